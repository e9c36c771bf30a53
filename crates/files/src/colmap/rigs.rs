//! Rigs of cameras (COLMAP 3.12 and later): where frames place images, which overrides the poses in the file of images.

use super::records::Placed;
use std::collections::HashMap;

/// Where the cameras of rigs are in these, by rig and camera.
#[derive(Debug, Default)]
pub(super) struct Rigs(HashMap<(u32, u32), Option<Placed>>);

/// The frames that images belong to, by image.
#[derive(Debug, Default)]
pub(super) struct Frames(HashMap<u64, Frame>);

/// Images that a rig takes at once, for one of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) rig: u32,
    /// The camera of the image.
    pub(super) sensor: u32,
    /// The place of the rig.
    pub(super) placed: Placed,
}

impl Rigs {
    pub(super) fn add(&mut self, rig: u32, camera: u32, placed: Option<Placed>) {
        self.0.insert((rig, camera), placed);
    }
}

impl Frames {
    pub(super) fn add(&mut self, image: u64, frame: Frame) {
        self.0.insert(image, frame);
    }

    /// Where the frame of an image and the rig place it, if they do.
    pub(super) fn placed(&self, image: u64, rigs: &Rigs) -> Option<Placed> {
        let frame = self.0.get(&image)?;
        let camera = rigs.0.get(&(frame.rig, frame.sensor)).copied()??;
        Some(camera.after(frame.placed))
    }
}
