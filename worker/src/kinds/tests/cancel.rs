//! Tasks hear a cancel soon: counted in rays between two looks for it, not in time.

use std::collections::BTreeMap;

use super::super::*;
use super::small;
use lightkiln_proto::kinds::Kinds;

const CORNELL: &[u8] = include_bytes!("../../../../tests/scenes/cornell.glb");
/// Tasks that end within moments whatever the scene: they copy what is there.
const BRIEF: [&str; 11] = [
    "scene.frame",
    "scene.draw",
    "prt.plan",
    "prt.assemble",
    "transfer.plan",
    "transfer.assemble",
    "voxels.plan",
    "voxels.assemble",
    "sh.assemble",
    "captured.assemble",
    "scene.import",
];
/// Most rays between two looks: a few milliseconds.
const RAYS_MAX: u64 = 20_000;

/// A task with what it reads.
struct Ready {
    task: TaskSpec,
    inputs: Vec<Artefact>,
}

#[test]
fn every_task_looks_for_a_cancel_between_any_few_rays_and_ends_at_once() {
    let runner = Runner::new(&BakeKinds::new());
    let mut looked = 0;
    for kind in Kinds::new().iter() {
        let progress = Progress::new();
        let mut run = LocalRun::new(1 << 30, &progress);
        let scene = run.shelf.put(CORNELL.to_vec());
        let mut ready: BTreeMap<String, Ready> = BTreeMap::new();
        let mut plan = kind.first_tasks(scene, &small(kind, 6000, 64)).unwrap();
        // Kind by kind, so that the inputs of the first task of each are at hand.
        while let Some(next) = plan.iter().position(|task| run.is_ready(task)) {
            let task = plan.remove(next);
            if ready.contains_key(&task.kind) && task.kind.ends_with(".transport") {
                continue;
            }
            let inputs = run.resolved(&task);
            let name = task.kind.clone();
            ready.entry(name).or_insert(Ready { task: task.clone(), inputs });
            let left = run.run(&runner, vec![task.clone()], |kind| kind == task.kind, |_| {}).unwrap();
            plan.extend(left);
        }
        for (name, Ready { task, inputs }) in &ready {
            let run_with = |progress: &Progress| {
                let memory = MemoryCache::new(1 << 30);
                runner.run(task, inputs, &[], &run.shelf, &memory, progress)
            };
            let whole = Progress::new();
            run_with(&whole).unwrap();
            if BRIEF.contains(&name.as_str()) {
                continue;
            }
            let (checks, rays) = (whole.checks(), whole.rays().total());
            assert!(checks > 0 && rays / checks <= RAYS_MAX, "{name}: {checks} looks, {rays} rays");
            for share in [0.01, 0.3, 0.6, 0.95] {
                let early = Progress::cancelled_at(1 + (share * checks as f64) as u64);
                let outcome = run_with(&early);
                assert!(
                    matches!(outcome, Err(TaskError::Cancelled(_))),
                    "{name} at {share}: {:?}",
                    outcome.err()
                );
                // Other threads may be between two looks.
                let after = early.checks() - (1 + (share * checks as f64) as u64);
                assert!(after <= 256, "{name} at {share}: {after} looks more");
                looked += 1;
            }
        }
    }
    assert!(looked >= 20, "{looked}");
}
