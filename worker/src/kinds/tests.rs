//! The table of kinds, and kinds side by side.

mod cancel;

use std::collections::BTreeSet;

use lightkiln_proto::kinds::{Kind, Kinds};
use serde_json::{Value, json};

use super::*;

const FURNACE: &[u8] = include_bytes!("../../../tests/scenes/furnace.glb");

/// Settings of a small draft, as far as a kind has them.
fn small(kind: &dyn Kind, receivers: u32, rays: u32) -> Value {
    let all = [("receivers_target", receivers), ("transport_rays", rays)];
    let mut settings = json!({ "preset": "draft" });
    for (name, value) in all.into_iter().filter(|(name, _)| has(kind, name)) {
        settings[name] = value.into();
    }
    settings
}

fn has(kind: &dyn Kind, setting: &str) -> bool {
    kind.settings().iter().any(|row| row.name == setting)
}

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
    let ran: Vec<Vec<String>> = Kinds::new()
        .iter()
        // Without receivers there is no lightmap, and meshes have no places in one.
        .filter(|kind| has(*kind, "receivers_target"))
        .map(|kind| {
            let plan = kind.first_tasks(scene, &small(kind, 2000, 16)).unwrap();
            let mut ran = Vec::new();
            run.run(&runner, plan, |_| true, |task| ran.push(task.kind.clone())).unwrap();
            assert!(ran.iter().any(|task| task.starts_with(kind.name())), "{ran:?}");
            ran
        })
        .collect();
    let is_shared = |task: &&String| SceneTask::ALL.iter().any(|shared| shared.name() == task.as_str());
    assert_eq!(ran[0].iter().filter(is_shared).count(), SceneTask::ALL.len());
    // Patches of a thing that is looked at from around weigh their parts otherwise: its kind has them anew, and nothing else.
    let anew: Vec<&String> = ran[1..].iter().flatten().filter(is_shared).collect();
    assert_eq!(anew, [SceneTask::Patches.name()], "{ran:?}");
}

#[test]
fn plans_name_all_that_they_plan_in_their_keys() {
    let (progress, runner) = (Progress::new(), Runner::new(&BakeKinds::new()));
    for kind in Kinds::new().iter() {
        let mut run = LocalRun::new(1 << 30, &progress);
        let scene = run.shelf.put(FURNACE.to_vec());
        let first = kind.first_tasks(scene, &small(kind, 2000, 16)).unwrap();
        let plan = first.last().unwrap().clone();
        let known: BTreeSet<String> = first.iter().map(|task| task.kind.clone()).collect();
        let mut planned = BTreeSet::new();
        run.run(
            &runner,
            first,
            |_| true,
            |task| {
                if !known.contains(&task.kind) {
                    planned.insert(task.kind.clone());
                }
            },
        )
        .unwrap();
        assert!(!planned.is_empty());
        let named = plan.params["plans"].as_object().unwrap();
        let named: BTreeSet<String> = named.keys().cloned().collect();
        // Tasks of other kinds whose work a plan does itself are named as well.
        assert!(named.is_superset(&planned), "{}: {named:?}, not {planned:?}", kind.name());
    }
}

#[test]
fn bakes_that_differ_by_the_name_of_the_preset_share_the_transport() {
    let (progress, runner) = (Progress::new(), Runner::new(&BakeKinds::new()));
    for kind in Kinds::new().iter().filter(|kind| has(*kind, "transport_rays")) {
        let mut run = LocalRun::new(1 << 30, &progress);
        let scene = run.shelf.put(FURNACE.to_vec());
        let mut settings = kind.resolve(&small(kind, 2000, 16)).unwrap();
        let mut transported = |settings: &serde_json::Value| {
            let plan = kind.first_tasks(scene, settings).unwrap();
            let mut ran = Vec::new();
            run.run(&runner, plan, |_| true, |task| ran.push(task.kind.clone())).unwrap();
            ran.iter().filter(|task| task.ends_with(".transport")).count()
        };
        assert!(transported(&settings) > 0);
        settings["preset"] = json!("high");
        assert_eq!(transported(&settings), 0, "{}", kind.name());
        settings["transport_rays"] = json!(32);
        assert!(transported(&settings) > 0);
    }
}

#[test]
#[should_panic(expected = "two kinds are named")]
fn table_refuses_a_second_kind_of_a_name() {
    drop(BakeKinds::new().with(&prt::Prt));
}

#[test]
#[should_panic(expected = "two tasks are named 'scene.import'")]
fn table_refuses_a_kind_with_a_task_of_another() {
    struct Thief;
    impl BakeKind for Thief {
        fn name(&self) -> &'static str {
            "thief"
        }
        fn tasks(&self) -> Vec<TaskRow> {
            vec![TaskRow { name: SceneTask::Import.name(), run: scene::task::run }]
        }
        fn evaluated(
            &self,
            _: &BakeKinds,
            _: &Manifest,
            _: Vec<u8>,
            _: ChunkBytes,
            _: &Progress,
        ) -> Result<Box<dyn Evaluated>, EvaluationError> {
            Err(EvaluationError::UnknownKind { kind: self.name().to_owned() })
        }
    }
    drop(BakeKinds::new().with(&Thief));
}

#[test]
fn world_is_made_anew_up_to_the_task_that_is_named() {
    use lightkiln_proto::kinds::prt::{Settings, first_tasks, tasks};
    let settings = json!({ "preset": "draft", "receivers_target": 2000, "transport_rays": 16 });
    let settings = Settings::from_json(&settings).unwrap();
    let (kinds, progress) = (BakeKinds::new(), Progress::new());
    let made = |run: &[&str], up_to: &str| {
        let plan = |scene| first_tasks(scene, &settings);
        let first = FirstTasks { kinds: &kinds, plan, run, up_to, or_else: &[] };
        made_anew(first, FURNACE.to_vec(), &progress, |context, run| {
            let transport = run.output(tasks::TRANSPORT.name, "index");
            Ok((context.inputs.iter().map(|input| input.name.clone()).collect::<Vec<_>>(), transport))
        })
    };
    let (inputs, transport) = made(&[tasks::PLAN.name], tasks::TRANSPORT.name).unwrap();
    assert!(inputs.iter().any(|name| name == "patches/patches") && transport.is_none(), "{inputs:?}");
    // Tasks that a plan plans run too where they are named.
    let run = [tasks::PLAN.name, tasks::TRANSPORT.name, tasks::COLOUR.name, tasks::OVERVIEW.name];
    let (inputs, transport) = made(&run, tasks::ASSEMBLE.name).unwrap();
    assert!(inputs.iter().any(|name| name.ends_with("/index")) && transport.is_some(), "{inputs:?}");
    let error = made(&[tasks::PLAN.name], tasks::ASSEMBLE.name).unwrap_err();
    assert!(matches!(&error, EvaluationError::Prepare(_)), "{error}");
}
