// One tile of a convolution as a product of matrices: pixels x (taps x channels) times (taps x channels) x outputs, with all
// that follows a layer. Offsets count quads, which are the values of four channels.
//
// Before this text stand UNITS, PIXELS (of a tile), QUADS (of outputs of a tile), ROWS (pixels of a unit), DEPTH (quads of a
// step) and SOURCE (what the left matrix is).

const CONVOLVED = 0u;
// Each channel convolved alone, with its bias and ReLU; the product is a 1x1 convolution.
const DEPTHWISE = 1u;
// Enlarged bilinearly to the size of the output; the product is a 1x1 convolution.
const ENLARGED = 2u;

const NONE = 0xffffffffu;
const GROUPS = UNITS / QUADS;

struct Parameters {
    // Offset, height, width, quads.
    input: vec4u,
    output: vec4u,
    // Taps of a side, stride, padding, dilation: of the convolution, or of the one of each channel.
    window: vec4u,
    // Offsets of weights and bias, whether there is a ReLU, and weights of the convolution of each channel, before its bias.
    product: vec4u,
    // Offset, height, width: what is added, enlarged to the size of the output.
    skip: vec4u,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(1) var<storage, read> weights: array<vec4f>;
@group(0) @binding(2) var<uniform> p: Parameters;

var<workgroup> left: array<vec4f, PIXELS * DEPTH>;
var<workgroup> right: array<vec4f, 4u * DEPTH * QUADS>;

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

fn source(pixel: vec2u, k: u32) -> vec4f {
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
    let first = p.product.w + k;
    var sum = weights[first + taps * taps * p.input.w];
    for (var tap = 0u; tap < taps * taps; tap++) {
        let at = corner + vec2i(vec2u(tap / taps, tap % taps) * p.window.w);
        sum += weights[first + tap * p.input.w] * padded(at.x, at.y, k);
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
    for (var start = 0u; start < depth; start += DEPTH) {
        for (var i = unit; i < PIXELS * DEPTH; i += UNITS) {
            let k = start + i % DEPTH;
            let pixel = first + i / DEPTH;
            var value = vec4f(0.0);
            if (k < depth && pixel < pixels) {
                value = source(vec2u(pixel / p.output.z, pixel % p.output.z), k);
            }
            left[i % DEPTH * PIXELS + i / DEPTH] = value;
        }
        for (var i = unit; i < 4u * DEPTH * QUADS; i += UNITS) {
            let k = 4u * start + i / QUADS;
            let quad = first_quad + i % QUADS;
            var value = vec4f(0.0);
            if (k < 4u * depth && quad < outputs) {
                value = weights[p.product.x + k * outputs + quad];
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
                value += weights[p.product.y + quad];
            }
            if (p.skip.x != NONE) {
                let at = vec2u(pixel / p.output.z, pixel % p.output.z);
                value += bilinear(p.skip, at, outputs, quad);
            }
            if (p.product.z != 0u) {
                value = max(value, vec4f(0.0));
            }
            maps[p.output.x + pixel * outputs + quad] = value;
        }
    }
}
