use super::*;
use crate::tests::{PYTORCH, TINY, TRANSFORMERS};
use loopback::{Answer, Server, answer, length};
use std::io::Write as _;
use std::path::PathBuf;

#[path = "../../../../tests/loopback/mod.rs"]
mod loopback;

const FILE: &[u8] = TRANSFORMERS;
/// Where connections are interrupted.
const HALF: usize = 20_000;

fn tag(version: &str) -> String {
    format!("ETag: \"{version}\"")
}

fn all() -> Answer {
    answer("200 OK", &[length(FILE.len()), tag("a")], FILE)
}

/// The first bytes of the file, with these headers.
fn first(bytes: usize, headers: &[String]) -> Answer {
    let headers = [headers, &[length(FILE.len())]].concat();
    answer("200 OK", &headers, &FILE[..bytes])
}

/// Some of the following bytes, with these headers.
fn more(from: usize, bytes: usize, headers: &[String]) -> Answer {
    let all = FILE.len();
    let range = format!("Content-Range: bytes {from}-{}/{all}", all - 1);
    let headers = [headers, &[length(all - from), range]].concat();
    answer("206 Partial Content", &headers, &FILE[from..from + bytes])
}

/// All following bytes.
fn rest(from: usize, headers: &[String]) -> Answer {
    more(from, FILE.len() - from, headers)
}

struct Run {
    result: Result<Installation>,
    /// One word per event; progress is listed once.
    events: Vec<String>,
}

fn run(store: &Store, urls: &[&str], limits: &DownloadLimits) -> Run {
    let mut events: Vec<String> = Vec::new();
    let mut on_event = |event: DownloadEvent<'_>| {
        let word = match event {
            DownloadEvent::Started {
                resumed_bytes,
                total_bytes,
                ..
            } => format!("begun {resumed_bytes} {total_bytes:?}"),
            DownloadEvent::Progress(_) => "reached".to_owned(),
            DownloadEvent::Interrupted(_) => "broken".to_owned(),
            DownloadEvent::NextUrl(_) => "elsewhere".to_owned(),
        };
        if events.last() != Some(&word) {
            events.push(word);
        }
    };
    let result = get(store, &TINY, urls, false, limits, &mut on_event);
    Run { result, events }
}

fn scratch() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::at(folder.path().join("weights"));
    (folder, store)
}

fn files(store: &Store) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(store.folder()).into_iter().flatten();
    entries.map(|entry| entry.unwrap().path()).collect()
}

/// Checks that the encoder is installed, and that no other files are left.
fn check_installed(store: &Store, run: &Run) {
    assert_eq!(*run.result.as_ref().unwrap(), Installation::New);
    assert_eq!(files(store), [store.path(&TINY)]);
    assert_eq!(store.load(&TINY).unwrap().len(), 48);
}

/// Checks that the responses of the server lead to the encoder.
fn installs(answers: Vec<Answer>) -> (Server, Vec<String>) {
    let (_folder, store) = scratch();
    let server = Server::start(answers);
    let run = run(&store, &[&server.url()], &DownloadLimits::default());
    check_installed(&store, &run);
    (server, run.events)
}

/// Checks that the responses of the server lead to an error with these words; returns the size of the partial download.
fn fails(answers: Vec<Answer>, limits: &DownloadLimits, words: &[&str]) -> u64 {
    let (_folder, store) = scratch();
    let server = Server::start(answers);
    let run = run(&store, &[&server.url()], limits);
    let error = run.result.unwrap_err();
    let text = format!("{} {:?}", error.with_causes(), error.advice());
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
    assert!(!store.path(&TINY).exists());
    let parts = files(&store).into_iter();
    let parts = parts.filter(|path| path.extension().is_some_and(|e| e == "part"));
    parts.map(|path| path.metadata().unwrap().len()).sum()
}

#[test]
fn a_file_is_downloaded_checked_and_converted_once() {
    let (_folder, store) = scratch();
    let server = Server::start(vec![all()]);
    let first = run(&store, &[&server.url()], &DownloadLimits::default());
    check_installed(&store, &first);
    let begun = format!("begun 0 Some({})", FILE.len());
    assert_eq!(first.events, [begun.as_str(), "reached"]);
    let requests = server.requests();
    assert!(requests[0].contains("user-agent: lsdc/"), "{requests:?}");
    assert!(!requests[0].contains("range:"), "{requests:?}");

    // The server would reject another connection.
    let again = run(&store, &[&server.url()], &DownloadLimits::default());
    assert_eq!(again.result.unwrap(), Installation::Unchanged);
    assert!(again.events.is_empty());

    // The other container, without a length.
    let (_, events) = installs(vec![answer("200 OK", &[], PYTORCH)]);
    assert_eq!(events, ["begun 0 None", "reached"]);
}

#[test]
fn a_broken_connection_is_followed_by_another() {
    let (server, events) = installs(vec![
        first(HALF, &[tag("a")]),
        more(HALF, 5000, &[tag("a")]),
        rest(HALF + 5000, &[tag("a")]),
    ]);
    let requests = server.requests();
    assert_eq!(requests.len(), 3);
    for (request, from) in [(&requests[1], HALF), (&requests[2], HALF + 5000)] {
        let range = format!("\r\nrange: bytes={from}-\r\n");
        assert!(request.contains(&range), "{request}");
        assert!(request.contains("\r\nif-range: \"a\"\r\n"), "{request}");
    }
    assert_eq!(events.iter().filter(|word| *word == "broken").count(), 2);
    // A date is also sufficient (RFC 9110, 13.1.5).
    let date = "Last-Modified: Wed, 26 Jun 2024 10:15:00 GMT".to_owned();
    let (server, _) = installs(vec![first(HALF, &[date]), rest(HALF, &[])]);
    let request = &server.requests()[1];
    assert!(request.contains("if-range: wed, 26 jun 2024"), "{request}");
}

#[test]
fn the_next_run_goes_on_where_the_last_one_ended() {
    let (_folder, store) = scratch();
    // The partial download of another address is removed, too.
    let mut other = PartialDownload::open(store.folder(), &TINY, "http://127.0.0.1:9/a").unwrap();
    other.append(b"abc").unwrap();
    drop(other);
    let busy = answer("503 Service Unavailable", &[length(0)], b"");
    let server = Server::start(vec![
        first(HALF, &[tag("a")]),
        busy,
        rest(HALF, &[tag("a")]),
    ]);
    let url = server.url();
    let error = run(&store, &[&url], &DownloadLimits::default())
        .result
        .unwrap_err();
    assert!(
        error.to_string().contains("503 Service Unavailable"),
        "{error}"
    );
    assert_eq!(error.cause(), Cause::Network);
    let next = run(&store, &[&url], &DownloadLimits::default());
    check_installed(&store, &next);
    let begun = format!("begun {HALF} Some({})", FILE.len());
    assert_eq!(next.events, [begun.as_str(), "reached"]);
}

/// The folder was full, or the program was killed, between the last byte and the installation.
#[test]
fn a_whole_file_is_not_downloaded_again() {
    let (_folder, store) = scratch();
    let url = "http://127.0.0.1:9/model.safetensors";
    let mut part = PartialDownload::open(store.folder(), &TINY, url).unwrap();
    let origin = Origin {
        url: url.to_owned(),
        version: None,
        total: Some(FILE.len() as u64),
    };
    part.begin(origin).unwrap();
    part.append(FILE).unwrap();
    drop(part);
    check_installed(&store, &run(&store, &[url], &DownloadLimits::default()));
}

#[test]
fn servers_that_do_not_continue_begin_anew() {
    // No validator, so no range is requested.
    for headers in [vec![], vec!["ETag: W/\"a\"".to_owned()]] {
        let (server, _) = installs(vec![first(HALF, &headers), all()]);
        assert!(!server.requests()[1].contains("range:"));
    }
    // A range is requested, and the full file is sent.
    let (server, events) = installs(vec![first(HALF, &[tag("a")]), all()]);
    assert!(server.requests()[1].contains("range: bytes="));
    assert_eq!(
        events
            .iter()
            .filter(|word| word.contains("begun 0"))
            .count(),
        2
    );
}

#[test]
fn another_file_at_the_place_is_no_continuation() {
    let gone = answer("416 Range Not Satisfiable", &[length(0)], b"");
    for changed in [rest(HALF, &[tag("b")]), rest(HALF + 1, &[tag("a")]), gone] {
        let (server, _) = installs(vec![first(HALF, &[tag("a")]), changed, all()]);
        assert!(!server.requests()[2].contains("range:"));
    }
}

#[test]
fn something_else_is_refused_and_not_kept() {
    let limits = DownloadLimits::default();
    let page = answer("200 OK", &[], b"<html>Please log in</html>");
    let words = [
        "what `http://127.0.0.1",
        "is not a tiny encoder",
        "neither a PyTorch",
    ];
    assert_eq!(fails(vec![page], &limits, &words), 0);
    let mut damaged = FILE.to_vec();
    damaged[FILE.len() - 9] ^= 1;
    let damaged = answer("200 OK", &[], &damaged);
    assert_eq!(fails(vec![damaged], &limits, &["other values"]), 0);
    // Truncated, without a declared length.
    let short = answer("200 OK", &[], &FILE[..HALF]);
    assert_eq!(fails(vec![short], &limits, &["is not a tiny encoder"]), 0);
}

#[test]
fn short_files_are_asked_for_again_while_that_helps() {
    let limits = DownloadLimits::default();
    let half = || first(HALF, &[]);
    let words = ["the connection broke", "begins anew"];
    assert_eq!(fails(vec![half(), half()], &limits, &words), 0);
    let nothing = more(HALF, 0, &[tag("a")]);
    let answers = vec![first(HALF, &[tag("a")]), nothing];
    let words = ["the connection broke", "0.0 MB are kept"];
    assert_eq!(fails(answers, &limits, &words), HALF as u64);
    // One byte per connection.
    let drops = (0..3).map(|i| match i {
        0 => first(1, &[tag("a")]),
        _ => more(i, 1, &[tag("a")]),
    });
    let limits = DownloadLimits {
        connections: 3,
        ..limits
    };
    assert_eq!(
        fails(drops.collect(), &limits, &["3 connections", "broke"]),
        3
    );
}

#[test]
fn answers_other_than_a_file_are_errors() {
    let limits = DownloadLimits::default();
    let none = || answer("404 Not Found", &[length(4)], b"none");
    assert_eq!(fails(vec![none()], &limits, &["404 Not Found"]), 0);
    let odd = answer("206 Partial Content", &[length(0)], b"");
    assert_eq!(fails(vec![odd], &limits, &["206"]), 0);
    assert_eq!(fails(vec![], &limits, &["cannot reach `http://127"]), 0);
    let noise: Answer = Box::new(|stream| drop(stream.write_all(b"SSH-2.0-x\r\n\r\n")));
    assert_eq!(fails(vec![noise], &limits, &["cannot reach"]), 0);
    let (_folder, store) = scratch();
    for url in [
        "nowhere",
        "ftp://127.0.0.1/a",
        "http://",
        "https://127.0.0.1:9/a",
    ] {
        let error = run(&store, &[url], &limits).result.unwrap_err();
        assert_eq!(error.cause(), Cause::Network, "{url}");
        assert_eq!(files(&store).len(), 0, "{url}");
    }

    // The next address has the file.
    let (broken, whole) = (Server::start(vec![none()]), Server::start(vec![all()]));
    let urls = [&broken.url()[..], &whole.url()];
    let run = run(&store, &urls, &limits);
    check_installed(&store, &run);
    assert_eq!(run.events[0], "elsewhere");
}

#[test]
fn redirects_are_followed_but_not_for_ever() {
    let moved = |to: &str| answer("302 Found", &[length(0), format!("Location: {to}")], b"");
    let (server, _) = installs(vec![
        moved("/there"),
        first(HALF, &[tag("a")]),
        moved("/there"),
        rest(HALF, &[tag("a")]),
    ]);
    let requests = server.requests();
    assert!(requests[1].starts_with("get /there "), "{requests:?}");
    assert!(requests[3].contains("range: bytes="), "{requests:?}");
    let circle = (0..20).map(|_| moved("/again")).collect();
    assert_eq!(
        fails(circle, &DownloadLimits::default(), &["too many redirects"]),
        0
    );
}

#[test]
fn endless_files_end() {
    let limits = DownloadLimits {
        bytes: 1 << 20,
        ..DownloadLimits::default()
    };
    let endless: Answer = Box::new(|stream| {
        let sent = stream.write_all(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n");
        let mut open = sent.is_ok();
        while open {
            open = stream.write_all(&[7; 4096]).is_ok();
        }
    });
    assert_eq!(fails(vec![endless], &limits, &["more than 1 MiB"]), 0);
    let huge = answer("200 OK", &[length(1 << 40)], b"");
    assert_eq!(fails(vec![huge], &limits, &["more than 1 MiB"]), 0);
}

#[test]
fn silent_servers_are_left() {
    let limits = DownloadLimits {
        timeout: Duration::from_millis(10),
        ..DownloadLimits::default()
    };
    // Until the client disconnects.
    let wait: fn(&mut std::net::TcpStream) = |stream| drop(stream.read(&mut [0]));
    let silent: Answer = Box::new(wait);
    assert_eq!(fails(vec![silent], &limits, &["timeout"]), 0);
    let stops: Answer = Box::new(move |stream| {
        first(HALF, &[tag("a")])(stream);
        wait(stream);
    });
    let left = fails(vec![stops], &limits, &["cannot reach", "are kept"]);
    assert_eq!(left, HALF as u64);
}

#[test]
fn two_programs_do_not_write_one_file() {
    let (_folder, store) = scratch();
    let url = "http://127.0.0.1:9/a";
    let _part = PartialDownload::open(store.folder(), &TINY, url).unwrap();
    let error = run(&store, &[url], &DownloadLimits::default())
        .result
        .unwrap_err();
    assert!(error.to_string().contains("another program"), "{error}");
}

#[test]
fn parts_of_unknown_origin_are_not_used() {
    let (_folder, store) = scratch();
    let url = "http://127.0.0.1:9/a";
    let origin = |version: Option<&str>, total: u64| Origin {
        url: url.to_owned(),
        version: version.map(str::to_owned),
        total: Some(total),
    };
    let kept = |origin: Origin, damage: &dyn Fn(&std::path::Path)| {
        let mut part = PartialDownload::open(store.folder(), &TINY, url).unwrap();
        part.begin(origin).unwrap();
        part.append(b"abc").unwrap();
        let path = part.close();
        damage(&path);
        PartialDownload::open(store.folder(), &TINY, url)
            .unwrap()
            .length()
    };
    assert_eq!(kept(origin(Some("\"a\""), 9), &|_| {}), 3);
    assert_eq!(kept(origin(None, 9), &|_| {}), 0);
    // Longer than the full file.
    assert_eq!(kept(origin(Some("\"a\""), 2), &|_| {}), 0);
    for record in [
        "",
        "{",
        "[]",
        r#"{"place":"http://elsewhere","version":"1","total":9}"#,
    ] {
        let damage = |path: &std::path::Path| {
            std::fs::write(path.with_extension("part.json"), record).unwrap();
        };
        assert_eq!(kept(origin(Some("\"a\""), 9), &damage), 0, "{record}");
    }
}
