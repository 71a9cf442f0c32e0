// EWA projection of one Gaussian, and intermediate results shared with its gradient (sms-gaussians, cpu/project.rs).

struct Linearized {
    p_c: vec3f,
    inverse_z: f32,
    scale: vec3f,
    opacity: f32,
    // Clamped x/z and y/z, and one where they were not clamped.
    slope: vec2f,
    unclamped: vec2f,
    // Axes times scale, in the camera and in the image (pixels).
    axes_c: mat3x3<f32>,
    axes_i: mat3x2<f32>,
    // 2-D covariance with the low-pass filter: xx, xy, yy.
    covariance: vec3f,
    // Determinants without the filter, plus its floor, and with it.
    determinants: vec2f,
    depth_slope: vec2f,
    // One for the shortest axis.
    shortest: vec3f,
    facing: f32,
    normal_w: vec3f,
    valid: bool,
}

fn to_camera(v: vec3f) -> vec3f {
    return vec3f(dot(u.camera[0].xyz, v), dot(u.camera[1].xyz, v), dot(u.camera[2].xyz, v));
}

fn to_world(v: vec3f) -> vec3f {
    return v.x * u.camera[0].xyz + v.y * u.camera[1].xyz + v.z * u.camera[2].xyz;
}

fn cross2(a: vec2f, b: vec2f) -> f32 {
    return a.x * b.y - a.y * b.x;
}

fn rotation_columns(q: vec4f) -> mat3x3<f32> {
    let two = q.xyz + q.xyz;
    let xx = q.x * two.x; let yy = q.y * two.y; let zz = q.z * two.z;
    let xy = q.x * two.y; let xz = q.x * two.z; let yz = q.y * two.z;
    let wx = q.w * two.x; let wy = q.w * two.y; let wz = q.w * two.z;
    return mat3x3<f32>(
        vec3f(1.0 - (yy + zz), xy + wz, xz - wy),
        vec3f(xy - wz, 1.0 - (xx + zz), yz + wx),
        vec3f(xz + wy, yz - wx, 1.0 - (xx + yy)),
    );
}

fn linearize(p_w: vec3f, rotation: vec4f, log_scale: vec3f, logit: f32) -> Linearized {
    var m: Linearized;
    m.p_c = to_camera(p_w) + vec3f(u.camera[0].w, u.camera[1].w, u.camera[2].w);
    let z = m.p_c.z;
    m.valid = is_finite(m.p_c.x) && is_finite(m.p_c.y) && is_finite(z) && z >= NEAR && z <= FAR;
    m.inverse_z = 1.0 / z;
    let axes_w = rotation_columns(rotation);
    m.scale = exp2(log_scale * LOG2_E);
    let ratio = m.p_c.xy * m.inverse_z;
    m.slope = clamp(ratio, u.limits.xz, u.limits.yw);
    m.unclamped = select(vec2f(0.0), vec2f(1.0), (ratio >= u.limits.xz) & (ratio <= u.limits.yw));
    let focal = u.intrinsics.xy * m.inverse_z;
    m.covariance = vec3f(LOW_PASS, 0.0, LOW_PASS);
    // With the filter of depth's slope instead.
    var bare = vec3f(0.0);
    var with_z = vec2f(0.0);
    for (var k = 0; k < 3; k++) {
        let v = to_camera(axes_w[k] * m.scale[k]);
        let i = focal * (v.xy - m.slope * v.z);
        m.axes_c[k] = v;
        m.axes_i[k] = i;
        let square = vec3f(i.x * i.x, i.x * i.y, i.y * i.y);
        m.covariance += square;
        bare += square;
        with_z += i * v.z;
    }
    let c0 = cross2(m.axes_i[0], m.axes_i[1]);
    let c1 = cross2(m.axes_i[0], m.axes_i[2]);
    let c2 = cross2(m.axes_i[1], m.axes_i[2]);
    let crossed = c0 * c0 + (c1 * c1 + c2 * c2);
    m.determinants = vec2f(
        crossed + AREA_FLOOR,
        LOW_PASS * (m.covariance.x + m.covariance.z - LOW_PASS) + crossed,
    );
    let s = vec3f(bare.x + SLOPE_LOW_PASS, bare.y, bare.z + SLOPE_LOW_PASS);
    let by_determinant = 1.0 / (SLOPE_LOW_PASS * (s.x + s.z - SLOPE_LOW_PASS) + crossed);
    m.depth_slope =
        vec2f(s.z * with_z.x - s.y * with_z.y, s.x * with_z.y - s.y * with_z.x) * by_determinant;
    let first = log_scale.y >= log_scale.x && log_scale.z >= log_scale.x;
    let second = !first && log_scale.z >= log_scale.y;
    m.shortest = vec3f(f32(first), f32(second), f32(!first && !second));
    let axis_c = m.axes_c * m.shortest;
    m.facing = select(1.0, -1.0, dot(axis_c, m.p_c) > 0.0);
    m.normal_w = (axes_w * m.shortest) * m.facing;
    m.opacity = 1.0 / (1.0 + exp2(-logit * LOG2_E));
    return m;
}

// Inverse of the 2-D covariance.
fn conic_of(c: vec3f) -> vec3f {
    let inverse = 1.0 / (c.x * c.z - c.y * c.y);
    return vec3f(c.z, -c.y, c.x) * inverse;
}
