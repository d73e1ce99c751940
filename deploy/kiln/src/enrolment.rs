//! A worker's own token: made here, exchanged a code for, and kept in a file that nobody else may read.

use std::error::Error;
use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

use lightkiln_http::{CallError, FOREVER, Level, retry};
use lightkiln_server::access::NewBearer;
use lightkiln_worker::runtime::{WorkerConfig, enrol};

use crate::console::say;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;

/// Longest token that a file may hold, in bytes.
const TOKEN_BYTES_MAX: u64 = 4096;

/// The token in `file`; with a code, one that the farm takes from now on, made if there is none.
///
/// The token is on the disk before the farm hears of it: a worker that ends in between goes on with the same code.
pub fn token_of_worker(
    config: &WorkerConfig,
    file: &Path,
    code: Option<&str>,
    interrupt: &Interrupt,
) -> Result<Option<String>> {
    let kept = read(file)?;
    let Some(code) = code.filter(|code| !code.is_empty()) else { return Ok(kept) };
    let is_new = kept.is_none();
    let token = match kept {
        Some(token) => token,
        None => make(file)?,
    };
    match exchange(config, code, &token, interrupt) {
        Ok(name) => say!("enrolled as {name}; the token is kept in {}", file.display()),
        // The code was used up when the token was made, long ago perhaps.
        Err(error) if error.is_about_tokens() && !is_new => {
            tracing::info!(%error, "the code is not taken any more; going on with the token that is kept");
        }
        Err(error) if error.is_about_tokens() => {
            let _ = fs::remove_file(file);
            let failure = Failure::bad_input("this worker was not enrolled").caused_by(&error);
            return Err(failure.try_this("another code, from 'kiln token enrol NAME'"));
        }
        Err(CallError::Stopped) => return Err(Failure::new(Exit::Interrupted, "interrupted")),
        Err(error) => {
            let failure = Failure::bad_input("this worker cannot be enrolled").caused_by(&error);
            return Err(failure.try_this("the URL of a Lightkiln server with --server"));
        }
    }
    Ok(Some(token))
}

/// Waits for a server that is away.
fn exchange(
    config: &WorkerConfig,
    code: &str,
    token: &str,
    interrupt: &Interrupt,
) -> std::result::Result<String, CallError> {
    let is_over = |level| level > Level::Run;
    let pause = |error: &CallError, wait| {
        let error = error as &dyn Error;
        tracing::warn!(error, "this worker could not be enrolled; trying again");
        if is_over(interrupt.flag().wait(wait, is_over)) { Err(CallError::Stopped) } else { Ok(()) }
    };
    retry(FOREVER, || enrol(&config.server_url, config.ca_pem.as_deref(), code, token), pause)
}

fn read(file: &Path) -> Result<Option<String>> {
    let unusable = |what: &str| {
        Failure::bad_input(format!("the token file {} {what}", file.display()))
            .try_this("another one with --token-file, or remove it and enrol this worker again")
    };
    let metadata = match fs::metadata(file) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(unusable("cannot be read").caused_by(&error)),
    };
    if !metadata.is_file() || metadata.len() > TOKEN_BYTES_MAX {
        return Err(unusable("holds no token"));
    }
    if metadata.permissions().mode() & 0o077 != 0 {
        return Err(unusable("can be read by others; its mode must be 0600"));
    }
    let text = fs::read_to_string(file).map_err(|error| unusable("cannot be read").caused_by(&error))?;
    let token = text.trim();
    if token.is_empty() || !token.bytes().all(|byte| byte.is_ascii_graphic()) {
        return Err(unusable("holds no token"));
    }
    Ok(Some(token.to_owned()))
}

fn make(file: &Path) -> Result<String> {
    let new = NewBearer::named("worker")
        .map_err(|error| Failure::new(Exit::Failed, "no token can be made").caused_by(&error))?;
    let write = || {
        if let Some(folder) = file.parent() {
            fs::create_dir_all(folder)?;
        }
        let mut opened = File::options().write(true).create_new(true).mode(0o600).open(file)?;
        opened.write_all(format!("{}\n", new.token).as_bytes())?;
        opened.sync_all()
    };
    write().map_err(|error| {
        Failure::bad_input(format!("the token file {} cannot be written", file.display()))
            .caused_by(&error)
            .try_this("another one with --token-file")
    })?;
    Ok(new.token)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn token_is_kept_where_nobody_else_reads_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a/token");
        assert_eq!(read(&file).unwrap(), None);
        let token = make(&file).unwrap();
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(read(&file).unwrap(), Some(token));
        assert!(make(&file).is_err(), "a token is never written over");
        fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
        assert!(read(&file).unwrap_err().to_string().contains("0600"));
    }

    #[test]
    fn file_that_holds_no_token_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("token");
        for content in ["", "two words", "kiln_\u{e4}", &"x".repeat(5000)] {
            fs::write(&file, content).unwrap();
            fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
            assert!(read(&file).unwrap_err().to_string().contains("no token"), "{content}");
        }
        assert!(read(folder.path()).is_err());
    }
}
