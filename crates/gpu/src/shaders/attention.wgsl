// Attention softmax(Q K' / sqrt(depth)) V of one head for QUERIES tokens. No score is stored: a unit holds a query, and what it
// has attended to so far, relative to its largest score (Milakov and Gimelshein 2018). Four units share a query, each of which
// reads every fourth run of four keys.
//
// Before this text stand UNITS, DEPTH (quads of a head) and SCALE (1 / sqrt(depth)).

const SPLITS = 4u;
const KEYS = 4u;
const QUERIES = UNITS / SPLITS;
// Of keys; as many of values follow.
const TILE = SPLITS * KEYS * DEPTH;
// Below every score.
const LEAST = -1e30;

struct Parameters {
    // Offset, height, width, quads of queries, keys and values `[tokens, 3, heads, depth]`.
    rows: vec4u,
    // Of what is attended to, `[tokens, heads, depth]`.
    output: vec4u,
}

@group(0) @binding(0) var<storage, read_write> maps: array<vec4f>;
@group(0) @binding(2) var<uniform> p: Parameters;

// As large as the sums of one split.
var<workgroup> tile: array<vec4f, 2u * TILE>;
// Of a split: the largest score, and the sum of exponentials relative to it.
var<workgroup> totals: array<vec2f, QUERIES>;

@compute @workgroup_size(UNITS)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) unit: u32) {
    let tokens = p.rows.y * p.rows.z;
    let width = p.output.w;
    let local = unit % QUERIES;
    let split = unit / QUERIES;
    let query = group.x * QUERIES + local;
    let head = group.y * DEPTH;
    var q: array<vec4f, DEPTH>;
    var sums: array<vec4f, DEPTH>;
    for (var k = 0u; k < DEPTH; k++) {
        q[k] = SCALE * maps[p.rows.x + min(query, tokens - 1u) * 3u * width + head + k];
    }
    var largest = LEAST;
    var total = 0.0;
    for (var start = 0u; start < tokens; start += SPLITS * KEYS) {
        for (var i = unit; i < TILE; i += UNITS) {
            let key = min(start + i / DEPTH, tokens - 1u);
            let at = p.rows.x + key * 3u * width + head + i % DEPTH;
            tile[i] = maps[at + width];
            tile[TILE + i] = maps[at + 2u * width];
        }
        workgroupBarrier();
        let first = split * KEYS * DEPTH;
        var scores = vec4f(0.0);
        for (var k = 0u; k < DEPTH; k++) {
            let x = q[k];
            scores.x += dot(x, tile[first + k]);
            scores.y += dot(x, tile[first + DEPTH + k]);
            scores.z += dot(x, tile[first + 2u * DEPTH + k]);
            scores.w += dot(x, tile[first + 3u * DEPTH + k]);
        }
        let keys = start + split * KEYS + vec4u(0u, 1u, 2u, 3u);
        scores = select(vec4f(LEAST), scores, keys < vec4u(tokens));
        let next = max(largest, max(max(scores.x, scores.y), max(scores.z, scores.w)));
        let factor = exp(largest - next);
        // A split without keys adds ones to LEAST, which count nothing beside any score.
        let shares = exp(scores - next);
        total = total * factor + shares.x + shares.y + shares.z + shares.w;
        for (var k = 0u; k < DEPTH; k++) {
            let value = TILE + first + k;
            sums[k] = sums[k] * factor
                + shares.x * tile[value] + shares.y * tile[value + DEPTH]
                + shares.z * tile[value + 2u * DEPTH] + shares.w * tile[value + 3u * DEPTH];
        }
        largest = next;
        workgroupBarrier();
    }
    // The splits are added to the first, one after the other.
    for (var other = 1u; other < SPLITS; other++) {
        if (split == other) {
            for (var k = 0u; k < DEPTH; k++) {
                tile[k * QUERIES + local] = sums[k];
            }
            totals[local] = vec2f(largest, total);
        }
        workgroupBarrier();
        if (split == 0u) {
            let next = max(largest, totals[local].x);
            let factor = exp(largest - next);
            let share = exp(totals[local].x - next);
            total = total * factor + share * totals[local].y;
            for (var k = 0u; k < DEPTH; k++) {
                sums[k] = sums[k] * factor + share * tile[k * QUERIES + local];
            }
            largest = next;
        }
        workgroupBarrier();
    }
    if (split == 0u && query < tokens) {
        for (var k = 0u; k < DEPTH; k++) {
            maps[p.output.x + query * width + head + k] = sums[k] / total;
        }
    }
}
