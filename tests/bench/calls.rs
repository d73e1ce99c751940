//! Calls of people and workers, each over a connection that is kept.

use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
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

    /// The text at a path.
    pub fn get(&self, path: &str) -> String {
        self.agent.get(format!("{}{path}", self.url)).call().unwrap().body_mut().read_to_string().unwrap()
    }

    /// Whether bytes are stored as a chunk or a scene.
    pub fn has(&self, kind: &str, bytes: &[u8]) -> bool {
        match self.agent.head(format!("{}/v1/{kind}/{}", self.url, Digest::of(bytes))).call() {
            Ok(_) => true,
            Err(ureq::Error::StatusCode(404)) => false,
            Err(error) => panic!("{error}"),
        }
    }

    /// Stores bytes as a chunk or a scene.
    pub fn put(&self, kind: &str, bytes: &[u8]) -> Digest {
        let digest = Digest::of(bytes);
        self.agent.put(format!("{}/v1/{kind}/{digest}", self.url)).send(bytes).unwrap();
        digest
    }

    /// A new bake of a scene; other settings are other tasks.
    pub fn submit(&self, scene: Digest, rank_max: usize) -> String {
        self.submit_to(scene, rank_max, &[])
    }

    fn submit_to(&self, scene: Digest, rank_max: usize, labels: &[&str]) -> String {
        let settings = json!({ "rank_max": 1 + rank_max % 64, "transport_rays": 16 + rank_max / 64 });
        let needs = json!({ "labels": labels });
        let bake = json!({ "name": "load", "scene": scene, "settings": settings, "needs": needs });
        self.post("/v1/bakes", &bake)["id"].as_str().unwrap().to_owned()
    }

    /// The token of a task of these kinds, if one is ready.
    pub fn claim(&self, worker: &str, kinds: &[&str]) -> Option<String> {
        self.claim_with(worker, kinds, &[])
    }

    fn claim_with(&self, worker: &str, kinds: &[&str], labels: &[&str]) -> Option<String> {
        let claim = json!({
            "worker": worker, "kinds": kinds, "threads": 1, "labels": labels, "max": 1, "ttl_secs": 3600, "wait_secs": 0,
        });
        let answer = self.post("/v1/leases", &claim);
        Some(answer["leases"].get(0)?["token"].as_str().unwrap().to_owned())
    }

    /// The tokens of so many tasks of a kind, from one call.
    pub fn claim_many(&self, worker: &str, kind: &str, count: usize) -> Vec<String> {
        let claim = json!({
            "worker": worker, "kinds": [kind], "threads": 1, "max": count, "ttl_secs": 3600, "wait_secs": 0,
        });
        let answer = self.post("/v1/leases", &claim);
        let leases = answer["leases"].as_array().unwrap();
        assert_eq!(leases.len(), count, "too few tasks are ready");
        leases.iter().map(|lease| lease["token"].as_str().unwrap().to_owned()).collect()
    }

    /// Hands in results, each with one output that is stored, by the call that a worker would make.
    pub fn commit_stored(&self, results: &[(&str, &[u8])]) {
        let result = |bytes: &[u8]| {
            let output = json!({ "name": "out", "digest": Digest::of(bytes), "bytes": bytes.len() });
            json!({ "outputs": [output], "plan": [], "counters": { "secs": 1.0 } })
        };
        if let [(token, bytes)] = results {
            let answer = self.post(&format!("/v1/leases/{token}/commit"), &result(bytes));
            assert_eq!(answer["verdict"], "committed");
            return;
        }
        let commit = |(token, bytes): &(&str, &[u8])| json!({ "token": token, "result": result(bytes) });
        let commits: Vec<Value> = results.iter().map(commit).collect();
        let answer = self.post("/v1/leases/commit", &json!({ "commits": commits }));
        for outcome in answer["answers"].as_array().unwrap() {
            assert_eq!(outcome["verdict"], "committed");
        }
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
        self.fill_for(&[], "bench.work", b"a scene that is never read", tasks);
    }

    /// A bake for workers with these labels that has so many tasks ready of a kind.
    pub fn fill_for(&self, labels: &[&str], kind: &str, scene: &[u8], tasks: usize) {
        let task = |index: usize| {
            let (label, params) = (format!("task {index}"), json!({ "index": index }));
            TaskSpec::new(kind, 1, label, params, Vec::new(), 1 + index as u64 % 97)
        };
        self.fill_with(labels, scene, 0, &(0..tasks).map(task).collect::<Vec<_>>());
    }

    /// A bake for workers with these labels that has these tasks ready; its id. Other settings are another bake of the same scene.
    pub fn fill_with(&self, labels: &[&str], scene: &[u8], settings: usize, tasks: &[TaskSpec]) -> String {
        let scene = self.put("scenes", scene);
        let bake = self.submit_to(scene, settings, labels);
        let before = ["import", "unwrap", "frame", "draw", "place", "patches"];
        for name in before.map(|name| format!("scene.{name}")) {
            let task = self.claim_with("planner", &[&name], labels).unwrap();
            self.commit(&task, name.as_bytes(), json!([]));
        }
        let plan = self.claim_with("planner", &["prt.plan"], labels).unwrap();
        self.commit(&plan, b"planned", json!(tasks));
        bake
    }
}
