//! Those who have tokens.

use std::collections::BTreeSet;

use lightkiln_proto::ids::Digest;
use lightkiln_server::access::{Bearer, Scope};
use lightkiln_server::store::StoreError;

use crate::support::World;

async fn add(world: &World, name: &str, token: &str, scopes: &[Scope]) -> Result<Bearer, StoreError> {
    let scopes: BTreeSet<Scope> = scopes.iter().copied().collect();
    world.store.add_bearer(name, Digest::of(token.as_bytes()), &scopes).await
}

pub async fn bearers_are_listed_by_name_also_when_revoked(world: World) {
    assert_eq!(world.store.bearers().await.unwrap(), []);
    let b = add(&world, "b", "one", &[Scope::Read, Scope::Worker]).await.unwrap();
    assert_eq!(b.scopes, [Scope::Read, Scope::Worker].into());
    assert_eq!((b.created_ms, b.revoked_ms), (1_000_000, None));
    world.clock.advance_ms(5);
    let a = add(&world, "a", "two", &[Scope::Admin]).await.unwrap();
    assert_eq!(world.store.bearers().await.unwrap(), [a.clone(), b.clone()]);
    let revoked = world.store.revoke_bearer("b").await.unwrap();
    assert_eq!(revoked, Bearer { revoked_ms: Some(1_000_005), ..b });
    assert_eq!(world.store.bearers().await.unwrap(), [a, revoked]);
}

pub async fn name_of_a_bearer_is_given_once(world: World) {
    let first = add(&world, "a", "one", &[Scope::Read]).await.unwrap();
    assert_eq!(add(&world, "a", "one", &[Scope::Read]).await.unwrap(), first, "the same call again");
    world.store.revoke_bearer("a").await.unwrap();
    let refused = add(&world, "a", "two", &[Scope::Read]).await;
    assert!(matches!(&refused, Err(StoreError::BearerExists { name }) if name == "a"), "{refused:?}");
    assert_eq!(world.store.bearers().await.unwrap().len(), 1);
}

pub async fn revoking_again_changes_nothing(world: World) {
    add(&world, "a", "one", &[Scope::Read]).await.unwrap();
    let revoked = world.store.revoke_bearer("a").await.unwrap();
    world.clock.advance_ms(5);
    assert_eq!(world.store.revoke_bearer("a").await.unwrap(), revoked);
    let unknown = world.store.revoke_bearer("b").await;
    assert!(matches!(&unknown, Err(StoreError::NoSuchBearer { name }) if name == "b"), "{unknown:?}");
}
