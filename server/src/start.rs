//! A server that starts before its database does.

use std::net::SocketAddr;
use std::pin::pin;
use std::time::Duration;

use axum::Router;
use axum::routing::get;
use tokio::net::TcpListener;
use tokio::sync::watch;

use crate::connections;
use crate::error::{Result, ServerError};
use crate::http;
use crate::server::{Config, Server};
use crate::store::StoreError;

/// A database that says nothing for so long is waited for in public.
const SILENT_FOR: Duration = Duration::from_secs(5);
/// Wait before a database that is away is asked again.
const ASK_AGAIN_AFTER: Duration = Duration::from_secs(1);
/// Calls that were answered meanwhile have so long to end once the server is open, or told to stop.
const LEAVE_WITHIN: Duration = Duration::from_secs(1);
/// Looks between two lines of the log.
const LOOKS_UNTOLD: u32 = 60;

/// Opens a server, listens and serves until `shutdown` is done. `announce` is told the address once callers get answers.
///
/// While the database is away, calls about health are answered, and all others told to come again. A server that cannot
/// be for other reasons ends with them.
pub async fn serve(
    config: Config,
    address: &str,
    announce: impl FnOnce(SocketAddr),
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> Result<()> {
    let (is_away, mut away) = watch::channel(false);
    let mut opening = pin!(open_at_last(&config, is_away));
    let opened = tokio::select! {
        opened = &mut opening => Some(opened?),
        _ = away.wait_for(|is_away| *is_away) => None,
        () = tokio::time::sleep(SILENT_FOR) => None,
    };
    if let Some(server) = opened {
        let listener = server.bind(address).await?;
        announce(listener.local_addr().map_err(ServerError::Serve)?);
        return server.serve(listener, shutdown).await;
    }
    let listener = listen(address).await?;
    announce(listener.local_addr().map_err(ServerError::Serve)?);
    let (stop, mut stopped) = watch::channel(false);
    tokio::spawn(async move {
        shutdown.await;
        stop.send_replace(true);
    });
    let Some((server, listener)) = wait(&config, listener, opening, stopped.clone()).await? else {
        return Ok(());
    };
    let shutdown = async move {
        let _ = stopped.wait_for(|is_stopped| *is_stopped).await;
    };
    server.serve(listener, shutdown).await
}

async fn listen(address: &str) -> Result<TcpListener> {
    let cannot = |source| ServerError::Listen { address: address.to_owned(), source };
    TcpListener::bind(address).await.map_err(cannot)
}

/// Answers calls until the server is open; none if it was told to stop before.
async fn wait(
    config: &Config,
    listener: TcpListener,
    opening: impl Future<Output = Result<Server>>,
    mut stopped: watch::Receiver<bool>,
) -> Result<Option<(Server, TcpListener)>> {
    // The socket outlives the connections that are answered meanwhile.
    let listener = listener.into_std().map_err(ServerError::Serve)?;
    let meanwhile = listener.try_clone().and_then(TcpListener::from_std).map_err(ServerError::Serve)?;
    let (end, mut ended) = watch::channel(());
    let mut ends = end.subscribe();
    let answering = connections::serve(
        meanwhile,
        router(),
        config.acceptor().await?,
        config.connections.within(connections::open_files()),
        async move { while ends.changed().await.is_ok() {} },
    );
    // A caller that takes none of its answer must hold up nobody: its connection ends by itself.
    let answering = async {
        let grace = async {
            while ended.changed().await.is_ok() {}
            tokio::time::sleep(LEAVE_WITHIN).await;
        };
        tokio::select! {
            () = answering => (),
            () = grace => (),
        }
    };
    let opened = async {
        let opened = tokio::select! {
            opened = opening => Some(opened),
            _ = stopped.wait_for(|is_stopped| *is_stopped) => None,
        };
        drop(end);
        opened
    };
    let (opened, ()) = tokio::join!(opened, answering);
    let Some(server) = opened.transpose()? else { return Ok(None) };
    Ok(Some((server, TcpListener::from_std(listener).map_err(ServerError::Serve)?)))
}

/// Opens the server as soon as its database answers; `is_away` becomes true when it does not.
async fn open_at_last(config: &Config, is_away: watch::Sender<bool>) -> Result<Server> {
    let mut looks = 0;
    loop {
        match Server::open(config.clone()).await {
            Err(ServerError::Store(error)) if config.database_is_remote() && may_come(&error) => {
                if looks % LOOKS_UNTOLD == 0 {
                    let error = lightkiln_proto::problem::chain(&error);
                    tracing::warn!(error, "the server waits for its database");
                }
                looks += 1;
                is_away.send_replace(true);
                tokio::time::sleep(ASK_AGAIN_AFTER).await;
            }
            opened => return opened,
        }
    }
}

/// Whether a database may come by itself. A wrong password, address or name, or a certificate that is not trusted,
/// takes a person, who must hear of it.
fn may_come(error: &StoreError) -> bool {
    let StoreError::Unavailable(source) = error else { return false };
    match source.downcast_ref::<sqlx::Error>() {
        Some(sqlx::Error::Database(error)) => error.code().is_none_or(|state| is_passing(&state)),
        Some(sqlx::Error::Tls(_) | sqlx::Error::Configuration(_) | sqlx::Error::Protocol(_)) => false,
        _ => true,
    }
}

/// Whether a SQLSTATE is one of a database that starts, stops, is busy or is not the primary yet.
fn is_passing(state: &str) -> bool {
    // Connection, resources, end from outside, system; a standby; timeouts of transactions, locks and statements.
    let of_class = ["08", "53", "57P0", "58"].iter().any(|class| state.starts_with(class));
    of_class || ["25006", "25P03", "55P03", "57014"].contains(&state)
}

/// Answers of a server whose database is away.
fn router() -> Router {
    Router::new()
        .route("/healthz", get(http::healthz))
        .fallback(not_open)
        .method_not_allowed_fallback(not_open)
}

async fn not_open() -> ServerError {
    ServerError::NotOpen
}

#[cfg(test)]
mod tests {
    use std::io;

    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
    use tokio::net::TcpStream;

    use super::*;

    fn unavailable(error: sqlx::Error) -> StoreError {
        StoreError::Unavailable(error.into())
    }

    #[test]
    fn database_that_may_come_by_itself_is_waited_for_and_a_wrong_one_is_not() {
        for state in ["08006", "53300", "57P01", "57P03", "58030", "25006", "55P03"] {
            assert!(is_passing(state), "{state}");
        }
        for state in ["28P01", "28000", "3D000", "42P01", "57000"] {
            assert!(!is_passing(state), "{state}");
        }
        let refused = sqlx::Error::Io(io::ErrorKind::ConnectionRefused.into());
        assert!(may_come(&unavailable(refused)) && may_come(&unavailable(sqlx::Error::PoolTimedOut)));
        for error in [sqlx::Error::Tls("untrusted".into()), sqlx::Error::Configuration("no host".into())] {
            assert!(!may_come(&unavailable(error)));
        }
    }

    /// A call by HTTP/2, without TLS, of a caller that takes no byte of an answer: the beginning of the protocol, SETTINGS
    /// with INITIAL_WINDOW_SIZE = 0, and `GET /` in HEADERS.
    const REFUSES_ANSWER: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\
        \x00\x00\x06\x04\x00\x00\x00\x00\x00\x00\x04\x00\x00\x00\x00\
        \x00\x00\x03\x01\x05\x00\x00\x00\x01\x82\x86\x84";
    /// Type of the frame that the answer's head comes in.
    const HEADERS: u8 = 1;

    /// Reads frames until one of HEADERS has come.
    async fn read_head(stream: &mut TcpStream) {
        loop {
            let mut head = [0; 9];
            stream.read_exact(&mut head).await.unwrap();
            let length = u32::from_be_bytes([0, head[0], head[1], head[2]]);
            stream.read_exact(&mut vec![0; length as usize]).await.unwrap();
            if head[3] == HEADERS {
                return;
            }
        }
    }

    #[tokio::test]
    async fn caller_that_takes_no_answer_keeps_no_server_from_stopping() {
        let folder = tempfile::tempdir().unwrap();
        let config = Config::new(folder.path());
        let listener = listen("127.0.0.1:0").await.unwrap();
        let mut caller = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
        let (stop, stopped) = watch::channel(false);
        let refusal = async {
            caller.write_all(REFUSES_ANSWER).await.unwrap();
            read_head(&mut caller).await;
            stop.send_replace(true);
        };
        let waiting = wait(&config, listener, std::future::pending(), stopped);
        // Less than a stalled answer has.
        let limit = config.connections.stall_timeout / 2;
        let both = async { tokio::join!(waiting, refusal).0 };
        let waited = tokio::time::timeout(limit, both).await.expect("the server stops");
        assert!(waited.unwrap().is_none());
    }
}
