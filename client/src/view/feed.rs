//! A server's bake that comes piece by piece: fetched by a thread of its own, which the window never waits for.

use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};

use crate::bake::LoadedBake;
use crate::error::{ClientError, Result};
use crate::preview::{StreamedBake, View};
use crate::stream::Streamed;

/// Share of the bytes that a piece brings: light gets better some ten times, and each time the frame takes it anew.
const PIECES: u64 = 12;
/// Least bytes of a piece.
const PIECE_MIN: u64 = 128 << 10;

/// A piece of light.
pub struct Piece {
    /// The bake with all the light that has come.
    pub bake: Arc<LoadedBake>,
    /// Bytes and clusters that have come.
    pub streamed: Streamed,
}

/// The thread's end of light that comes.
pub struct Feed {
    pieces: Receiver<Result<Piece>>,
    view: Arc<Mutex<View>>,
    /// Light that has come.
    pub streamed: Streamed,
    /// An error that came after the piece that was taken last.
    held: Option<ClientError>,
    is_over: bool,
}

impl Feed {
    /// Goes on fetching what a view needs most, until all is there; `wake` is called when a piece has come. The light that has come
    /// already is the first piece.
    pub fn start(
        stream: StreamedBake,
        view: View,
        wake: impl Fn() + Send + 'static,
    ) -> (Self, Arc<LoadedBake>) {
        let (sender, pieces) = channel();
        let view = Arc::new(Mutex::new(view));
        let (streamed, first) = (stream.streamed(), Arc::clone(&stream.bake));
        let wanted = Arc::clone(&view);
        let step = (streamed.bytes_all / PIECES).max(PIECE_MIN);
        std::thread::spawn(move || fetch((stream, step), &wanted, &sender, wake));
        (Self { pieces, view, streamed, held: None, is_over: false }, first)
    }

    /// Fetches what this view needs most from here on.
    pub fn look(&self, view: View) {
        *self.view.lock().unwrap_or_else(PoisonError::into_inner) = view;
    }

    /// The last piece that has come since the last call. An error comes after the pieces before it, and is the end.
    pub fn next(&mut self) -> Result<Option<Piece>> {
        let mut last = None;
        while self.held.is_none() {
            match self.pieces.try_recv() {
                Ok(Ok(piece)) => last = Some(piece),
                Ok(Err(error)) => self.held = Some(error),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    self.is_over = true;
                    break;
                }
            }
        }
        if let Some(piece) = last {
            self.streamed = piece.streamed;
            return Ok(Some(piece));
        }
        let Some(error) = self.held.take() else { return Ok(None) };
        self.is_over = true;
        Err(error)
    }

    /// Nothing more will come.
    pub fn is_over(&self) -> bool {
        self.is_over
    }
}

/// Ends when all is there, when something is wrong, or when nobody listens any more. A piece has `step` bytes, or as many steps
/// as its first cluster takes.
fn fetch(
    (mut stream, step): (StreamedBake, u64),
    view: &Mutex<View>,
    sender: &Sender<Result<Piece>>,
    wake: impl Fn(),
) {
    let mut target = stream.streamed().bytes;
    loop {
        let Streamed { clusters, clusters_all, .. } = stream.streamed();
        if clusters == clusters_all {
            return;
        }
        let view = view.lock().unwrap_or_else(PoisonError::into_inner).clone();
        // Clusters that do not fit are left out: the target grows until they do.
        target = target.saturating_add(step);
        let refined = stream.refine(&view, target);
        let goes_on = refined.is_ok();
        if goes_on && stream.streamed().clusters == clusters {
            continue;
        }
        let piece = refined.map(|()| Piece { bake: Arc::clone(&stream.bake), streamed: stream.streamed() });
        if sender.send(piece).is_err() {
            return;
        }
        wake();
        if !goes_on {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use lightkiln_proto::kinds::prt;
    use lightkiln_proto::manifest::with_chunks;

    use super::*;
    use crate::fetch::Source;
    use crate::fixture::write_bundle;
    use crate::kinds;
    use crate::tests::fixture_view;

    #[test]
    fn clusters_larger_than_a_step_come_as_well_and_every_piece_brings_some() {
        let folder = tempfile::tempdir().unwrap();
        write_bundle(folder.path(), prt::NAME);
        let source = Source::bundle(folder.path()).unwrap();
        let stream = StreamedBake::begin(&source, &kinds::all(), u64::MAX).unwrap();
        let largest = with_chunks(&stream.bake.scene.manifest).map(|(_, chunk)| chunk.bytes).max().unwrap();
        let all = stream.streamed().clusters_all;
        let (sender, pieces) = channel();
        fetch((stream, largest - 1), &Mutex::new(fixture_view().1), &sender, || {});
        drop(sender);
        let come: Vec<usize> = pieces.iter().map(|piece| piece.unwrap().streamed.clusters).collect();
        assert!(come[0] > 0 && come.windows(2).all(|pair| pair[0] < pair[1]), "{come:?}");
        assert!(come.len() > 1, "{come:?}");
        assert_eq!(come.last(), Some(&all));
    }

    #[test]
    fn pieces_before_an_error_are_taken_and_then_the_error_once() {
        let (bake, view) = fixture_view();
        let (sender, pieces) = channel();
        let streamed = Streamed { bytes: 1, bytes_all: 2, clusters: 1, clusters_all: 2 };
        let view = Arc::new(Mutex::new(view));
        let mut feed = Feed { pieces, view, streamed: Streamed::default(), held: None, is_over: false };
        assert!(feed.next().unwrap().is_none());
        sender.send(Ok(Piece { bake: Arc::new(bake), streamed })).unwrap();
        let what = "the server".to_owned();
        sender.send(Err(ClientError::Argument { what, problem: "is lost".to_owned() })).unwrap();
        drop(sender);
        assert!(feed.next().unwrap().is_some());
        assert!(feed.streamed == streamed && !feed.is_over());
        let problem = feed.next().err().unwrap().to_string();
        assert!(problem.contains("is lost") && feed.is_over(), "{problem}");
        assert!(feed.next().unwrap().is_none() && feed.is_over());
    }
}
