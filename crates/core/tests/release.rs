//! Memory that `Completer::release` and `DepthAnything::release` leave allocated.

#![allow(clippy::unwrap_used)]

#[path = "../../../tests/depth_anything/mod.rs"]
mod depth_anything;

use lsdc_core::network::{DepthHead, Encoder, EncoderConfig};
use lsdc_core::weights::Tensor;
use lsdc_core::{Channels, Completer, DepthAnything, Image, Observations, Weights};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts the bytes in use.
struct Counting;

static IN_USE: AtomicUsize = AtomicUsize::new(0);

#[allow(unsafe_code)]
// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        IN_USE.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Returns the memory in use after `work` and after `release`, in MiB beyond permanent allocations such as threads and tables.
fn kept_and_left(work: impl Fn(usize), release: impl Fn(), sizes: [usize; 2]) -> (f64, f64) {
    let in_use = || IN_USE.load(Ordering::Relaxed) as f64 / f64::from(1 << 20);
    work(sizes[0]);
    release();
    let before = in_use();
    work(sizes[1]);
    let kept = in_use() - before;
    release();
    (kept, in_use() - before)
}

/// The colours of an image.
fn colours((width, height): (usize, usize)) -> Vec<u8> {
    let bytes = 0..3 * width * height;
    bytes.map(|i| (i / 7 % 251) as u8).collect()
}

/// A single test, because the memory of all threads is counted.
#[test]
fn nothing_is_kept_after_release() {
    let completer = Completer::new(&Weights::builtin_small()).unwrap();
    let complete = |width: usize| {
        let height = width * 3 / 4;
        let colours = colours((width, height));
        let image = Image::new(width, height, Channels::Rgb, &colours).unwrap();
        let mut points = Observations::new();
        for i in 0..200 {
            points.add(
                (i * 37 % width) as f64,
                (i * 53 % height) as f64,
                1.0 + i as f32 / 100.0,
            );
        }
        completer
            .scene(&image)
            .unwrap()
            .complete(&points)
            .unwrap()
            .depth()
            .unwrap();
    };
    let (kept, left) = kept_and_left(complete, || completer.release(), [64, 304]);
    assert!(kept > 10.0, "{kept} MiB");
    assert!(left < 0.1 * kept, "{left} of {kept} MiB");

    let network = depth_anything::network();
    let colours = colours((64, 48));
    let image = Image::new(64, 48, Channels::Rgb, &colours).unwrap();
    let predict = |short_side: usize| drop(network.predict(&image, short_side).unwrap());
    let (kept, left) = kept_and_left(predict, || network.release(), [252, 518]);
    assert!(kept > 10.0, "{kept} MiB");
    // The patch rows that one thread of the encoder embeds at once take 0.11 MiB.
    assert!(left < 0.05, "{left} of {kept} MiB");
}
