//! Affinities between neighbouring pixels.

use burn::tensor::Tensor;
use lsdc_core::network::{CONTRAST, LEAST_AFFINITY, MAX_LOG_FACTOR};

/// Computes the affinities `[batch, height, width, 2]` between each pixel of normalised images `[batch, height, width, 3]` and
/// its right and lower neighbour: `a = 1 / (1 + (dC / CONTRAST)^2) + LEAST_AFFINITY`, where dC is the colour difference; with
/// changes (f, g), `e^f a^(1 + g)`.
pub(super) fn affinities(images: Tensor<4>, changes: Option<Tensor<4>>) -> Tensor<4> {
    let differences = Tensor::cat(vec![squares(&images, 2), squares(&images, 1)], 3);
    let alike = (differences / (CONTRAST * CONTRAST) + 1.0).recip() + LEAST_AFFINITY;
    match changes {
        None => alike,
        Some(changes) => {
            let factor = changes
                .clone()
                .narrow(3, 0, 2)
                .clamp(-MAX_LOG_FACTOR, MAX_LOG_FACTOR);
            let more = changes.narrow(3, 2, 2).clamp(-1.0, 1.0);
            (alike.log() * (more + 1.0) + factor).exp()
        }
    }
}

/// Returns the squared differences `[batch, height, width, 1]` to the next pixel along an axis; 0 at the end.
fn squares(images: &Tensor<4>, axis: usize) -> Tensor<4> {
    let dims = images.dims();
    let length = dims[axis];
    let mut end = dims;
    (end[axis], end[3]) = (1, 1);
    let end = Tensor::zeros(end, &images.device());
    if length == 1 {
        return end;
    }
    let next = images.clone().narrow(axis, 1, length - 1);
    let here = images.clone().narrow(axis, 0, length - 1);
    let difference = (next - here).square().sum_dim(3);
    Tensor::cat(vec![difference, end], axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

    #[test]
    fn unlike_colours_are_joined_weakly() {
        let half = CONTRAST as f32;
        let colours = vec![0.0, 0.0, 0.0, half, 0.0, 0.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0];
        let image = Tensor::from_data(TensorData::new(colours, [1, 2, 2, 3]), &Device::flex());
        let found = affinities(image, None).into_data();
        let found: Vec<f32> = found.iter::<f32>().collect();
        // Right and lower affinity of each pixel; the last column and row have no neighbour.
        let expected = [0.5001, 1e-4, 1.0001, 1e-4, 1.0001, 1.0001, 1.0001, 1.0001];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
}
