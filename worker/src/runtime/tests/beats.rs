//! Heartbeats whose answers are late, or never come.

use super::fake_farm::{FakeFarm, LIMIT};
use super::*;
use crate::runtime::store::LeaseStore;
use crate::runtime::watch::{LeaseWatch, RETRY_WAIT};
use crate::task::Progress;

/// Parts that a watch of lease `t1` holds on to.
struct Held {
    farm: Farm,
    memory: MemoryWatch,
    progress: Progress,
    shutdown: ShutdownFlag,
}

impl Held {
    fn by(server: &FakeFarm) -> Self {
        Self {
            farm: Farm::new(server.url(), None, None).unwrap(),
            memory: MemoryWatch::new(None, Box::new(Kernel::default())),
            progress: Progress::new(),
            shutdown: ShutdownFlag::new(),
        }
    }

    fn watch(&self, interval: Duration) -> LeaseWatch<'_> {
        LeaseWatch {
            farm: &self.farm,
            token: "t1",
            interval,
            grace: Duration::ZERO,
            progress: &self.progress,
            memory: &self.memory,
            shutdown: &self.shutdown,
            finished: AtomicBool::new(false),
            stop: Mutex::new(None),
        }
    }
}

#[test]
fn heartbeat_without_an_answer_is_soon_sent_again() {
    let server = FakeFarm::start();
    server.state().refuse = vec!["POST /v1/leases/t1/heartbeat"];
    let held = Held::by(&server);
    let watch = held.watch(LIMIT);
    assert_eq!(watch.beat(None), RETRY_WAIT);
    assert_eq!(watch.beat(None), LIMIT);
    assert_eq!(watch.stop_reason(), None);
}

/// Behind a slow line the answer takes longer than heartbeats are apart.
#[test]
fn answer_that_takes_most_of_a_lease_begins_the_task() {
    const INTERVAL: Duration = Duration::from_secs(1);
    let server = FakeFarm::start();
    server.state().hang = Some("POST /v1/leases/t1/heartbeat");
    let held = Held::by(&server);
    let watch = held.watch(INTERVAL);
    let Held { farm, progress, shutdown, .. } = &held;
    let store = LeaseStore { farm, disk: None, progress, shutdown };
    std::thread::scope(|scope| {
        let acknowledged = scope.spawn(|| watch.acknowledge(&store));
        server.wait_for("heartbeat", beats);
        // The time is the trouble itself; nothing waits for it to be over.
        std::thread::park_timeout(INTERVAL * 3 / 2);
        server.let_go();
        acknowledged.join().unwrap().unwrap();
    });
    // The one that hung is noted when it comes and when it goes on.
    let calls = server.state().calls.clone();
    assert_eq!(calls.iter().filter(|call| call.ends_with("/heartbeat")).count(), 2, "{calls:?}");
}
