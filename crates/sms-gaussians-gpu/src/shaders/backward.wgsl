// The gradient of blending without atomics (design, section 6), one tile per workgroup, a batch of splats at a time, in
// two passes. First each lane takes a pixel and replays the blending with two numbers, its transmittance and the
// remainder Σ w·s of the splats still to come, and notes of each splat its weight w and v = ∂L/∂(ln α) there. Then the
// sums over pixels are products of matrices: weights by the gradients of the pixel's channels, v by powers of the pixel's
// coordinates; a lane sums one vector of two splats.
//
// Every pair of splat and tile writes its own slot: the moments of v about the splat's centre (1, x, y, x²; xy, y²), Σ w,
// which is positive where the splat reaches a pixel, and ∂L/∂(record's channels and affinity).

@group(0) @binding(0) var<storage, read> rows: array<vec4f>;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;
@group(0) @binding(2) var<storage, read> lists: array<vec2u>;
@group(0) @binding(3) var<storage, read> pairs: array<vec2u>;
@group(0) @binding(4) var<storage, read> used: array<u32>;
@group(0) @binding(5) var<storage, read> image: array<vec4f>;
@group(0) @binding(6) var<storage, read> gradient: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> slots: array<vec4f>;

const BATCH = 16u;
// One place of padding, so that rows start in different banks.
const PIXEL_ROW = TILE_PIXELS + 1u;
// Gradients of six vectors of channels, then two vectors of powers.
var<workgroup> factors: array<vec4f, 8u * PIXEL_ROW>;
var<workgroup> weights: array<vec2f, BATCH / 2u * PIXEL_ROW>;
var<workgroup> slopes: array<vec2f, BATCH / 2u * PIXEL_ROW>;
var<workgroup> splats: array<vec4f, BATCH * 8u>;
var<workgroup> splat_slots: array<u32, BATCH>;
var<workgroup> moments: array<vec4f, BATCH * 2u>;
var<workgroup> bounds: vec2u;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = group.x + group.y * MAX_GROUPS;
    if (tile >= u.size.z * u.size.w) { return; }
    let corner = tile_corner(tile);
    let at = vec2u(lane % TILE, lane / TILE);
    let center = vec2f(corner + at) + 0.5;
    if (lane == 0u) { bounds = vec2u(lists[tile].x, used[tile]); }
    let segmented = (u.counts.w & SEGMENTED) != 0u;
    let inside = all(corner + at < u.size.xy);
    let o = tile * 6u * TILE_PIXELS + lane;
    var g0 = vec4f(); var g1 = vec4f(); var g2 = vec4f(); var g3 = vec4f(); var g4 = vec4f(); var g5 = vec4f();
    var transmittance = 0.0;
    var remainder = 0.0;
    if (inside) {
        transmittance = 1.0;
        g0 = gradient[o];
        g1 = gradient[o + TILE_PIXELS];
        remainder = dot(g0, image[o]) + dot(g1, image[o + TILE_PIXELS]);
        if (segmented) {
            g2 = gradient[o + 2u * TILE_PIXELS];
            g3 = gradient[o + 3u * TILE_PIXELS];
            g4 = gradient[o + 4u * TILE_PIXELS];
            g5 = gradient[o + 5u * TILE_PIXELS];
            remainder += dot(g2, image[o + 2u * TILE_PIXELS]) + dot(g3, image[o + 3u * TILE_PIXELS])
                + dot(g4, image[o + 4u * TILE_PIXELS]) + dot(g5, image[o + 5u * TILE_PIXELS]);
        }
    }
    factors[lane] = g0;
    factors[PIXEL_ROW + lane] = g1;
    factors[2u * PIXEL_ROW + lane] = g2;
    factors[3u * PIXEL_ROW + lane] = g3;
    factors[4u * PIXEL_ROW + lane] = g4;
    factors[5u * PIXEL_ROW + lane] = g5;
    // Coordinates about the tile's centre; sums are moved to the splats' centres afterwards.
    let p = vec2f(at) - 3.5;
    factors[6u * PIXEL_ROW + lane] = vec4f(1.0, p.x, p.y, p.x * p.x);
    factors[7u * PIXEL_ROW + lane] = vec4f(p.x * p.y, p.y * p.y, 0.0, 0.0);
    // What this lane sums: a vector of the factors, for two splats.
    let factor = lane % 8u;
    let two = lane / 8u;

    let list = workgroupUniformLoad(&bounds);
    let n = list.y;
    for (var base = 0u; base < n; base += BATCH) {
        let m = min(BATCH, n - base);
        for (var i = lane; i < 8u * m; i += TILE_PIXELS) {
            let g = pairs[list.x + base + i / 8u].x;
            let part = i % 8u;
            if (part < 4u) { splats[i] = records[4u * g + part]; } else { splats[i] = rows[8u * g + part]; }
        }
        if (lane < m) { splat_slots[lane] = pairs[list.x + base + lane].y; }
        workgroupBarrier();
        for (var k = 0u; k < BATCH; k += 2u) {
            var w = vec2f(0.0);
            var v = vec2f(0.0);
            //unroll e 2
            if (k + $eu < m && transmittance > TRANSMITTANCE_MIN) {
                let s = 8u * (k + $eu);
                let r0 = splats[s];
                let r1 = splats[s + 1u];
                let d = center - r0.xy;
                let a = alpha_at(r0, r1, d);
                if (a.enough) {
                    let score = (dot(g0, splats[s + 2u]) + dot(g1, splats[s + 3u]))
                        + (dot(g2, splats[s + 4u]) + dot(g3, splats[s + 5u]))
                        + (dot(g4, splats[s + 6u]) + dot(g5, splats[s + 7u]))
                        + g0.w * (r1.z * d.x + r1.w * d.y);
                    let weight = a.value * transmittance;
                    remainder -= weight * score;
                    transmittance -= weight;
                    w[$e] = weight;
                    v[$e] = select(0.0, weight * score - remainder * a.value / (1.0 - a.value), a.free);
                }
            }
            //end
            weights[k / 2u * PIXEL_ROW + lane] = w;
            slopes[k / 2u * PIXEL_ROW + lane] = v;
        }
        workgroupBarrier();
        var first = vec4f();
        var second = vec4f();
        if (factor < 6u) {
            for (var px = 0u; px < TILE_PIXELS; px++) {
                let f = factors[factor * PIXEL_ROW + px];
                let w = weights[two * PIXEL_ROW + px];
                first += w.x * f;
                second += w.y * f;
            }
        } else {
            // Σ w takes the place of a power, in the last vector.
            let last = f32(factor - 6u);
            for (var px = 0u; px < TILE_PIXELS; px++) {
                let f = factors[factor * PIXEL_ROW + px];
                let v = slopes[two * PIXEL_ROW + px];
                let w = last * weights[two * PIXEL_ROW + px];
                first += v.x * f + vec4f(0.0, 0.0, w.x, 0.0);
                second += v.y * f + vec4f(0.0, 0.0, w.y, 0.0);
            }
        }
        let k = 2u * two;
        if (factor < 6u) {
            if (k < m) { slots[8u * splat_slots[k] + 2u + factor] = first; }
            if (k + 1u < m) { slots[8u * splat_slots[k + 1u] + 2u + factor] = second; }
        } else {
            moments[2u * k + factor - 6u] = first;
            moments[2u * k + factor - 4u] = second;
        }
        workgroupBarrier();
        if (lane < m) {
            let about = moments[2u * lane];
            let more = moments[2u * lane + 1u];
            let by = vec2f(corner) + 4.0 - splats[8u * lane].xy;
            let moved = about.yz + by * about.x;
            let slot = 8u * splat_slots[lane];
            slots[slot] = vec4f(about.x, moved, about.w + by.x * (about.y + moved.x));
            slots[slot + 1u] = vec4f(
                more.x + by.x * about.z + by.y * moved.x,
                more.y + by.y * (about.z + moved.y),
                more.z,
                0.0,
            );
        }
        workgroupBarrier();
    }
    // What lies beyond the last splat that reaches a pixel.
    let all = lists[tile].y;
    for (var i = 8u * n + lane; i < 8u * all; i += TILE_PIXELS) {
        slots[8u * pairs[list.x + i / 8u].y + i % 8u] = vec4f();
    }
}
