//! What is in a file that nobody has described.

use super::files::{
    CLOUDS, IMAGES, Listed, has_ending, image_kind, read_array, read_cloud, read_list, read_npz,
};
use super::sparse::{is_list, listed};
use super::{Colmap, DepthMap, Sparse, Unit};
use crate::error::{Error, Result};
use std::path::Path;

/// What a file holds, by its ending and its first bytes.
#[derive(Clone, Debug)]
pub enum Contents {
    /// A colour image.
    Image {
        /// Width and height in pixels, as stored.
        size: (usize, usize),
        /// Bits and channels.
        kind: String,
    },
    /// Depths by pixel.
    Map(Box<Sparse>),
    /// A list of points.
    List {
        /// u, v in pixels and depth in metres of the points with a positive and finite depth.
        points: Vec<[f64; 3]>,
        /// The others.
        ignored: usize,
        /// Whether they have standard deviations.
        deviations: bool,
        /// What the file is taken to be in.
        unit: Unit,
    },
    /// A cloud.
    Cloud {
        /// Points with finite coordinates.
        count: usize,
        /// The others.
        ignored: usize,
        /// Least x, y, z.
        low: [f64; 3],
        /// Greatest x, y, z.
        high: [f64; 3],
    },
    /// A sparse model of COLMAP.
    Model(Colmap),
}

impl Contents {
    /// Reads a file or the folder of a model. Without a unit integers are taken for millimetres,
    /// other numbers for metres.
    ///
    /// # Errors
    /// A file that is missing, damaged, or of no kind that is known.
    pub fn read(path: &Path, unit: Option<Unit>) -> Result<Self> {
        let is = |ending: &str| has_ending(path, ending);
        let known = |integers: bool| {
            unit.unwrap_or(if integers {
                Unit::MILLIMETRE
            } else {
                Unit::METRE
            })
        };
        if path.is_dir() {
            return Colmap::read(path).map(Self::Model);
        }
        if CLOUDS.into_iter().any(is) {
            return Self::of_cloud(path);
        }
        if is("csv") || is("txt") {
            return Ok(Self::of_list(&read_list(path)?, known(false)));
        }
        if is("npy") || is("npz") {
            let array = if is("npy") {
                read_array(path)?
            } else {
                read_npz(path)?.0
            };
            // As no image tells otherwise, three or four columns are a list.
            if is_list(&array, (0, 0)) {
                return Ok(Self::of_list(&listed(&array), known(array.integers)));
            }
        } else if IMAGES.into_iter().any(is) {
            let (size, color) = image_kind(path)?;
            let channels = color.channel_count();
            if channels > 2 {
                let bits = color.bits_per_pixel() / u16::from(channels);
                let alpha = if color.has_alpha() {
                    ", the last for transparency"
                } else {
                    ""
                };
                let kind = format!("{bits} bits, {channels} channels{alpha}");
                return Ok(Self::Image { size, kind });
            }
        } else if !["exr", "pfm"].into_iter().any(is) {
            return Err(Error::format(path, "is of no kind that is known"));
        }
        Sparse::read(path, unit, None, (0, 0)).map(|points| Self::Map(Box::new(points)))
    }

    fn of_list(points: &[Listed], unit: Unit) -> Self {
        let metres = |point: &Listed| [point.u, point.v, point.depth * unit.metres()];
        let good = |point: &[f64; 3]| point[2] > 0.0 && point.iter().all(|v| v.is_finite());
        let found: Vec<[f64; 3]> = points.iter().map(metres).filter(good).collect();
        Self::List {
            ignored: points.len() - found.len(),
            deviations: points.iter().any(|point| point.sigma.is_some()),
            points: found,
            unit,
        }
    }

    fn of_cloud(path: &Path) -> Result<Self> {
        let (mut count, mut ignored) = (0, 0);
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        read_cloud(path, &mut |point| {
            if point.iter().any(|v| !v.is_finite()) {
                ignored += 1;
                return;
            }
            count += 1;
            for axis in 0..3 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        })?;
        Ok(Self::Cloud {
            count,
            ignored,
            low,
            high,
        })
    }

    /// The depths in it, in metres, in no order: those of a map or a list.
    pub fn depths(&self) -> Vec<f32> {
        match self {
            Self::Map(map) => map.depth.points().map(|point| point.depth).collect(),
            Self::List { points, .. } => points.iter().map(|point| point[2] as f32).collect(),
            Self::Image { .. } | Self::Cloud { .. } | Self::Model(_) => Vec::new(),
        }
    }

    /// The map, if it is one.
    pub fn map(&self) -> Option<&DepthMap> {
        match self {
            Self::Map(map) => Some(&map.depth),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Colored, write_depth_png, write_npy, write_ply, write_rgb};
    use image::RgbImage;

    #[test]
    fn files_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let map = DepthMap::new(5, 2, (0..10).map(|i| i as f32).collect()).unwrap();
        write_npy(&at("map.npy"), &map).unwrap();
        write_depth_png(&at("map.png"), &map, 0.001).unwrap();
        write_rgb(&at("image.png"), &RgbImage::new(4, 3)).unwrap();
        std::fs::write(at("list.csv"), "u,v,depth\n1,2,0.5\n3,4,-1\n").unwrap();
        let corners = [[1.0, 2.0, 3.0], [-1.0, 5.0, f64::NAN], [0.0, 7.0, 1.0]];
        let cloud = corners.map(|place| Colored {
            place,
            color: [0; 3],
            sigma: None,
        });
        write_ply(&at("cloud.ply"), &cloud).unwrap();

        let read = |name: &str| Contents::read(&at(name), None).unwrap();
        for name in ["map.npy", "map.png"] {
            let found = read(name);
            assert_eq!(found.map(), Some(&map), "{name}");
            assert_eq!(found.depths().len(), 9);
        }
        let Contents::Image { size: (4, 3), kind } = read("image.png") else {
            panic!("no image");
        };
        assert!(kind.starts_with("8 bits, 3 channels"), "{kind}");
        let Contents::List {
            points, ignored: 1, ..
        } = read("list.csv")
        else {
            panic!("no list");
        };
        assert_eq!(points, [[1.0, 2.0, 0.5]]);
        let Contents::Cloud {
            count: 2,
            ignored: 1,
            low,
            high,
        } = read("cloud.ply")
        else {
            panic!("no cloud");
        };
        assert_eq!((low, high), ([0.0, 2.0, 1.0], [1.0, 7.0, 3.0]));
        assert!(Contents::read(&at("nothing.doc"), None).is_err());
    }
}
