//! An error bar on every pixel.

use super::{Completer, ImageBases, at_places, places, size_of};
use crate::data::DepthMap;
use crate::error::{Error, Result};
use crate::fit::{Fit, LocalNoise};
use crate::sample::Size;
use rayon::prelude::*;

/// Pixels whose base functions are held at once.
const STRIP: usize = 1 << 13;

impl Completer {
    /// The standard deviation of each pixel of `depth`, in metres: that of the noise around it and
    /// that of the weights, which grows away from what the points determine. `depth` is the dense
    /// depth of `fit` to
    /// `sparse`, at any size.
    ///
    /// # Errors
    /// Fewer than two points under a field.
    pub fn deviation(
        &self,
        bases: &ImageBases,
        sparse: &DepthMap,
        fit: &Fit,
        depth: &DepthMap,
    ) -> Result<DepthMap> {
        let (places, _) = places(sparse);
        let leverages = fit.leverages(&at_places(bases, sparse, &places));
        let from = size_of(sparse);
        let noise = LocalNoise::new(fit, &leverages, &places, (from.height, from.width));
        let Size { height, width } = size_of(depth);
        let (right, down) = (
            from.width as f64 / width as f64,
            from.height as f64 / height as f64,
        );
        let mut values = vec![0.0; height * width];
        if fit.smooth().is_some() && noise.is_silent() {
            return Err(Error::fit(
                "the points say nothing of how far a field is off between them",
            )
            .hint("give more points, or choose another fit (`--fit lse`)"));
        }
        if let Some(deviations) = fit.field_deviations(|size, pixels| bases.at(size, pixels)) {
            deviations.add_to((height, width), &mut values);
            for (pixel, value) in values.iter_mut().enumerate() {
                let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
                let noise = noise.at(x * right, y * down).sqrt();
                *value = (self.deviation * noise * f64::from(*value)) as f32;
            }
            return DepthMap::new(width, height, values);
        }
        values
            .par_chunks_mut(STRIP)
            .enumerate()
            .for_each(|(strip, values)| {
                let first = strip * STRIP;
                let pixels: Vec<u32> = (first..first + values.len()).map(|p| p as u32).collect();
                let spreads = fit.spreads(&bases.at((height, width), &pixels));
                for ((value, spread), pixel) in values.iter_mut().zip(spreads).zip(first..) {
                    let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
                    let variance = noise.at(x * right, y * down) * (1.0 + f64::from(spread));
                    let slope = fit.space.slope(f64::from(depth.values()[pixel]));
                    *value = (self.deviation * variance.sqrt() * slope) as f32;
                }
            });
        DepthMap::new(width, height, values)
    }
}
