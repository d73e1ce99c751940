//! A door between two parts of a farm, at which connections are cut, delayed, and lose the answers that pass.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Bytes that pass at a time.
const PIECE_BYTES: usize = 64 << 10;

/// Passes connections on to one of its targets in turn.
pub struct Proxy {
    /// Port on 127.0.0.1 that it listens on.
    pub port: u16,
    inner: Arc<Inner>,
}

#[derive(Default)]
struct Inner {
    targets: Mutex<Vec<u16>>,
    turn: AtomicUsize,
    next_id: AtomicU64,
    open: Mutex<BTreeMap<u64, [TcpStream; 2]>>,
    answers_to_lose: AtomicU32,
    delay_ms: AtomicU64,
    /// Nobody is let in, as if the target had ended.
    is_shut: AtomicBool,
    is_closed: AtomicBool,
}

impl Proxy {
    /// A door to ports on 127.0.0.1.
    pub fn to(targets: &[u16]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let inner = Arc::new(Inner { targets: Mutex::new(targets.to_vec()), ..Inner::default() });
        let accepting = inner.clone();
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                if accepting.is_closed.load(Ordering::SeqCst) {
                    return;
                }
                accepting.open(client);
            }
        });
        Self { port, inner }
    }

    /// Passes new connections to that port too.
    pub fn add_target(&self, port: u16) {
        self.inner.targets.lock().unwrap().push(port);
    }

    /// Passes no new connections to that port.
    pub fn remove_target(&self, port: u16) {
        self.inner.targets.lock().unwrap().retain(|target| *target != port);
    }

    /// Cuts all connections; returns how many.
    pub fn cut(&self) -> usize {
        let open = std::mem::take(&mut *self.inner.open.lock().unwrap());
        open.values().flatten().for_each(hang_up);
        open.len()
    }

    /// The next `count` answers get lost: the request arrived and was done, then the connection breaks.
    pub fn lose_answers(&self, count: u32) {
        self.inner.answers_to_lose.store(count, Ordering::SeqCst);
    }

    /// Everything takes that much longer, each way.
    pub fn delay(&self, delay: Duration) {
        self.inner.delay_ms.store(delay.as_millis() as u64, Ordering::SeqCst);
    }

    /// Lets nobody in, as if what is behind it had ended; returns how many connections that cut.
    pub fn shut(&self) -> usize {
        self.inner.is_shut.store(true, Ordering::SeqCst);
        self.cut()
    }

    /// Ends all trouble.
    pub fn heal(&self) {
        self.inner.is_shut.store(false, Ordering::SeqCst);
        self.lose_answers(0);
        self.delay(Duration::ZERO);
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.inner.is_closed.store(true, Ordering::SeqCst);
        self.cut();
        // Wakes the thread that accepts.
        let _ = TcpStream::connect(("127.0.0.1", self.port));
    }
}

impl Inner {
    fn open(self: &Arc<Self>, client: TcpStream) {
        if self.is_shut.load(Ordering::SeqCst) {
            return;
        }
        let Some(server) = self.connect() else { return };
        for end in [&client, &server] {
            end.set_nodelay(true).unwrap();
        }
        let id = self.next_id.fetch_add(1, Ordering::SeqCst);
        let ends = [client.try_clone().unwrap(), server.try_clone().unwrap()];
        self.open.lock().unwrap().insert(id, ends);
        let ways =
            [(client.try_clone().unwrap(), server.try_clone().unwrap(), false), (server, client, true)];
        for (from, to, is_answer) in ways {
            let inner = self.clone();
            std::thread::spawn(move || {
                inner.pass(&from, &to, is_answer);
                hang_up(&from);
                hang_up(&to);
                inner.open.lock().unwrap().remove(&id);
            });
        }
    }

    fn connect(&self) -> Option<TcpStream> {
        let targets = self.targets.lock().unwrap().clone();
        let turn = self.turn.fetch_add(1, Ordering::SeqCst);
        let mut in_turn = (0..targets.len()).map(|index| targets[(turn + index) % targets.len()]);
        in_turn.find_map(|port| TcpStream::connect(("127.0.0.1", port)).ok())
    }

    /// Passes bytes one way until the connection ends, or an answer is to be lost.
    fn pass(&self, mut from: &TcpStream, mut to: &TcpStream, is_answer: bool) {
        let mut piece = vec![0; PIECE_BYTES];
        while let Ok(length @ 1..) = from.read(&mut piece) {
            if is_answer && self.loses_this() {
                return;
            }
            // The delay is the trouble itself; nothing waits for it to be over.
            std::thread::park_timeout(Duration::from_millis(self.delay_ms.load(Ordering::SeqCst)));
            if to.write_all(&piece[..length]).is_err() {
                return;
            }
        }
    }

    fn loses_this(&self) -> bool {
        let one_less = |left: u32| left.checked_sub(1);
        self.answers_to_lose.fetch_update(Ordering::SeqCst, Ordering::SeqCst, one_less).is_ok()
    }
}

fn hang_up(end: &TcpStream) {
    // It may have ended by itself.
    let _ = end.shutdown(Shutdown::Both);
}

#[test]
fn cut_connections_lost_answers_and_a_shut_door_are_noticed_and_new_ones_pass() {
    let echo = TcpListener::bind("127.0.0.1:0").unwrap();
    let proxy = Proxy::to(&[echo.local_addr().unwrap().port()]);
    std::thread::spawn(move || {
        for mut stream in echo.incoming().flatten() {
            std::thread::spawn(move || {
                let mut byte = [0];
                while stream.read_exact(&mut byte).and_then(|()| stream.write_all(&byte)).is_ok() {}
            });
        }
    });
    let ask = |stream: &mut TcpStream| -> Option<u8> {
        let mut byte = [7];
        stream.write_all(&byte).and_then(|()| stream.read_exact(&mut byte)).ok().map(|()| byte[0])
    };
    let open = || TcpStream::connect(("127.0.0.1", proxy.port)).unwrap();
    let mut first = open();
    assert_eq!(ask(&mut first), Some(7));
    assert_eq!(proxy.cut(), 1);
    assert_eq!(ask(&mut first), None);
    proxy.lose_answers(1);
    assert_eq!(ask(&mut open()), None);
    let mut last = open();
    assert_eq!(ask(&mut last), Some(7));
    assert!(proxy.shut() > 0);
    assert_eq!(ask(&mut last), None);
    assert_eq!(ask(&mut open()), None);
    proxy.heal();
    assert_eq!(ask(&mut open()), Some(7));
}
