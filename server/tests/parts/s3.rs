//! One S3-compatible server for all tests of the process: moto, which keeps objects in memory.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::sync::OnceLock;

use super::keeper::Keeper;

/// The bucket of all tests; each uses a prefix of its own.
pub const BUCKET: &str = "farm";

/// A running server.
pub struct S3 {
    port: u16,
    _keeper: Keeper,
}

impl S3 {
    fn start() -> Self {
        let program = program();
        let script = || {
            format!(
                r#"PYTHONUNBUFFERED=1 "{}" -H 127.0.0.1 -p 0 2>&1 &
                server=$! stop=KILL"#,
                program.display()
            )
        };
        let (keeper, line) = Keeper::start(script, "Running on http://127.0.0.1:", false);
        let port = line.rsplit(':').next().unwrap().trim().parse().unwrap();
        let mut connection = TcpStream::connect(("127.0.0.1", port)).unwrap();
        let create = format!(
            "PUT /{BUCKET} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        );
        connection.write_all(create.as_bytes()).unwrap();
        let mut answer = String::new();
        connection.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        Self { port, _keeper: keeper }
    }

    /// Its port on 127.0.0.1.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// The variables that lead to it.
    pub fn settings(&self) -> Vec<(String, String)> {
        Self::settings_at(self.port)
    }

    /// The variables that lead to it by way of another port.
    pub fn settings_at(port: u16) -> Vec<(String, String)> {
        let endpoint = format!("http://127.0.0.1:{port}");
        [
            ("AWS_ACCESS_KEY_ID", "kiln"),
            ("AWS_SECRET_ACCESS_KEY", "kiln"),
            ("AWS_REGION", "us-east-1"),
            ("AWS_ENDPOINT_URL", &endpoint),
        ]
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .to_vec()
    }
}

/// The process's server, started when first asked for.
pub fn server() -> &'static S3 {
    static SERVER: OnceLock<S3> = OnceLock::new();
    SERVER.get_or_init(S3::start)
}

/// Where `tests/run` puts it, unless told otherwise.
fn program() -> PathBuf {
    if let Some(told) = std::env::var_os("KILN_TEST_MOTO") {
        return told.into();
    }
    // This test is TARGET/PROFILE/deps/NAME.
    let test = std::env::current_exe().unwrap();
    let found = test.ancestors().map(|folder| folder.join("test-parts/moto/bin/moto_server"));
    found
        .into_iter()
        .find(|program| program.is_file())
        .expect("moto_server is not installed: run tests/run once")
}
