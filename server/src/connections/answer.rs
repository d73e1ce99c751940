//! An answer's body on its way to a caller with several calls at a time.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Instant;

use axum::body::{Body, HttpBody};
use axum::response::Response;
use bytes::Bytes;
use http_body::{Frame, SizeHint};

use super::table::Call;
use crate::held::hold;

/// Longest piece that is handed over at a time, which a slow caller must take within the time of a stall. More → fewer steps
/// for large answers, and slower callers are cut off.
const PIECE_BYTES: usize = 16 << 10;

/// The answer, which holds its call until all of it has been handed over or its caller is gone.
///
/// HTTP/2 lets a caller refuse the bytes of one answer while the connection itself takes all: only that the next piece is
/// not asked for shows it. Where there is one call at a time, writes show it.
pub(super) fn watched(answer: Response, call: Call) -> Response {
    if !call.is_multiplexed {
        return hold(answer, call);
    }
    answer.map(|body| Body::new(Watched { body, rest: Bytes::new(), call }))
}

struct Watched {
    body: Body,
    /// Rest of a frame that was too long.
    rest: Bytes,
    call: Call,
}

impl HttpBody for Watched {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.call.note_taken();
        if self.rest.is_empty() {
            match Pin::new(&mut self.body).poll_frame(context) {
                Poll::Ready(Some(Ok(frame))) => match frame.into_data() {
                    Ok(bytes) => self.rest = bytes,
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                other => return other,
            }
        }
        let length = self.rest.len().min(PIECE_BYTES);
        let piece = self.rest.split_to(length);
        self.call.note_handed(Instant::now());
        Poll::Ready(Some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (rest, of_body) = (self.rest.len() as u64, self.body.size_hint());
        let mut hint = SizeHint::new();
        hint.set_lower(of_body.lower() + rest);
        if let Some(upper) = of_body.upper() {
            hint.set_upper(upper + rest);
        }
        hint
    }
}

#[cfg(test)]
mod tests {
    use axum::body::to_bytes;
    use futures::StreamExt;

    use super::super::ConnectionConfig;
    use super::super::table::Table;
    use super::*;

    #[tokio::test]
    async fn long_frame_comes_whole_in_pieces_and_its_length_is_known() {
        let table = std::sync::Arc::new(Table::new(&ConnectionConfig::default()));
        let seat = table.enter([127, 0, 0, 1].into(), Instant::now()).unwrap();
        let seat = std::sync::Arc::new(seat);
        let bytes: Vec<u8> = (0..3 * PIECE_BYTES + 5).map(|index| index as u8).collect();
        let answer = || watched(Response::new(Body::from(bytes.clone())), seat.begin(true).unwrap());
        assert_eq!(to_bytes(answer().into_body(), usize::MAX).await.unwrap(), bytes);
        let mut body = answer().into_body();
        assert_eq!(body.size_hint().exact(), Some(bytes.len() as u64));
        let mut pieces = Vec::new();
        while let Some(frame) = std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await
        {
            let piece = frame.unwrap().into_data().unwrap();
            pieces.push(piece.len());
            let left = bytes.len() - pieces.iter().sum::<usize>();
            assert_eq!((body.size_hint().exact(), body.is_end_stream()), (Some(left as u64), left == 0));
        }
        assert_eq!(pieces, [PIECE_BYTES, PIECE_BYTES, PIECE_BYTES, 5]);
        let empty = watched(Response::new(Body::empty()), seat.begin(true).unwrap());
        assert!(empty.into_body().into_data_stream().next().await.is_none());
    }
}
