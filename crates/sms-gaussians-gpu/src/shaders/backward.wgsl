// The gradient of blending without atomics (design, section 6), one tile per workgroup, a batch of splats at a time, in
// two passes. First each lane takes a pixel and replays the blending with two numbers, the transmittance and the
// remainder Σ w·s of the splats still to come, and notes of each splat its weight w and v = ∂L/∂(ln α) there. Then the
// sums over pixels are products of matrices: weights by the gradients of the pixel's channels, v by powers of the pixel's
// coordinates; a lane sums one vector of two splats. The first pass is limited by latency: it computes
// everything independent of earlier splats for four splats at once, without a branch.
//
// Every pair of splat and tile writes its own slot: the moments of v about the splat's centre (1, x, y, x²; xy, y²) and
// ∂L/∂(record's channels and affinity), with Σ w, which is positive where the splat reaches a pixel, in the place of
// opacity, whose feature is always one.

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
// Of two splats each: rows of weights, then rows of v.
var<workgroup> notes: array<vec2f, BATCH * PIXEL_ROW>;
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
    let o = tile * 6u * TILE_PIXELS + lane;
    //unroll q 6
    var g$q = vec4f();
    //end
    var left = 0.0;
    var remainder = 0.0;
    if (all(corner + at < u.size.xy)) {
        left = 1.0;
        //unroll q 6
        if ($qu < 2u || segmented) {
            g$q = gradient[o + $qu * TILE_PIXELS];
            remainder += dot(g$q, image[o + $qu * TILE_PIXELS]);
        }
        //end
    }
    //unroll q 6
    factors[$qu * PIXEL_ROW + lane] = g$q;
    //end
    // Nobody needs the gradient of opacity's feature: Σ w takes its place.
    factors[PIXEL_ROW + lane].w = 1.0;
    // Coordinates about the tile's centre; sums are moved to the splats' centres afterwards.
    let p = vec2f(at) - 3.5;
    factors[6u * PIXEL_ROW + lane] = vec4f(1.0, p.x, p.y, p.x * p.x);
    factors[7u * PIXEL_ROW + lane] = vec4f(p.x * p.y, p.y * p.y, 0.0, 0.0);
    // Sum of this lane: a vector of the factors, for two splats. The last two are of v.
    let factor = lane % 8u;
    let two = lane / 8u;
    let noted = (two + select(0u, BATCH / 2u, factor >= 6u)) * PIXEL_ROW;

    let list = workgroupUniformLoad(&bounds);
    let n = list.y;
    for (var base = 0u; base < n; base += BATCH) {
        let m = min(BATCH, n - base);
        for (var i = lane; i < 8u * m; i += TILE_PIXELS) {
            let g = pairs[list.x + base + i / 8u].x;
            let part = i % 8u;
            if (part < 4u) { splats[i] = records[4u * g + part]; } else { splats[i] = rows[ROW_VECTORS * g + part]; }
        }
        if (lane < m) { splat_slots[lane] = pairs[list.x + base + lane].y; }
        workgroupBarrier();
        for (var k = 0u; k < BATCH; k += 4u) {
            //unroll i 4
            var w$i = 0.0;
            var v$i = 0.0;
            //end
            if (k < m && left > TRANSMITTANCE_MIN) {
                //unroll i 4
                let s$i = 8u * (k + $iu);
                let r$i = splats[s$i + 1u];
                let d$i = center - splats[s$i].xy;
                let a$i = alpha_at(splats[s$i], r$i, d$i);
                let ok$i = a$i.enough && k + $iu < m;
                let score$i = select(
                    0.0,
                    (dot(g0, splats[s$i + 2u]) + dot(g1, splats[s$i + 3u]))
                        + (dot(g2, splats[s$i + 4u]) + dot(g3, splats[s$i + 5u]))
                        + (dot(g4, splats[s$i + 6u]) + dot(g5, splats[s$i + 7u]))
                        + g0.w * (r$i.z * d$i.x + r$i.w * d$i.y),
                    ok$i,
                );
                let odds$i = a$i.value / (1.0 - a$i.value);
                //end
                //unroll i 4
                w$i = select(0.0, a$i.value * left, ok$i && left > TRANSMITTANCE_MIN);
                remainder -= w$i * score$i;
                left -= w$i;
                v$i = select(0.0, w$i * score$i - remainder * odds$i, w$i > 0.0 && a$i.free);
                //end
            }
            let row = k / 2u * PIXEL_ROW + lane;
            notes[row] = vec2f(w0, w1);
            notes[row + PIXEL_ROW] = vec2f(w2, w3);
            notes[row + BATCH / 2u * PIXEL_ROW] = vec2f(v0, v1);
            notes[row + (BATCH / 2u + 1u) * PIXEL_ROW] = vec2f(v2, v3);
        }
        workgroupBarrier();
        var sum0 = vec4f();
        var sum1 = vec4f();
        for (var px = 0u; px < TILE_PIXELS; px += 4u) {
            //unroll i 4
            let f$i = factors[factor * PIXEL_ROW + px + $iu];
            let by$i = notes[noted + px + $iu];
            //end
            //unroll i 4
            sum0 += by$i.x * f$i;
            sum1 += by$i.y * f$i;
            //end
        }
        //unroll i 2
        {
            let k = 2u * two + $iu;
            if (factor >= 6u) {
                moments[2u * k + factor - 6u] = sum$i;
            } else if (k < m) {
                slots[8u * splat_slots[k] + 2u + factor] = sum$i;
            }
        }
        //end
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
                0.0,
                0.0,
            );
        }
        workgroupBarrier();
    }
    // Clears the slots beyond the last splat that reaches a pixel.
    let whole = lists[tile].y;
    for (var i = 8u * n + lane; i < 8u * whole; i += TILE_PIXELS) {
        slots[8u * pairs[list.x + i / 8u].y + i % 8u] = vec4f();
    }
}
