//! Frames of a dataset, modified when they are loaded.

use image::RgbImage;
use lsdc_eval::data::{Dataset, DepthMap, Frame, FrameId};
use lsdc_files::error::Result;
use std::path::PathBuf;
use std::sync::Arc;

/// Ratio between the original view and that of the other camera.
const NARROWER: usize = 2;

/// Returns frames with depths multiplied by a factor.
pub(super) fn scaled(frames: Arc<dyn Dataset>, factor: f32) -> Arc<dyn Dataset> {
    Arc::new(ChangedFrames {
        frames,
        about: format!("depths x {factor}"),
        change: move |frame| multiplied(frame, factor),
    })
}

/// Returns the centres of frames, as seen by a camera with a longer lens.
pub(super) fn narrowed(frames: Arc<dyn Dataset>) -> Arc<dyn Dataset> {
    Arc::new(ChangedFrames {
        frames,
        about: format!("the middle 1/{NARROWER}"),
        change: middle,
    })
}

struct ChangedFrames<F> {
    frames: Arc<dyn Dataset>,
    /// Description of the modification.
    about: String,
    change: F,
}

impl<F: Fn(Frame) -> Result<Frame> + Send + Sync> Dataset for ChangedFrames<F> {
    fn description(&self) -> String {
        format!("{}, {}", self.frames.description(), self.about)
    }

    fn protocol(&self) -> &'static str {
        self.frames.protocol()
    }

    fn len(&self) -> usize {
        self.frames.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.frames.id(index)
    }

    fn files(&self, index: usize) -> Vec<PathBuf> {
        self.frames.files(index)
    }

    fn load(&self, index: usize) -> Result<Frame> {
        (self.change)(self.frames.load(index)?)
    }
}

fn multiplied(frame: Frame, factor: f32) -> Result<Frame> {
    let scaled = |map: &DepthMap| {
        let values = map.values().iter().map(|d| d * factor).collect();
        DepthMap::new(map.width(), map.height(), values)
    };
    Ok(Frame {
        depth: scaled(&frame.depth)?,
        sparse: frame.sparse.as_ref().map(scaled).transpose()?,
        ..frame
    })
}

/// Crops the centre and enlarges it to the original size, so that protocols can crop it as usual.
fn middle(frame: Frame) -> Result<Frame> {
    let (width, height) = (frame.depth.width(), frame.depth.height());
    // The pixel of the centre crop shown by each pixel.
    let from = |i: usize, length: usize| {
        let part = (length / NARROWER).max(1);
        (length - part) / 2 + i * part / length
    };
    let place = |i: usize| from(i / width, height) * width + from(i % width, width);
    let moved = |map: &DepthMap| {
        let values = (0..width * height).map(|i| map.values()[place(i)]);
        DepthMap::new(width, height, values.collect())
    };
    let rgb = RgbImage::from_fn(width as u32, height as u32, |x, y| {
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
