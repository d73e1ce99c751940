//! An S3-compatible store, reached with the keys, the region and the endpoint of the usual `AWS_…` variables.
//!
//! Nothing here rests on conditional PUTs, which not every such store has: an object's name is the digest of its bytes,
//! so whoever writes it twice writes the same, and a PUT or the end of a multipart upload shows all of it or nothing.
//! Stages of uploads that were broken off stay invisible; a lifecycle rule of the bucket should remove them.

use std::sync::Arc;
use std::time::Duration;

use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};

use super::Result;
use crate::tls::use_ring;

/// Wait for a connection. Longer → slow networks work, and a store that is away is noticed later.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Wait for the next bytes of an answer.
const READ_TIMEOUT: Duration = Duration::from_secs(30);
/// Longest time of one request, be it a part of an upload or a whole download.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(1800);
/// Tries after the first, and how long they may go on: workers try again too, so this only bridges moments.
const RETRIES: usize = 4;
/// See [`RETRIES`].
const RETRY_TIMEOUT: Duration = Duration::from_secs(20);

/// Opens the objects of `bucket` whose keys begin with `prefix`. Nothing is asked of the store yet.
///
/// `settings` are variables such as `AWS_REGION` and their values; others than object_store's are passed over.
pub(super) fn open(
    bucket: &str,
    prefix: &str,
    settings: impl IntoIterator<Item = (String, String)>,
) -> Result<Arc<dyn ObjectStore>> {
    use_ring();
    let mut builder = AmazonS3Builder::new();
    for (name, value) in settings {
        let key = name.starts_with("AWS_").then(|| name.to_ascii_lowercase().parse::<AmazonS3ConfigKey>());
        if let Some(Ok(key)) = key {
            builder = builder.with_config(key, value);
        }
    }
    // An endpoint without TLS is meant as it is named.
    let endpoint = builder.get_config_value(&AmazonS3ConfigKey::Endpoint).unwrap_or_default();
    let client = ClientOptions::new()
        .with_connect_timeout(CONNECT_TIMEOUT)
        .with_read_timeout(READ_TIMEOUT)
        .with_timeout(REQUEST_TIMEOUT)
        .with_allow_http(endpoint.starts_with("http://"));
    let retry = RetryConfig {
        backoff: BackoffConfig { init_backoff: Duration::from_millis(100), ..BackoffConfig::default() },
        max_retries: RETRIES,
        retry_timeout: RETRY_TIMEOUT,
    };
    let store = builder.with_bucket_name(bucket).with_client_options(client).with_retry(retry).build()?;
    if prefix.is_empty() {
        return Ok(Arc::new(store));
    }
    let prefix = Path::parse(prefix).map_err(object_store::Error::from)?;
    Ok(Arc::new(PrefixStore::new(store, prefix)))
}
