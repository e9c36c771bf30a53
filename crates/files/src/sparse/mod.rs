//! Sparse depths in an image, from maps, tables of points, clouds and models of COLMAP.

mod depths;
mod points;

pub use depths::Sparse;

use super::columns::meaning;
use super::depth_kind::along_axis;
use super::file_unit::FileUnit;
use super::files::{CLOUDS, ColumnMeaning, PointTable, has_ending, read_cloud};
use super::grid::{is_plausible, pixel, rescaled, same_shape};
use super::stored::{DepthFile, StoredMap, endings, read_depth_file};
use super::{Camera, DepthKind, DepthReadOptions, Orientation, Unit, View};
use crate::checks::{NumberFormat, NumberType, leave_out_marks};
use crate::error::{Error, Result};
use crate::raster::Raster;
use points::SparseBuilder;
use std::path::Path;

impl Sparse {
    /// Returns the supported file extensions, in lower case.
    pub fn endings() -> impl Iterator<Item = &'static str> {
        endings()
    }

    /// Reads sparse depths for an image, by the file's extension.
    ///
    /// - Maps of the image's shape, at any resolution: `png`, `pgm`, `npy`, `npz`, `tiff`, `exr`, `pfm`, `h5`.
    /// - Tables, `csv`, `txt` and arrays `[points, 3 or 4]`: of `u, v, depth[, sigma]`, u and v in pixels from the centre of
    ///   the first, or of x, y, z. Names in the first line decide which. `npz` may have lists `u`, `v`, `depth` and `sigma`. Without names the columns are x, y, z if there is a
    ///   camera and most points cannot be pixels, or pixels if the points are spread over the image. Ambiguous tables are
    ///   rejected.
    /// - Clouds, which need the camera of the upright image: `ply`, `pcd`, `las`, `laz`, `xyz`, `bin`.
    ///
    /// Without a unit, integers are taken for millimetres; other numbers and clouds for metres.
    ///
    /// # Errors
    /// The file is missing, damaged, ambiguous or of another kind or shape; a table has no point in the image; or a cloud
    /// has no camera.
    pub fn read(
        path: &Path,
        unit: Option<Unit>,
        camera: Option<&Camera>,
        image: impl Into<Orientation>,
    ) -> Result<Self> {
        Self::read_as(path, unit.into(), camera, image)
    }

    /// [`Self::read`] with the definition of the depths. Distances along the ray need the camera, which converts maps and
    /// tables of pixels to depths along the axis; clouds have coordinates in any case.
    ///
    /// # Errors
    /// As [`Self::read`], and if distances along the ray have no camera.
    pub fn read_as(
        path: &Path,
        options: DepthReadOptions,
        camera: Option<&Camera>,
        image: impl Into<Orientation>,
    ) -> Result<Self> {
        let image = image.into();
        let size = image.upright();
        check(size)?;
        let camera = camera.map(|camera| camera.resized(size)).transpose()?;
        let camera = camera.as_ref();
        if CLOUDS.into_iter().any(|ending| has_ending(path, ending)) {
            let known = FileUnit::new(options.unit, NumberType::Floats);
            let mut points = SparseBuilder::new(size);
            let camera = require_camera(path, camera)?;
            let metres = known.unit.metres();
            read_cloud(path, &mut |point| {
                points.project(camera, point, metres, None);
            })?;
            return cloud(path, points, known);
        }
        let sizes = [size, image.stored()];
        match read_depth_file(path, options, |array| is_table(array, &sizes))? {
            DepthFile::Map(map) => Self::of_map(path, map, &image)?.of_kind(options.kind, camera),
            DepthFile::Table(table, known) => {
                let columns = meaning(path, &table, camera, size, known.unit.metres())?;
                if columns == ColumnMeaning::Space {
                    Self::of_space(path, &table, require_camera(path, camera)?, known, size)
                } else {
                    Self::of_pixels(path, &table, known, &image)?.of_kind(options.kind, camera)
                }
            }
        }
    }

    /// Returns the points that a view of a model sees in its image. Depths stay in the unit of the model if none is given.
    ///
    /// # Errors
    /// The image has another shape than that of the model, or no point is in it.
    pub fn of_view(view: &View, image: impl Into<Orientation>, unit: Option<Unit>) -> Result<Self> {
        let image = image.into();
        check(image.upright())?;
        // COLMAP refers to the pixels as stored.
        let as_stored = same_shape(view.size, image.stored());
        if !as_stored && !same_shape(view.size, image.upright()) {
            let ((a, b), (c, d)) = (view.size, image.stored());
            let what = format!(
                "`{}` is {a}x{b} in the model, but the image is {c}x{d}",
                view.name
            );
            return Err(Error::shape(what)
                .hint("give the images that the model was made of, neither cut nor undistorted"));
        }
        let unit = unit.unwrap_or(Unit::MODEL);
        let mut points = SparseBuilder::new(image.upright()).of_camera();
        for (number, point) in view.keypoints().iter().enumerate() {
            let position = in_image([point.u, point.v], view.size, &image, !as_stored);
            let depth = point.depth * unit.metres();
            let sigma = point.sigma.map(|sigma| sigma * unit.metres());
            points.add_identified(position, depth, sigma, (number, point.id));
        }
        points.ignored += view.ignored;
        if points.found.is_empty() {
            return Err(points.no_points(Path::new(&view.name), "keypoints"));
        }
        let mut found = points.build(unit, false, "keypoint");
        found.remarks.extend(view.remarks.iter().cloned());
        Ok(found)
    }

    /// Projects a cloud in metres to an image of this width and height. `name` is used in messages.
    ///
    /// # Errors
    /// The camera is of images of another shape, or no point is in the image.
    pub fn of_cloud(
        name: &Path,
        cloud: impl IntoIterator<Item = [f64; 3]>,
        camera: &Camera,
        size: (usize, usize),
    ) -> Result<Self> {
        check(size)?;
        let camera = camera.resized(size)?;
        let mut points = SparseBuilder::new(size);
        for point in cloud {
            points.project(&camera, point, 1.0, None);
        }
        let metres = Some(Unit::METRE);
        self::cloud(name, points, FileUnit::new(metres, NumberType::Floats))
    }

    /// Returns the depths of a map with the shape of the image. `name` is used in messages.
    ///
    /// # Errors
    /// The map has another shape.
    pub fn of_depths(name: &Path, map: StoredMap, size: (usize, usize)) -> Result<Self> {
        check(size)?;
        Self::of_map(name, map, &size.into())
    }

    /// Adds standard deviations from a map with the shape of the image, in the unit of the depths.
    ///
    /// # Errors
    /// The file is missing, damaged, or not a map of this shape.
    pub fn with_sigma(self, path: &Path, image: impl Into<Orientation>) -> Result<Self> {
        let image = image.into();
        let DepthFile::Map(map) = read_depth_file(path, Some(self.unit).into(), |_| false)? else {
            return Err(Error::format(path, "is a table").hint("standard deviations are a map"));
        };
        let map = map.depth;
        let own = (map.width(), map.height());
        let upright = same_shape(own, image.upright());
        if !upright && !same_shape(own, image.stored()) {
            return Err(other_shape(path, own, &image));
        }
        let shown_size = if upright {
            image.upright()
        } else {
            image.stored()
        };
        let mut points = SparseBuilder::with_capacity(self.size, self.points.len()).of_camera();
        for (number, point) in self.points.iter().enumerate() {
            let mut position = [point.u, point.v];
            if !upright {
                position = image.turned_back(position);
            }
            let position = [
                rescaled(position[0], shown_size.0, own.0),
                rescaled(position[1], shown_size.1, own.1),
            ];
            let sigma = pixel(position, own).map_or(0.0, |i| map.values()[i]);
            let depth = f64::from(point.depth);
            points.add([point.u, point.v], depth, Some(f64::from(sigma)), number);
        }
        let found = points.build(self.unit, self.guessed, "point");
        Ok(Self {
            ignored: self.ignored + found.ignored,
            outside: self.outside,
            hidden: self.hidden + found.hidden,
            remarks: [self.remarks, found.remarks].concat(),
            ..found
        })
    }

    fn of_map(path: &Path, map: StoredMap, image: &Orientation) -> Result<Self> {
        let (depth, size) = (&map.depth, image.upright());
        let own = (depth.width(), depth.height());
        let upright = same_shape(own, size);
        let as_stored = same_shape(own, image.stored());
        if !upright && !as_stored {
            return Err(other_shape(path, own, image));
        }
        let mut points = SparseBuilder::with_capacity(size, depth.count());
        points.ignored = depth.ignored();
        for point in depth.points() {
            let position = in_image([point.x as f64, point.y as f64], own, image, upright);
            let sigma = map
                .sigma
                .as_ref()
                .map(|map| f64::from(map.at(point.x, point.y)));
            let number = point.y * own.0 + point.x;
            points.add(position, f64::from(point.depth), sigma, number);
        }
        let mut found = points.build(map.unit, map.guessed, "pixel");
        found.remarks.extend(map.remarks);
        if !image.is_upright() {
            found.remarks.push(if upright {
                upright_as_shown("the map is", image)
            } else {
                format!(
                    "the map is turned upright with the image (EXIF orientation {})",
                    image.exif()
                )
            });
        }
        Ok(found)
    }

    fn of_pixels(
        path: &Path,
        table: &PointTable,
        known: FileUnit,
        image: &Orientation,
    ) -> Result<Self> {
        let metres = known.unit.metres();
        let mut points = SparseBuilder::with_capacity(image.upright(), table.rows.len());
        let mut depths: Vec<f32> = table.rows.iter().map(|row| row.values[2] as f32).collect();
        let marks = NumberFormat {
            numbers: NumberType::Floats,
            metres,
            declared: None,
        };
        let marks = leave_out_marks(&mut depths, &marks);
        for (row, checked) in table.rows.iter().zip(&depths) {
            let [u, v, depth] = row.values;
            let depth = if checked.is_nan() { f64::NAN } else { depth };
            let sigma = row.fourth.map(|sigma| sigma * metres);
            points.add([u, v], depth * metres, sigma, row.number);
        }
        if points.found.is_empty() {
            let error = points.no_points(path, "points");
            return Err(error.hint("columns are u, v, depth: u to the right, v down, in pixels"));
        }
        let mut found = points.build(known.unit, known.is_guessed(), table.row);
        found.remarks.extend(marks.iter().map(ToString::to_string));
        found.check_unit(known);
        found.remarks.extend(found.doubtful_places());
        if !image.is_upright() {
            found.remarks.push(upright_as_shown("u and v are", image));
        }
        Ok(found)
    }

    /// Converts distances along the ray to depths along the axis, if `kind` is [`DepthKind::Ray`].
    fn of_kind(self, kind: Option<DepthKind>, camera: Option<&Camera>) -> Result<Self> {
        if kind != Some(DepthKind::Ray) {
            return Ok(self);
        }
        let camera = camera.ok_or_else(|| {
            Error::config("distances along the ray need a camera to become depths")
                .hint("give --camera FILE, or --camera FX,FY,CX,CY")
        })?;
        let before = self.points.len();
        let points = self.points.iter();
        let points = points
            .filter_map(|point| along_axis(*point, camera))
            .collect();
        let mut found = Self { points, ..self };
        let unseen = before - found.points.len();
        if unseen > 0 {
            found.outside += unseen;
            found.remarks.push(format!(
                "{unseen} points are left out, as the lens sees no ray there"
            ));
        }
        Ok(found)
    }

    /// Returns a warning if many points given in pixels are outside the image, or in the same pixels.
    fn doubtful_places(&self) -> Option<String> {
        let all = self.points.len() + self.outside + self.hidden;
        let (count, what) = if self.outside * 10 > all {
            (self.outside, "are outside the image")
        } else if self.hidden * 2 > all {
            (self.hidden, "share their pixels with nearer ones")
        } else {
            return None;
        };
        Some(format!(
            "{count} of {all} points {what}: check that the columns are u to the right and v down, in pixels \
             of this image"
        ))
    }

    fn of_space(
        path: &Path,
        table: &PointTable,
        camera: &Camera,
        known: FileUnit,
        size: (usize, usize),
    ) -> Result<Self> {
        // In a cloud without names, a fourth column is an intensity or a colour.
        let with_sigma = table.columns == ColumnMeaning::Space;
        let metres = known.unit.metres();
        let mut points = SparseBuilder::new(size);
        for row in &table.rows {
            let sigma = row
                .fourth
                .filter(|_| with_sigma)
                .map(|sigma| sigma * metres);
            points.project(camera, row.values, metres, sigma);
        }
        let mut found = cloud(path, points, known)?;
        if !with_sigma {
            let what = "the columns without names are taken for x, y, z, as they cannot be pixels";
            found.remarks.push(what.to_owned());
        }
        Ok(found)
    }

    /// Adds a warning if a unit leads to implausible depths; the unit is then a guess.
    fn check_unit(&mut self, known: FileUnit) {
        let warning = known.warning(self.points.iter().map(|point| point.depth).collect());
        self.guessed |= warning.is_some();
        self.remarks.extend(warning);
    }
}

/// Converts a position on a grid of another size, upright or as stored, to the upright image.
fn in_image(
    [u, v]: [f64; 2],
    grid: (usize, usize),
    image: &Orientation,
    upright: bool,
) -> [f64; 2] {
    let shown_size = if upright {
        image.upright()
    } else {
        image.stored()
    };
    let position = [
        rescaled(u, grid.0, shown_size.0),
        rescaled(v, grid.1, shown_size.1),
    ];
    if upright {
        position
    } else {
        image.turned(position)
    }
}

/// Returns the points of a cloud that the camera sees.
fn cloud(path: &Path, points: SparseBuilder, known: FileUnit) -> Result<Sparse> {
    if points.found.is_empty() {
        return Err(points.no_points(path, "points").hint(
            "check the camera: its pose leads from the cloud's axes to x right, y down, z forwards, in \
             metres",
        ));
    }
    let mut found = points.build(known.unit, known.is_guessed(), "point");
    found.check_unit(known);
    Ok(found)
}

/// Returns the camera, which a cloud needs.
fn require_camera<'a>(path: &Path, camera: Option<&'a Camera>) -> Result<&'a Camera> {
    camera.ok_or_else(|| {
        Error::format(path, "is a point cloud; pass --camera to project it").hint(
            "give --camera FILE, or --camera FX,FY,CX,CY; columns of pixels are called u, v, depth",
        )
    })
}

fn check(size: (usize, usize)) -> Result<()> {
    if is_plausible(size) {
        return Ok(());
    }
    let (width, height) = size;
    Err(Error::shape(format!(
        "an image of {width}x{height} is too large"
    )))
}

fn other_shape(path: &Path, own: (usize, usize), image: &Orientation) -> Error {
    let (width, height) = image.upright();
    Error::shape(format!(
        "`{}` is a map of {}x{} but the image is {width}x{height}",
        path.display(),
        own.0,
        own.1
    ))
    .hint(
        "a map shows what the image shows, with as many pixels or others, but of the same shape; a \
         table is an array of shape (points, 3 or 4)",
    )
}

fn upright_as_shown(what: &str, image: &Orientation) -> String {
    format!(
        "{what} taken to be of the upright image, which the file stores turned (EXIF orientation {})",
        image.exif()
    )
}

/// Whether an array is a table of points rather than a map, which would have one of the sizes of `images`.
pub(super) fn is_table(array: &Raster, images: &[(usize, usize)]) -> bool {
    matches!(array.columns, 3 | 4) && !images.contains(&(array.columns, array.rows))
}

#[cfg(test)]
mod tests;
