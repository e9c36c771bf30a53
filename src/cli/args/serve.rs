//! Arguments of `serve` and `view`.

use super::Model;
use super::encoder::PretrainedEncoder;
use clap::Args as ClapArgs;
use std::net::SocketAddr;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
#[command(after_long_help = "See docs/serve.md for the requests, with lines for curl.")]
pub(in crate::cli) struct Serve {
    /// Address and port to listen on; port 0 is any that is free.
    #[arg(long, default_value = "127.0.0.1:8080", value_name = "ADDR")]
    pub(in crate::cli) listen: SocketAddr,
    /// File with the token that clients must show, as `Authorization: Bearer TOKEN`; or set the environment variable
    /// `LSDC_TOKEN`.
    #[arg(long, value_name = "FILE", help_heading = "Access")]
    pub(in crate::cli) token_file: Option<PathBuf>,
    /// Let everybody ask who reaches the address. Without this, only this machine is served without a token.
    #[arg(long, conflicts_with = "token_file", help_heading = "Access")]
    pub(in crate::cli) without_token: bool,
    /// Certificate for HTTPS and those above it (PEM).
    #[arg(
        long,
        value_name = "FILE",
        requires = "tls_key",
        help_heading = "Access"
    )]
    pub(in crate::cli) tls_cert: Option<PathBuf>,
    /// Private key of the certificate (PEM).
    #[arg(
        long,
        value_name = "FILE",
        requires = "tls_cert",
        help_heading = "Access"
    )]
    pub(in crate::cli) tls_key: Option<PathBuf>,
    #[command(flatten)]
    pub(in crate::cli) limits: Limits,
    #[command(flatten)]
    pub(in crate::cli) encoder: PretrainedEncoder,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}

/// What one request, and all together, may cost.
#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Limits {
    /// Computations at a time [default: one for each core].
    #[arg(
        long,
        value_name = "N",
        help_heading = "Limits",
        hide_short_help = true
    )]
    workers: Option<usize>,
    /// Requests that wait; more are refused with status 429 [default: 32].
    #[arg(
        long,
        value_name = "N",
        help_heading = "Limits",
        hide_short_help = true
    )]
    queue: Option<usize>,
    /// Megabytes of a request [default: 64].
    #[arg(
        long,
        value_name = "MIB",
        help_heading = "Limits",
        hide_short_help = true
    )]
    max_body: Option<u64>,
    /// Megapixels of an image [default: 50].
    #[arg(
        long,
        value_name = "MP",
        help_heading = "Limits",
        hide_short_help = true
    )]
    max_pixels: Option<f64>,
    /// Points of a request [default: 2000000].
    #[arg(
        long,
        value_name = "N",
        help_heading = "Limits",
        hide_short_help = true
    )]
    max_points: Option<usize>,
    /// Seconds for a computation, its time in the queue included [default: 60].
    #[arg(
        long,
        value_name = "SECONDS",
        help_heading = "Limits",
        hide_short_help = true
    )]
    timeout: Option<u64>,
    /// Megabytes of all scenes that are kept [default: 2048].
    #[arg(
        long,
        value_name = "MIB",
        help_heading = "Limits",
        hide_short_help = true
    )]
    scene_memory: Option<u64>,
    /// Seconds after which an unused scene is forgotten [default: 600].
    #[arg(
        long,
        value_name = "SECONDS",
        help_heading = "Limits",
        hide_short_help = true
    )]
    scene_expiry: Option<u64>,
}

impl Limits {
    /// Those of the service, with what was given.
    pub(in crate::cli) fn apply(&self) -> lsdc_serve::Limits {
        let usual = lsdc_serve::Limits::default();
        let seconds = std::time::Duration::from_secs;
        let megapixels = |mega: f64| (mega * 1e6) as usize;
        lsdc_serve::Limits {
            workers: self.workers.unwrap_or(usual.workers),
            queue: self.queue.unwrap_or(usual.queue),
            body: self.max_body.map_or(usual.body, |mebi| mebi << 20),
            pixels: self.max_pixels.map_or(usual.pixels, megapixels),
            points: self.max_points.unwrap_or(usual.points),
            request: self.timeout.map_or(usual.request, seconds),
            scenes: self.scene_memory.map_or(usual.scenes, |mebi| mebi << 20),
            expiry: self.scene_expiry.map_or(usual.expiry, seconds),
            ..usual
        }
    }
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct View {
    /// Image to open; any other can be opened in the page.
    pub(in crate::cli) image: Option<PathBuf>,
    /// Its sparse depths, in any file that `lsdc complete` reads for a single image.
    pub(in crate::cli) points: Option<PathBuf>,
    /// Camera file, for points in space and for clouds.
    #[arg(long, value_name = "FILE", requires = "image")]
    pub(in crate::cli) camera: Option<PathBuf>,
    /// Folder of results of `lsdc complete` or `lsdc eval --save`, to look through and to compare; may be repeated.
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) gallery: Vec<PathBuf>,
    /// Port on this machine; 0 is any that is free.
    #[arg(long, default_value_t = 0, value_name = "PORT", hide_short_help = true)]
    pub(in crate::cli) port: u16,
    /// Only print the address of the page.
    #[arg(long)]
    pub(in crate::cli) no_browser: bool,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
    #[command(flatten)]
    pub(in crate::cli) encoder: PretrainedEncoder,
}
