//! Bearers of tokens.

use std::collections::BTreeSet;

use lightkiln_proto::ids::Digest;

use super::codec::to_json;
use super::conn::{Conn, Row, query};
use crate::access::{Bearer, Scope};
use crate::store::{Result, StoreError, same_bearer};

pub(super) async fn add(
    conn: &mut Conn,
    name: &str,
    hash: Digest,
    scopes: &BTreeSet<Scope>,
) -> Result<Bearer> {
    if let Some(bearer) = find(conn, name).await? {
        return same_bearer(bearer, hash);
    }
    query("INSERT INTO bearers (name, hash, scopes, created_ms) VALUES ($1, $2, $3, $4)")
        .bind(name)
        .bind(hash.to_string())
        .bind(to_json(scopes)?)
        .bind(conn.now_ms)
        .run(conn)
        .await?;
    Ok(Bearer {
        name: name.to_owned(),
        hash,
        scopes: scopes.clone(),
        created_ms: conn.now_ms,
        revoked_ms: None,
    })
}

pub(super) async fn revoke(conn: &mut Conn, name: &str) -> Result<Bearer> {
    let sql = "UPDATE bearers SET revoked_ms = $1 WHERE name = $2 AND revoked_ms IS NULL";
    query(sql).bind(conn.now_ms).bind(name).run(conn).await?;
    let found = find(conn, name).await?;
    found.ok_or_else(|| StoreError::NoSuchBearer { name: name.to_owned() })
}

pub(super) async fn all(conn: &mut Conn) -> Result<Vec<Bearer>> {
    let rows = query("SELECT name, hash, scopes, created_ms, revoked_ms FROM bearers ORDER BY name")
        .all(conn)
        .await?;
    rows.iter().map(bearer).collect()
}

async fn find(conn: &mut Conn, name: &str) -> Result<Option<Bearer>> {
    let row = query("SELECT name, hash, scopes, created_ms, revoked_ms FROM bearers WHERE name = $1")
        .bind(name)
        .optional(conn)
        .await?;
    row.as_ref().map(bearer).transpose()
}

fn bearer(row: &Row) -> Result<Bearer> {
    Ok(Bearer {
        name: row.get("name")?,
        hash: row.digest("hash")?,
        scopes: row.json("scopes")?,
        created_ms: row.get("created_ms")?,
        revoked_ms: row.get("revoked_ms")?,
    })
}
