// Colour, depth and normal terms and the gradient by the blended channels but affinity (sms-gaussians, cpu/losses.rs),
// with the gradient of SSIM: its derivatives convolved once more. One 16 x 16 block per workgroup.

@group(0) @binding(0) var<storage, read> image: array<vec4f>;
@group(0) @binding(1) var<storage, read> derivatives: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> gradient: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> partials: array<f32>;
@group(1) @binding(1) var<storage, read> observed: array<vec4u>;

const BLOCK = 16u;
const HALO = 26u;
var<workgroup> by_mean: array<f32, 676>;
var<workgroup> by_square: array<f32, 676>;
var<workgroup> by_product: array<f32, 676>;
var<workgroup> along: array<vec4f, 416>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let corner = vec2<i32>(group.xy * BLOCK) - vec2<i32>(5);
    let at = vec2u(lane % BLOCK, lane / BLOCK);
    let pixel = group.xy * BLOCK + at;
    let inside = all(pixel < u.size.xy);
    var window = WINDOW;
    var shown = vec4f();
    var normal = vec4f();
    var seen = vec4u();
    var more = vec4u();
    if (inside) {
        let o = tiled(pixel, 6u);
        shown = image[o];
        normal = image[o + TILE_PIXELS];
        let t = 2u * (pixel.y * u.size.x + pixel.x);
        seen = observed[t];
        more = observed[t + 1u];
    }
    let colored = (more.w & 0x10000u) != 0u;
    var g_color = vec3f();
    if (u.other_weights.x != 0.0) {
        for (var c = 0u; c < 3u; c++) {
            for (var i = lane; i < HALO * HALO; i += 256u) {
                let p = corner + vec2<i32>(vec2u(i % HALO, i / HALO));
                var d = vec4f();
                if (all(p >= vec2<i32>(0)) && all(p < vec2<i32>(u.size.xy))) {
                    let q = vec2u(p);
                    d = derivatives[(c * u.size.y + q.y) * u.size.x + q.x];
                }
                by_mean[i] = d.x;
                by_square[i] = d.y;
                by_product[i] = d.z;
            }
            workgroupBarrier();
            for (var i = lane; i < HALO * BLOCK; i += 256u) {
                let from_x = (i / BLOCK) * HALO + i % BLOCK;
                var d = vec3f();
                for (var k = 0u; k < 11u; k++) {
                    d += window[k] * vec3f(by_mean[from_x + k], by_square[from_x + k], by_product[from_x + k]);
                }
                along[i] = vec4f(d, 0.0);
            }
            workgroupBarrier();
            var d = vec3f();
            for (var k = 0u; k < 11u; k++) { d += window[k] * along[lane + k * BLOCK].xyz; }
            g_color[c] = d.x + 2.0 * shown[c] * d.y + bitcast<f32>(seen[c]) * d.z;
            workgroupBarrier();
        }
    }
    let color_error = select(vec3f(0.0), shown.xyz - bitcast<vec3f>(seen.xyz), colored);
    g_color = select(vec3f(0.0), g_color + u.pixel_weights.x * sign(color_error), colored);

    let measured = bitcast<f32>(seen.w);
    var share = 1.0;
    if ((u.counts.w & (DEPTH_NORMALIZED | DEPTH_DETACHED)) != 0u) { share = 1.0 / max(normal.w, DEPTH_OPACITY_MIN); }
    let depth = shown.w * share;
    let depth_error = select(0.0, depth - measured, measured > 0.0);
    let g_depth = sign(depth_error) * u.pixel_weights.y * share;
    let through = (u.counts.w & DEPTH_NORMALIZED) != 0u && normal.w > DEPTH_OPACITY_MIN;
    let g_opacity = select(0.0, -g_depth * depth, through);

    let n = bitcast<vec3f>(more.xyz);
    let normal_error = select(vec3f(0.0), normal.xyz - n, dot(n, n) > 0.0);
    let g_normal = sign(normal_error) * u.pixel_weights.z;

    if (inside) {
        let o = tiled(pixel, 6u);
        gradient[o] = vec4f(g_color, g_depth);
        gradient[o + TILE_PIXELS] = vec4f(g_normal, g_opacity);
    }
    // The convolved rows are done with: their memory takes the sums.
    let ones = vec3f(1.0);
    along[lane] = vec4f(dot(abs(color_error), ones), abs(depth_error), dot(abs(normal_error), ones), 0.0);
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (lane < half) { along[lane] += along[lane + half]; }
        workgroupBarrier();
    }
    if (lane == 0u) {
        let block = group.y * u.groups.x + group.x;
        partials[SUM_COLOR * u.groups.w + block] = along[0].x;
        partials[SUM_DEPTH * u.groups.w + block] = along[0].y;
        partials[SUM_NORMAL * u.groups.w + block] = along[0].z;
    }
}
