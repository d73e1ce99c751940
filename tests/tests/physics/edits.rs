//! A scene that was edited is baked again: as far as nothing has changed from what rays met, results are those of before, and all
//! bytes are those of a bake that knows nothing of it.

use std::sync::Mutex;

use glam::Vec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::{Artefact, TaskSpec};
use lightkiln_tests::harness::{Bakery, Rebaked, Recipe, bake};
use lightkiln_tests::scenes::{FLAT_WALL_M, Flat, Thing, flat};
use lightkiln_worker::kinds::{BakeKinds, Runner};
use lightkiln_worker::rays::sampling::Sequence;
use lightkiln_worker::task::{ArtefactSource, MemoryCache, Progress, TaskError, TaskOutput, TaskRunner};

use super::setup::small;

/// Receivers of the flat, about; and of one that is edited many times.
const RECEIVERS: u32 = 3000;
const FEW_RECEIVERS: u32 = 1500;

/// Labels of a bake's transport tasks with whether each took the result of one before.
fn kept(rebaked: &Rebaked) -> Vec<(&str, bool)> {
    kept_of(rebaked, "cluster ")
}

/// Receivers of tasks that ran though there were results of tasks alike: those traced, and all.
fn traced(rebaked: &Rebaked) -> [usize; 2] {
    let of_task = |(_, note): &(String, String)| {
        let (traced, rest) = note.split_once(" of ")?;
        let all = rest.split_once(" receivers traced: ")?.0;
        Some([traced.parse::<usize>().ok()?, all.parse().ok()?])
    };
    rebaked.notes.iter().filter_map(of_task).fold([0; 2], |sum, task| [sum[0] + task[0], sum[1] + task[1]])
}

/// Lower and upper x of the cell that a task is named by.
fn along_x_m(label: &str) -> [f32; 2] {
    let corners = label.trim_start_matches("cluster ").split("..");
    let x = |corner: &str| corner.split(',').next().unwrap().parse().unwrap();
    corners.map(x).collect::<Vec<f32>>().try_into().unwrap()
}

fn assert_is_whole_bake(of: &Flat, recipe: &Recipe, rebaked: &Rebaked, what: &str) {
    let whole = bake(flat(of), recipe).unwrap();
    let [was, is] =
        [&whole.manifest_bytes, &rebaked.manifest_bytes].map(|bytes| String::from_utf8_lossy(bytes));
    assert!(was == is, "{what}: other bytes than those of a whole bake: {:?}", rebaked.notes);
}

#[test]
fn chair_that_is_moved_leaves_the_tasks_of_rooms_that_do_not_see_it_alone() {
    let progress = Progress::new();
    let mut bakery = Bakery::new(&small("prt", RECEIVERS), &progress);
    let mut of = Flat::default();
    let first = bakery.bake(flat(&of)).unwrap();
    assert!(kept(&first).iter().all(|(_, kept)| !kept));
    of.things[0].at_m += Vec3::new(0.3, 0.0, -0.1);
    let second = bakery.bake(flat(&of)).unwrap();
    let far: Vec<_> =
        kept(&second).into_iter().filter(|(label, _)| along_x_m(label)[0] >= FLAT_WALL_M).collect();
    assert!(far.len() > 2 && far.iter().all(|(_, kept)| *kept), "{:#?}", second.notes);
    assert!(kept(&second).iter().any(|(_, kept)| !kept), "the chair's own room is as it was");
    assert_is_whole_bake(&of, &small("prt", RECEIVERS), &second, "chair moved");
}

#[test]
fn receivers_whose_rays_met_nothing_that_changed_are_not_traced_again() {
    let progress = Progress::new();
    let mut bakery = Bakery::new(&small("prt", RECEIVERS), &progress);
    let mut of = Flat::default();
    let first = bakery.bake(flat(&of)).unwrap();
    of.things[0].at_m += Vec3::new(0.1, 0.0, 0.0);
    let second = bakery.bake(flat(&of)).unwrap();
    let [again, all] = traced(&second);
    assert!(again > 0 && again * 4 < all * 3, "{again} of {all}: {:#?}", second.notes);
    assert!(second.rays < first.rays, "{} rays of {}", second.rays, first.rays);
    assert_is_whole_bake(&of, &small("prt", RECEIVERS), &second, "chair moved a little");
    // Rows that were taken over are there for the next bake too.
    of.things[0].at_m += Vec3::new(0.1, 0.0, 0.0);
    let third = bakery.bake(flat(&of)).unwrap();
    let [again, all] = traced(&third);
    assert!(again > 0 && again * 4 < all * 3, "{again} of {all}: {:#?}", third.notes);
    assert_is_whole_bake(&of, &small("prt", RECEIVERS), &third, "chair moved again");
}

/// Labels of a bake's tasks of probes with whether each took the result of one before.
fn kept_fields(rebaked: &Rebaked) -> Vec<(&str, bool)> {
    kept_of(rebaked, "field ")
}

/// The same of tasks whose labels begin so.
fn kept_of<'a>(rebaked: &'a Rebaked, begin: &str) -> Vec<(&'a str, bool)> {
    let wanted = rebaked.notes.iter().filter(|(label, _)| label.starts_with(begin));
    wanted.map(|(label, note)| (label.as_str(), note.starts_with("as before"))).collect()
}

#[test]
fn probes_whose_rays_met_nothing_that_changed_are_those_of_before() {
    probes_of_before("grid");
}

#[test]
fn so_are_those_of_a_cloud() {
    probes_of_before("cloud");
}

fn probes_of_before(kind: &'static str) {
    let progress = Progress::new();
    let mut recipe = small(kind, FEW_RECEIVERS).with("field_spacing_m", 0.75).with("probe_rays", 128);
    // Its things have the light of probes.
    recipe = recipe.with("field_rank_error", 0.1).with("probe_lit_m", 1.5);
    let mut bakery = Bakery::new(&recipe, &progress);
    let mut of = Flat::default();
    let first = bakery.bake(flat(&of)).unwrap();
    assert!(kept_fields(&first).iter().all(|(_, kept)| !kept), "nothing was before: {:#?}", first.notes);
    of.things[0].at_m += Vec3::new(0.3, 0.0, -0.1);
    let moved = bakery.bake(flat(&of)).unwrap();
    let fields = kept_fields(&moved);
    let again = fields.iter().filter(|(_, kept)| !kept).count();
    println!("{again} of {} tasks of probes ran again", fields.len());
    assert!(again > 0, "the chair's own room is as it was");
    let far: Vec<_> = fields.iter().filter(|(_, kept)| *kept).map(|(label, _)| field_x_m(label)).collect();
    // Light of the chair's own room comes through the door to most of the flat.
    assert!(!far.is_empty() && far.iter().all(|x_m| *x_m >= FLAT_WALL_M), "{far:?}: {:#?}", moved.notes);
    assert_is_whole_bake(&of, &recipe, &moved, "chair moved");
    // Colours of surfaces say nothing of what rays meet; those of lamps are in what probes hold.
    of.colours[0] = [0.1, 0.3, 0.7];
    let coloured = bakery.bake(flat(&of)).unwrap();
    assert!(kept_fields(&coloured).iter().all(|(_, kept)| *kept), "{:#?}", coloured.notes);
    let lit = kept_of(&coloured, "cluster lit ");
    assert!(!lit.is_empty() && lit.iter().all(|(_, kept)| *kept), "{:#?}", coloured.notes);
    assert_is_whole_bake(&of, &recipe, &coloured, "a colour changed");
    of.lamps = [[5.0, 7.0, 9.0], [3.0, 5.5, 0.5]];
    let relit = bakery.bake(flat(&of)).unwrap();
    assert!(kept_fields(&relit).iter().any(|(_, kept)| !kept), "{:#?}", relit.notes);
    assert_is_whole_bake(&of, &recipe, &relit, "lamps changed");
}

/// Lower x of the cell of probes that a task is named by.
fn field_x_m(label: &str) -> f32 {
    let corner = label.trim_start_matches("field ").split("..").next().unwrap();
    corner.split(',').next().unwrap().parse().unwrap()
}

/// Faults of a farm that rows may have.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// The store has lost them.
    Lost,
    /// They are bytes of something else.
    Other,
    /// They are those of another cell.
    Swapped,
}

/// A runner whose tasks find rows at fault.
struct AtFault {
    runner: Runner,
    fault: Fault,
    last: Mutex<Option<Artefact>>,
}

impl AtFault {
    fn with_fault(&self, outputs: &[Artefact]) -> Vec<Artefact> {
        let mut outputs = outputs.to_vec();
        let record = outputs.iter().find(|output| output.name == "record").map(|record| record.digest);
        let rows = outputs.iter_mut().find(|output| output.name == "rows").expect("transport leaves rows");
        let own = rows.clone();
        match self.fault {
            Fault::Lost => rows.digest = Digest::of(b"lost"),
            Fault::Other => rows.digest = record.expect("transport leaves a record"),
            Fault::Swapped => {
                let other = self.last.lock().unwrap().replace(own);
                rows.digest = other.map_or(Digest::of(b"none yet"), |other| other.digest);
            }
        }
        outputs
    }
}

impl TaskRunner for AtFault {
    fn kinds(&self) -> Vec<String> {
        self.runner.kinds()
    }

    fn run(
        &self,
        task: &TaskSpec,
        inputs: &[Artefact],
        alike: &[Vec<Artefact>],
        source: &dyn ArtefactSource,
        memory: &MemoryCache,
        progress: &Progress,
    ) -> Result<TaskOutput, TaskError> {
        let alike: Vec<_> = alike.iter().map(|outputs| self.with_fault(outputs)).collect();
        self.runner.run(task, inputs, &alike, source, memory, progress)
    }
}

#[test]
fn rows_that_are_lost_or_not_what_they_should_be_are_traced_again() {
    for fault in [Fault::Lost, Fault::Other, Fault::Swapped] {
        let progress = Progress::new();
        let mut bakery = Bakery::new(&small("prt", FEW_RECEIVERS), &progress);
        let mut of = Flat::default();
        bakery.bake(flat(&of)).unwrap();
        of.things[0].at_m += Vec3::new(0.1, 0.0, 0.0);
        let at_fault = AtFault { runner: Runner::new(&BakeKinds::new()), fault, last: Mutex::default() };
        let rebaked = bakery.bake_by(&at_fault, flat(&of)).unwrap();
        let [again, all] = traced(&rebaked);
        assert!(again == all && all > 0, "{fault:?}: {again} of {all}");
        assert!(kept(&rebaked).iter().any(|(_, kept)| *kept), "{fault:?}: whole results need no rows");
        assert_is_whole_bake(&of, &small("prt", FEW_RECEIVERS), &rebaked, "rows at fault");
    }
}

#[test]
fn colour_texture_and_light_that_change_leave_all_tasks_alone() {
    let progress = Progress::new();
    let mut bakery = Bakery::new(&small("prt", RECEIVERS), &progress);
    let mut of = Flat::default();
    let first = bakery.bake(flat(&of)).unwrap();
    of.colours[0] = [0.1, 0.3, 0.7];
    of.colours[2] = [0.2, 0.2, 0.5];
    of.lamps = [[5.0, 7.0, 9.0], [3.0, 5.5, 0.5]];
    of.stripes = 7;
    of.light_m += Vec3::X;
    let second = bakery.bake(flat(&of)).unwrap();
    assert!(kept(&second).iter().all(|(_, kept)| *kept), "{:#?}", second.notes);
    assert_eq!(kept(&second).len(), kept(&first).len());
    assert_ne!(first.manifest_bytes, second.manifest_bytes);
    assert_is_whole_bake(&of, &small("prt", RECEIVERS), &second, "colours changed");
}

#[test]
fn bake_after_random_edits_has_the_bytes_of_a_whole_one() {
    let progress = Progress::new();
    // Rows have near hits too.
    let recipe = small("prt", FEW_RECEIVERS).with("near_hits", 8);
    let mut bakery = Bakery::new(&recipe, &progress);
    let mut of = Flat::default();
    bakery.bake(flat(&of)).unwrap();
    let mut sequence = Sequence::new(17);
    let (mut kept_in_all, mut rows_kept) = (0, 0);
    for edit in 0..8 {
        let what = edited(&mut of, edit, &mut sequence);
        let rebaked = bakery.bake(flat(&of)).unwrap();
        kept_in_all += kept(&rebaked).iter().filter(|(_, kept)| *kept).count();
        let [again, all] = traced(&rebaked);
        rows_kept += all - again;
        assert_is_whole_bake(&of, &recipe, &rebaked, what);
    }
    assert!(kept_in_all > 20, "{kept_in_all} results of before were taken");
    assert!(rows_kept > 200, "{rows_kept} rows of before were taken");
}

/// Changes something: each kind of edit in turn, of a random thing.
fn edited(of: &mut Flat, edit: usize, sequence: &mut Sequence) -> &'static str {
    let mut number = || sequence.next_f32();
    let place = Vec3::new(number() * 7.0 - 3.5, 0.0, number() * 2.4 - 1.2);
    let one = |count: usize, number: f32| ((count as f32 * number) as usize).min(count - 1);
    let thing = one(of.things.len(), number());
    let colour = [number(), number(), number()].map(|channel| 0.1 + 0.8 * channel);
    match edit % 8 {
        0 => {
            of.things[thing].at_m = place;
            "a thing moved"
        }
        1 => {
            let size_m = Vec3::new(0.2 + number(), 0.2 + number(), 0.2 + number());
            let name = format!("thing {edit}");
            of.things.insert(thing, Thing { name, at_m: place, size_m, yaw_rad: number(), colour: 0 });
            "a thing added before others"
        }
        2 => {
            let chosen = one(of.colours.len(), number());
            of.colours[chosen] = colour;
            "a colour changed"
        }
        3 => {
            of.things.remove(thing);
            "a thing removed"
        }
        4 => {
            of.stripes += 3;
            "a texture changed"
        }
        5 => {
            of.light_m = place + Vec3::Y;
            "a light moved"
        }
        6 => {
            of.lamps[thing % 2] = colour.map(|channel| 10.0 * channel);
            "a lamp's colour changed"
        }
        _ => {
            of.pane = 0.2 + 0.6 * number();
            "glass changed"
        }
    }
}
