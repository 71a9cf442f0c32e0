// The gradient of blending without atomics (design, section 6), one tile per workgroup, a batch of splats at a time, in
// two passes. First each lane takes two pixels and replays the blending with two numbers each, the transmittance and the
// remainder Σ w·s of the splats still to come, and notes of each splat its weight w and v = ∂L/∂(ln α) there. Then the
// sums over pixels are products of matrices: weights by the gradients of the pixel's channels, v by powers of the pixel's
// coordinates; a lane sums one vector of four splats. Reads of workgroup memory are what limits both passes.
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

const LANES = 32u;
const BATCH = 16u;
// One place of padding, so that rows start in different banks.
const PIXEL_ROW = TILE_PIXELS + 1u;
// Gradients of six vectors of channels, then two vectors of powers.
var<workgroup> factors: array<vec4f, 8u * PIXEL_ROW>;
// Of four splats each: rows of weights, then rows of v.
var<workgroup> notes: array<vec4f, BATCH / 2u * PIXEL_ROW>;
var<workgroup> splats: array<vec4f, BATCH * 8u>;
var<workgroup> splat_slots: array<u32, BATCH>;
var<workgroup> moments: array<vec4f, BATCH * 2u>;
var<workgroup> bounds: vec2u;

@compute @workgroup_size(LANES)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = group.x + group.y * MAX_GROUPS;
    if (tile >= u.size.z * u.size.w) { return; }
    let corner = tile_corner(tile);
    if (lane == 0u) { bounds = vec2u(lists[tile].x, used[tile]); }
    let segmented = (u.counts.w & SEGMENTED) != 0u;
    //unroll e 2
    let pixel$e = lane + LANES * $eu;
    let at$e = vec2u(pixel$e % TILE, pixel$e / TILE);
    let center$e = vec2f(corner + at$e) + 0.5;
    let o$e = tile * 6u * TILE_PIXELS + pixel$e;
    //unroll q 6
    var g$e$q = vec4f();
    //end
    var left$e = 0.0;
    var remainder$e = 0.0;
    if (all(corner + at$e < u.size.xy)) {
        left$e = 1.0;
        //unroll q 2
        g$e$q = gradient[o$e + $qu * TILE_PIXELS];
        remainder$e += dot(g$e$q, image[o$e + $qu * TILE_PIXELS]);
        //end
        if (segmented) {
            g$e2 = gradient[o$e + 2u * TILE_PIXELS];
            remainder$e += dot(g$e2, image[o$e + 2u * TILE_PIXELS]);
            g$e3 = gradient[o$e + 3u * TILE_PIXELS];
            remainder$e += dot(g$e3, image[o$e + 3u * TILE_PIXELS]);
            g$e4 = gradient[o$e + 4u * TILE_PIXELS];
            remainder$e += dot(g$e4, image[o$e + 4u * TILE_PIXELS]);
            g$e5 = gradient[o$e + 5u * TILE_PIXELS];
            remainder$e += dot(g$e5, image[o$e + 5u * TILE_PIXELS]);
        }
    }
    factors[pixel$e] = g$e0;
    // Nobody needs the gradient of opacity's feature: Σ w takes its place.
    factors[PIXEL_ROW + pixel$e] = vec4f(g$e1.xyz, 1.0);
    factors[2u * PIXEL_ROW + pixel$e] = g$e2;
    factors[3u * PIXEL_ROW + pixel$e] = g$e3;
    factors[4u * PIXEL_ROW + pixel$e] = g$e4;
    factors[5u * PIXEL_ROW + pixel$e] = g$e5;
    // Coordinates about the tile's centre; sums are moved to the splats' centres afterwards.
    let p$e = vec2f(at$e) - 3.5;
    factors[6u * PIXEL_ROW + pixel$e] = vec4f(1.0, p$e.x, p$e.y, p$e.x * p$e.x);
    factors[7u * PIXEL_ROW + pixel$e] = vec4f(p$e.x * p$e.y, p$e.y * p$e.y, 0.0, 0.0);
    //end
    // What this lane sums: a vector of the factors, for four splats. The last two are of v.
    let factor = lane % 8u;
    let four = lane / 8u;
    let noted = (four + select(0u, BATCH / 4u, factor >= 6u)) * PIXEL_ROW;

    let list = workgroupUniformLoad(&bounds);
    let n = list.y;
    for (var base = 0u; base < n; base += BATCH) {
        let m = min(BATCH, n - base);
        for (var i = lane; i < 8u * m; i += LANES) {
            let g = pairs[list.x + base + i / 8u].x;
            let part = i % 8u;
            if (part < 4u) { splats[i] = records[4u * g + part]; } else { splats[i] = rows[8u * g + part]; }
        }
        if (lane < m) { splat_slots[lane] = pairs[list.x + base + lane].y; }
        workgroupBarrier();
        for (var k = 0u; k < BATCH; k += 4u) {
            //unroll e 2
            var w$e = vec4f(0.0);
            var v$e = vec4f(0.0);
            //end
            //unroll i 4
            if (k + $iu < m) {
                let s = 8u * (k + $iu);
                let r0 = splats[s];
                let r1 = splats[s + 1u];
                //unroll e 2
                let d$e = center$e - r0.xy;
                let a$e = alpha_at(r0, r1, d$e);
                let hit$e = a$e.enough && left$e > TRANSMITTANCE_MIN;
                //end
                if (hit0 || hit1) {
                    //unroll q 6
                    let f$q = splats[s + 2u + $qu];
                    //end
                    //unroll e 2
                    let score$e = (dot(g$e0, f0) + dot(g$e1, f1)) + (dot(g$e2, f2) + dot(g$e3, f3))
                        + (dot(g$e4, f4) + dot(g$e5, f5)) + g$e0.w * (r1.z * d$e.x + r1.w * d$e.y);
                    let weight$e = select(0.0, a$e.value * left$e, hit$e);
                    remainder$e -= weight$e * score$e;
                    left$e -= weight$e;
                    let slope$e = weight$e * score$e - remainder$e * a$e.value / (1.0 - a$e.value);
                    w$e[$i] = weight$e;
                    v$e[$i] = select(0.0, slope$e, hit$e && a$e.free);
                    //end
                }
            }
            //end
            //unroll e 2
            notes[k / 4u * PIXEL_ROW + pixel$e] = w$e;
            notes[(BATCH + k) / 4u * PIXEL_ROW + pixel$e] = v$e;
            //end
        }
        workgroupBarrier();
        //unroll i 4
        var sum$i = vec4f();
        //end
        for (var px = 0u; px < TILE_PIXELS; px++) {
            let f = factors[factor * PIXEL_ROW + px];
            let by = notes[noted + px];
            //unroll i 4
            sum$i += by[$i] * f;
            //end
        }
        //unroll i 4
        {
            let k = 4u * four + $iu;
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
    // What lies beyond the last splat that reaches a pixel.
    let whole = lists[tile].y;
    for (var i = 8u * n + lane; i < 8u * whole; i += LANES) {
        slots[8u * pairs[list.x + i / 8u].y + i % 8u] = vec4f();
    }
}
