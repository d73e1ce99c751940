//! A server that starts before its database does.

use std::net::SocketAddr;
use std::pin::pin;
use std::time::Duration;

use axum::Router;
use axum::routing::get;
use tokio::net::TcpListener;
use tokio::sync::{oneshot, watch};

use crate::connections;
use crate::error::{Result, ServerError};
use crate::http;
use crate::server::{Config, Server};
use crate::store::StoreError;

/// A database that says nothing for so long is waited for in public.
const SILENT_FOR: Duration = Duration::from_secs(5);
/// Wait before a database that is away is asked again.
const ASK_AGAIN_AFTER: Duration = Duration::from_secs(1);
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
    let (end, ended) = oneshot::channel::<()>();
    let answering = connections::serve(
        meanwhile,
        router(),
        config.acceptor().await?,
        config.connections.within(connections::open_files()),
        async {
            let _ = ended.await;
        },
    );
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
            Err(ServerError::Store(error @ StoreError::Unavailable(_))) if config.database_is_remote() => {
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
