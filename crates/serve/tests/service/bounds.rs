//! Every limit, and requests that exceed it.

use crate::client::{Reply, Running, asset, file, form, request, text};
use lsdc_serve::{Config, Limits};
use std::io::{Read as _, Write as _};
use std::time::Duration;

fn with(change: impl FnOnce(&mut Limits)) -> Running {
    let mut limits = Limits::default();
    change(&mut limits);
    Running::new(Config {
        limits,
        ..Config::default()
    })
}

fn complete(service: &Running, points: &str) -> Reply {
    let rgb = asset("rgb.png");
    let parts = [file("image", "rgb.png", &rgb), text("points", points)];
    service.post("/v1/complete", "application/json", &parts)
}

const POINTS: &str = "[[10, 20, 2.0], [200, 100, 2.5]]";

/// Checks that a request was refused with a word in its message, and that the service still works.
fn refused(service: &Running, reply: &Reply, status: u16, word: &str) {
    assert_eq!(
        reply.status,
        status,
        "{}",
        String::from_utf8_lossy(&reply.body)
    );
    assert!(reply.message().contains(word), "{}", reply.message());
    let error = reply.json()["error"]["request"].clone();
    assert_eq!(error.as_str(), reply.header("x-request-id"));
    assert_eq!(service.get("/healthz").status, 200);
}

#[test]
fn bytes_are_counted_declared_or_not() {
    let service = with(|limits| limits.body = 200_000);
    let large = asset("rgb.png").repeat(3);
    let parts = [file("image", "rgb.png", &large), text("points", POINTS)];
    let reply = service.post("/v1/complete", "*/*", &parts);
    refused(&service, &reply, 413, "200000 bytes");
    // In chunks, without a declared length.
    let (kind, body) = form(&parts);
    let mut chunked = Vec::new();
    for piece in body.chunks(10_000) {
        chunked.extend(format!("{:x}\r\n", piece.len()).into_bytes());
        chunked.extend([piece, b"\r\n"].concat());
    }
    chunked.extend(b"0\r\n\r\n");
    let headers = [
        ("content-type", kind.as_str()),
        ("transfer-encoding", "chunked"),
    ];
    let reply = service.ask("POST", "/v1/complete", &headers, &chunked);
    refused(&service, &reply, 413, "200000 bytes");
}

#[test]
fn pixels_are_counted_before_they_are_decoded() {
    let service = with(|limits| limits.pixels = 304 * 228 - 1);
    refused(&service, &complete(&service, POINTS), 413, "304x228 pixels");
    // The head of the file is enough to refuse it.
    let head = &asset("rgb.png")[..100];
    let parts = [file("image", "rgb.png", head), text("points", POINTS)];
    let reply = service.post("/v1/complete", "*/*", &parts);
    assert!([413, 422].contains(&reply.status), "{reply:?}");
}

#[test]
fn points_are_counted_as_a_list_and_in_files() {
    let service = with(|limits| limits.points = 2);
    assert_eq!(complete(&service, POINTS).status, 200);
    let three = "[[10, 20, 2.0], [200, 100, 2.5], [30, 30, 2]]";
    refused(
        &service,
        &complete(&service, three),
        413,
        "more than 2 points",
    );
    let rgb = asset("rgb.png");
    let table = b"u,v,depth\n10,20,2\n20,20,2\n90,20,2\n";
    let parts = [
        file("image", "rgb.png", &rgb),
        file("points", "a.csv", table),
    ];
    let reply = service.post("/v1/complete", "*/*", &parts);
    refused(&service, &reply, 413, "more than 2 points");
}

#[test]
fn what_files_unfold_to_is_bounded() {
    let service = with(|limits| limits.unfolded = 250_000);
    // The colours of 304 x 228 pixels fit, but not as many floats.
    assert_eq!(complete(&service, POINTS).status, 200);
    let map = lsdc_files::DepthMap::new(304, 228, vec![2.0; 304 * 228]).unwrap();
    let packed = lsdc_files::encode_npz(&[("depth", &map)]).unwrap();
    assert!(packed.len() < 10_000);
    let rgb = asset("rgb.png");
    let parts = [
        file("image", "rgb.png", &rgb),
        file("points", "a.npz", &packed),
    ];
    let reply = service.post("/v1/complete", "*/*", &parts);
    refused(&service, &reply, 413, "is too large");
    assert!(
        reply.message().starts_with("`a.npz`"),
        "{}",
        reply.message()
    );
}

#[test]
fn a_request_has_its_time() {
    let service = with(|limits| limits.request = Duration::ZERO);
    refused(
        &service,
        &complete(&service, POINTS),
        503,
        "no answer within",
    );
    assert_eq!(
        service.metric("lsdc_rejected_total{reason=\"late\"}"),
        Some(1.0)
    );
}

#[test]
fn a_slow_head_is_dropped() {
    let service = with(|limits| limits.head = Duration::from_millis(100));
    let mut stream = service.connect();
    stream
        .write_all(b"POST /v1/complete HTTP/1.1\r\nhost: local")
        .unwrap();
    let mut answer = Vec::new();
    // The connection ends without an answer, or with a timeout.
    let _ = stream.read_to_end(&mut answer);
    assert!(
        answer.is_empty() || answer.starts_with(b"HTTP/1.1 408"),
        "{answer:?}"
    );
}

#[test]
fn a_slow_body_is_refused() {
    let service = with(|limits| limits.pace = Duration::from_millis(100));
    let (kind, body) = form(&[text("points", POINTS)]);
    let length = body.len().to_string();
    let headers = [
        ("content-type", kind.as_str()),
        ("content-length", length.as_str()),
    ];
    let bytes = request(
        service.address,
        "POST",
        "/v1/complete",
        &headers,
        &body[..20],
    );
    let reply = service.send(&bytes).unwrap();
    refused(&service, &reply, 408, "too slowly");
}

#[test]
fn idle_connections_make_room() {
    let service = with(|limits| limits.connections = 4);
    let mut idle = Vec::new();
    for number in 0..20 {
        let mut stream = service.connect();
        if number % 2 == 0 {
            // An unfinished head; the connection may be closed already.
            let _ = stream.write_all(b"GET /healthz HTTP/1.1\r\nhost: ");
        }
        idle.push(stream);
    }
    // A client that keeps its connection open between requests.
    let ask = request(service.address, "GET", "/healthz", &[], &[]);
    let mut kept = service.connect();
    let text = String::from_utf8(ask.clone()).unwrap();
    let keeps = text.replace("connection: close", "connection: keep-alive");
    kept.write_all(keeps.as_bytes()).unwrap();
    let mut first = [0; 15];
    kept.read_exact(&mut first).unwrap();
    assert_eq!(&first, b"HTTP/1.1 200 OK");
    for _ in 0..4 {
        assert_eq!(service.send(&ask).unwrap().status, 200);
    }
    let closed = service.metric("lsdc_closed_idle_total").unwrap();
    assert!((17.0..=26.0).contains(&closed), "{closed}");
    drop((idle, kept));
}
