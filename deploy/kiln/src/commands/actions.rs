//! `kiln pause`, `resume`, `cancel` and `delete`: what is done to a bake whose id is all there is to say.

use clap::Args;
use lightkiln_client::fetch::ApiClient;

use crate::arguments::ServerArgument;
use crate::console::say;
use crate::failure::Result;

/// Arguments of each of them.
#[derive(Args, Debug)]
pub struct Arguments {
    /// The bake's id, or its first characters (4 or more)
    id: String,
    #[command(flatten)]
    server: ServerArgument,
}

/// A change of a bake.
#[derive(Clone, Copy, Debug)]
pub enum Action {
    /// Tasks are held back; those under way go on.
    Pause,
    /// The pause ends.
    Resume,
    /// The bake ends; its finished tasks stay and are used again by a later bake.
    Cancel,
    /// The bake goes, with the results that no other bake holds; the server frees their room after its grace.
    Delete,
}

impl Action {
    /// Does it, and says so.
    pub fn run(self, arguments: Arguments) -> Result<()> {
        let Arguments { id, server } = arguments;
        let client = server.connect()?;
        // The whole id, where a beginning of it was given.
        let id = client.bake(&id)?.id;
        say!("bake {id} {}", self.take(&client, &id)?);
        Ok(())
    }

    /// Does it; gives the bake's state afterwards, in words.
    fn take(self, client: &ApiClient, id: &str) -> Result<String> {
        Ok(match self {
            Self::Pause => {
                client.pause(id).map(|_| format!("is paused; 'kiln resume {id}' lets it go on"))?
            }
            Self::Resume => client.resume(id).map(|_| "goes on".to_owned())?,
            Self::Cancel => client.cancel(id).map(|_| "is cancelled".to_owned())?,
            Self::Delete => client.delete(id).map(|()| "is deleted".to_owned())?,
        })
    }
}
