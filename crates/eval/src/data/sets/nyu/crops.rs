//! The pair of files of Conti et al. (sparsity-agnostic depth completion, WACV 2023): the 654 test crops of 228x304 with their
//! depths, and 500 fixed points for each.

use crate::data::{Dataset, DepthMap, Frame, FrameId};
use image::RgbImage;
use lsdc_files::error::{Error, Result};
use lsdc_files::{Hdf5, from_planes};
use std::path::{Path, PathBuf};

const CROPS: &str = "nyu_img_gt.h5";
const HINTS: &str = "nyu_pred_with_500.h5";

/// An array of all frames: its name and the shape of one frame.
#[derive(Clone, Debug)]
struct ArrayInfo {
    name: String,
    shape: Vec<usize>,
}

/// The crops, read one at a time.
pub(super) struct Crops {
    file: Hdf5,
    colours: ArrayInfo,
    truth: ArrayInfo,
    hints: Option<(Hdf5, ArrayInfo)>,
    frames: usize,
    width: usize,
    height: usize,
}

impl Crops {
    /// Returns the folder of the pair of files, if `root` is or contains it.
    pub(super) fn folder_of(root: &Path) -> Option<PathBuf> {
        let folder = if root.ends_with(CROPS) {
            root.parent()?.to_owned()
        } else {
            root.to_owned()
        };
        folder.join(CROPS).is_file().then_some(folder)
    }

    /// Opens the crops, and the points if they are in the same folder.
    pub(super) fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(CROPS);
        let file = Hdf5::open(&path)?;
        let truth = array(&file, &path, &["gt", "depth"])?;
        let colours = array(&file, &path, &["img", "image", "rgb"])?;
        let (height, width) = match truth.shape[..] {
            [_, height, width] | [_, height, width, 1] | [_, 1, height, width] => (height, width),
            ref other => {
                return Err(Error::format(
                    &path,
                    format!(
                        "`{}` has shape {other:?}, expected (frames, height, width)",
                        truth.name
                    ),
                ));
            }
        };
        let hints = folder.join(HINTS);
        let hints = if hints.is_file() {
            let file = Hdf5::open(&hints)?;
            let points = array(&file, &hints, &["hints", "hint", "sparse"])?;
            Some((file, points))
        } else {
            None
        };
        Ok(Self {
            frames: truth.shape[0],
            file,
            colours,
            truth,
            hints,
            width,
            height,
        })
    }
}

/// Returns the first array with one of the names.
fn array(file: &Hdf5, path: &Path, names: &[&str]) -> Result<ArrayInfo> {
    let found = file.names()?;
    let Some(name) = names.iter().find(|name| found.iter().any(|f| f == *name)) else {
        return Err(Error::format(
            path,
            format!(
                "has no array named {}; found: {}",
                names.join(" or "),
                found.join(", ")
            ),
        ));
    };
    let shape = file.shape(name)?;
    if shape.is_empty() {
        return Err(Error::format(path, format!("`{name}` is a single value")));
    }
    Ok(ArrayInfo {
        name: (*name).to_owned(),
        shape,
    })
}

impl Dataset for Crops {
    fn description(&self) -> String {
        let hints = match self.hints {
            Some(_) => "with their fixed 500 points",
            None => "without their points",
        };
        format!("NYU Depth v2, crops of Conti et al. {hints}")
    }

    fn protocol(&self) -> &'static str {
        match self.hints {
            Some(_) => "nyu-conti",
            None => "full",
        }
    }

    fn len(&self) -> usize {
        self.frames
    }

    fn id(&self, index: usize) -> FrameId {
        format!("crop/{index:04}")
    }

    fn files(&self, _index: usize) -> Vec<PathBuf> {
        let hints = self.hints.iter().map(|(file, _)| file);
        let files = std::iter::once(&self.file).chain(hints);
        files.map(|file| file.path().to_owned()).collect()
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let (width, height) = (self.width, self.height);
        let depths = |file: &Hdf5, array: &ArrayInfo| {
            let values = file.rows_f32(&array.name, &array.shape[1..], index, 1)?;
            Ok::<_, Error>(DepthMap::new(width, height, values)?)
        };
        let row = &self.colours.shape[1..];
        let bytes = self.file.rows_u8(&self.colours.name, row, index, 1)?;
        let rgb = if row == [3, height, width] {
            from_planes(&bytes, width, height, |x, y| y * width + x)?
        } else {
            RgbImage::from_raw(width as u32, height as u32, bytes)
                .filter(|_| row == [height, width, 3])
                .ok_or_else(|| Error::shape("colours and depths of the crops differ in size"))?
        };
        let frame = Frame::new(self.id(index), rgb, depths(&self.file, &self.truth)?)?;
        match &self.hints {
            None => Ok(frame),
            Some((file, array)) => frame.with_sparse(depths(file, array)?),
        }
    }
}
