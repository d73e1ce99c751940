//! Arrows between crates, from what cargo itself says.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

use super::root;

/// Normal dependencies (neither of tests nor of build scripts) of every package that is built for this machine.
struct Graph {
    names: BTreeMap<String, String>,
    arrows: BTreeMap<String, Vec<String>>,
}

impl Graph {
    fn read() -> Self {
        let output = Command::new(env!("CARGO"))
            .args(["metadata", "--format-version", "1", "--locked", "--filter-platform", &host()])
            .current_dir(root())
            .output()
            .expect("cargo runs");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON");
        let id_of = |package: &Value| package["id"].as_str().expect("every package has an id").to_owned();
        let name_of =
            |package: &Value| package["name"].as_str().expect("every package has a name").to_owned();
        let names =
            list(&metadata["packages"]).iter().map(|package| (id_of(package), name_of(package))).collect();
        let normal =
            |dependency: &&Value| list(&dependency["dep_kinds"]).iter().any(|kind| kind["kind"].is_null());
        let target =
            |dependency: &Value| dependency["pkg"].as_str().expect("a dependency has an id").to_owned();
        let arrows = list(&metadata["resolve"]["nodes"])
            .iter()
            .map(|node| (id_of(node), list(&node["deps"]).iter().filter(normal).map(target).collect()))
            .collect();
        Self { names, arrows }
    }

    fn id(&self, name: &str) -> &String {
        let found = self.names.iter().find(|(_, found)| *found == name);
        found.unwrap_or_else(|| panic!("there is no package {name}")).0
    }

    /// Names of the packages that `name` names itself.
    fn direct(&self, name: &str) -> BTreeSet<&str> {
        self.arrows[self.id(name)].iter().map(|id| self.names[id].as_str()).collect()
    }

    /// Names of all packages that are linked with `name`.
    fn all(&self, name: &str) -> BTreeSet<&str> {
        let mut seen = BTreeSet::new();
        let mut next = vec![self.id(name)];
        while let Some(id) = next.pop() {
            if seen.insert(id) {
                next.extend(&self.arrows[id]);
            }
        }
        assert!(seen.len() > 5, "{name} has next to no dependencies: the walk is broken");
        seen.into_iter().map(|id| self.names[id].as_str()).collect()
    }
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().expect("cargo metadata has lists where it says so")
}

fn host() -> String {
    let output = Command::new("rustc").arg("-vV").output().expect("rustc runs");
    let text = String::from_utf8(output.stdout).expect("rustc writes UTF-8");
    let host = text.lines().find_map(|line| line.strip_prefix("host: "));
    host.expect("rustc names its host").to_owned()
}

#[test]
fn arrows_between_crates_point_to_the_contract_alone() {
    let graph = Graph::read();
    let house = |name: &str| -> Vec<&str> {
        graph.direct(name).into_iter().filter(|name| name.starts_with("lightkiln-")).collect()
    };
    assert_eq!(house("lightkiln-proto"), [""; 0]);
    let contract = ["lightkiln-http", "lightkiln-proto"];
    assert_eq!(house("lightkiln-http"), contract[1..]);
    assert_eq!(house("lightkiln-server"), contract[1..], "a server calls no server");
    for role in ["lightkiln-worker", "lightkiln-client"] {
        assert_eq!(house(role), contract, "{role} may know no other role");
    }
    let all =
        ["lightkiln-client", "lightkiln-http", "lightkiln-proto", "lightkiln-server", "lightkiln-worker"];
    assert_eq!(house("kiln"), all, "the binary alone sees all");
}

#[test]
fn contract_links_nothing_that_does_input_or_output() {
    let graph = Graph::read();
    let linked = graph.all("lightkiln-proto");
    let io = ["tokio", "mio", "socket2", "hyper", "axum", "ureq", "sqlx", "object_store", "wgpu", "rayon"];
    for name in io {
        assert!(!linked.contains(name), "lightkiln-proto links {name}");
    }
}

#[test]
fn server_knows_jobs_and_bytes_but_not_light() {
    let graph = Graph::read();
    let linked = graph.all("lightkiln-server");
    let light = ["wgpu", "obvhs", "gltf", "faer", "image", "rayon", "lightkiln-worker", "lightkiln-client"];
    for name in light {
        assert!(!linked.contains(name), "lightkiln-server links {name}");
    }
    assert!(graph.all("kiln").contains("obvhs"), "the walk finds no obvhs anywhere: it is broken");
}

#[test]
fn roles_without_async_link_no_runtime() {
    let graph = Graph::read();
    for role in ["lightkiln-worker", "lightkiln-client"] {
        assert!(!graph.all(role).contains("tokio"), "{role} links tokio");
    }
}
