//! Requests that wait, panic or are abandoned, and the end of a service.

use crate::client::{Reply, Running, asset, file, form, request, text};
use lsdc_serve::{Config, Limits};
use std::io::Write as _;
use std::net::Shutdown;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

/// A service whose computations report that they have reached a part, and wait there to be released.
struct Held {
    service: Running,
    arrived: Receiver<String>,
    on: Sender<()>,
    entries: Arc<Mutex<Vec<Logged>>>,
}

/// The status of a request, and its fault.
type Logged = (u16, Option<&'static str>);

impl Held {
    /// Starts the service with one computing thread.
    fn before(part: &'static str, queue: usize) -> Self {
        let limits = Limits {
            workers: 1,
            queue,
            ..Limits::default()
        };
        Self::with(part, limits)
    }

    fn with(part: &'static str, limits: Limits) -> Self {
        let (say, arrived) = channel();
        let (on, wait) = channel();
        let (say, wait) = (Mutex::new(say), Mutex::new(wait));
        let trace = move |found: &str| {
            if found == part {
                say.lock().unwrap().send(found.to_owned()).unwrap();
                let _ = wait.lock().unwrap().recv();
            }
        };
        let entries = Arc::new(Mutex::new(Vec::new()));
        let log = entries.clone();
        let service = Running::new(Config {
            limits,
            trace: Some(Arc::new(trace)),
            log: Some(Arc::new(move |entry| {
                log.lock().unwrap().push((entry.status, entry.fault));
            })),
            ..Config::default()
        });
        Self {
            service,
            arrived,
            on,
            entries,
        }
    }
}

fn question(service: &Running) -> Vec<u8> {
    let rgb = asset("rgb.png");
    let parts = [
        file("image", "rgb.png", &rgb),
        text("points", "[[10, 20, 2]]"),
    ];
    let (kind, body) = form(&parts);
    let headers = [("content-type", kind.as_str())];
    request(service.address, "POST", "/v1/complete", &headers, &body)
}

/// Polls until a metric has the value. Other threads update the metrics, after the event.
fn until(service: &Running, metric: &str, value: f64) {
    while service.metric(metric) != Some(value) {
        std::thread::yield_now();
    }
}

#[test]
fn a_full_queue_refuses_and_says_when_to_come_again() {
    let held = Held::before("read", 1);
    let service = &held.service;
    let question = question(service);
    let mut first = service.connect();
    first.write_all(&question).unwrap();
    held.arrived.recv().unwrap();
    let mut second = service.connect();
    second.write_all(&question).unwrap();
    until(service, "lsdc_queue", 1.0);
    let third = service.send(&question).unwrap();
    assert_eq!(third.status, 429);
    let after: u64 = third.header("retry-after").unwrap().parse().unwrap();
    assert!((1..=60).contains(&after));
    assert_eq!(
        service.metric("lsdc_rejected_total{reason=\"full\"}"),
        Some(1.0)
    );
    for stream in [&mut first, &mut second] {
        held.on.send(()).unwrap();
        assert_eq!(Reply::read(stream).unwrap().status, 200);
    }
    until(service, "lsdc_queue", 0.0);
    held.on.send(()).unwrap();
    assert_eq!(service.send(&question).unwrap().status, 200);
}

#[test]
fn a_client_that_goes_frees_its_place() {
    let held = Held::before("network", 1);
    let service = &held.service;
    let question = question(service);
    let mut working = service.connect();
    working.write_all(&question).unwrap();
    held.arrived.recv().unwrap();
    let mut waiting = service.connect();
    waiting.write_all(&question).unwrap();
    until(service, "lsdc_queue", 1.0);
    // The waiting request leaves the queue.
    waiting.shutdown(Shutdown::Both).unwrap();
    until(service, "lsdc_queue", 0.0);
    // The running request stops before its next part.
    working.shutdown(Shutdown::Both).unwrap();
    until(service, "lsdc_rejected_total{reason=\"gone\"}", 2.0);
    held.on.send(()).unwrap();
    until(service, "lsdc_working", 0.0);
    assert_eq!(
        service.metric("lsdc_part_seconds_count{part=\"fit\"}"),
        None
    );
    assert_eq!(
        service.metric("lsdc_part_seconds_count{part=\"network\"}"),
        None
    );
    let logged = held.entries.lock().unwrap().clone();
    let gone = logged.iter().filter(|entry| **entry == (499, Some("gone")));
    assert_eq!(gone.count(), 2);
}

#[test]
fn a_place_is_taken_before_the_body_is_read() {
    let service = Running::new(Config {
        limits: Limits {
            workers: 1,
            queue: 1,
            ..Limits::default()
        },
        ..Config::default()
    });
    let question = question(&service);
    let (most, rest) = question.split_at(question.len() - 10);
    let mut reading = [(); 2].map(|()| service.connect());
    for stream in &mut reading {
        stream.write_all(most).unwrap();
    }
    until(&service, "lsdc_places", 2.0);
    let reply = service.send(&question).unwrap();
    assert_eq!(reply.status, 429);
    assert!(reply.header("retry-after").is_some());
    assert_eq!(service.get("/healthz").status, 200);
    for mut stream in reading {
        stream.write_all(rest).unwrap();
        assert_eq!(Reply::read(&mut stream).unwrap().status, 200);
    }
    until(&service, "lsdc_places", 0.0);
    // A refused request frees its place before the rest of its body arrives.
    let (kind, body) = form(&[text("colour", "red"), text("points", "[[1, 1, 1]]")]);
    let headers = [("content-type", kind.as_str())];
    let wrong = request(service.address, "POST", "/v1/complete", &headers, &body);
    let mut stream = service.connect();
    stream.write_all(&wrong[..wrong.len() - 10]).unwrap();
    until(&service, "lsdc_places", 0.0);
    stream.write_all(&wrong[wrong.len() - 10..]).unwrap();
    assert_eq!(Reply::read(&mut stream).unwrap().status, 400);
}

/// Holds as many requests before parsing as there are computing threads; other requests are still answered.
#[test]
fn points_are_parsed_by_the_threads_that_compute() {
    let workers = 4;
    let limits = Limits {
        workers,
        ..Limits::default()
    };
    let held = Held::with("read", limits);
    let service = &held.service;
    let (kind, body) = form(&[file("image", "rgb.png", &asset("rgb.png"))]);
    let headers = [("content-type", kind.as_str())];
    let post = request(service.address, "POST", "/v1/scenes", &headers, &body);
    let mut stream = service.connect();
    stream.write_all(&post).unwrap();
    held.arrived.recv().unwrap();
    held.on.send(()).unwrap();
    let posted = Reply::read(&mut stream).unwrap();
    let path = posted.header("location").unwrap().to_owned() + "/complete";
    let headers = [("content-type", "application/json")];
    let ask = request(service.address, "POST", &path, &headers, b"no JSON");
    let mut waiting: Vec<_> = (0..workers).map(|_| service.connect()).collect();
    for stream in &mut waiting {
        stream.write_all(&ask).unwrap();
    }
    for _ in 0..workers {
        held.arrived.recv().unwrap();
    }
    assert_eq!(service.get("/healthz").status, 200);
    for _ in 0..workers {
        held.on.send(()).unwrap();
    }
    for mut stream in waiting {
        assert_eq!(Reply::read(&mut stream).unwrap().status, 400);
    }
}

#[test]
fn a_connection_with_a_request_does_not_make_room() {
    let limits = Limits {
        workers: 1,
        connections: 1,
        ..Limits::default()
    };
    let held = Held::with("read", limits);
    let service = &held.service;
    let mut working = service.connect();
    working.write_all(&question(service)).unwrap();
    held.arrived.recv().unwrap();
    let mut next = service.connect();
    let ask = request(service.address, "GET", "/healthz", &[], &[]);
    next.write_all(&ask).unwrap();
    held.on.send(()).unwrap();
    let reply = Reply::read(&mut working).unwrap();
    assert_eq!(reply.status, 200);
    assert!(reply.json()["depth"]["lowest"].as_f64().unwrap() > 0.0);
    assert_eq!(Reply::read(&mut next).unwrap().status, 200);
}

/// Variable that makes the test below a process to be killed.
#[cfg(unix)]
const HOLDS: &str = "LSDC_TEST_HOLDS_AN_UPLOAD";

#[cfg(unix)]
#[test]
#[ignore = "a process of the next test"]
#[allow(clippy::print_stdout)]
fn holds_an_upload() {
    if std::env::var_os(HOLDS).is_none() {
        return;
    }
    let held = Held::before("read", 1);
    let mut client = held.service.connect();
    client.write_all(&question(&held.service)).unwrap();
    held.arrived.recv().unwrap();
    println!("upload held");
    let _ = std::io::stdin().read_line(&mut String::new());
}

#[cfg(unix)]
#[test]
fn the_next_service_removes_the_uploads_of_a_killed_one_and_of_no_other() {
    use std::collections::BTreeSet;
    use std::io::BufRead as _;
    use std::process::{Command, Stdio};
    let temporary = tempfile::tempdir().unwrap();
    let start = || {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([
                "life::holds_an_upload",
                "--exact",
                "--ignored",
                "--nocapture",
            ])
            .env("TMPDIR", temporary.path())
            .env(HOLDS, "1")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let said = std::io::BufReader::new(child.stdout.take().unwrap());
        let mut lines = said.lines().map_while(Result::ok);
        assert!(lines.any(|line| line.contains("upload held")));
        child
    };
    let uploads = || -> BTreeSet<_> {
        let found = std::fs::read_dir(temporary.path()).unwrap().flatten();
        let found = found.filter(|entry| entry.path().join("image/rgb.png").exists());
        found.map(|entry| entry.file_name()).collect()
    };
    let mut killed = start();
    let left = uploads();
    let mut alive = start();
    let both = uploads();
    assert_eq!((left.len(), both.len()), (1, 2));
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert_eq!(uploads(), both);
    let mut next = start();
    let now = uploads();
    assert!(now.is_disjoint(&left));
    assert!(now.is_superset(&(&both - &left)));
    assert_eq!(now.len(), 2);
    for child in [&mut alive, &mut next] {
        child.kill().unwrap();
        child.wait().unwrap();
    }
}

#[test]
fn a_panic_is_one_answer_and_the_service_lives() {
    let panics = |part: &str| assert_ne!(part, "fit", "a panic of the test, to be caught");
    let service = Running::new(Config {
        trace: Some(Arc::new(panics)),
        ..Config::default()
    });
    let question = question(&service);
    for count in 1..=3 {
        let reply = service.send(&question).unwrap();
        assert_eq!(reply.status, 500);
        assert!(!reply.message().contains("panic"), "{}", reply.message());
        assert_eq!(service.metric("lsdc_panics_total"), Some(f64::from(count)));
    }
    assert_eq!(service.get("/readyz").status, 200);
}

#[test]
fn the_end_finishes_what_has_begun() {
    let mut held = Held::before("fit", 4);
    let question = question(&held.service);
    let mut working = held.service.connect();
    working.write_all(&question).unwrap();
    held.arrived.recv().unwrap();
    let mut waiting = held.service.connect();
    waiting.write_all(&question).unwrap();
    until(&held.service, "lsdc_queue", 1.0);
    held.service.handle.end();
    for stream in [&mut working, &mut waiting] {
        held.on.send(()).unwrap();
        let reply = Reply::read(stream).unwrap();
        assert_eq!(reply.status, 200);
        assert!(reply.json()["depth"]["lowest"].as_f64().unwrap() > 0.0);
    }
    held.service.end();
    assert!(std::net::TcpStream::connect(held.service.address).is_err());
}

#[test]
fn the_end_does_not_wait_for_ever() {
    let mut service = Running::new(Config {
        limits: Limits {
            drain: std::time::Duration::ZERO,
            ..Limits::default()
        },
        ..Config::default()
    });
    let mut stream = service.connect();
    stream.write_all(b"POST /v1/complete HTTP/1.1\r\n").unwrap();
    service.end();
    assert!(Reply::read(&mut stream).is_none());
}

#[test]
fn requests_keep_their_names_and_logs_say_nothing_of_contents() {
    let lines = Arc::new(Mutex::new(Vec::new()));
    let log = lines.clone();
    let service = Running::new(Config {
        log: Some(Arc::new(move |entry| {
            log.lock()
                .unwrap()
                .push(serde_json::to_string(entry).unwrap());
        })),
        ..Config::default()
    });
    let named = |name: &str| {
        let headers = [("x-request-id", name)];
        let reply = service.ask("GET", "/v1/scenes/secretname", &headers, &[]);
        assert_eq!(reply.status, 404);
        reply.header("x-request-id").unwrap().to_owned()
    };
    assert_eq!(named("robot-7.frame_12"), "robot-7.frame_12");
    for other in ["", "a b", &"x".repeat(65)] {
        let name = named(other);
        assert!(name != other && !name.is_empty(), "{name}");
    }
    drop(service);
    let lines = lines.lock().unwrap();
    assert_eq!(lines.len(), 4);
    for line in lines.iter() {
        assert!(
            line.contains("\"route\":\"/v1/scenes/{id}\"") && !line.contains("secret"),
            "{line}"
        );
        assert!(line.contains("\"fault\":\"not-found\""), "{line}");
    }
}
