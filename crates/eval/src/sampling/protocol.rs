//! Protocols: the size at which a frame is evaluated, and its valid depths.

use super::Size;
use super::occlusion::Occlusion;
use super::resize::{Interpolation, move_points, resize_depth, resize_rgb, sources_of_points};
use crate::data::{DepthMap, Environment, Frame};
use crate::window;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};

/// Part of a frame kept by a crop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Anchor {
    /// The centre.
    #[default]
    Centre,
    /// The bottom centre: a laser scanner does not see the sky.
    Bottom,
}

/// Largest depth jumps: a true depth is invalid if a depth among its 3x3 neighbours differs by more than this share of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Jumps {
    /// For indoor frames.
    pub indoor: f32,
    /// For outdoor frames.
    pub outdoor: f32,
}

/// Steps of a protocol, in order. Steps that are absent are skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Protocol {
    /// Remove the depths that the dataset marks invalid.
    pub mask: bool,
    /// Remove depths outside this range, in metres.
    pub range: Option<[f32; 2]>,
    /// Remove returns behind a nearer surface, which a laser scanner above the camera sees; only for frames with
    /// [sparse](Frame::is_sparse) depths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occlusion: Option<Occlusion>,
    /// Remove depths beside a jump.
    pub jumps: Option<Jumps>,
    /// Crop to this size at the centre.
    pub cut: Option<Size>,
    /// Resize to this size.
    pub resize: Option<Size>,
    /// If neither `resize` nor `crop` is given: resize to about this many pixels, with the aspect ratio of each frame; in
    /// training, with that of the first frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixels: Option<usize>,
    /// Resampling of colours.
    pub rgb_resize: Interpolation,
    /// Resampling of depths.
    pub depth_resize: Interpolation,
    /// Crop to this size after resizing.
    pub crop: Option<Size>,
    /// Part kept by `crop`.
    pub anchor: Anchor,
}

impl Protocol {
    /// Returns the protocol of NYU Depth v2 since sparse-to-dense (Ma and Karaman 2018): half size, then the centre 228x304.
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
            ..Self::default()
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// `pixels` is 0, or conflicts with another size.
    pub fn check(&self) -> Result<()> {
        if self.pixels == Some(0) {
            let what = "`protocol.pixels` must be above 0";
            return Err(Error::config(what).hint("as in `pixels = 69312`, or leave it out"));
        }
        if self.pixels.is_some() && self.resize.or(self.crop).is_some() {
            let what = "`protocol.pixels` has no effect beside `resize` or `crop`";
            return Err(Error::config(what).hint("leave out `pixels`, or `resize` and `crop`"));
        }
        Ok(())
    }

    /// Applies the protocol to a frame.
    ///
    /// # Errors
    /// A crop is larger than the frame.
    pub fn apply(&self, frame: &Frame) -> Result<Frame> {
        let frame = self.scale(frame)?;
        match self.crop {
            None => Ok(frame),
            Some(size) => {
                let corner = self.corner(&frame)?;
                cropped(&frame, corner, size)
            }
        }
    }

    /// Applies all steps except the last crop.
    ///
    /// # Errors
    /// A cut is larger than the frame.
    pub fn scale(&self, frame: &Frame) -> Result<Frame> {
        let mut frame = Frame {
            depth: self.valid(frame)?,
            ..frame.clone()
        };
        if let (Some(occlusion), Some(sparse)) = (self.occlusion, &frame.sparse)
            && occlusion.given
        {
            frame.sparse = Some(occlusion.without(sparse)?);
        }
        if let Some(size) = self.cut {
            let corner = corner(&frame, size, Anchor::Centre)?;
            frame = cropped(&frame, corner, size)?;
        }
        if let Some(size) = self.resized(Size::of(&frame.depth)) {
            frame.rgb = resize_rgb(&frame.rgb, size, self.rgb_resize)?;
            if let (Some(rings), Some(returns)) = (&frame.rings, &frame.sparse) {
                let sources = sources_of_points(returns, size)?.into_iter();
                let rings = sources.map(|source| source.map_or(-1, |pixel| rings[pixel]));
                frame.rings = Some(rings.collect());
                // Returns have holes all around, which interpolation would spread over them.
                frame.depth = move_points(&frame.depth, size)?;
            } else {
                frame.depth = resize_depth(&frame.depth, size, self.depth_resize)?;
            }
            frame.sparse = match &frame.sparse {
                Some(sparse) => Some(move_points(sparse, size)?),
                None => None,
            };
        }
        Ok(frame)
    }

    /// Returns the size after resizing a frame of this size; `None` if it is not resized.
    fn resized(&self, size: Size) -> Option<Size> {
        let pixels = self.pixels.filter(|_| self.crop.is_none());
        self.resize.or_else(|| Some(size.with_pixels(pixels?)))
    }

    /// Returns the protocol that resizes all frames to the size of this one.
    #[must_use]
    pub fn sized_as(&self, frame: &Frame) -> Self {
        Self {
            resize: self.resized(self.cut.unwrap_or(Size::of(&frame.depth))),
            pixels: None,
            ..*self
        }
    }

    /// Returns the remaining step for scaled frames: the last crop.
    #[must_use]
    pub fn after_scaling(&self) -> Self {
        Self {
            crop: self.crop,
            anchor: self.anchor,
            ..Self::default()
        }
    }

    /// Returns the upper left pixel of the last crop in a frame.
    ///
    /// # Errors
    /// The frame is smaller than the crop.
    pub fn corner(&self, frame: &Frame) -> Result<(usize, usize)> {
        let size = self.crop.unwrap_or(Size::of(&frame.depth));
        corner(frame, size, self.anchor)
    }

    /// Returns the valid true depths.
    fn valid(&self, frame: &Frame) -> Result<DepthMap> {
        let mut values = frame.depth.values().to_vec();
        if let (true, Some(mask)) = (self.mask, &frame.mask) {
            for (value, valid) in values.iter_mut().zip(mask) {
                *value *= f32::from(*valid);
            }
        }
        if let Some([low, high]) = self.range {
            for value in &mut values {
                if !(low..=high).contains(value) {
                    *value = 0.0;
                }
            }
        }
        let mut depth = DepthMap::new(frame.depth.width(), frame.depth.height(), values)?;
        if let Some(occlusion) = self.occlusion.filter(|_| frame.is_sparse()) {
            depth = occlusion.without(&depth)?;
        }
        match self.jumps {
            None => Ok(depth),
            Some(jumps) => without_jumps(
                &depth,
                match frame.place {
                    Environment::Indoor => jumps.indoor,
                    Environment::Outdoor => jumps.outdoor,
                },
            ),
        }
    }
}

fn without_jumps(depth: &DepthMap, max_jump: f32) -> Result<DepthMap> {
    let (width, height) = (depth.width(), depth.height());
    let smooth = |x: usize, y: usize| {
        let here = depth.at(x, y);
        window(y, 1, height).all(|v| {
            window(x, 1, width).all(|u| {
                let neighbour = depth.at(u, v);
                neighbour == 0.0 || (neighbour - here).abs() <= max_jump * here
            })
        })
    };
    let values = (0..width * height)
        .map(|i| (i % width, i / width))
        .map(|(x, y)| f32::from(smooth(x, y)) * depth.at(x, y))
        .collect();
    Ok(DepthMap::new(width, height, values)?)
}

/// Returns the upper left pixel of a crop.
fn corner(frame: &Frame, size: Size, anchor: Anchor) -> Result<(usize, usize)> {
    let whole = Size::of(&frame.depth);
    if size.height > whole.height || size.width > whole.width {
        return Err(Error::shape(format!(
            "frame `{}` of {whole} is smaller than the crop of {size}",
            frame.id
        )));
    }
    // Rounded half to even, as in torchvision's CenterCrop.
    let half = |room: usize| (room as f64 / 2.0).round_ties_even() as usize;
    let top = match anchor {
        Anchor::Centre => half(whole.height - size.height),
        Anchor::Bottom => whole.height - size.height,
    };
    Ok((half(whole.width - size.width), top))
}

fn cropped(frame: &Frame, (left, top): (usize, usize), size: Size) -> Result<Frame> {
    let part = |map: &DepthMap| {
        let values = (top..top + size.height)
            .flat_map(|y| (left..left + size.width).map(move |x| map.at(x, y)))
            .collect();
        DepthMap::new(size.width, size.height, values)
    };
    let whole = frame.depth.width();
    let rings = frame.rings.as_ref().map(|rings| {
        let rows = (top..top + size.height).map(|y| y * whole + left);
        rows.flat_map(|from| rings[from..from + size.width].iter().copied())
            .collect()
    });
    let [x, y, width, height] = [left, top, size.width, size.height].map(|n| n as u32);
    Ok(Frame {
        id: frame.id.clone(),
        rgb: image::imageops::crop_imm(&frame.rgb, x, y, width, height).to_image(),
        depth: part(&frame.depth)?,
        sparse: frame.sparse.as_ref().map(part).transpose()?,
        // Already applied.
        mask: None,
        rings,
        place: frame.place,
        // Teachers see the uncropped frame.
        target: None,
    })
}

impl Display for Protocol {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let mut steps = Vec::new();
        if self.mask {
            steps.push("the dataset's validity mask".to_owned());
        }
        if let Some([low, high]) = self.range {
            steps.push(format!("true depths of {low} to {high} m"));
        }
        if let Some(occlusion) = self.occlusion {
            steps.push(occlusion.to_string());
        }
        if let Some(Jumps { indoor, outdoor }) = self.jumps {
            steps.push(format!(
                "no depths beside jumps of {} % (outdoor {} %)",
                per_cent(indoor),
                per_cent(outdoor)
            ));
        }
        if let Some(size) = self.cut {
            steps.push(format!("centre crop {size}"));
        }
        if let Some(size) = self.resize {
            steps.push(format!(
                "resized to {size} (colour {}, depth {})",
                self.rgb_resize.name(),
                self.depth_resize.name()
            ));
        }
        if let (Some(pixels), None, None) = (self.pixels, self.resize, self.crop) {
            steps.push(format!(
                "resized to about {pixels} pixels (colour {}, depth {})",
                self.rgb_resize.name(),
                self.depth_resize.name()
            ));
        }
        if let Some(size) = self.crop {
            let anchor = match self.anchor {
                Anchor::Centre => "centre",
                Anchor::Bottom => "bottom",
            };
            steps.push(format!("{anchor} crop {size}"));
        }
        if steps.is_empty() {
            steps.push("full size, every true depth".to_owned());
        }
        f.write_str(&steps.join(", "))
    }
}

/// Returns a share in per cent, without the rounding errors of f32.
pub(super) fn per_cent(share: f32) -> f64 {
    (f64::from(share) * 1e4).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::ProtocolPreset;
    use image::RgbImage;

    fn frame(width: usize, height: usize, values: Vec<f32>) -> Frame {
        let rgb = RgbImage::new(width as u32, height as u32);
        Frame::new(
            "f".into(),
            rgb,
            DepthMap::new(width, height, values).unwrap(),
        )
        .unwrap()
    }

    #[test]
    fn what_does_not_count_is_left_out() {
        let frame = frame(4, 1, vec![0.05, 1.0, 1.04, 2.0])
            .with_mask(4, 1, vec![true, true, true, true])
            .unwrap();
        let range = Protocol {
            range: Some([0.1, 1.5]),
            ..Protocol::default()
        };
        assert_eq!(
            range.apply(&frame).unwrap().depth.values(),
            [0.0, 1.0, 1.04, 0.0]
        );
        let jumps = Protocol {
            jumps: Some(Jumps {
                indoor: 0.05,
                outdoor: 0.5,
            }),
            range: Some([0.1, 3.0]),
            ..Protocol::default()
        };
        assert_eq!(
            jumps.apply(&frame).unwrap().depth.values(),
            [0.0, 1.0, 0.0, 0.0]
        );
        let masked = Frame {
            mask: Some(vec![true, false, true, false]),
            ..frame.clone()
        };
        let mask = Protocol {
            mask: true,
            ..Protocol::default()
        };
        assert_eq!(
            mask.apply(&masked).unwrap().depth.values(),
            [0.05, 0.0, 1.04, 0.0]
        );
        assert_eq!(mask.apply(&frame).unwrap().depth, frame.depth);
    }

    #[test]
    fn rings_stay_with_their_returns() {
        let returns = vec![9.0, 0.0, 2.0, 0.0, 0.0, 5.0, 0.0, 4.0];
        let scan = frame(4, 2, returns.clone())
            .with_sparse(DepthMap::new(4, 2, returns).unwrap())
            .unwrap()
            .with_rings(vec![7, -1, 3, -1, -1, 5, -1, 4])
            .unwrap();
        let half = Protocol {
            resize: Some(Size {
                height: 1,
                width: 2,
            }),
            ..Protocol::default()
        };
        // Of 9 and 5 m the nearer return is kept, as of 2 and 4 m.
        let small = half.apply(&scan).unwrap();
        assert_eq!(small.depth.values(), [5.0, 2.0]);
        assert_eq!(small.sparse.unwrap().values(), [5.0, 2.0]);
        assert_eq!(small.rings.unwrap(), [5, 3]);
        let crop = Protocol {
            crop: Some(Size {
                height: 1,
                width: 2,
            }),
            anchor: Anchor::Bottom,
            ..Protocol::default()
        };
        let part = crop.apply(&scan).unwrap();
        assert_eq!(part.depth.values(), [5.0, 0.0]);
        assert_eq!(part.rings.unwrap(), [5, -1]);
        let nowhere = frame(4, 2, vec![1.0; 8]).with_rings(vec![0; 8]);
        assert!(nowhere.is_err());
    }

    #[test]
    fn a_number_of_pixels_keeps_the_shape_of_each_frame_or_takes_that_of_one() {
        let protocol = Protocol {
            pixels: Some(50),
            depth_resize: Interpolation::NearestMeasured,
            ..Protocol::default()
        };
        let (wide, square) = (frame(20, 10, vec![2.0; 200]), frame(9, 9, vec![2.0; 81]));
        let sizes = |protocol: &Protocol| {
            [&wide, &square].map(|frame| {
                let frame = protocol.apply(frame).unwrap();
                assert_eq!(frame.depth.count(), frame.depth.values().len());
                (frame.depth.width(), frame.depth.height())
            })
        };
        // sqrt(50 / 200) = 0.5, sqrt(50 / 81) = 0.786.
        assert_eq!(sizes(&protocol), [(10, 5), (7, 7)]);
        assert_eq!(sizes(&protocol.sized_as(&wide)), [(10, 5), (10, 5)]);
        assert_eq!(Protocol::nyu().sized_as(&wide), Protocol::nyu());
        let text = protocol.to_string();
        assert!(text.contains("about 50 pixels") && text.contains("nearest-measured"));
    }

    #[test]
    fn a_number_of_pixels_is_above_0_and_beside_no_other_size() {
        let of = |pixels| Protocol {
            pixels: Some(pixels),
            ..Protocol::default()
        };
        let size = Some(Size {
            height: 2,
            width: 3,
        });
        assert!(of(50).check().is_ok());
        assert!(
            Protocol {
                cut: size,
                ..of(50)
            }
            .check()
            .is_ok()
        );
        assert!(
            ProtocolPreset::all()
                .iter()
                .all(|preset| preset.protocol.check().is_ok())
        );
        let resized = Protocol {
            resize: size,
            ..of(50)
        };
        let cropped = Protocol {
            crop: size,
            ..of(50)
        };
        for (wrong, what) in [
            (of(0), "above 0"),
            (resized, "no effect"),
            (cropped, "no effect"),
        ] {
            let error = wrong.check().unwrap_err();
            assert!(error.to_string().contains(what), "{error}");
            assert!(error.advice().is_some());
        }
    }

    #[test]
    fn surfaces_that_a_camera_sees_side_by_side_are_kept() {
        let protocol = Protocol {
            occlusion: Some(Occlusion::default()),
            ..Protocol::default()
        };
        let count = |values: Vec<f32>| {
            let frame = frame(values.len(), 1, values);
            protocol.apply(&frame).unwrap().depth.count()
        };
        assert_eq!(count(vec![2.0, 2.0, 9.0]), 3);
        // Depths at fewer than half of the pixels count as returns: 9 m is seen past 2 m.
        assert_eq!(count(vec![2.0, 0.0, 9.0, 0.0, 0.0]), 1);
    }

    #[test]
    fn crops_keep_the_asked_part() {
        let frame = frame(5, 4, (1..=20).map(|v| v as f32).collect());
        let crop = |anchor| Protocol {
            crop: Some(Size {
                height: 2,
                width: 3,
            }),
            anchor,
            ..Protocol::default()
        };
        let centre = crop(Anchor::Centre).apply(&frame).unwrap();
        assert_eq!(centre.depth.values(), [7.0, 8.0, 9.0, 12.0, 13.0, 14.0]);
        let bottom = crop(Anchor::Bottom).apply(&frame).unwrap();
        assert_eq!(bottom.depth.values(), [12.0, 13.0, 14.0, 17.0, 18.0, 19.0]);
    }
}
