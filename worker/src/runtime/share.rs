//! How a worker's threads are shared among the tasks that it has in hand.
//!
//! A task has steps for one thread and steps for many, and few parts to share out in the latter: two tasks keep few threads
//! busy, however many there are. So a worker of many threads has many tasks in hand, each with a few threads.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::{ThreadPool, ThreadPoolBuildError};

/// Threads that tasks have in all, over those of the worker: about half of a task's threads wait, for a step that is not
/// parallel or for the server. More → less idle time, more tasks that keep each other waiting.
const THREADS_FACTOR: usize = 2;
/// Threads of a task in the usual number of tasks.
const USUAL_THREADS: usize = 4;
/// Most tasks in hand where nobody says: each is a thread, a lease and a cell's rows.
const USUAL_TASKS_MAX: usize = 64;

/// Tasks in hand at a time where nobody says: two, but one where there is one thread, to keep to that, and one for every two
/// threads, up to 64, where there are many.
pub fn usual_tasks(threads: usize) -> usize {
    let few = threads.clamp(1, 2);
    (THREADS_FACTOR * threads / USUAL_THREADS).clamp(few, USUAL_TASKS_MAX)
}

/// A worker's threads, and the tasks that have some.
#[derive(Debug)]
pub(super) struct Threads {
    all: usize,
    tasks: AtomicUsize,
    started: AtomicUsize,
}

/// One task's threads.
#[derive(Debug)]
pub(super) struct Share<'a> {
    threads: &'a Threads,
    /// A pool of the task's own: in one for all, a thread that waits for part of one task would take up another as a whole,
    /// under whatever locks it holds.
    pub pool: ThreadPool,
}

impl Threads {
    /// So many threads, at least one.
    pub fn new(all: usize) -> Self {
        Self { all: all.max(1), tasks: AtomicUsize::new(0), started: AtomicUsize::new(0) }
    }

    /// Number of all threads.
    pub fn all(&self) -> usize {
        self.all
    }

    /// Starts the threads of one task more. A task that is alone has all.
    pub fn start(&self) -> Result<Share<'_>, ThreadPoolBuildError> {
        let tasks = self.tasks.fetch_add(1, Ordering::Relaxed) + 1;
        let task = self.started.fetch_add(1, Ordering::Relaxed);
        let name = move |index| format!("bake-{task}-{index}");
        let threads = threads_of_task(self.all, tasks);
        match rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(name).build() {
            Ok(pool) => Ok(Share { threads: self, pool }),
            Err(error) => {
                self.tasks.fetch_sub(1, Ordering::Relaxed);
                Err(error)
            }
        }
    }
}

impl Drop for Share<'_> {
    fn drop(&mut self) {
        self.threads.tasks.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Threads of a task that begins as one of so many.
fn threads_of_task(threads: usize, tasks: usize) -> usize {
    (THREADS_FACTOR * threads).div_ceil(tasks.max(1)).clamp(1, threads)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Seconds of a task's steps for one thread, and of those for many.
    const STEPS: [f64; 2] = [0.25, 0.5];
    /// Parts that the steps for many threads are shared out in.
    const PARTS: usize = 64;

    /// Share of `cores` cores that are busy, while there are always tasks and `tasks` of them are in hand, each with so many
    /// threads. Cores are shared evenly among all threads that have work.
    fn busy(cores: usize, tasks: usize, threads: usize) -> f64 {
        let wide = threads.min(PARTS) as f64;
        // Time of each step when no thread has to wait for a core, and the threads that have work on the average.
        let alone = [STEPS[0], STEPS[1] / wide];
        let wanted = tasks as f64 * (STEPS[0] + STEPS[1]) / (alone[0] + alone[1]);
        (wanted / cores as f64).min(1.0)
    }

    #[test]
    fn machine_of_any_size_is_kept_busy() {
        for cores in [2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96] {
            let tasks = usual_tasks(cores);
            let share = busy(cores, tasks, threads_of_task(cores, tasks));
            assert!(share > 0.9, "{cores} cores, {tasks} tasks: {share}");
        }
        assert!(busy(64, 2, 64) < 0.15, "two tasks in hand do not keep 64 cores busy");
    }

    #[test]
    fn small_machines_have_one_or_two_tasks_with_all_threads_each() {
        assert_eq!([0, 1, 2, 3, 4].map(usual_tasks), [1, 1, 2, 2, 2]);
        assert_eq!([1, 2].map(|tasks| threads_of_task(2, tasks)), [2, 2]);
        assert_eq!([1, 2, 3, 9].map(|tasks| threads_of_task(1, tasks)), [1; 4]);
    }

    #[test]
    fn task_that_is_alone_has_all_threads_and_later_ones_a_share() {
        let threads = Threads::new(8);
        let first = threads.start().unwrap();
        assert_eq!(first.pool.current_num_threads(), 8);
        let others: Vec<_> = (0..3).map(|_| threads.start().unwrap()).collect();
        assert_eq!(
            others.iter().map(|share| share.pool.current_num_threads()).collect::<Vec<_>>(),
            [8, 6, 4]
        );
        drop((first, others));
        assert_eq!(threads.start().unwrap().pool.current_num_threads(), 8);
    }
}
