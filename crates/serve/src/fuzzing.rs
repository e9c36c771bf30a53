//! Entry points for fuzzers and tests: the readers of all input, without a connection.

use crate::body::Incoming;
use crate::config::Limits;
use crate::frame::{InputFrame, check_points};
use crate::media_type::MediaType;
use crate::options::Options;
use crate::points;
use crate::upload::Upload;
use axum::body::Body;

/// Small limits: what is refused is as good as what is read.
fn limits() -> Limits {
    Limits {
        body: 1 << 20,
        pixels: 1 << 16,
        points: 1000,
        unfolded: 8 << 20,
        ..Limits::default()
    }
}

/// Reads a form as `/v1/complete` does, up to the computation. Returns whether all of it could be read.
pub fn form(content_type: &str, bytes: &[u8]) -> bool {
    let limits = limits();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build();
    let Ok(runtime) = runtime else {
        return false;
    };
    let mut body = Incoming::new(Body::from(bytes.to_vec()), &limits);
    let known = ["image", "points", "camera", "options"];
    let mut read = || {
        let upload = runtime.block_on(Upload::read(content_type, &mut body, &known))?;
        let options = Options::read(&upload)?;
        check_points(&upload)?;
        InputFrame::read(&upload, &limits)?.points(&upload, &options, &limits)
    };
    read().is_ok()
}

/// Reads points, options and a header as JSON and text.
pub fn text(bytes: &[u8]) {
    let _ = points::parse(bytes, 1000);
    let _ = points::parse_with_options(bytes, 1000);
    let _ = Options::parse(bytes);
    let _ = MediaType::accepted(std::str::from_utf8(bytes).ok());
}

/// The bytes that are counted for a scene of an image of this size.
pub fn scene_bytes(width: usize, height: usize) -> u64 {
    crate::scene_cache::bytes(width, height)
}
