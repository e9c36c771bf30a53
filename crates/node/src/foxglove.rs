//! Images, depths, clouds and diagnostics for Foxglove, over its WebSocket protocol (`foxglove.websocket.v1` and
//! `foxglove.sdk.v1`, which are the same for a server that only sends).

use crate::clock::Clock;
use crate::transport::{Advertisement, Deliver, Publisher, Subscription, Transport};
use lsdc_files::error::{Cause, Error, Result};
use lsdc_recordings::message_definition;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tungstenite::handshake::server::{ErrorResponse, Request, Response};
use tungstenite::http::{HeaderValue, StatusCode, header};
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Message, WebSocket};

/// Accepted subprotocols, the preferred one first.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// Limit of simultaneous clients.
const CLIENTS: usize = 8;
/// Limit of a request, in bytes.
const LARGEST: usize = 1 << 20;
/// Limit of subscriptions per client.
const SUBSCRIPTIONS: usize = 256;
/// Time limit of the handshake and of each message sent to a client.
const PATIENCE: Duration = Duration::from_secs(5);

/// A server that shows topics in Foxglove.
///
/// Slow clients miss messages: only the newest message of each topic waits.
#[derive(Clone)]
pub struct Foxglove {
    shared: Arc<Shared>,
    address: SocketAddr,
}

struct Shared {
    clock: Arc<dyn Clock>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    channels: Vec<Channel>,
    clients: BTreeMap<u64, Arc<Client>>,
    next: u64,
}

/// A topic. Its identifier in the protocol is its index in the list plus one.
#[derive(Clone)]
struct Channel {
    topic: String,
    kind: String,
}

/// A connection.
#[derive(Default)]
struct Client {
    outbox: Mutex<Outbox>,
    filled: Condvar,
}

#[derive(Default)]
struct Outbox {
    /// Subscription identifiers by channel.
    subscriptions: BTreeMap<usize, u32>,
    texts: Vec<String>,
    /// The newest unsent message of each channel, and when it was received.
    messages: BTreeMap<usize, (u64, Arc<[u8]>)>,
    /// Where the search for the next message starts, so that channels take turns.
    turn: usize,
    is_closed: bool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Foxglove {
    /// Listens on an address; port 0 picks a free port.
    ///
    /// # Errors
    /// The address is in use, or a thread cannot be started.
    pub fn listen(address: SocketAddr, clock: Arc<dyn Clock>) -> Result<Self> {
        let failed = |error| {
            Error::new(Cause::Network, format!("cannot listen on {address}"))
                .because(error)
                .hint("give another port")
        };
        let listener = TcpListener::bind(address).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let shared = Arc::new(Shared {
            clock,
            state: Mutex::default(),
        });
        let server = Self {
            shared: shared.clone(),
            address,
        };
        let accept = move || {
            for stream in listener.incoming().flatten() {
                if lock(&shared.state).clients.len() < CLIENTS {
                    let shared = shared.clone();
                    let name = "lsdc-foxglove".to_owned();
                    let thread = std::thread::Builder::new().name(name);
                    // Without a thread, the connection closes.
                    let _ = thread.spawn(move || shared.serve(stream));
                }
            }
        };
        let thread = std::thread::Builder::new().name("lsdc-foxglove".to_owned());
        thread.spawn(accept).map_err(failed)?;
        Ok(server)
    }

    /// The address on which it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Wraps a transport so that its topics of known types are also shown in Foxglove.
    pub fn beside<'a>(&self, inner: &'a mut dyn Transport) -> ShownTransport<'a> {
        ShownTransport {
            inner,
            server: self.clone(),
        }
    }

    /// Announces a topic. Returns `None` for unknown types.
    fn channel(&self, topic: &str, kind: &str) -> Option<usize> {
        message_definition(kind)?;
        let mut state = lock(&self.shared.state);
        let channel = Channel {
            topic: topic.to_owned(),
            kind: kind.to_owned(),
        };
        let number = state.channels.len();
        let text = advertise(&[(number, &channel)]);
        state.channels.push(channel);
        for client in state.clients.values() {
            client.say(text.clone());
        }
        Some(number)
    }

    fn send(&self, channel: usize, message: &[u8]) {
        let state = lock(&self.shared.state);
        let wanted =
            |client: &&Arc<Client>| lock(&client.outbox).subscriptions.contains_key(&channel);
        let clients: Vec<&Arc<Client>> = state.clients.values().filter(wanted).collect();
        if clients.is_empty() {
            return;
        }
        let message: Arc<[u8]> = message.into();
        let stamp = u64::try_from(self.shared.clock.stamp()).unwrap_or(0);
        for client in clients {
            lock(&client.outbox)
                .messages
                .insert(channel, (stamp, message.clone()));
            client.filled.notify_one();
        }
    }
}

/// The message that advertises channels.
fn advertise(channels: &[(usize, &Channel)]) -> String {
    let described = channels.iter().map(|(number, channel)| {
        json!({
            "id": number + 1, "topic": channel.topic, "encoding": "cdr", "schemaName": channel.kind,
            "schema": message_definition(&channel.kind), "schemaEncoding": "ros2msg",
        })
    });
    let described: Vec<Value> = described.collect();
    json!({"op": "advertise", "channels": described}).to_string()
}

impl Client {
    fn say(&self, text: String) {
        lock(&self.outbox).texts.push(text);
        self.filled.notify_one();
    }

    fn close(&self) {
        lock(&self.outbox).is_closed = true;
        self.filled.notify_one();
    }

    /// Blocks until there is a message to send; `None` once the client has left.
    fn next(&self) -> Option<Message> {
        let is_idle = |outbox: &mut Outbox| {
            outbox.texts.is_empty() && outbox.messages.is_empty() && !outbox.is_closed
        };
        let outbox = self.filled.wait_while(lock(&self.outbox), is_idle);
        let mut outbox = outbox.unwrap_or_else(PoisonError::into_inner);
        if outbox.is_closed {
            return None;
        }
        if !outbox.texts.is_empty() {
            return Some(Message::text(outbox.texts.remove(0)));
        }
        let turn = outbox.turn;
        let after = outbox.messages.range(turn..).next();
        let channel = *after.or(outbox.messages.iter().next())?.0;
        let (stamp, message) = outbox.messages.remove(&channel)?;
        outbox.turn = channel + 1;
        // The client may have unsubscribed meanwhile.
        let Some(subscription) = outbox.subscriptions.get(&channel) else {
            return Some(Message::Ping(Vec::new().into()));
        };
        let mut bytes = Vec::with_capacity(13 + message.len());
        bytes.push(1);
        bytes.extend(subscription.to_le_bytes());
        bytes.extend(stamp.to_le_bytes());
        bytes.extend(&*message);
        Some(Message::binary(bytes))
    }

    /// Handles a request; unknown ones are ignored.
    fn obey(&self, text: &str, channels: usize) {
        let Ok(request) = serde_json::from_str::<Value>(text) else {
            return;
        };
        let list = |name: &str| request[name].as_array().cloned().unwrap_or_default();
        let mut outbox = lock(&self.outbox);
        match request["op"].as_str() {
            Some("subscribe") => {
                for wanted in list("subscriptions") {
                    let id = wanted["id"].as_u64().and_then(|id| u32::try_from(id).ok());
                    let channel = wanted["channelId"]
                        .as_u64()
                        .and_then(|id| id.checked_sub(1));
                    let (Some(id), Some(channel)) = (id, channel) else {
                        continue;
                    };
                    if channel < channels as u64 && outbox.subscriptions.len() < SUBSCRIPTIONS {
                        outbox.subscriptions.insert(channel as usize, id);
                    }
                }
            }
            Some("unsubscribe") => {
                let ended: Vec<u64> = list("subscriptionIds")
                    .iter()
                    .filter_map(Value::as_u64)
                    .collect();
                outbox
                    .subscriptions
                    .retain(|_, id| !ended.contains(&u64::from(*id)));
            }
            _ => {}
        }
    }
}

/// A connection to which two threads write whole frames.
struct SharedStream {
    stream: TcpStream,
    gate: Arc<Mutex<()>>,
}

impl Read for SharedStream {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.stream.read(buffer)
    }
}

impl Write for SharedStream {
    fn write(&mut self, buffer: &[u8]) -> std::io::Result<usize> {
        let _turn = lock(&self.gate);
        self.stream.write_all(buffer)?;
        Ok(buffer.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.stream.flush()
    }
}

impl Shared {
    /// Serves a client until it leaves.
    fn serve(&self, stream: TcpStream) {
        // A client that violates the protocol is disconnected.
        let _ = self.converse(stream);
    }

    fn converse(&self, stream: TcpStream) -> std::result::Result<(), Box<dyn std::error::Error>> {
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        let config = WebSocketConfig::default()
            .max_message_size(Some(LARGEST))
            .max_frame_size(Some(LARGEST));
        let upgraded =
            tungstenite::accept_hdr_with_config(stream.try_clone()?, agreed, Some(config));
        drop(upgraded.map_err(|error| error.to_string())?);
        stream.set_read_timeout(None)?;
        let gate = Arc::new(Mutex::new(()));
        let half = |stream| {
            let stream = SharedStream {
                stream,
                gate: gate.clone(),
            };
            WebSocket::from_raw_socket(stream, Role::Server, Some(config))
        };
        let (mut reader, mut writer) = (half(stream.try_clone()?), half(stream.try_clone()?));
        let client = Arc::new(Client::default());
        let number = self.greet(&client);
        let sender = client.clone();
        let sending = std::thread::Builder::new().name("lsdc-foxglove".to_owned());
        let sending = sending.spawn(move || {
            while let Some(message) = sender.next() {
                if writer.send(message).is_err() {
                    // Also ends the reading thread.
                    let _ = stream.shutdown(std::net::Shutdown::Both);
                    return;
                }
            }
        });
        while let Ok(message) = reader.read() {
            if let Message::Text(text) = message {
                let channels = lock(&self.state).channels.len();
                client.obey(&text, channels);
            }
        }
        lock(&self.state).clients.remove(&number);
        client.close();
        drop(sending);
        Ok(())
    }

    /// Advertises all channels to a client, and registers it.
    fn greet(&self, client: &Arc<Client>) -> u64 {
        let mut state = lock(&self.state);
        client.say(
            json!({
                "op": "serverInfo", "name": concat!("lsdc ", env!("CARGO_PKG_VERSION")), "capabilities": [],
                "supportedEncodings": ["cdr"], "metadata": {},
            })
            .to_string(),
        );
        let channels: Vec<_> = state.channels.iter().enumerate().collect();
        client.say(advertise(&channels));
        let number = state.next;
        state.next += 1;
        state.clients.insert(number, client.clone());
        number
    }
}

/// Negotiates the subprotocol.
#[allow(clippy::result_large_err)]
fn agreed(
    request: &Request,
    mut response: Response,
) -> std::result::Result<Response, ErrorResponse> {
    let offered = request.headers().get_all(header::SEC_WEBSOCKET_PROTOCOL);
    let offered = offered.iter().filter_map(|offer| offer.to_str().ok());
    let offered: Vec<&str> = offered
        .flat_map(|offer| offer.split(','))
        .map(str::trim)
        .collect();
    let Some(protocol) = PROTOCOLS.into_iter().find(|known| offered.contains(known)) else {
        let mut refused = ErrorResponse::new(Some("this is a server for Foxglove".to_owned()));
        *refused.status_mut() = StatusCode::BAD_REQUEST;
        return Err(refused);
    };
    response.headers_mut().insert(
        header::SEC_WEBSOCKET_PROTOCOL,
        HeaderValue::from_static(protocol),
    );
    Ok(response)
}

/// A transport whose topics are also shown in Foxglove.
pub struct ShownTransport<'a> {
    inner: &'a mut dyn Transport,
    server: Foxglove,
}

impl Transport for ShownTransport<'_> {
    fn subscribe(&mut self, subscription: &Subscription, mut deliver: Deliver) -> Result<()> {
        let Subscription { topic, kind, .. } = subscription;
        let Some(channel) = self.server.channel(topic, kind) else {
            return self.inner.subscribe(subscription, deliver);
        };
        let server = self.server.clone();
        let both = move |message: Vec<u8>| {
            server.send(channel, &message);
            deliver(message);
        };
        self.inner.subscribe(subscription, Box::new(both))
    }

    fn advertise(&mut self, advertisement: &Advertisement) -> Result<Box<dyn Publisher>> {
        let inner = self.inner.advertise(advertisement)?;
        let Advertisement { topic, kind, .. } = advertisement;
        let server = self.server.clone();
        Ok(match self.server.channel(topic, kind) {
            None => inner,
            Some(channel) => Box::new(ShownPublisher {
                inner,
                server,
                channel,
            }),
        })
    }
}

struct ShownPublisher {
    inner: Box<dyn Publisher>,
    server: Foxglove,
    channel: usize,
}

impl Publisher for ShownPublisher {
    fn publish(&self, message: &[u8]) -> Result<()> {
        self.server.send(self.channel, message);
        self.inner.publish(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ManualClock, MemoryTransport, Qos};
    use tungstenite::ClientRequestBuilder;
    use tungstenite::stream::MaybeTlsStream;

    type Viewer = WebSocket<MaybeTlsStream<TcpStream>>;

    fn connect(server: &Foxglove, protocol: &str) -> tungstenite::Result<Viewer> {
        let address = format!("ws://{}", server.address());
        let request = ClientRequestBuilder::new(address.parse().unwrap());
        let connected = tungstenite::connect(request.with_sub_protocol(protocol));
        connected.map(|(viewer, _)| viewer)
    }

    fn text(viewer: &mut Viewer) -> Value {
        let message = viewer.read().unwrap();
        serde_json::from_str(message.to_text().unwrap()).unwrap()
    }

    /// Sends a request, and waits until it was read: a pong answers what follows it.
    fn request(viewer: &mut Viewer, request: &Value) {
        viewer.send(Message::text(request.to_string())).unwrap();
        viewer.send(Message::Ping(Vec::new().into())).unwrap();
        while !matches!(viewer.read().unwrap(), Message::Pong(_)) {}
    }

    fn server() -> (Foxglove, Arc<ManualClock>) {
        let clock = Arc::new(ManualClock::default());
        let address = "127.0.0.1:0".parse().unwrap();
        (Foxglove::listen(address, clock.clone()).unwrap(), clock)
    }

    #[test]
    fn viewers_receive_what_they_subscribe_to() {
        let (server, clock) = server();
        let mut bus = MemoryTransport::default();
        let depth = Advertisement {
            topic: "/depth".to_owned(),
            kind: "sensor_msgs/msg/Image".to_owned(),
            qos: Qos::RESULTS,
        };
        let other = Advertisement {
            topic: "/other".to_owned(),
            kind: "my_msgs/msg/Other".to_owned(),
            ..depth.clone()
        };
        let mut shown = server.beside(&mut bus);
        let publisher = shown.advertise(&depth).unwrap();
        shown.advertise(&other).unwrap();
        for protocol in PROTOCOLS {
            let mut viewer = connect(&server, protocol).unwrap();
            assert_eq!(text(&mut viewer)["op"], "serverInfo");
            let channels = text(&mut viewer)["channels"].clone();
            assert_eq!(
                channels.as_array().unwrap().len(),
                1,
                "unknown types are not shown"
            );
            let channel = &channels[0];
            assert_eq!(
                (&channel["topic"], &channel["encoding"]),
                (&json!("/depth"), &json!("cdr"))
            );
            assert!(channel["schema"].as_str().unwrap().contains("uint32 step"));
            // Neither what is not subscribed to is sent, nor what is no request obeyed.
            publisher.publish(b"before").unwrap();
            request(
                &mut viewer,
                &json!({"op": "subscribe", "subscriptions": [{"id": 3, "channelId": 99}, {"id": -1}, 7]}),
            );
            publisher.publish(b"before").unwrap();
            let wanted = json!([{"id": 7, "channelId": channel["id"]}]);
            request(
                &mut viewer,
                &json!({"op": "subscribe", "subscriptions": wanted}),
            );
            clock.set(258);
            publisher.publish(b"depth").unwrap();
            let expected = [&[1, 7, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0][..], b"depth"].concat();
            assert_eq!(viewer.read().unwrap().into_data(), expected);
            request(
                &mut viewer,
                &json!({"op": "unsubscribe", "subscriptionIds": [7]}),
            );
            publisher.publish(b"after").unwrap();
            request(&mut viewer, &json!("anything"));
            viewer.close(None).unwrap();
        }
    }

    #[test]
    fn other_protocols_are_refused() {
        let (server, _) = server();
        assert!(connect(&server, "chat").is_err());
        assert!(connect(&server, PROTOCOLS[0]).is_ok());
    }

    /// What waits for a slow viewer is the newest message of each channel, and channels take turns.
    #[test]
    fn the_newest_message_of_each_channel_waits() {
        let client = Client::default();
        let put = |channel: usize, byte: u8| {
            let mut outbox = lock(&client.outbox);
            outbox.subscriptions.insert(channel, channel as u32);
            outbox.messages.insert(channel, (0, Arc::from([byte])));
        };
        let last = || *client.next().unwrap().into_data().last().unwrap();
        put(0, 1);
        put(0, 2);
        put(1, 3);
        assert_eq!(last(), 2);
        put(0, 4);
        assert_eq!((last(), last()), (3, 4));
        client.close();
        assert!(client.next().is_none());
    }
}
