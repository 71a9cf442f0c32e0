// Alpha of one splat at one pixel, before transmittance (sms-gaussians, cpu/tile.rs). A record is
// mean 2, power 3, log2 opacity, slope of depth 2; then colour and depth; then normal and one.

struct Alpha {
    // Alpha, not yet zeroed where it is too little.
    value: f32,
    enough: bool,
    // Whether alpha still depends on the exponent.
    free: bool,
}

fn alpha_at(r0: vec4f, r1: vec4f, d: vec2f) -> Alpha {
    let exponent = r1.y + d.x * (r0.z * d.x + r0.w * d.y) + r1.x * d.y * d.y;
    // Rounding can lift the exponent of a very eccentric splat above its maximum.
    let t = min(exponent, r1.y);
    return Alpha(exp2(min(t, LOG2_ALPHA_MAX)), t >= LOG2_ALPHA_MIN, t < LOG2_ALPHA_MAX);
}
