//! The tasks of random histories: what each needs, names, plans and gives.

use lightkiln_proto::api::BakeLimits;
use lightkiln_proto::jobs::{TaskInput, TaskResult, TaskSpec};

use crate::support::{output, outputs, task_of};

/// Tasks of the universe.
pub const TASKS: usize = 12;
/// Dependencies of each task; all come before it.
pub const NEEDS: [&[usize]; TASKS] =
    [&[], &[], &[0], &[0, 1], &[2], &[3], &[3, 4], &[], &[7], &[1], &[], &[10]];
/// Plans of the tasks; task 7 plans one that needs task 5, which its bake may not hold.
pub const PLANS: [&[usize]; TASKS] = [&[1, 2], &[9], &[4], &[5], &[], &[], &[], &[8, 7], &[], &[], &[], &[]];
/// Which of the outputs each task names.
pub const NAMES: [&[u8]; TASKS] = [&[], &[], &[], &[], &[], &[0], &[], &[], &[1], &[0, 2], &[2], &[3, 1]];

pub fn universe() -> Vec<TaskSpec> {
    let mut tasks: Vec<TaskSpec> = Vec::new();
    for (index, needs) in NEEDS.iter().enumerate() {
        let needs: Vec<&TaskSpec> = needs.iter().map(|needs| &tasks[*needs]).collect();
        let kind = if index % 3 == 2 { "more" } else { "work" };
        let TaskSpec { kind, label, params, mut inputs, cost, .. } =
            task_of(kind, &format!("task {index}"), &needs, index as u64 % 4);
        for number in NAMES[index] {
            inputs.push(TaskInput::Artefact { name: format!("named {number}"), digest: output(*number) });
        }
        tasks.push(TaskSpec::new(&kind, 1, label, params, inputs, cost));
    }
    tasks
}

/// Limits of a bake, by the first task that was chosen.
pub fn limits_of(task: usize) -> BakeLimits {
    BakeLimits {
        max_workers: [6, 7].contains(&task).then_some(1),
        attempts: [0, 7].contains(&task).then_some(1),
        lost_workers: (task == 8).then_some(2),
    }
}

/// Share of a bake's results that are verified, by the first task that was chosen.
pub fn share_of(task: usize) -> f64 {
    match task {
        1 | 2 | 3 | 9 => 1.0,
        5 => 0.5,
        _ => 0.0,
    }
}

/// Machine of a worker: two share one, and one cannot tell.
pub fn machine_of(worker: u8) -> String {
    ["oven", "oven", "hob", ""][usize::from(worker) % 4].to_owned()
}

/// The chosen tasks, with all that they need if the plan is to be closed.
pub fn plan_of(chosen: &[usize], is_closed: bool, tasks: &[TaskSpec]) -> Vec<TaskSpec> {
    let mut numbers = chosen.to_vec();
    let mut next = 0;
    while is_closed && next < numbers.len() {
        numbers.extend(NEEDS[numbers[next]]);
        next += 1;
    }
    numbers.into_iter().map(|number| tasks[number].clone()).collect()
}

pub fn result_of(task: &TaskSpec, tasks: &[TaskSpec]) -> TaskResult {
    let number = tasks.iter().position(|known| known.key == task.key).expect("a task of the universe");
    let plan = PLANS[number].iter().map(|planned| tasks[*planned].clone()).collect();
    let counters = [("rays".to_owned(), 0.1 * number as f64)].into();
    TaskResult { outputs: outputs(task.key), plan, counters, ..TaskResult::default() }
}
