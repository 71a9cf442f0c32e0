// From the gradient of splats to that of Gaussians, the regularisers, and Adam: one Gaussian per lane, only those that
// reached a pixel (sms-gaussians, cpu/unproject.rs).

@group(0) @binding(0) var<storage, read_write> rows: array<vec4f>;
// First moments, then second.
@group(0) @binding(1) var<storage, read_write> moments: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> steps: array<u32>;
@group(0) @binding(3) var<storage, read> sums: array<vec4f>;
// 1/(1 − β₁ᵗ) and 1/(1 − β₂ᵗ).
@group(0) @binding(4) var<storage, read> corrections: array<vec2f>;
@group(0) @binding(5) var<storage, read_write> partials: array<f32>;
@group(0) @binding(6) var<storage, read> control: array<u32>;

var<workgroup> regularizers: array<vec2f, 128>;

@compute @workgroup_size(128)
fn main(
    @builtin(global_invocation_id) id: vec3u,
    @builtin(workgroup_id) group: vec3u,
    @builtin(local_invocation_index) lane: u32,
) {
    let g = id.x;
    var terms = vec2f(0.0);
    if (g < u.counts.x && control[OVERFLOWED] == 0u) {
        if (sums[8u * g + 3u].w > 0.0) { terms = descend(g); }
    }
    regularizers[lane] = terms;
    workgroupBarrier();
    for (var half = 64u; half > 0u; half /= 2u) {
        if (lane < half) { regularizers[lane] += regularizers[lane + half]; }
        workgroupBarrier();
    }
    if (lane == 0u) {
        partials[SUM_ISOTROPIC * u.groups.w + group.x] = regularizers[0].x;
        partials[SUM_FLAT * u.groups.w + group.x] = regularizers[0].y;
    }
}

// Product of quaternions.
fn product(a: vec4f, b: vec4f) -> vec4f {
    return vec4f(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
}

// Moves one Gaussian; returns its isotropic and flatness terms, metres.
fn descend(g: u32) -> vec2f {
    let row = ROW_VECTORS * g;
    // Of the moments.
    let first = 2u * row;
    let second = first + ROW_VECTORS;
    let place = rows[row];
    let rotation = rows[row + 1u];
    let log_scale = rows[row + 2u].xyz;
    let m = linearize(place.xyz, rotation, log_scale, place.w);
    let s0 = sums[8u * g];
    let s1 = sums[8u * g + 1u];
    let s2 = sums[8u * g + 2u];
    let s3 = sums[8u * g + 3u];

    // ln α = −½ dᵀQd + … with d = pixel − mean: ∂L/∂mean = Q Σv·d and ∂L/∂Σ = ½ Q (Σv·ddᵀ) Q.
    let q = conic_of(m.covariance);
    let d_depth = s2.w;
    let d_mean = vec2f(q.x * s0.y + q.y * s0.z, q.y * s0.y + q.z * s0.z) - m.depth_slope * d_depth;
    let h00 = q.x * s0.w + q.y * s1.x;
    let h01 = q.x * s1.x + q.y * s1.y;
    let h10 = q.y * s0.w + q.z * s1.x;
    let h11 = q.y * s1.x + q.z * s1.y;
    // Twice ∂L/∂Σ; its last parts are those of the determinant that α is divided by the root of.
    let d_cov = vec3f(
        h00 * q.x + h01 * q.y - s0.x * q.x,
        h00 * q.y + h01 * q.z - s0.x * q.y,
        h10 * q.y + h11 * q.z - s0.x * q.z,
    );
    let by_area = s0.x / m.determinants.x;
    // Σ = Σ_k u_k u_kᵀ with u_k = J v_k, J = [fx/z (1, 0, −slope_x); fy/z (0, 1, −slope_y)].
    let focal = u.intrinsics.xy * m.inverse_z;
    var d_p_c = vec3f(focal * d_mean, d_depth);
    d_p_c.z -= dot(d_p_c.xy, m.p_c.xy) * m.inverse_z;
    var d_slope = vec2f(0.0);
    var d_axes: mat3x3<f32>;
    var d_log_scale: vec3f;
    for (var k = 0; k < 3; k++) {
        let i = m.axes_i[k];
        let v = m.axes_c[k];
        var d_u = vec2f(d_cov.x * i.x + d_cov.y * i.y, d_cov.y * i.x + d_cov.z * i.y);
        // ∂(½ ln det Σ_j u_j u_jᵀ)/∂u_k, the filter left out: from the sum of squares (u_k × u_j)².
        for (var j = 0; j < 3; j++) {
            let other = m.axes_i[j];
            d_u += by_area * cross2(i, other) * vec2f(other.y, -other.x);
        }
        let d_xy = focal * d_u;
        let d_v = vec3f(d_xy, -dot(d_xy, m.slope));
        d_slope -= d_xy * v.z;
        d_p_c.z -= dot(d_u, i) * m.inverse_z;
        d_axes[k] = to_world(d_v) * m.scale[k] + s3.xyz * (m.shortest[k] * m.facing);
        d_log_scale[k] = dot(d_v, v);
    }
    let d_ratio = d_slope * m.inverse_z * m.unclamped;
    d_p_c += vec3f(d_ratio, -dot(d_ratio, m.slope));

    // With the flatness term on, the isotropic term acts on the two larger scales only: the two would fight otherwise.
    let share = 1.0 / f32(max(control[SEEN], 1u));
    let flattening = (u.counts.w & FLATTENING) != 0u;
    let taken = select(vec3f(1.0), vec3f(1.0) - m.shortest, flattening);
    let by_number = select(1.0 / 3.0, 0.5, flattening);
    let mean = dot(taken, m.scale) * by_number;
    let signs = sign(m.scale - vec3f(mean)) * taken;
    let mean_sign = (signs.x + signs.y + signs.z) * by_number;
    d_log_scale += share * m.scale
        * (u.other_weights.y * (signs - vec3f(mean_sign)) * taken + u.other_weights.z * m.shortest);
    let terms = vec2f(dot(abs(m.scale - vec3f(mean)), taken), dot(m.shortest, m.scale));

    let d_place = vec4f(to_world(d_p_c), s0.x * (1.0 - m.opacity));
    let d_rotation = rotation_gradient(rotation, d_axes);
    let d_color = vec4f(s2.xyz, 0.0);
    let s4 = sums[8u * g + 4u];
    let s5 = sums[8u * g + 5u];
    let s6 = sums[8u * g + 6u];
    let s7 = sums[8u * g + 7u];
    let d_size = vec4f(d_log_scale, 0.0);
    // A Gaussian whose gradient is not finite is left as it is.
    if (!(all_finite(d_place) && all_finite(d_rotation) && all_finite(d_size) && all_finite(d_color)
        && all_finite(s4) && all_finite(s5) && all_finite(s6) && all_finite(s7))) {
        return select(vec2f(0.0), terms, vec2<bool>(is_finite(terms.x), is_finite(terms.y)));
    }
    let taken_steps = steps[g] + 1u;
    let correction = corrections[min(taken_steps, CORRECTIONS - 1u)];
    let r = u.rates;
    let c = u.more_rates;
    var p0 = adam(place, moments[first], moments[second], d_place, vec4f(r.xxx, r.w), correction);
    var p1 = adam(rotation, moments[first + 1u], moments[second + 1u], d_rotation, vec4f(r.y), correction);
    let off_plane = u.off_plane.x;
    if (off_plane < 1.0) {
        // Reduces the move along the normal of the disc, and the turn about axes in its plane (sms-gaussians, cpu/adam.rs).
        let moved = p0.value.xyz - place.xyz;
        let along = m.normal_w * dot(m.normal_w, moved);
        p0.value = vec4f(p0.value.xyz - (1.0 - off_plane) * along, p0.value.w);
        let turn = product(vec4f(-rotation.xyz, rotation.w), p1.value);
        p1.value = product(rotation, vec4f(turn.xyz * mix(vec3f(off_plane), vec3f(1.0), m.shortest), turn.w));
    }
    var p2 =
        adam(rows[row + 2u], moments[first + 2u], moments[second + 2u], d_size, vec4f(r.z), correction);
    var p3 = adam(rows[row + 3u], moments[first + 3u], moments[second + 3u], d_color, vec4f(c.x), correction);
    var p4 = adam(rows[row + 4u], moments[first + 4u], moments[second + 4u], s4, vec4f(c.y), correction);
    var p5 = adam(rows[row + 5u], moments[first + 5u], moments[second + 5u], s5, vec4f(c.y), correction);
    var p6 = adam(rows[row + 6u], moments[first + 6u], moments[second + 6u], s6, vec4f(c.y), correction);
    var p7 = adam(rows[row + 7u], moments[first + 7u], moments[second + 7u], s7, vec4f(c.y), correction);
    var harmonics: array<Moved, 6>;
    var harmonics_sound = true;
    if (c.w > 0.0) {
        let basis = basis_at(place.xyz);
        for (var q = 0u; q < 6u; q++) {
            var d: vec4f;
            for (var e = 0u; e < 4u; e++) {
                let i = 4u * q + e;
                d[e] = basis[i / 3u] * s2[i % 3u];
            }
            let at = first + 8u + q;
            harmonics[q] =
                adam(rows[row + 8u + q], moments[at], moments[at + ROW_VECTORS], d, vec4f(c.w), correction);
            harmonics_sound = harmonics_sound && all_finite(harmonics[q].value);
        }
    }
    let squared = dot(p1.value, p1.value);
    let sound = harmonics_sound && all_finite(p0.value) && all_finite(p1.value) && all_finite(p2.value) && all_finite(p3.value)
        && all_finite(p4.value) && all_finite(p5.value) && all_finite(p6.value) && all_finite(p7.value)
        && squared > 1e-12;
    if (!sound) {
        for (var k = 0u; k < 2u * ROW_VECTORS; k++) { moments[first + k] = vec4f(); }
        steps[g] = 0u;
        return terms;
    }
    p0.value.w = clamp(p0.value.w, -LOGIT_LIMIT, LOGIT_LIMIT);
    rows[row] = p0.value;
    rows[row + 1u] = p1.value / sqrt(squared);
    rows[row + 2u] = vec4f(clamp(p2.value.xyz, vec3f(LOG_SCALE_MIN), vec3f(LOG_SCALE_MAX)), 0.0);
    rows[row + 3u] = p3.value;
    rows[row + 4u] = p4.value;
    rows[row + 5u] = p5.value;
    rows[row + 6u] = p6.value;
    rows[row + 7u] = p7.value;
    moments[first] = p0.first;
    moments[first + 1u] = p1.first;
    moments[first + 2u] = p2.first;
    moments[first + 3u] = p3.first;
    moments[first + 4u] = p4.first;
    moments[first + 5u] = p5.first;
    moments[first + 6u] = p6.first;
    moments[first + 7u] = p7.first;
    moments[second] = p0.second;
    moments[second + 1u] = p1.second;
    moments[second + 2u] = p2.second;
    moments[second + 3u] = p3.second;
    moments[second + 4u] = p4.second;
    moments[second + 5u] = p5.second;
    moments[second + 6u] = p6.second;
    moments[second + 7u] = p7.second;
    if (c.w > 0.0) {
        for (var q = 0u; q < 6u; q++) {
            let at = first + 8u + q;
            rows[row + 8u + q] = harmonics[q].value;
            moments[at] = harmonics[q].first;
            moments[at + ROW_VECTORS] = harmonics[q].second;
        }
    }
    steps[g] = taken_steps;
    return terms;
}

// ∂L/∂(x, y, z, w) of a unit quaternion from ∂L/∂(columns of R), without the part along the quaternion itself.
fn rotation_gradient(q: vec4f, d: mat3x3<f32>) -> vec4f {
    let s01 = d[1][0] + d[0][1];
    let s02 = d[2][0] + d[0][2];
    let s12 = d[2][1] + d[1][2];
    let a01 = d[0][1] - d[1][0];
    let a02 = d[2][0] - d[0][2];
    let a12 = d[1][2] - d[2][1];
    let raw = 2.0 * vec4f(
        q.y * s01 + q.z * s02 + q.w * a12 - 2.0 * q.x * (d[1][1] + d[2][2]),
        q.x * s01 + q.z * s12 + q.w * a02 - 2.0 * q.y * (d[0][0] + d[2][2]),
        q.x * s02 + q.y * s12 + q.w * a01 - 2.0 * q.z * (d[0][0] + d[1][1]),
        q.z * a01 + q.y * a02 + q.x * a12,
    );
    return raw - dot(raw, q) * q;
}
