//! Sends forty hostile requests, one after the other, to one service.

use crate::client::{Reply, Running, asset, file, request, text};
use crate::requests::{Expected, hostile};
use crate::{ALONE, counted};
use lsdc_serve::{Config, Limits};
use std::fmt::Write as _;
use std::io::Write as _;
use std::sync::PoisonError;
use std::time::Duration;

/// Small limits, so that every request exceeds one of them.
pub(crate) fn limits() -> Limits {
    Limits {
        body: 1 << 20,
        pixels: 200_000,
        points: 500,
        unfolded: 4 << 20,
        head: Duration::from_millis(200),
        pace: Duration::from_millis(200),
        workers: 1,
        ..Limits::default()
    }
}

/// Largest number of bytes for a refused request: its body, and the decompressed size of a file.
const MOST: usize = 4 << 20;

/// Largest number of bytes for a request that is completed nevertheless: up to 24 MiB for the network, independent parts of
/// which may run at the same time, and 30 MiB for the field's update matrices, which are freed after each image.
const MOST_ANSWERED: usize = 64 << 20;

#[test]
fn forty_hostile_requests_do_no_harm() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let service = Running::new(Config {
        limits: limits(),
        ..Config::default()
    });
    let rgb = asset("rgb.png");
    let parts = [
        file("image", "rgb.png", &rgb),
        text("points", "[[10, 20, 2], [200, 100, 3]]"),
    ];
    let depth = || {
        let reply = service.post("/v1/complete", "image/png", &parts);
        assert_eq!(
            reply.status,
            200,
            "{}",
            String::from_utf8_lossy(&reply.body)
        );
        reply.body
    };
    let before = depth();
    let mut table = String::new();
    let all = hostile(service.address);
    assert!(all.len() >= 40, "{}", all.len());
    for case in all {
        let mut answer = None;
        let taken = counted::most(|| answer = service.send(&case.bytes));
        let status = answer.as_ref().map(|reply| reply.status);
        let said = answer.map(|reply| String::from_utf8_lossy(&reply.body).into_owned());
        let as_expected = match case.expected {
            Expected::Status(expected) => status == Some(expected),
            Expected::Dropped => status.is_none() || status == Some(408),
        };
        assert!(as_expected, "{}: {status:?} {said:?}", case.sent);
        let most = if status == Some(200) {
            MOST_ANSWERED
        } else {
            MOST
        };
        assert!(taken < most, "{}: {taken} bytes", case.sent);
        let said = said.unwrap_or_default();
        assert!(
            !said.contains("/tmp") && !said.contains("panicked"),
            "{said}"
        );
        let kib = taken.next_multiple_of(1024) >> 10;
        let status = case.expected.shown();
        writeln!(table, "| {} | {status} | {kib} KiB |", case.sent).unwrap();
    }
    println!("{table}");
    assert_eq!(service.metric("lsdc_panics_total"), Some(0.0));
    assert!(depth() == before);
    check_documents();
}

/// The number of places limits the memory of bodies, however many clients send one.
#[test]
fn bodies_take_no_more_memory_than_their_places() {
    const BODY: usize = 2 << 20;
    const PLACES: usize = 3;
    const CLIENTS: usize = 24;
    /// Growing vectors, and the buffers of connections.
    const ROOM: usize = PLACES * 3 * BODY + CLIENTS * (256 << 10);
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let service = Running::new(Config {
        limits: Limits {
            body: BODY as u64,
            workers: 1,
            queue: PLACES - 1,
            ..Limits::default()
        },
        ..Config::default()
    });
    let rgb = asset("rgb.png");
    let posted = service.post("/v1/scenes", "*/*", &[file("image", "rgb.png", &rgb)]);
    let path = posted.header("location").unwrap().to_owned() + "/complete";
    let body = format!("{{\"points\": [[10, 20, 2]{}]}}", " ".repeat(BODY - 100));
    let headers = [("content-type", "application/json")];
    let layers = request(service.address, "POST", &path, &headers, body.as_bytes());
    let (most, rest) = layers.split_at(layers.len() - 1);
    let mut streams: Vec<_> = (0..CLIENTS).map(|_| service.connect()).collect();
    // Computations, with their memory, begin after the last byte.
    let taken = counted::most(|| {
        for stream in &mut streams {
            stream.write_all(most).unwrap();
        }
        assert_eq!(service.metric("lsdc_places"), Some(PLACES as f64));
    });
    for stream in &mut streams {
        stream.write_all(rest).unwrap();
    }
    let replies = streams
        .iter_mut()
        .map(|stream| Reply::read(stream).unwrap());
    let statuses: Vec<_> = replies.map(|reply| reply.status).collect();
    let count = |status| statuses.iter().filter(|found| **found == status).count();
    assert_eq!((count(200), count(429)), (PLACES, CLIENTS - PLACES));
    assert!(taken < ROOM, "{taken} bytes");
    const { assert!(ROOM < CLIENTS * BODY) };
}

/// Checks that `hostile.md` lists all requests with their statuses.
fn check_documents() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let guide = std::fs::read_to_string(root.join("tests/memory/hostile.md")).unwrap();
    for case in hostile(([127, 0, 0, 1], 1).into()) {
        let row = format!("| {} | {} |", case.sent, case.expected.shown());
        assert!(guide.contains(&row), "hostile.md lacks: {row}");
    }
}

/// A good request for comparison; buffers of earlier requests may still be allocated.
#[test]
fn a_good_request_takes_more_than_a_refused_one() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let service = Running::new(Config::default());
    let rgb = asset("rgb.png");
    let parts = [
        file("image", "rgb.png", &rgb),
        text("points", "[[10, 20, 2], [200, 100, 3]]"),
    ];
    let taken = counted::most(|| {
        let reply = service.post("/v1/complete", "application/x-npz", &parts);
        assert_eq!(reply.status, 200);
    });
    println!("a completion at 304x228: {} MiB", taken >> 20);
    assert!(taken > MOST, "{taken} bytes");
    let ask = request(service.address, "GET", "/healthz", &[], &[]);
    assert!(counted::most(|| assert!(service.send(&ask).is_some())) < 1 << 20);
}
