// The MLP at places of an image. A group computes PLACES of them, layer by layer in its own memory; then the functions there,
// or their sum with weights, for which no function is formed.
//
// Before this text stand UNITS, PLACES, WIDTH (quads of the widest hidden layer), LAYERS (hidden layers after the first), SUM
// (whether weights are summed with) and FIRST (what the first function is).

const CONSTANT = 0u;
// Its logarithm is linear in the last hidden layer.
const HIDDEN = 1u;
// The features contain its logarithm.
const EXTRACTED = 2u;

const GROUPS = min(PLACES, 8u);
const COLUMNS = UNITS / GROUPS;
const LANES = UNITS / PLACES;

struct Parameters {
    // Height, width and quads of the features, and the offset of the logarithm.
    features: vec4u,
    // The number of places, and height and width of the image.
    places: vec4u,
    // Offsets of the weights of codes, of the bias of the first layer, of the last layer, and of the first function.
    head: vec4u,
    // The number of functions, of octaves, and quads of functions and of the last hidden layer.
    sizes: vec4u,
    // Of each hidden layer after the first: offsets of weights and bias, quads of inputs and outputs.
    layers: array<vec4u, max(LAYERS, 1u)>,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(1) var<storage, read> weights: array<vec4f>;
@group(0) @binding(2) var<uniform> p: Parameters;
// Of each place: row and column on the features, then the codes of its column and of its row. For sums: the weight of the first
// function, then those of the last hidden layer.
@group(0) @binding(3) var<storage, read> input: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> output: array<f32>;
// For sums: the first layer on the codes of all rows, then on those of all columns, with the bias.
@group(0) @binding(5) var<storage, read> grid: array<vec4f>;

// Two buffers, from one to the other with each layer.
var<workgroup> activations: array<vec4f, 2u * PLACES * WIDTH>;

// Row and column on the features.
fn position(place: u32) -> vec2f {
    if (!SUM) {
        return input[place * (1u + p.sizes.y)].xy;
    }
    let pixel = vec2f(vec2u(place / p.places.z, place % p.places.z));
    let scale = vec2f(p.features.xy) / vec2f(p.places.yz);
    return clamp((pixel + 0.5) * scale - 0.5, vec2f(0.0), vec2f(p.features.xy - 1u));
}

fn bilinear(offset: u32, quads: u32, place: u32, quad: u32) -> vec4f {
    let position = position(place);
    let low = vec2u(position);
    let high = min(low + 1u, p.features.xy - 1u);
    let share = position - vec2f(low);
    let upper = offset + low.x * p.features.y * quads + quad;
    let lower = offset + high.x * p.features.y * quads + quad;
    let top = mix(maps[upper + low.y * quads], maps[upper + high.y * quads], share.y);
    let bottom = mix(maps[lower + low.y * quads], maps[lower + high.y * quads], share.y);
    return mix(top, bottom, share.x);
}

// What the first layer adds for the position.
fn coded(place: u32, quad: u32) -> vec4f {
    let width = p.features.z;
    if (SUM) {
        let row = place / p.places.z;
        let column = p.places.y + place % p.places.z;
        return grid[row * width + quad] + grid[column * width + quad];
    }
    var sum = weights[p.head.y + quad];
    for (var i = 0u; i < p.sizes.y; i++) {
        let codes = input[place * (1u + p.sizes.y) + 1u + i];
        let first = p.head.x + 4u * i * width + quad;
        sum += codes.x * weights[first] + codes.y * weights[first + width];
        sum += codes.z * weights[first + 2u * width] + codes.w * weights[first + 3u * width];
    }
    return sum;
}

// A quad of a product of the activations of a place and weights.
fn product(activation: u32, inputs: u32, offset: u32, quads: u32, quad: u32) -> vec4f {
    var sum = vec4f(0.0);
    for (var k = 0u; k < inputs; k++) {
        let value = activations[activation + k];
        let first = offset + 4u * k * quads + quad;
        sum += value.x * weights[first] + value.y * weights[first + quads];
        sum += value.z * weights[first + 2u * quads] + value.w * weights[first + 3u * quads];
    }
    return sum;
}

fn first_function(place: u32, logarithm: f32) -> f32 {
    var value = logarithm;
    if (FIRST == CONSTANT) {
        return 1.0;
    }
    if (FIRST == EXTRACTED) {
        value = bilinear(p.features.w, 1u, place, 0u).x;
    }
    return exp(clamp(value, -MAX_LOG_DEPTH, MAX_LOG_DEPTH));
}

@compute @workgroup_size(UNITS)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) unit: u32,
) {
    let first = (group.y * groups.x + group.x) * PLACES;
    for (var i = unit; i < PLACES * p.features.z; i += UNITS) {
        let place = min(first + i / p.features.z, p.places.x - 1u);
        let quad = i % p.features.z;
        let value = bilinear(0u, p.features.z, place, quad) + coded(place, quad);
        activations[i / p.features.z * WIDTH + quad] = max(value, vec4f(0.0));
    }
    workgroupBarrier();
    var from_half = 0u;
    for (var layer = 0u; layer < LAYERS; layer++) {
        let sizes = p.layers[layer];
        let to_half = PLACES * WIDTH - from_half;
        for (var quad = unit % COLUMNS; quad < sizes.w; quad += COLUMNS) {
            let bias = weights[sizes.y + quad];
            for (var i = unit / COLUMNS; i < PLACES; i += GROUPS) {
                let sum = product(from_half + i * WIDTH, sizes.z, sizes.x, sizes.w, quad);
                activations[to_half + i * WIDTH + quad] = max(sum + bias, vec4f(0.0));
            }
        }
        workgroupBarrier();
        from_half = to_half;
    }
    if (!SUM) {
        let functions = p.sizes.x;
        for (var quad = unit % COLUMNS; quad < p.sizes.z; quad += COLUMNS) {
            for (var i = unit / COLUMNS; i < PLACES && first + i < p.places.x; i += GROUPS) {
                let place = first + i;
                var values = product(from_half + i * WIDTH, p.sizes.w, p.head.z, p.sizes.z, quad);
                if (quad == 0u) {
                    values.x = first_function(place, values.x);
                }
                for (var j = 0u; j < min(4u, functions - 4u * quad); j++) {
                    output[place * functions + 4u * quad + j] = values[j];
                }
            }
        }
        return;
    }
    // The sum, and the logarithm of the first function.
    let i = unit / LANES;
    let lane = unit % LANES;
    var sums = vec2f(0.0);
    for (var k = lane; k < p.sizes.w; k += LANES) {
        let value = activations[from_half + i * WIDTH + k];
        sums.x += dot(value, input[1u + k]);
        if (FIRST == HIDDEN) {
            sums.y += dot(value, weights[p.head.w + k]);
        }
    }
    workgroupBarrier();
    activations[unit] = vec4f(sums, 0.0, 0.0);
    workgroupBarrier();
    if (lane == 0u && first + i < p.places.x) {
        sums = vec2f(0.0);
        for (var k = 0u; k < LANES; k++) {
            sums += activations[unit + k].xy;
        }
        let place = first + i;
        output[place] = sums.x + input[0].x * first_function(place, sums.y);
    }
}
