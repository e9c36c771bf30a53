//! What `Completer::release` leaves allocated.

#![allow(clippy::unwrap_used)]

use lsdc_core::{Channels, Completer, Image, Observations, Weights};
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

#[test]
fn nothing_of_a_completion_is_kept_after_release() {
    let in_use = || IN_USE.load(Ordering::Relaxed) as f64 / f64::from(1 << 20);
    let completer = Completer::new(&Weights::builtin_small()).unwrap();
    let complete = |(width, height): (usize, usize)| {
        let colours: Vec<u8> = (0..3 * width * height)
            .map(|i| (i / 7 % 251) as u8)
            .collect();
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
            .unwrap()
    };
    // What is allocated once and for all: threads, tables.
    complete((64, 48));
    completer.release();
    let before = in_use();
    complete((304, 228));
    let kept = in_use() - before;
    completer.release();
    let left = in_use() - before;
    assert!(kept > 10.0, "{kept} MiB");
    assert!(left < 0.1 * kept, "{left} of {kept} MiB");
}
