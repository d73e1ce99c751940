//! Memory that the files of `deploy/` give a server, beside what it may come to need.

use lightkiln_server::HEAVY_BYTES;
use serde_json::Value;

use super::{documents, text_of};

/// Bytes that a server may take for a byte of a plan while it works on it: the text, the parsed plan and a copy of it.
const PER_BYTE_OF_PLAN: u64 = 28;
/// Bytes for all else.
const REST: u64 = 256 << 20;

/// Bytes from a number with a unit as compose, Kubernetes and systemd write it.
fn bytes(text: &str) -> u64 {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match text[digits.len()..].to_ascii_lowercase().trim_end_matches('i') {
        "m" => 20,
        "g" => 30,
        unit => panic!("{text} has the unit {unit}"),
    };
    digits.parse::<u64>().unwrap() << shift
}

#[test]
fn servers_have_the_memory_that_the_largest_plans_take() {
    let compose = &documents("deploy/compose.yaml")[0];
    let of_compose = &compose["services"]["server"]["deploy"]["resources"]["limits"]["memory"];
    let is_server =
        |object: &&Value| object["kind"] == "Deployment" && object["metadata"]["name"] == "server";
    let manifests = documents("deploy/kubernetes/server.yaml");
    let deployment = manifests.iter().find(is_server).expect("a deployment of the server");
    let container = &deployment["spec"]["template"]["spec"]["containers"][0];
    let unit = text_of("deploy/systemd/kiln-server.service");
    let of_unit = unit.lines().find_map(|line| line.strip_prefix("MemoryMax=")).unwrap();
    for (place, limit) in [
        ("compose.yaml", of_compose.as_str().unwrap()),
        ("kubernetes", container["resources"]["limits"]["memory"].as_str().unwrap()),
        ("systemd", of_unit),
    ] {
        let needed = PER_BYTE_OF_PLAN * HEAVY_BYTES + REST;
        assert!(bytes(limit) >= needed, "{place} gives {limit}, a server may take {needed} bytes");
    }
}
