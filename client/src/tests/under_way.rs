//! A bake under way as a source: clusters of its cells as they land, and at its end the light of a load at once.

use glam::{Vec3, Vec4};
use lightkiln_proto::api::BakeState;
use lightkiln_proto::kinds::{prt, sh};
use lightkiln_proto::manifest::{CLUSTERS, Manifest};
use lightkiln_proto::words::lod_from_text;

use super::fixture_view;
use crate::bake::LoadedBake;
use crate::error::{ClientError, Result};
use crate::fetch::{News, Source, chunk_path};
use crate::fixture::{BundleServer, Faults, Told, write_bundle};
use crate::kinds;
use crate::passes::compare::Difference;
use crate::passes::shade;
use crate::preview::{Backend, StreamedBake, View, render};
use crate::stream::{Baked, Budget, Streamed};

/// Cells of the fixture's seven clusters: one has none.
const CELLS: [&[usize]; 5] = [&[0, 1], &[2], &[], &[3, 4, 5], &[6]];

struct Farm {
    folder: tempfile::TempDir,
    server: BundleServer,
    source: Source,
    told: Told,
    manifest: Manifest,
}

impl Farm {
    /// A farm whose bake has an outline, and no cell yet.
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let manifest = write_bundle(folder.path(), prt::NAME);
        let told = Told::of(folder.path(), &manifest, &CELLS);
        let server = BundleServer::start(folder.path(), Faults::default());
        server.tell(&told);
        let source = server.source();
        Self { folder, server, source, told, manifest }
    }

    fn land(&mut self, cells: &[usize]) {
        self.told.landed.extend(cells);
        self.server.tell(&self.told);
    }

    fn end(&mut self, state: BakeState, failure: Option<&str>) {
        self.told.end(state, failure);
        self.server.tell(&self.told);
    }

    fn followed(&self) -> Result<StreamedBake> {
        let following = kinds::all().follow(&self.source)?.expect("the bake goes on");
        StreamedBake::follow(following, &kinds::all(), Budget::NONE)
    }

    /// All light of the bake, loaded at once.
    fn whole(&self, view: &View) -> Vec<[f32; 3]> {
        let bundle = Source::bundle(self.folder.path()).unwrap();
        drawn(&LoadedBake::load(&bundle, &kinds::all()).unwrap(), view)
    }
}

fn drawn(bake: &LoadedBake, view: &View) -> Vec<[f32; 3]> {
    render(bake, view, Backend::Cpu).unwrap().linear
}

fn energy(picture: &[[f32; 3]]) -> f32 {
    picture.iter().flatten().sum()
}

#[test]
fn clusters_that_land_in_any_order_end_as_the_light_of_a_load_at_once_bit_for_bit() {
    let (_, view) = fixture_view();
    for order in [&[0, 1, 2, 3, 4][..], &[4, 3, 2, 1, 0], &[3, 0, 4, 2, 1]] {
        let mut farm = Farm::new();
        let whole = farm.whole(&view);
        // Results that were there already land with the plan.
        farm.land(&order[..1]);
        let mut streamed = farm.followed().unwrap();
        let mut last = energy(&drawn(&streamed.bake, &view));
        for landed in 1..=CELLS.len() {
            streamed.refine(&view, Budget::NONE).unwrap();
            let come = streamed.streamed();
            assert_eq!(come.baked, Some(Baked { cells: landed as u64, cells_all: 5 }));
            let clusters: usize = order[..landed].iter().map(|cell| CELLS[*cell].len()).sum();
            assert_eq!((come.clusters, come.whole, come.clusters_all), (clusters, clusters, clusters));
            assert!(!come.is_whole(), "more is to come before the end");
            let now = energy(&drawn(&streamed.bake, &view));
            assert!(now >= last, "{now} after {last} with {landed} cells of {order:?}");
            last = now;
            farm.land(&order[landed..(landed + 1).min(order.len())]);
            streamed.hear(0).unwrap();
        }
        assert!(streamed.is_under_way());
        farm.end(BakeState::Done, None);
        streamed.hear(0).unwrap();
        streamed.refine(&view, Budget::NONE).unwrap();
        let come = streamed.streamed();
        assert!(come.is_whole() && !streamed.is_under_way(), "{come:?}");
        assert_eq!((come.bytes, come.clusters_all), (come.bytes_all, 7));
        assert_eq!(drawn(&streamed.bake, &view), whole, "{order:?}");
    }
}

#[test]
fn clusters_in_part_at_the_end_of_a_bake_are_gone_on_with_and_no_byte_comes_twice() {
    let (_, view) = fixture_view();
    let mut farm = Farm::new();
    farm.land(&[4, 3, 0]);
    let mut streamed = farm.followed().unwrap();
    let all = streamed.streamed().bytes_all;
    streamed.refine(&view, Budget { step: (all - streamed.streamed().bytes) / 2, ..Budget::NONE }).unwrap();
    let part = streamed.streamed();
    assert!(part.clusters > 0 && part.whole < part.clusters_all, "{part:?}");
    farm.server.take_asked();
    farm.end(BakeState::Done, None);
    streamed.hear(0).unwrap();
    let ended = streamed.streamed();
    assert_eq!((ended.clusters, ended.whole, ended.clusters_all), (part.clusters, part.whole, 7));
    assert!(ended.memory_least > part.memory_least, "the overview has come");
    let first = energy(&drawn(&streamed.bake, &view)) / energy(&farm.whole(&view));
    assert!((first - 1.0).abs() < 0.2, "the overview stands for clusters that have not come: {first}");
    streamed.refine(&view, Budget::NONE).unwrap();
    let asked: u64 = farm.server.take_asked().iter().map(|asked| asked.sent as u64).sum();
    let pages_and_overview = farm.manifest.bytes() - farm.manifest.bytes_light();
    assert!(asked <= streamed.streamed().bytes_all - part.bytes + pages_and_overview, "{asked}");
    assert_eq!(drawn(&streamed.bake, &view), farm.whole(&view));
}

#[test]
fn bake_without_a_cell_shows_direct_light_alone() {
    let (_, mut view) = fixture_view();
    let farm = Farm::new();
    let mut streamed = farm.followed().unwrap();
    streamed.refine(&view, Budget::NONE).unwrap();
    assert_eq!(streamed.streamed().clusters_all, 0);
    let first = drawn(&streamed.bake, &view);
    assert!((0.1..0.95).contains(&(energy(&first) / energy(&farm.whole(&view)))));
    view.lod = Some(lod_from_text("coarse").unwrap());
    assert_eq!(drawn(&streamed.bake, &view), first, "there is no detail to leave out");
    // Colours and objects of bakes under way are those of any bake.
    let too_few = Budget { memory: streamed.streamed().memory_least - 1, ..Budget::NONE };
    let following = kinds::all().follow(&farm.source).unwrap().unwrap();
    let error = StreamedBake::follow(following, &kinds::all(), too_few).err().unwrap();
    assert!(matches!(error, ClientError::Argument { .. }), "{error}");
}

#[test]
#[ignore = "needs a graphics adapter"]
fn adapter_draws_a_bake_without_a_cell_as_the_processor_does() {
    let (_, view) = fixture_view();
    let mut farm = Farm::new();
    let mut streamed = farm.followed().unwrap();
    for cells in [&[][..], &[3], &[0, 1]] {
        farm.land(cells);
        streamed.hear(0).unwrap();
        streamed.refine(&view, Budget::NONE).unwrap();
        let pictures = [Backend::Gpu, Backend::Cpu].map(|backend| {
            let linear = render(&streamed.bake, &view, backend).unwrap().linear;
            linear.into_iter().map(|pixel| Vec3::from(pixel).extend(0.0)).collect::<Vec<Vec4>>()
        });
        let difference = Difference::of_mean(&pictures[0], &pictures[1], shade::TOLERANCE);
        assert!(difference.agrees(2.0 * shade::OUTLIERS), "{difference:?} with cells {cells:?}");
    }
    let detailed = View { lod: Some(lod_from_text("coarse").unwrap()), ..view };
    let bare = Farm::new().followed().unwrap();
    render(&bare.bake, &detailed, Backend::Gpu).unwrap();
}

#[test]
fn page_whose_bytes_are_lost_comes_again_with_its_task() {
    let (_, view) = fixture_view();
    let mut farm = Farm::new();
    let mut streamed = farm.followed().unwrap();
    let page = chunk_path(farm.folder.path(), farm.told.page(3));
    let bytes = std::fs::read(&page).unwrap();
    std::fs::remove_file(&page).unwrap();
    farm.land(&[3, 1]);
    streamed.hear(0).unwrap();
    assert_eq!(streamed.streamed().baked.unwrap().cells, 1);
    std::fs::write(&page, bytes).unwrap();
    // The task has run again; of the other, which is told again, nothing comes twice.
    farm.land(&[3, 1]);
    streamed.hear(0).unwrap();
    streamed.refine(&view, Budget::NONE).unwrap();
    let come = streamed.streamed();
    assert_eq!((come.baked.unwrap().cells, come.clusters, come.clusters_all), (2, 4, 4));
}

/// Bytes of a cluster that a server answers instead of its own: none, or those with a bit turned over.
fn damaged(path: &std::path::Path, is_gone: bool) -> Vec<u8> {
    let bytes = std::fs::read(path).unwrap();
    if is_gone {
        std::fs::remove_file(path).unwrap();
    } else {
        let mut other = bytes.clone();
        *other.last_mut().unwrap() ^= 1;
        std::fs::write(path, other).unwrap();
    }
    bytes
}

#[test]
fn clusters_that_are_lost_hold_no_other_up_are_told_of_and_come_with_their_task() {
    let (_, view) = fixture_view();
    for is_gone in [true, false] {
        let mut farm = Farm::new();
        farm.land(&[0, 3]);
        // The first that is asked for, of four.
        let path = chunk_path(farm.folder.path(), farm.manifest.chunks(CLUSTERS)[0].digest);
        let bytes = damaged(&path, is_gone);
        let mut streamed = farm.followed().unwrap();
        let bare = energy(&drawn(&streamed.bake, &view));
        streamed.refine(&view, Budget::NONE).unwrap();
        let come = streamed.streamed();
        assert_eq!((come.whole, come.clusters_all, come.lost), (4, 5, 1), "gone: {is_gone}");
        let part = energy(&drawn(&streamed.bake, &view));
        assert!(part > bare, "the others show: {part} after {bare}");
        assert!(!streamed.hear(0).unwrap());
        std::fs::write(&path, bytes).unwrap();
        farm.land(&[0, 4]);
        assert!(streamed.hear(0).unwrap());
        streamed.refine(&view, Budget::NONE).unwrap();
        let come = streamed.streamed();
        assert_eq!((come.whole, come.clusters_all, come.lost), (6, 6, 0), "gone: {is_gone}");
        assert!(energy(&drawn(&streamed.bake, &view)) > part);
        // Of a bake that is done nothing comes again.
        damaged(&chunk_path(farm.folder.path(), farm.manifest.chunks(CLUSTERS)[2].digest), is_gone);
        farm.land(&[1]);
        streamed.hear(0).unwrap();
        farm.end(BakeState::Done, None);
        streamed.hear(0).unwrap();
        let error = streamed.refine(&view, Budget::NONE).unwrap_err();
        assert!(matches!(error, ClientError::Call(_) | ClientError::WrongDigest { .. }), "{error}");
    }
}

#[test]
fn clusters_that_are_lost_take_no_share_of_bytes_or_memory_from_those_that_are_not() {
    let (_, view) = fixture_view();
    // One of the two at least is not the one that is needed most.
    for kept in [0, 6] {
        let mut farm = Farm::new();
        farm.land(&[0, 1, 2, 3, 4]);
        for (index, chunk) in farm.manifest.chunks(CLUSTERS).iter().enumerate() {
            if index != kept {
                std::fs::remove_file(chunk_path(farm.folder.path(), chunk.digest)).unwrap();
            }
        }
        let refined = |budget_of: &dyn Fn(Streamed) -> Budget| {
            let mut streamed = farm.followed().unwrap();
            let before = streamed.streamed();
            streamed.refine(&view, budget_of(before)).unwrap();
            streamed.streamed()
        };
        let all = refined(&|_| Budget::NONE);
        assert_eq!((all.whole, all.lost), (1, 6));
        let budgets: [&dyn Fn(Streamed) -> Budget; 3] = [
            &|_| Budget::of_bytes(all.bytes),
            &|_| Budget { memory: all.memory, ..Budget::NONE },
            &|before| Budget { step: all.bytes - before.bytes, ..Budget::NONE },
        ];
        for (at, budget_of) in budgets.into_iter().enumerate() {
            let come = refined(budget_of);
            assert_eq!((come.whole, come.bytes), (1, all.bytes), "budget {at} with cluster {kept} there");
        }
    }
}

#[test]
fn overview_beyond_the_memory_of_the_budget_is_refused_at_the_end_of_a_bake_as_of_one_that_is_done() {
    let (_, view) = fixture_view();
    let mut farm = Farm::new();
    farm.land(&[0, 1, 2, 3, 4]);
    let bundle = Source::bundle(farm.folder.path()).unwrap();
    let least = |stream: &StreamedBake| stream.streamed().memory_least;
    let memory = least(&StreamedBake::begin(&bundle, &kinds::all(), Budget::NONE).unwrap()) - 1;
    let budget = Budget { memory, ..Budget::NONE };
    let done = StreamedBake::begin(&bundle, &kinds::all(), budget).err().unwrap().to_string();
    let following = kinds::all().follow(&farm.source).unwrap().unwrap();
    let mut streamed = StreamedBake::follow(following, &kinds::all(), budget).unwrap();
    assert!(least(&streamed) <= memory, "patches alone fit");
    streamed.refine(&view, budget).unwrap();
    let shown = drawn(&streamed.bake, &view);
    farm.end(BakeState::Done, None);
    assert_eq!(streamed.hear(0).unwrap_err().to_string(), done);
    assert_eq!(drawn(&streamed.bake, &view), shown, "the light stays");
}

#[test]
fn results_are_looked_at_once() {
    let mut farm = Farm::new();
    let mut following = kinds::all().follow(&farm.source).unwrap().unwrap();
    let after = |farm: &Farm| farm.server.take_afters();
    farm.land(&[3, 0, 2]);
    assert_eq!(following.hear(0).unwrap(), News::More);
    // Pages have two results each, at places 13, 16 and 19.
    assert_eq!(after(&farm), [0, 0, 16, 19]);
    assert_eq!(following.hear(0).unwrap(), News::None);
    // Results of other kinds land.
    farm.told.others = 5;
    farm.server.tell(&farm.told);
    assert_eq!([following.hear(0).unwrap(), following.hear(0).unwrap()], [News::None; 2]);
    assert_eq!(after(&farm), [19, 19, 24]);
}

#[test]
fn results_that_end_where_they_begin_are_refused() {
    let mut farm = Farm::new();
    let mut following = kinds::all().follow(&farm.source).unwrap().unwrap();
    assert_eq!(following.hear(0).unwrap(), News::More);
    farm.told.stands_still = true;
    farm.land(&[3]);
    let error = following.hear(0).unwrap_err().to_string();
    assert!(error.contains("inconsistent") && error.contains("end at place"), "{error}");
}

#[test]
fn bakes_that_end_without_their_light_say_how() {
    let problem = |farm: &Farm| farm.followed().err().unwrap();
    let mut farm = Farm::new();
    let mut streamed = farm.followed().unwrap();
    farm.end(BakeState::Failed, Some("the scene has no surface"));
    let after = streamed.hear(0).unwrap_err();
    for error in [problem(&farm), after] {
        assert!(error.to_string().contains("failed: the scene has no surface"), "{error}");
        assert!(matches!(error, ClientError::Ended { state: Some(BakeState::Failed), .. }));
    }
    farm.end(BakeState::Cancelled, None);
    assert!(problem(&farm).to_string().contains("was cancelled"));
    farm.told.is_deleted = true;
    farm.server.tell(&farm.told);
    let deleted = streamed.hear(0).unwrap_err().to_string();
    assert!(deleted.contains("deleted"), "{deleted}");

    let mut early = Farm::new();
    early.told.has_outline = false;
    early.server.tell(&early.told);
    let error = problem(&early).to_string();
    assert!(error.contains("no scene to draw yet"), "{error}");

    let mut old = Farm::new();
    old.told.lose_outline();
    old.server.tell(&old.told);
    let error = problem(&old).to_string();
    assert!(error.contains("plan of an earlier version") && error.contains("kiln watch"), "{error}");
    old.land(&[0, 1, 2, 3, 4]);
    old.end(BakeState::Done, None);
    assert!(kinds::all().follow(&old.source).unwrap().is_none(), "it is seen at its end");

    let mut other = Farm::new();
    other.told.bake.kind = sh::NAME.to_owned();
    other.server.tell(&other.told);
    let error = kinds::all().follow(&other.source).err().unwrap().to_string();
    assert!(error.contains("kind sh") && error.contains("kiln watch"), "{error}");
    other.end(BakeState::Done, None);
    assert!(kinds::all().follow(&other.source).unwrap().is_none(), "a bake that is done is as any other");
}

#[test]
fn manifest_of_another_scene_than_the_outlines_is_refused() {
    let mut farm = Farm::new();
    let mut streamed = farm.followed().unwrap();
    let mut other = farm.manifest.clone();
    other.bounds_m[1][0] += 1.0;
    crate::fixture::rewrite_manifest(farm.folder.path(), other);
    farm.end(BakeState::Done, None);
    let error = streamed.hear(0).unwrap_err().to_string();
    assert!(error.contains("outline"), "{error}");
}
