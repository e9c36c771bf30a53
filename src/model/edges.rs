//! How strongly neighbouring pixels are joined.

use burn::tensor::Tensor;

/// The difference in colour at which neighbours are joined half as strongly as equal ones: 1.5 of
/// 255 in units of the normalised image. This and the next were chosen on training frames of NYU
/// Depth v2.
const CONTRAST: f64 = 0.026;

/// What still passes an edge.
const LEAST: f64 = 1e-4;

/// What the network says of each pixel's two edges: logarithms of factors, then by how much more
/// than fully the colours count, -1 = not at all: many edges in the colours are none in the depth.
pub(super) const CHANGES: usize = 4;

/// Factors are at most e to the power of this.
const MOST: f64 = 7.0;

/// The strengths `[batch, height, width, 2]` with which each pixel of normalised images `[batch,
/// height, width, 3]` is joined to its right and lower neighbour: `a = 1 / (1 + (dC / CONTRAST)^2) +
/// LEAST`, dC being the difference in colour; with changes (f, g), `e^f a^(1 + g)`.
pub(super) fn strengths(images: Tensor<4>, changes: Option<Tensor<4>>) -> Tensor<4> {
    let differences = Tensor::cat(vec![squares(&images, 2), squares(&images, 1)], 3);
    let alike = (differences / (CONTRAST * CONTRAST) + 1.0).recip() + LEAST;
    match changes {
        None => alike,
        Some(changes) => {
            let factor = changes.clone().narrow(3, 0, 2).clamp(-MOST, MOST);
            let more = changes.narrow(3, 2, 2).clamp(-1.0, 1.0);
            (alike.log() * (more + 1.0) + factor).exp()
        }
    }
}

/// The same for one image `[height, width, 3]`, on the host.
pub(super) fn strengths_of(
    image: &[f32],
    (height, width): (usize, usize),
    changes: Option<&[f32]>,
) -> Vec<f32> {
    let colour = |pixel: usize| &image[3 * pixel..][..3];
    let alike = |one: usize, other: usize| {
        let pairs = colour(one).iter().zip(colour(other));
        let square: f32 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
        let contrast = CONTRAST as f32;
        1.0 / (1.0 + square / (contrast * contrast)) + LEAST as f32
    };
    let most = MOST as f32;
    let mut strengths = Vec::with_capacity(2 * height * width);
    for pixel in 0..height * width {
        let last = [pixel % width + 1 == width, pixel / width + 1 == height];
        for (way, (last, step)) in last.into_iter().zip([1, width]).enumerate() {
            let alike = alike(pixel, if last { pixel } else { pixel + step });
            strengths.push(match changes {
                None => alike,
                Some(changes) => {
                    let changes = &changes[CHANGES * pixel..][..CHANGES];
                    let factor = changes[way].clamp(-most, most);
                    let more = changes[2 + way].clamp(-1.0, 1.0);
                    (alike.ln() * (1.0 + more) + factor).exp()
                }
            });
        }
    }
    strengths
}

/// Squared differences `[batch, height, width, 1]` to the next pixel along an axis; 0 at the end.
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
        let found = strengths(image, None).into_data();
        let found: Vec<f32> = found.iter::<f32>().collect();
        // Right, down of each pixel; the last column and row have no neighbour.
        let expected = [0.5001, 1e-4, 1.0001, 1e-4, 1.0001, 1.0001, 1.0001, 1.0001];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
}
