//! Parts of bodies: asked for by range, and taken up again where a connection broke.

use std::io::Read as _;
use std::ops::Range;

use lightkiln_proto::problem::RetryClass;

use crate::call::Call;
use crate::client::HttpClient;
use crate::error::CallError;

/// Bytes of a body from a place on.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Part {
    /// Place of the first of them in the body.
    pub start: u64,
    /// The bytes.
    pub bytes: Vec<u8>,
}

impl Part {
    fn end(&self) -> u64 {
        self.start + self.bytes.len() as u64
    }
}

impl HttpClient {
    /// Bytes `wanted` of the body at `path`, which should have `total` bytes. A server that ignores ranges gives all of the body,
    /// which then begins before `wanted`; one that has less of it gives fewer bytes, and none more.
    ///
    /// A connection that breaks loses nothing: the next one goes on where it was, at once if it brought something, else after the waits
    /// of failed calls. Bytes that came before an error are given with it.
    pub fn part(&self, path: &str, wanted: Range<u64>, total: u64) -> (Part, Result<(), CallError>) {
        let mut got = Part { start: wanted.start, bytes: Vec::new() };
        let call = || loop {
            let before = got.end();
            match self.part_once(path, &wanted, total, &mut got) {
                Err(error) if may_go_on(&error) && got.end() > before => {
                    tracing::debug!(%error, place = got.end(), "going on where the connection broke");
                    self.check_shutdown()?;
                }
                outcome => return outcome,
            }
        };
        let ended = self.try_again(call);
        (got, ended)
    }

    /// Asks for the part that is left, and adds as much of it as comes.
    fn part_once(
        &self,
        path: &str,
        wanted: &Range<u64>,
        total: u64,
        got: &mut Part,
    ) -> Result<(), CallError> {
        let from = got.end();
        if from >= wanted.end {
            return Ok(());
        }
        let range = format!("bytes={from}-{}", wanted.end - 1);
        let is_all = from == 0 && wanted.end >= total;
        // Lengths are those of the bytes as they are stored.
        let call = Call::get(path).header("accept-encoding", "identity");
        let call = if is_all { call } else { call.header("range", &range) };
        let answer = self.once(&call)?;
        let end = match answer.part_start()? {
            Some(start) if start == from => wanted.end,
            Some(start) => {
                let problem = format!("bytes from {start} on came, asked for were those from {from} on");
                return Err(CallError::WrongPart { call: answer.call, problem });
            }
            None => {
                *got = Part::default();
                total
            }
        };
        let room = end.saturating_sub(got.end());
        answer.read_into(&mut got.bytes, room)
    }
}

fn may_go_on(error: &CallError) -> bool {
    error.retry_class() == RetryClass::Backoff
}

impl crate::call::Answer {
    /// First byte of the part that the answer holds; `None` where it holds all of the body.
    fn part_start(&self) -> Result<Option<u64>, CallError> {
        if self.response.status().as_u16() != 206 {
            return Ok(None);
        }
        let range = self.response.headers().get("content-range").and_then(|range| range.to_str().ok());
        let start = range.and_then(|range| {
            let (first, _) = range.trim().strip_prefix("bytes")?.trim_start().split_once('-')?;
            first.parse().ok()
        });
        let problem = || format!("its header Content-Range is {range:?}, no range of bytes");
        let call = || self.call.clone();
        start.map(Some).ok_or_else(|| CallError::WrongPart { call: call(), problem: problem() })
    }

    /// Adds the body to `bytes` as it comes, at most `room` of it; what came before an error stays.
    fn read_into(mut self, bytes: &mut Vec<u8>, room: u64) -> Result<(), CallError> {
        let first = bytes.len();
        let too_large =
            |bytes| CallError::TooLarge { body: format!("the answer to {}", self.call), bytes, limit: room };
        if let Some(length) = self.content_length().filter(|length| *length > room) {
            return Err(too_large(length));
        }
        let body = self.response.body_mut().with_config().limit(u64::MAX).reader();
        let read = body.take(room + 1).read_to_end(bytes);
        let came = (bytes.len() - first) as u64;
        if came > room {
            bytes.truncate(first + room as usize);
            return Err(too_large(came));
        }
        read.map(drop).map_err(|error| CallError::Network { call: self.call, source: Box::new(error.into()) })
    }
}
