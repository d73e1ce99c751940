//! A disk that fills up under a server: calls are refused with what to do, nothing is left half-written, and work goes on
//! by itself when there is room again.
//!
//! The disk is a small one in memory, which only the server sees: mounts of its namespace go with it. Where no user may
//! have a namespace of their own, only root can run this.

use std::io::Write as _;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use lightkiln_client::ClientError;
use lightkiln_client::fetch::ApiClient;
use lightkiln_http::USUAL;
use lightkiln_proto::api::{EventKind, Needs, NewBake};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::problem::ProblemCode;

use super::farm::{arguments, embedded_bundle, wait_for_stage};
use super::processes::{Running, Server, kiln, run};
use super::{bundle, cornell};

/// Size of the disk: a small bake needs less than half of it.
const DISK_MIB: u32 = 32;
/// Mounts a disk of `$1` MiB at `$2` and goes on as the rest.
const ON_SMALL_DISK: &str = r#"mount -t tmpfs -o "size=$1m" tmpfs "$2" && shift 2 && exec "$@""#;

/// A server whose state is on a disk of its own.
struct SmallDisk {
    server: Server,
    /// The disk, as others can see it.
    folder: PathBuf,
}

impl SmallDisk {
    /// A command that runs another one in a namespace of its own.
    fn namespace() -> Command {
        let mut command = Command::new("unshare");
        command.arg("--mount");
        if std::fs::metadata("/proc/self").unwrap().uid() != 0 {
            command.args(["--user", "--map-root-user"]);
        }
        command
    }

    /// `kiln` in such a namespace, with a disk of so many MiB at `state`.
    fn kiln(state: &Path, mib: u32) -> Command {
        std::fs::create_dir_all(state).unwrap();
        let mut command = Self::namespace();
        command.args(["sh", "-c", ON_SMALL_DISK, "sh", &mib.to_string()]);
        let program = kiln(state);
        command.arg(state).arg(program.get_program());
        for (name, value) in program.get_envs() {
            match value {
                Some(value) => command.env(name, value),
                None => command.env_remove(name),
            };
        }
        command
    }

    fn start(state: &Path) -> Self {
        let command = Self::kiln(state, DISK_MIB);
        let server = Server::start_with(command, &["--state", &state.display().to_string()]);
        let inside = state.strip_prefix("/").expect("an absolute path");
        let folder = Path::new("/proc").join(server.id().to_string()).join("root").join(inside);
        Self { server, folder }
    }

    fn ballast(&self) -> PathBuf {
        self.folder.join("ballast")
    }

    /// Takes all room there is, and how it looks from then on.
    fn fill(&self) {
        let mut file = std::fs::File::options().create(true).append(true).open(self.ballast()).unwrap();
        for piece in [1 << 20, 1 << 12, 1] {
            let piece = vec![0; piece];
            while file.write_all(&piece).is_ok() {}
        }
    }

    fn make_room(&self) {
        std::fs::remove_file(self.ballast()).unwrap();
    }

    /// Every file among the chunks is a whole one under its name.
    fn assert_chunks_are_whole(&self) -> usize {
        let mut count = 0;
        for shard in std::fs::read_dir(self.folder.join("chunks")).unwrap() {
            let shard = shard.unwrap().path();
            for file in std::fs::read_dir(&shard).unwrap() {
                let path = file.unwrap().path();
                let digest = Digest::of(&std::fs::read(&path).unwrap()).to_string();
                let name = path.file_name().unwrap().to_str().unwrap();
                let rest = name.split('.').next().unwrap();
                let named = format!("{}{rest}", shard.file_name().unwrap().to_str().unwrap());
                assert_eq!(named, digest, "{} is not whole", path.display());
                count += 1;
            }
        }
        count
    }
}

fn is_full(error: &ClientError) -> bool {
    matches!(error, ClientError::Call(error) if error.code() == Some(ProblemCode::StorageFull))
}

/// A bake that waits for a worker that nobody has.
fn idle_bake(scene: Digest, number: usize) -> NewBake {
    NewBake {
        name: format!("idle {number}"),
        scene,
        kind: String::new(),
        settings: serde_json::json!({ "preset": "draft" }),
        priority: 0,
        needs: Needs { labels: vec!["none such".to_owned()], ..Needs::default() },
        attempt_limit_secs: None,
        limits: Default::default(),
        verify_share: 0.0,
    }
}

#[test]
#[ignore = "needs leave to mount a small disk, as root has it; tests/run runs it where it may"]
fn farm_on_a_full_disk_refuses_with_507_and_goes_on_when_there_is_room() {
    let folder = tempfile::tempdir().unwrap();
    let expected = embedded_bundle(folder.path());
    let disk = SmallDisk::start(&folder.path().join("disk"));
    let url = &disk.server.url;
    let client = ApiClient::new(url, None).unwrap();
    let once = client.clone().with_retry(USUAL.with_max_times(0));
    let submitted = run(kiln(folder.path()), &arguments("submit", &["--server", url]), 0);
    let bake = submitted.stdout().trim().to_owned();
    let _worker = disk.server.worker(folder.path(), "worker", 1);
    wait_for_stage(&client, &bake, "prt.transport");
    disk.fill();
    assert!(!client.bake(&bake).unwrap().state.is_final(), "the disk was full too late");

    // The bytes: no part of them stays.
    let big = vec![7; 1 << 20];
    for _ in 0..3 {
        let refused = once.upload_scene(&big).unwrap_err();
        assert!(is_full(&refused), "{refused}");
    }
    // The queue: its file has some room inside; when that is used up, it refuses too, and says no more than that.
    let scene = client.bake(&bake).unwrap().scene;
    let mut taken = 0;
    let refused = loop {
        match once.submit(&idle_bake(scene, taken), &format!("key-{taken}")) {
            Ok(_) => taken += 1,
            Err(error) => break error,
        }
        assert!(taken < 100_000, "it never fills");
    };
    assert!(is_full(&refused), "{refused}");
    for _ in 0..3 {
        let refused = once.submit(&idle_bake(scene, taken), &format!("key-{taken}")).unwrap_err();
        assert!(is_full(&refused), "{refused}");
    }
    assert_eq!(client.bake(&bake).unwrap().id, bake, "what is there can be read");
    disk.assert_chunks_are_whole();

    disk.make_room();
    run(kiln(folder.path()), &["watch", &bake, "--server", url], 0);
    let out = folder.path().join("out").display().to_string();
    run(kiln(folder.path()), &["fetch", &bake, "--server", url, "--out", &out], 0);
    assert_eq!(bundle(Path::new(&out)), expected);
    assert!(disk.assert_chunks_are_whole() > 10);
    // Refused calls changed nothing, and succeed now.
    assert_eq!(once.upload_scene(&big).unwrap().bytes, big.len() as u64);
    once.submit(&idle_bake(scene, taken), &format!("key-{taken}")).unwrap();
    let bakes = client.bakes(&Default::default(), None, 500).unwrap().bakes.len();
    assert_eq!(bakes, (taken + 2).min(500));
    let events = client.events(&bake, 0, 0).unwrap().events;
    let blamed = |kind: &EventKind| matches!(kind, EventKind::TaskFailed { .. });
    assert!(!events.iter().any(|event| blamed(&event.event)), "nobody is to blame: {events:?}");
    assert_eq!(disk.server.stop(), Some(0));
}

#[test]
#[ignore = "needs leave to mount a small disk, as root has it; tests/run runs it where it may"]
fn bake_on_a_full_disk_ends_with_what_to_do_instead_of_waiting_for_ever() {
    let folder = tempfile::tempdir().unwrap();
    let state = folder.path().join("disk");
    let mut command = SmallDisk::kiln(&state, 2);
    command.arg("bake").arg(cornell()).args(["--preset", "draft", "--state"]).arg(&state);
    command.arg("--out").arg(folder.path().join("out"));
    let ended = Running::start(command).finish();
    let words = ended.stderr.join("\n");
    assert_eq!(ended.exit, Some(1), "{words}");
    assert!(words.contains("error: no room is left on the disk of") && words.contains("--state"), "{words}");
    assert!(!words.contains("classification"), "{words}");
}
