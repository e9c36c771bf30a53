// The channels of several maps, each enlarged bilinearly to the size of the output.

struct Parameters {
    // Offset, height, width, quads.
    output: vec4u,
    // The first quad of the output, and the number of maps.
    part: vec4u,
    // Offset, height, width, quads.
    inputs: array<vec4u, PARTS>,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(2) var<uniform> p: Parameters;

fn bilinear(map: vec4u, pixel: vec2u, quad: u32) -> vec4f {
    let last = vec2f(map.yz - 1u);
    let scale = vec2f(map.yz) / vec2f(p.output.yz);
    let position = clamp((vec2f(pixel) + 0.5) * scale - 0.5, vec2f(0.0), last);
    let low = vec2u(position);
    let high = min(low + 1u, map.yz - 1u);
    let share = position - vec2f(low);
    let upper = map.x + low.x * map.z * map.w + quad;
    let lower = map.x + high.x * map.z * map.w + quad;
    let top = mix(maps[upper + low.y * map.w], maps[upper + high.y * map.w], share.y);
    let bottom = mix(maps[lower + low.y * map.w], maps[lower + high.y * map.w], share.y);
    return mix(top, bottom, share.x);
}

@compute @workgroup_size(UNITS)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) unit: u32,
) {
    let index = (group.y * groups.x + group.x) * UNITS + unit;
    var count = 0u;
    for (var i = 0u; i < p.part.y; i++) {
        count += p.inputs[i].w;
    }
    let pixel = index / count;
    if (pixel >= p.output.y * p.output.z) {
        return;
    }
    var quad = index % count;
    let target_quad = p.part.x + quad;
    var i = 0u;
    while (quad >= p.inputs[i].w) {
        quad -= p.inputs[i].w;
        i++;
    }
    let at = vec2u(pixel / p.output.z, pixel % p.output.z);
    maps[p.output.x + pixel * p.output.w + target_quad] = bilinear(p.inputs[i], at, quad);
}
