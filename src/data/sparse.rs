//! Sparse depths as users have them: maps as large as the image, or lists of points.

use super::files::{
    Array, CLOUDS, Listed, has_ending, read_array, read_cloud, read_depth_png, read_exr, read_list,
    read_npz, read_pfm, read_tiff, stored_unit,
};
use super::occlusion::remove_hidden;
use super::{Camera, DepthMap, Unit, View};
use crate::error::{Error, Result};
use std::path::Path;

/// Sparse depths in metres, and how they were read.
#[derive(Clone, Debug)]
pub struct Sparse {
    /// As large as the image they were read for, but for a map of another size.
    pub depth: DepthMap,
    /// The standard deviation of each depth in metres, if the file has them.
    pub sigma: Option<DepthMap>,
    /// The unit of the file.
    pub unit: Unit,
    /// Whether nobody said so.
    pub guessed: bool,
    /// Points without a positive and finite depth.
    pub ignored: usize,
    /// Points of a list or cloud that lie outside the image.
    pub outside: usize,
    /// Points of a list or cloud behind another one in the same pixel, and those of a cloud that
    /// nearer ones surround.
    pub hidden: usize,
}

impl Sparse {
    /// Reads sparse depths for an image of `size` (width, height), by the file's ending. Maps: `png`
    /// of 16 bits, `npy`, `npz`, `tiff`, `exr`, `pfm`. Lists of `u, v, depth[, sigma]`, u and v in
    /// pixels from the centre of the first: `csv`, `txt`, and arrays `[points, 3 or 4]`. Of several
    /// points in a pixel the nearest counts. Clouds, `ply`, `pcd`, `las` and `laz`, are looked at by
    /// the camera. Without a unit integers are taken for millimetres, other numbers and clouds for
    /// metres.
    ///
    /// # Errors
    /// A file that is missing, damaged, or of another kind; a list without a point in the image; a
    /// cloud without a camera.
    pub fn read(
        path: &Path,
        unit: Option<Unit>,
        camera: Option<&Camera>,
        size: (usize, usize),
    ) -> Result<Self> {
        let unit = unit.or_else(|| stored_unit(path));
        let known = |integers: bool| {
            unit.unwrap_or(if integers {
                Unit::MILLIMETRE
            } else {
                Unit::METRE
            })
        };
        let is = |ending: &str| has_ending(path, ending);
        let found = if is("png") {
            let unit = known(true);
            Self::of_map(read_depth_png(path, unit.metres())?, unit)
        } else if is("tif") || is("tiff") {
            let (depth, integers) = read_tiff(path, |integers| known(integers).metres())?;
            Self::of_map(depth, known(integers))
        } else if is("exr") {
            let unit = known(false);
            let (depth, sigma) = read_exr(path, unit.metres())?;
            Self {
                sigma,
                ..Self::of_map(depth, unit)
            }
        } else if is("pfm") {
            let unit = known(false);
            Self::of_map(read_pfm(path, unit.metres())?, unit)
        } else if is("csv") || is("txt") {
            Self::of_list(path, &read_list(path)?, known(false), size)?
        } else if is("npy") {
            let array = read_array(path)?;
            Self::of_array(path, &array, known(array.integers), size)?
        } else if is("npz") {
            let (array, sigma) = read_npz(path)?;
            let unit = known(array.integers);
            let found = Self::of_array(path, &array, unit, size)?;
            let sigma = sigma.map(|sigma| in_metres(&sigma, unit)).transpose()?;
            Self {
                sigma: sigma.or(found.sigma),
                ..found
            }
        } else if CLOUDS.into_iter().any(is) {
            let camera = camera.ok_or_else(|| {
                Error::format(path, "is a cloud, which only a camera sees")
                    .hint("give --camera FILE, or --camera FX,FY,CX,CY")
            })?;
            Self::of_cloud(path, &camera.resized(size), known(false), size)?
        } else {
            return Err(Error::format(path, "is no kind of depth file").hint(
                "sparse depths are read from npy, npz, 16-bit PNG, TIFF, EXR, PFM, csv, txt, PLY, \
                 PCD, LAS and LAZ",
            ));
        };
        Ok(Self {
            guessed: unit.is_none(),
            ..found
        })
    }

    /// The same depths on an image of another size but of the same shape: each at the pixel that
    /// shows it, as from a sensor of fewer pixels. What has another shape stays as it is.
    ///
    /// # Errors
    /// No depth is left.
    pub fn placed_on(self, (width, height): (usize, usize)) -> Result<Self> {
        let from = &self.depth;
        let factors = [
            width as f64 / from.width() as f64,
            height as f64 / from.height() as f64,
        ];
        // Sizes are rounded to whole pixels.
        let least = from.width().min(from.height()).min(width).min(height) as f64;
        let same_shape = (factors[0] / factors[1] - 1.0).abs() * least <= 1.0;
        if factors == [1.0, 1.0] || !same_shape || from.count() == 0 {
            return Ok(self);
        }
        let place = |pixel: usize, factor: f64| (pixel as f64 + 0.5) * factor - 0.5;
        let sigma = |x, y| self.sigma.as_ref().map(|sigma| f64::from(sigma.at(x, y)));
        let points = from.points().map(|point| Listed {
            u: place(point.x, factors[0]),
            v: place(point.y, factors[1]),
            depth: f64::from(point.depth),
            sigma: sigma(point.x, point.y),
        });
        let points: Vec<Listed> = points.collect();
        let placed = Self::of_list(Path::new("map"), &points, Unit::METRE, (width, height))?;
        Ok(Self {
            depth: placed.depth,
            sigma: placed.sigma,
            hidden: placed.hidden,
            ..self
        })
    }

    fn of_map(depth: DepthMap, unit: Unit) -> Self {
        Self {
            ignored: depth.ignored(),
            depth,
            sigma: None,
            unit,
            guessed: false,
            outside: 0,
            hidden: 0,
        }
    }

    fn of_array(path: &Path, array: &Array, unit: Unit, size: (usize, usize)) -> Result<Self> {
        if is_list(array, size) {
            Self::of_list(path, &listed(array), unit, size)
        } else {
            Ok(Self::of_map(in_metres(array, unit)?, unit))
        }
    }

    /// What a view of a model sees, for its image at `size` (width, height); the unit of the model
    /// takes the place of metres.
    ///
    /// # Errors
    /// No point in the image.
    pub fn of_view(view: &View, size: (usize, usize)) -> Result<Self> {
        let moved = |place: f64, from: usize, to: usize| {
            (place + 0.5) * (to as f64 / from.max(1) as f64) - 0.5
        };
        let points = view.listed().iter().map(|point| Listed {
            u: moved(point.u, view.size.0, size.0),
            v: moved(point.v, view.size.1, size.1),
            ..*point
        });
        let points: Vec<Listed> = points.collect();
        let found = Self::of_list(Path::new(&view.name), &points, Unit::METRE, size)?;
        Ok(Self {
            ignored: found.ignored + view.ignored,
            ..found
        })
    }

    fn of_cloud(path: &Path, camera: &Camera, unit: Unit, size: (usize, usize)) -> Result<Self> {
        let mut screen = Screen::new(size);
        let mut all = 0_usize;
        read_cloud(path, &mut |point| {
            all += 1;
            if point.iter().any(|v| !v.is_finite()) {
                screen.ignored += 1;
                return;
            }
            match camera.project(point.map(|v| v * unit.metres())) {
                Some((place, depth)) => screen.add(place, depth as f32, None),
                None => screen.outside += 1,
            }
        })?;
        screen.hidden += remove_hidden(size.0, &mut screen.depths);
        let found = screen.sparse(unit)?;
        if found.depth.count() == 0 {
            let (width, height) = size;
            let what = format!("none of its {all} points lies in the image of {width}x{height}");
            return Err(Error::format(path, what).hint(
                "check the camera: its pose leads from the cloud's axes to x right, y down, z \
                 forwards, in metres",
            ));
        }
        Ok(found)
    }

    fn of_list(path: &Path, points: &[Listed], unit: Unit, size: (usize, usize)) -> Result<Self> {
        let mut screen = Screen::new(size);
        let metres = |value: f64| (value * unit.metres()) as f32;
        for point in points {
            let sigma = point.sigma.map(metres);
            screen.add([point.u, point.v], metres(point.depth), sigma);
        }
        let found = screen.sparse(unit)?;
        if found.depth.count() == 0 {
            let (all, (width, height)) = (points.len(), size);
            let what = format!(
                "none of its {all} points lies in the image of {width}x{height} with a positive \
                 depth"
            );
            return Err(Error::format(path, what)
                .hint("columns are u, v, depth: u to the right, v down, in pixels"));
        }
        Ok(found)
    }
}

/// The nearest point in each pixel, and how many others there were.
struct Screen {
    size: (usize, usize),
    depths: Vec<f32>,
    /// Empty until a point has one.
    sigmas: Vec<f32>,
    ignored: usize,
    outside: usize,
    hidden: usize,
}

impl Screen {
    /// Of an image of `size` (width, height).
    fn new(size: (usize, usize)) -> Self {
        Self {
            size,
            depths: vec![0.0; size.0 * size.1],
            sigmas: Vec::new(),
            ignored: 0,
            outside: 0,
            hidden: 0,
        }
    }

    /// Takes in a point at `place` (u, v); depth and deviation in metres.
    fn add(&mut self, place: [f64; 2], depth: f32, sigma: Option<f32>) {
        if !(depth > 0.0 && depth.is_finite()) {
            self.ignored += 1;
            return;
        }
        let Some(pixel) = pixel(place, self.size) else {
            self.outside += 1;
            return;
        };
        if sigma.is_some() && self.sigmas.is_empty() {
            self.sigmas.resize(self.depths.len(), 0.0);
        }
        let here = &mut self.depths[pixel];
        if *here > 0.0 {
            self.hidden += 1;
        }
        if *here == 0.0 || depth < *here {
            *here = depth;
            if let Some(deviation) = self.sigmas.get_mut(pixel) {
                *deviation = sigma.unwrap_or(0.0);
            }
        }
    }

    fn sparse(self, unit: Unit) -> Result<Sparse> {
        let map = |values| DepthMap::new(self.size.0, self.size.1, values);
        let sigma = (!self.sigmas.is_empty()).then(|| map(self.sigmas));
        Ok(Sparse {
            depth: map(self.depths)?,
            sigma: sigma.transpose()?,
            unit,
            guessed: false,
            ignored: self.ignored,
            outside: self.outside,
            hidden: self.hidden,
        })
    }
}

/// The index of the pixel that holds a place, if the image does.
fn pixel([u, v]: [f64; 2], (width, height): (usize, usize)) -> Option<usize> {
    let within = |place: f64, length: usize| {
        let place = (place + 0.5).floor();
        (place >= 0.0 && place < length as f64).then_some(place as usize)
    };
    Some(within(v, height)? * width + within(u, width)?)
}

/// Whether an array is a list of points rather than a map: a map is as large as the image.
pub(super) fn is_list(array: &Array, (width, height): (usize, usize)) -> bool {
    matches!(array.columns, 3 | 4) && (array.columns, array.rows) != (width, height)
}

fn in_metres(array: &Array, unit: Unit) -> Result<DepthMap> {
    let metres = |value: &f32| (f64::from(*value) * unit.metres()) as f32;
    let values = array.values.iter().map(metres).collect();
    DepthMap::new(array.columns, array.rows, values)
}

pub(super) fn listed(array: &Array) -> Vec<Listed> {
    let rows = array.values.chunks_exact(array.columns);
    let point = |row: &[f32]| Listed {
        u: f64::from(row[0]),
        v: f64::from(row[1]),
        depth: f64::from(row[2]),
        sigma: row.get(3).map(|&sigma| f64::from(sigma)),
    };
    rows.map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{write_exr, write_npz, write_pfm, write_tiff};

    fn list(text: &str, unit: Option<Unit>) -> Result<Sparse> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.csv");
        std::fs::write(&path, text).unwrap();
        Sparse::read(&path, unit, None, (4, 3))
    }

    #[test]
    fn the_nearest_point_of_a_pixel_counts() {
        let text = "0,0,2\n3.4,2.49,1500\n3.3,2,900,\n-0.6,0,1\n0,2.5,1\n1,1,nan\n0.2,-0.5,7\n";
        let found = list(text, Some(Unit::MILLIMETRE)).unwrap();
        assert_eq!((found.outside, found.ignored, found.hidden), (2, 1, 2));
        assert_eq!(found.depth.count(), 2);
        assert!((found.depth.at(0, 0) - 0.002).abs() < 1e-9);
        assert!((found.depth.at(3, 2) - 0.9).abs() < 1e-6);
        assert!(!found.guessed && found.sigma.is_none());
    }

    #[test]
    fn deviations_come_with_their_points() {
        let found = list("u v depth sigma\n1 2 4.0 0.5\n1 2 3.0 0.25\n", None).unwrap();
        assert_eq!((found.guessed, found.unit), (true, Unit::METRE));
        assert_eq!(found.depth.at(1, 2), 3.0);
        assert_eq!(found.sigma.unwrap().at(1, 2), 0.25);
    }

    /// A map without two equal values.
    fn map(first: f32) -> DepthMap {
        let values = (0..12).map(|i| first + i as f32 * 0.123).collect();
        DepthMap::new(4, 3, values).unwrap()
    }

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let (depth, sigma) = (map(1.0), map(0.01));
        let at = |name: &str| folder.path().join(name);
        write_pfm(&at("a.pfm"), &depth).unwrap();
        write_tiff(&at("a.tiff"), &depth).unwrap();
        write_exr(&at("a.exr"), &depth, None).unwrap();
        write_exr(&at("b.EXR"), &depth, Some(&sigma)).unwrap();
        write_npz(&at("a.npz"), &[("anything", &depth)]).unwrap();
        write_npz(&at("b.npz"), &[("depth", &depth), ("sigma", &sigma)]).unwrap();
        for (name, with) in [
            ("a.pfm", None),
            ("a.tiff", None),
            ("a.exr", None),
            ("b.EXR", Some(&sigma)),
            ("a.npz", None),
            ("b.npz", Some(&sigma)),
        ] {
            let found = Sparse::read(&at(name), None, None, (4, 3)).unwrap();
            assert_eq!(
                (&found.depth, found.sigma.as_ref()),
                (&depth, with),
                "{name}"
            );
            assert_eq!((found.unit, found.guessed), (Unit::METRE, true));
            let found = Sparse::read(&at(name), Some(Unit::MILLIMETRE), None, (4, 3)).unwrap();
            assert!((found.depth.at(0, 0) - 0.001).abs() < 1e-9, "{name}");
            assert!(!found.guessed);
        }
    }

    #[test]
    fn a_smaller_map_of_the_same_shape_is_placed_on_the_image() {
        let points = Sparse::of_map(map(1.0), Unit::METRE);
        let placed = points.clone().placed_on((8, 6)).unwrap();
        assert_eq!((placed.depth.width(), placed.depth.height()), (8, 6));
        assert_eq!(placed.depth.count(), 12);
        // Pixel 1 of 4 covers 2 and 3 of 8; its centre lies between them and counts as the later.
        assert_eq!(placed.depth.at(3, 5), points.depth.at(1, 2));
        let other = points.clone().placed_on((9, 4)).unwrap();
        assert_eq!(other.depth, points.depth);
    }

    #[test]
    fn a_list_beside_the_image_is_refused() {
        let error = list("100,100,1\n0,0,-1\n", None).unwrap_err();
        assert!(
            error.to_string().contains("none of its 2 points"),
            "{error}"
        );
    }
}
