//! Texts that callers write into URLs and headers, and owners onto command lines.

use std::net::IpAddr;
use std::sync::Arc;

use lightkiln_proto::api::{BakeFilter, Needs, NewBake};
use lightkiln_proto::ids::Digest;
use lightkiln_server::WebhookConfig;
use lightkiln_server::chunks::ChunkName;
use lightkiln_server::clock::SystemClock;
use lightkiln_server::places::{ChunksPlace, DatabasePlace};
use lightkiln_server::ranges::{Wanted, is_known, range_applies, wanted};
use lightkiln_server::store::chunk::KeptChunk;
use lightkiln_server::store::{FarmStore, Submission};

use super::model::MemoryStore;
use super::{Target, taken};

/// The headers Range, If-Range and If-None-Match, one a line.
pub const RANGE: Target = Target {
    name: "range",
    read: |bytes| text(bytes).is_some_and(|text| wanted(Some(text), 1000) != Wanted::All),
    check: |bytes| {
        if let Some(text) = text(bytes) {
            check_range(text);
        }
    },
    seeds: || {
        texts(&["bytes=0-99", "bytes=-5\n\"a\"", "bytes=7-\nW/\"a\"\n\"b\", W/\"a\"", "bytes=1-2,4-5\n*\n*"])
    },
    memory_max,
};

/// Where a page of bakes begins.
pub const CURSOR: Target = Target {
    name: "cursor",
    read: |bytes| {
        let (store, _) = farm();
        let after = text(bytes).and_then(|text| text.parse().ok());
        after.is_some_and(|after| {
            taken(&pollster::block_on(store.list(&BakeFilter::default(), Some(after), 2)))
        })
    },
    check: |bytes| {
        if let Some(text) = text(bytes) {
            check_cursor(text);
        }
    },
    seeds: || texts(&["0", "1", "3", "18446744073709551615"]),
    memory_max,
};

/// URLs of databases, chunk stores and webhooks.
pub const PLACE: Target = Target {
    name: "place",
    read: |bytes| {
        let Some(text) = text(bytes) else { return false };
        let database = taken(&text.parse::<DatabasePlace>());
        let chunks = taken(&text.parse::<ChunksPlace>());
        let digest = taken(&text.parse::<Digest>());
        taken(&webhook(text)) || database || chunks || digest
    },
    check: |bytes| {
        if let Some(text) = text(bytes) {
            check_place(text);
        }
    },
    seeds: || {
        texts(&[
            "https://hooks.example:8443/a?b=c",
            "http://10.0.0.1/",
            "http://[::ffff:127.0.0.1]:80/",
            "http://user:secret@2130706433/",
            "postgres://u:secret@db:5432/farm?options[search_path]=x",
            "sqlite:///var/farm.sqlite",
            "s3://BUCKET/PREFIX/MORE/",
            "file:///srv/chunks",
            &Digest::of(b"seed").to_string(),
        ])
    },
    memory_max,
};

fn memory_max(bytes: usize) -> u64 {
    (1 << 20) + 64 * bytes as u64
}

fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}

fn texts(seeds: &[&str]) -> Vec<Vec<u8>> {
    seeds.iter().map(|seed| seed.as_bytes().to_vec()).collect()
}

fn check_range(text: &str) {
    let mut lines = text.splitn(3, '\n');
    let (range, if_range, if_none_match) = (lines.next(), lines.next(), lines.next());
    for length in [0, 1, 10, 1000, u64::MAX] {
        if let Wanted::Part(part) = wanted(range, length) {
            assert!(part.start < part.end && part.end <= length);
            // Asked for by its own bounds, the part is the same.
            let again = format!("bytes={}-{}", part.start, part.end - 1);
            assert_eq!(wanted(Some(&again), length), Wanted::Part(part));
        }
    }
    let etag = "\"a\"";
    assert!(!range_applies(if_range, etag) || if_range.is_none_or(|tag| tag.contains(etag)));
    assert!(!is_known(if_none_match, etag) || if_none_match.is_some_and(|tags| tags.contains(['a', '*'])));
}

/// A farm with three bakes, and their ids.
fn farm() -> (MemoryStore, Vec<String>) {
    let store = MemoryStore::new(Arc::new(SystemClock));
    let scene = KeptChunk { name: ChunkName::from(Digest::of(b"seed")), bytes: 4 };
    pollster::block_on(store.keep_chunk(scene, None, None)).expect("room for a scene");
    let bake = NewBake {
        name: "seed".into(),
        scene: Digest::of(b"seed"),
        kind: "x".into(),
        settings: serde_json::Value::Null,
        priority: 0,
        needs: Needs::default(),
        attempt_limit_secs: None,
        limits: Default::default(),
        verify_share: 0.0,
    };
    let submission = Submission {
        idempotency_key: None,
        traceparent: None,
        owner: None,
        body_hash: Digest::of(b""),
        bake,
        plan: Vec::new(),
    };
    let submit = || pollster::block_on(store.submit(&submission)).expect("a bake without tasks").bake.id;
    let ids = (0..3).map(|_| submit()).collect();
    (store, ids)
}

fn check_cursor(text: &str) {
    let Ok(after) = text.parse::<u64>() else { return };
    let (store, ids) = farm();
    let page = pollster::block_on(store.list(&BakeFilter::default(), Some(after), 2))
        .expect("any number is a place");
    // Newest first: behind a number there are the bakes with smaller ones, which are given out from 1 on.
    let before = usize::try_from(after.saturating_sub(1)).unwrap_or(usize::MAX).min(ids.len());
    let given: Vec<_> = page.bakes.iter().map(|bake| &bake.id).collect();
    assert_eq!(given, ids[..before].iter().rev().take(2).collect::<Vec<_>>());
    assert_eq!(page.next.is_some(), before > 2);
}

fn webhook(text: &str) -> Result<WebhookConfig, lightkiln_server::ServerError> {
    WebhookConfig::new(&[text.to_owned()], "0123456789abcdef0123456789abcdef", false)
}

fn check_place(text: &str) {
    if let Ok(config) = webhook(text) {
        let url = &config.urls[0];
        assert!(matches!(url.scheme(), "http" | "https"), "{url}");
        let host = url.host_str().expect("a host").trim_matches(['[', ']']);
        // A name may look like the beginning of an address; the address behind it is tested when it is called.
        let is_near = |address: IpAddr| match address {
            IpAddr::V4(address) => address.is_loopback() || address.is_link_local(),
            IpAddr::V6(address) => address.is_loopback(),
        };
        assert!(!host.parse().is_ok_and(is_near), "{url}");
        assert_eq!(webhook(url.as_str()).expect("the same URL").urls[0], *url);
    }
    if let Ok(place) = text.parse::<DatabasePlace>() {
        let shown = place.to_string();
        assert_eq!(shown.parse::<DatabasePlace>().expect("what is shown is a place").to_string(), shown);
    }
    if let Ok(digest) = text.parse::<Digest>() {
        assert_eq!(digest.to_string(), text);
    }
}
