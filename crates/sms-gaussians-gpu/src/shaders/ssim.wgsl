// SSIM (Wang et al. 2004) with an 11 x 11 Gaussian window and zeros beyond the image, summed, and its derivatives by the
// window's moments, one 16 x 16 block per workgroup (sms-gaussians, cpu/ssim.rs).

@group(0) @binding(0) var<storage, read> image: array<vec4f>;
// Per pixel and colour: by the mean of x, by the mean of its square, by the mean of the product.
@group(0) @binding(1) var<storage, read_write> derivatives: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> partials: array<f32>;
@group(1) @binding(1) var<storage, read> observed: array<vec4u>;

const BLOCK = 16u;
const HALO = 26u;
var<workgroup> xs: array<f32, 676>;
var<workgroup> ys: array<f32, 676>;
// Rows of the block and its margins, convolved along x: mean of x, of y, of the squares, of the product.
var<workgroup> along: array<vec4f, 416>;
var<workgroup> sums: array<f32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let corner = vec2<i32>(group.xy * BLOCK) - vec2<i32>(5);
    let at = vec2u(lane % BLOCK, lane / BLOCK);
    let pixel = group.xy * BLOCK + at;
    let inside = all(pixel < u.size.xy);
    var window = WINDOW;
    var sum = 0.0;
    for (var c = 0u; c < 3u; c++) {
        for (var i = lane; i < HALO * HALO; i += 256u) {
            let p = corner + vec2<i32>(vec2u(i % HALO, i / HALO));
            var x = 0.0;
            var y = 0.0;
            if (all(p >= vec2<i32>(0)) && all(p < vec2<i32>(u.size.xy))) {
                let q = vec2u(p);
                let t = 2u * (q.y * u.size.x + q.x);
                if ((observed[t + 1u].w & 0x10000u) != 0u) {
                    x = image[tiled(q, 6u)][c];
                    y = bitcast<f32>(observed[t][c]);
                }
            }
            xs[i] = x;
            ys[i] = y;
        }
        workgroupBarrier();
        for (var i = lane; i < HALO * BLOCK; i += 256u) {
            let from_x = (i / BLOCK) * HALO + i % BLOCK;
            var moments = vec4f();
            for (var k = 0u; k < 11u; k++) {
                let x = xs[from_x + k];
                let y = ys[from_x + k];
                moments += window[k] * vec4f(x, y, x * x + y * y, x * y);
            }
            along[i] = moments;
        }
        workgroupBarrier();
        var m = vec4f();
        for (var k = 0u; k < 11u; k++) { m += window[k] * along[lane + k * BLOCK]; }
        if (inside) {
            let uxx = m.x * m.x;
            let uxy = m.x * m.y;
            let uyy = m.y * m.y;
            let a1 = 2.0 * uxy + SSIM_C1;
            let a2 = 2.0 * (m.w - uxy) + SSIM_C2;
            // The sum of variances is never negative; rounding is.
            let by_b1 = 1.0 / (uxx + uyy + SSIM_C1);
            let by_b2 = 1.0 / (max(m.z - uxx - uyy, 0.0) + SSIM_C2);
            let inverse = by_b1 * by_b2;
            let s = a1 * a2 * inverse;
            sum += s;
            let d_square = -s * by_b2;
            let d_product = 2.0 * a1 * inverse;
            let d_mean = 2.0 * m.y * a2 * inverse - 2.0 * m.x * s * by_b1 - d_product * m.y - 2.0 * m.x * d_square;
            let plane = c * u.size.x * u.size.y;
            derivatives[plane + pixel.y * u.size.x + pixel.x] =
                u.other_weights.x * vec4f(d_mean, d_square, d_product, 0.0);
        }
        workgroupBarrier();
    }
    sums[lane] = sum;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (lane < half) { sums[lane] += sums[lane + half]; }
        workgroupBarrier();
    }
    if (lane == 0u) { partials[SUM_SSIM * u.groups.w + group.y * u.groups.x + group.x] = sums[0]; }
}
