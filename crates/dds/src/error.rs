//! Errors of participants and topics.

use std::{io, net::Ipv4Addr, result};

/// What is wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The domain is too large: its ports would not exist.
    #[error("domain {0} has no ports; ROS_DOMAIN_ID is between 0 and 232")]
    Domain(u32),
    /// An environment variable is invalid.
    #[error("`{name}` is not understood: `{value}`; expected {expected}")]
    Environment {
        /// Its name.
        name: &'static str,
        /// Its value.
        value: String,
        /// Accepted values.
        expected: &'static str,
    },
    /// An invalid name of a topic or a type.
    #[error("`{name}` is no {what} of ROS 2; expected one like `{example}`")]
    Name {
        /// The name.
        name: String,
        /// What the name is for.
        what: &'static str,
        /// A valid name.
        example: &'static str,
    },
    /// No network interface has an IPv4 address, or none has the requested one.
    #[error("no network interface has the IPv4 address {0}")]
    NoInterface(Ipv4Addr),
    /// All ports for participants are in use.
    #[error(
        "all ports of domain {0} are taken; end other participants, or use another ROS_DOMAIN_ID"
    )]
    NoPort(u32),
    /// A socket could not be opened.
    #[error("cannot open a socket of domain {domain}: {source}")]
    Socket {
        /// The domain.
        domain: u32,
        /// The error of the system.
        source: io::Error,
    },
    /// The message is larger than [`Settings::largest_message`](crate::Settings::largest_message), or shorter than
    /// the four bytes of the CDR encapsulation.
    #[error("a message of {bytes} bytes cannot be sent; between 4 and {largest} can")]
    MessageSize {
        /// Its size.
        bytes: usize,
        /// The largest that is sent.
        largest: usize,
    },
}

/// Result with the [`Error`] of this crate.
pub type Result<T> = result::Result<T, Error>;
