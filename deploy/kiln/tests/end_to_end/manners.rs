//! What people who run a farm see of it: lists, shortened ids, the time left, the first token.

use lightkiln_proto::api::BakeState;

use super::farm::arguments;
use super::processes::{Running, Server, kiln, run};

#[test]
fn bakes_are_filtered_and_named_by_the_first_characters_of_their_ids() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("server"));
    let call = |arguments: &[&str], exit: i32| {
        run(kiln(folder.path()), &[arguments, &["--server", &server.url]].concat(), exit)
    };
    assert!(call(&["list"], 0).stderr().contains("kiln submit"));
    let submit = || run(kiln(folder.path()), &arguments("submit", &["--server", &server.url]), 0);
    let [kept, gone] = [submit(), submit()].map(|finished| finished.stdout().trim().to_owned());
    call(&["cancel", &gone[..6]], 0);
    let rows = |more: &[&str]| -> Vec<String> {
        let table = call(&[&["list"], more].concat(), 0).stdout();
        table.lines().skip(1).map(str::to_owned).collect()
    };
    let table = call(&["list"], 0).stdout();
    let (head, first) = (table.lines().next().unwrap(), table.lines().nth(1).unwrap());
    assert!(head.contains("SUBMITTED") && head.contains("ENDED"), "{table}");
    let ended = first.matches('Z').count();
    assert!(first.starts_with(&gone) && ended == 2, "submitted and ended, with the day: {table}");
    for (filter, wanted) in [
        (&["--state", "running"][..], &[&kept][..]),
        (&["--state", "cancelled,failed"], &[&gone]),
        (&["--name", "CORN", "--since", "1h"], &[&gone, &kept]),
        (&["--since", "2020-01-01", "--state", "running"], &[&kept]),
    ] {
        let found = rows(filter);
        assert_eq!(found.len(), wanted.len(), "{filter:?}: {found:?}");
        assert!(found.iter().zip(wanted).all(|(row, id)| row.starts_with(*id)), "{filter:?}: {found:?}");
    }
    for none in [&["--name", "atrium"][..], &["--since", "0s"], &["--state", "failed"]] {
        let told = call(&[&["list"], none].concat(), 0);
        assert!(told.stdout().is_empty() && told.stderr().contains("--since"), "{none:?}: {}", told.stderr());
    }
    assert!(call(&["list", "--state", "gone"], 2).stderr().contains("cancelled"));
    assert!(call(&["list", "--since", "soon"], 2).stderr().contains("12h"));

    let short = &kept[..4];
    assert!(call(&["show", short], 0).stdout().contains("submitted"));
    assert!(call(&["pause", short], 0).stderr().contains(&kept), "the whole id is told");
    assert_eq!(call(&["show", &kept, "--json"], 0).json()["state"], BakeState::Paused.name());
    for command in ["resume", "logs", "blocklist", "cancel"] {
        call(&[command, short], 0);
    }
    assert!(call(&["watch", short], 130).stderr().contains(&kept));
    assert!(call(&["show", &kept[..3]], 2).stderr().contains("4 characters"));
    call(&["delete", short], 0);
    assert!(call(&["show", short], 2).stderr().contains("no bake"));
}

#[test]
fn first_token_warns_of_workers_that_have_none_and_the_second_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("server");
    let server = Server::start(&state);
    let worker: Running = server.worker(folder.path(), "oven-1", 1);
    // Known to the farm once it has asked for work.
    let client = lightkiln_client::fetch::ApiClient::new(&server.url, None).unwrap();
    let deadline = std::time::Instant::now() + super::processes::LIMIT;
    while client.workers().unwrap().workers.is_empty() {
        assert!(std::time::Instant::now() < deadline, "no worker came");
    }
    let token = |state: &std::path::Path, arguments: &[&str]| {
        run(kiln(state), &[&["token"], arguments].concat(), 0).stderr()
    };
    let told = token(&state, &["enrol", "oven-2"]);
    assert!(told.contains("warning") && told.contains("oven-1") && told.contains("token enrol"), "{told}");
    assert!(!token(&state, &["create", "ci", "--scope", "submit"]).contains("warning"));
    drop(worker);
    // Where nobody works yet there is nobody to warn of.
    let fresh = token(&folder.path().join("fresh"), &["create", "ci", "--scope", "submit"]);
    assert!(!fresh.contains("warning"), "{fresh}");
}

/// `kiln list | head`: whoever reads has seen enough. The pipe has lost its reader before the program starts.
#[test]
fn results_that_nobody_reads_any_more_end_the_program_in_peace() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["settings"][..], &["settings", "--json"], &["settings", "--kind", "sh"]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let ended = kiln(folder.path()).args(arguments).stdout(writer).output().unwrap();
        assert!(ended.status.success(), "{arguments:?}: {ended:?}");
        assert!(ended.stderr.is_empty(), "{arguments:?}: {ended:?}");
    }
}
