//! Input and output of a network that another program runs.

use crate::bilinear::InterpolationWeights;
use crate::completer::Completer;
use crate::ensemble::Quality;
use crate::error::{FitError, Result, SettingsError};
use crate::image::{Image, check_size};
use crate::network::{Basis, Forward};
use crate::resize::resized;
use crate::scene::Scene;
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;
use std::sync::Arc;

/// Positions, or pixels, per task.
const PIECE: usize = 64;

/// An image in the form that exported weights (`lsdc weights export`) read, from [`Completer::network_input`].
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct NetworkInput {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Red, green and blue from 0 to 1, `[3, height, width]`.
    pub values: Vec<f32>,
}

/// Basis functions and affinities of one image, computed by another program, such as ONNX Runtime with exported
/// weights. Cheap to clone.
///
/// [`Completer::scene_with_output`] makes a scene from it.
#[derive(Clone)]
pub struct NetworkOutput(Arc<Inner>);

struct Inner {
    height: usize,
    width: usize,
    /// `[functions, height, width]`.
    basis: Vec<f32>,
    /// `[2, height, width]`.
    affinities: Vec<f32>,
}

impl std::fmt::Debug for NetworkOutput {
    /// Omits the values, of which there are millions.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NetworkOutput")
            .field("width", &self.width())
            .field("height", &self.height())
            .field("functions", &self.functions())
            .finish_non_exhaustive()
    }
}

impl NetworkOutput {
    /// The output for an image of this size: `basis` is `[functions, height, width]`; its first function is the constant 1 or
    /// the depth that the network predicts, up to scale. `affinities` are `[2, height, width]`: the affinity of each pixel to
    /// its right neighbour, then to its lower neighbour.
    ///
    /// # Errors
    /// A side of 0, arrays of other lengths, values that are not finite, or negative affinities.
    pub fn new(width: usize, height: usize, basis: Vec<f32>, affinities: Vec<f32>) -> Result<Self> {
        check_size(width, height)?;
        let pixels = width * height;
        if basis.is_empty() || !basis.len().is_multiple_of(pixels) {
            let found = basis.len();
            let what = format!("{found} values are not basis functions of {width}x{height} pixels");
            return Err(FitError::Shape(what).into());
        }
        if affinities.len() != 2 * pixels {
            let found = affinities.len();
            let what =
                format!("{found} affinities are not two for each of {width}x{height} pixels");
            return Err(FitError::Shape(what).into());
        }
        let finite = basis.par_iter().all(|v| v.is_finite());
        if !finite || !affinities.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return Err(FitError::NotFinite.into());
        }
        Ok(Self(Arc::new(Inner {
            height,
            width,
            basis,
            affinities,
        })))
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.0.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.0.height
    }

    /// Number of basis functions, including the first.
    pub fn functions(&self) -> usize {
        self.0.basis.len() / self.pixels()
    }

    fn pixels(&self) -> usize {
        self.0.width * self.0.height
    }

    /// Height and width.
    pub(crate) fn size(&self) -> (usize, usize) {
        (self.0.height, self.0.width)
    }
}

impl Forward for NetworkOutput {
    fn basis(&self) -> Box<dyn Basis> {
        Box::new(self.clone())
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        let (right, down) = self.0.affinities.split_at(self.pixels());
        let pairs = right.iter().zip(down);
        (pairs.flat_map(|(r, d)| [*r, *d]).collect(), self.size())
    }
}

impl Basis for NetworkOutput {
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        let (functions, pixels) = (self.functions(), self.pixels());
        let mut rows = vec![0.0; places.len() * functions];
        let pieces = rows.par_chunks_mut(PIECE * functions);
        pieces.zip(places.par_chunks(PIECE)).each(|(rows, places)| {
            let taps: Vec<InterpolationWeights> = places
                .iter()
                .map(|&place| InterpolationWeights::new(place, size, self.size()))
                .collect();
            for (k, map) in self.0.basis.chunks_exact(pixels).enumerate() {
                let column = rows.iter_mut().skip(k).step_by(functions);
                for (value, taps) in column.zip(&taps) {
                    let terms = taps.iter();
                    let terms = terms.map(|(pixel, share)| share as f32 * map[pixel as usize]);
                    *value = terms.sum();
                }
            }
        });
        rows
    }

    fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let pixels = self.pixels();
        let mut sums = vec![0.0_f64; pixels];
        let row = self.0.width * PIECE.div_ceil(self.0.width);
        sums.par_chunks_mut(row).enumerate().each(|(i, sums)| {
            for (map, weight) in self.0.basis.chunks_exact(pixels).zip(weights) {
                let values = &map[i * row..][..sums.len()];
                let pairs = sums.iter_mut().zip(values);
                pairs.for_each(|(sum, value)| *sum += weight * f64::from(*value));
            }
        });
        if size == self.size() {
            return sums.into_iter().map(|sum| sum as f32).collect();
        }
        // Interpolation commutes with sums.
        let mut map = vec![0.0; size.0 * size.1];
        let rows = map.par_chunks_mut(size.1.max(1)).enumerate();
        rows.each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                let place = [x as f64, y as f64];
                let taps = InterpolationWeights::new(place, size, self.size());
                *value = taps.read(&sums) as f32;
            }
        });
        map
    }
}

impl Completer {
    /// The width and height of the [`NetworkInput`] for an image of this width and height.
    ///
    /// ```
    /// # #[cfg(feature = "weights")] {
    /// let completer = lsdc_core::Completer::new(&lsdc_core::Weights::builtin_small()).unwrap();
    /// assert_eq!(completer.network_size(640, 480), (304, 228));
    /// # }
    /// ```
    pub fn network_size(&self, width: usize, height: usize) -> (usize, usize) {
        let (height, width) = self.normalisation().working_size((height, width));
        (width, height)
    }

    /// The input of the network for an image: resized to the working size. It is not normalised, because exported weights
    /// include the normalisation.
    ///
    /// # Errors
    /// Colours that are not finite or far above 1.
    pub fn network_input(&self, image: &Image<'_>) -> Result<NetworkInput> {
        let size = (image.height(), image.width());
        let (width, height) = self.network_size(size.1, size.0);
        let colours = resized(&image.rgb()?, size, (height, width))?;
        let channel = |c: usize| colours.iter().skip(c).step_by(3);
        let values = (0..3).flat_map(channel).map(|&v| f32::from(v) / 255.0);
        Ok(NetworkInput {
            width,
            height,
            values: values.collect(),
        })
    }

    /// Makes a scene from an image and the network output that another program computed, for the [`NetworkInput`] of this
    /// completer or for the image at another size. A fit with a field is solved at the size of the output.
    ///
    /// At pixel centres of the output, depths equal those of the built-in network, up to rounding. Between them, basis
    /// functions are interpolated, where the built-in network computes them at the position itself: depths of 300 points
    /// between pixels differ by up to 1.4 % (`default`) or 0.3 % (`small`).
    ///
    /// # Errors
    /// The number of basis functions does not match the prior of the weights; [`Quality::Best`], which would also need the
    /// output for the mirror image; colours that are not finite, or settings out of range.
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// use lsdc_core::{Channels, Completer, Image, NetworkOutput, Observations, Weights};
    ///
    /// let completer = Completer::new(&Weights::builtin_small())?;
    /// let grey = vec![128_u8; 3 * 64 * 48];
    /// let image = Image::new(64, 48, Channels::Rgb, &grey)?;
    /// let input = completer.network_input(&image)?;
    /// // In place of another program: a constant and waves.
    /// let pixels = input.width * input.height;
    /// let wave = |i: usize| if i < pixels { 1.0 } else { (0.013 * i as f32).sin() };
    /// let basis = (0..65 * pixels).map(wave).collect();
    /// let output = NetworkOutput::new(input.width, input.height, basis, vec![1.0; 2 * pixels])?;
    /// let mut points = Observations::new();
    /// points.add(10.0, 20.0, 2.0);
    /// points.add(50.0, 30.5, 2.5);
    /// let depth = completer.scene_with_output(&image, &output)?.complete(&points)?.depth()?;
    /// assert!((depth.at(10, 20) - 2.0).abs() < 0.2);
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    pub fn scene_with_output(&self, image: &Image<'_>, output: &NetworkOutput) -> Result<Scene> {
        if self.quality() == Quality::Best {
            let what = "the output of a network for one image is not enough for `Quality::Best`";
            return Err(SettingsError::new(what)
                .with_hint("choose `Quality::Standard`")
                .into());
        }
        if let Some(prior) = self.prior().filter(|p| p.columns() != output.functions()) {
            let (found, expected) = (output.functions(), prior.columns());
            let what = format!(
                "the network's output has {found} basis functions, but the prior of the weights is for {expected}"
            );
            return Err(FitError::Shape(what).into());
        }
        Scene::new(self.clone(), image, Some(output), None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{FitConfig, FitMethod};
    use crate::{Channels, Observations};

    /// Returns a basis of the constant, the column and the row.
    fn planes(width: usize, height: usize) -> NetworkOutput {
        let pixel = |i: usize| ((i % width) as f32, (i / width) as f32);
        let pixels = 0..width * height;
        let maps = [
            pixels.clone().map(|_| 1.0).collect::<Vec<f32>>(),
            pixels.clone().map(|i| pixel(i).0).collect(),
            pixels.map(|i| pixel(i).1).collect(),
        ];
        NetworkOutput::new(width, height, maps.concat(), vec![1.0; 2 * width * height]).unwrap()
    }

    #[test]
    fn functions_are_interpolated_between_pixels() {
        let output = planes(5, 4);
        let rows = output.at((4, 5), &[[1.25, 2.5], [4.0, 0.0], [9.0, -3.0]]);
        assert_eq!(rows, [1.0, 1.25, 2.5, 1.0, 4.0, 0.0, 1.0, 4.0, 0.0]);
        // In an image of twice the size, centre 3 lies at 1.25.
        assert_eq!(output.at((8, 10), &[[3.0, 5.0]]), [1.0, 1.25, 2.25]);
    }

    #[test]
    fn sums_are_those_of_the_functions_at_every_pixel() {
        let output = planes(70, 3);
        let weights = [2.0, 0.5, -0.25];
        for (height, width) in [(3, 70), (6, 140), (2, 33)] {
            let map = output.combine((height, width), &weights);
            let places = (0..height * width).map(|i| [(i % width) as f64, (i / width) as f64]);
            let rows = output.at((height, width), &places.collect::<Vec<_>>());
            assert_eq!(map.len(), height * width);
            for (value, row) in map.iter().zip(rows.chunks_exact(3)) {
                let expected = 2.0 + 0.5 * row[1] - 0.25 * row[2];
                assert!((value - expected).abs() < 1e-4, "{value} {expected}");
            }
        }
    }

    #[test]
    fn a_plane_is_found_exactly() {
        let fit = FitConfig {
            method: FitMethod::Lse,
            prior: crate::fit::PriorKind::None,
            ..FitConfig::default()
        };
        let mut completer = Completer::without_network(fit).unwrap();
        let grey = [99_u8; 3 * 20 * 16];
        let image = Image::new(20, 16, Channels::Rgb, &grey).unwrap();
        let output = planes(10, 8);
        // Without a network, the prior is for the constant alone.
        let error = completer.scene_with_output(&image, &output).unwrap_err();
        assert!(error.to_string().contains("3 basis functions"), "{error}");

        let (mean, factor) = ([1.0, 0.0, 0.0], [0.0; 3]);
        let noise = completer.prior().unwrap().noise();
        let prior = crate::fit::Prior::new(&mean, &factor, noise).unwrap();
        completer = completer.with_prior(prior);
        let scene = completer.scene_with_output(&image, &output).unwrap();
        let mut points = Observations::new();
        // Away from the border, where positions beyond the outermost centres take the outermost value.
        let depth = |u: f64, v: f64| 2.0 + 0.05 * u + 0.1 * v;
        for (u, v) in [
            (2.0, 3.0),
            (17.0, 4.0),
            (6.5, 12.0),
            (11.0, 9.25),
            (4.0, 8.0),
        ] {
            points.add(u, v, depth(u, v) as f32);
        }
        let map = scene.complete(&points).unwrap().depth().unwrap();
        for (x, y) in [(1, 1), (9, 7), (18, 14), (5, 13)] {
            let expected = depth(x as f64, y as f64) as f32;
            assert!((map.at(x, y) - expected).abs() < 1e-4, "{}", map.at(x, y));
        }
    }

    #[test]
    fn outputs_that_cannot_be_used_are_rejected() {
        let made = |basis: Vec<f32>, affinities: Vec<f32>| {
            NetworkOutput::new(3, 2, basis, affinities).map(|_| ())
        };
        let message = |made: Result<()>| made.unwrap_err().to_string();
        assert!(message(made(vec![0.0; 13], vec![1.0; 12])).contains("13 values"));
        assert!(message(made(vec![], vec![1.0; 12])).contains("0 values"));
        assert!(message(made(vec![0.0; 12], vec![1.0; 6])).contains("6 affinities"));
        assert!(made(vec![f32::NAN; 12], vec![1.0; 12]).is_err());
        assert!(made(vec![0.0; 12], vec![-1.0; 12]).is_err());
        assert!(NetworkOutput::new(0, 2, vec![], vec![]).is_err());

        let fit = FitConfig::default();
        let completer = Completer::without_network(fit).unwrap();
        let grey = [99_u8; 3 * 6];
        let image = Image::new(3, 2, Channels::Rgb, &grey).unwrap();
        let output = NetworkOutput::new(3, 2, vec![1.0; 6], vec![1.0; 12]).unwrap();
        let best = completer.with_quality(Quality::Best);
        let error = best.scene_with_output(&image, &output).unwrap_err();
        assert!(error.to_string().contains("Quality::Best"), "{error}");
    }

    #[cfg(feature = "weights")]
    #[test]
    fn outputs_of_the_network_give_its_completion() {
        use crate::network::{CpuNetwork, Network};
        use crate::weights::Weights;
        use lsdc_kernels::simd::Level;

        let weights = Weights::builtin_small();
        let (width, height) = (96, 72);
        let completer = Completer::builder(&weights)
            .working_size(height / 2, width / 2)
            .build()
            .unwrap();
        let rgb: Vec<u8> = (0..3 * width * height)
            .map(|i| (i / 5 * i / 911 % 251) as u8)
            .collect();
        let image = Image::new(width, height, Channels::Rgb, &rgb).unwrap();
        let input = completer.network_input(&image).unwrap();
        assert_eq!((input.width, input.height), (width / 2, height / 2));
        let pixels = input.width * input.height;
        let size = (input.height, input.width);
        let normalisation = completer.normalisation();
        let normal = (0..3 * pixels).map(|i| {
            let (pixel, c) = (i / 3, i % 3);
            (input.values[c * pixels + pixel] - normalisation.mean[c]) / normalisation.deviation[c]
        });
        let network =
            CpuNetwork::new(&weights.network, &weights.tensors, None, Level::here()).unwrap();
        let forward = network.forward(&normal.collect::<Vec<_>>(), size).unwrap();
        let places = (0..pixels).map(|i| [(i % size.1) as f64, (i / size.1) as f64]);
        let rows = forward.basis().at(size, &places.collect::<Vec<_>>());
        let functions = rows.len() / pixels;
        let planar = |values: &[f32], count: usize| -> Vec<f32> {
            let plane = |k| values.iter().skip(k).step_by(count).copied();
            (0..count).flat_map(plane).collect()
        };
        let output = NetworkOutput::new(
            input.width,
            input.height,
            planar(&rows, functions),
            planar(&forward.affinities().0, 2),
        )
        .unwrap();
        let mut points = Observations::new();
        for i in 0..60 {
            let (u, v) = (37 * i % width, 29 * i % height);
            points.add(u as f64, v as f64, 1.5 + u as f32 / 50.0);
        }
        let expected = completer.scene(&image).unwrap();
        let expected = expected.complete(&points).unwrap().depth().unwrap();
        let found = completer.scene_with_output(&image, &output).unwrap();
        let found = found.complete(&points).unwrap().depth().unwrap();
        for (found, expected) in found.values().iter().zip(expected.values()) {
            assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
        }
    }
}
