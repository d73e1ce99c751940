//! A farm that asks for tokens.

use std::path::Path;
use std::process::Command;

use super::farm::arguments;
use super::processes::{Running, Server, kiln, run};

fn with_token(state: &Path, token: &str) -> Command {
    let mut command = kiln(state);
    command.env("KILN_TOKEN", token);
    command
}

#[test]
fn farm_with_tokens_works_for_those_who_have_the_right_one() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path();
    let create = |name: &str, scopes: &str| {
        let made = run(kiln(state), &["token", "create", name, "--scope", scopes], 0);
        made.stdout().trim().to_owned()
    };
    let worker = create("oven", "worker");
    let server = Server::start(state);
    let submit = create("ci", "submit");
    let refused = run(kiln(state), &["list", "--server", &server.url], 2);
    assert!(refused.stderr().contains("KILN_TOKEN"), "{}", refused.stderr());
    run(with_token(state, "two words"), &["list", "--server", &server.url], 2);
    let refused = run(with_token(state, &submit), &["worker", "--server", &server.url], 2);
    assert!(refused.stderr().contains("scope 'worker'"), "{}", refused.stderr());
    // Of a bake too: a refusal is no server that is away, which a script would try again.
    let bake = |command: Command| {
        let out = state.join("none").display().to_string();
        run(command, &arguments("bake", &["--server", &server.url, "--out", &out]), 2).stderr()
    };
    assert!(bake(kiln(state)).contains("KILN_TOKEN"));
    let refused = bake(with_token(state, &worker));
    assert!(refused.contains("scope submit") && !refused.contains("kiln server"), "{refused}");
    let mut command = with_token(&state.join("oven"), &worker);
    command.args(["worker", "--server", &server.url, "--threads", "2"]);
    let _worker = Running::start(command);
    let out = state.join("out").display().to_string();
    run(with_token(state, &submit), &arguments("bake", &["--server", &server.url, "--out", &out]), 0);
}

#[test]
fn tokens_are_listed_and_revoked_and_shown_but_once() {
    let folder = tempfile::tempdir().unwrap();
    let token =
        |arguments: &[&str], exit: i32| run(kiln(folder.path()), &[&["token"], arguments].concat(), exit);
    assert!(token(&["list"], 0).stderr().contains("kiln token create"));
    let secret = token(&["create", "ci", "--scope", "read,submit"], 0).stdout().trim().to_owned();
    assert!(secret.len() > 64, "{secret}");
    let listed = token(&["list", "--json"], 0);
    assert!(!listed.stdout().contains(&secret));
    assert_eq!(listed.json()[0]["scopes"], serde_json::json!(["read", "submit"]));
    assert!(token(&["list"], 0).stdout().contains("good"));
    token(&["revoke", "ci"], 0);
    assert!(token(&["list"], 0).stdout().contains("revoked"));
    for (wrong, told) in [
        (&["create", "ci", "--scope", "read"][..], "another name"),
        (&["create", "new", "--scope", "all"], "submit, worker and admin"),
        (&["create", "no good", "--scope", "read"], "letters, digits"),
        (&["revoke", "nobody"], "kiln token list"),
    ] {
        let refused = token(wrong, 2);
        assert!(refused.stderr().contains(told), "{wrong:?}: {}", refused.stderr());
    }
}
