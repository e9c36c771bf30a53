//! Limits of the decoded size of a file.

use crate::error::{Cause, Error, Result};
use std::cell::Cell;
use std::path::Path;

/// Largest image, or part of a scan in memory at a time, in bytes.
pub(super) const LARGEST: u64 = 1 << 30;

thread_local! {
    /// Limit of the decoded size on this thread in bytes, if set.
    static MOST: Cell<Option<u64>> = const { Cell::new(None) };
}

/// Runs `read` with a limit for readers of this thread: no image, map or cloud of more than `bytes` is decoded from a file,
/// however well it is compressed; more is an error of [`Cause::TooLarge`]. Without a limit, an image or a map may have 1
/// GiB, and a cloud, which is never in memory as a whole, any size.
pub fn reading_at_most<T>(bytes: u64, read: impl FnOnce() -> T) -> T {
    /// Restores the limit, also after a panic.
    struct Before(Option<u64>);
    impl Drop for Before {
        fn drop(&mut self) {
            MOST.set(self.0);
        }
    }
    let _before = Before(MOST.replace(Some(bytes)));
    read()
}

/// Whether a file of `size` bytes can contain `bytes` of values: deflate expands a byte to at most 1032 (zlib), and small
/// sizes are always accepted. Damaged headers declare much more.
pub(super) fn plausible(bytes: u64, size: u64) -> bool {
    bytes <= (1 << 20).max(size.saturating_mul(1100))
}

/// Rejects an image that is too large, or larger than a file of `size` bytes can contain.
pub(super) fn check_pixels(
    path: &Path,
    (width, height): (u32, u32),
    bytes: u64,
    size: u64,
) -> Result<()> {
    if plausible(bytes, size) {
        let what = format!("{width}x{height} pixels");
        return check_unfolded(path, &what, bytes, LARGEST);
    }
    let what = format!("declares {width}x{height} pixels but is only {size} bytes long");
    Err(Error::format(path, what).hint("the file is damaged; write it again"))
}

/// Rejects contents beyond the limit in bytes: `default_limit`, unless another one is set.
pub(super) fn check_unfolded(
    path: &Path,
    what: &str,
    bytes: u64,
    default_limit: u64,
) -> Result<()> {
    let most = MOST
        .get()
        .map_or(default_limit, |most| most.min(default_limit));
    if bytes <= most {
        return Ok(());
    }
    let (path, bytes, most) = (path.display(), bytes >> 20, most >> 20);
    let what = format!("`{path}` is too large: {what} take {bytes} MiB, at most {most} are read");
    Err(Error::new(Cause::TooLarge, what).hint("make it smaller, or cut it"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_holds_within_and_ends_after_a_panic() {
        let path = Path::new("a.png");
        let check = || check_pixels(path, (640, 480), 921_600, 10_000);
        assert!(check().is_ok());
        let error = reading_at_most(100_000, check).unwrap_err();
        assert_eq!(error.cause(), Cause::TooLarge);
        assert!(error.to_string().contains("640x480 pixels"), "{error}");
        let panics = || reading_at_most(1000, || panic!("a damaged file"));
        assert!(std::panic::catch_unwind(panics).is_err());
        assert!(check().is_ok());
    }

    #[test]
    fn the_size_of_a_sound_image_is_no_damage() {
        let path = Path::new("a.png");
        let check = |size| check_pixels(path, (40_000, 40_000), 4_800_000_000, size).unwrap_err();
        let large = check(900_000_000);
        assert_eq!(large.cause(), Cause::TooLarge);
        let text = large.to_string();
        assert!(text.contains("is too large: 40000x40000"), "{text}");
        assert!(check(900).to_string().contains("only 900 bytes"));
    }
}
