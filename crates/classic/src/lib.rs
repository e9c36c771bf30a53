//! Depth completion without training: common baselines, one method per file.
//!
//! ```
//! use image::RgbImage;
//! use lsdc_classic::Classic;
//! use lsdc_core::DepthMap;
//! use lsdc_core::Point;
//! # fn main() -> lsdc_classic::Result<()> {
//! let points = [(0, 1.0), (8, 3.0)].map(|(x, depth)| Point { x, y: 1, depth });
//! let sparse = DepthMap::from_points(9, 3, &points);
//! let dense = Classic::Nearest.complete(&RgbImage::new(9, 3), &sparse)?;
//! assert_eq!([dense.at(1, 0), dense.at(7, 2)], [1.0, 3.0]);
//! # Ok(())
//! # }
//! ```
//!
//! Maps are those of `lsdc-core`; `lsdc-eval` compares these methods with others.

mod colorisation;
mod distance;
mod equations;
mod error;
mod inverse_distance;
mod linear;
mod morphology;
mod neighbours;
mod smooth;
mod spline;
mod steering;

pub use distance::distances;
pub use error::{Error, Result};

use image::RgbImage;
use linear::Quantity;
use lsdc_core::DepthMap;

/// A method without training.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Classic {
    /// The nearest point.
    Nearest,
    /// Linear interpolation over the Delaunay triangulation, nearest outside its hull.
    Linear,
    /// Linear interpolation of inverse depth: exact on planes in front of a pinhole camera.
    LinearInverse,
    /// Weighted mean of the eight nearest points, by the inverse square of their distance (Shepard
    /// 1968).
    InverseDistance,
    /// Thin-plate spline (Duchon 1977).
    Spline,
    /// Weighted least squares: neighbours of similar colours have similar depths (Farbman et al. 2008).
    Smooth,
    /// Colorisation (Levin, Lischinski, Weiss 2004), used to fill the depths of NYU.
    Colorisation,
    /// Steering kernel regression (Takeda, Farsiu, Milanfar 2007).
    Steering,
    /// IP-Basic: morphology alone, made for laser scanners (Ku, Harakeh, Waslander 2018).
    Morphology,
}

impl Classic {
    /// All methods.
    pub const ALL: [Self; 9] = [
        Self::Nearest,
        Self::Linear,
        Self::LinearInverse,
        Self::InverseDistance,
        Self::Spline,
        Self::Smooth,
        Self::Colorisation,
        Self::Steering,
        Self::Morphology,
    ];

    /// The name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nearest => "nearest",
            Self::Linear => "linear",
            Self::LinearInverse => "linear-inverse",
            Self::InverseDistance => "idw",
            Self::Spline => "tps",
            Self::Smooth => "wls",
            Self::Colorisation => "levin",
            Self::Steering => "steering",
            Self::Morphology => "ip-basic",
        }
    }

    /// Fills every pixel of `sparse`. Some methods are guided by `rgb`, which must have the same size.
    ///
    /// # Errors
    /// No point, or a system of equations without a solution.
    pub fn complete(self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        if sparse.count() == 0 {
            return Err(Error::NoPoints);
        }
        match self {
            Self::Nearest => neighbours::nearest(sparse),
            Self::Linear => linear::linear(sparse, Quantity::Depth),
            Self::LinearInverse => linear::linear(sparse, Quantity::Inverse),
            Self::InverseDistance => inverse_distance::inverse_distance(sparse),
            Self::Spline => spline::spline(sparse),
            Self::Smooth => smooth::smooth(rgb, sparse),
            Self::Colorisation => colorisation::colorisation(rgb, sparse),
            Self::Steering => steering::steering(rgb, sparse),
            Self::Morphology => morphology::morphology(sparse),
        }
    }
}

/// Returns the luma of all pixels, from 0 to 255.
fn grey_values(rgb: &RgbImage) -> impl Iterator<Item = f64> {
    rgb.pixels()
        .map(|p| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_core::Point;
    use lsdc_rng::Rng;

    fn points(width: usize, height: usize, depth: impl Fn(usize, usize) -> f32) -> DepthMap {
        let mut rng = Rng::stream(0, &["classic"]);
        let points: Vec<Point> = (0..60)
            .map(|_| {
                (
                    rng.below(width as u32) as usize,
                    rng.below(height as u32) as usize,
                )
            })
            .map(|(x, y)| Point {
                x,
                y,
                depth: depth(x, y),
            })
            .collect();
        DepthMap::from_points(width, height, &points)
    }

    #[test]
    fn every_method_keeps_a_constant_and_fills_every_pixel() {
        let sparse = points(48, 36, |_, _| 2.5);
        let rgb = RgbImage::from_fn(48, 36, |x, y| image::Rgb([(x * 5) as u8, (y * 7) as u8, 9]));
        for method in Classic::ALL {
            let dense = method.complete(&rgb, &sparse).unwrap();
            for value in dense.values() {
                assert!((value - 2.5).abs() < 1e-3, "{}: {value}", method.name());
            }
        }
    }

    #[test]
    fn methods_that_see_the_image_stop_at_its_edges() {
        let edge = |x: u32, _: u32| image::Rgb([if x < 10 { 20 } else { 220 }; 3]);
        let rgb = RgbImage::from_fn(20, 10, edge);
        let point = |x, depth| Point { x, y: 5, depth };
        let sparse = DepthMap::from_points(20, 10, &[point(2, 1.0), point(17, 4.0)]);
        for method in [Classic::Smooth, Classic::Colorisation] {
            let dense = method.complete(&rgb, &sparse).unwrap();
            let near = [(2, 5, 1.0), (8, 0, 1.0), (11, 9, 4.0), (17, 5, 4.0)];
            for (x, y, depth) in near {
                let found = dense.at(x, y);
                assert!(
                    (found - depth).abs() < 0.2,
                    "{} {x} {y}: {found}",
                    method.name()
                );
            }
        }
    }

    #[test]
    fn every_method_fills_the_map_from_one_point() {
        let mut values = vec![0.0; 30 * 20];
        values[7 * 30 + 11] = 3.0;
        let sparse = DepthMap::new(30, 20, values).unwrap();
        for method in Classic::ALL {
            let dense = method.complete(&RgbImage::new(30, 20), &sparse).unwrap();
            for value in dense.values() {
                assert!((value - 3.0).abs() < 1e-3, "{}: {value}", method.name());
            }
            let nothing = DepthMap::empty(30, 20);
            assert!(method.complete(&RgbImage::new(30, 20), &nothing).is_err());
        }
    }

    #[test]
    fn methods_that_scale_do() {
        let depth = |x: usize, y: usize| 1.0 + 0.03 * x as f32 + 0.2 * (y % 7) as f32;
        let (near, far) = (
            points(40, 30, depth),
            points(40, 30, |x, y| 4.0 * depth(x, y)),
        );
        let rgb = RgbImage::from_fn(40, 30, |x, y| image::Rgb([(x * 6) as u8, (y * 8) as u8, 0]));
        for method in Classic::ALL
            .into_iter()
            .filter(|m| *m != Classic::Morphology)
        {
            let near = method.complete(&rgb, &near).unwrap();
            let far = method.complete(&rgb, &far).unwrap();
            for (a, b) in near.values().iter().zip(far.values()) {
                assert!(
                    (4.0 * a - b).abs() < 1e-3 * b.max(1.0),
                    "{} {a} {b}",
                    method.name()
                );
            }
        }
    }
}
