//! Layers of the published networks that ours do not have: upsampling by convolutions, max pooling, and convolutions with a
//! bias.

use burn::module::{Module, Param};
use burn::tensor::module::max_pool2d;
use burn::tensor::ops::MaxPoolOptions;
use burn::tensor::{Tensor, TensorData};
use lsdc_train::model::layers::{Init, Norm};
use lsdc_train::ops::conv::{ConvSpec, conv2d};

/// Inserts zeros between the pixels of a map, which doubles its size, and applies a convolution that keeps the size: the
/// unpooling of Laina et al. 2016 with the following convolution; with three taps, a transposed convolution of stride 2.
///
/// Three quarters of the inputs of the convolution are zeros. Hence it is computed as four convolutions of the smaller map, for
/// the pixels of even and odd rows and columns, combined into one convolution of three taps.
#[derive(Module, Debug)]
pub(super) struct UpConv {
    /// Weights `[to, from, taps, taps]` for the map with zeros.
    weight: Param<Tensor<4>>,
}

impl UpConv {
    /// Creates a layer with 3 or 5 taps. Random weights have the variance `2 / (taps^2 fan)`.
    pub(super) fn init(from: usize, to: usize, taps: usize, fan: usize, init: &mut Init) -> Self {
        let deviation = (2.0 / (taps * taps * fan) as f32).sqrt();
        Self {
            weight: init.normal([to, from, taps, taps], deviation),
        }
    }

    /// Maps `[n, height, width, from]` to `[n, rows, columns, to]`, twice the size of the map, or one less if the map was
    /// rounded up.
    pub(super) fn forward(&self, x: Tensor<4>, (rows, columns): (usize, usize)) -> Tensor<4> {
        let [n, height, width, _] = x.dims();
        let weight = self.weight.val();
        let [to, from, taps, _] = weight.dims();
        // An odd row, between two rows of the map, reads them by the taps next to the middle one; an even row reads its own row
        // by the middle tap. Tap t of parity p is tap 2 t + 1 - p of the weights.
        let (before, after) = if taps == 5 { (1, 0) } else { (2, 1) };
        let weight = weight
            .pad((before, after, before, after), 0.0)
            .reshape([to, from, 3, 2, 3, 2])
            // Parity 0 is last there.
            .flip([3, 5])
            .permute([3, 5, 0, 1, 2, 4])
            .reshape([4 * to, from, 3, 3]);
        let four = conv2d(x, weight, ConvSpec::same(1));
        let whole = four
            .reshape([n, height, width, 2, 2, to])
            .permute([0, 1, 3, 2, 4, 5])
            .reshape([n, 2 * height, 2 * width, to]);
        cut(whole, (rows, columns))
    }
}

/// Returns the first rows and columns of a map.
fn cut(map: Tensor<4>, (rows, columns): (usize, usize)) -> Tensor<4> {
    let [n, height, width, channels] = map.dims();
    if (rows, columns) == (height, width) {
        return map;
    }
    map.slice([0..n, 0..rows, 0..columns, 0..channels])
}

/// Upsampling by a convolution, followed by normalisation.
#[derive(Module, Debug)]
pub(super) struct UpConvNorm {
    conv: UpConv,
    norm: Norm,
}

impl UpConvNorm {
    pub(super) fn init(from: usize, to: usize, taps: usize, fan: usize, init: &mut Init) -> Self {
        Self {
            conv: UpConv::init(from, to, taps, fan, init),
            norm: Norm::init(to, init),
        }
    }

    pub(super) fn forward(&self, x: Tensor<4>, size: (usize, usize), relu: bool) -> Tensor<4> {
        self.norm.forward(self.conv.forward(x, size), relu)
    }
}

/// A convolution with a bias.
#[derive(Module, Debug)]
pub(super) struct Biased {
    weight: Param<Tensor<4>>,
    bias: Param<Tensor<1>>,
}

impl Biased {
    /// Creates a convolution with an odd number of taps, which keeps the size.
    pub(super) fn init(from: usize, to: usize, taps: usize, init: &mut Init) -> Self {
        let deviation = (2.0 / (taps * taps * to) as f32).sqrt();
        Self {
            weight: init.normal([to, from, taps, taps], deviation),
            bias: Param::from_data(TensorData::new(vec![0.0_f32; to], [to]), &init.device),
        }
    }

    pub(super) fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let weight = self.weight.val();
        let [to, _, taps, _] = weight.dims();
        let spec = ConvSpec {
            stride: 1,
            padding: taps / 2,
            ..ConvSpec::pointwise()
        };
        conv2d(x, weight, spec) + self.bias.val().reshape([1, 1, 1, to])
    }
}

/// Max pooling over `side` x `side` pixels with stride `step`, with a border of `margin`.
pub(super) fn largest(map: Tensor<4>, side: usize, step: usize, margin: usize) -> Tensor<4> {
    let options = MaxPoolOptions {
        kernel_size: [side; 2],
        stride: [step; 2],
        padding: [(margin, margin); 2],
        dilation: [1; 2],
        ceil_mode: false,
    };
    max_pool2d(map.permute([0, 3, 1, 2]), options).permute([0, 2, 3, 1])
}

/// Interpolates bilinearly to a height and width, aligning the centres of the corner pixels: `align_corners` of `PyTorch`.
pub(super) fn stretched(map: Tensor<4>, (rows, columns): (usize, usize)) -> Tensor<4> {
    let [n, height, width, channels] = map.dims();
    let matrix = |from: usize, to: usize| {
        let data = TensorData::new(stretch(from, to), [to, from]);
        Tensor::<2>::from_data(data, (&map.device(), map.dtype())).unsqueeze::<3>()
    };
    let (vertical, horizontal) = (matrix(height, rows), matrix(width, columns));
    let map = vertical.matmul(map.reshape([n, height, width * channels]));
    let map = horizontal.matmul(map.reshape([n * rows, width, channels]));
    map.reshape([n, rows, columns, channels])
}

/// Returns the matrix `[to, from]` of this interpolation along an axis.
fn stretch(from: usize, to: usize) -> Vec<f32> {
    let mut matrix = vec![0.0; to * from];
    for i in 0..to {
        let place = (i * (from - 1)) as f64 / (to - 1).max(1) as f64;
        let low = (place as usize).min(from - 1);
        let share = (place - low as f64) as f32;
        matrix[i * from + low] += 1.0 - share;
        matrix[i * from + (low + 1).min(from - 1)] += share;
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use lsdc_core::network::NormKind;
    use lsdc_rng::Rng;

    /// Inserts zeros between the pixels, and convolves the result.
    fn plainly(layer: &UpConv, x: Tensor<4>, (rows, columns): (usize, usize)) -> Tensor<4> {
        let [n, height, width, channels] = x.dims();
        let zeros = Tensor::zeros_like(&x);
        let wide = Tensor::stack::<5>(vec![x, zeros], 3).reshape([n, height, 2 * width, channels]);
        let zeros = Tensor::zeros_like(&wide);
        let whole = Tensor::stack::<5>(vec![wide, zeros], 2);
        let whole = whole.reshape([n, 2 * height, 2 * width, channels]);
        let weight = layer.weight.val();
        let spec = ConvSpec {
            stride: 1,
            padding: weight.dims()[2] / 2,
            ..ConvSpec::pointwise()
        };
        conv2d(cut(whole, (rows, columns)), weight, spec)
    }

    #[test]
    fn enlargement_agrees_with_the_convolution_of_zeros() {
        let device = Device::flex();
        let mut init = Init {
            rng: Some(Rng::stream(0, &["up"])),
            norm: NormKind::Batch,
            momentum: 0.1,
            device: device.clone(),
        };
        let x = init.normal([2, 4, 5, 6], 1.0).val();
        for taps in [3, 5] {
            let layer = UpConv::init(6, 3, taps, 3, &mut init);
            for size in [(8, 10), (7, 10), (8, 9), (7, 9)] {
                let fast = layer.forward(x.clone(), size);
                let plain = plainly(&layer, x.clone(), size);
                assert_eq!(fast.dims(), [2, size.0, size.1, 3]);
                let apart = (fast - plain.clone()).abs().max().into_scalar::<f32>();
                let largest = plain.abs().max().into_scalar::<f32>();
                assert!(
                    largest > 0.5 && apart < 1e-5 * largest.max(3.0),
                    "{taps}: {apart}"
                );
            }
        }
    }

    #[test]
    fn corners_stay_where_they_are() {
        assert_eq!(stretch(2, 3), [1.0, 0.0, 0.5, 0.5, 0.0, 1.0]);
        assert_eq!(stretch(3, 2), [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(stretch(1, 2), [1.0, 1.0]);
        assert_eq!(stretch(2, 1), [1.0, 0.0]);
    }
}
