//! The hostile requests.

use crate::client::{Part, asset, file, form, request, text};
use image::{ExtendedColorType, ImageEncoder as _};
use lsdc_files::DepthMap;
use std::net::SocketAddr;

/// A description, the bytes of a request, and the expected outcome.
pub(crate) struct Case {
    pub(crate) sent: &'static str,
    pub(crate) bytes: Vec<u8>,
    pub(crate) expected: Expected,
}

/// Expected outcome of a request.
pub(crate) enum Expected {
    Status(u16),
    /// The connection is closed.
    Dropped,
}

impl Expected {
    pub(crate) fn shown(&self) -> String {
        match self {
            Self::Status(status) => status.to_string(),
            Self::Dropped => "dropped".to_owned(),
        }
    }
}

const POINTS: &str = "[[10, 20, 2.0], [200, 100, 2.5]]";

/// Returns all hostile requests.
pub(crate) fn hostile(address: SocketAddr) -> Vec<Case> {
    let mut all = Vec::new();
    let mut add = |sent, bytes, status| {
        let expected = match status {
            0 => Expected::Dropped,
            status => Expected::Status(status),
        };
        all.push(Case {
            sent,
            bytes,
            expected,
        });
    };
    heads(address, &mut add);
    bodies(address, &mut add);
    images(address, &mut add);
    points(address, &mut add);
    others(address, &mut add);
    all
}

type Add<'a> = dyn FnMut(&'static str, Vec<u8>, u16) + 'a;

/// Heads that are malformed, too long, or refer to other hosts or paths.
fn heads(address: SocketAddr, add: &mut Add<'_>) {
    let get = |path: &str, headers: &[(&str, &str)]| request(address, "GET", path, headers, &[]);
    add(
        "a TLS handshake to a port that speaks plain HTTP",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\r\n\r\n".to_vec(),
        400,
    );
    add("`GET / HTTP/9.9`", b"GET / HTTP/9.9\r\n\r\n".to_vec(), 400);
    add(
        "a head of 100 KB",
        get("/healthz", &[("x", &"y".repeat(100_000))]),
        431,
    );
    let lines: Vec<String> = (0..200).map(|i| format!("x-{i}")).collect();
    let lines: Vec<(&str, &str)> = lines.iter().map(|name| (name.as_str(), "1")).collect();
    add("a head of 200 lines", get("/healthz", &lines), 431);
    add(
        "a head that never ends",
        b"GET /healthz HTTP/1.1\r\nhost: ".to_vec(),
        0,
    );
    add(
        "`DELETE /v1/complete`",
        request(address, "DELETE", "/v1/complete", &[], &[]),
        405,
    );
    add(
        "`GET /../../etc/passwd`",
        get("/../../etc/passwd", &[]),
        404,
    );
    add(
        "`GET /v1/scenes/..%2f..%2fetc%2fpasswd`",
        get("/v1/scenes/..%2f..%2fetc%2fpasswd", &[]),
        404,
    );
    add("`GET /v1/scenes/%00`", get("/v1/scenes/%00", &[]), 404);
    add(
        "`GET /v1/scenes/%ff` (no UTF-8)",
        get("/v1/scenes/%ff", &[]),
        400,
    );
    add(
        "the `Host` of another site (DNS rebinding)",
        get("/metrics", &[("host", "evil.example")]),
        403,
    );
    add(
        "the `Origin` of another site",
        get("/metrics", &[("origin", "https://evil.example")]),
        403,
    );
    add(
        "two `Host` headers",
        get(
            "/healthz",
            &[("host", "localhost"), ("host", "evil.example")],
        ),
        400,
    );
    add(
        "`GET http://evil.example/metrics` with a good `Host`",
        get("http://evil.example/metrics", &[]),
        400,
    );
    add(
        "no `Host`",
        b"GET /healthz HTTP/1.1\r\nconnection: close\r\n\r\n".to_vec(),
        400,
    );
    add(
        "`Accept: text/html`",
        complete(address, "text/html", &[]),
        406,
    );
}

/// Bodies that are missing, malformed or endless.
fn bodies(address: SocketAddr, add: &mut Add<'_>) {
    let post = |headers: &[(&str, &str)], body: &[u8]| {
        request(address, "POST", "/v1/complete", headers, body)
    };
    let multipart = ("content-type", "multipart/form-data; boundary=b");
    add("no body and no type", post(&[], &[]), 415);
    add(
        "JSON in the place of a form",
        post(&[("content-type", "application/json")], b"{}"),
        415,
    );
    add(
        "a form without a boundary",
        post(&[("content-type", "multipart/form-data")], b"--b--"),
        415,
    );
    add("an empty form", post(&[multipart], b""), 400);
    add(
        "a form of 100,000 dashes",
        post(&[multipart], &b"-".repeat(100_000)),
        400,
    );
    let (kind, body) = form(&[file("image", "rgb.png", &asset("rgb.png"))]);
    add(
        "a form that ends in the middle of a file",
        post(&[("content-type", &kind)], &body[..5000]),
        400,
    );
    add(
        "a part of an unknown name",
        complete(address, "*/*", &[text("x\u{7f}", "1")]),
        400,
    );
    add(
        "two images",
        complete(address, "*/*", &[text("image", "a"), text("image", "b")]),
        400,
    );
    add(
        "no image",
        complete(address, "*/*", &[text("points", POINTS)]),
        400,
    );
    add(
        "no points",
        complete(address, "*/*", &[text("image", "a")]),
        400,
    );
    add(
        "`Content-Length: 10000000000`",
        post(&[multipart, ("content-length", "10000000000")], b"--b"),
        413,
    );
    add(
        "`Content-Length: -1`",
        post(&[multipart, ("content-length", "-1")], b"--b"),
        400,
    );
    let chunk = [b"10000\r\n", &b"x".repeat(0x10000)[..], b"\r\n"]
        .concat()
        .repeat(40);
    add(
        "chunks without an end",
        post(&[multipart, ("transfer-encoding", "chunked")], &chunk),
        413,
    );
    add(
        "a body that stops coming",
        post(&[multipart, ("content-length", "1000")], b"--b\r\n"),
        408,
    );
    let options = "[".repeat(2_000_000 >> 1);
    add(
        "options of 1 MB of `[`",
        complete(
            address,
            "*/*",
            &[
                text("image", "a"),
                text("points", POINTS),
                text("options", &options),
            ],
        ),
        400,
    );
    let small = [
        text("image", "a"),
        text("points", POINTS),
        text("options", "{\"a\": 1}"),
    ];
    add("an unknown option", complete(address, "*/*", &small), 400);
}

/// Files that are not images, or larger than they appear.
fn images(address: SocketAddr, add: &mut Add<'_>) {
    let with = |name: &str, bytes: &[u8]| {
        complete(
            address,
            "*/*",
            &[file("image", name, bytes), text("points", POINTS)],
        )
    };
    let rgb = asset("rgb.png");
    add("an image that is text", with("a.png", b"no image"), 422);
    add(
        "a PNG that is cut off",
        with("a.png", &rgb[..rgb.len() / 2]),
        422,
    );
    let jpeg = jpeg(&rgb);
    add(
        "a JPEG that is cut off",
        with("a.jpg", &jpeg[..jpeg.len() / 2]),
        422,
    );
    add(
        "a PNG bomb of 16 megapixels in 16 KB",
        with("a.png", &bomb()),
        413,
    );
    let mut promise = rgb.clone();
    promise[16..24].copy_from_slice(&[0, 0, 0xff, 0xff, 0, 0, 0xff, 0xff]);
    add(
        "a PNG that declares 65535x65535 pixels",
        with("a.png", &promise),
        422,
    );
    add(
        "an SVG",
        with("a.svg", b"<svg xmlns='http://www.w3.org/2000/svg'/>"),
        422,
    );
    add(
        "a TIFF with a tag of 4 GB",
        with(
            "a.tif",
            b"II*\0\x08\0\0\0\x01\0\x00\x01\x03\0\xff\xff\xff\xff\x08\0\0\0\0\0\0\0",
        ),
        422,
    );
    add(
        "an image called `../../../etc/cron.d/x.png`",
        with("../../../etc/cron.d/x.png", &rgb),
        200,
    );
}

/// Encodes the image as JPEG.
fn jpeg(png: &[u8]) -> Vec<u8> {
    let image = image::load_from_memory(png).unwrap().into_rgb8();
    let mut bytes = std::io::Cursor::new(Vec::new());
    image
        .write_to(&mut bytes, image::ImageFormat::Jpeg)
        .unwrap();
    bytes.into_inner()
}

/// Points that are malformed, too many, or decompress to a large size.
fn points(address: SocketAddr, add: &mut Add<'_>) {
    let rgb = asset("rgb.png");
    let list = |list: &str| {
        complete(
            address,
            "*/*",
            &[file("image", "a.png", &rgb), text("points", list)],
        )
    };
    let with = |name: &str, bytes: &[u8]| {
        complete(
            address,
            "*/*",
            &[file("image", "a.png", &rgb), file("points", name, bytes)],
        )
    };
    add(
        "points nested 100,000 deep",
        list(&"[".repeat(100_000)),
        400,
    );
    add("points of `NaN`", list("[[NaN, NaN, NaN]]"), 400);
    add("points of 1e999", list("[[1e999, 1, 1]]"), 400);
    add(
        "no point in the image",
        list("[[-5, -5, 1], [1e9, 3, 2]]"),
        422,
    );
    add(
        "600 points where 500 are taken",
        list(&format!("[{}[1,1,1]]", "[1,1,1],".repeat(599))),
        413,
    );
    add("points in an `.exe`", with("a.exe", b"MZ"), 415);
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000, 1000000), }";
    let npy = [
        b"\x93NUMPY\x01\0\x80\0",
        format!("{header:<127}\n").as_bytes(),
    ]
    .concat();
    add("an npy that declares 4 TB", with("a.npy", &npy), 422);
    let zeros = DepthMap::new(2000, 2000, vec![0.0; 4_000_000]).unwrap();
    let npz = lsdc_files::encode_npz(&[("depth", &zeros)]).unwrap();
    add("an npz bomb of 16 MB in 16 KB", with("a.npz", &npz), 413);
    add(
        "an HDF5 file that is none",
        with("a.h5", b"\x89HDF\r\n\x1a\n\xff\xff\xff\xff"),
        422,
    );
    add("a cloud without a camera", with("a.ply", b"ply\n"), 422);
    add(
        "a table of letters",
        with("a.csv", b"u,v,depth\na,b,c\n"),
        422,
    );
}

/// Malformed cameras.
fn others(address: SocketAddr, add: &mut Add<'_>) {
    let rgb = asset("rgb.png");
    let with = |camera: Part<'_>| {
        complete(
            address,
            "*/*",
            &[file("image", "a.png", &rgb), text("points", POINTS), camera],
        )
    };
    add(
        "the camera `/etc/passwd`",
        with(text("camera", "/etc/passwd")),
        422,
    );
    add(
        "the camera `nan,inf,0,0`",
        with(text("camera", "nan,inf,0,0")),
        422,
    );
}

fn complete(address: SocketAddr, accept: &str, parts: &[Part<'_>]) -> Vec<u8> {
    let (kind, body) = form(parts);
    let headers = [("content-type", kind.as_str()), ("accept", accept)];
    request(address, "POST", "/v1/complete", &headers, &body)
}

/// A black PNG of four thousand pixels square.
fn bomb() -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new_with_quality(
        &mut bytes,
        image::codecs::png::CompressionType::Best,
        image::codecs::png::FilterType::NoFilter,
    );
    let black = vec![0; 4000 * 4000];
    encoder
        .write_image(&black, 4000, 4000, ExtendedColorType::L8)
        .unwrap();
    bytes
}
