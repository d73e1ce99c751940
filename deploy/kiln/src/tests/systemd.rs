//! The units: what systemd says of them, and what they may do.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::{names_in, root, text_of};

/// Settings of a unit's section, each with all its values.
fn section(text: &str, wanted: &str) -> BTreeMap<String, Vec<String>> {
    let mut current = "";
    let mut settings: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if let Some(name) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            current = name;
        } else {
            let (name, value) = line.split_once('=').unwrap_or_else(|| panic!("no setting: {line}"));
            if current == wanted {
                settings.entry(name.to_owned()).or_default().push(value.to_owned());
            }
        }
    }
    assert!(!settings.is_empty(), "no section [{wanted}]");
    settings
}

#[test]
fn units_run_as_nobody_special_and_may_write_their_own_folder_alone() {
    let names = names_in("deploy/systemd", ".service");
    assert_eq!(names, ["kiln-server.service", "kiln-worker.service"]);
    for name in names {
        let service = section(&text_of(&format!("deploy/systemd/{name}")), "Service");
        for (setting, wanted) in [
            ("User", "lightkiln"),
            ("Group", "lightkiln"),
            ("NoNewPrivileges", "yes"),
            ("CapabilityBoundingSet", ""),
            ("AmbientCapabilities", ""),
            ("ProtectSystem", "strict"),
            ("ProtectHome", "yes"),
            ("PrivateTmp", "yes"),
            ("PrivateDevices", "yes"),
            ("ProtectKernelModules", "yes"),
            ("ProtectKernelTunables", "yes"),
            ("ProtectControlGroups", "yes"),
            ("RestrictAddressFamilies", "AF_INET AF_INET6 AF_UNIX"),
            ("RestrictNamespaces", "yes"),
            ("RestrictSUIDSGID", "yes"),
            ("MemoryDenyWriteExecute", "yes"),
            ("SystemCallArchitectures", "native"),
            ("UMask", "0077"),
            ("Restart", "always"),
            ("KillSignal", "SIGTERM"),
        ] {
            assert_eq!(service.get(setting), Some(&vec![wanted.to_owned()]), "{name}: {setting}");
        }
        assert_eq!(service["SystemCallFilter"][0], "@system-service", "{name}");
        assert!(
            service.contains_key("MemoryMax") && service.contains_key("TasksMax"),
            "{name} has no limits"
        );
        let has = |folder: &str| service.contains_key(folder);
        assert!(has("StateDirectory"), "{name}");
        assert_eq!(has("CacheDirectory"), name.contains("worker"), "{name}");
        let state = format!("KILN_STATE=/var/lib/{}", service["StateDirectory"][0]);
        assert_eq!(service["Environment"], [state], "{name}: the state is in the folder that it may write");
        assert!(!service.contains_key("ReadWritePaths"), "{name}");
    }
}

#[test]
fn worker_sees_the_memory_of_its_machine() {
    let service = section(&text_of("deploy/systemd/kiln-worker.service"), "Service");
    let subset = service.get("ProcSubset").map(|values| values.concat());
    assert_ne!(subset.as_deref(), Some("pid"), "/proc/meminfo and the machine's start are hidden by it");
}

#[test]
fn worker_has_longer_to_stop_than_a_task_in_hand() {
    let service = section(&text_of("deploy/systemd/kiln-worker.service"), "Service");
    let stop_secs: u64 = service["TimeoutStopSec"][0].parse().unwrap();
    let grace = lightkiln_worker::runtime::WorkerConfig::new("http://farm", "w").drain_grace;
    assert!(stop_secs > grace.as_secs() + 10, "{stop_secs} s against {grace:?}");
    let service = section(&text_of("deploy/systemd/kiln-server.service"), "Service");
    let stop_secs: u64 = service["TimeoutStopSec"][0].parse().unwrap();
    let grace = lightkiln_server::Config::new("state").stop_grace;
    assert!(stop_secs > grace.as_secs() + 5, "{stop_secs} s against {grace:?}");
}

#[test]
fn user_of_the_units_is_made() {
    let users = text_of("deploy/systemd/lightkiln.sysusers");
    let user = users.lines().find(|line| !line.starts_with('#')).unwrap();
    assert!(user.starts_with("u lightkiln - "), "{user}");
}

/// A unit whose program is there, in a folder of its own.
fn unit(name: &str, text: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let unit = folder.path().join(name);
    let program = std::env::current_exe().unwrap();
    std::fs::write(&unit, text.replace("/usr/local/bin/kiln", &program.display().to_string())).unwrap();
    (folder, unit)
}

/// As systemd looks for them.
#[test]
#[ignore = "needs systemd-analyze, which tests/run installs"]
fn systemd_finds_nothing_wrong_with_the_units() {
    let verify = |text: &str, name: &str| {
        let (_folder, unit) = unit(name, text);
        let output =
            Command::new("systemd-analyze").args(["verify", "--man=no"]).arg(&unit).output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        // Of this machine's own units, not of ours.
        told.lines().filter(|line| line.contains("kiln")).map(str::to_owned).collect::<Vec<_>>()
    };
    for name in names_in("deploy/systemd", ".service") {
        let text = text_of(&format!("deploy/systemd/{name}"));
        assert_eq!(verify(&text, &name), [""; 0], "{name}");
        let wrong = text.replace("ProtectHome=", "ProtectHomes=");
        assert!(!verify(&wrong, &name).is_empty(), "systemd-analyze says nothing of a wrong setting");
    }
}

/// Exposure runs from 0, of a service that may do nothing, to 10.
#[test]
#[ignore = "needs systemd-analyze, which tests/run installs"]
fn systemd_says_that_the_units_expose_little() {
    let is_little = |text: &str, name: &str| {
        let (_folder, unit) = unit(name, text);
        let mut analyze = Command::new("systemd-analyze");
        // In tenths.
        analyze.args(["security", "--offline=true", "--no-pager", "--threshold=18"]).arg(&unit);
        analyze.output().unwrap().status.success()
    };
    for name in names_in("deploy/systemd", ".service") {
        let text = text_of(&format!("deploy/systemd/{name}"));
        assert!(is_little(&text, &name), "{name}: see systemd-analyze security");
        let open = text.replace("RestrictNamespaces=yes", "");
        assert!(!is_little(&open, &name), "a right more is told");
    }
}

#[test]
#[ignore = "needs systemd-sysusers, which tests/run installs"]
fn systemd_makes_the_user() {
    let root_folder = tempfile::tempdir().unwrap();
    let sysusers = |file: &Path| {
        let mut sysusers = Command::new("systemd-sysusers");
        sysusers.arg("--dry-run").arg(format!("--root={}", root_folder.path().display())).arg(file);
        sysusers.output().unwrap()
    };
    let users = root().canonicalize().unwrap().join("deploy/systemd/lightkiln.sysusers");
    let made = sysusers(&users);
    let told = String::from_utf8_lossy(&made.stderr).into_owned();
    assert!(made.status.success() && told.contains("Creating user 'lightkiln'"), "{told}");
    let wrong = root_folder.path().join("wrong.conf");
    std::fs::write(
        &wrong,
        text_of("deploy/systemd/lightkiln.sysusers").replace("u lightkiln", "user lightkiln"),
    )
    .unwrap();
    assert!(!sysusers(&wrong).status.success(), "systemd-sysusers takes a line that is none");
}
