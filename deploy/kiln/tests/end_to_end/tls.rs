//! A farm that is reached over TLS.

use std::path::{Path, PathBuf};

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair};

use super::bundle;
use super::farm::{arguments, embedded_bundle};
use super::processes::{Running, Server, kiln, run};

/// Files of an authority, and of a certificate that it signed for this machine.
struct Files {
    ca: String,
    cert: PathBuf,
    key: PathBuf,
}

impl Files {
    fn make(folder: &Path) -> Self {
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let ca = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
        let key = KeyPair::generate().unwrap();
        let names = vec!["127.0.0.1".to_owned(), "localhost".to_owned()];
        let cert = CertificateParams::new(names).unwrap().signed_by(&key, &ca).unwrap();
        let write = |name: &str, text: String| {
            let path = folder.join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        Self {
            ca: write("ca.pem", ca.pem()).display().to_string(),
            cert: write("cert.pem", cert.pem()),
            key: write("key.pem", key.serialize_pem()),
        }
    }

    fn server(&self, state: &Path) -> Server {
        let [cert, key] = [&self.cert, &self.key].map(|path| path.display().to_string());
        Server::start_with(kiln(state), &["--tls-cert", &cert, "--tls-key", &key])
    }
}

#[test]
fn farm_with_tls_bakes_the_same_for_those_who_trust_its_authority() {
    let folder = tempfile::tempdir().unwrap();
    let expected = embedded_bundle(folder.path());
    let files = Files::make(folder.path());
    let server = files.server(&folder.path().join("server"));
    assert!(server.url.starts_with("https://"), "{}", server.url);
    let mut worker = kiln(&folder.path().join("worker"));
    worker.args([
        "worker",
        "--server",
        &server.url,
        "--ca",
        &files.ca,
        "--threads",
        "2",
        "--lease-secs",
        "5",
    ]);
    let _worker = Running::start(worker);
    let out = folder.path().join("out").display().to_string();
    let bake = arguments("bake", &["--server", &server.url, "--ca", &files.ca, "--out", &out]);
    run(kiln(folder.path()), &bake, 0);
    assert_eq!(bundle(Path::new(&out)), expected);
    let mut by_variable = kiln(folder.path());
    by_variable.env("KILN_CA", &files.ca);
    assert!(run(by_variable, &["list", "--server", &server.url], 0).stdout().contains("done"));
}

#[test]
fn farm_is_not_spoken_to_by_those_who_do_not_trust_it() {
    let folder = tempfile::tempdir().unwrap();
    let files = Files::make(folder.path());
    let server = files.server(&folder.path().join("server"));
    let refused = run(kiln(folder.path()), &["list", "--server", &server.url], 3);
    assert!(refused.stderr().contains("try: --ca FILE"), "{}", refused.stderr());
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    let other = Files::make(&other);
    run(kiln(folder.path()), &["list", "--server", &server.url, "--ca", &other.ca], 3);
    run(kiln(folder.path()), &["list", "--server", &server.url, "--ca", &files.ca], 0);
    let plain = server.url.replace("https://", "http://");
    let refused = run(kiln(folder.path()), &["list", "--server", &plain, "--ca", &files.ca], 3);
    assert!(refused.stderr().contains("try: https://"), "{}", refused.stderr());
}

#[test]
fn server_with_tls_ends_well_when_it_is_told_to() {
    let folder = tempfile::tempdir().unwrap();
    let files = Files::make(folder.path());
    let server = files.server(&folder.path().join("server"));
    run(kiln(folder.path()), &["list", "--server", &server.url, "--ca", &files.ca], 0);
    assert_eq!(server.stop(), Some(0));
}

#[test]
fn certificates_that_cannot_be_used_are_refused_with_their_file() {
    let folder = tempfile::tempdir().unwrap();
    let files = Files::make(folder.path());
    let [cert, key] = [&files.cert, &files.key].map(|path| path.display().to_string());
    let serve = |more: &[&str]| {
        let arguments = [&["server", "--listen", "127.0.0.1:0"], more].concat();
        run(kiln(folder.path()), &arguments, 2).stderr()
    };
    assert!(serve(&["--tls-cert", &cert]).contains("--tls-key"));
    assert!(serve(&["--tls-cert", &key, "--tls-key", &key]).contains("key.pem"));
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    let of_another = Files::make(&other).key.display().to_string();
    assert!(serve(&["--tls-cert", &cert, "--tls-key", &of_another]).contains("--tls-cert"));
    assert!(serve(&["--tls-cert", "absent.pem", "--tls-key", &key]).contains("absent.pem"));
    for (ca, told) in [("absent.pem", "absent.pem"), (key.as_str(), "BEGIN CERTIFICATE")] {
        for command in ["list", "worker"] {
            let refused =
                run(kiln(folder.path()), &[command, "--server", "https://127.0.0.1:9", "--ca", ca], 2);
            assert!(refused.stderr().contains(told), "{command}: {}", refused.stderr());
        }
    }
}
