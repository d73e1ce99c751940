//! TLS by flag: a certificate and its key, from PEM files.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use rustls::ServerConfig;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::TlsAcceptor;

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
    pub(crate) async fn read(&self) -> io::Result<TlsAcceptor> {
        use_ring();
        let (cert, key) = (tokio::fs::read(&self.cert).await?, tokio::fs::read(&self.key).await?);
        let chain =
            CertificateDer::pem_slice_iter(&cert).collect::<Result<Vec<_>, _>>().map_err(io::Error::other)?;
        if chain.is_empty() {
            return Err(io::Error::other("there is no certificate in the file of the certificate"));
        }
        let key = PrivateKeyDer::from_pem_slice(&key).map_err(io::Error::other)?;
        let config = ServerConfig::builder().with_no_client_auth().with_single_cert(chain, key);
        let mut config = config.map_err(io::Error::other)?;
        config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
        Ok(TlsAcceptor::from(Arc::new(config)))
    }
}

/// Makes ring this process's cryptography for TLS, unless it has one.
pub(crate) fn use_ring() {
    // Fails only when the process has a provider already, which is as good.
    let _ = rustls::crypto::ring::default_provider().install_default();
}
