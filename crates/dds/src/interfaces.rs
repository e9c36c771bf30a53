//! Addresses of this machine, and the choice among the addresses of another participant.

use std::net::{Ipv4Addr, SocketAddrV4};

use crate::writer::Destination;

/// IPv4 addresses of this machine with their netmasks.
#[derive(Clone, Debug)]
pub(crate) struct Interfaces {
    addresses: Vec<(Ipv4Addr, Ipv4Addr)>,
}

impl Interfaces {
    /// All interfaces, only the loopback interface, or only the one with this address.
    pub(crate) fn of_machine(localhost_only: bool, only: Option<Ipv4Addr>) -> Self {
        let found = if_addrs::get_if_addrs().unwrap_or_default();
        let mut addresses: Vec<_> = found
            .into_iter()
            .filter(|interface| interface.is_oper_up() || interface.is_loopback())
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

    /// Addresses to announce: the loopback address only if there is no other.
    pub(crate) fn announced(&self) -> Vec<Ipv4Addr> {
        let others: Vec<_> = self.all().filter(|ip| !ip.is_loopback()).collect();
        if others.is_empty() {
            self.all().collect()
        } else {
            others
        }
    }

    /// The best address of a participant: one of this machine if all are, else its source address, one in
    /// a network of this machine, or the first.
    pub(crate) fn destination(
        &self,
        addresses: &[SocketAddrV4],
        heard: Ipv4Addr,
    ) -> Option<Destination> {
        let is_own = |ip: &Ipv4Addr| self.all().any(|own| own == *ip);
        // A loopback address announced beside others may belong to another machine.
        let (loopback, others): (Vec<_>, Vec<_>) = addresses
            .iter()
            .partition::<Vec<&SocketAddrV4>, _>(|address| address.ip().is_loopback());
        let at = |address: &&SocketAddrV4, on_host| {
            Some(Destination {
                address: **address,
                on_host,
            })
        };
        let is_restricted = self.all().all(|own| own.is_loopback());
        if is_restricted || others.is_empty() {
            let reached = loopback.first().filter(|address| is_own(address.ip()));
            return reached.and_then(|address| at(address, true));
        }
        // Container bridges have the same address on many machines, so a single match proves nothing.
        if others.iter().all(|address| is_own(address.ip())) {
            return others.first().and_then(|address| at(address, true));
        }
        let is_near = |ip: Ipv4Addr| {
            self.addresses.iter().any(|(own, mask)| {
                u32::from(*own) & u32::from(*mask) == u32::from(ip) & u32::from(*mask)
            })
        };
        let remote = || others.iter().filter(|address| !is_own(address.ip()));
        remote()
            .find(|address| *address.ip() == heard)
            .or_else(|| remote().find(|address| is_near(*address.ip())))
            .or_else(|| remote().next())
            .and_then(|address| at(address, false))
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
    fn the_best_address_is_used() {
        let own = interfaces(&[[127, 0, 0, 1], [10, 0, 0, 2], [172, 17, 0, 1]]);
        let (near, far, bridge) = ([10, 0, 0, 9], [192, 168, 1, 9], [172, 17, 0, 1]);
        let loopback = [127, 0, 0, 1];
        for (addresses, heard, expected) in [
            (
                &[[10, 0, 0, 2], bridge][..],
                [10, 0, 0, 2],
                Some(([10, 0, 0, 2], true)),
            ),
            (&[loopback], loopback, Some((loopback, true))),
            // Another machine, which has a bridge with the same address.
            (&[bridge, near], near, Some((near, false))),
            (&[loopback, far, near], [8, 8, 8, 8], Some((near, false))),
            (&[loopback, near, far], far, Some((far, false))),
            (&[loopback, far], [8, 8, 8, 8], Some((far, false))),
            (&[], near, None),
        ] {
            let addresses: Vec<_> = addresses.iter().map(|&ip| at(ip)).collect();
            let expected = expected.map(|(ip, on_host)| Destination {
                address: at(ip),
                on_host,
            });
            assert_eq!(own.destination(&addresses, heard.into()), expected);
        }
        assert_eq!(own.announced(), [[10, 0, 0, 2], bridge].map(Ipv4Addr::from));
    }

    #[test]
    fn localhost_only_reaches_nothing_else() {
        let own = interfaces(&[[127, 0, 0, 1]]);
        let heard = [10, 0, 0, 9].into();
        assert_eq!(own.announced(), [Ipv4Addr::LOCALHOST]);
        assert!(own.destination(&[at([10, 0, 0, 9])], heard).is_none());
        let both = [at([10, 0, 0, 9]), at([127, 0, 0, 1])];
        assert!(own.destination(&both, heard).is_some());
    }
}
