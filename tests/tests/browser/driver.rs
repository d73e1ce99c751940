//! A headless Chromium, driven by WebDriver; it ends with the test process.

use std::time::Duration;

use serde_json::{Value, json};

use super::keeper::Keeper;

/// Longest that a script may take, beside other tests on a slow machine too: an end to one that hangs.
const SCRIPT_LIMIT: Duration = Duration::from_secs(900);
/// Calls a function of a module with the arguments of the script, and tells what it gives or throws.
const CALL: &str = "const [module, name, args, done] = arguments;
    import(module).then((module) => module[name](...args)).then(
        (value) => done({ value: value ?? null }),
        (error) => done({ error: String(error?.stack ?? error) }));";
/// Runs the driver; a signal ends every process of its session, as a browser has groups of processes of its own. The session's
/// number is the sixth word of a process' line, the fourth behind its name in brackets.
const SESSION: &str = r#"HOME="$folder" TMPDIR="$folder" setsid sh -c '
    end() {
        for turn in 1 2; do
            for file in /proc/[0-9]*/stat; do
                read -r line 2>/dev/null <"$file" || continue
                process=${line%% *}
                set -- ${line##*) }
                [ "$4" = $$ ] && [ "$process" != $$ ] && kill -9 "$process"
            done
        done
        exit 0
    }
    trap end USR1
    chromedriver --port=0 &
    wait
' 2>&1 &"#;
/// WebGPU by SwiftShader, and nothing that calls out. Containers have little shared memory, so files stand for it.
const FLAGS: [&str; 12] = [
    "--headless=new",
    "--no-sandbox",
    "--enable-unsafe-webgpu",
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
    "--use-angle=swiftshader",
    "--use-webgpu-adapter=swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--disable-dev-shm-usage",
];

/// A browser with one page.
pub struct Browser {
    /// Keeps the driver, and with it the browser.
    _keeper: Keeper,
    agent: ureq::Agent,
    /// URL of the session.
    session: String,
}

impl Browser {
    /// Starts driver and browser in a session of their own, which is ended as one.
    pub fn start() -> Self {
        let script = || format!("{SESSION}\nserver=$! stop=USR1");
        let (keeper, line) = Keeper::start(script, "started successfully on port", false);
        let port = line.rsplit(' ').next().map(|port| port.trim_end_matches('.')).expect("a port");
        let timeout = Some(SCRIPT_LIMIT + Duration::from_secs(30));
        let config = ureq::Agent::config_builder().proxy(None).timeout_global(timeout);
        let agent: ureq::Agent = config.http_status_as_error(false).build().into();
        let sessions = format!("http://127.0.0.1:{port}/session");
        let options = json!({ "goog:chromeOptions": { "args": FLAGS }, "browserName": "chrome" });
        let opened = call(&agent, &sessions, &json!({ "capabilities": { "alwaysMatch": options } }));
        let id = opened["sessionId"].as_str().expect("a session has an id").to_owned();
        let browser = Self { _keeper: keeper, agent, session: format!("{sessions}/{id}") };
        browser.call("timeouts", &json!({ "script": SCRIPT_LIMIT.as_millis() as u64 }));
        browser
    }

    fn call(&self, what: &str, body: &Value) -> Value {
        call(&self.agent, &format!("{}/{what}", self.session), body)
    }

    /// Opens a page and waits until it is there.
    pub fn open(&self, url: &str) {
        self.call("url", &json!({ "url": url }));
    }

    /// Makes the window so wide and high, in pixels.
    pub fn resize(&self, [width, height]: [u32; 2]) {
        self.call("window/rect", &json!({ "width": width, "height": height }));
    }

    /// Runs a script in every page that is opened from here on, before its own.
    pub fn before_pages(&self, script: &str) {
        let params = json!({ "source": script });
        self.call(
            "goog/cdp/execute",
            &json!({ "cmd": "Page.addScriptToEvaluateOnNewDocument", "params": params }),
        );
    }

    /// The value of a script; its `arguments[0]` are `args`.
    pub fn script(&self, script: &str, args: Value) -> Value {
        self.call("execute/sync", &json!({ "script": script, "args": [args] }))
    }

    /// The value of a module's async function; panics with its error.
    pub fn run(&self, module: &str, function: &str, args: Value) -> Value {
        let answer = self.call("execute/async", &json!({ "script": CALL, "args": [module, function, args] }));
        assert!(answer.get("error").is_none(), "{function} of {module}: {}", answer["error"]);
        answer["value"].clone()
    }
}

/// The value of a driver's answer.
fn call(agent: &ureq::Agent, url: &str, body: &Value) -> Value {
    let mut answer = agent.post(url).send_json(body).unwrap_or_else(|error| panic!("{url}: {error}"));
    let status = answer.status();
    let json: Value =
        answer.body_mut().with_config().limit(256 << 20).read_json().expect("an answer in JSON");
    assert!(status.is_success(), "{url}: {status}: {}", json["value"]["message"]);
    json["value"].clone()
}
