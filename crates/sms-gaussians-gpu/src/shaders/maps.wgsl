// Rendered channels that are not blended: median depth and most likely label (sms-gaussians,
// cpu/median.rs). Nine values per pixel, row by row: colour 3, opacity, depth, normal 3, label.

@group(0) @binding(0) var<storage, read> records: array<vec4f>;
@group(0) @binding(1) var<storage, read> lists: array<vec2u>;
@group(0) @binding(2) var<storage, read> pairs: array<vec2u>;
@group(0) @binding(3) var<storage, read> used: array<u32>;
@group(0) @binding(4) var<storage, read> image: array<vec4f>;
@group(0) @binding(5) var<uniform> classifier: array<vec4f, CLASSIFIER_VECTORS>;
@group(0) @binding(6) var<storage, read_write> maps: array<f32>;

const B1 = 128u;
const W2 = 136u;
const B2 = W2 + 8u * CLASSES;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = group.x + group.y * MAX_GROUPS;
    if (tile >= u.size.z * u.size.w) { return; }
    let pixel = tile_corner(tile) + vec2u(lane % TILE, lane / TILE);
    if (any(pixel >= u.size.xy)) { return; }
    let o = tile * 6u * TILE_PIXELS + lane;
    let color = image[o];
    let normal = image[o + TILE_PIXELS];
    let center = vec2f(pixel) + 0.5;
    let first = lists[tile].x;
    let n = used[tile];
    let half = 1.0 - 0.5 * normal.w;
    var transmittance = 1.0;
    var depth = 0.0;
    for (var k = 0u; k < n; k++) {
        let record = 4u * pairs[first + k].x;
        let r0 = records[record];
        let r1 = records[record + 1u];
        let d = center - r0.xy;
        let a = alpha_at(r0, r1, d);
        if (a.enough && transmittance > TRANSMITTANCE_MIN) {
            let after = transmittance - a.value * transmittance;
            if (transmittance > half && half >= after) {
                depth = records[record + 2u].w + r1.z * d.x + r1.w * d.y;
            }
            transmittance = after;
        }
    }
    var h: array<vec4f, 8>;
    for (var j = 0u; j < 8u; j++) {
        var v = classifier[B1 + j];
        for (var i = 0u; i < 4u; i++) {
            for (var q = 0u; q < 4u; q++) {
                v[i] += dot(classifier[16u * j + 4u * i + q], image[o + (2u + q) * TILE_PIXELS]);
            }
        }
        h[j] = max(v, vec4f(0.0));
    }
    var best = 0u;
    var largest = 0.0;
    for (var k = 0u; k < CLASSES; k++) {
        var logit = classifier[B2 + k / 4u][k % 4u];
        for (var j = 0u; j < 8u; j++) { logit += dot(classifier[W2 + 8u * k + j], h[j]); }
        if (k == 0u || logit > largest) {
            largest = logit;
            best = k;
        }
    }
    let m = 9u * (pixel.y * u.size.x + pixel.x);
    maps[m] = color.x;
    maps[m + 1u] = color.y;
    maps[m + 2u] = color.z;
    maps[m + 3u] = normal.w;
    maps[m + 4u] = depth;
    maps[m + 5u] = normal.x;
    maps[m + 6u] = normal.y;
    maps[m + 7u] = normal.z;
    maps[m + 8u] = f32(best);
}
