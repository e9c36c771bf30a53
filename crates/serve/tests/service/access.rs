//! Access tokens, requests from other machines, and HTTPS.

use crate::client::{Reply, Running, completer, request};
use lsdc_serve::{Access, Config, Error, Server, Tls};
use std::io::Write as _;
use std::net::TcpStream;
use std::sync::Arc;
use tokio_rustls::rustls;

const TOKEN: &str = "0123456789abcdef0123";

#[test]
fn a_token_opens_all_but_the_probes() {
    let service = Running::new(Config {
        access: Access {
            token: Some(TOKEN.to_owned()),
            open: false,
        },
        ..Config::default()
    });
    for path in ["/healthz", "/readyz", "/openapi.json"] {
        assert_eq!(service.get(path).status, 200, "{path}");
    }
    for path in ["/metrics", "/v1/scenes/x", "/nowhere", "/"] {
        let reply = service.get(path);
        assert_eq!(reply.status, 401, "{path}");
        assert_eq!(reply.header("www-authenticate"), Some("Bearer"));
        assert!(!String::from_utf8_lossy(&reply.body).contains(TOKEN));
    }
    let shown = format!("Bearer {TOKEN}");
    let with = |value: &str| {
        let headers = [("authorization", value)];
        service.ask("GET", "/metrics", &headers, &[]).status
    };
    assert_eq!(with(&shown), 200);
    assert_eq!(with(&shown[..shown.len() - 1]), 401);
    assert_eq!(with("Bearer"), 401);
}

#[test]
fn other_machines_are_let_in_by_a_token_or_a_word_only() {
    let bind = |access: Access| {
        let config = Config {
            access,
            ..Config::default()
        };
        Server::bind(completer(), ([0, 0, 0, 0], 0).into(), config).map(|_| ())
    };
    let refused = bind(Access::default()).unwrap_err();
    assert!(matches!(refused, Error::Open(_)), "{refused}");
    assert!(refused.hint().unwrap().contains("--without-token"));
    let token = Some(TOKEN.to_owned());
    bind(Access { token, open: false }).unwrap();
    bind(Access {
        token: None,
        open: true,
    })
    .unwrap();
}

#[test]
fn pages_of_other_sites_are_refused() {
    let service = Running::new(Config::default());
    let ask = |headers: &[(&str, &str)]| service.ask("GET", "/metrics", headers, &[]).status;
    assert_eq!(ask(&[]), 200);
    assert_eq!(ask(&[("host", "evil.example")]), 403);
    assert_eq!(ask(&[("origin", "https://evil.example")]), 403);
    let own = format!("http://{}", service.address);
    assert_eq!(ask(&[("origin", &own)]), 200);
}

#[test]
fn a_request_has_one_host() {
    let service = Running::new(Config::default());
    let own = service.address.to_string();
    let status = |path: &str, hosts: &[&str]| {
        let hosts: Vec<_> = hosts.iter().map(|host| ("host", *host)).collect();
        service.ask("GET", path, &hosts, &[]).status
    };
    assert_eq!(status("/metrics", &[&own]), 200);
    assert_eq!(status(&format!("http://{own}/metrics"), &[&own]), 200);
    assert_eq!(status("/metrics", &[&own, "evil.example"]), 400);
    assert_eq!(status("/healthz", &[&own, &own]), 400);
    assert_eq!(status("http://evil.example/metrics", &[&own]), 400);
    let without = service.send(b"GET /healthz HTTP/1.1\r\nconnection: close\r\n\r\n");
    assert_eq!(without.unwrap().status, 400);
}

#[test]
fn https_answers_and_nothing_else_does() {
    let folder = tempfile::tempdir().unwrap();
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let (certificate, key) = (
        folder.path().join("cert.pem"),
        folder.path().join("key.pem"),
    );
    std::fs::write(&certificate, made.cert.pem()).unwrap();
    std::fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let tls = |certificate, key| Config {
        tls: Some(Tls { certificate, key }),
        ..Config::default()
    };
    let service = Running::new(tls(certificate.clone(), key.clone()));

    let mut roots = rustls::RootCertStore::empty();
    roots.add(made.cert.der().clone()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let client = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let name = "localhost".try_into().unwrap();
    let mut session = rustls::ClientConnection::new(Arc::new(client), name).unwrap();
    let mut stream = TcpStream::connect(service.address).unwrap();
    let mut secure = rustls::Stream::new(&mut session, &mut stream);
    let headers = [("host", "localhost")];
    let ask = request(service.address, "GET", "/healthz", &headers, &[]);
    secure.write_all(&ask).unwrap();
    assert_eq!(Reply::read(&mut secure).unwrap().status, 200);

    // Plain HTTP is not a TLS handshake.
    assert!(service.send(&ask).is_none());

    for config in [
        tls(key.clone(), key.clone()),
        tls(certificate.clone(), certificate),
        tls(folder.path().join("none.pem"), key),
    ] {
        let address = ([127, 0, 0, 1], 0).into();
        let error = Server::bind(completer(), address, config)
            .map(|_| ())
            .unwrap_err();
        assert!(matches!(error, Error::Certificate { .. }), "{error}");
    }
}
