//! Frames of a camera with a longer lens.

use lsdc_eval::data::{Dataset, DepthMap, Frame, FrameId};
use lsdc_files::error::Result;
use std::path::PathBuf;
use std::sync::Arc;

/// How much narrower the view of the other camera is.
const NARROWER: usize = 2;

/// The middle of frames: what a camera with a longer lens sees.
pub(super) struct Narrow(pub(super) Arc<dyn Dataset>);

impl Dataset for Narrow {
    fn about(&self) -> String {
        format!("{}, the middle 1/{NARROWER}", self.0.about())
    }

    fn protocol(&self) -> &'static str {
        self.0.protocol()
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.0.id(index)
    }

    fn files(&self, index: usize) -> Vec<PathBuf> {
        self.0.files(index)
    }

    /// Enlarged to the size that it had, so that protocols find what they cut out.
    fn load(&self, index: usize) -> Result<Frame> {
        let frame = self.0.load(index)?;
        let (width, height) = (frame.depth.width(), frame.depth.height());
        // The pixel of the middle part that each pixel shows.
        let from = |i: usize, length: usize| {
            let part = (length / NARROWER).max(1);
            (length - part) / 2 + i * part / length
        };
        let place = |i: usize| from(i / width, height) * width + from(i % width, width);
        let moved = |map: &DepthMap| {
            let values = (0..width * height).map(|i| map.values()[place(i)]);
            DepthMap::new(width, height, values.collect())
        };
        let rgb = image::RgbImage::from_fn(width as u32, height as u32, |x, y| {
            let (x, y) = (from(x as usize, width), from(y as usize, height));
            *frame.rgb.get_pixel(x as u32, y as u32)
        });
        let mask = frame.mask.as_ref();
        Ok(Frame {
            rgb,
            depth: moved(&frame.depth)?,
            sparse: None,
            rings: None,
            mask: mask.map(|mask| (0..width * height).map(|i| mask[place(i)]).collect()),
            ..frame
        })
    }
}
