//! Sockets of a participant: for messages, for announcements, and for multicast.

use std::{
    io,
    net::{Ipv4Addr, SocketAddrV4, UdpSocket},
    time::Duration,
};

use socket2::{Domain, Protocol, Socket, Type};

use crate::{Error, Result, interfaces::Interfaces, settings::Settings};

const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);

/// Largest number of participants of a machine in a domain.
const INDICES: u16 = 120;

/// Number of participants of a machine that are tried without multicast.
const LOOKED_FOR: u16 = 10;

/// Interval at which a receiving thread checks whether to stop.
pub(crate) const TIMEOUT: Duration = Duration::from_millis(100);

pub(crate) struct Sockets {
    pub(crate) multicast: UdpSocket,
    pub(crate) discovery: UdpSocket,
    /// Also sends all unicast datagrams.
    pub(crate) messages: UdpSocket,
    /// One for each interface.
    announcers: Vec<UdpSocket>,
    announcements: Vec<SocketAddrV4>,
    group: SocketAddrV4,
}

impl Sockets {
    pub(crate) fn open(domain: u32, settings: &Settings, interfaces: &Interfaces) -> Result<Self> {
        let base = u16::try_from(domain)
            .ok()
            .filter(|domain| *domain <= 232)
            .map(|domain| 7400 + 250 * domain)
            .ok_or(Error::Domain(domain))?;
        let failed = |source| Error::Socket { domain, source };
        let (discovery, messages) = (0..INDICES)
            .filter_map(|index| base.checked_add(10 + 2 * index))
            .filter_map(|port| Some((port, port.checked_add(1)?)))
            .find_map(|(discovery, messages)| {
                let pair = bind(discovery, settings)
                    .and_then(|discovery| Ok((discovery, bind(messages, settings)?)));
                match pair {
                    Err(error) if error.kind() == io::ErrorKind::AddrInUse => None,
                    pair => Some(pair),
                }
            })
            .ok_or(Error::NoPort(domain))?
            .map_err(failed)?;
        let multicast = multicast(base, settings, interfaces).map_err(failed)?;
        let announcers = interfaces
            .all()
            .filter_map(|interface| announcer(interface).ok())
            .collect();
        let machines = [Ipv4Addr::LOCALHOST]
            .into_iter()
            .chain(settings.peers.iter().copied());
        let announcements = machines
            .flat_map(|ip| {
                (0..LOOKED_FOR)
                    .filter_map(move |index| base.checked_add(10 + 2 * index))
                    // Some participants have no predictable port and listen at the multicast port.
                    .chain([base])
                    .map(move |port| SocketAddrV4::new(ip, port))
            })
            .collect();
        Ok(Self {
            multicast,
            discovery,
            messages,
            announcers,
            announcements,
            group: SocketAddrV4::new(GROUP, base),
        })
    }

    /// Ports for announcements and for messages.
    pub(crate) fn ports(&self) -> io::Result<(u16, u16)> {
        Ok((
            self.discovery.local_addr()?.port(),
            self.messages.local_addr()?.port(),
        ))
    }

    /// Sends an announcement to everyone. Returns the number of sockets that failed.
    pub(crate) fn announce(&self, announcement: &[u8]) -> u64 {
        let failed = self
            .announcers
            .iter()
            .filter(|socket| socket.send_to(announcement, self.group).is_err())
            .count();
        for to in &self.announcements {
            // It is no error if nobody listens.
            let _ = self.discovery.send_to(announcement, to);
        }
        failed as u64
    }
}

fn udp() -> io::Result<Socket> {
    Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))
}

fn bind(port: u16, settings: &Settings) -> io::Result<UdpSocket> {
    let socket = udp()?;
    let ip = match settings.interface {
        Some(interface) => interface,
        None if settings.localhost_only => Ipv4Addr::LOCALHOST,
        None => Ipv4Addr::UNSPECIFIED,
    };
    socket.bind(&SocketAddrV4::new(ip, port).into())?;
    // A system that refuses the size keeps its default.
    let _ = socket.set_recv_buffer_size(settings.socket_buffer);
    let _ = socket.set_send_buffer_size(settings.socket_buffer);
    socket.set_read_timeout(Some(TIMEOUT))?;
    Ok(socket.into())
}

fn multicast(port: u16, settings: &Settings, interfaces: &Interfaces) -> io::Result<UdpSocket> {
    let socket = udp()?;
    // All participants of the machine share this port.
    socket.set_reuse_address(true)?;
    #[cfg(all(unix, not(any(target_os = "solaris", target_os = "illumos"))))]
    socket.set_reuse_port(true)?;
    socket.bind(&SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, port).into())?;
    let _ = socket.set_recv_buffer_size(settings.socket_buffer);
    for interface in interfaces.all() {
        // Tunnels have no multicast; ROS_STATIC_PEERS reaches participants behind them.
        let _ = socket.join_multicast_v4(&GROUP, &interface);
    }
    socket.set_read_timeout(Some(TIMEOUT))?;
    Ok(socket.into())
}

fn announcer(interface: Ipv4Addr) -> io::Result<UdpSocket> {
    let socket = udp()?;
    socket.bind(&SocketAddrV4::new(interface, 0).into())?;
    socket.set_multicast_if_v4(&interface)?;
    socket.set_multicast_loop_v4(true)?;
    Ok(socket.into())
}
