//! The operation on GPUs as matrix products. The left matrix, the patches of pixels around each output, is never stored
//! (implicit GEMM, Chetlur et al. 2014). A cube computes one tile of the result from tiles in its shared memory.

use super::{ConvBackend, ConvGradients, ConvSpec, reference, reference_input, reference_weight};
use crate::ops::gpu::{cube, cubes, empty, tile, tiles};
use burn::backend::TensorMetadata as _;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;

/// Side of the square of units of a cube, each with some rows of the tile and some columns.
const SIDE: usize = 16;
/// Rows per unit of a tile of the gradient of weights; of other results, where more tiles are not enough.
const OWN: usize = 4;
/// Rows of such a tile.
const ROWS: usize = SIDE * OWN;
/// Products summed between two loads.
const DEPTH: usize = 16;
/// Values that a unit reads at once from shared memory, which otherwise takes longer than the products.
const WIDTH: usize = 4;
/// Vectors of channels per row or column of a tile, one of them unused: an odd number, so that no two units read from one bank.
const VECTORS: usize = DEPTH / WIDTH + 1;
/// Number of cubes from which on larger tiles keep all of a large GPU busy.
const MANY: usize = 512;
/// Number of cubes that fill a large GPU.
const ENOUGH: usize = 2048;
/// Smallest number of pixels summed by one part of the gradient of weights.
const PART: usize = 512;

type Floats = FloatTensor<CubeBackend>;

/// The sizes of a convolution.
#[derive(Clone, Copy)]
struct Geometry {
    batch: usize,
    /// Height, width and channels of the input.
    input: [usize; 3],
    /// Height, width and channels of the output.
    output: [usize; 3],
    taps: usize,
    spec: ConvSpec,
}

impl Geometry {
    fn new(x: &CubeTensor, weight: &CubeTensor, spec: ConvSpec) -> Self {
        let (x, weight) = (x.shape(), weight.shape());
        let taps = weight[2];
        let out = |length: usize| spec.output(length, taps);
        Self {
            batch: x[0],
            input: [x[1], x[2], x[3]],
            output: [out(x[1]), out(x[2]), weight[0]],
            taps,
            spec,
        }
    }
}

/// Returns whether the kernels apply.
fn applies(x: &CubeTensor, weight: &CubeTensor, spec: ConvSpec) -> bool {
    !spec.depthwise
        && x.dtype() == DType::F32
        && x.shape().num_elements() * weight.shape().num_elements() > 0
}

impl ConvBackend for CubeBackend {
    fn conv(x: Floats, weight: Floats, spec: ConvSpec) -> Floats {
        if !applies(&x, &weight, spec) {
            return reference::<Self>(x, weight, spec);
        }
        let geometry = Geometry::new(&x, &weight, spec);
        let weights = Self::float_permute(weight, &[2, 3, 0, 1]);
        from_patches(x, weights, geometry, false)
    }
}

impl ConvGradients for CubeBackend {
    fn conv_backward_input(x: Floats, weight: Floats, grad: Floats, spec: ConvSpec) -> Floats {
        if !applies(&x, &weight, spec) {
            return reference_input::<Self>(x, weight, grad, spec);
        }
        let geometry = Geometry::new(&x, &weight, spec);
        let weights = Self::float_permute(weight, &[2, 3, 1, 0]);
        from_patches(grad, weights, geometry, true)
    }

    fn conv_backward_weight(x: Floats, weight: Floats, grad: Floats, spec: ConvSpec) -> Floats {
        if !applies(&x, &weight, spec) {
            return reference_weight::<Self>(x, weight, grad, spec);
        }
        let geometry = Geometry::new(&x, &weight, spec);
        of_weights(into_contiguous(x), into_contiguous(grad), geometry)
    }
}

/// Computes outputs from inputs with `weights [taps, taps, out, in]`; if `back`, the gradient of inputs from that of outputs
/// with `weights [taps, taps, in, out]`.
fn from_patches(from: Floats, weights: Floats, geometry: Geometry, back: bool) -> Floats {
    let (from, weights) = (into_contiguous(from), into_contiguous(weights));
    let Geometry {
        batch, taps, spec, ..
    } = geometry;
    let (source, target) = if back {
        (geometry.output, geometry.input)
    } else {
        (geometry.input, geometry.output)
    };
    let [height, width, channels] = target;
    let result = empty(&from, [batch, height, width, channels]);
    let across = if channels > 2 * SIDE { 4 } else { 2 };
    let (pixels, columns) = (batch * height * width, channels.div_ceil(SIDE * across));
    let large = pixels.div_ceil(2 * ROWS);
    let own = if large * columns >= MANY {
        2 * OWN
    } else {
        OWN
    };
    multiply_patches::launch(
        &from.client,
        tiles(pixels.div_ceil(SIDE * own), columns),
        cube(),
        from.clone().into_buffer_arg(),
        weights.into_buffer_arg(),
        result.clone().into_buffer_arg(),
        source[0] as u32,
        source[1] as u32,
        source[2] as u32,
        height as u32,
        width as u32,
        channels as u32,
        taps as u32,
        spec.stride as u32,
        spec.padding as u32,
        spec.dilation as u32,
        own,
        across,
        back,
    );
    result
}

/// Computes the gradient `[out, in, taps, taps]` of weights: sums over parts of all pixels, then the sum of the parts.
fn of_weights(x: Floats, grad: Floats, geometry: Geometry) -> Floats {
    let Geometry {
        batch, taps, spec, ..
    } = geometry;
    let ([height, width, inputs], [rows, columns, outputs]) = (geometry.input, geometry.output);
    let pixels = batch * rows * columns;
    let across = if outputs > 2 * SIDE { 4 } else { 2 };
    let places = [inputs.div_ceil(ROWS), outputs.div_ceil(SIDE * across)];
    let per_part = places[0] * places[1] * taps * taps;
    let count = ENOUGH.div_ceil(per_part).min(pixels.div_ceil(PART));
    let part = pixels.div_ceil(count).next_multiple_of(DEPTH);
    let count = pixels.div_ceil(part);
    let parts = empty(&x, [count, taps, taps, inputs, outputs]);
    multiply_by_patches::launch(
        &x.client,
        CubeCount::Static(
            (places[0] * places[1]) as u32,
            (taps * taps) as u32,
            count as u32,
        ),
        cube(),
        x.clone().into_buffer_arg(),
        grad.into_buffer_arg(),
        parts.clone().into_buffer_arg(),
        height as u32,
        width as u32,
        inputs as u32,
        rows as u32,
        columns as u32,
        outputs as u32,
        taps as u32,
        spec.stride as u32,
        spec.padding as u32,
        spec.dilation as u32,
        pixels as u32,
        part as u32,
        across,
    );
    let result = empty(&x, [outputs, inputs, taps, taps]);
    sum_weights::launch(
        &x.client,
        cubes(&x, result.meta.num_elements()),
        cube(),
        parts.into_buffer_arg(),
        result.clone().into_buffer_arg(),
        inputs as u32,
        outputs as u32,
    );
    result
}

/// Sums `parts [parts, taps, taps, inputs, outputs]` to `result [outputs, inputs, taps, taps]`.
#[cube(launch)]
fn sum_weights(parts: &[f32], result: &mut [f32], inputs: u32, outputs: u32) {
    let (inputs, outputs) = (inputs as usize, outputs as usize);
    let count = result.len();
    if ABSOLUTE_POS < count {
        let mut total = 0.0f32;
        let mut at = ABSOLUTE_POS;
        while at < parts.len() {
            total += parts[at];
            at += count;
        }
        let output = ABSOLUTE_POS % outputs;
        let input = ABSOLUTE_POS / outputs % inputs;
        let tap = ABSOLUTE_POS / outputs / inputs;
        result[(output * inputs + input) * (count / inputs / outputs) + tap] = total;
    }
}

/// Returns the index along an axis of an input of `length` read by a tap of output `at`; `length` if outside.
#[cube]
fn input_of(
    at: usize,
    tap: usize,
    length: usize,
    stride: usize,
    padding: usize,
    dilation: usize,
) -> usize {
    let place = at * stride + tap * dilation;
    let mut found = length;
    if place >= padding && place - padding < length {
        found = place - padding;
    }
    found
}

/// Returns the index of the output, of `length` along an axis, that reads input `at` by a tap; `length` if there is none.
#[cube]
fn output_of(
    at: usize,
    tap: usize,
    length: usize,
    stride: usize,
    padding: usize,
    dilation: usize,
) -> usize {
    let place = at + padding;
    let mut found = length;
    if place >= tap * dilation {
        let place = place - tap * dilation;
        let output = place / stride;
        if output * stride == place && output < length {
            found = output;
        }
    }
    found
}

/// Returns the index along an axis of the pixel multiplied by a tap for the result at `at`: an input pixel for an output, or,
/// if `back`, an output pixel for the gradient of an input.
#[cube]
fn source_of(
    at: usize,
    tap: usize,
    length: usize,
    stride: usize,
    padding: usize,
    dilation: usize,
    #[comptime] back: bool,
) -> usize {
    if comptime!(back) {
        output_of(at, tap, length, stride, padding, dilation)
    } else {
        input_of(at, tap, length, stride, padding, dilation)
    }
}

/// Values that are read at once.
type Values = Vector<f32, Const<WIDTH>>;

/// Returns the initial sums of a unit, `[own, across]`.
#[cube]
fn zeros(#[comptime] own: usize, #[comptime] across: usize) -> Array<f32> {
    let mut sums = Array::<f32>::new(comptime!(own * across));
    #[unroll]
    for i in 0..comptime!(own * across) {
        sums[i] = 0.0f32;
    }
    sums
}

/// Computes `result [pixels, outputs]`: the patches of `x [batch, source_height, source_width, channels]` times `weights [taps,
/// taps, outputs, channels]`; pixels are those of `[batch, height, width]`. A unit has `own` rows of a tile, and every
/// [`SIDE`]-th column.
#[cube(launch)]
fn multiply_patches(
    x: &[f32],
    weights: &[f32],
    result: &mut [f32],
    source_height: u32,
    source_width: u32,
    channels: u32,
    height: u32,
    width: u32,
    outputs: u32,
    taps: u32,
    stride: u32,
    padding: u32,
    dilation: u32,
    #[comptime] own: usize,
    #[comptime] across: usize,
    #[comptime] back: bool,
) {
    let (source_height, source_width) = (source_height as usize, source_width as usize);
    let (height, width) = (height as usize, width as usize);
    let (channels, outputs) = (channels as usize, outputs as usize);
    let (taps, stride) = (taps as usize, stride as usize);
    let (padding, dilation) = (padding as usize, dilation as usize);
    let rows = comptime!(SIDE * own);
    let wide = comptime!(SIDE * across);
    let unit = UNIT_POS_X as usize;
    let first_row = tile() * rows;
    let first_column = CUBE_POS_Y as usize * wide;
    let pixels = result.len() / outputs;

    // Four units load the channels of one pixel or output.
    let loaded = unit / WIDTH;
    let group = unit % WIDTH;
    let row = unit / SIDE * own;
    let column = unit % SIDE;
    let mut left = Shared::<[Values]>::new_slice(comptime!(SIDE * own * VECTORS));
    let mut right = Shared::<[Values]>::new_slice(comptime!(SIDE * across * VECTORS));
    let mut sums = zeros(own, across);
    for tap in 0..taps * taps {
        let (down, along) = (tap / taps, tap % taps);
        let mut from = 0usize;
        while from < channels {
            let channel = from + group * WIDTH;
            #[unroll]
            for i in 0..comptime!(own / WIDTH) {
                let place = loaded + i * ROWS;
                let pixel = first_row + place;
                let (at_y, image) = (pixel / width % height, pixel / width / height);
                let y = source_of(at_y, down, source_height, stride, padding, dilation, back);
                let at = source_of(
                    pixel % width,
                    along,
                    source_width,
                    stride,
                    padding,
                    dilation,
                    back,
                );
                let inside = pixel < pixels && y < source_height && at < source_width;
                let base = ((image * source_height + y) * source_width + at) * channels;
                left[place * VECTORS + group] = values_of(x, base, channel, channels, inside);
            }
            if loaded < wide {
                let output = first_column + loaded;
                let base = (tap * outputs + output) * channels;
                right[loaded * VECTORS + group] =
                    values_of(weights, base, channel, channels, output < outputs);
            }
            sync_cube();
            #[unroll]
            for k in 0..comptime!(DEPTH / WIDTH) {
                #[unroll]
                for j in 0..across {
                    let b = right[(column + j * SIDE) * VECTORS + k];
                    #[unroll]
                    for i in 0..own {
                        let a = left[(row + i) * VECTORS + k];
                        #[unroll]
                        for c in 0..WIDTH {
                            sums[i * across + j] += a.extract(c) * b.extract(c);
                        }
                    }
                }
            }
            sync_cube();
            from += DEPTH;
        }
    }
    #[unroll]
    for i in 0..own {
        let pixel = first_row + row + i;
        #[unroll]
        for j in 0..across {
            let output = first_column + column + j * SIDE;
            if pixel < pixels && output < outputs {
                result[pixel * outputs + output] = sums[i * across + j];
            }
        }
    }
}

/// Returns the values of the channels from `channel` on, after `base`; 0 beyond the last one and if not `inside`.
#[cube]
fn values_of(from: &[f32], base: usize, channel: usize, channels: usize, inside: bool) -> Values {
    let mut values = Values::new(0.0f32);
    #[unroll]
    for i in 0..WIDTH {
        if inside && channel + i < channels {
            values.insert(i, from[base + channel + i]);
        }
    }
    values
}

/// Computes `parts [parts, taps, taps, inputs, outputs]`, each over a part of the `pixels` of `grad [pixels, outputs]`: the
/// transposed patches of `x [batch, source_height, source_width, inputs]` times `grad`.
#[cube(launch)]
fn multiply_by_patches(
    x: &[f32],
    grad: &[f32],
    parts: &mut [f32],
    source_height: u32,
    source_width: u32,
    inputs: u32,
    height: u32,
    width: u32,
    outputs: u32,
    taps: u32,
    stride: u32,
    padding: u32,
    dilation: u32,
    pixels: u32,
    part: u32,
    #[comptime] across: usize,
) {
    let (source_height, source_width) = (source_height as usize, source_width as usize);
    let (height, width) = (height as usize, width as usize);
    let (inputs, outputs) = (inputs as usize, outputs as usize);
    let (taps, stride) = (taps as usize, stride as usize);
    let (padding, dilation) = (padding as usize, dilation as usize);
    let (pixels, part) = (pixels as usize, part as usize);
    let wide = comptime!(SIDE * across);
    let unit = UNIT_POS_X as usize;
    let tap = CUBE_POS_Y as usize;
    let number = CUBE_POS_Z as usize;
    let columns = outputs.div_ceil(wide);
    let first_row = CUBE_POS_X as usize / columns * ROWS;
    let first_column = CUBE_POS_X as usize % columns * wide;
    let last = clamp_max((number + 1) * part, pixels);

    // Sixteen units load the channels of one pixel.
    let loaded = unit / SIDE;
    let lane = unit % SIDE;
    let row = loaded * OWN;
    let mut left = Shared::<[Values]>::new_slice(DEPTH * SIDE);
    let mut right = Shared::<[f32]>::new_slice(comptime!(DEPTH * SIDE * across));
    let mut sums = zeros(OWN, across);
    let mut first = number * part;
    while first < last {
        let pixel = first + loaded;
        let y = input_of(
            pixel / width % height,
            tap / taps,
            source_height,
            stride,
            padding,
            dilation,
        );
        let at = input_of(
            pixel % width,
            tap % taps,
            source_width,
            stride,
            padding,
            dilation,
        );
        let image = pixel / width / height;
        let inside = pixel < last && y < source_height && at < source_width;
        let base = ((image * source_height + y) * source_width + at) * inputs;
        left[unit] = values_of(x, base, first_row + lane * OWN, inputs, inside);
        #[unroll]
        for i in 0..across {
            let output = first_column + lane + i * SIDE;
            let mut value = 0.0f32;
            if pixel < last && output < outputs {
                value = grad[pixel * outputs + output];
            }
            right[loaded * wide + lane + i * SIDE] = value;
        }
        sync_cube();
        #[unroll]
        for k in 0..DEPTH {
            let a = left[k * SIDE + loaded];
            #[unroll]
            for j in 0..across {
                let b = right[k * wide + lane + j * SIDE];
                #[unroll]
                for i in 0..OWN {
                    sums[i * across + j] += a.extract(i) * b;
                }
            }
        }
        sync_cube();
        first += DEPTH;
    }
    #[unroll]
    for i in 0..OWN {
        let input = first_row + row + i;
        #[unroll]
        for j in 0..across {
            let output = first_column + lane + j * SIDE;
            if input < inputs && output < outputs {
                let place = (number * taps * taps + tap) * inputs + input;
                parts[place * outputs + output] = sums[i * across + j];
            }
        }
    }
}
