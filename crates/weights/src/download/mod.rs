//! Downloads of published encoders over HTTP.
//!
//! A file is identified by its values ([`recognise`](super::recognise)), so that servers and mirrors need not be trusted.
//! An interrupted download is resumed, in this run or the next, if the server confirms that its file is the same
//! ([`PartialDownload`]).

mod part;

use super::known::KnownEncoder;
use super::store::{Installation, Store};
use lsdc_files::error::{Cause, Error, Result};
use part::{Origin, PartialDownload, remove, remove_parts};
use std::io::Read as _;
use std::net::IpAddr;
use std::slice::from_ref;
use std::time::Duration;
use ureq::http::header::{
    ACCEPT_RANGES, CONTENT_RANGE, ETAG, HeaderName, IF_RANGE, LAST_MODIFIED, RANGE,
};
use ureq::http::{Response, StatusCode, Uri};
use ureq::{Agent, Body, Proxy};

/// Limits of a download.
#[derive(Clone, Copy, Debug)]
pub struct DownloadLimits {
    /// Largest size of the file in bytes.
    pub bytes: u64,
    /// Largest number of connections, each of which must transfer something.
    pub connections: usize,
    /// Longest time without data from the server.
    pub timeout: Duration,
}

impl Default for DownloadLimits {
    fn default() -> Self {
        Self {
            bytes: 1 << 28,
            connections: 50,
            timeout: Duration::from_mins(1),
        }
    }
}

/// Progress of a download.
#[derive(Debug)]
pub enum DownloadEvent<'a> {
    /// A server has answered.
    Started {
        /// Address of the file.
        url: &'a str,
        /// Bytes of earlier connections, after which the download is resumed.
        resumed_bytes: u64,
        /// Size of the file in bytes, if the server sends it.
        total_bytes: Option<u64>,
    },
    /// Bytes of the file received so far.
    Progress(u64),
    /// The connection was interrupted, and another one is opened.
    Interrupted(&'a Error),
    /// An address has failed, and the next one is tried.
    NextUrl(&'a Error),
}

/// Downloads an encoder from the first of `urls` that has it, checks it, and adds it to the store. An existing one is
/// replaced if `replace` is set.
///
/// # Errors
/// No address has it, or the folder cannot be written. Received data are kept for the next time, unless they are not the
/// encoder.
pub fn get(
    store: &Store,
    known: &KnownEncoder,
    urls: &[&str],
    replace: bool,
    limits: &DownloadLimits,
    on_event: &mut dyn FnMut(DownloadEvent<'_>),
) -> Result<Installation> {
    if store.path(known).exists() && store.has_head(known) && !replace {
        return store.load(known).map(|_| Installation::Unchanged);
    }
    let mut last_error = None;
    for url in urls {
        if let Some(error) = &last_error {
            on_event(DownloadEvent::NextUrl(error));
        }
        match get_from_url(store, known, url, limits, on_event) {
            Ok(()) => {
                remove_parts(store.folder(), known);
                return Ok(Installation::New);
            }
            // Another address would not help.
            Err(error) if error.cause() == Cause::Write => return Err(error),
            Err(error) => last_error = Some(error),
        }
    }
    let error = last_error.unwrap_or_else(|| Error::config("there is no place to download from"));
    Err(match error.advice() {
        Some(_) => error,
        None => error.hint(format!(
            "`lsdc weights add FILE` takes the file from {}, however you get it",
            known.urls.first().unwrap_or(&"elsewhere")
        )),
    })
}

fn get_from_url(
    store: &Store,
    known: &KnownEncoder,
    url: &str,
    limits: &DownloadLimits,
    on_event: &mut dyn FnMut(DownloadEvent<'_>),
) -> Result<()> {
    let mut part = PartialDownload::open(store.folder(), known, url)?;
    if !part.is_whole()
        && let Err(error) = fetch(url, &mut part, limits, on_event)
    {
        if part.length() == 0 || part.version().is_none() {
            part.remove();
        }
        return Err(error);
    }
    let path = part.close();
    match store.add(&path, from_ref(known), true) {
        Err(error) if error.cause() != Cause::Write => {
            remove(&path);
            let name = known.name;
            let what = format!("what `{url}` sends is not {name}");
            Err(Error::new(Cause::Format, what).because(error))
        }
        added => added.map(|_| ()),
    }
}

/// End of a connection, except for errors that another connection would not change.
enum End {
    Whole,
    Broken(Error),
    /// The file has changed, so the partial download was discarded.
    Changed,
}

/// Completes a partial download with as many connections as needed.
fn fetch(
    url: &str,
    part: &mut PartialDownload,
    limits: &DownloadLimits,
    on_event: &mut dyn FnMut(DownloadEvent<'_>),
) -> Result<()> {
    let agent = agent(url, limits);
    let mut length_before = part.length();
    for _ in 0..limits.connections {
        let error = match connect(&agent, url, part, limits, on_event) {
            Ok(End::Whole) => return Ok(()),
            Ok(End::Changed) => {
                length_before = 0;
                continue;
            }
            Ok(End::Broken(error)) => error,
            Err(error) => return Err(with_resume_hint(error, part)),
        };
        if part.length() <= length_before {
            return Err(with_resume_hint(error, part));
        }
        length_before = part.length();
        on_event(DownloadEvent::Interrupted(&error));
    }
    let what = format!("{} connections to `{url}` broke", limits.connections);
    Err(with_resume_hint(Error::new(Cause::Network, what), part))
}

/// Adds a hint about the remaining part of a failed download.
fn with_resume_hint(error: Error, part: &PartialDownload) -> Error {
    match part.length() {
        0 => error,
        bytes if part.version().is_some() => error.hint(format!(
            "the first {:.1} MB are kept; the same command goes on from there",
            bytes as f64 / 1e6
        )),
        _ => error.hint("the same command begins anew; this server does not continue downloads"),
    }
}

/// Sends a request and receives its data.
fn connect(
    agent: &Agent,
    url: &str,
    part: &mut PartialDownload,
    limits: &DownloadLimits,
    on_event: &mut dyn FnMut(DownloadEvent<'_>),
) -> Result<End> {
    let mut request = agent.get(url);
    let before = part.length();
    if let Some(version) = part.version().filter(|_| before > 0) {
        request = request
            .header(RANGE, format!("bytes={before}-"))
            .header(IF_RANGE, version);
    }
    let response = match request.call() {
        Ok(response) => response,
        Err(error) => {
            return Ok(End::Broken(
                network_error("cannot reach", url).because(error),
            ));
        }
    };
    match response.status() {
        StatusCode::PARTIAL_CONTENT if is_continuation(&response, part) => {}
        StatusCode::OK => part.begin(origin(url, &response))?,
        StatusCode::PARTIAL_CONTENT | StatusCode::RANGE_NOT_SATISFIABLE if before > 0 => {
            part.begin(Origin::default())?;
            return Ok(End::Changed);
        }
        status => {
            let reason = status.canonical_reason().unwrap_or_default();
            let what = format!("the answer is {} {reason} from", status.as_u16());
            return Err(network_error(&what, url));
        }
    }
    receive(response, url, part, limits, on_event)
}

/// Appends the data of a response to the partial download.
fn receive(
    response: Response<Body>,
    url: &str,
    part: &mut PartialDownload,
    limits: &DownloadLimits,
    on_event: &mut dyn FnMut(DownloadEvent<'_>),
) -> Result<End> {
    let total = part.total();
    let too_long = || {
        let most = limits.bytes >> 20;
        let what = format!("more than {most} MiB, too much for an encoder, come from");
        network_error(&what, url)
    };
    if total.is_some_and(|total| total > limits.bytes) {
        return Err(too_long());
    }
    on_event(DownloadEvent::Started {
        url,
        resumed_bytes: part.length(),
        total_bytes: total,
    });
    let mut body = response.into_body().into_reader();
    let mut buffer = vec![0; 1 << 16];
    let broken = loop {
        let count = match body.read(&mut buffer) {
            Ok(0) => break None,
            Ok(count) => count,
            Err(error) => break Some(network_error("the connection broke to", url).because(error)),
        };
        if part.length() + count as u64 > limits.bytes {
            part.begin(Origin::default())?;
            return Err(too_long());
        }
        part.append(&buffer[..count])?;
        on_event(DownloadEvent::Progress(part.length()));
    };
    part.sync()?;
    Ok(match broken {
        Some(error) => End::Broken(error),
        None if total.is_none_or(|total| total == part.length()) => End::Whole,
        None => End::Broken(network_error("the file ends early from", url)),
    })
}

fn network_error(what: &str, url: &str) -> Error {
    Error::new(Cause::Network, format!("{what} `{url}`"))
}

/// Whether a partial response continues the partial download, in the same version of the file.
fn is_continuation(response: &Response<Body>, part: &PartialDownload) -> bool {
    let range = header(response, &CONTENT_RANGE).unwrap_or_default();
    let starts = range.strip_prefix("bytes ").and_then(|range| {
        let (first, _) = range.split_once('-')?;
        first.trim().parse().ok()
    });
    let same = version(response).is_none_or(|version| part.version() == Some(version));
    starts == Some(part.length()) && same
}

/// Returns the origin that a full response declares.
fn origin(url: &str, response: &Response<Body>) -> Origin {
    let ranges = header(response, &ACCEPT_RANGES) != Some("none");
    Origin {
        url: url.to_owned(),
        version: version(response).filter(|_| ranges).map(str::to_owned),
        total: response.body().content_length(),
    }
}

/// Returns a strong validator of the file (RFC 9110, 13.1.5): an entity tag that is not weak, or a date.
fn version(response: &Response<Body>) -> Option<&str> {
    let tag = header(response, &ETAG).filter(|tag| tag.starts_with('"'));
    tag.or_else(|| header(response, &LAST_MODIFIED))
}

fn header<'a>(response: &'a Response<Body>, name: &HeaderName) -> Option<&'a str> {
    response.headers().get(name)?.to_str().ok()
}

fn agent(url: &str, limits: &DownloadLimits) -> Agent {
    let timeout = Some(limits.timeout);
    let proxy = Proxy::try_from_env().filter(|_| !is_this_machine(url));
    Agent::config_builder()
        .http_status_as_error(false)
        .user_agent(concat!("lsdc/", env!("CARGO_PKG_VERSION")))
        .accept_encoding("identity")
        .proxy(proxy)
        .timeout_resolve(timeout)
        .timeout_connect(timeout)
        .timeout_recv_response(timeout)
        .timeout_per_read(timeout)
        .build()
        .new_agent()
}

/// Whether an address is this machine, which is never reached through a proxy.
fn is_this_machine(url: &str) -> bool {
    let uri: Option<Uri> = url.parse().ok();
    let host = uri.as_ref().and_then(Uri::host).unwrap_or_default();
    let address: Option<IpAddr> = host.trim_matches(['[', ']']).parse().ok();
    host == "localhost" || address.is_some_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests;
