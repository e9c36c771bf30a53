// Tokens after some blocks, each normalised (Ba, Kiros and Hinton 2016), side by side: one group of units for each token.
//
// Before this text stand UNITS, PARTS and EPSILON.

struct Parameters {
    // Offset, height, width, quads.
    output: vec4u,
    // Offsets of gain and shift in the weights.
    norm: vec4u,
    // Offset, height, width, quads.
    inputs: array<vec4u, PARTS>,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(1) var<storage, read> weights: array<vec4f>;
@group(0) @binding(2) var<uniform> p: Parameters;

var<workgroup> partial: array<f32, UNITS>;

// The sum of the values of all units.
fn total(value: f32, unit: u32) -> f32 {
    partial[unit] = value;
    workgroupBarrier();
    for (var half = UNITS / 2u; half > 0u; half /= 2u) {
        if (unit < half) {
            partial[unit] += partial[unit + half];
        }
        workgroupBarrier();
    }
    let sum = partial[0];
    workgroupBarrier();
    return sum;
}

@compute @workgroup_size(UNITS)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) unit: u32) {
    let quads = p.inputs[group.y].w;
    let first = p.inputs[group.y].x + group.x * quads;
    var sum = 0.0;
    for (var k = unit; k < quads; k += UNITS) {
        sum += dot(maps[first + k], vec4f(1.0));
    }
    let mean = total(sum, unit) / f32(4u * quads);
    sum = 0.0;
    for (var k = unit; k < quads; k += UNITS) {
        let difference = maps[first + k] - mean;
        sum += dot(difference, difference);
    }
    let scale = 1.0 / sqrt(total(sum, unit) / f32(4u * quads) + EPSILON);
    let to = p.output.x + group.x * p.output.w + group.y * quads;
    for (var k = unit; k < quads; k += UNITS) {
        let value = (maps[first + k] - mean) * scale;
        maps[to + k] = value * weights[p.norm.x + k] + weights[p.norm.y + k];
    }
}
