//! A service on the loopback interface, and a client that can send malformed requests.

use lsdc_core::{Completer, Weights};
use lsdc_serve::{Config, Handle, Server};
use std::fmt::Write as _;
use std::io::Write as _;
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::sync::OnceLock;
use std::thread::JoinHandle;

/// Returns the completer shared by all tests.
pub(crate) fn completer() -> Completer {
    static COMPLETER: OnceLock<Completer> = OnceLock::new();
    COMPLETER
        .get_or_init(|| Completer::new(&Weights::builtin_small()).unwrap())
        .clone()
}

/// A service that ends when this is dropped.
pub(crate) struct Running {
    pub(crate) address: SocketAddr,
    pub(crate) handle: Handle,
    thread: Option<JoinHandle<()>>,
}

impl Running {
    pub(crate) fn new(config: Config) -> Self {
        let server = Server::bind(completer(), ([127, 0, 0, 1], 0).into(), config).unwrap();
        let (address, handle) = (server.address(), server.handle());
        let thread = std::thread::spawn(|| server.run().unwrap());
        Self {
            address,
            handle,
            thread: Some(thread),
        }
    }

    /// Ends the service, and waits for its thread.
    pub(crate) fn end(&mut self) {
        self.handle.end();
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }

    pub(crate) fn get(&self, path: &str) -> Reply {
        self.ask("GET", path, &[], &[])
    }

    /// Posts a form and accepts the given type.
    pub(crate) fn post(&self, path: &str, accept: &str, parts: &[Part<'_>]) -> Reply {
        let (kind, body) = form(parts);
        self.ask(
            "POST",
            path,
            &[("accept", accept), ("content-type", &kind)],
            &body,
        )
    }

    pub(crate) fn ask(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: &[u8],
    ) -> Reply {
        let bytes = request(self.address, method, path, headers, body);
        self.send(&bytes)
            .unwrap_or_else(|| panic!("no answer to {method} {path}"))
    }

    /// Sends bytes unchanged. `None` if the connection is dropped without an answer.
    pub(crate) fn send(&self, bytes: &[u8]) -> Option<Reply> {
        let mut stream = self.connect();
        // The service may have stopped reading.
        let _ = stream.write_all(bytes);
        Reply::read(&mut stream)
    }

    pub(crate) fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).unwrap()
    }

    /// Returns the value of a metric.
    pub(crate) fn metric(&self, name: &str) -> Option<f64> {
        let text = String::from_utf8(self.get("/metrics").body).unwrap();
        let mut lines = text.lines().filter_map(|line| line.rsplit_once(' '));
        let found = lines.find(|(own, _)| *own == name);
        found.map(|(_, value)| value.parse().unwrap())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.handle.end();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Returns the bytes of a request that asks to close the connection.
pub(crate) fn request(
    address: SocketAddr,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: &[u8],
) -> Vec<u8> {
    let mut head = format!("{method} {path} HTTP/1.1\r\nconnection: close\r\n");
    if !headers.iter().any(|(name, _)| *name == "host") {
        write!(head, "host: {address}\r\n").unwrap();
    }
    let lengths = ["content-length", "transfer-encoding"];
    if method == "POST" && !headers.iter().any(|(name, _)| lengths.contains(name)) {
        write!(head, "content-length: {}\r\n", body.len()).unwrap();
    }
    for (name, value) in headers {
        write!(head, "{name}: {value}\r\n").unwrap();
    }
    [head.as_bytes(), b"\r\n", body].concat()
}

/// An answer.
#[derive(Debug)]
pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) headers: Vec<(String, String)>,
    pub(crate) body: Vec<u8>,
}

impl Reply {
    /// Reads an answer up to the end of the connection.
    pub(crate) fn read(stream: &mut impl std::io::Read) -> Option<Self> {
        let mut bytes = Vec::new();
        // The connection may be reset after the answer.
        let _ = stream.read_to_end(&mut bytes);
        let end = bytes.windows(4).position(|four| four == b"\r\n\r\n")?;
        let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
        let mut lines = head.lines();
        let status = lines.next()?.split(' ').nth(1)?.parse().unwrap();
        let headers = lines.filter_map(|line| line.split_once(": "));
        let headers = headers.map(|(name, value)| (name.to_owned(), value.to_owned()));
        let reply = Self {
            status,
            headers: headers.collect(),
            body: bytes[end + 4..].to_vec(),
        };
        if let Some(length) = reply.header("content-length") {
            assert_eq!(length.parse(), Ok(reply.body.len()), "{head}");
        }
        Some(reply)
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let mut headers = self.headers.iter();
        headers
            .find(|(own, _)| own == name)
            .map(|(_, value)| value.as_str())
    }

    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {self:?}"))
    }

    /// The error message.
    pub(crate) fn message(&self) -> String {
        self.json()["error"]["message"].as_str().unwrap().to_owned()
    }
}

/// A part of a form.
#[derive(Clone, Copy)]
pub(crate) struct Part<'a> {
    pub(crate) name: &'a str,
    /// The file name; `None` if it is a text.
    pub(crate) file: Option<&'a str>,
    pub(crate) bytes: &'a [u8],
}

/// A file of a form.
pub(crate) fn file<'a>(name: &'a str, file: &'a str, bytes: &'a [u8]) -> Part<'a> {
    let file = Some(file);
    Part { name, file, bytes }
}

/// A text of a form.
pub(crate) fn text<'a>(name: &'a str, text: &'a str) -> Part<'a> {
    let (file, bytes) = (None, text.as_bytes());
    Part { name, file, bytes }
}

/// Returns the content type and the bytes of a form.
pub(crate) fn form(parts: &[Part<'_>]) -> (String, Vec<u8>) {
    const BOUNDARY: &str = "xxBOUNDARYxx";
    let mut body = Vec::new();
    for part in parts {
        let file = part.file.map(|file| format!("; filename=\"{file}\""));
        let (name, file) = (part.name, file.unwrap_or_default());
        let head = format!(
            "--{BOUNDARY}\r\ncontent-disposition: form-data; name=\"{name}\"{file}\r\n\r\n"
        );
        body.extend([head.as_bytes(), part.bytes, b"\r\n"].concat());
    }
    body.extend(format!("--{BOUNDARY}--\r\n").as_bytes());
    (format!("multipart/form-data; boundary={BOUNDARY}"), body)
}

/// A file of the rendered room.
pub(crate) fn asset(name: &str) -> Vec<u8> {
    std::fs::read(asset_path(name)).unwrap()
}

pub(crate) fn asset_path(name: &str) -> PathBuf {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    root.join("../../assets/room").join(name)
}
