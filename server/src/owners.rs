//! Whose bakes are whose.

use crate::access::{Bearer, Scope};
use crate::error::{Result, ServerError};
use crate::farm::Farm;

impl Farm {
    /// Refuses a bearer who may not change a bake: it is another's, and he has not the scope admin.
    pub(crate) async fn require_owner(&self, bake: &str, caller: Option<&Bearer>) -> Result<()> {
        let Some(caller) = caller.filter(|caller| !caller.scopes.contains(&Scope::Admin)) else {
            return Ok(());
        };
        match self.store.show(bake).await?.owner {
            Some(owner) if owner != caller.name => {
                Err(ServerError::NotOwner { bake: bake.to_owned(), owner, caller: caller.name.clone() })
            }
            _ => Ok(()),
        }
    }
}
