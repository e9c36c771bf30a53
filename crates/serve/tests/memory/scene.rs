//! A scene takes no more memory than the service counts for it.

use crate::{ALONE, counted};
use lsdc_core::{Channels, Completer, Image, Observations, Weights};
use lsdc_serve::fuzzing::scene_bytes;
use std::sync::PoisonError;

#[test]
fn what_is_counted_for_a_scene_is_what_it_takes() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let completer = Completer::new(&Weights::builtin()).unwrap();
    let mut wrong = false;
    for (width, height) in [(64, 48), (304, 228), (640, 480), (2000, 1500)] {
        let rgb: Vec<u8> = (0..3 * width * height)
            .map(|i| (i / 977 % 251) as u8)
            .collect();
        let mut points = Observations::new();
        for i in 0..300 {
            points.add((37 * i % width) as f64, (29 * i % height) as f64, 2.0);
        }
        let make = || {
            let image = Image::new(width, height, Channels::Rgb, &rgb).unwrap();
            let scene = completer.scene(&image).unwrap();
            let depth = scene.complete(&points).unwrap().depth().unwrap();
            drop(depth);
            scene
        };
        // The first scene allocates what all scenes share; while it is alive, its buffers are not reused.
        let first = make();
        let before = counted::now();
        let scene = make();
        // The service also keeps the image.
        let taken = counted::now() - before + rgb.len();
        let counted = scene_bytes(width, height) as usize;
        println!("{width}x{height}: {taken} bytes, {counted} counted");
        wrong |= taken > counted || counted > taken + (64 << 20);
        drop((first, scene));
    }
    assert!(!wrong, "see above");
}
