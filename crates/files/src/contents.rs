//! Recognises the contents of an arbitrary file.

use super::file_unit::FileUnit;
use super::files::{
    CLOUDS, ColumnMeaning, IMAGES, PointTable, PointVisitor, has_ending, image_kind, images_below,
    is_grey_tiff, read_cloud, read_upright,
};
use super::sparse::is_table;
use super::stored::{DEPTHS, DepthFile, StoredMap, read_depth_file};
use super::{Camera, Colmap, DepthMap, Orientation, Unit};
use crate::error::{Error, Result};
use crate::foreign::check_foreign;
use std::path::Path;

/// Contents of a file, by its extension and its first bytes.
#[derive(Clone, Debug)]
pub enum Contents {
    /// A colour image.
    Image {
        /// Width and height in pixels, as stored.
        size: (usize, usize),
        /// Bits and channels.
        kind: String,
        /// How it is rotated upright.
        orientation: Orientation,
        /// What should be checked, a sentence each.
        remarks: Vec<String>,
    },
    /// A depth map.
    Map(Box<StoredMap>),
    /// A table of points.
    List {
        /// u, v in pixels and depth in metres of the points with a positive and finite depth.
        points: Vec<[f64; 3]>,
        /// Number of other points.
        ignored: usize,
        /// Whether the points have standard deviations.
        deviations: bool,
        /// Assumed unit of the file.
        unit: Unit,
        /// Whether the columns are named u, v and depth; otherwise they may be x, y and z.
        named: bool,
    },
    /// A cloud.
    Cloud {
        /// Number of points with finite coordinates.
        count: usize,
        /// Number of other points.
        ignored: usize,
        /// Smallest x, y, z.
        low: [f64; 3],
        /// Largest x, y, z.
        high: [f64; 3],
    },
    /// A sparse model of COLMAP.
    Model(Colmap),
    /// A camera.
    Camera(Box<Camera>),
}

impl Contents {
    /// Reads a file or the folder of a model. Without a unit, integers are taken for millimetres and other numbers for
    /// metres.
    ///
    /// # Errors
    /// The file is missing, damaged, or of an unknown kind.
    pub fn read(path: &Path, unit: Option<Unit>) -> Result<Self> {
        let is = |ending: &str| has_ending(path, ending);
        if path.is_dir() {
            return Colmap::read(path)
                .map(Self::Model)
                .map_err(|e| of_images(path, e));
        }
        check_foreign(path)?;
        if CLOUDS.into_iter().any(is) {
            return read_bounds(&mut |visit| read_cloud(path, visit));
        }
        if CAMERAS.into_iter().any(is) {
            let camera = Camera::read(path).map_err(|e| of_report(path, e))?;
            return Ok(Self::Camera(Box::new(camera)));
        }
        let grey = (is("tif") || is("tiff")) && is_grey_tiff(path)?;
        if IMAGES.into_iter().any(is) && !grey {
            let (size, color) = image_kind(path)?;
            let channels = color.channel_count();
            if channels > 2 || !DEPTHS.into_iter().any(is) {
                let bits = color.bits_per_pixel() / u16::from(channels);
                let alpha = if color.has_alpha() {
                    ", the last for transparency"
                } else {
                    ""
                };
                let kind = format!("{bits} bits, {channels} channels{alpha}");
                let image = read_upright(path)?;
                return Ok(Self::Image {
                    size,
                    kind,
                    orientation: image.orientation,
                    remarks: image.warnings.iter().map(ToString::to_string).collect(),
                });
            }
        }
        if !DEPTHS.into_iter().any(is) {
            return Err(Error::format(path, "is of no kind that is known")
                .hint("images, depth maps, tables and clouds of points, cameras, weights and recordings are read"));
        }
        // Without an image to compare with, an array of three or four columns counts as a table.
        match read_depth_file(path, unit.into(), |array| is_table(array, &[]))? {
            DepthFile::Map(map) => Ok(Self::Map(Box::new(map))),
            DepthFile::Table(table, _) if table.columns == ColumnMeaning::Space => {
                read_bounds(&mut |visit| {
                    table.rows.iter().for_each(|row| visit(row.values));
                    Ok(())
                })
            }
            DepthFile::Table(table, known) => Ok(Self::of_table(&table, known)),
        }
    }

    fn of_table(table: &PointTable, known: FileUnit) -> Self {
        let metres = known.unit.metres();
        let points = table.rows.iter().map(|row| {
            let [u, v, depth] = row.values;
            [u, v, depth * metres]
        });
        let is_valid = |point: &[f64; 3]| point[2] > 0.0 && point.iter().all(|v| v.is_finite());
        let found: Vec<[f64; 3]> = points.filter(is_valid).collect();
        Self::List {
            ignored: table.rows.len() - found.len(),
            deviations: table.rows.iter().any(|row| row.fourth.is_some()),
            points: found,
            unit: known.unit,
            named: matches!(
                table.columns,
                ColumnMeaning::Pixels | ColumnMeaning::Outliers
            ),
        }
    }

    /// Returns the depths of a map or a list in metres, in no particular order.
    pub fn depths(&self) -> Vec<f32> {
        match self {
            Self::Map(map) => map.depth.points().map(|point| point.depth).collect(),
            Self::List { points, .. } => points.iter().map(|point| point[2] as f32).collect(),
            Self::Image { .. } | Self::Cloud { .. } | Self::Model(_) | Self::Camera(_) => {
                Vec::new()
            }
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

/// Error of a folder that is not a model, with a hint if it contains images.
fn of_images(folder: &Path, error: Error) -> Error {
    match images_below(folder) {
        Ok(images) if !images.is_empty() => error.hint(format!(
            "the folder holds {} images, which are inspected as files: lsdc inspect {}",
            images.len(),
            images[0].display()
        )),
        _ => error,
    }
}

/// Error of a file that is not a camera, with its kind if it is a report.
fn of_report(path: &Path, error: Error) -> Error {
    let text = std::fs::read(path).unwrap_or_default();
    let value: serde_json::Value = serde_json::from_slice(&text).unwrap_or_default();
    let has = |name: &str| value.get(name).is_some();
    if has_ending(path, "json")
        && !has("fx")
        && !has("K")
        && !has("camera_matrix")
        && value.is_object()
    {
        return error.hint(
            "cameras are JSON files with fx, fy, cx and cy; reports of `lsdc eval` are shown by `lsdc report`, those of \
             `lsdc complete` are plain JSON",
        );
    }
    error
}

/// File extensions of cameras.
const CAMERAS: [&str; 4] = ["toml", "json", "yaml", "yml"];

/// Returns the bounds of the points of a cloud, which `visit_all` visits.
fn read_bounds(visit_all: &mut dyn FnMut(&mut PointVisitor<'_>) -> Result<()>) -> Result<Contents> {
    let (mut count, mut ignored) = (0, 0);
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    visit_all(&mut |point| {
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
    Ok(Contents::Cloud {
        count,
        ignored,
        low,
        high,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ColoredPoint, write_depth_png, write_npy, write_ply, write_rgb};
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
        std::fs::write(at("cloud.csv"), "x,y,z\n1,2,3\n-1,5,nan\n0,7,1\n").unwrap();
        std::fs::write(at("camera.toml"), "fx = 5\nfy = 5\ncx = 2\ncy = 1\n").unwrap();
        let corners = [[1.0, 2.0, 3.0], [-1.0, 5.0, f64::NAN], [0.0, 7.0, 1.0]];
        let cloud = corners.map(|position| ColoredPoint {
            position,
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
        let Contents::Image {
            size: (4, 3), kind, ..
        } = read("image.png")
        else {
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
        for name in ["cloud.ply", "cloud.csv"] {
            let Contents::Cloud {
                count: 2,
                ignored: 1,
                low,
                high,
            } = read(name)
            else {
                panic!("{name} is no cloud");
            };
            assert_eq!((low, high), ([0.0, 2.0, 1.0], [1.0, 7.0, 3.0]));
        }
        assert!(matches!(read("camera.toml"), Contents::Camera(_)));
        assert!(Contents::read(&at("nothing.doc"), None).is_err());
    }
}
