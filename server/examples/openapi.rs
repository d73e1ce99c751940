//! Writes `server/openapi.json` anew: `cargo run -p lightkiln-server --example openapi`.

fn main() -> std::io::Result<()> {
    std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.json"), lightkiln_server::openapi_json())
}
