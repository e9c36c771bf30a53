//! The operation on GPUs: one pass over the values per step, while burn's own operations take several.

use super::{
    NormBackend, NormGradients, NormSpec, reference, reference_backward, reference_moments,
};
use crate::ops::gpu::{UNITS, cube, cubes, empty, sum_of_parts};
use burn::backend::TensorMetadata as _;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::{DType, Shape, Slice};
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// Channels summed by a cube at once.
const CHANNELS: usize = 32;
/// Units per channel.
const LANES: usize = UNITS / CHANNELS;
/// Smallest number of rows of one part of a sum.
const PART: usize = 512;
/// Largest number of parts.
const PARTS: usize = 512;

type Floats = FloatTensor<CubeBackend>;

/// Rows, channels, and rows of one part of a sum.
struct Extent {
    rows: usize,
    channels: usize,
    part: usize,
}

impl Extent {
    /// Returns `None` if the kernels do not apply.
    fn of(x: &CubeTensor) -> Option<Self> {
        let shape = x.shape();
        let (count, channels) = (shape.num_elements(), shape.last().copied().unwrap_or(1));
        if x.dtype() != DType::F32 || count == 0 {
            return None;
        }
        let rows = count / channels;
        let parts = rows.div_ceil(PART).min(PARTS);
        Some(Self {
            rows,
            channels,
            part: rows.div_ceil(parts),
        })
    }

    fn parts(&self) -> usize {
        self.rows.div_ceil(self.part)
    }

    fn count(&self) -> CubeCount {
        let across = self.channels.div_ceil(CHANNELS);
        CubeCount::Static(across as u32, self.parts() as u32, 1)
    }
}

impl NormBackend for CubeBackend {
    fn moments(x: Floats) -> (Floats, Floats) {
        let Some(extent) = Extent::of(&x) else {
            return reference_moments::<Self>(x);
        };
        let x = into_contiguous(x);
        let parts = empty(&x, [extent.parts(), 2, extent.channels]);
        moments_of_parts::launch(
            &x.client,
            extent.count(),
            cube(),
            x.clone().into_buffer_arg(),
            parts.clone().into_buffer_arg(),
            extent.rows as u32,
            extent.channels as u32,
            extent.part as u32,
        );
        let (mean, variance) = (empty(&x, [extent.channels]), empty(&x, [extent.channels]));
        moments_of_all::launch(
            &x.client,
            cubes(&x, extent.channels),
            cube(),
            parts.into_buffer_arg(),
            mean.clone().into_buffer_arg(),
            variance.clone().into_buffer_arg(),
            extent.rows as u32,
            extent.part as u32,
        );
        (mean, variance)
    }

    fn normalise(
        x: Floats,
        gain: Floats,
        shift: Floats,
        mean: Floats,
        variance: Floats,
        spec: NormSpec,
    ) -> Floats {
        if Extent::of(&x).is_none() {
            return reference::<Self>(x, gain, shift, mean, variance, spec);
        }
        let x = into_contiguous(x);
        let result = empty(&x, x.shape());
        let line = Line::new([gain, shift, mean, variance]);
        forward::launch(
            &x.client,
            cubes(&x, x.meta.num_elements()),
            cube(),
            x.clone().into_buffer_arg(),
            line.gain.into_buffer_arg(),
            line.shift.into_buffer_arg(),
            line.mean.into_buffer_arg(),
            line.variance.into_buffer_arg(),
            result.clone().into_buffer_arg(),
            spec.epsilon as f32,
            spec.relu,
        );
        result
    }
}

impl NormGradients for CubeBackend {
    fn normalise_backward(
        x: Floats,
        gain: Floats,
        shift: Floats,
        mean: Floats,
        variance: Floats,
        grad: Floats,
        spec: NormSpec,
    ) -> [Floats; 3] {
        let Some(extent) = Extent::of(&x) else {
            return reference_backward::<Self>(x, gain, shift, mean, variance, grad, spec);
        };
        let (x, grad) = (into_contiguous(x), into_contiguous(grad));
        let line = Line::new([gain, shift, mean, variance]);
        let channels = extent.channels;
        let parts = empty(&x, [extent.parts(), 2, channels]);
        sums_of_parts::launch(
            &x.client,
            extent.count(),
            cube(),
            x.clone().into_buffer_arg(),
            grad.clone().into_buffer_arg(),
            line.gain.clone().into_buffer_arg(),
            line.shift.clone().into_buffer_arg(),
            line.mean.clone().into_buffer_arg(),
            line.variance.clone().into_buffer_arg(),
            parts.clone().into_buffer_arg(),
            extent.rows as u32,
            extent.part as u32,
            spec.epsilon as f32,
            spec.relu,
        );
        let sums = sum_of_parts(parts, [2, channels]);
        let result = empty(&x, x.shape());
        backward::launch(
            &x.client,
            cubes(&x, x.meta.num_elements()),
            cube(),
            x.clone().into_buffer_arg(),
            grad.into_buffer_arg(),
            line.gain.into_buffer_arg(),
            line.shift.into_buffer_arg(),
            line.mean.into_buffer_arg(),
            line.variance.into_buffer_arg(),
            sums.clone().into_buffer_arg(),
            result.clone().into_buffer_arg(),
            extent.rows as u32,
            spec.epsilon as f32,
            spec.relu,
            spec.own,
        );
        let row = |index: isize| {
            let slices = [Slice::new(index, Some(index + 1), 1), Slice::full()];
            Self::float_reshape(
                Self::float_slice(sums.clone(), &slices),
                Shape::new([channels]),
            )
        };
        [result, row(1), row(0)]
    }
}

/// The parameters of each channel.
struct Line {
    gain: Floats,
    shift: Floats,
    mean: Floats,
    variance: Floats,
}

impl Line {
    fn new(values: [Floats; 4]) -> Self {
        let [gain, shift, mean, variance] = values.map(into_contiguous);
        Self {
            gain,
            shift,
            mean,
            variance,
        }
    }
}

/// Sums a value over the lanes of a channel, in the first lane.
#[cube]
fn over_lanes(shared: &mut Shared<[f32]>, value: f32) -> f32 {
    let unit = UNIT_POS_X as usize;
    shared[unit] = value;
    sync_cube();
    let mut sum = value;
    if unit < CHANNELS {
        for other in 1..LANES {
            sum += shared[unit + other * CHANNELS];
        }
    }
    // The shared memory is reused for the next value.
    sync_cube();
    sum
}

/// Computes `parts [parts, 2, channels]` of `x [rows, channels]`: the mean of each part, and the sum of squared differences
/// from it. Both are summed as differences from the first row, so that large means do not cost precision.
#[cube(launch)]
fn moments_of_parts(x: &[f32], parts: &mut [f32], rows: u32, channels: u32, part: u32) {
    let (rows, channels, part) = (rows as usize, channels as usize, part as usize);
    let unit = UNIT_POS_X as usize;
    let lane = unit / CHANNELS;
    let channel = CUBE_POS_X as usize * CHANNELS + unit % CHANNELS;
    let number = CUBE_POS_Y as usize;
    let first = number * part;
    let last = clamp_max(first + part, rows);
    let mut shared = Shared::<[f32]>::new_slice(UNITS);
    let mut origin = 0.0f32;
    let mut sum = 0.0f32;
    let mut square = 0.0f32;
    if channel < channels {
        origin = x[first * channels + channel];
        let mut row = first + lane;
        while row < last {
            let v = x[row * channels + channel] - origin;
            sum += v;
            square += v * v;
            row += LANES;
        }
    }
    let sum = over_lanes(&mut shared, sum);
    let square = over_lanes(&mut shared, square);
    if lane == 0 && channel < channels {
        let count = f32::cast_from(last - first);
        let mean = sum / count;
        parts[2 * number * channels + channel] = origin + mean;
        parts[(2 * number + 1) * channels + channel] = square - sum * mean;
    }
}

/// Combines mean and variance of all `rows` from those of parts (Chan, Golub and `LeVeque` 1979).
#[cube(launch)]
fn moments_of_all(parts: &[f32], mean: &mut [f32], variance: &mut [f32], rows: u32, part: u32) {
    let (rows, part) = (rows as usize, part as usize);
    let channels = mean.len();
    let channel = ABSOLUTE_POS;
    if channel < channels {
        let count = rows.div_ceil(part);
        let mut centre = 0.0f32;
        let mut square = 0.0f32;
        let mut before = 0.0f32;
        for number in 0..count {
            let here = f32::cast_from(clamp_max((number + 1) * part, rows) - number * part);
            let apart = parts[2 * number * channels + channel] - centre;
            let all = before + here;
            centre += apart * (here / all);
            square += parts[(2 * number + 1) * channels + channel]
                + apart * apart * (before * (here / all));
            before = all;
        }
        mean[channel] = centre;
        variance[channel] = square / before;
    }
}

#[cube(launch)]
fn forward(
    x: &[f32],
    gain: &[f32],
    shift: &[f32],
    mean: &[f32],
    variance: &[f32],
    result: &mut [f32],
    epsilon: f32,
    #[comptime] relu: bool,
) {
    if ABSOLUTE_POS < result.len() {
        let channel = ABSOLUTE_POS % gain.len();
        let slope = gain[channel] / (variance[channel] + epsilon).sqrt();
        let mut value = (x[ABSOLUTE_POS] - mean[channel]) * slope + shift[channel];
        if comptime!(relu) {
            value = max(value, 0.0f32);
        }
        result[ABSOLUTE_POS] = value;
    }
}

/// Returns the gradient of a value from that of its ReLU, if there is one.
#[cube]
fn passed(gradient: f32, value: f32, #[comptime] relu: bool) -> f32 {
    let mut passed = gradient;
    if comptime!(relu) {
        passed = select(value > 0.0f32, gradient, 0.0f32);
    }
    passed
}

/// Computes `parts [parts, 2, channels]`: sums of the gradient `grad [rows, channels]` of the output, and sums of its product
/// with the normalised `x`.
#[cube(launch)]
fn sums_of_parts(
    x: &[f32],
    grad: &[f32],
    gain: &[f32],
    shift: &[f32],
    mean: &[f32],
    variance: &[f32],
    parts: &mut [f32],
    rows: u32,
    part: u32,
    epsilon: f32,
    #[comptime] relu: bool,
) {
    let (rows, part) = (rows as usize, part as usize);
    let channels = gain.len();
    let unit = UNIT_POS_X as usize;
    let lane = unit / CHANNELS;
    let channel = CUBE_POS_X as usize * CHANNELS + unit % CHANNELS;
    let number = CUBE_POS_Y as usize;
    let last = clamp_max((number + 1) * part, rows);
    let mut shared = Shared::<[f32]>::new_slice(UNITS);
    let mut plain = 0.0f32;
    let mut along = 0.0f32;
    if channel < channels {
        let scale = 1.0f32 / (variance[channel] + epsilon).sqrt();
        let centre = mean[channel];
        let slope = gain[channel] * scale;
        let offset = shift[channel];
        let mut row = number * part + lane;
        while row < last {
            let v = x[row * channels + channel] - centre;
            let g = passed(grad[row * channels + channel], v * slope + offset, relu);
            plain += g;
            along += g * (v * scale);
            row += LANES;
        }
    }
    let plain = over_lanes(&mut shared, plain);
    let along = over_lanes(&mut shared, along);
    if lane == 0 && channel < channels {
        parts[2 * number * channels + channel] = plain;
        parts[(2 * number + 1) * channels + channel] = along;
    }
}

/// Computes the gradient of `x` from that of the output, with the `sums [2, channels]` over all rows if it has its `own`
/// statistics.
#[cube(launch)]
fn backward(
    x: &[f32],
    grad: &[f32],
    gain: &[f32],
    shift: &[f32],
    mean: &[f32],
    variance: &[f32],
    sums: &[f32],
    result: &mut [f32],
    rows: u32,
    epsilon: f32,
    #[comptime] relu: bool,
    #[comptime] own: bool,
) {
    if ABSOLUTE_POS < result.len() {
        let channels = gain.len();
        let channel = ABSOLUTE_POS % channels;
        let scale = 1.0f32 / (variance[channel] + epsilon).sqrt();
        let slope = gain[channel] * scale;
        let v = x[ABSOLUTE_POS] - mean[channel];
        let output = v * slope + shift[channel];
        let mut g = passed(grad[ABSOLUTE_POS], output, relu);
        if comptime!(own) {
            let share = 1.0f32 / f32::cast_from(rows);
            g -= (sums[channel] + v * scale * sums[channels + channel]) * share;
        }
        result[ABSOLUTE_POS] = g * slope;
    }
}
