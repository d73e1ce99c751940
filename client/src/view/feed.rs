//! A server's bake that comes piece by piece: fetched by a thread of its own, which the window never waits for.

use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::pace::{Pace, Turn};
use crate::bake::LoadedBake;
use crate::error::{ClientError, Result};
use crate::preview::{StreamedBake, View};
use crate::stream::{Budget, Streamed};

/// Share of the bytes that a piece brings: light gets better some ten times, and each time the frame takes it anew.
const PIECES: u64 = 12;
/// Where an adapter has no room for a piece, light keeps below its memory: by one in so many at least, and at most. More at a time → fewer
/// tries, and more of the adapter's room is left unused.
const FALL_LEAST: u64 = 16;
const FALL_MOST: u64 = 4;
/// Least bytes of a piece.
const PIECE_MIN: u64 = 128 << 10;
/// Time from hearing of a bake under way to hearing of it again: clusters land meanwhile. More → fewer pieces.
const LANDING: Duration = Duration::from_secs(1);

/// A piece of light.
pub struct Piece {
    /// The bake with all the light that has come.
    pub bake: Arc<LoadedBake>,
    /// Bytes and clusters that have come.
    pub streamed: Streamed,
}

/// The view that light is fetched for.
struct Watched {
    watch: Mutex<Watch>,
    /// Told of each change.
    changed: Condvar,
}

struct Watch {
    /// `None` when nobody looks any more.
    view: Option<View>,
    /// Most memory of the light.
    memory: u64,
    /// All light that there is room for has come for this view.
    is_served: bool,
}

impl Watched {
    fn new(view: View, memory: u64) -> Self {
        let watch = Mutex::new(Watch { view: Some(view), memory, is_served: false });
        Self { watch, changed: Condvar::new() }
    }

    fn held(&self) -> MutexGuard<'_, Watch> {
        self.watch.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, view: Option<View>) {
        let mut held = self.held();
        if held.view != view {
            (held.view, held.is_served) = (view, false);
            self.changed.notify_all();
        }
    }

    fn set_memory(&self, memory: u64) {
        let mut held = self.held();
        (held.memory, held.is_served) = (memory, false);
        self.changed.notify_all();
    }

    /// The view, and the most memory for it.
    fn wanted(&self) -> Option<(View, u64)> {
        let held = self.held();
        Some((held.view.clone()?, held.memory))
    }

    /// Waits for another view than this one, or another memory: for these all is done.
    fn wait_for_other(&self, view: &View, memory: u64) {
        let mut held = self.held();
        held.is_served = held.view.as_ref() == Some(view) && held.memory == memory;
        let served = |held: &mut Watch| held.is_served;
        drop(self.changed.wait_while(held, served).unwrap_or_else(PoisonError::into_inner));
    }

    /// Waits so long for another view or memory, though more is to come for these.
    fn wait_a_little(&self, view: &View, memory: u64, time: Duration) {
        let is_same = |held: &mut Watch| held.view.as_ref() == Some(view) && held.memory == memory;
        let waited = self.changed.wait_timeout_while(self.held(), time, is_same);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

/// The thread's end of light that comes.
pub struct Feed {
    pieces: Receiver<Result<Piece>>,
    watched: Arc<Watched>,
    /// Light that has come.
    pub streamed: Streamed,
    /// An error that came after the piece that was taken last.
    held: Option<ClientError>,
    is_over: bool,
}

impl Feed {
    /// Goes on fetching what a view needs most, within so many bytes of memory; `wake` is called when a piece has come. The light that has come already is the first piece.
    pub fn start(
        stream: StreamedBake,
        memory: u64,
        view: View,
        wake: impl Fn() + Send + 'static,
    ) -> (Self, Arc<LoadedBake>) {
        let (sender, pieces) = channel();
        let watched = Arc::new(Watched::new(view, memory));
        let (streamed, first) = (stream.streamed(), Arc::clone(&stream.bake));
        let wanted = Arc::clone(&watched);
        let step = (streamed.bytes_all / PIECES).max(PIECE_MIN);
        std::thread::spawn(move || fetch(stream, step, &wanted, &sender, wake));
        (Self { pieces, watched, streamed, held: None, is_over: false }, first)
    }

    /// Fetches what this view needs most from here on.
    pub fn look(&self, view: View) {
        self.watched.set(Some(view));
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

    /// The adapter has no room for the light of the last piece, and goes on with `shown`: keeps light within less memory, and tells how much
    /// that is. Pieces with less are to come.
    pub fn fall(&mut self, shown: Streamed) -> u64 {
        let refused = std::mem::replace(&mut self.streamed, shown).memory;
        let memory = shown.memory.min(refused - refused / FALL_LEAST).max(refused - refused / FALL_MOST);
        self.watched.set_memory(memory);
        memory
    }

    /// No more light will come for the view: all has come, or memory holds no more.
    pub fn is_served(&self) -> bool {
        self.watched.held().is_served
    }

    /// Nothing more will come.
    pub fn is_over(&self) -> bool {
        self.is_over
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.watched.set(None);
    }
}

/// Ends when something is wrong, or when nobody listens any more. A piece has the bytes of a step, or where no layer fits into one all
/// that there is room for.
fn fetch(
    mut stream: StreamedBake,
    step: u64,
    watched: &Watched,
    sender: &Sender<Result<Piece>>,
    wake: impl Fn(),
) {
    let (mut pace, mut sent, mut heard_at) = (Pace::new(step), stream.streamed(), Instant::now());
    loop {
        let Some(wanted) = watched.wanted() else { return };
        let (view, memory) = (&wanted.0, wanted.1);
        let before = stream.streamed();
        let done = match pace.turn(&wanted, &before, heard_at.elapsed() >= LANDING) {
            Turn::Rest => {
                watched.wait_for_other(view, memory);
                continue;
            }
            Turn::Hear { wait_secs } => {
                // Clusters that land within a while are taken together, so that light is made less often.
                watched.wait_a_little(view, memory, LANDING.saturating_sub(heard_at.elapsed()));
                let heard = stream.hear(wait_secs);
                heard_at = Instant::now();
                heard.map(|has_more| pace.heard(has_more))
            }
            Turn::Refine { step } => {
                let refined = stream.refine(view, Budget { step, memory, ..Budget::NONE });
                pace.refined(&wanted, stream.streamed() != before);
                refined
            }
        };
        let streamed = stream.streamed();
        if streamed != sent {
            sent = streamed;
            let bake = Arc::clone(&stream.bake);
            if view.lod.is_some() {
                // Made here, so that the window has not to wait for it.
                let _ = bake.light.lod_table();
            }
            if sender.send(Ok(Piece { bake, streamed })).is_err() {
                return;
            }
            wake();
        }
        if let Err(error) = done {
            // Nobody listens if this fails.
            let _ = sender.send(Err(error));
            return wake();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use lightkiln_proto::api::BakeState;
    use lightkiln_proto::kinds::prt;
    use lightkiln_proto::manifest::CLUSTERS;

    use super::*;
    use crate::fetch::{Source, chunk_path};
    use crate::fixture::{BundleServer, Faults, Told, write_bundle};
    use crate::kinds;
    use crate::tests::fixture_view;

    #[test]
    fn clusters_larger_than_a_step_come_as_well_and_every_piece_brings_some() {
        let folder = tempfile::tempdir().unwrap();
        write_bundle(folder.path(), prt::NAME);
        let source = Source::bundle(folder.path()).unwrap();
        let stream = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
        let chunks = stream.bake.scene.manifest.chunks(CLUSTERS);
        let smallest = chunks.iter().map(|chunk| chunk.bytes).min().unwrap();
        let Streamed { bytes: none, bytes_all: all, .. } = stream.streamed();
        let bytes_with = |stream: StreamedBake, step: u64| -> Vec<u64> {
            let (sender, pieces) = channel();
            let watched = Watched::new(fixture_view().1, u64::MAX);
            std::thread::scope(|threads| {
                threads.spawn(|| fetch(stream, step, &watched, &sender, || {}));
                let mut come = Vec::new();
                while come.last() != Some(&all) {
                    come.push(pieces.recv().unwrap().unwrap().streamed.bytes);
                }
                watched.set(None);
                come
            })
        };
        let come = bytes_with(stream, smallest);
        assert!(come[0] > none && come.windows(2).all(|pair| pair[0] < pair[1]), "{come:?}");
        assert!(come.len() > 1, "{come:?}");
        assert_eq!(come.last(), Some(&all));
        // No layer fits into a byte.
        let stream = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
        assert_eq!(bytes_with(stream, 1), [all]);
    }

    #[test]
    fn where_memory_is_short_another_view_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        write_bundle(folder.path(), prt::NAME);
        let source = Source::bundle(folder.path()).unwrap();
        let stream = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
        let least = stream.streamed().memory;
        let mut whole = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
        let (_, view) = fixture_view();
        whole.refine(&view, Budget::NONE).unwrap();
        let memory = least + (whole.streamed().memory - least) / 2;
        let (mut feed, first) = Feed::start(stream, memory, view.clone(), || {});
        // Pieces come until memory is full; then the thread waits, and is not over.
        let served = |feed: &mut Feed| {
            let mut last = None;
            loop {
                let is_served = feed.is_served();
                match feed.next().unwrap() {
                    Some(piece) => last = Some(piece),
                    None if is_served => return last,
                    None => std::thread::yield_now(),
                }
                assert!(!feed.is_over());
            }
        };
        let piece: Piece = served(&mut feed).unwrap();
        assert!(!Arc::ptr_eq(&first, &piece.bake));
        assert!(piece.streamed.memory <= memory && !piece.streamed.is_whole(), "{:?}", piece.streamed);
        let mut other = view.clone();
        std::mem::swap(&mut other.camera.eye_m, &mut other.camera.target_m);
        feed.look(other);
        let again = served(&mut feed).map_or(piece.streamed, |piece| piece.streamed);
        assert!(again.memory <= memory && !again.is_whole(), "{again:?}");
        // An adapter that has no room for it gets less.
        let shown = Streamed { memory: again.memory - 1, ..again };
        let less = feed.fall(shown);
        assert!(less < again.memory && feed.streamed == shown);
        let fallen = served(&mut feed).unwrap().streamed;
        assert!(fallen.memory <= less && fallen.turns > again.turns, "{fallen:?}");
    }

    #[test]
    fn light_that_is_all_there_falls_as_well() {
        let folder = tempfile::tempdir().unwrap();
        write_bundle(folder.path(), prt::NAME);
        let source = Source::bundle(folder.path()).unwrap();
        let stream = StreamedBake::begin(&source, &kinds::all(), Budget::NONE).unwrap();
        let first = stream.streamed();
        let (mut feed, _) = Feed::start(stream, u64::MAX, fixture_view().1, || {});
        let until = |feed: &mut Feed, is_wanted: &dyn Fn(&Streamed) -> bool| {
            while !is_wanted(&feed.streamed) {
                feed.next().unwrap();
                std::thread::yield_now();
            }
        };
        until(&mut feed, &Streamed::is_whole);
        let all = feed.streamed;
        assert_eq!(all.memory, all.memory_all);
        // Each refusal brings less, down to the overview.
        let mut last = all;
        while last.memory > first.memory {
            let less = feed.fall(first);
            assert!(less < last.memory && feed.streamed == first && !feed.is_over());
            until(&mut feed, &|streamed| streamed.turns > last.turns);
            assert!(feed.streamed.memory <= less.max(first.memory), "{:?}", feed.streamed);
            last = feed.streamed;
        }
        assert_eq!(last.clusters, 0);
    }

    #[test]
    fn clusters_of_a_bake_under_way_come_as_they_land_and_it_is_served_at_its_end_alone() {
        let folder = tempfile::tempdir().unwrap();
        let manifest = write_bundle(folder.path(), prt::NAME);
        let mut told = Told::of(folder.path(), &manifest, &[&[0, 1, 2], &[3, 4, 5, 6]]);
        let server = BundleServer::start(folder.path(), Faults::default());
        server.tell(&told);
        let following = kinds::all().follow(&server.source()).unwrap().unwrap();
        let stream = StreamedBake::follow(following, &kinds::all(), Budget::NONE).unwrap();
        let (mut feed, _) = Feed::start(stream, u64::MAX, fixture_view().1, || {});
        let until = |feed: &mut Feed, is_wanted: &dyn Fn(&Streamed) -> bool| {
            while !is_wanted(&feed.streamed) {
                feed.next().unwrap();
                assert!(!feed.is_over());
                std::thread::yield_now();
            }
        };
        for (cell, clusters) in [(1, 4), (0, 7)] {
            told.landed.push(cell);
            server.tell(&told);
            until(&mut feed, &|streamed| streamed.whole == clusters);
            assert_eq!(feed.streamed.baked.unwrap().cells, told.landed.len() as u64);
            assert!(!feed.is_served() && !feed.streamed.is_whole());
        }
        told.end(BakeState::Done, None);
        server.tell(&told);
        until(&mut feed, &Streamed::is_whole);
        while !feed.is_served() {
            std::thread::yield_now();
        }
        // A bake that fails is the end.
        told.end(BakeState::Running, None);
        server.tell(&told);
        let following = kinds::all().follow(&server.source()).unwrap().unwrap();
        let stream = StreamedBake::follow(following, &kinds::all(), Budget::NONE).unwrap();
        let (mut feed, _) = Feed::start(stream, u64::MAX, fixture_view().1, || {});
        told.end(BakeState::Failed, Some("no ray meets anything"));
        server.tell(&told);
        let error = loop {
            match feed.next() {
                Err(error) => break error.to_string(),
                Ok(_) => std::thread::yield_now(),
            }
        };
        assert!(error.contains("no ray meets anything") && feed.is_over(), "{error}");
    }

    /// A server of a bake under way whose first cell has landed and lacks the bytes of a cluster, which are given with their place.
    fn with_one_lost(folder: &Path) -> (BundleServer, StreamedBake, Told, (PathBuf, Vec<u8>)) {
        let manifest = write_bundle(folder, prt::NAME);
        let mut told = Told::of(folder, &manifest, &[&[0, 1, 2], &[3, 4, 5, 6]]);
        told.landed.push(0);
        let chunk = chunk_path(folder, manifest.chunks(CLUSTERS)[1].digest);
        let bytes = std::fs::read(&chunk).unwrap();
        std::fs::remove_file(&chunk).unwrap();
        let server = BundleServer::start(folder, Faults::default());
        server.tell(&told);
        let following = kinds::all().follow(&server.source()).unwrap().unwrap();
        let stream = StreamedBake::follow(following, &kinds::all(), Budget::NONE).unwrap();
        (server, stream, told, (chunk, bytes))
    }

    #[test]
    fn cluster_that_is_lost_is_asked_for_again_only_once_something_has_landed() {
        let folder = tempfile::tempdir().unwrap();
        let (server, stream, mut told, (chunk, bytes)) = with_one_lost(folder.path());
        let (mut feed, _) = Feed::start(stream, u64::MAX, fixture_view().1, || {});
        let until = |feed: &mut Feed, is_there: &dyn Fn(&Streamed) -> bool| {
            while !is_there(&feed.streamed) {
                feed.next().unwrap();
                assert!(!feed.is_over());
                std::thread::yield_now();
            }
        };
        until(&mut feed, &|streamed| streamed.whole == 2 && streamed.lost == 1);
        let wait_for_polls = |count: usize| {
            let mut polls = 0;
            while polls < count {
                polls += server.take_afters().len();
                std::thread::yield_now();
            }
        };
        server.take_afters();
        wait_for_polls(1);
        let before = server.refused();
        wait_for_polls(2);
        assert_eq!(server.refused(), before, "nothing has landed, and the view is the same");
        std::fs::write(&chunk, bytes).unwrap();
        told.landed.push(0);
        server.tell(&told);
        until(&mut feed, &|streamed| streamed.whole == 3 && streamed.lost == 0);
    }

    #[test]
    fn view_that_never_rests_hears_of_clusters_that_land_and_of_the_end_of_a_bake() {
        const LIMIT: Duration = Duration::from_secs(60);
        let folder = tempfile::tempdir().unwrap();
        // While one is lost, there is always more to want.
        let (server, stream, mut told, (chunk, bytes)) = with_one_lost(folder.path());
        let (_, view) = fixture_view();
        let (feed, _) = Feed::start(stream, u64::MAX, view.clone(), || {});
        let until = |is_there: &dyn Fn(&Streamed) -> bool| {
            let start = Instant::now();
            for moved in (0_u16..1000).cycle() {
                let mut other = view.clone();
                other.camera.eye_m[0] += 1e-4 * f32::from(moved);
                feed.look(other);
                let piece = feed.pieces.recv_timeout(Duration::from_micros(100));
                if piece.is_ok_and(|piece| is_there(&piece.unwrap().streamed)) {
                    break;
                }
                assert!(start.elapsed() < LIMIT, "the light that is wanted has not come");
            }
        };
        until(&|streamed| streamed.whole == 2 && streamed.lost == 1);
        told.landed.push(1);
        server.tell(&told);
        until(&|streamed| streamed.whole == 6);
        std::fs::write(&chunk, bytes).unwrap();
        told.end(BakeState::Done, None);
        server.tell(&told);
        until(&Streamed::is_whole);
    }

    #[test]
    fn pieces_before_an_error_are_taken_and_then_the_error_once() {
        let (bake, view) = fixture_view();
        let (sender, pieces) = channel();
        let streamed =
            Streamed { bytes: 1, bytes_all: 2, clusters: 1, clusters_all: 2, ..Streamed::default() };
        let watched = Arc::new(Watched::new(view, u64::MAX));
        let mut feed = Feed { pieces, watched, streamed: Streamed::default(), held: None, is_over: false };
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
