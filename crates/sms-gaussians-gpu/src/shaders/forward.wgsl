// Alpha blending of depth-ordered splats (Kerbl et al. 2023): one pixel per lane, one tile per workgroup, splats through
// workgroup memory. A pixel has six vectors: colour and depth, normal and opacity, four of affinity.

@group(0) @binding(0) var<storage, read> rows: array<vec4f>;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;
@group(0) @binding(2) var<storage, read> lists: array<vec2u>;
@group(0) @binding(3) var<storage, read> pairs: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> image: array<vec4f>;
// Per tile: how much of its list reaches a pixel.
@group(0) @binding(5) var<storage, read_write> used: array<u32>;

const BATCH = 64u;
var<workgroup> splats: array<vec4f, 512>;
var<workgroup> open_pixels: atomic<u32>;
var<workgroup> last: atomic<u32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = group.x + group.y * MAX_GROUPS;
    if (tile >= u.size.z * u.size.w) { return; }
    let pixel = tile_corner(tile) + vec2u(lane % TILE, lane / TILE);
    let center = vec2f(pixel) + 0.5;
    let first = lists[tile].x;
    let n = lists[tile].y;
    // Pixels outside of the image receive no light, and nobody reads them.
    let inside = all(pixel < u.size.xy);
    var transmittance = select(0.0, 1.0, inside);
    var o0 = vec4f(); var o1 = vec4f(); var o2 = vec4f(); var o3 = vec4f(); var o4 = vec4f(); var o5 = vec4f();
    var reached = 0u;
    if (lane == 0u) {
        atomicStore(&last, 0u);
        atomicStore(&open_pixels, 1u);
    }
    for (var base = 0u; base < n; base += BATCH) {
        workgroupBarrier();
        if (atomicLoad(&open_pixels) == 0u) { break; }
        workgroupBarrier();
        if (lane == 0u) { atomicStore(&open_pixels, 0u); }
        let m = min(BATCH, n - base);
        for (var i = lane; i < m * 8u; i += BATCH) {
            let g = pairs[first + base + i / 8u].x;
            let part = i % 8u;
            if (part < 4u) { splats[i] = records[4u * g + part]; } else { splats[i] = rows[8u * g + part]; }
        }
        workgroupBarrier();
        if (transmittance > TRANSMITTANCE_MIN) {
            for (var k = 0u; k < m; k++) {
                let r0 = splats[8u * k];
                let r1 = splats[8u * k + 1u];
                let d = center - r0.xy;
                let a = alpha_at(r0, r1, d);
                if (a.enough) {
                    let f = 8u * k + 2u;
                    let w = a.value * transmittance;
                    transmittance -= w;
                    var f0 = splats[f];
                    f0.w += r1.z * d.x + r1.w * d.y;
                    o0 += w * f0;
                    o1 += w * splats[f + 1u];
                    o2 += w * splats[f + 2u];
                    o3 += w * splats[f + 3u];
                    o4 += w * splats[f + 4u];
                    o5 += w * splats[f + 5u];
                    reached = base + k + 1u;
                    if (transmittance <= TRANSMITTANCE_MIN) { break; }
                }
            }
            if (transmittance > TRANSMITTANCE_MIN) { atomicStore(&open_pixels, 1u); }
        }
    }
    atomicMax(&last, reached);
    let o = tile * 6u * TILE_PIXELS + lane;
    image[o] = o0 + transmittance * vec4f(u.background.xyz, 0.0);
    o1.w = 1.0 - transmittance;
    image[o + TILE_PIXELS] = o1;
    image[o + 2u * TILE_PIXELS] = o2;
    image[o + 3u * TILE_PIXELS] = o3;
    image[o + 4u * TILE_PIXELS] = o4;
    image[o + 5u * TILE_PIXELS] = o5;
    workgroupBarrier();
    if (lane == 0u) { used[tile] = atomicLoad(&last); }
}
