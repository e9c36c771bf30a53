// A map read in another form, pixel by pixel and quad by quad.
//
// Before this text stand UNITS and FORM (what the output is).

// Enlarged bilinearly, with the centres of the corner pixels in those of the corners.
const CORNERS = 0u;
// Without negative values.
const RECTIFIED = 1u;
// Plus another map of its size.
const SUM = 2u;
// Each pixel holds `[row, column, channel]` of a block of pixels.
const BLOCKS = 3u;
// The first channel alone, of four pixels in a quad.
const PACKED = 4u;

struct Parameters {
    // Offset, height, width, quads.
    input: vec4u,
    output: vec4u,
    // The offset of the other map, or the side of blocks.
    other: vec4u,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(2) var<uniform> p: Parameters;

fn cornered(pixel: vec2u, quad: u32) -> vec4f {
    let last = p.input.yz - 1u;
    let steps = max(p.output.yz - 1u, vec2u(1u));
    // In integers, as far as it goes: what coincides has no share of its neighbour.
    let low = pixel * last / steps;
    let high = min(low + 1u, last);
    let share = vec2f(pixel * last % steps) / vec2f(steps);
    let upper = p.input.x + low.x * p.input.z * p.input.w + quad;
    let lower = p.input.x + high.x * p.input.z * p.input.w + quad;
    let left = mix(maps[upper + low.y * p.input.w], maps[lower + low.y * p.input.w], share.x);
    let right = mix(maps[upper + high.y * p.input.w], maps[lower + high.y * p.input.w], share.x);
    return mix(left, right, share.y);
}

@compute @workgroup_size(UNITS)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) unit: u32,
) {
    let index = (group.y * groups.x + group.x) * UNITS + unit;
    let pixel = index / p.output.w;
    let quad = index % p.output.w;
    if (pixel >= p.output.y * p.output.z) {
        return;
    }
    let at = vec2u(pixel / p.output.z, pixel % p.output.z);
    var value = vec4f(0.0);
    if (FORM == CORNERS) {
        value = cornered(at, quad);
    } else if (FORM == RECTIFIED) {
        value = max(maps[p.input.x + index], vec4f(0.0));
    } else if (FORM == SUM) {
        value = maps[p.input.x + index] + maps[p.other.x + index];
    } else if (FORM == BLOCKS) {
        let side = p.other.x;
        let coarse = at / side;
        let place = at.x % side * side + at.y % side;
        value = maps[p.input.x + (coarse.x * p.input.z + coarse.y) * p.input.w + place * p.output.w + quad];
    } else {
        let end = p.input.y * p.input.z - 1u;
        for (var i = 0u; i < 4u; i++) {
            value[i] = maps[p.input.x + min(4u * index + i, end) * p.input.w].x;
        }
    }
    maps[p.output.x + index] = value;
}
