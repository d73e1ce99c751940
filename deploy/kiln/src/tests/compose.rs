//! The compose file: who runs, from which image, with what rights.

use serde_json::Value;

use super::{documents, is_pinned, texts};

fn compose() -> Value {
    documents("deploy/compose.yaml").remove(0)
}

#[test]
fn farm_has_a_server_two_workers_a_database_and_a_store() {
    let compose = compose();
    let services = compose["services"].as_object().unwrap();
    let names: Vec<&str> = services.keys().map(String::as_str).collect();
    for name in ["server", "worker", "postgres", "s3"] {
        assert!(names.contains(&name), "{names:?}");
    }
    assert_eq!(services["worker"]["deploy"]["replicas"], 2);
    let worker = texts(&services["worker"]["command"]);
    assert!(worker.contains(&"http://server:7410"), "{worker:?}");
    let server = texts(&services["server"]["command"]);
    assert!(server.contains(&"0.0.0.0:7410") && server.contains(&"s3://lightkiln/chunks"), "{server:?}");
    let environment = &services["server"]["environment"];
    assert!(environment["KILN_DATABASE"].as_str().unwrap().contains("@postgres:5432/lightkiln"));
    assert_eq!(environment["AWS_ENDPOINT_URL"], "http://s3:7070");
    assert_eq!(services["s3"]["environment"]["VGW_PORT"], ":7070");
    assert_eq!(services["postgres"]["environment"]["POSTGRES_DB"], "lightkiln");
    assert_eq!(environment["AWS_ACCESS_KEY_ID"], services["s3"]["environment"]["ROOT_ACCESS_KEY"]);
    assert_eq!(environment["AWS_SECRET_ACCESS_KEY"], services["s3"]["environment"]["ROOT_SECRET_KEY"]);
}

#[test]
fn services_are_pinned_limited_and_without_rights_that_they_do_not_need() {
    let compose = compose();
    for (name, service) in compose["services"].as_object().unwrap() {
        let image = service["image"].as_str().unwrap();
        assert!(is_pinned(image) || image == "lightkiln:local", "{name}: {image}");
        let limits = &service["deploy"]["resources"]["limits"];
        assert!(limits["memory"].is_string() && limits["cpus"].is_string(), "{name} has no limits");
        assert!(service["privileged"].is_null() && service["network_mode"].is_null(), "{name}");
        let ours = image == "lightkiln:local";
        if ours || name == "s3" {
            assert_eq!(texts(&service["cap_drop"]), ["ALL"], "{name}");
            assert_eq!(texts(&service["security_opt"]), ["no-new-privileges:true"], "{name}");
        }
        if ours {
            assert_eq!(service["read_only"], true, "{name}");
            assert_eq!(service["build"]["dockerfile"], "deploy/Dockerfile", "{name}");
        }
    }
}

#[test]
fn only_the_server_is_published_and_on_this_machine_unless_told_otherwise() {
    let compose = compose();
    let services = compose["services"].as_object().unwrap();
    let published: Vec<_> = services.iter().filter(|(_, service)| !service["ports"].is_null()).collect();
    assert_eq!(published.len(), 1, "{published:?}");
    assert_eq!(published[0].0, "server");
    assert_eq!(texts(&published[0].1["ports"]), ["${KILN_PUBLISH:-127.0.0.1:7410}:7410"]);
}

#[test]
fn secrets_come_from_outside() {
    let compose = compose();
    let mut found = 0;
    for (name, service) in compose["services"].as_object().unwrap() {
        for (variable, value) in service["environment"].as_object().into_iter().flatten() {
            if ["PASSWORD", "SECRET", "TOKEN", "DATABASE"].iter().any(|word| variable.contains(word)) {
                found += 1;
                assert!(value.as_str().unwrap().contains("${"), "{name} has {variable} written down");
            }
        }
    }
    assert_eq!(found, 5);
}

#[test]
fn volumes_and_services_that_are_named_are_there() {
    let compose = compose();
    let services = compose["services"].as_object().unwrap();
    let mut volumes = 0;
    for (name, service) in services {
        for volume in service["volumes"].as_array().into_iter().flatten() {
            if let Some((volume, _)) = volume.as_str().unwrap().split_once(':') {
                volumes += 1;
                assert!(compose["volumes"].get(volume).is_some(), "{name}: {volume}");
            }
        }
        for (needed, how) in service["depends_on"].as_object().into_iter().flatten() {
            let needed_service = services.get(needed).unwrap_or_else(|| panic!("{name} needs {needed}"));
            let waits_for_health = how["condition"] == "service_healthy";
            assert!(
                !waits_for_health || needed_service["healthcheck"]["test"].is_array(),
                "{name} → {needed}"
            );
        }
    }
    assert!(volumes >= 3);
}
