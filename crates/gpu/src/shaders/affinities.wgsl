// The affinities of each pixel with its right and lower neighbour, those of two pixels in a quad:
// a = 1 / (1 + (dC / CONTRAST)^2) + LEAST_AFFINITY from colours, and e^f a^(1 + g) with the changes (f, g) of the network.

const NONE = 0xffffffffu;

struct Parameters {
    // Offset, height, width of the image, and the offset of the changes.
    image: vec4u,
    // The offset of the affinities.
    output: vec4u,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(2) var<uniform> p: Parameters;

fn affinity(pixel: u32, other: u32) -> f32 {
    let difference = maps[p.image.x + pixel].xyz - maps[p.image.x + other].xyz;
    let contrast = dot(difference, difference) / (CONTRAST * CONTRAST);
    return 1.0 / (1.0 + contrast) + LEAST_AFFINITY;
}

fn affinities(pixel: u32) -> vec2f {
    let width = p.image.z;
    let right = select(pixel + 1u, pixel, pixel % width + 1u == width);
    let below = select(pixel + width, pixel, pixel / width + 1u == p.image.y);
    let found = vec2f(affinity(pixel, right), affinity(pixel, below));
    if (p.image.w == NONE) {
        return found;
    }
    let changes = maps[p.image.w + pixel];
    let factors = clamp(changes.xy, vec2f(-MAX_LOG_FACTOR), vec2f(MAX_LOG_FACTOR));
    let exponents = 1.0 + clamp(changes.zw, vec2f(-1.0), vec2f(1.0));
    return exp(log(found) * exponents + factors);
}

@compute @workgroup_size(UNITS)
fn main(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) unit: u32,
) {
    let pixels = p.image.y * p.image.z;
    let index = (group.y * groups.x + group.x) * UNITS + unit;
    let pixel = 2u * index;
    if (pixel < pixels) {
        let second = affinities(min(pixel + 1u, pixels - 1u));
        maps[p.output.x + index] = vec4f(affinities(pixel), second);
    }
}
