//! A server's bake that comes piece by piece: fetched by a thread of its own, which the window never waits for.

use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};

use crate::bake::LoadedBake;
use crate::error::Result;
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
        std::thread::spawn(move || fetch(stream, &wanted, &sender, wake));
        (Self { pieces, view, streamed, is_over: false }, first)
    }

    /// Fetches what this view needs most from here on.
    pub fn look(&self, view: View) {
        *self.view.lock().unwrap_or_else(PoisonError::into_inner) = view;
    }

    /// The last piece that has come since the last call.
    pub fn next(&mut self) -> Result<Option<Piece>> {
        let mut last = None;
        loop {
            match self.pieces.try_recv() {
                Ok(piece) => last = Some(piece?),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    self.is_over = true;
                    break;
                }
            }
        }
        if let Some(piece) = &last {
            self.streamed = piece.streamed;
        }
        Ok(last)
    }

    /// Nothing more will come.
    pub fn is_over(&self) -> bool {
        self.is_over
    }
}

/// Ends when all is there, when something is wrong, or when nobody listens any more.
fn fetch(mut stream: StreamedBake, view: &Mutex<View>, sender: &Sender<Result<Piece>>, wake: impl Fn()) {
    loop {
        let Streamed { bytes, bytes_all, clusters, clusters_all } = stream.streamed();
        if clusters == clusters_all {
            return;
        }
        let step = (bytes_all / PIECES).max(PIECE_MIN);
        let view = view.lock().unwrap_or_else(PoisonError::into_inner).clone();
        // A cluster may be larger than a step: the last step takes whatever there is.
        let refined = stream.refine(&view, bytes.saturating_add(step).min(bytes_all));
        let piece = refined.map(|()| Piece { bake: Arc::clone(&stream.bake), streamed: stream.streamed() });
        let goes_on = piece.is_ok();
        if sender.send(piece).is_err() {
            return;
        }
        wake();
        if !goes_on {
            return;
        }
    }
}
