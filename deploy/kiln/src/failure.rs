//! How a command fails: what was wrong, its causes, the next step, and an exit code that scripts can rely on.

use std::error::Error as StdError;
use std::fmt;
use std::process::ExitCode;

use lightkiln_client::ClientError;
use lightkiln_http::CallError;
use lightkiln_proto::api::BakeState;
use lightkiln_proto::problem::{ProblemCode, RetryClass, causes};

/// Exit codes, for `--help`.
pub const EXIT_CODES: &str = "Exit codes:
  0    done
  1    the bake failed, or Lightkiln itself did
  2    wrong arguments, settings or input files
  3    the server was not reached
  4    the bake is done, but its evaluation breaks a limit of --fail-if
  5    stored bytes are lost or damaged: those of a bake, or some that 'kiln fsck' did not make good
  130  interrupted, or the bake that was waited for was cancelled";

/// Why a command ends; the number is the process's exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// The bake failed, or Lightkiln itself did.
    Failed = 1,
    /// Wrong arguments, settings or input files.
    BadInput = 2,
    /// The server was not reached.
    Unreachable = 3,
    /// The bake is done, but its evaluation breaks a limit of `--fail-if`.
    LimitBroken = 4,
    /// Stored bytes are lost or damaged.
    Unsound = 5,
    /// Ctrl-C or SIGTERM.
    Interrupted = 130,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// A command's end without success. Displayed as `error: …`, `caused by: …` and `try: …`, a line each.
#[derive(Clone, Debug)]
pub struct Failure {
    exit: Exit,
    message: String,
    causes: Vec<String>,
    next_step: Option<String>,
}

/// Result of a command.
pub type Result<T> = std::result::Result<T, Failure>;

impl Failure {
    /// A failure in words of its own.
    pub fn new(exit: Exit, message: impl Into<String>) -> Self {
        Self { exit, message: message.into(), causes: Vec::new(), next_step: None }
    }

    /// A failure in the words of an error.
    pub fn of(exit: Exit, error: &(dyn StdError + 'static)) -> Self {
        Self {
            causes: causes(error).skip(1).map(ToString::to_string).collect(),
            ..Self::new(exit, error.to_string())
        }
    }

    /// Wrong arguments, settings or input files.
    pub fn bad_input(message: impl Into<String>) -> Self {
        Self::new(Exit::BadInput, message)
    }

    /// Adds an error and all that caused it.
    #[must_use]
    pub fn caused_by(mut self, error: &(dyn StdError + 'static)) -> Self {
        self.causes.extend(causes(error).map(ToString::to_string));
        self
    }

    /// Adds what the user can do about it.
    #[must_use]
    pub fn try_this(mut self, next_step: impl Into<String>) -> Self {
        self.next_step = Some(next_step.into());
        self
    }

    /// The fault, without causes.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// The exit code.
    pub fn exit(&self) -> Exit {
        self.exit
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "error: {}", self.message)?;
        for cause in &self.causes {
            // A line each: a name out of a file cannot add one.
            writeln!(f, "  caused by: {}", cause.replace(['\n', '\r'], " "))?;
        }
        match &self.next_step {
            Some(next_step) => writeln!(f, "  try: {next_step}"),
            None => Ok(()),
        }
    }
}

impl StdError for Failure {}

/// The client's errors already say what was wrong, where, and what to do.
impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        let exit = match &error {
            ClientError::Call(error) => exit_of_call(error),
            ClientError::Ended { state: Some(BakeState::Cancelled), .. } => Exit::Interrupted,
            ClientError::Ended { state: Some(_), .. } => Exit::Failed,
            ClientError::Ended { state: None, .. }
            | ClientError::Source { .. }
            | ClientError::Argument { .. }
            | ClientError::Object { .. }
            | ClientError::TooLarge { .. }
            | ClientError::Json { .. }
            | ClientError::Manifest { .. }
            | ClientError::Chunk { .. }
            | ClientError::Inconsistent { .. } => Exit::BadInput,
            ClientError::WrongDigest { .. } | ClientError::WrongPrefix { .. } => Exit::Unsound,
            ClientError::File { .. }
            | ClientError::Adapter { .. }
            | ClientError::AdapterFull { .. }
            | ClientError::Window { .. }
            | ClientError::Picture { .. } => Exit::Failed,
        };
        let failure = Self::of(exit, &error);
        let is_busy =
            matches!(&error, ClientError::Call(error) if error.code() == Some(ProblemCode::TooManyRequests));
        let tls_step = match &error {
            ClientError::Call(error) => tls_step(error),
            _ => None,
        };
        if is_busy {
            failure.try_this("the same command a little later")
        } else if let Some(tls_step) = tls_step {
            failure.try_this(tls_step)
        } else if exit == Exit::Unreachable {
            failure.try_this("start one with 'kiln server', or bake without --server")
        } else {
            failure
        }
    }
}

/// The next step where a server is there, and one side alone speaks TLS or its certificate is not trusted.
fn tls_step(error: &CallError) -> Option<&'static str> {
    let CallError::Network { call, source } = error else { return None };
    let cause = source.to_string();
    if cause.contains("certificate") {
        Some("--ca FILE, or KILN_CA, with the certificate of the authority that signed the server's")
    } else if cause.contains("InvalidContentType") {
        Some("http:// in the server's URL, unless it has a certificate")
    } else if call.contains(" http://") && cause.contains("http parse fail") {
        Some("https:// in the server's URL, if it has a certificate")
    } else {
        None
    }
}

fn exit_of_call(error: &CallError) -> Exit {
    match error {
        CallError::Stopped => Exit::Interrupted,
        CallError::Network { .. } | CallError::Foreign { .. } => Exit::Unreachable,
        // It was reached; only its owner can make room.
        CallError::Refused { problem, .. } if problem.code == ProblemCode::StorageFull => Exit::Failed,
        // Its bytes were there when the bake ended: nobody named a wrong one.
        CallError::Refused { call, problem, .. }
            if problem.code == ProblemCode::NotFound && call.contains("/v1/chunks/") =>
        {
            Exit::Unsound
        }
        CallError::WrongPart { .. } => Exit::Unsound,
        CallError::Refused { .. } if error.retry_class() == RetryClass::Backoff => Exit::Unreachable,
        CallError::Refused { .. }
        | CallError::Address { .. }
        | CallError::Certificates { .. }
        | CallError::Json { .. }
        | CallError::TooLarge { .. } => Exit::BadInput,
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::problem::Problem;

    use super::*;

    #[test]
    fn full_server_fails_in_its_own_words_and_is_not_said_to_be_away() {
        let problem = Problem::new(ProblemCode::StorageFull, "free 3 GiB under /srv/farm");
        let (call, problem) = ("PUT /v1/scenes".to_owned(), Box::new(problem));
        let error = CallError::Refused { call, problem, retry_after: None };
        let failure = Failure::from(ClientError::from(error));
        assert_eq!(failure.exit(), Exit::Failed);
        let text = failure.to_string();
        assert!(text.contains("free 3 GiB") && !text.contains("kiln server"), "{text}");
    }

    #[test]
    fn light_that_came_wrong_or_is_lost_is_no_bad_input_and_a_server_that_is_lost_is_unreachable() {
        let (place, digest) = ("http://farm:7410".to_owned(), lightkiln_proto::ids::Digest::of(b"chunk"));
        let (call, problem) = ("GET /v1/chunks".to_owned(), "bytes from 9 on came".to_owned());
        let refused = |call: &str| {
            let problem = Box::new(Problem::new(ProblemCode::NotFound, "there is none"));
            ClientError::from(CallError::Refused { call: call.to_owned(), problem, retry_after: None })
        };
        assert_eq!(Failure::from(refused("GET http://farm:7410/v1/bakes/ab")).exit(), Exit::BadInput);
        let wrong = [
            ClientError::WrongPrefix { place, digest, bytes: 700 },
            ClientError::from(CallError::WrongPart { call, problem }),
            refused("GET http://farm:7410/v1/chunks/ab"),
        ];
        for error in wrong {
            let told = error.to_string();
            let failure = Failure::from(error);
            assert_eq!(failure.exit(), Exit::Unsound, "{told}");
            assert!(failure.to_string().contains(&told), "{failure}");
        }
        let lost = CallError::Foreign { call: "GET /v1/chunks".to_owned(), status: 502, retry_after: None };
        assert_eq!(Failure::from(ClientError::from(lost)).exit(), Exit::Unreachable);
    }

    #[test]
    fn failure_names_its_causes_and_the_next_step_on_lines_of_their_own() {
        let cause = std::io::Error::other("disk full");
        let failure = Failure::bad_input("cannot write 'out'").caused_by(&cause).try_this("free some room");
        let text = failure.to_string();
        assert_eq!(text, "error: cannot write 'out'\n  caused by: disk full\n  try: free some room\n");
        let cause = std::io::Error::other("extension 'a\r\nbundle: b' is not known");
        let text = Failure::bad_input("no").caused_by(&cause).to_string();
        assert_eq!(text, "error: no\n  caused by: extension 'a  bundle: b' is not known\n");
    }
}
