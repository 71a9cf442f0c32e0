// Projects every Gaussian: the inputs of blending, and the ellipse in which its alpha is above the minimum.

@group(0) @binding(0) var<storage, read> rows: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> records: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> outlines: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> control: array<u32>;

@compute @workgroup_size(128)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let g = id.x;
    if (g == 0u) {
        control[LIST_COUNTER] = 0u;
        control[PAIRS] = 0u;
        control[SEEN] = 0u;
        control[LARGE] = 0u;
        control[CLASSIFIER_STEPS] = control[CLASSIFIER_STEPS_NEXT];
    }
    if (g >= u.counts.x) { return; }
    let place = rows[ROW_VECTORS * g];
    let m = linearize(place.xyz, rows[ROW_VECTORS * g + 1u], rows[ROW_VECTORS * g + 2u].xyz, place.w);
    let c = m.covariance;
    let determinant = c.x * c.z - c.y * c.y;
    let mean = u.intrinsics.xy * m.p_c.xy * m.inverse_z + u.intrinsics.zw;
    let log2_opacity = 0.5 * log2_precise(m.determinants.x / m.determinants.y) + log2_precise(m.opacity);
    // Squared Mahalanobis distance at which alpha reaches its minimum.
    let reach = (log2_opacity - LOG2_ALPHA_MIN) * (2.0 * LN_2);
    let half = sqrt(max(reach * c.xz, vec2f(0.0)));
    let size = vec2f(u.size.xy);
    let inside = all(mean + half > vec2f(0.0)) && all(size > mean - half);
    // In single precision a splat thousands of pixels across loses its determinant; nothing useful is lost with it.
    let product = c.x * c.z;
    let sound = is_finite(product) && determinant > 1e-6 * product;
    let seen = m.valid && inside && sound && reach > 0.0 && is_finite(half.x) && is_finite(half.y);
    if (!seen) {
        outlines[g] = vec4f(-1.0, 0.0, 0.0, 0.0);
        return;
    }
    let power = conic_of(c) * vec3f(-0.5 * LOG2_E, -LOG2_E, -0.5 * LOG2_E);
    records[4u * g] = vec4f(mean, power.xy);
    records[4u * g + 1u] = vec4f(power.z, log2_opacity, m.depth_slope);
    records[4u * g + 2u] = vec4f(color_of(g, place.xyz), m.p_c.z);
    records[4u * g + 3u] = vec4f(m.normal_w, 1.0);
    outlines[g] = vec4f(half, sqrt(reach * determinant / c.z), c.y / c.z);
}

// The colour of a Gaussian in this view.
fn color_of(g: u32, p_w: vec3f) -> vec3f {
    var color = rows[ROW_VECTORS * g + 3u].xyz;
    let at = ROW_VECTORS * g + 8u;
    var coefficients: array<vec4f, 6>;
    var any_set = false;
    for (var q = 0u; q < 6u; q++) {
        coefficients[q] = rows[at + q];
        any_set = any_set || any(coefficients[q] != vec4f(0.0));
    }
    if (!any_set) { return color; }
    let basis = basis_at(p_w);
    for (var k = 0u; k < BASIS; k++) {
        for (var c = 0u; c < 3u; c++) {
            let i = 3u * k + c;
            color[c] += basis[k] * coefficients[i / 4u][i % 4u];
        }
    }
    return color;
}

// log2 of a positive normal number to single precision, which the built-in need not reach (as in cpu/lanes.rs).
fn log2_precise(x: f32) -> f32 {
    let bits = bitcast<u32>(x);
    var exponent = f32(i32(bits >> 23u) - 127);
    var mantissa = bitcast<f32>((bits & 0x007fffffu) | 0x3f800000u);
    if (mantissa > 1.4142135) {
        mantissa *= 0.5;
        exponent += 1.0;
    }
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let q = s * s;
    let series = 1.0 + q * (1.0 / 3.0 + q * (1.0 / 5.0 + q * (1.0 / 7.0 + q * (1.0 / 9.0))));
    return exponent + 2.0 * LOG2_E * s * series;
}
