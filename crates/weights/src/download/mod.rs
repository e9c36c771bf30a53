//! Encoders from where they are published, over HTTP.
//!
//! What arrives is a file that says by itself which encoder it is ([`recognise`](super::recognise)), so that servers and
//! mirrors need not be trusted. A download goes on where it broke, in this run or the next, if the server says that its
//! file is the same ([`Part`]).

mod part;

use super::known::Known;
use super::store::{Added, Store};
use lsdc_files::error::{Cause, Error, Result};
use part::{Origin, Part, remove, remove_parts};
use std::io::Read as _;
use std::net::IpAddr;
use std::slice::from_ref;
use std::time::Duration;
use ureq::http::header::{
    ACCEPT_RANGES, CONTENT_RANGE, ETAG, HeaderName, IF_RANGE, LAST_MODIFIED, RANGE,
};
use ureq::http::{Response, StatusCode, Uri};
use ureq::{Agent, Body, Proxy};

/// What a download may take.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Bytes of the file.
    pub bytes: u64,
    /// Connections, each of which must bring something.
    pub connections: usize,
    /// How long a server may be silent.
    pub silence: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            bytes: 1 << 28,
            connections: 50,
            silence: Duration::from_mins(1),
        }
    }
}

/// How a download goes.
#[derive(Debug)]
pub enum Event<'a> {
    /// A server answers; so many bytes were there before.
    Begun {
        /// Where the file comes from.
        place: &'a str,
        /// Bytes that an earlier connection has brought.
        before: u64,
        /// Bytes of the file, if the server says so.
        total: Option<u64>,
    },
    /// So many bytes are there.
    Reached(u64),
    /// The connection broke, and another one is opened.
    Broken(&'a Error),
    /// A place has failed, and another one is asked.
    Elsewhere(&'a Error),
}

/// Downloads an encoder from the first of `places` that has it, checks it, and adds it to the store. One that is there
/// is replaced if `replace` is set.
///
/// # Errors
/// No place has it, or the folder cannot be written. What has arrived by then is kept for the next time, unless it is
/// something else.
pub fn get(
    store: &Store,
    known: &Known,
    places: &[&str],
    replace: bool,
    limits: &Limits,
    tell: &mut dyn FnMut(Event<'_>),
) -> Result<Added> {
    if store.path(known).exists() && !replace {
        return store.load(known).map(|_| Added::Before);
    }
    let mut failed = None;
    for place in places {
        if let Some(error) = &failed {
            tell(Event::Elsewhere(error));
        }
        match get_from(store, known, place, limits, tell) {
            Ok(()) => {
                remove_parts(store.folder(), known);
                return Ok(Added::New);
            }
            // No other place helps.
            Err(error) if error.cause() == Cause::Write => return Err(error),
            Err(error) => failed = Some(error),
        }
    }
    let error = failed.unwrap_or_else(|| Error::config("there is no place to download from"));
    Err(match error.advice() {
        Some(_) => error,
        None => error.hint(format!(
            "`lsdc weights add FILE` takes the file from {}, however you get it",
            known.places.first().unwrap_or(&"elsewhere")
        )),
    })
}

fn get_from(
    store: &Store,
    known: &Known,
    place: &str,
    limits: &Limits,
    tell: &mut dyn FnMut(Event<'_>),
) -> Result<()> {
    let mut part = Part::open(store.folder(), known, place)?;
    if !part.is_whole()
        && let Err(error) = fetch(place, &mut part, limits, tell)
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
            let what = format!("what `{place}` sends is not {name}");
            Err(Error::new(Cause::Format, what).because(error))
        }
        added => added.map(|_| ()),
    }
}

/// How a connection ended, if not by an error that another one would not change.
enum End {
    Whole,
    Broken(Error),
    /// There is another file now, so that nothing is left of the part.
    Changed,
}

/// Completes a part, by as many connections as it takes.
fn fetch(
    place: &str,
    part: &mut Part,
    limits: &Limits,
    tell: &mut dyn FnMut(Event<'_>),
) -> Result<()> {
    let agent = agent(place, limits);
    let mut reached = part.length();
    for _ in 0..limits.connections {
        let error = match connect(&agent, place, part, limits, tell) {
            Ok(End::Whole) => return Ok(()),
            Ok(End::Changed) => {
                reached = 0;
                continue;
            }
            Ok(End::Broken(error)) => error,
            Err(error) => return Err(keeping(error, part)),
        };
        if part.length() <= reached {
            return Err(keeping(error, part));
        }
        reached = part.length();
        tell(Event::Broken(&error));
    }
    let what = format!("{} connections to `{place}` broke", limits.connections);
    Err(keeping(Error::new(Cause::Network, what), part))
}

/// Says what is left of a failed download.
fn keeping(error: Error, part: &Part) -> Error {
    match part.length() {
        0 => error,
        bytes if part.version().is_some() => error.hint(format!(
            "the first {:.1} MB are kept; the same command goes on from there",
            bytes as f64 / 1e6
        )),
        _ => error.hint("the same command begins anew; this server does not continue downloads"),
    }
}

/// One request, and what it brings.
fn connect(
    agent: &Agent,
    place: &str,
    part: &mut Part,
    limits: &Limits,
    tell: &mut dyn FnMut(Event<'_>),
) -> Result<End> {
    let mut request = agent.get(place);
    let before = part.length();
    if let Some(version) = part.version().filter(|_| before > 0) {
        request = request
            .header(RANGE, format!("bytes={before}-"))
            .header(IF_RANGE, version);
    }
    let response = match request.call() {
        Ok(response) => response,
        Err(error) => return Ok(End::Broken(lost("cannot reach", place).because(error))),
    };
    match response.status() {
        StatusCode::PARTIAL_CONTENT if continues(&response, part) => {}
        StatusCode::OK => part.begin(origin(place, &response))?,
        StatusCode::PARTIAL_CONTENT | StatusCode::RANGE_NOT_SATISFIABLE if before > 0 => {
            part.begin(Origin::default())?;
            return Ok(End::Changed);
        }
        status => {
            let reason = status.canonical_reason().unwrap_or_default();
            let what = format!("the answer is {} {reason} from", status.as_u16());
            return Err(lost(&what, place));
        }
    }
    receive(response, place, part, limits, tell)
}

/// Adds what an answer brings to the part.
fn receive(
    response: Response<Body>,
    place: &str,
    part: &mut Part,
    limits: &Limits,
    tell: &mut dyn FnMut(Event<'_>),
) -> Result<End> {
    let total = part.total();
    let too_long = || {
        let most = limits.bytes >> 20;
        let what = format!("more than {most} MiB, too much for an encoder, come from");
        lost(&what, place)
    };
    if total.is_some_and(|total| total > limits.bytes) {
        return Err(too_long());
    }
    tell(Event::Begun {
        place,
        before: part.length(),
        total,
    });
    let mut body = response.into_body().into_reader();
    let mut buffer = vec![0; 1 << 16];
    let broken = loop {
        let count = match body.read(&mut buffer) {
            Ok(0) => break None,
            Ok(count) => count,
            Err(error) => break Some(lost("the connection broke to", place).because(error)),
        };
        if part.length() + count as u64 > limits.bytes {
            part.begin(Origin::default())?;
            return Err(too_long());
        }
        part.append(&buffer[..count])?;
        tell(Event::Reached(part.length()));
    };
    part.sync()?;
    Ok(match broken {
        Some(error) => End::Broken(error),
        None if total.is_none_or(|total| total == part.length()) => End::Whole,
        None => End::Broken(lost("the file ends early from", place)),
    })
}

fn lost(what: &str, place: &str) -> Error {
    Error::new(Cause::Network, format!("{what} `{place}`"))
}

/// Whether a partial answer begins where the part ends, in the same version of the file.
fn continues(response: &Response<Body>, part: &Part) -> bool {
    let range = header(response, &CONTENT_RANGE).unwrap_or_default();
    let starts = range.strip_prefix("bytes ").and_then(|range| {
        let (first, _) = range.split_once('-')?;
        first.trim().parse().ok()
    });
    let same = version(response).is_none_or(|version| part.version() == Some(version));
    starts == Some(part.length()) && same
}

/// What a whole answer says about its file.
fn origin(place: &str, response: &Response<Body>) -> Origin {
    let ranges = header(response, &ACCEPT_RANGES) != Some("none");
    Origin {
        place: place.to_owned(),
        version: version(response).filter(|_| ranges).map(str::to_owned),
        total: response.body().content_length(),
    }
}

/// What tells versions of a file apart, byte by byte (RFC 9110, 13.1.5): an entity tag that is not weak, or a date.
fn version(response: &Response<Body>) -> Option<&str> {
    let tag = header(response, &ETAG).filter(|tag| tag.starts_with('"'));
    tag.or_else(|| header(response, &LAST_MODIFIED))
}

fn header<'a>(response: &'a Response<Body>, name: &HeaderName) -> Option<&'a str> {
    response.headers().get(name)?.to_str().ok()
}

fn agent(place: &str, limits: &Limits) -> Agent {
    let silence = Some(limits.silence);
    let proxy = Proxy::try_from_env().filter(|_| !is_this_machine(place));
    Agent::config_builder()
        .http_status_as_error(false)
        .user_agent(concat!("lsdc/", env!("CARGO_PKG_VERSION")))
        .accept_encoding("identity")
        .proxy(proxy)
        .timeout_resolve(silence)
        .timeout_connect(silence)
        .timeout_recv_response(silence)
        .timeout_per_read(silence)
        .build()
        .new_agent()
}

/// Whether no proxy leads there.
fn is_this_machine(place: &str) -> bool {
    let uri: Option<Uri> = place.parse().ok();
    let host = uri.as_ref().and_then(Uri::host).unwrap_or_default();
    let address: Option<IpAddr> = host.trim_matches(['[', ']']).parse().ok();
    host == "localhost" || address.is_some_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests;
