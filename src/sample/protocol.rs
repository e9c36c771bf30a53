//! How a frame is brought to the size at which it is measured.

use super::resize::{resize_depth_bilinear, resize_depth_nearest, resize_rgb};
use crate::data::{DepthMap, Frame};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Rows and columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Size {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.height, self.width)
    }
}

/// How depths are resized; colours are always bilinear with antialiasing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Interpolation {
    /// As NLSPN, CSPN and later: mixes depths at edges.
    #[default]
    Bilinear,
    /// As sparse-to-dense: keeps measured values.
    Nearest,
}

/// Resize, then centre crop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Protocol {
    /// Resize to this first.
    pub resize: Option<Size>,
    /// Then cut this out of the centre.
    pub crop: Option<Size>,
    /// How depths are resized.
    pub depth_resize: Interpolation,
}

impl Protocol {
    /// NYU Depth v2 as evaluated since sparse-to-dense (Ma and Karaman 2018): half size, then the
    /// centre 228x304.
    pub fn nyu() -> Self {
        Self {
            resize: Some(Size {
                height: 240,
                width: 320,
            }),
            crop: Some(Size {
                height: 228,
                width: 304,
            }),
            depth_resize: Interpolation::default(),
        }
    }

    /// Brings a frame to the protocol's size.
    ///
    /// # Errors
    /// The crop is larger than the frame.
    pub fn apply(&self, frame: &Frame) -> Result<Frame> {
        self.cut(self.scale(frame)?)
    }

    /// The resizing step alone.
    pub(super) fn scale(&self, frame: &Frame) -> Result<Frame> {
        let Some(size) = self.resize else {
            return Ok(frame.clone());
        };
        let resize_depth = match self.depth_resize {
            Interpolation::Bilinear => resize_depth_bilinear,
            Interpolation::Nearest => resize_depth_nearest,
        };
        Ok(Frame {
            id: frame.id.clone(),
            rgb: resize_rgb(&frame.rgb, size.width, size.height)?,
            depth: resize_depth(&frame.depth, size.width, size.height)?,
        })
    }

    fn cut(&self, frame: Frame) -> Result<Frame> {
        let Some(size) = self.crop else {
            return Ok(frame);
        };
        let (x, y) = self.corner(&frame)?;
        let values = (y..y + size.height)
            .flat_map(|row| (x..x + size.width).map(move |column| (column, row)))
            .map(|(column, row)| frame.depth.at(column, row))
            .collect();
        let (left, top) = (x as u32, y as u32);
        let (width, height) = (size.width as u32, size.height as u32);
        Ok(Frame {
            rgb: image::imageops::crop_imm(&frame.rgb, left, top, width, height).to_image(),
            depth: DepthMap::new(size.width, size.height, values)?,
            id: frame.id,
        })
    }

    /// The crop's upper left pixel in a frame.
    pub(super) fn corner(&self, frame: &Frame) -> Result<(usize, usize)> {
        let (width, height) = (frame.depth.width(), frame.depth.height());
        let size = self.crop.unwrap_or(Size { height, width });
        if size.height > height || size.width > width {
            return Err(Error::shape(format!(
                "frame `{}` of {height}x{width} is smaller than the crop of {size}",
                frame.id
            )));
        }
        // Rounded half to even, as torchvision's CenterCrop.
        let half = |room: usize| (room as f64 / 2.0).round_ties_even() as usize;
        Ok((half(width - size.width), half(height - size.height)))
    }
}

impl std::fmt::Display for Protocol {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.resize {
            Some(size) => {
                let depth = match self.depth_resize {
                    Interpolation::Bilinear => "bilinear",
                    Interpolation::Nearest => "nearest",
                };
                write!(f, "resized to {size} (colour bilinear, depth {depth})")?;
            }
            None => write!(f, "full size")?,
        }
        if let Some(size) = self.crop {
            write!(f, ", centre crop {size}")?;
        }
        Ok(())
    }
}
