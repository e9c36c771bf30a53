//! `nyu_depth_v2_labeled.mat`: MATLAB v7.3, which is HDF5 after a user block. MATLAB stores
//! columns first, so that an image is `[3, width, height]`.

use super::{Depths, official};
use crate::data::{Dataset, DepthMap, Frame, FrameId, Split};
use lsdc_files::error::{Error, Result};
use lsdc_files::{Hdf5, from_planes};
use std::path::{Path, PathBuf};

const COLOURS: &str = "images";
const SCENES: &str = "scenes";

/// The labelled frames, read one at a time.
pub(super) struct Labelled {
    file: Hdf5,
    /// Row in the file and name of each frame.
    frames: Vec<(usize, FrameId)>,
    depths: Depths,
    width: usize,
    height: usize,
    complete: bool,
}

impl Labelled {
    /// Opens the file. The official lists apply to its 1449 frames; a file with fewer contains only validation frames.
    pub(super) fn open(path: &Path, split: Split, depths: Depths) -> Result<Self> {
        let file = Hdf5::open(path)?;
        let [rows, 3, width, height] = file.shape(COLOURS)?[..] else {
            return Err(Error::format(
                path,
                format!("`{COLOURS}` is not of shape (frames, 3, width, height)"),
            ));
        };
        let complete = rows == official::FRAMES;
        if !complete && (split == Split::Train || rows > official::FRAMES) {
            return Err(Error::format(
                path,
                format!("holds {rows} frames, not {}", official::FRAMES),
            )
            .hint("the official split lists do not apply to it: it serves --split val only"));
        }
        let scenes = match split {
            Split::Val => Vec::new(),
            Split::Train => file.texts(SCENES, official::FRAMES)?,
        };
        let frames = (0..rows)
            .map(|row| (row, row + 1))
            .filter(|(_, n)| !complete || official::is_test(*n) == (split == Split::Val))
            .map(|(row, n)| match (scenes.get(row), official::name(n)) {
                (None, name) => (row, name),
                (Some(scene), name) => (row, format!("{scene}/{name}")),
            })
            .collect();
        Ok(Self {
            file,
            frames,
            depths,
            width,
            height,
            complete,
        })
    }
}

impl Dataset for Labelled {
    fn description(&self) -> String {
        let depths = match self.depths {
            Depths::Filled => "filled depths",
            Depths::Raw => "raw depths",
        };
        let lists = if self.complete {
            "official split"
        } else {
            "all frames of an incomplete file"
        };
        format!("NYU Depth v2, labelled .mat, {depths}, {lists}")
    }

    fn protocol(&self) -> &'static str {
        "nyu"
    }

    fn len(&self) -> usize {
        self.frames.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.frames[index].1.clone()
    }

    fn files(&self, _index: usize) -> Vec<PathBuf> {
        vec![self.file.path().to_owned()]
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let (row, ref id) = self.frames[index];
        let (width, height) = (self.width, self.height);
        let name = match self.depths {
            Depths::Filled => "depths",
            Depths::Raw => "rawDepths",
        };
        let planes = self.file.rows_u8(COLOURS, &[3, width, height], row, 1)?;
        let columns = self.file.rows_f32(name, &[width, height], row, 1)?;
        let depths = (0..width * height)
            .map(|i| columns[i % width * height + i / width])
            .collect();
        Frame::new(
            id.clone(),
            from_planes(&planes, width, height, |x, y| x * height + y)?,
            DepthMap::new(width, height, depths)?,
        )
    }
}
