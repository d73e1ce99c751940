//! Calls of people and workers, each over a connection that is kept.

use lightkiln_proto::ids::Digest;
use serde_json::{Value, json};

/// A caller.
pub struct Caller {
    agent: ureq::Agent,
    url: String,
}

impl Caller {
    pub fn new(url: &str) -> Self {
        let agent = ureq::Agent::config_builder().proxy(None).build().into();
        Self { agent, url: url.to_owned() }
    }

    pub fn post(&self, path: &str, body: &Value) -> Value {
        let mut answer = self.agent.post(format!("{}{path}", self.url)).send_json(body).unwrap();
        answer.body_mut().with_config().limit(64 << 20).read_json().unwrap()
    }

    /// Stores bytes as a chunk or a scene.
    pub fn put(&self, kind: &str, bytes: &[u8]) -> Digest {
        let digest = Digest::of(bytes);
        self.agent.put(format!("{}/v1/{kind}/{digest}", self.url)).send(bytes).unwrap();
        digest
    }

    /// A new bake of a scene; other settings are other tasks.
    pub fn submit(&self, scene: Digest, rank_max: usize) -> String {
        let settings = json!({ "rank_max": 1 + rank_max % 64, "transport_rays": 16 + rank_max / 64 });
        let bake = self.post("/v1/bakes", &json!({ "name": "load", "scene": scene, "settings": settings }));
        bake["id"].as_str().unwrap().to_owned()
    }

    /// The token of a task of these kinds, if one is ready.
    pub fn claim(&self, worker: &str, kinds: &[&str]) -> Option<String> {
        let claim = json!({
            "worker": worker, "kinds": kinds, "threads": 1, "max": 1, "ttl_secs": 3600, "wait_secs": 0,
        });
        let answer = self.post("/v1/leases", &claim);
        Some(answer["leases"].get(0)?["token"].as_str().unwrap().to_owned())
    }

    /// Hands in a result with one output of those bytes, and more tasks.
    pub fn commit(&self, token: &str, output: &[u8], plan: Value) {
        let digest = self.put("chunks", output);
        let outputs = json!([{ "name": "out", "digest": digest, "bytes": output.len() }]);
        let answer = self.post(
            &format!("/v1/leases/{token}/commit"),
            &json!({ "outputs": outputs, "plan": plan, "counters": { "secs": 1.0 } }),
        );
        assert_eq!(answer["verdict"], "committed");
    }

    /// A bake that has so many tasks ready, of the kind `bench.work`.
    pub fn fill(&self, tasks: usize) {
        let scene = self.put("scenes", b"a scene that is never read");
        self.submit(scene, 0);
        let before = ["import", "unwrap", "frame", "draw", "place", "patches"];
        for name in before.map(|name| format!("scene.{name}")) {
            let task = self.claim("planner", &[&name]).unwrap();
            self.commit(&task, name.as_bytes(), json!([]));
        }
        let plan = self.claim("planner", &["prt.plan"]).unwrap();
        let task = |index: usize| {
            let key = Digest::of(&index.to_le_bytes());
            json!({ "key": key, "kind": "bench.work", "label": format!("task {index}"), "params": { "index": index },
                "inputs": [], "cost": 1 + index % 97 })
        };
        self.commit(&plan, b"planned", (0..tasks).map(task).collect());
    }
}
