// Means of a map over windows of several sizes, cut off at the end: one group of units for each window and quad.

struct Parameters {
    // Offset, height, width, quads.
    input: vec4u,
    // Offset, height, width of the means, and side of the windows.
    pools: array<vec4u, PARTS>,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(2) var<uniform> p: Parameters;

var<workgroup> sums: array<vec4f, UNITS>;

@compute @workgroup_size(UNITS)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) unit: u32) {
    let pool = p.pools[group.z];
    if (group.x >= pool.y * pool.z) {
        return;
    }
    let start = vec2u(group.x / pool.z, group.x % pool.z) * pool.w;
    let size = min(vec2u(pool.w), p.input.yz - start);
    var sum = vec4f(0.0);
    for (var i = unit; i < size.x * size.y; i += UNITS) {
        let at = start + vec2u(i / size.y, i % size.y);
        sum += maps[p.input.x + (at.x * p.input.z + at.y) * p.input.w + group.y];
    }
    sums[unit] = sum;
    workgroupBarrier();
    for (var half = UNITS / 2u; half > 0u; half /= 2u) {
        if (unit < half) {
            sums[unit] += sums[unit + half];
        }
        workgroupBarrier();
    }
    if (unit == 0u) {
        maps[pool.x + group.x * p.input.w + group.y] = sums[0] / f32(size.x * size.y);
    }
}
