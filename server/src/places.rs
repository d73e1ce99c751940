//! Addresses of a farm's state, as the command line gives them.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use thiserror::Error;

/// An address that is none.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("'{text}' is no {wanted}")]
pub struct PlaceError {
    /// The text given, up to its first colon, as the rest may hold a password.
    pub text: String,
    /// The address wanted, in words.
    pub wanted: &'static str,
}

/// Address of the queue's database. Displayed without user and password.
#[derive(Clone, PartialEq, Eq)]
pub enum DatabasePlace {
    /// An SQLite file, which one server has open, or bakes of one machine.
    Sqlite(PathBuf),
    /// A PostgreSQL database, which any number of servers share.
    Postgres(String),
}

impl FromStr for DatabasePlace {
    type Err = PlaceError;

    fn from_str(text: &str) -> Result<Self, PlaceError> {
        let wanted = "database: sqlite:PATH or postgres://USER:PASSWORD@HOST:PORT/NAME";
        match text.split_once(':') {
            Some(("sqlite", path)) if !path.trim_start_matches('/').is_empty() => {
                let path = path.strip_prefix("//").unwrap_or(path);
                // More slashes than one mean one, as in any path; two would read as the end of a scheme.
                let rest = path.trim_start_matches('/');
                Ok(Self::Sqlite(if path.starts_with('/') { format!("/{rest}").into() } else { rest.into() }))
            }
            Some(("postgres" | "postgresql", rest)) if rest.starts_with("//") => {
                Ok(Self::Postgres(text.to_owned()))
            }
            _ => Err(wrong(text, wanted)),
        }
    }
}

impl fmt::Display for DatabasePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sqlite(path) => write!(f, "sqlite:{}", path.display()),
            Self::Postgres(url) => {
                let host = url.rsplit_once('@').map_or(url.as_str(), |(_, host)| host);
                let host = host.split('?').next().unwrap_or_default();
                write!(f, "postgres://{}", host.rsplit_once("://").map_or(host, |(_, host)| host))
            }
        }
    }
}

impl fmt::Debug for DatabasePlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// Address of the chunk store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChunksPlace {
    /// Files below a folder.
    Folder(PathBuf),
    /// Objects of an S3-compatible store; keys and endpoint come from the usual `AWS_…` variables.
    S3 {
        /// The bucket.
        bucket: String,
        /// Prefix of all keys; may be empty.
        prefix: String,
    },
}

impl FromStr for ChunksPlace {
    type Err = PlaceError;

    fn from_str(text: &str) -> Result<Self, PlaceError> {
        let wanted = "chunk store: a folder, file:///PATH or s3://BUCKET/PREFIX";
        if let Some(rest) = text.strip_prefix("s3://") {
            let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
            if bucket.is_empty() {
                return Err(wrong(text, wanted));
            }
            let prefix = prefix.trim_matches('/').to_owned();
            return Ok(Self::S3 { bucket: bucket.to_owned(), prefix });
        }
        let path = text.strip_prefix("file://").unwrap_or(text);
        if path.is_empty() || path.contains("://") {
            return Err(wrong(text, wanted));
        }
        Ok(Self::Folder(path.into()))
    }
}

fn wrong(text: &str, wanted: &'static str) -> PlaceError {
    let text = text.split(':').next().unwrap_or_default().chars().take(80).collect();
    PlaceError { text, wanted }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn databases_are_read_and_shown_without_passwords() {
        for (text, shown) in [
            ("sqlite:/var/farm.sqlite", "sqlite:/var/farm.sqlite"),
            ("sqlite:///var/farm.sqlite", "sqlite:/var/farm.sqlite"),
            ("sqlite:farm.sqlite", "sqlite:farm.sqlite"),
            ("sqlite://///var//farm.sqlite", "sqlite:/var//farm.sqlite"),
            ("postgres://u:se@cret@db:5432/farm?password=secret", "postgres://db:5432/farm"),
            ("postgresql://db/farm?sslmode=require", "postgres://db/farm"),
        ] {
            let place: DatabasePlace = text.parse().unwrap();
            assert_eq!(format!("{place} {place:?}"), format!("{shown} {shown}"));
        }
        for text in ["", "farm", "sqlite:", "sqlite://", "mysql://db", "postgres:db"] {
            assert!(text.parse::<DatabasePlace>().is_err(), "{text}");
        }
        let error = "mysql://u:secret@db".parse::<DatabasePlace>().unwrap_err();
        assert!(!error.to_string().contains("secret"), "{error}");
    }

    #[test]
    fn chunk_stores_are_read() {
        let s3 =
            |bucket: &str, prefix: &str| ChunksPlace::S3 { bucket: bucket.into(), prefix: prefix.into() };
        for (text, wanted) in [
            ("/srv/chunks", ChunksPlace::Folder("/srv/chunks".into())),
            ("file:///srv/chunks", ChunksPlace::Folder("/srv/chunks".into())),
            ("chunks", ChunksPlace::Folder("chunks".into())),
            ("s3://farm", s3("farm", "")),
            ("s3://BUCKET/PREFIX/MORE/", s3("BUCKET", "PREFIX/MORE")),
        ] {
            assert_eq!(text.parse(), Ok(wanted), "{text}");
        }
        for text in ["", "s3://", "s3:///prefix", "gs://bucket", "file://"] {
            assert!(text.parse::<ChunksPlace>().is_err(), "{text}");
        }
    }
}
