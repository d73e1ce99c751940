//! The table of kinds, and kinds side by side.

use std::collections::BTreeSet;

use lightkiln_proto::kinds::Kinds;
use serde_json::json;

use super::*;

const FURNACE: &[u8] = include_bytes!("../../../tests/scenes/furnace.glb");

#[test]
fn every_kind_of_the_contract_has_its_tasks_here_and_no_task_two_runners() {
    let kinds = BakeKinds::new();
    assert!(Kinds::new().iter().all(|kind| kinds.get(kind.name()).is_some()));
    let names = Runner::new(&kinds).kinds();
    assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len(), "{names:?}");
    assert!(names.len() > SceneTask::ALL.len());
}

#[test]
fn bakes_of_two_kinds_of_one_scene_share_the_tasks_over_it() {
    let (progress, runner) = (Progress::new(), Runner::new(&BakeKinds::new()));
    let mut run = LocalRun::new(1 << 30, &progress);
    let scene = run.shelf.put(FURNACE.to_vec());
    let settings = json!({ "preset": "draft", "receivers_target": 2000, "transport_rays": 16 });
    let ran: Vec<Vec<String>> = Kinds::new()
        .iter()
        .map(|kind| {
            let plan = kind.first_tasks(scene, &settings).unwrap();
            let mut ran = Vec::new();
            run.run(&runner, plan, |_| true, |task| ran.push(task.kind.clone())).unwrap();
            assert!(ran.iter().any(|task| task.starts_with(kind.name())), "{ran:?}");
            ran
        })
        .collect();
    let is_shared = |task: &&String| SceneTask::ALL.iter().any(|shared| shared.name() == task.as_str());
    assert_eq!(ran[0].iter().filter(is_shared).count(), SceneTask::ALL.len());
    assert!(!ran[1..].iter().flatten().any(|task| is_shared(&task)), "{ran:?}");
}
