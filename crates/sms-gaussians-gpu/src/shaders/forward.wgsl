// Alpha blending of depth-ordered splats (Kerbl et al. 2023): one tile per workgroup, two pixels per lane, splats through
// workgroup memory, whose reads limit this kernel: each serves both pixels. A pixel has six vectors: colour and
// depth, normal and opacity, four of affinity.

@group(0) @binding(0) var<storage, read> rows: array<vec4f>;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;
@group(0) @binding(2) var<storage, read> lists: array<vec2u>;
@group(0) @binding(3) var<storage, read> pairs: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> image: array<vec4f>;
// Per tile: how much of its list reaches a pixel.
@group(0) @binding(5) var<storage, read_write> used: array<u32>;

const LANES = 32u;
const BATCH = 32u;
var<workgroup> splats: array<vec4f, 8u * BATCH>;
var<workgroup> open_pixels: atomic<u32>;
var<workgroup> last: atomic<u32>;

@compute @workgroup_size(LANES)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = group.x + group.y * MAX_GROUPS;
    if (tile >= u.size.z * u.size.w) { return; }
    let first = lists[tile].x;
    let n = lists[tile].y;
    //unroll e 2
    let pixel$e = tile_corner(tile) + vec2u(lane % TILE, lane / TILE + 4u * $eu);
    let center$e = vec2f(pixel$e) + 0.5;
    // Pixels outside of the image receive no light, and nobody reads them.
    var left$e = select(0.0, 1.0, all(pixel$e < u.size.xy));
    //unroll q 6
    var o$e$q = vec4f();
    //end
    //end
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
        for (var i = lane; i < m * 8u; i += LANES) {
            let g = pairs[first + base + i / 8u].x;
            let part = i % 8u;
            if (part < 4u) { splats[i] = records[4u * g + part]; } else { splats[i] = rows[ROW_VECTORS * g + part]; }
        }
        workgroupBarrier();
        if (max(left0, left1) > TRANSMITTANCE_MIN) {
            for (var k = 0u; k < m; k++) {
                let r0 = splats[8u * k];
                let r1 = splats[8u * k + 1u];
                //unroll e 2
                let d$e = center$e - r0.xy;
                let a$e = alpha_at(r0, r1, d$e);
                let hit$e = a$e.enough && left$e > TRANSMITTANCE_MIN;
                //end
                if (hit0 || hit1) {
                    let f = 8u * k + 2u;
                    //unroll e 2
                    let w$e = select(0.0, a$e.value * left$e, hit$e);
                    left$e -= w$e;
                    o$e0.w += w$e * (r1.z * d$e.x + r1.w * d$e.y);
                    //end
                    //unroll q 6
                    let f$q = splats[f + $qu];
                    o0$q += w0 * f$q;
                    o1$q += w1 * f$q;
                    //end
                    reached = base + k + 1u;
                    if (max(left0, left1) <= TRANSMITTANCE_MIN) { break; }
                }
            }
            if (max(left0, left1) > TRANSMITTANCE_MIN) { atomicStore(&open_pixels, 1u); }
        }
    }
    atomicMax(&last, reached);
    //unroll e 2
    let at$e = tile * 6u * TILE_PIXELS + lane + LANES * $eu;
    o$e0 += left$e * vec4f(u.background.xyz, 0.0);
    o$e1.w = 1.0 - left$e;
    //unroll q 6
    image[at$e + $qu * TILE_PIXELS] = o$e$q;
    //end
    //end
    workgroupBarrier();
    if (lane == 0u) { used[tile] = atomicLoad(&last); }
}
