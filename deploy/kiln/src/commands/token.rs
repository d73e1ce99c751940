//! `kiln token`: who may call a farm, and for what.

use std::collections::BTreeSet;
use std::time::{SystemTime, UNIX_EPOCH};

use clap::{Args, Subcommand};
use lightkiln_server::access::{Bearer, CODE_LIFETIME, NewBearer, Scope};
use lightkiln_server::store::{FarmStore, SqlStore, StoreError};
use lightkiln_server::{ServerError, open_store};
use serde_json::json;
use tokio::runtime::Runtime;

use crate::arguments::StateArguments;
use crate::console::{answer, put_json, say};
use crate::embedded::server_failure;
use crate::failure::{Exit, Failure, Result};

/// Arguments of `kiln token`.
#[derive(Args, Debug)]
#[command(
    after_help = "Commands that call a farm, workers too, take their token from the variable KILN_TOKEN. A farm that has \
                        never had a token asks nobody for one; from the first one on every call needs one. Servers \
                        notice changes within seconds."
)]
pub struct Arguments {
    /// The action
    #[command(subcommand)]
    action: Action,
    #[command(flatten)]
    state: StateArguments,
}

#[derive(Subcommand, Debug)]
enum Action {
    /// Makes a token and prints it; it is shown this once and stored nowhere
    Create {
        /// Whose it is; unique on the farm, for ever
        name: String,
        /// Rights: read, submit (send and change bakes, and read), worker, admin (everything)
        #[arg(long = "scope", value_name = "SCOPE", required = true, value_delimiter = ',')]
        scopes: Vec<Scope>,
    },
    /// Makes a code with which one worker gets a token of its own: 'kiln worker --enrol CODE', within an hour
    Enrol {
        /// Name for the worker's token; unique on the farm, for ever
        name: String,
    },
    /// Lists the tokens of the farm by name
    List {
        /// Prints them as JSON
        #[arg(long)]
        json: bool,
    },
    /// Makes a token useless
    Revoke {
        /// Whose it is
        name: String,
    },
}

/// Changes or shows who has tokens.
pub fn run(arguments: Arguments) -> Result<()> {
    let state = arguments.state.folder()?;
    let runtime = Runtime::new()
        .map_err(|error| Failure::new(Exit::Failed, "no thread can be started").caused_by(&error))?;
    runtime.block_on(async {
        let store = open_store(&state, arguments.state.database.as_ref()).await;
        let store = store.map_err(|error| server_failure(&error))?;
        let done = act(&store, arguments.action).await;
        store.close().await;
        done.map_err(|error| token_failure(&error))
    })
}

async fn act(store: &SqlStore, action: Action) -> std::result::Result<(), ServerError> {
    match action {
        Action::Create { name, scopes } => {
            let new = NewBearer::named(&name)?;
            warn_of_the_first(store).await?;
            store.add_bearer(&new.name, new.hash(), &scopes.into_iter().collect()).await?;
            say!("this token is shown only now; give it to {name} as KILN_TOKEN:");
            answer!("{}", new.token);
        }
        Action::Enrol { name } => {
            let new = NewBearer::code_for(&name)?;
            if store.bearers().await?.iter().any(|bearer| bearer.name == name) {
                return Err(StoreError::BearerExists { name }.into());
            }
            warn_of_the_first(store).await?;
            store.add_bearer(&new.name, new.hash(), &[Scope::Enrol].into()).await?;
            let minutes = CODE_LIFETIME.as_secs() / 60;
            say!("this code is shown only now, and good for one worker within {minutes} minutes:");
            answer!("{}", new.token);
        }
        Action::List { json } => list(&store.bearers().await?, json),
        Action::Revoke { name } => {
            store.revoke_bearer(&name).await?;
            say!("the token of {name} is revoked; servers refuse it within seconds");
        }
    }
    Ok(())
}

/// Says whom the first token of a farm shuts out: all who work for it now, and call it, without one.
async fn warn_of_the_first(store: &SqlStore) -> std::result::Result<(), ServerError> {
    if !store.bearers().await?.is_empty() {
        return Ok(());
    }
    let workers: Vec<String> = store.workers().await?.into_iter().map(|worker| worker.name).collect();
    if !workers.is_empty() {
        say!(
            "warning: this is the farm's first token: within seconds its servers refuse all who call without one. Workers \
             that have none are cut off, and their tasks wait for others: {}. 'kiln token enrol NAME' gives each a code to \
             start it with anew",
            workers.join(", ")
        );
    }
    Ok(())
}

fn list(bearers: &[Bearer], as_json: bool) {
    let names = |scopes: &BTreeSet<Scope>| scopes.iter().map(|scope| scope.name()).collect::<Vec<_>>();
    let now_ms = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |age| age.as_millis() as i64);
    let standing = |bearer: &Bearer| bearer.standing(bearers, now_ms).name();
    if as_json {
        let entry = |bearer: &Bearer| {
            json!({
                "name": bearer.name,
                "scopes": names(&bearer.scopes),
                "created_ms": bearer.created_ms,
                "revoked_ms": bearer.revoked_ms,
                "standing": standing(bearer),
            })
        };
        put_json(&bearers.iter().map(entry).collect::<Vec<_>>());
        return;
    }
    for bearer in bearers {
        answer!("{:24}  {:7}  {}", bearer.name, standing(bearer), names(&bearer.scopes).join(","));
    }
    if bearers.is_empty() {
        say!("this farm asks nobody for a token; 'kiln token create NAME --scope …' makes one");
    }
}

fn token_failure(error: &ServerError) -> Failure {
    let failed = Failure::new(Exit::BadInput, "the token was not changed").caused_by(error);
    failed.try_this("'kiln token list' to see those that there are")
}
