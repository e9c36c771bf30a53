//! Sparse depths as users have them: maps as large as the image, or lists of points.

use super::files::{
    Array, Listed, has_ending, read_array, read_depth_png, read_exr, read_list, read_npz, read_pfm,
    read_tiff,
};
use super::{DepthMap, Unit, View};
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
    /// Points of a list that lie outside the image.
    pub outside: usize,
    /// Points of a list behind another one in the same pixel.
    pub hidden: usize,
}

impl Sparse {
    /// Reads sparse depths for an image of `size` (width, height), by the file's ending. Maps: `png`
    /// of 16 bits, `npy`, `npz`, `tiff`, `exr`, `pfm`. Lists of `u, v, depth[, sigma]`, u and v in
    /// pixels from the centre of the first: `csv`, `txt`, and arrays `[points, 3 or 4]`. Of several
    /// points in a pixel the nearest counts. Without a unit integers are taken for millimetres,
    /// other numbers for metres.
    ///
    /// # Errors
    /// A file that is missing, damaged, or of another kind; a list without a point in the image.
    pub fn read(path: &Path, unit: Option<Unit>, size: (usize, usize)) -> Result<Self> {
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
        } else {
            return Err(Error::format(path, "is no kind of depth file").hint(
                "sparse depths are read from npy, npz, 16-bit PNG, TIFF, EXR, PFM, csv and txt",
            ));
        };
        Ok(Self {
            guessed: unit.is_none(),
            ..found
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

    fn of_list(
        path: &Path,
        points: &[Listed],
        unit: Unit,
        (width, height): (usize, usize),
    ) -> Result<Self> {
        let mut depths = vec![0.0_f32; width * height];
        let mut sigmas = points
            .iter()
            .any(|p| p.sigma.is_some())
            .then(|| vec![0.0; width * height]);
        let (mut ignored, mut outside, mut hidden) = (0, 0, 0);
        for point in points {
            let depth = (point.depth * unit.metres()) as f32;
            if !(depth > 0.0 && depth.is_finite()) {
                ignored += 1;
                continue;
            }
            let pixel = [(point.u, width), (point.v, height)].map(|(place, length)| {
                let place = (place + 0.5).floor();
                (place >= 0.0 && place < length as f64).then_some(place as usize)
            });
            let [Some(x), Some(y)] = pixel else {
                outside += 1;
                continue;
            };
            let here = &mut depths[y * width + x];
            if *here > 0.0 {
                hidden += 1;
            }
            if *here == 0.0 || depth < *here {
                *here = depth;
                if let (Some(sigmas), Some(sigma)) = (&mut sigmas, point.sigma) {
                    sigmas[y * width + x] = (sigma * unit.metres()) as f32;
                }
            }
        }
        let depth = DepthMap::new(width, height, depths)?;
        if depth.count() == 0 {
            return Err(Error::format(
                path,
                format!(
                    "none of its {} points lies in the image of {width}x{height} with a positive \
                     depth",
                    points.len()
                ),
            )
            .hint("columns are u, v, depth: u to the right, v down, in pixels"));
        }
        Ok(Self {
            depth,
            sigma: sigmas
                .map(|values| DepthMap::new(width, height, values))
                .transpose()?,
            unit,
            guessed: false,
            ignored,
            outside,
            hidden,
        })
    }
}

/// Whether an array is a list of points rather than a map: a map is as large as the image.
fn is_list(array: &Array, (width, height): (usize, usize)) -> bool {
    matches!(array.columns, 3 | 4) && (array.columns, array.rows) != (width, height)
}

fn in_metres(array: &Array, unit: Unit) -> Result<DepthMap> {
    let metres = |value: &f32| (f64::from(*value) * unit.metres()) as f32;
    let values = array.values.iter().map(metres).collect();
    DepthMap::new(array.columns, array.rows, values)
}

fn listed(array: &Array) -> Vec<Listed> {
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
        Sparse::read(&path, unit, (4, 3))
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
            let found = Sparse::read(&at(name), None, (4, 3)).unwrap();
            assert_eq!(
                (&found.depth, found.sigma.as_ref()),
                (&depth, with),
                "{name}"
            );
            assert_eq!((found.unit, found.guessed), (Unit::METRE, true));
            let found = Sparse::read(&at(name), Some(Unit::MILLIMETRE), (4, 3)).unwrap();
            assert!((found.depth.at(0, 0) - 0.001).abs() < 1e-9, "{name}");
            assert!(!found.guessed);
        }
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
