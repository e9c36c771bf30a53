// One tile of a convolution as a product of matrices: pixels x (taps x channels) times (taps x channels) x outputs, with all
// that follows a layer. Offsets count quads, which are the values of four channels.
//
// Before this text stand UNITS, PIXELS (of a tile), QUADS (of outputs of a tile), ROWS (pixels of a unit), DEPTH (quads of a
// step), SOURCE (what the left matrix is), HALF (whether the right matrix is in f16) and EPSILON.

const CONVOLVED = 0u;
// Each channel convolved alone, with its bias and ReLU; the product is a 1x1 convolution.
const DEPTHWISE = 1u;
// Enlarged bilinearly to the size of the output; the product is a 1x1 convolution.
const ENLARGED = 2u;
// Each pixel normalised over its channels (Ba, Kiros and Hinton 2016); the product is a 1x1 convolution.
const NORMALISED = 3u;

const RELU = 1u;
const GELU = 2u;

const NONE = 0xffffffffu;
const GROUPS = UNITS / QUADS;
const LANES = UNITS / PIXELS;

struct Parameters {
    // Offset, height, width, quads.
    input: vec4u,
    output: vec4u,
    // Taps of a side, stride, padding, dilation: of the convolution, or of the one of each channel.
    window: vec4u,
    // Offsets of weights and bias, the activation, and weights of the convolution of each channel, before its bias.
    product: vec4u,
    // Offset, height, width: what is added, enlarged to the size of the output.
    skip: vec4u,
    // Offsets of the gain of the normalisation, whose shift follows, and of what the outputs are multiplied by.
    token: vec4u,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
// Quads of f32, or two quads of f16: their bits.
@group(0) @binding(1) var<storage, read> weights: array<vec4u>;
@group(0) @binding(2) var<uniform> p: Parameters;

var<workgroup> left: array<vec4f, PIXELS * DEPTH>;
var<workgroup> right: array<vec4f, 4u * DEPTH * QUADS>;
// Of each pixel that is normalised: the mean, and one over the standard deviation.
var<workgroup> moments: array<vec2f, PIXELS>;
var<workgroup> partial: array<f32, UNITS>;

fn weight(offset: u32) -> vec4f {
    return bitcast<vec4f>(weights[offset]);
}

// A quad of the right matrix.
fn factor(index: u32) -> vec4f {
    if (!HALF) {
        return weight(p.product.x + index);
    }
    let two = weights[p.product.x + index / 2u];
    let bits = select(two.xy, two.zw, index % 2u == 1u);
    return vec4f(unpack2x16float(bits.x), unpack2x16float(bits.y));
}

// Means and variances of the pixels of a tile; the units of a pixel sum over its channels in turns.
fn measure(first: u32, unit: u32) {
    let row = unit / LANES;
    let pixel = min(first + row, p.output.y * p.output.z - 1u);
    let quads = p.input.w;
    var mean = 0.0;
    var variance = 0.0;
    for (var moment = 0u; moment < 2u; moment++) {
        var sum = 0.0;
        for (var k = unit % LANES; k < quads; k += LANES) {
            let value = maps[p.input.x + pixel * quads + k] - mean;
            sum += select(dot(value, value), dot(value, vec4f(1.0)), moment == 0u);
        }
        partial[unit] = sum;
        workgroupBarrier();
        sum = 0.0;
        for (var i = 0u; i < LANES; i++) {
            sum += partial[row * LANES + i];
        }
        workgroupBarrier();
        if (moment == 0u) {
            mean = sum / f32(4u * quads);
        } else {
            variance = sum / f32(4u * quads);
        }
    }
    moments[row] = vec2f(mean, 1.0 / sqrt(variance + EPSILON));
    workgroupBarrier();
}

// x P(X <= x) of a standard normal X, to 1e-7 (Abramowitz and Stegun 1964, 7.1.26).
fn gelu(x: vec4f) -> vec4f {
    let z = abs(x) * 0.70710678;
    let t = 1.0 / (1.0 + 0.3275911 * z);
    var series = vec4f(1.0614054);
    series = series * t - 1.4531520;
    series = series * t + 1.4214138;
    series = series * t - 0.28449674;
    series = series * t + 0.25482960;
    let tail = 0.5 * series * t * exp(-z * z);
    return x * select(tail, 1.0 - tail, x > vec4f(0.0));
}

fn bilinear(map: vec4u, pixel: vec2u, quads: u32, quad: u32) -> vec4f {
    let last = vec2f(map.yz - 1u);
    let scale = vec2f(map.yz) / vec2f(p.output.yz);
    let position = clamp((vec2f(pixel) + 0.5) * scale - 0.5, vec2f(0.0), last);
    let low = vec2u(position);
    let high = min(low + 1u, map.yz - 1u);
    let share = position - vec2f(low);
    let upper = map.x + low.x * map.z * quads + quad;
    let lower = map.x + high.x * map.z * quads + quad;
    let top = mix(maps[upper + low.y * quads], maps[upper + high.y * quads], share.y);
    let bottom = mix(maps[lower + low.y * quads], maps[lower + high.y * quads], share.y);
    return mix(top, bottom, share.x);
}

// A quad of the input; zeros beyond its edges.
fn padded(row: i32, column: i32, quad: u32) -> vec4f {
    if (row < 0 || column < 0 || row >= i32(p.input.y) || column >= i32(p.input.z)) {
        return vec4f(0.0);
    }
    return maps[p.input.x + (u32(row) * p.input.z + u32(column)) * p.input.w + quad];
}

fn source(pixel: vec2u, row: u32, k: u32) -> vec4f {
    let taps = p.window.x;
    let corner = vec2i(pixel * p.window.y) - i32(p.window.z);
    if (SOURCE == CONVOLVED) {
        let tap = k / p.input.w;
        let at = corner + vec2i(vec2u(tap / taps, tap % taps) * p.window.w);
        return padded(at.x, at.y, k % p.input.w);
    }
    if (SOURCE == ENLARGED) {
        return bilinear(p.input, pixel, p.input.w, k);
    }
    if (SOURCE == NORMALISED) {
        let value = maps[p.input.x + (pixel.x * p.output.z + pixel.y) * p.input.w + k];
        let normalised = (value - moments[row].x) * moments[row].y;
        return normalised * weight(p.token.x + k) + weight(p.token.x + p.input.w + k);
    }
    let first = p.product.w + k;
    var sum = weight(first + taps * taps * p.input.w);
    for (var tap = 0u; tap < taps * taps; tap++) {
        let at = corner + vec2i(vec2u(tap / taps, tap % taps) * p.window.w);
        sum += weight(first + tap * p.input.w) * padded(at.x, at.y, k);
    }
    return max(sum, vec4f(0.0));
}

@compute @workgroup_size(UNITS)
fn main(@builtin(workgroup_id) tile: vec3u, @builtin(local_invocation_index) unit: u32) {
    let pixels = p.output.y * p.output.z;
    let outputs = p.output.w;
    let first = tile.x * PIXELS;
    let first_quad = tile.y * QUADS;
    var depth = p.input.w;
    if (SOURCE == CONVOLVED) {
        depth *= p.window.x * p.window.x;
    }
    let column = unit % QUADS;
    let group = unit / QUADS;
    var sums: array<vec4f, ROWS>;
    if (SOURCE == NORMALISED) {
        measure(first, unit);
    }
    for (var start = 0u; start < depth; start += DEPTH) {
        for (var i = unit; i < PIXELS * DEPTH; i += UNITS) {
            let k = start + i % DEPTH;
            let pixel = first + i / DEPTH;
            var value = vec4f(0.0);
            if (k < depth && pixel < pixels) {
                value = source(vec2u(pixel / p.output.z, pixel % p.output.z), i / DEPTH, k);
            }
            left[i % DEPTH * PIXELS + i / DEPTH] = value;
        }
        for (var i = unit; i < 4u * DEPTH * QUADS; i += UNITS) {
            let k = 4u * start + i / QUADS;
            let quad = first_quad + i % QUADS;
            var value = vec4f(0.0);
            if (k < 4u * depth && quad < outputs) {
                value = factor(k * outputs + quad);
            }
            right[i] = value;
        }
        workgroupBarrier();
        for (var k = 0u; k < DEPTH; k++) {
            let a = right[4u * k * QUADS + column];
            let b = right[(4u * k + 1u) * QUADS + column];
            let c = right[(4u * k + 2u) * QUADS + column];
            let d = right[(4u * k + 3u) * QUADS + column];
            for (var i = 0u; i < ROWS; i++) {
                let value = left[k * PIXELS + group + i * GROUPS];
                sums[i] += value.x * a + value.y * b + value.z * c + value.w * d;
            }
        }
        workgroupBarrier();
    }
    let quad = first_quad + column;
    if (quad >= outputs) {
        return;
    }
    for (var i = 0u; i < ROWS; i++) {
        let pixel = first + group + i * GROUPS;
        if (pixel < pixels) {
            var value = sums[i];
            if (p.product.y != NONE) {
                value += weight(p.product.y + quad);
            }
            if (p.token.y != NONE) {
                value *= weight(p.token.y + quad);
            }
            if (p.skip.x != NONE) {
                let at = vec2u(pixel / p.output.z, pixel % p.output.z);
                value += bilinear(p.skip, at, outputs, quad);
            }
            if (p.product.z == RELU) {
                value = max(value, vec4f(0.0));
            } else if (p.product.z == GELU) {
                value = gelu(value);
            }
            maps[p.output.x + pixel * outputs + quad] = value;
        }
    }
}
