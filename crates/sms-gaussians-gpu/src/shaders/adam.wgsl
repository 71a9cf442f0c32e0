// Adam (Kingma and Ba 2015) as on the CPU (sms-gaussians, cpu/adam.rs).

const BETA1 = 0.9;
const BETA2 = 0.999;
const EPSILON = 1e-15;
const FIRST_MIN = 1e-30;
const SECOND_MIN = 1e-36;
const GRADIENT_MAX = 1e12;

struct Moved {
    value: vec4f,
    first: vec4f,
    second: vec4f,
}

fn adam(value: vec4f, first: vec4f, second: vec4f, gradient: vec4f, rate: vec4f, correction: vec2f) -> Moved {
    let g = clamp(gradient, vec4f(-GRADIENT_MAX), vec4f(GRADIENT_MAX));
    let m = BETA1 * first + (1.0 - BETA1) * g;
    let v = BETA2 * second + (1.0 - BETA2) * (g * g);
    var out: Moved;
    out.first = select(vec4f(0.0), m, abs(m) > vec4f(FIRST_MIN));
    out.second = select(vec4f(0.0), v, v > vec4f(SECOND_MIN));
    out.value = value - rate * out.first * correction.x / (sqrt(out.second * correction.y) + EPSILON);
    return out;
}
