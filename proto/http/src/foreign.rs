//! Calls to servers that are not Lightkiln's, for example a collector of traces: no token, no trace, no retries.

use std::time::Duration;

use lightkiln_proto::address::is_loopback;
use ureq::Agent;
pub use ureq::Error;
use ureq::http::{Request, Response};

/// Sends `request` and reads at most `limit` bytes of its answer, within `patience` in all.
pub fn send(request: Request<Vec<u8>>, patience: Duration, limit: u64) -> Result<Response<Vec<u8>>, Error> {
    let mut config = Agent::config_builder().http_status_as_error(false).timeout_global(Some(patience));
    if is_loopback(&request.uri().to_string()) {
        config = config.proxy(None);
    }
    let (parts, mut body) = config.build().new_agent().run(request)?.into_parts();
    Ok(Response::from_parts(parts, body.with_config().limit(limit).read_to_vec()?))
}
