//! Procedural rooms: ray-cast furnished interiors with exact depth. Needs no download.

mod furnish;
mod geometry;
mod paint;
mod path;
mod render;

pub use path::RoomPath;

use crate::data::{Dataset, Frame, FrameId, Split};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};

/// Number and size of procedural frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RoomsConfig {
    /// Seed of the rooms.
    pub seed: u64,
    /// Number of training frames.
    pub train: usize,
    /// Number of validation frames.
    pub val: usize,
    /// Image columns.
    pub width: usize,
    /// Image rows.
    pub height: usize,
}

impl Default for RoomsConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            train: 2000,
            val: 100,
            width: 304,
            height: 228,
        }
    }
}

/// The procedural dataset; frame `i` is the same on every machine.
#[derive(Clone, Debug)]
pub struct Rooms {
    split: Split,
    config: RoomsConfig,
}

impl Rooms {
    /// Creates the rooms of a split.
    ///
    /// # Errors
    /// No rooms, or images outside 16 to 8192 pixels.
    pub fn new(split: Split, config: &RoomsConfig) -> Result<Self> {
        check_size(config.width, config.height)?;
        let rooms = Self {
            split,
            config: *config,
        };
        if rooms.is_empty() {
            return Err(Error::config(format!("`rooms.{}` is 0", split.name())));
        }
        Ok(rooms)
    }
}

fn check_size(width: usize, height: usize) -> Result<()> {
    let sizes = 16..=8192;
    if sizes.contains(&width) && sizes.contains(&height) {
        return Ok(());
    }
    Err(Error::config(
        "`rooms.width` and `height` must be 16 to 8192",
    ))
}

/// Returns the random stream that furnishes a room.
fn stream(seed: u64, id: &str) -> Rng {
    Rng::stream(seed, &["room", id])
}

fn id(split: Split, index: usize) -> FrameId {
    format!("{}/{index:05}", split.name())
}

impl Dataset for Rooms {
    fn description(&self) -> String {
        format!("procedural rooms, seed {}", self.config.seed)
    }

    fn scene(&self, index: usize) -> Option<String> {
        Some(self.id(index))
    }

    fn len(&self) -> usize {
        match self.split {
            Split::Train => self.config.train,
            Split::Val => self.config.val,
        }
    }

    fn id(&self, index: usize) -> FrameId {
        id(self.split, index)
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let id = self.id(index);
        let mut rng = stream(self.config.seed, &id);
        let room = furnish::furnish(&mut rng);
        let view = render::View::random(&room, &mut rng);
        let exposure = render::exposure(&mut rng);
        let size = (self.config.width, self.config.height);
        let (rgb, depth) = render::render(&room, &view, size, exposure, &mut rng)?;
        Frame::new(id, rgb, depth)
    }
}
