//! The manifests: rights, limits, probes, and what they name of each other.

use std::collections::BTreeSet;
use std::process::Command;

use lightkiln_worker::kinds::Runner;
use lightkiln_worker::task::TaskRunner as _;
use serde_json::Value;

use super::{documents, names_in, root, texts};
use crate::kinds::KindTables;

/// Every object of the folder, with its file.
fn objects() -> Vec<(String, Value)> {
    let names = names_in("deploy/kubernetes", ".yaml");
    let of_file = |name: String| {
        let documents = documents(&format!("deploy/kubernetes/{name}"));
        documents.into_iter().map(move |document| (name.clone(), document))
    };
    let objects: Vec<_> = names.into_iter().flat_map(of_file).collect();
    assert!(objects.len() >= 9);
    for (file, object) in &objects {
        assert!(object["apiVersion"].is_string() && object["kind"].is_string(), "{file}: {object}");
    }
    objects
}

fn object(kind: &str, name: &str) -> Value {
    let found = objects().into_iter().find(|(_, object)| {
        object["kind"] == kind && (object["metadata"]["name"] == name || name.is_empty())
    });
    found.unwrap_or_else(|| panic!("there is no {kind} {name}")).1
}

#[test]
fn pods_run_as_nobody_special_within_limits() {
    let mut checked = 0;
    for (file, object) in objects() {
        let pod = &object["spec"]["template"]["spec"];
        if pod.is_null() {
            continue;
        }
        checked += 1;
        assert_eq!(pod["automountServiceAccountToken"], false, "{file}");
        assert_eq!(pod["securityContext"]["runAsNonRoot"], true, "{file}");
        assert_eq!(pod["securityContext"]["runAsUser"], 10001, "{file}: the image's user");
        assert_eq!(pod["securityContext"]["seccompProfile"]["type"], "RuntimeDefault", "{file}");
        for container in pod["containers"].as_array().unwrap() {
            let rights = &container["securityContext"];
            assert_eq!(rights["allowPrivilegeEscalation"], false, "{file}");
            assert_eq!(rights["readOnlyRootFilesystem"], true, "{file}");
            assert_eq!(texts(&rights["capabilities"]["drop"]), ["ALL"], "{file}");
            assert!(container["resources"]["limits"]["memory"].is_string(), "{file} has no limits");
            let image = container["image"].as_str().unwrap();
            assert!(image == "lightkiln" || super::is_pinned(image), "{file}: {image}");
        }
    }
    assert_eq!(checked, 3, "server, worker, and the job that makes tokens");
}

#[test]
fn servers_are_two_probed_and_reached_by_a_name_that_workers_use() {
    let server = object("Deployment", "server");
    assert!(server["spec"]["replicas"].as_u64().unwrap() >= 2);
    let container = &server["spec"]["template"]["spec"]["containers"][0];
    assert_eq!(container["readinessProbe"]["httpGet"]["path"], "/readyz");
    assert_eq!(container["livenessProbe"]["httpGet"]["path"], "/healthz");
    let port = &container["ports"][0];
    let service = object("Service", "server");
    assert_eq!(service["spec"]["ports"][0]["targetPort"], port["name"]);
    assert_eq!(service["spec"]["selector"], server["spec"]["selector"]["matchLabels"]);
    assert_eq!(object("PodDisruptionBudget", "server")["spec"]["minAvailable"], 1);
    let worker = object("Deployment", "worker");
    let arguments = worker["spec"]["template"]["spec"]["containers"][0]["args"].clone();
    let url = format!("http://server:{}", service["spec"]["ports"][0]["port"]);
    assert!(texts(&arguments).contains(&url.as_str()), "{arguments}");
    assert!(texts(&arguments).contains(&"$(POD_NAME)"), "a worker's name is its pod's: {arguments}");
}

#[test]
fn selectors_find_their_own_pods() {
    for name in ["server", "worker"] {
        let deployment = object("Deployment", name);
        let labels = &deployment["spec"]["template"]["metadata"]["labels"];
        assert_eq!(&deployment["spec"]["selector"]["matchLabels"], labels);
        assert_eq!(labels["app.kubernetes.io/component"], name);
    }
    let monitor = object("PodMonitor", "server");
    let labels = object("Deployment", "server")["spec"]["selector"]["matchLabels"].clone();
    assert_eq!(monitor["spec"]["selector"]["matchLabels"], labels);
    assert_eq!(monitor["spec"]["podMetricsEndpoints"][0]["path"], "/metrics");
}

#[test]
fn workers_are_scaled_by_what_is_ready_and_what_is_under_way() {
    let scaled = object("ScaledObject", "worker");
    assert_eq!(scaled["spec"]["scaleTargetRef"]["name"], "worker");
    assert_eq!(
        (&scaled["spec"]["minReplicaCount"], &scaled["spec"]["maxReplicaCount"]),
        (&0.into(), &50.into())
    );
    assert!(object("Deployment", "worker")["spec"]["replicas"].is_null(), "KEDA says how many there are");
    let trigger = &scaled["spec"]["triggers"][0];
    assert_eq!(trigger["type"], "prometheus");
    let query = trigger["metadata"]["query"].as_str().unwrap();
    assert!(query.contains("lightkiln_ready_tasks") && query.contains("state=\"leased\""), "{query}");
    assert!(query.contains("labels=\"\""), "bakes for other pools start none of these: {query}");
    assert!(query.contains("max by (kind, state)"), "servers tell of the whole farm, each: {query}");
    assert!(trigger["metadata"]["threshold"].as_str().unwrap().parse::<f64>().unwrap() > 0.0);
}

#[test]
fn scaling_counts_tasks_that_the_pools_own_workers_can_take() {
    let worker = object("Deployment", "worker");
    let container = &worker["spec"]["template"]["spec"]["containers"][0];
    let arguments = texts(&container["args"]);
    let at = arguments.iter().position(|argument| *argument == "--threads").unwrap();
    let threads: u32 = arguments[at + 1].parse().unwrap();
    let memory_gib: u32 = container["resources"]["limits"]["memory"]
        .as_str()
        .unwrap()
        .strip_suffix("Gi")
        .unwrap()
        .parse()
        .unwrap();
    let query = object("ScaledObject", "worker")["spec"]["triggers"][0]["metadata"]["query"].clone();
    let query = query.as_str().unwrap();
    assert!(query.contains(&format!("threads=~\"[0-{threads}]\"")), "{query}");
    // The matcher ends at 7999 MiB.
    assert!(
        query.contains("memory_mib=~\"[0-9]{1,3}|[1-7][0-9]{3}\"") && memory_gib * 1024 >= 7999,
        "{query}"
    );
    assert!(!arguments.contains(&"--label"), "a worker with a label could take more than is counted");
}

#[test]
fn scaling_counts_the_kinds_of_tasks_that_workers_know() {
    let query = object("ScaledObject", "worker")["spec"]["triggers"][0]["metadata"]["query"].clone();
    let matchers: Vec<&str> = query.as_str().unwrap().split("kind=~\"(").skip(1).collect();
    assert_eq!(matchers.len(), 2, "ready tasks, and those under way: {query}");
    let known = Runner::new(&KindTables::new().worker).kinds();
    let known: BTreeSet<&str> = known.iter().map(|kind| kind.split_once('.').unwrap().0).collect();
    for matcher in matchers {
        let families = matcher.split_once(")[.].+\"").unwrap().0;
        assert_eq!(families.split('|').collect::<BTreeSet<_>>(), known, "{query}");
    }
}

#[test]
fn policies_let_workers_speak_with_servers_alone_and_the_ingress_has_tls() {
    for name in ["server", "worker"] {
        let policy = object("NetworkPolicy", name);
        let labels = &object("Deployment", name)["spec"]["selector"]["matchLabels"];
        assert_eq!(&policy["spec"]["podSelector"]["matchLabels"], labels, "{name}");
    }
    let worker = object("NetworkPolicy", "worker");
    assert_eq!(texts(&worker["spec"]["policyTypes"]), ["Ingress", "Egress"]);
    assert_eq!(worker["spec"]["ingress"], Value::Array(Vec::new()), "nobody calls a worker");
    let to = &worker["spec"]["egress"][0];
    let servers = &object("Deployment", "server")["spec"]["selector"]["matchLabels"];
    assert_eq!(&to["to"][0]["podSelector"]["matchLabels"], servers);
    let port =
        &object("Deployment", "server")["spec"]["template"]["spec"]["containers"][0]["ports"][0]["name"];
    assert_eq!(&to["ports"][0]["port"], port);
    let server = object("NetworkPolicy", "server");
    let workers = &object("Deployment", "worker")["spec"]["selector"]["matchLabels"];
    assert_eq!(&server["spec"]["ingress"][0]["from"][0]["podSelector"]["matchLabels"], workers);
    let ingress = object("Ingress", "server");
    let backend = &ingress["spec"]["rules"][0]["http"]["paths"][0]["backend"]["service"];
    assert_eq!(backend["name"], object("Service", "server")["metadata"]["name"]);
    assert_eq!(backend["port"]["name"], object("Service", "server")["spec"]["ports"][0]["name"]);
    assert_eq!(ingress["spec"]["tls"][0]["hosts"][0], ingress["spec"]["rules"][0]["host"]);
}

#[test]
fn worker_has_longer_to_stop_than_a_task_in_hand_and_room_for_its_cache() {
    let worker = object("Deployment", "worker");
    let pod = &worker["spec"]["template"]["spec"];
    let grace = lightkiln_worker::runtime::WorkerConfig::new("http://farm", "w").drain_grace;
    assert!(pod["terminationGracePeriodSeconds"].as_u64().unwrap() > grace.as_secs() + 10);
    let arguments = texts(&pod["containers"][0]["args"]);
    let at = arguments.iter().position(|argument| *argument == "--cache-gib").unwrap();
    let cache_gib: u64 = arguments[at + 1].parse().unwrap();
    let room = pod["volumes"][0]["emptyDir"]["sizeLimit"].as_str().unwrap();
    let room_gib: u64 = room.strip_suffix("Gi").unwrap().parse().unwrap();
    assert!(cache_gib < room_gib, "a full cache would evict the pod: {cache_gib} GiB in {room}");
}

#[test]
fn kustomization_names_files_that_there_are() {
    let kustomization = object("Kustomization", "");
    let resources = texts(&kustomization["resources"]);
    assert!(resources.len() >= 4 && !resources.contains(&"token-job.yaml"), "{resources:?}");
    assert!(!resources.contains(&"ingress.yaml"), "it needs a host's name first: {resources:?}");
    for resource in resources {
        assert!(root().join("deploy/kubernetes").join(resource).is_file(), "{resource}");
    }
    assert_eq!(object("Namespace", "lightkiln")["metadata"]["name"], kustomization["namespace"]);
    assert_eq!(kustomization["images"][0]["name"], "lightkiln");
    assert_eq!(kustomization["images"][0]["newTag"], env!("CARGO_PKG_VERSION"));
}

#[test]
#[ignore = "needs kubectl, which tests/run installs"]
fn kustomize_builds_the_manifests() {
    let folder = root().join("deploy/kubernetes");
    let output = Command::new("kubectl").arg("kustomize").arg(folder).output().expect("kubectl is installed");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let built: Vec<Value> = serde_saphyr::from_multiple(&text).unwrap();
    assert_eq!(built.len(), 9, "{text}");
    for object in built {
        let is_namespace = object["kind"] == "Namespace";
        assert!(is_namespace || object["metadata"]["namespace"] == "lightkiln", "{object}");
        let image = &object["spec"]["template"]["spec"]["containers"][0]["image"];
        assert!(image.is_null() || image.as_str().is_some_and(super::is_pinned), "{image}");
    }
}
