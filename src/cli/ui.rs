//! Everything that the program prints: results on stdout, diagnostics on stderr.

use super::signals;
use indicatif::{ProgressBar, ProgressStyle};
use lsdc_files::error::{Cause, Error, Result};
use std::error::Error as _;
use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// The first failure to print a result.
static UNPRINTED: OnceLock<std::io::Error> = OnceLock::new();

/// Prints a result. What cannot be printed is an error at the end of the program.
pub(super) fn print(text: &str) {
    note(writeln!(std::io::stdout(), "{}", text.trim_end()));
}

/// A closed pipe is no failure: the reader has seen enough.
fn note(result: std::io::Result<()>) {
    if let Err(error) = result
        && error.kind() != ErrorKind::BrokenPipe
    {
        let _ = UNPRINTED.set(error);
    }
}

/// Prints what is left to print.
///
/// # Errors
/// A result could not be printed.
pub(super) fn finish() -> Result<()> {
    note(std::io::stdout().flush());
    match UNPRINTED.get() {
        None => Ok(()),
        Some(error) => {
            Err(Error::new(Cause::Write, "cannot write to standard output")
                .because(error.to_string()))
        }
    }
}

/// Prints how it went: a result that `--quiet` can spare.
pub(super) fn tell(text: &str) {
    if !is_quiet() {
        print(text);
    }
}

/// Prints a remark.
pub(super) fn say(text: &str) {
    if !is_quiet() {
        warn(text);
    }
}

/// Prints a warning, even with `--quiet`.
pub(super) fn warn(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Whether remarks are unwanted.
static QUIET: AtomicBool = AtomicBool::new(false);

pub(super) fn be_quiet(quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
}

fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Sends a file to stdout.
pub(super) fn pass_on(path: &Path) -> Result<()> {
    let mut file = File::open(path).map_err(|e| Error::read(path, e))?;
    note(std::io::copy(&mut file, &mut std::io::stdout()).map(|_| ()));
    Ok(())
}

/// Says that one of many could not be done, and why.
pub(super) fn print_failure(name: &Path, error: &Error) {
    warn(&format!("failed: {}", name.display()));
    print_error(error);
}

/// Prints an error with its causes and its hint.
pub(super) fn print_error(error: &Error) {
    warn(&format!("error: {error}"));
    let mut source = error.source();
    while let Some(cause) = source {
        let text = cause.to_string();
        warn(&format!(
            "  caused by: {}",
            text.lines().next().unwrap_or_default()
        ));
        source = cause.source();
    }
    if let Some(hint) = error.advice() {
        warn(&format!("hint: {hint}"));
    }
}

/// Sends log records of the libraries to stderr.
pub(super) fn start_log(verbose: u8) {
    let level = ["error", "info", "debug"][usize::from(verbose).min(2)];
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(level));
    // A second start, as in tests, changes nothing.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .try_init();
}

/// A bar on the terminal; silent where stderr is none.
pub(super) fn bar(total: usize, unit: &str) -> ProgressBar {
    let template = format!("{{bar:30}} {{pos}}/{{len}} {unit}, {{eta}} left {{msg}}");
    styled(ProgressBar::new(total as u64), &template)
}

/// A bar for bytes, whose total may be unknown.
#[cfg(feature = "download")]
pub(super) fn byte_bar(total: Option<u64>) -> ProgressBar {
    match total {
        Some(total) => styled(
            ProgressBar::new(total),
            "{bar:30} {decimal_bytes} of {decimal_total_bytes}, {decimal_bytes_per_sec}, {eta} left",
        ),
        None => styled(
            ProgressBar::no_length(),
            "{decimal_bytes}, {decimal_bytes_per_sec}",
        ),
    }
}

fn styled(bar: ProgressBar, template: &str) -> ProgressBar {
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = if is_quiet() {
        ProgressBar::hidden()
    } else {
        bar
    };
    bar.with_style(style)
}

/// A number of things: `1 point`, `2 points`.
pub(super) fn counted(count: usize, thing: &str) -> String {
    let plural = if count == 1 { "" } else { "s" };
    format!("{count} {thing}{plural}")
}

/// A duration in milliseconds.
pub(super) fn millis(duration: Duration) -> String {
    format!("{:.0} ms", duration.as_secs_f64() * 1e3)
}

/// A flag that Ctrl-C sets, as for [`on_stop`].
pub(super) fn stop_flag() -> Arc<AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    let handler = flag.clone();
    on_stop(move || handler.store(true, Ordering::Relaxed));
    flag
}

/// Does this on Ctrl-C; pressed again, it ends the program at once. A signal that the program was started to ignore,
/// as by `nohup`, stays ignored.
pub(super) fn on_stop(stop: impl Fn() + Send + 'static) {
    let pressed = AtomicBool::new(false);
    let ignored = signals::ignored();
    let installed = ctrlc::set_handler(move || {
        if pressed.swap(true, Ordering::Relaxed) {
            std::process::exit(super::Exit::Interrupted as i32);
        }
        stop();
        say("stopping; press Ctrl-C again to end at once");
    });
    signals::ignore(&ignored);
    if installed.is_err() {
        say("Ctrl-C cannot be caught here; it will end the program at once");
    }
}

/// On with the work, unless Ctrl-C was pressed.
pub(super) fn unless(stop: &AtomicBool) -> ControlFlow<()> {
    if stop.load(Ordering::Relaxed) {
        ControlFlow::Break(())
    } else {
        ControlFlow::Continue(())
    }
}
