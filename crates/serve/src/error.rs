//! Why a service does not start, or ends.

use std::net::SocketAddr;
use std::path::PathBuf;

/// Why a service does not start, or ends.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address cannot be listened to.
    #[error("cannot listen on {address}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Error of the system.
        source: std::io::Error,
    },
    /// Other machines could ask without a token.
    #[error("{0} can be reached from other machines, and there is no token")]
    Open(SocketAddr),
    /// The token can be guessed.
    #[error("the token has less than {0} characters")]
    Token(usize),
    /// The token has blanks or letters that a header cannot have.
    #[error("the token has other characters than visible ones of ASCII")]
    TokenCharacters,
    /// The certificate or its key cannot be used.
    #[error("`{}` cannot be used for HTTPS: {why}", path.display())]
    Certificate {
        /// The file.
        path: PathBuf,
        /// Description of the problem.
        why: String,
    },
    /// Threads or their runtime cannot be started.
    #[error("cannot start the threads of the service")]
    Threads(#[source] std::io::Error),
    /// The system gives no random numbers.
    #[error("the system gives no random numbers")]
    Random,
}

impl Error {
    /// Suggested remedy, if one is known.
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Listen { .. } => Some("choose another port, or 0 for any that is free"),
            Self::Open(_) => {
                Some("set a token, listen on 127.0.0.1, or allow everybody with --without-token")
            }
            Self::Token(_) | Self::TokenCharacters => Some("make one with `openssl rand -hex 32`"),
            Self::Certificate { .. } => {
                Some("give a chain of certificates and its key, both as PEM")
            }
            Self::Threads(_) | Self::Random => None,
        }
    }
}
