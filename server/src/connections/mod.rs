//! Connections of callers, plain or with TLS: how many there may be, how long one may be silent, and which one goes when
//! there is no room for another.
//!
//! A connection without a call under way costs its caller nothing to open anew, so it makes room for others: the one
//! that has been silent the longest, whether it never said a word, is in the middle of a request's head, or has been
//! answered. Those with a call under way stay. Whoever holds thousands of half-open connections thus keeps nobody out.

mod answer;
mod room;
mod stream;
mod table;

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::Body;
use axum::extract::ConnectInfo;
use axum::http::{Request, Version};
use axum::response::IntoResponse as _;
use hyper::body::Incoming;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto;
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio_rustls::TlsAcceptor;

use crate::error::ServerError;
use answer::watched;
use stream::Noted;
use table::{Seat, Table};

pub(crate) use room::open_files;

/// Wait before connections are taken again after the system refused one.
const ACCEPT_AGAIN_AFTER: Duration = Duration::from_millis(50);
/// Bytes that one connection buffers: a request's head must fit. More → fewer reads of large bodies, more memory when
/// many callers send heads that never end.
const BUFFER_BYTES: usize = 32 << 10;
/// Bytes that callers of HTTP/2 may send before they are read, of one call and of one connection.
const HTTP2_WINDOWS: [u32; 2] = [128 << 10, 256 << 10];
/// A caller of HTTP/2 is asked this often whether it is still there, and has as long to answer.
const HTTP2_PING: Duration = Duration::from_secs(30);
/// Calls at a time of one connection of HTTP/2. More → one connection takes up more room; browsers and proxies wait less.
const HTTP2_CALLS: u32 = 16;
/// Seconds after which a caller may come again whose address has as many calls as it may: how long is not known.
const CROWDED_RETRY_SECS: u64 = 1;

/// Limits of connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConnectionConfig {
    /// Connections at a time; fewer where the system lets the process open fewer files. Fewer → less memory at worst;
    /// each worker and each watched bake takes one or two. 0 is as many as the system allows.
    pub at_a_time: u32,
    /// The same of one address (of IPv6, one network of 64 bits), and its calls under way at most. Fewer → one caller takes up less room; workers behind one proxy need
    /// more. 0 is no limit of its own.
    pub of_address: u32,
    /// A request's head must have come within this time, as must what TLS says before it.
    pub head_timeout: Duration,
    /// A connection without a request ends after this time. Longer than that of a load balancer in front, which else sends
    /// calls into a connection that is being closed.
    pub idle_timeout: Duration,
    /// A caller that takes none of an answer for this long is cut off.
    pub stall_timeout: Duration,
}

impl Default for ConnectionConfig {
    fn default() -> Self {
        Self {
            at_a_time: 10_000,
            of_address: 7_500,
            head_timeout: Duration::from_secs(15),
            idle_timeout: Duration::from_secs(120),
            stall_timeout: Duration::from_secs(60),
        }
    }
}

/// Serves connections until `stop` is done and the calls then under way have ended.
pub(crate) async fn serve(
    listener: TcpListener,
    app: Router,
    tls: Option<TlsAcceptor>,
    config: ConnectionConfig,
    stop: impl Future<Output = ()>,
) {
    let table = Arc::new(Table::new(&config));
    let (closing, is_closing) = watch::channel(false);
    let mut stop = pin!(stop);
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = &mut stop => break,
        };
        match accepted {
            Ok((stream, address)) => {
                // None: every place is taken by calls under way.
                let Some(seat) = table.enter(address.ip(), Instant::now()) else { continue };
                // Without delay: the end of an answer would wait for the caller to acknowledge its beginning, for 40 ms.
                let _ = stream.set_nodelay(true);
                let caller = Caller { app: app.clone(), tls: tls.clone(), seat: Arc::new(seat), address };
                tokio::spawn(caller.serve(stream, config, is_closing.clone()));
            }
            Err(error) if is_of_one_caller(&error) => (),
            Err(error) => {
                tracing::warn!(%error, "a connection could not be taken; a silent one makes room");
                table.make_room();
                tokio::time::sleep(ACCEPT_AGAIN_AFTER).await;
            }
        }
    }
    drop((listener, is_closing));
    closing.send_replace(true);
    closing.closed().await;
}

/// Waits until the flag is raised, or nobody is left to raise it.
async fn is_true(flag: &mut watch::Receiver<bool>) {
    let _ = flag.wait_for(|flag| *flag).await;
}

/// Whether a connection ended before it was taken, which says nothing of the next.
fn is_of_one_caller(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

/// One connection.
struct Caller {
    app: Router,
    tls: Option<TlsAcceptor>,
    seat: Arc<Seat>,
    address: SocketAddr,
}

impl Caller {
    /// Answers until the caller or its time is over, or the server closes and no call is under way.
    async fn serve(self, stream: TcpStream, config: ConnectionConfig, closing: watch::Receiver<bool>) {
        let (seat, mut at_close) = (self.seat.clone(), closing.clone());
        let stream = Noted::new(stream, seat.clone());
        let answering = async {
            match self.tls.clone() {
                None => self.answer(stream, closing).await,
                Some(tls) => {
                    if let Ok(stream) = tls.accept(stream).await {
                        self.answer(stream, closing).await;
                    }
                }
            }
        };
        tokio::select! {
            () = answering => (),
            why = seat.end(&config, is_true(&mut at_close)) => tracing::debug!(address = %self.address, why, "a connection was ended"),
        }
    }

    async fn answer(
        &self,
        stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static,
        mut closing: watch::Receiver<bool>,
    ) {
        let (app, seat, address) =
            (TowerToHyperService::new(self.app.clone()), self.seat.clone(), self.address);
        let service = service_fn(move |request: Request<Incoming>| {
            let call = seat.begin(request.version() == Version::HTTP_2);
            let mut request = request.map(Body::new);
            request.extensions_mut().insert(ConnectInfo(address));
            let answered = call.map(|call| (call, app.call(request)));
            async move {
                let Some((call, answer)) = answered else {
                    let busy = ServerError::Busy { retry_after_secs: CROWDED_RETRY_SECS };
                    return Ok(busy.into_response());
                };
                let answer: Result<_, Infallible> = answer.await;
                answer.map(|answer| watched(answer, call))
            }
        });
        let mut builder = auto::Builder::new(TokioExecutor::new());
        builder.http1().max_buf_size(BUFFER_BYTES);
        builder
            .http2()
            .timer(TokioTimer::new())
            .initial_stream_window_size(HTTP2_WINDOWS[0])
            .initial_connection_window_size(HTTP2_WINDOWS[1])
            .max_concurrent_streams(HTTP2_CALLS)
            .keep_alive_interval(HTTP2_PING)
            .keep_alive_timeout(HTTP2_PING);
        let mut connection = pin!(builder.serve_connection(TokioIo::new(stream), service));
        let served = tokio::select! {
            served = connection.as_mut() => served,
            () = is_true(&mut closing) => {
                connection.as_mut().graceful_shutdown();
                connection.await
            }
        };
        if let Err(error) = served {
            tracing::debug!(%address, %error, "a connection broke");
        }
    }
}
