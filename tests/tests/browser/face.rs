//! The farm's face: a server with its pages, and a reader with and without a token.

use std::time::{Duration, Instant};

use lightkiln_proto::api::NewBake;
use lightkiln_proto::ids::Digest;
use lightkiln_server::access::{NewBearer, Scope};
use lightkiln_server::store::FarmStore;
use lightkiln_server::{Config, Server, open_store};
use serde_json::json;
use tokio::runtime::Runtime;

use super::driver::Browser;

/// Longest that a page may take to show something.
const LIMIT: Duration = Duration::from_secs(300);
/// A name that must be shown as it is.
const NAME: &str = "<img src=x onerror=\"document.title='taken'\"> & \"friends\"";

/// A farm with a reader's token, served until the process ends.
struct Farm {
    url: String,
    token: String,
    _runtime: Runtime,
    _folder: tempfile::TempDir,
}

impl Farm {
    fn start() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let runtime = Runtime::new().expect("threads");
        let (url, token) = runtime.block_on(async {
            let store = open_store(folder.path(), None).await.expect("a store");
            let bearer = NewBearer::named("anna").expect("a name");
            let scopes = [Scope::Submit].into();
            store.add_bearer(&bearer.name, bearer.hash(), &scopes).await.expect("a token");
            store.close().await;
            let config = Config { pages: kiln::pages::pages(), ..Config::new(folder.path()) };
            let server = Server::open(config).await.expect("a server");
            let listener = server.bind("127.0.0.1:0").await.expect("a port");
            let url = format!("http://{}", listener.local_addr().expect("an address"));
            tokio::spawn(server.serve(listener, std::future::pending()));
            (url, bearer.token)
        });
        Self { url, token, _runtime: runtime, _folder: folder }
    }

    /// Submits a bake of a scene that no worker will take; gives its id.
    fn submit(&self) -> String {
        let agent: ureq::Agent = ureq::Agent::config_builder().proxy(None).build().into();
        let authorization = format!("Bearer {}", self.token);
        let scene = b"no scene at all";
        let digest = Digest::of(scene);
        let stored =
            agent.put(format!("{}/v1/scenes/{digest}", self.url)).header("authorization", &authorization);
        stored.send(&scene[..]).expect("the scene is stored");
        let bake = NewBake {
            name: NAME.to_owned(),
            scene: digest,
            kind: String::new(),
            settings: serde_json::Value::Null,
            priority: 0,
            needs: Default::default(),
            attempt_limit_secs: None,
            limits: Default::default(),
            verify_share: 0.0,
        };
        let submitted = agent.post(format!("{}/v1/bakes", self.url)).header("authorization", &authorization);
        let submitted = submitted.header("idempotency-key", "once").send_json(&bake);
        let answer: serde_json::Value =
            submitted.expect("the bake is taken").body_mut().read_json().expect("a bake");
        answer["id"].as_str().expect("an id").to_owned()
    }
}

/// Waits until the page's text has `words`; gives the text.
fn wait_for(browser: &Browser, words: &str) -> String {
    let deadline = Instant::now() + LIMIT;
    loop {
        let text = browser.script("return document.querySelector('main').innerText", json!([]));
        let text = text.as_str().unwrap_or_default().to_owned();
        if text.contains(words) {
            return text;
        }
        assert!(Instant::now() < deadline, "the page never says '{words}': {text}");
    }
}

fn enter(browser: &Browser, token: &str) {
    let script = "const field = document.querySelector('input[name=token]');
        field.value = arguments[0][0];
        field.form.requestSubmit();";
    browser.script(script, json!([token]));
}

#[test]
#[ignore = "needs chromium"]
fn chromium_shows_a_farm_to_readers_with_a_token_and_every_name_as_text() {
    let farm = Farm::start();
    let id = farm.submit();
    let browser = Browser::start();
    browser.open(&format!("{}/", farm.url));
    wait_for(&browser, "A token is needed");
    enter(&browser, "kiln_wr\u{f6}ng");
    wait_for(&browser, "ASCII letters");
    enter(&browser, "kiln_wrong");
    wait_for(&browser, "kiln token create anna");
    enter(&browser, &farm.token);
    let list = wait_for(&browser, NAME);
    assert!(list.contains("running") && list.contains(&id[..8]), "{list}");
    browser.open(&format!("{}/#/bakes/{id}", farm.url));
    let bake = wait_for(&browser, "submitted");
    assert!(bake.contains(NAME) && bake.contains("scene.import"), "{bake}");
    browser.open(&format!("{}/#/workers", farm.url));
    wait_for(&browser, "No worker was heard of lately");
    let script = "return [document.title, document.querySelectorAll('main img').length, document.cookie,
        localStorage.length, performance.getEntriesByType('resource').every(({ name }) => name.startsWith(location.origin))]";
    assert_eq!(browser.script(script, json!([])), json!(["Lightkiln", 0, "", 0, true]));
    browser.script("document.getElementById('forget').click()", json!([]));
    wait_for(&browser, "A token is needed");
}
