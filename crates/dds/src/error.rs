//! What can be wrong with a participant and its topics.

use std::{io, net::Ipv4Addr, result};

/// What is wrong, where, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A domain beyond those whose ports exist.
    #[error("domain {0} has no ports; ROS_DOMAIN_ID is between 0 and 232")]
    Domain(u32),
    /// An environment variable that cannot be read.
    #[error("`{name}` is not understood: `{value}`; expected {expected}")]
    Environment {
        /// Its name.
        name: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        expected: &'static str,
    },
    /// A name of a topic or a type that ROS 2 does not have.
    #[error("`{name}` is no {what} of ROS 2; expected one like `{example}`")]
    Name {
        /// The name.
        name: String,
        /// What it should name.
        what: &'static str,
        /// A valid name.
        example: &'static str,
    },
    /// No network interface with an IPv4 address, or not the one that was asked for.
    #[error("no network interface has the IPv4 address {0}")]
    NoInterface(Ipv4Addr),
    /// All ports of participants are taken.
    #[error(
        "all ports of domain {0} are taken; end other participants, or use another ROS_DOMAIN_ID"
    )]
    NoPort(u32),
    /// A socket could not be opened.
    #[error("cannot open a socket of domain {domain}: {source}")]
    Socket {
        /// The domain.
        domain: u32,
        /// Why not.
        source: io::Error,
    },
    /// A message that is larger than [`Settings::largest_message`](crate::Settings::largest_message), or shorter than
    /// the four bytes that CDR begins with.
    #[error("a message of {bytes} bytes cannot be sent; between 4 and {largest} can")]
    MessageSize {
        /// Its size.
        bytes: usize,
        /// The largest that is sent.
        largest: usize,
    },
}

/// Of everything here.
pub type Result<T> = result::Result<T, Error>;
