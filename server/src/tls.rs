//! TLS by flag: a certificate and its key, from PEM files.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use axum::Router;
use axum::extract::connect_info::IntoMakeServiceWithConnectInfo;
use axum::serve::ListenerExt;
use axum_server::Handle;
use axum_server::accept::NoDelayAcceptor;
use axum_server::tls_rustls::{RustlsAcceptor, RustlsConfig};
use tokio::net::TcpListener;

/// Files of a server's certificate. Read once, when the server is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TlsFiles {
    /// PEM file: the certificate, then those between it and one that callers trust.
    pub cert: PathBuf,
    /// PEM file: the certificate's private key.
    pub key: PathBuf,
}

impl TlsFiles {
    /// Reads both.
    pub(crate) async fn read(&self) -> io::Result<RustlsConfig> {
        use_ring();
        RustlsConfig::from_pem_file(&self.cert, &self.key).await
    }
}

/// Makes ring this process's cryptography for TLS, unless it has one.
pub(crate) fn use_ring() {
    // Fails only when the process has a provider already, which is as good.
    let _ = rustls::crypto::ring::default_provider().install_default();
}

/// Serves with TLS, or without, until `stop` is done and the requests then under way have ended.
pub(crate) async fn serve(
    listener: TcpListener,
    app: IntoMakeServiceWithConnectInfo<Router, SocketAddr>,
    tls: Option<RustlsConfig>,
    stop: impl Future<Output = ()> + Send + 'static,
) -> io::Result<()> {
    let Some(tls) = tls else {
        // Without delay: the end of an answer would wait for the caller to acknowledge its beginning, for 40 ms.
        let listener = listener.tap_io(|stream| {
            let _ = stream.set_nodelay(true);
        });
        return axum::serve(listener, app).with_graceful_shutdown(stop).await;
    };
    let handle = Handle::new();
    let stopping = handle.clone();
    tokio::spawn(async move {
        stop.await;
        // The caller of this function ends requests that take too long.
        stopping.graceful_shutdown(None);
    });
    let acceptor = RustlsAcceptor::new(tls).acceptor(NoDelayAcceptor::new());
    axum_server::from_tcp(listener.into_std()?)?.acceptor(acceptor).handle(handle).serve(app).await
}
