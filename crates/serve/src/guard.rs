//! Access control: a token, and no requests from pages of other web sites.

use crate::config::Config;
use crate::fault::{Fault, FaultKind};
use crate::header_text;
use axum::http::{HeaderMap, Method, Uri, Version, header};
use std::net::SocketAddr;
use subtle::ConstantTimeEq as _;

/// Paths open without a token, because probes have none; they reveal nothing about images.
const OPEN: [&str; 3] = ["/healthz", "/readyz", "/openapi.json"];

/// Decides about requests by their heads.
pub(crate) struct Guard {
    token: Option<String>,
    /// The cookie in which a browser keeps the token, if there is a page.
    cookie: Option<String>,
    /// Whether only this machine can reach the service; then a name that leads here is not taken for granted, as
    /// a web site can point a name of its own at this machine (DNS rebinding).
    local: bool,
}

/// Decision about a request.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It is answered.
    Pass,
    /// The page is opened by its link: the token becomes this cookie.
    Enter(String),
}

impl Guard {
    pub(crate) fn new(config: &Config, address: SocketAddr) -> Self {
        // Cookies do not tell ports apart.
        let cookie = format!("lsdc-{}", address.port());
        Self {
            token: config.access.token.clone(),
            cookie: config.page.is_some().then_some(cookie),
            local: address.ip().is_loopback(),
        }
    }

    /// Decides about a request.
    ///
    /// # Errors
    /// It is not clear which host it is for; a page of another site asks, or the token is missing or wrong.
    pub(crate) fn check(
        &self,
        (method, uri, version): (&Method, &Uri, Version),
        headers: &HeaderMap,
    ) -> Result<Verdict, Fault> {
        check_host(uri, version, headers)?;
        if OPEN.contains(&uri.path()) {
            return Ok(Verdict::Pass);
        }
        // A token that only its owner sends needs no such care; a browser sends cookies for everybody.
        if self.token.is_none() || self.cookie.is_some() {
            self.check_site(headers)?;
        }
        let Some(token) = &self.token else {
            return Ok(Verdict::Pass);
        };
        let equal = |shown: &str| bool::from(shown.as_bytes().ct_eq(token.as_bytes()));
        if let Some(cookie) = &self.cookie {
            if method == Method::GET && uri.path() == "/" && in_link(uri).is_some_and(equal) {
                let kept = "Path=/; HttpOnly; SameSite=Strict";
                return Ok(Verdict::Enter(format!("{cookie}={token}; {kept}")));
            }
            if cookies(headers).any(|(name, value)| name == cookie && equal(value)) {
                return Ok(Verdict::Pass);
            }
        }
        if bearer(headers).is_some_and(equal) {
            return Ok(Verdict::Pass);
        }
        let hint = match self.cookie {
            Some(_) => "open the link that `lsdc view` has printed",
            None => "send `Authorization: Bearer TOKEN`",
        };
        Err(Fault::new(FaultKind::Unknown, "the token is missing or wrong").hint(hint))
    }

    fn check_site(&self, headers: &HeaderMap) -> Result<(), Fault> {
        let host = header_text(headers, header::HOST).unwrap_or_default();
        if self.local && !is_local(host) {
            let what = "the service is asked by a name that is none of this machine";
            return Err(Fault::new(FaultKind::Foreign, what).hint("ask 127.0.0.1 or localhost"));
        }
        let own = |origin: &str| {
            let authority = origin.split_once("://").map(|(_, authority)| authority);
            authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host))
        };
        let origin = header_text(headers, header::ORIGIN);
        if headers.contains_key(header::ORIGIN) && !origin.is_some_and(own) {
            let what = "a page of another web site may not ask";
            return Err(Fault::new(FaultKind::Foreign, what)
                .hint("give the service a token, and send it from there"));
        }
        Ok(())
    }
}

/// Refuses requests without a `Host`, with several, or with another one than their first line has (RFC 9112, section
/// 3.2): whoever reads one of them and whoever reads the other do not mean the same host.
fn check_host(uri: &Uri, version: Version, headers: &HeaderMap) -> Result<(), Fault> {
    let mut hosts = headers.get_all(header::HOST).iter();
    let (host, another) = (hosts.next(), hosts.next());
    if another.is_some() {
        return Err(Fault::malformed("the request has more than one `Host`"));
    }
    if host.is_none() && version == Version::HTTP_11 {
        return Err(Fault::malformed("the request has no `Host`"));
    }
    let Some(authority) = uri.authority() else {
        return Ok(());
    };
    let same = |host: &[u8]| host.eq_ignore_ascii_case(authority.as_str().as_bytes());
    match host {
        Some(host) if !same(host.as_bytes()) => Err(Fault::malformed(
            "the request has another host in its first line than in `Host`",
        )),
        _ => Ok(()),
    }
}

/// Whether a `Host` names this machine, with a port or without.
fn is_local(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|b| b.is_ascii_digit()) => name,
        _ => host,
    };
    let bare = name.trim_start_matches('[').trim_end_matches(']');
    let is_loopback = |ip: std::net::IpAddr| ip.is_loopback();
    name.eq_ignore_ascii_case("localhost") || bare.parse().is_ok_and(is_loopback)
}

/// The token in the link to the page.
fn in_link(uri: &Uri) -> Option<&str> {
    let mut pairs = uri.query()?.split('&');
    pairs.find_map(|pair| pair.strip_prefix("token="))
}

fn bearer(headers: &HeaderMap) -> Option<&str> {
    let value = header_text(headers, header::AUTHORIZATION)?;
    let (scheme, token) = value.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

fn cookies(headers: &HeaderMap) -> impl Iterator<Item = (&str, &str)> {
    let values = headers.get_all(header::COOKIE).iter();
    let texts = values.filter_map(|value| value.to_str().ok());
    let pairs = texts.flat_map(|text| text.split(';'));
    pairs.filter_map(|pair| pair.trim().split_once('='))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard(token: Option<&str>, page: bool, local: bool) -> Guard {
        Guard {
            token: token.map(str::to_owned),
            cookie: page.then(|| "lsdc-7000".to_owned()),
            local,
        }
    }

    fn check(guard: &Guard, uri: &str, headers: &[(&str, &str)]) -> Result<Verdict, FaultKind> {
        let headers = headers
            .iter()
            .map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap()));
        let head = (&Method::GET, &uri.parse().unwrap(), Version::HTTP_10);
        let verdict = guard.check(head, &headers.collect());
        verdict.map_err(|fault| fault.kind)
    }

    #[test]
    fn other_sites_and_their_names_are_refused() {
        let plain = guard(None, false, true);
        for host in [
            "127.0.0.1:7000",
            "localhost:7000",
            "LOCALHOST",
            "[::1]:7000",
            "127.0.0.1",
        ] {
            assert_eq!(
                check(&plain, "/v1/x", &[("host", host)]),
                Ok(Verdict::Pass),
                "{host}"
            );
        }
        for host in [
            "evil.example",
            "evil.example:7000",
            "localhost.evil.example",
            "",
            "10.0.0.7",
        ] {
            let found = check(&plain, "/v1/x", &[("host", host)]);
            assert_eq!(found, Err(FaultKind::Foreign), "{host}");
        }
        let from = |origin| [("host", "localhost:7000"), ("origin", origin)];
        assert_eq!(
            check(&plain, "/v1/x", &from("http://localhost:7000")),
            Ok(Verdict::Pass)
        );
        for origin in ["http://localhost:7001", "https://evil.example", "null", ""] {
            let found = check(&plain, "/v1/x", &from(origin));
            assert_eq!(found, Err(FaultKind::Foreign), "{origin}");
        }
        // With a token that the client itself sends, it does not matter where from.
        let token = guard(Some("secret"), false, true);
        let headers = [("host", "a.example"), ("authorization", "Bearer secret")];
        assert_eq!(check(&token, "/v1/x", &headers), Ok(Verdict::Pass));
    }

    #[test]
    fn a_token_is_shown_in_a_header_or_by_the_link() {
        let own = ("host", "127.0.0.1:7000");
        let page = guard(Some("secret"), true, true);
        for shown in [
            ("authorization", "bearer secret"),
            ("cookie", "a=b; lsdc-7000=secret"),
        ] {
            assert_eq!(check(&page, "/v1/x", &[own, shown]), Ok(Verdict::Pass));
        }
        for wrong in [
            ("authorization", "Bearer secre"),
            ("authorization", "Basic secret"),
            ("cookie", "lsdc-7001=secret"),
            ("cookie", "lsdc-7000=wrong!"),
        ] {
            assert_eq!(
                check(&page, "/v1/x", &[own, wrong]),
                Err(FaultKind::Unknown),
                "{wrong:?}"
            );
        }
        let entered = check(&page, "/?token=secret", &[own]).unwrap();
        let Verdict::Enter(cookie) = entered else {
            panic!("{entered:?}");
        };
        assert!(cookie.starts_with("lsdc-7000=secret; ") && cookie.contains("SameSite=Strict"));
        assert_eq!(
            check(&page, "/?token=wrong", &[own]),
            Err(FaultKind::Unknown)
        );
        assert_eq!(
            check(&page, "/app.js?token=secret", &[own]),
            Err(FaultKind::Unknown)
        );
        // Without a page there are no links.
        let token = guard(Some("secret"), false, true);
        assert_eq!(
            check(&token, "/?token=secret", &[own]),
            Err(FaultKind::Unknown)
        );
        assert_eq!(check(&token, "/healthz", &[]), Ok(Verdict::Pass));
    }
    #[test]
    fn a_request_is_for_one_host() {
        let token = guard(Some("secret"), false, false);
        let found = |uri: &str, hosts: &[&str], version| {
            let hosts = hosts
                .iter()
                .map(|host| (header::HOST, host.parse().unwrap()));
            let uri = uri.parse().unwrap();
            let verdict = token.check((&Method::GET, &uri, version), &hosts.collect());
            verdict.map_err(|fault| fault.kind)
        };
        let new = Version::HTTP_11;
        for (uri, hosts) in [
            ("/healthz", &["a.example"][..]),
            ("http://a.example/healthz", &["A.example"]),
            ("http://a.example:7000/healthz", &["a.example:7000"]),
        ] {
            assert_eq!(found(uri, hosts, new), Ok(Verdict::Pass), "{uri}");
        }
        for (uri, hosts) in [
            ("/healthz", &["a.example", "a.example"][..]),
            ("/healthz", &["a.example", "evil.example"]),
            ("/healthz", &[]),
            ("http://evil.example/healthz", &["a.example"]),
            ("http://a.example:7001/healthz", &["a.example:7000"]),
            ("http://me@a.example/healthz", &["a.example"]),
        ] {
            assert_eq!(
                found(uri, hosts, new),
                Err(FaultKind::Malformed),
                "{uri} {hosts:?}"
            );
        }
        assert_eq!(found("/healthz", &[], Version::HTTP_10), Ok(Verdict::Pass));
        // Without `Host`, the first line counts.
        let local = guard(None, false, true);
        let head = (
            &Method::GET,
            &"http://evil.example/metrics".parse().unwrap(),
            Version::HTTP_10,
        );
        assert_eq!(
            local.check(head, &HeaderMap::new()).unwrap_err().kind,
            FaultKind::Foreign
        );
    }
}
