// The gradient of blending without atomics (design, section 6): one splat per lane, one tile per team of lanes. Each
// pixel's state, its transmittance and the remainder Σ w·s of the splats still to come, travels from lane to lane; every
// pair of splat and tile writes its own slot. A slot is the moments of v = ∂L/∂(ln α) about the splat's centre (1, x, y,
// x²; xy, y²), how many pixels the splat reached, and ∂L/∂(record's channels and affinity).
//
// A batch of splats takes as many rounds as the tile has pixels and one more for each lane but one, so that half a
// subgroup to a tile wastes fewer than a whole one.

@group(0) @binding(0) var<storage, read> rows: array<vec4f>;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;
@group(0) @binding(2) var<storage, read> lists: array<vec2u>;
@group(0) @binding(3) var<storage, read> pairs: array<vec2u>;
@group(0) @binding(4) var<storage, read> used: array<u32>;
@group(0) @binding(5) var<storage, read> image: array<vec4f>;
@group(0) @binding(6) var<storage, read> gradient: array<vec4f>;
@group(0) @binding(7) var<storage, read_write> slots: array<vec4f>;

const TEAMS = LANES / TEAM;
var<workgroup> by_channel: array<vec4f, 6u * TILE_PIXELS * TEAMS>;
// Transmittance and remainder of each pixel, between two batches of splats.
var<workgroup> states: array<vec2f, TILE_PIXELS * TEAMS>;
var<workgroup> longest: atomic<u32>;
//PASS_STATE//

@compute @workgroup_size(LANES)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) invocation: u32) {
    let lane = invocation % TEAM;
    let team = invocation / TEAM;
    let tiles = u.size.z * u.size.w;
    let tile = (group.x + group.y * MAX_GROUPS) * TEAMS + team;
    if (invocation == 0u) { atomicStore(&longest, 0u); }
    workgroupBarrier();
    let segmented = (u.counts.w & SEGMENTED) != 0u;
    let here = team * TILE_PIXELS;
    let channels = 6u * here;
    var n = 0u;
    var list = vec2u(0u);
    let corner = tile_corner(tile);
    if (tile < tiles) {
        n = used[tile];
        list = lists[tile];
        let o = tile * 6u * TILE_PIXELS;
        for (var i = lane; i < TILE_PIXELS; i += TEAM) {
            let inside = all(corner + vec2u(i % TILE, i / TILE) < u.size.xy);
            var remainder = 0.0;
            for (var q = 0u; q < 6u; q++) {
                var g = vec4f();
                if (inside && (q < 2u || segmented)) { g = gradient[o + q * TILE_PIXELS + i]; }
                by_channel[channels + q * TILE_PIXELS + i] = g;
                remainder += dot(g, image[o + q * TILE_PIXELS + i]);
            }
            states[here + i] = vec2f(select(0.0, 1.0, inside), select(0.0, remainder, inside));
        }
        if (lane == 0u) { atomicMax(&longest, n); }
    }
    let origin = vec2f(corner) + 0.5;
    workgroupBarrier();
    // All teams go through as many rounds, so that their lanes meet.
    let most = workgroupUniformLoad(&longest);
    for (var base = 0u; base < most; base += TEAM) {
        let holds = base + lane < n;
        var pair = vec2u(0u);
        if (holds) { pair = pairs[list.x + base + lane]; }
        let record = 4u * pair.x;
        let row = 8u * pair.x + 4u;
        let r0 = records[record]; let r1 = records[record + 1u];
        let f0 = records[record + 2u]; let f1 = records[record + 3u];
        let f2 = rows[row]; let f3 = rows[row + 1u]; let f4 = rows[row + 2u]; let f5 = rows[row + 3u];
        var d0 = vec4f(); var d1 = vec4f(); var d2 = vec4f(); var d3 = vec4f(); var d4 = vec4f(); var d5 = vec4f();
        var m0 = vec4f(); var m1 = vec3f();
        var state = vec2f();
        for (var i = 0u; i < TILE_PIXELS + TEAM - 1u; i++) {
            state = from_lane_before(state, invocation);
            if (lane == 0u) { state = states[here + min(i, TILE_PIXELS - 1u)]; }
            let px = i - lane;
            if (px < TILE_PIXELS) {
                if (holds && state.x > TRANSMITTANCE_MIN) {
                    let d = origin + vec2f(f32(px % TILE), f32(px / TILE)) - r0.xy;
                    let a = alpha_at(r0, r1, d);
                    if (a.enough) {
                        let c = channels + px;
                        let g0 = by_channel[c];
                        let g1 = by_channel[c + TILE_PIXELS];
                        let g2 = by_channel[c + 2u * TILE_PIXELS];
                        let g3 = by_channel[c + 3u * TILE_PIXELS];
                        let g4 = by_channel[c + 4u * TILE_PIXELS];
                        let g5 = by_channel[c + 5u * TILE_PIXELS];
                        let score = dot(g0, f0) + g0.w * (r1.z * d.x + r1.w * d.y) + dot(g1, f1) + dot(g2, f2)
                            + dot(g3, f3) + dot(g4, f4) + dot(g5, f5);
                        let w = a.value * state.x;
                        let remainder = state.y - w * score;
                        let v = select(0.0, w * score - remainder * a.value / (1.0 - a.value), a.free);
                        d0 += w * g0; d1 += w * g1; d2 += w * g2; d3 += w * g3; d4 += w * g4; d5 += w * g5;
                        m0 += v * vec4f(1.0, d.x, d.y, d.x * d.x);
                        m1 += vec3f(v * d.x * d.y, v * d.y * d.y, 1.0);
                        state = vec2f(state.x - w, remainder);
                    }
                }
                if (lane == TEAM - 1u) { states[here + px] = state; }
            }
        }
        if (holds) {
            let slot = 8u * pair.y;
            slots[slot] = m0;
            slots[slot + 1u] = vec4f(m1, 0.0);
            slots[slot + 2u] = d0; slots[slot + 3u] = d1; slots[slot + 4u] = d2;
            slots[slot + 5u] = d3; slots[slot + 6u] = d4; slots[slot + 7u] = d5;
        }
        workgroupBarrier();
    }
    // What lies beyond the last splat that reaches a pixel.
    for (var k = n + lane; k < list.y; k += TEAM) {
        let slot = 8u * pairs[list.x + k].y;
        for (var q = 0u; q < 8u; q++) { slots[slot + q] = vec4f(); }
    }
}
