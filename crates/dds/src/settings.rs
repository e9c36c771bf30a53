//! Settings of a participant, and the environment variables from which ROS 2 reads them.

use std::{env, net::Ipv4Addr};

use crate::{Error, Result};

/// The generation of ROS 2 of the other participants. Topics are the same in all; the node graph differs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Generation {
    /// Up to Humble: identifiers of 24 bytes in the node graph.
    Humble,
    /// From Iron on, with Jazzy: identifiers of 16 bytes.
    #[default]
    Jazzy,
}

/// How a [`Participant`](crate::Participant) takes part in a domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Name of the node that `ros2 node list` shows.
    pub node: String,
    /// Its namespace.
    pub namespace: String,
    /// Layout of the graph of nodes.
    pub generation: Generation,
    /// Communicate only with participants of this machine.
    pub localhost_only: bool,
    /// Use only the interface with this address.
    pub interface: Option<Ipv4Addr>,
    /// Machines to contact without multicast.
    pub peers: Vec<Ipv4Addr>,
    /// Size of the largest message, sent or received, in bytes.
    pub largest_message: usize,
    /// Requested size of the socket buffers in bytes. The system may grant less: `net.core.rmem_max` on Linux.
    pub socket_buffer: usize,
    /// Bytes of a message sent at once. A pause of 0.3 ms follows, so that a receiver with a small buffer keeps up;
    /// 0 disables the pauses.
    pub burst: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            node: "lsdc".into(),
            namespace: "/".into(),
            generation: Generation::default(),
            localhost_only: false,
            interface: None,
            peers: Vec::new(),
            largest_message: 64 << 20,
            socket_buffer: 8 << 20,
            burst: 128 << 10,
        }
    }
}

impl Settings {
    /// Returns the domain and the settings in the environment variables of ROS 2: `ROS_DOMAIN_ID`,
    /// `ROS_LOCALHOST_ONLY`, `ROS_AUTOMATIC_DISCOVERY_RANGE`, `ROS_STATIC_PEERS`, `ROS_DISTRO`.
    ///
    /// # Errors
    ///
    /// A variable has an invalid value.
    pub fn from_environment() -> Result<(u32, Self)> {
        Self::from_variables(|name| env::var(name).ok())
    }

    /// The same, with the variables that `value` returns.
    ///
    /// # Errors
    ///
    /// A value that is not understood.
    pub fn from_variables(value: impl Fn(&str) -> Option<String>) -> Result<(u32, Self)> {
        let value = |name| value(name).filter(|value| !value.is_empty());
        let wrong = |name, value: String, expected| Error::Environment {
            name,
            value,
            expected,
        };
        let mut settings = Self::default();
        let domain = match value("ROS_DOMAIN_ID") {
            None => 0,
            Some(text) => text
                .trim()
                .parse()
                .map_err(|_| wrong("ROS_DOMAIN_ID", text, "a number between 0 and 232"))?,
        };
        settings.localhost_only = match value("ROS_LOCALHOST_ONLY").as_deref() {
            None | Some("0") => false,
            Some("1") => true,
            Some(text) => return Err(wrong("ROS_LOCALHOST_ONLY", text.into(), "0 or 1")),
        };
        match value("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
            None | Some("SUBNET" | "SYSTEM_DEFAULT") => {}
            // Without any discovery, nothing could be received.
            Some("LOCALHOST" | "OFF") => settings.localhost_only = true,
            Some(text) => {
                let expected = "SUBNET, LOCALHOST, OFF or SYSTEM_DEFAULT";
                return Err(wrong(
                    "ROS_AUTOMATIC_DISCOVERY_RANGE",
                    text.into(),
                    expected,
                ));
            }
        }
        if let Some(text) = value("ROS_STATIC_PEERS") {
            for peer in text.split(';').filter(|peer| !peer.is_empty()) {
                let address = peer.trim().parse().map_err(|_| {
                    wrong(
                        "ROS_STATIC_PEERS",
                        text.clone(),
                        "IPv4 addresses with `;` between them",
                    )
                })?;
                settings.peers.push(address);
            }
        }
        if let Some("foxy" | "galactic" | "humble") = value("ROS_DISTRO").as_deref() {
            settings.generation = Generation::Humble;
        }
        Ok((domain, settings))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(variables: &[(&str, &str)]) -> Result<(u32, Settings)> {
        Settings::from_variables(|name| {
            let found = variables.iter().find(|(variable, _)| *variable == name);
            found.map(|(_, value)| (*value).into())
        })
    }

    #[test]
    fn variables_of_ros_are_read() {
        let (domain, settings) = read(&[]).expect("no variables");
        assert_eq!((domain, settings), (0, Settings::default()));
        let (domain, settings) = read(&[
            ("ROS_DOMAIN_ID", "42"),
            ("ROS_LOCALHOST_ONLY", "1"),
            ("ROS_DISTRO", "humble"),
            ("ROS_STATIC_PEERS", "10.0.0.3;10.0.0.4"),
        ])
        .expect("variables");
        assert_eq!(domain, 42);
        assert!(settings.localhost_only);
        assert_eq!(settings.generation, Generation::Humble);
        assert_eq!(
            settings.peers,
            [[10, 0, 0, 3], [10, 0, 0, 4]].map(Ipv4Addr::from)
        );
    }

    #[test]
    fn other_values_are_refused() {
        for (name, value) in [
            ("ROS_DOMAIN_ID", "robot"),
            ("ROS_LOCALHOST_ONLY", "yes"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "WORLD"),
            ("ROS_STATIC_PEERS", "robot.local"),
        ] {
            let error = read(&[(name, value)]).expect_err(name).to_string();
            assert!(error.contains(name) && error.contains(value), "{error}");
        }
    }
}
