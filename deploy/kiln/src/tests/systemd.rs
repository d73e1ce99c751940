//! The units: what systemd says of them, and what they may do.

use std::collections::BTreeMap;
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

/// With units whose program is there, as systemd looks for it.
#[test]
#[ignore = "needs systemd-analyze, which tests/run installs"]
fn systemd_finds_nothing_wrong_with_the_units() {
    let verify = |text: &str, name: &str| {
        let folder = tempfile::tempdir().unwrap();
        let unit = folder.path().join(name);
        let program = std::env::current_exe().unwrap();
        let text = text.replace("/usr/local/bin/kiln", &program.display().to_string());
        std::fs::write(&unit, text).unwrap();
        let output =
            Command::new("systemd-analyze").args(["verify", "--man=no"]).arg(&unit).output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        // Of this machine's own units, not of ours.
        told.lines().filter(|line| line.contains("kiln")).map(str::to_owned).collect::<Vec<_>>()
    };
    for name in names_in("deploy/systemd", ".service") {
        let text = std::fs::read_to_string(root().join("deploy/systemd").join(&name)).unwrap();
        assert_eq!(verify(&text, &name), [""; 0], "{name}");
        let wrong = text.replace("ProtectHome=", "ProtectHomes=");
        assert!(!verify(&wrong, &name).is_empty(), "systemd-analyze says nothing of a wrong setting");
    }
}
