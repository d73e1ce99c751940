//! `kiln worker`: does tasks for a farm's server.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use lightkiln_worker::kinds::{BakeKinds, Runner};
use lightkiln_worker::runtime::{
    CallError, LEASE_SECS, Seat, Worker, WorkerConfig, WorkerError, new_id, usual_tasks,
};

use crate::arguments::{ServerArgument, own_token};
use crate::console::say;
use crate::embedded::{all_processors, or_in_state};
use crate::enrolment::token_of_worker;
use crate::failure::{Exit, Failure, Result};
use crate::interrupt::Interrupt;

/// Arguments of `kiln worker`.
#[derive(Args, Debug)]
#[command(
    after_help = "The first Ctrl-C or SIGTERM finishes the task in hand if it ends within 20 seconds, its result handed in, \
                        else gives it back, for 5 seconds at most if the server does not answer: the task goes to another worker \
                        when its lease runs out. A second signal, half a second later or more, ends at once."
)]
pub struct Arguments {
    #[command(flatten)]
    server: ServerArgument,
    /// Threads, which the tasks in hand share [default: one per processor]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Tasks in hand at a time, each with as much memory as a task may use: one goes on while another waits for the server
    /// or has a step for one thread [default: one for every two threads, but 2 to 64, and 1 with one thread]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=64))]
    tasks: Option<u16>,
    /// Memory in MiB that a task may use; bakes that need more go to other workers [default: all that this machine has]
    #[arg(long, value_name = "MIB")]
    memory_mib: Option<u32>,
    /// MiB that this process may take: when it takes more, tasks in hand fail as out of memory, before the kernel ends it [default:
    /// limits of its group of processes and of the machine alone]
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..=1 << 30))]
    memory_limit_mib: Option<u64>,
    /// A label that bakes may ask for with --needs-label; may be repeated
    #[arg(long = "label", value_name = "LABEL")]
    labels: Vec<String>,
    /// Folder for fetched artefacts [default: worker in the state folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// GiB that the cache folder may hold
    #[arg(long, value_name = "GIB", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=65536))]
    cache_gib: u64,
    /// Seconds after which the task of a worker that is not heard from goes to another
    #[arg(long, value_name = "SECS", default_value_t = LEASE_SECS, value_parser = clap::value_parser!(u32).range(5..=3600))]
    lease_secs: u32,
    /// Takes so many tasks, then ends with 0: for jobs of a fixed size, as a spot fleet's or a render manager's
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    max_tasks: Option<u32>,
    /// Ends with 0 once the server had no task for this worker for so many seconds [with no number: 60]: for arrays of
    /// Slurm and jobs of Kubernetes. A server that is away is waited for; memory that other programs have no longer than that
    #[arg(long, value_name = "SECS", num_args = 0..=1, default_missing_value = "60")]
    exit_when_idle: Option<u32>,
    /// Code from 'kiln token enrol', to get a token of this worker's own, once; the token is kept in the token file
    #[arg(long, value_name = "CODE", env = "KILN_ENROL", hide_env_values = true)]
    enrol: Option<String>,
    /// File of this worker's own token, which nobody else may read; KILN_TOKEN goes before it
    /// [default: worker-token in the state folder]
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Name on the farm, unique there [default: the host's name and that of the seat in the state folder, the same after each start]
    #[arg(long)]
    name: Option<String>,
}

/// Works until a signal comes, or it has done what it came for.
pub fn run(arguments: Arguments, kinds: &BakeKinds) -> Result<()> {
    let interrupt = Interrupt::listen()?;
    let seat = take_seat()?;
    let name = arguments.name.unwrap_or_else(|| default_name(seat.as_deref()));
    let mut config = WorkerConfig::new(&arguments.server.server, name);
    config.seat = seat;
    config.memory_limit = arguments.memory_limit_mib.map(|mib| mib << 20);
    config.ca_pem = arguments.server.trust.pem()?;
    config.token = match own_token()? {
        Some(token) => {
            if arguments.enrol.is_some_and(|code| !code.is_empty()) {
                say!("KILN_TOKEN is set and goes before --enrol: the code was not used");
            }
            Some(token)
        }
        None => {
            let file = or_in_state(arguments.token_file, "worker-token")?;
            token_of_worker(&config, &file, arguments.enrol.as_deref(), &interrupt)?
        }
    };
    config.threads = arguments.threads.map_or_else(all_processors, usize::from);
    config.tasks = arguments.tasks.map_or_else(|| usual_tasks(config.threads), usize::from);
    config.memory_mib = arguments.memory_mib.unwrap_or_else(all_memory_mib);
    config.labels = arguments.labels;
    config.cache_dir = Some(or_in_state(arguments.cache, "worker")?);
    config.lease_secs = arguments.lease_secs;
    config.max_tasks = arguments.max_tasks;
    config.exit_when_idle = arguments.exit_when_idle.map(|secs| Duration::from_secs(secs.into()));
    // Who does not wait for tasks does not wait for memory either.
    config.memory_patience = config.exit_when_idle;
    config.cache_bytes = arguments.cache_gib << 30;
    let name = config.name.clone();
    let worker = Worker::new(config, Arc::new(Runner::new(kinds))).map_err(worker_failure)?;
    say!("worker {name} takes tasks from {}", arguments.server.server);
    worker.run(interrupt.flag()).map_err(worker_failure)?;
    if !interrupt.is_raised() {
        say!("worker {name} ends: its tasks are done, or there was none for it");
    }
    Ok(())
}

/// Memory of this machine, or of the group of processes that this one may use; 0 where nobody says.
fn all_memory_mib() -> u32 {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let meminfo = read("/proc/meminfo");
    let total = meminfo.lines().find_map(|line| line.strip_prefix("MemTotal:"));
    let total = total.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
    let limit = read("/sys/fs/cgroup/memory.max").trim().parse::<u64>().ok();
    let bytes = total.map_or(0, |kib| kib << 10).min(limit.unwrap_or(u64::MAX));
    u32::try_from(bytes >> 20).unwrap_or(u32::MAX)
}

/// A seat in the state folder, by which a worker is known from one start to the next. It works without one, too.
fn take_seat() -> Result<Option<Arc<Seat>>> {
    let folder = or_in_state(None, "worker-seats")?;
    match Seat::take(&folder) {
        Ok(seat) => Ok(Some(Arc::new(seat))),
        Err(error) => {
            say!(
                "the folder {} cannot be used ({error}): tasks of this worker wait for their leases' end if it is killed; KILN_STATE \
                 with a folder that can be written helps",
                folder.display()
            );
            Ok(None)
        }
    }
}

fn default_name(seat: Option<&Seat>) -> String {
    let host = std::fs::read_to_string("/etc/hostname").unwrap_or_default();
    let host = if host.trim().is_empty() { "worker" } else { host.trim() };
    // Many machines may have no name: it is the id that no other worker has.
    format!("{host}-{}", seat.map_or_else(new_id, |seat| seat.id().to_owned()))
}

fn worker_failure(error: WorkerError) -> Failure {
    let (exit, next_step) = match &error {
        WorkerError::Cache { .. } => (Exit::BadInput, "another folder with --cache DIR"),
        WorkerError::Server(CallError::Certificates { .. }) => (Exit::BadInput, "another file with --ca"),
        WorkerError::Server(_) => (Exit::BadInput, "the URL of a Lightkiln server with --server"),
        WorkerError::Memory { is_own: true, .. } => (
            Exit::Failed,
            "the same command again, which begins with no memory taken; services do it by themselves",
        ),
        WorkerError::Memory { is_own: false, .. } => {
            (Exit::Failed, "the same command again once other programs have let go of memory")
        }
        WorkerError::Threads { .. } => (Exit::BadInput, "fewer threads with --threads N"),
        WorkerError::Refused(error) if error.is_about_tokens() => (
            Exit::BadInput,
            "--enrol with a code from 'kiln token enrol', or KILN_TOKEN with a token of the scope 'worker'",
        ),
        WorkerError::Refused(_) => {
            (Exit::Unreachable, "the URL of a Lightkiln server of this version with --server")
        }
    };
    Failure::new(exit, "the worker cannot go on").caused_by(&error).try_this(next_step)
}
