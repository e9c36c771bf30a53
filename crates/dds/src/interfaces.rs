//! The addresses of this machine, and which address of another participant is used.

use std::net::{Ipv4Addr, SocketAddrV4};

use crate::writer::Destination;

/// IPv4 addresses of this machine with their netmasks.
#[derive(Clone, Debug)]
pub(crate) struct Interfaces {
    addresses: Vec<(Ipv4Addr, Ipv4Addr)>,
}

impl Interfaces {
    /// All of this machine, only the loopback interface, or only one with this address.
    pub(crate) fn of_machine(localhost_only: bool, only: Option<Ipv4Addr>) -> Self {
        let found = if_addrs::get_if_addrs().unwrap_or_default();
        let mut addresses: Vec<_> = found
            .into_iter()
            .filter_map(|interface| match interface.addr {
                if_addrs::IfAddr::V4(address) => Some((address.ip, address.netmask)),
                if_addrs::IfAddr::V6(_) => None,
            })
            .filter(|(ip, _)| match only {
                Some(only) => *ip == only,
                None => !localhost_only || ip.is_loopback(),
            })
            .collect();
        // The loopback interface exists on every machine, whether or not it is listed.
        let loopback = (Ipv4Addr::LOCALHOST, Ipv4Addr::new(255, 0, 0, 0));
        if only.is_none() && !addresses.contains(&loopback) {
            addresses.push(loopback);
        }
        Self { addresses }
    }

    #[cfg(test)]
    pub(crate) fn new(addresses: Vec<(Ipv4Addr, Ipv4Addr)>) -> Self {
        Self { addresses }
    }

    pub(crate) fn all(&self) -> impl Iterator<Item = Ipv4Addr> {
        self.addresses.iter().map(|(ip, _)| *ip)
    }

    /// Those that others are told: the loopback address only if there is no other.
    pub(crate) fn announced(&self) -> Vec<Ipv4Addr> {
        let others: Vec<_> = self.all().filter(|ip| !ip.is_loopback()).collect();
        if others.is_empty() {
            self.all().collect()
        } else {
            others
        }
    }

    /// The best of the addresses of a participant: one of this machine, one in a network of this machine, or the first.
    pub(crate) fn destination(&self, addresses: &[SocketAddrV4]) -> Option<Destination> {
        let on_host = |address: &&SocketAddrV4| {
            !address.ip().is_loopback() && self.all().any(|own| own == *address.ip())
        };
        // A loopback address is announced beside others too, and is then not that of this machine.
        let only_loopback = addresses.iter().all(|address| address.ip().is_loopback());
        let is_restricted = self.all().all(|own| own.is_loopback());
        let loopback = |address: &&SocketAddrV4| {
            (only_loopback || is_restricted)
                && address.ip().is_loopback()
                && self.all().any(|own| own.is_loopback())
        };
        if let Some(&address) = addresses
            .iter()
            .find(on_host)
            .or_else(|| addresses.iter().find(loopback))
        {
            return Some(Destination {
                address,
                on_host: true,
            });
        }
        if is_restricted {
            return None;
        }
        let is_near = |address: &&SocketAddrV4| {
            self.addresses.iter().any(|(own, mask)| {
                !own.is_loopback()
                    && u32::from(*own) & u32::from(*mask)
                        == u32::from(*address.ip()) & u32::from(*mask)
            })
        };
        let remote = |address: &&SocketAddrV4| !address.ip().is_loopback();
        addresses
            .iter()
            .find(is_near)
            .or_else(|| addresses.iter().find(remote))
            .map(|&address| Destination {
                address,
                on_host: false,
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ip: [u8; 4]) -> SocketAddrV4 {
        SocketAddrV4::new(ip.into(), 7411)
    }

    fn interfaces(addresses: &[[u8; 4]]) -> Interfaces {
        let mask = Ipv4Addr::new(255, 255, 255, 0);
        Interfaces::new(addresses.iter().map(|&ip| (ip.into(), mask)).collect())
    }

    #[test]
    fn the_nearest_address_is_used() {
        let own = interfaces(&[[127, 0, 0, 1], [10, 0, 0, 2], [192, 168, 1, 5]]);
        for (addresses, expected) in [
            (&[[10, 0, 0, 2]][..], Some(([10, 0, 0, 2], true))),
            (&[[127, 0, 0, 1]], Some(([127, 0, 0, 1], true))),
            (
                &[[127, 0, 0, 1], [172, 17, 0, 1], [192, 168, 1, 9]],
                Some(([192, 168, 1, 9], false)),
            ),
            (
                &[[127, 0, 0, 1], [172, 17, 0, 1]],
                Some(([172, 17, 0, 1], false)),
            ),
            (&[], None),
        ] {
            let addresses: Vec<_> = addresses.iter().map(|&ip| at(ip)).collect();
            let expected = expected.map(|(ip, on_host)| Destination {
                address: at(ip),
                on_host,
            });
            assert_eq!(own.destination(&addresses), expected);
        }
        assert_eq!(
            own.announced(),
            [[10, 0, 0, 2], [192, 168, 1, 5]].map(Ipv4Addr::from)
        );
    }

    #[test]
    fn localhost_only_reaches_nothing_else() {
        let own = interfaces(&[[127, 0, 0, 1]]);
        assert_eq!(own.announced(), [Ipv4Addr::LOCALHOST]);
        assert!(own.destination(&[at([10, 0, 0, 9])]).is_none());
        assert!(
            own.destination(&[at([10, 0, 0, 9]), at([127, 0, 0, 1])])
                .is_some()
        );
    }
}
