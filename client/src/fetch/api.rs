//! People's side of the HTTP API, typed ([`lightkiln_proto::api`]): scenes, bakes, events, results.

use std::ops::Range;

use lightkiln_http::{Call, HttpClient, Part, Patience, RetryPolicy, ShutdownFlag};
use lightkiln_proto::api::{
    Bake, BakeFilter, BakePage, Blocklist, EvaluationIndex, EventPage, MAX_CHUNK_BYTES, NewBake, NewPriority,
    ResultPage, SCENE_PART_BYTES, ScenePart, SceneParts, SceneProgress, SceneStored, WorkerPage,
};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest;
use lightkiln_proto::trace::TARGET;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, PercentEncode, utf8_percent_encode};
use rayon::prelude::*;

use crate::error::{ClientError, Result};

/// Longest wait of one polling call for events, in seconds.
pub const MAX_WAIT_SECS: u32 = 60;

/// Characters that a URL's path and query hold only when escaped.
const RESERVED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'_').remove(b'.').remove(b'~');

/// How often parts of a scene are uploaded before a server that keeps missing some is given up.
const UPLOAD_ROUNDS_MAX: u32 = 4;

/// A Lightkiln server. Calls block; those that fail in a way that may pass are tried again.
#[derive(Clone)]
pub struct ApiClient {
    http: HttpClient,
}

impl ApiClient {
    /// A server by its base URL (`http://host:port`), with a bearer token if it wants one.
    pub fn new(base: &str, token: Option<&str>) -> Result<Self> {
        Self::trusting(base, token, None)
    }

    /// The same, trusted if its certificate is signed by one of these (PEM) instead of the web's authorities.
    pub fn trusting(base: &str, token: Option<&str>, ca_pem: Option<&[u8]>) -> Result<Self> {
        Ok(Self { http: HttpClient::new(base, token, ca_pem)? })
    }

    /// The same server with other patience.
    #[must_use]
    pub fn with_retry(self, retry: RetryPolicy) -> Self {
        Self { http: self.http.with_retry(retry) }
    }

    /// The same server, waited for while it is away, whatever the policy.
    #[must_use]
    pub fn with_patience(self, patience: Patience) -> Self {
        Self { http: self.http.with_patience(patience) }
    }

    /// The same server; waits between tries end when `shutdown` is raised.
    #[must_use]
    pub fn with_shutdown(self, shutdown: ShutdownFlag) -> Self {
        Self { http: self.http.with_shutdown(shutdown) }
    }

    /// Base URL, without a slash at its end.
    pub fn base(&self) -> &str {
        self.http.base()
    }

    /// Uploads a scene bundle unless the server has it already. Of a big one only those parts go that the server has not:
    /// after an interruption the same call goes on where it was.
    pub fn upload_scene(&self, bundle: &[u8]) -> Result<SceneStored> {
        let bytes = bundle.len() as u64;
        if bytes > MAX_CHUNK_BYTES {
            let what = "the scene with its files".to_owned();
            let problem = format!(
                "has {bytes} bytes, more than the {MAX_CHUNK_BYTES} of a server; split it or lower its textures' sizes"
            );
            return Err(ClientError::Argument { what, problem });
        }
        let scene = Digest::of(bundle);
        let _span = tracing::info_span!(target: TARGET, "upload scene", %scene, bytes).entered();
        let pieces: Vec<&[u8]> = bundle.chunks(SCENE_PART_BYTES).collect();
        let part = |piece: &&[u8]| ScenePart { digest: Digest::of(piece), bytes: piece.len() as u64 };
        let parts: Vec<ScenePart> = pieces.par_iter().map(part).collect();
        let together =
            Call::post_json(format!("/v1/scenes/{scene}/parts"), &SceneParts { parts: parts.clone() })?;
        for _ in 0..UPLOAD_ROUNDS_MAX {
            let progress: SceneProgress = self.http.json(&together)?;
            if progress.is_stored {
                return Ok(SceneStored { scene, bytes });
            }
            if pieces.len() <= 1 {
                return Ok(self.http.json(&Call::put(format!("/v1/scenes/{scene}"), bundle))?);
            }
            tracing::info!(missing = progress.missing.len(), parts = parts.len(), "uploading a scene");
            for (part, piece) in parts.iter().zip(&pieces) {
                if progress.missing.contains(&part.digest) {
                    self.http.check_shutdown()?;
                    self.http.bytes(&Call::put(format!("/v1/scene-parts/{}", part.digest), piece), 0)?;
                }
            }
        }
        let problem =
            "keeps losing parts of the scene that were uploaded; have its storage checked ('kiln fsck')"
                .to_owned();
        Err(ClientError::Source { text: self.base().to_owned(), problem })
    }

    /// Asks for a bake; the same key with the same body gives the same bake.
    pub fn submit(&self, bake: &NewBake, idempotency_key: &str) -> Result<Bake> {
        if idempotency_key.is_empty() || !idempotency_key.bytes().all(|byte| byte.is_ascii_graphic()) {
            let problem = "an Idempotency-Key is printable ASCII without spaces, not empty".to_owned();
            return Err(ClientError::Argument { what: idempotency_key.to_owned(), problem });
        }
        let _span = tracing::info_span!(target: TARGET, "submit", scene = %bake.scene).entered();
        let call = Call::post_json("/v1/bakes", bake)?.header("idempotency-key", idempotency_key);
        Ok(self.http.json(&call)?)
    }

    /// Bakes that the filter takes, newest first; `after` is the `next` of the page before.
    pub fn bakes(&self, filter: &BakeFilter, after: Option<u64>, limit: u32) -> Result<BakePage> {
        let mut query = format!("limit={limit}");
        let parameters =
            filter.parameters().into_iter().chain(after.map(|place| ("after", place.to_string())));
        for (name, value) in parameters {
            query += &format!("&{name}={}", escape(&value));
        }
        Ok(self.http.json(&Call::get(format!("/v1/bakes?{query}")))?)
    }

    /// A bake as it stands.
    pub fn bake(&self, id: &str) -> Result<Bake> {
        Ok(self.http.json(&Call::get(bake_path(id, "")))?)
    }

    /// Cancels a bake.
    pub fn cancel(&self, id: &str) -> Result<Bake> {
        Ok(self.http.json(&Call::post(bake_path(id, "/cancel")))?)
    }

    /// Holds a bake's tasks back.
    pub fn pause(&self, id: &str) -> Result<Bake> {
        Ok(self.http.json(&Call::post(bake_path(id, "/pause")))?)
    }

    /// Ends a bake's pause.
    pub fn resume(&self, id: &str) -> Result<Bake> {
        Ok(self.http.json(&Call::post(bake_path(id, "/resume")))?)
    }

    /// Changes a bake's priority; bigger runs first.
    pub fn reprioritise(&self, id: &str, priority: i32) -> Result<Bake> {
        let call = Call::post_json(bake_path(id, "/priority"), &NewPriority { priority })?;
        Ok(self.http.json(&call)?)
    }

    /// Workers that failed at tasks of a bake.
    pub fn blocklist(&self, id: &str) -> Result<Blocklist> {
        Ok(self.http.json(&Call::get(bake_path(id, "/blocklist")))?)
    }

    /// Forgets that a worker, or any, failed at tasks of a bake; gives what is left.
    pub fn clear_blocklist(&self, id: &str, worker: Option<&str>) -> Result<Blocklist> {
        let query = worker.map(|worker| format!("?worker={}", escape(worker))).unwrap_or_default();
        Ok(self.http.json(&Call::delete(bake_path(id, &format!("/blocklist{query}"))))?)
    }

    /// Stores a file of an evaluation that is to be attached to a finished bake.
    pub fn put_evaluation_file(&self, id: &str, bytes: &[u8]) -> Result<()> {
        let path = bake_path(id, &format!("/evaluation/files/{}", Digest::of(bytes)));
        self.http.bytes(&Call::put(path, bytes), 0)?;
        Ok(())
    }

    /// Attaches an evaluation, whose files are stored, to a finished bake in place of the one before.
    pub fn attach_evaluation(&self, id: &str, index: &EvaluationIndex) -> Result<()> {
        self.http.bytes(&Call::put_json(bake_path(id, "/evaluation"), index)?, 0)?;
        Ok(())
    }

    /// Deletes a bake that has ended, with the results that no other bake holds.
    pub fn delete(&self, id: &str) -> Result<()> {
        self.http.bytes(&Call::delete(bake_path(id, "")), 0)?;
        Ok(())
    }

    /// Events after number `after` (0 for all), waiting up to `wait_secs` for the first.
    pub fn events(&self, id: &str, after: u64, wait_secs: u32) -> Result<EventPage> {
        let wait_secs = wait_secs.min(MAX_WAIT_SECS);
        let query = format!("/events?after={after}&wait_secs={wait_secs}");
        Ok(self.http.json(&Call::get(bake_path(id, &query)).header("accept", "application/json"))?)
    }

    /// Results behind place `after` (0 for all) of a bake's tasks of a kind, waiting up to `wait_secs` for the first.
    pub fn results(&self, id: &str, kind: &str, after: u64, wait_secs: u32) -> Result<ResultPage> {
        let wait_secs = wait_secs.min(MAX_WAIT_SECS);
        let query = format!("/results?kind={}&after={after}&wait_secs={wait_secs}", escape(kind));
        Ok(self.http.json(&Call::get(bake_path(id, &query)))?)
    }

    /// A finished bake's manifest, as its bytes.
    pub fn manifest(&self, id: &str) -> Result<Vec<u8>> {
        Ok(self.http.bytes(&Call::get(bake_path(id, "/manifest")), manifest::MAX_BYTES as u64)?)
    }

    /// A finished bake's report, as its bytes (JSON).
    pub fn report(&self, id: &str) -> Result<Vec<u8>> {
        Ok(self.http.bytes(&Call::get(bake_path(id, "/report")), manifest::MAX_BYTES as u64)?)
    }

    /// A chunk of at most `limit_bytes`, verified.
    pub fn chunk(&self, digest: Digest, limit_bytes: u64) -> Result<Vec<u8>> {
        let path = chunk_path(digest);
        let (Part { bytes, .. }, ended) = self.http.part(&path, 0..limit_bytes, limit_bytes);
        ended?;
        super::verify(&format!("{}{path}", self.base()), digest, bytes)
    }

    /// Bytes of a chunk of `total` bytes from a place on, unverified: those that are `wanted`, or all from a server that ignores
    /// ranges. A connection that breaks goes on where it was; bytes that came before an error are given with it.
    pub fn chunk_part(&self, digest: Digest, wanted: Range<u64>, total: u64) -> (Part, Result<()>) {
        let (part, ended) = self.http.part(&chunk_path(digest), wanted, total);
        (part, ended.map_err(Into::into))
    }

    /// Workers heard of lately.
    pub fn workers(&self) -> Result<WorkerPage> {
        Ok(self.http.json(&Call::get("/v1/workers"))?)
    }
}

fn chunk_path(digest: Digest) -> String {
    format!("/v1/chunks/{digest}")
}

fn bake_path(id: &str, rest: &str) -> String {
    format!("/v1/bakes/{}{rest}", escape(id))
}

/// Percent-encodes everything but unreserved characters.
fn escape(text: &str) -> PercentEncode<'_> {
    utf8_percent_encode(text, RESERVED)
}
