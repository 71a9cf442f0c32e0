// Colour that depends on the viewing direction (sms-gaussians, harmonics.rs): real spherical harmonics of degrees 1 and 2.

const BASIS = 8u;
const DEGREE_1 = 0.4886025;
const DEGREE_2 = vec3f(1.0925484, 0.31539157, 0.5462742);

// The basis functions at the direction from the camera to a Gaussian.
fn basis_at(p_w: vec3f) -> array<f32, BASIS> {
    let eye_w = -to_world(vec3f(u.camera[0].w, u.camera[1].w, u.camera[2].w));
    let offset = p_w - eye_w;
    let square = dot(offset, offset);
    let d = offset * select(0.0, 1.0 / sqrt(square), square > 0.0);
    return array<f32, BASIS>(
        -DEGREE_1 * d.y,
        DEGREE_1 * d.z,
        -DEGREE_1 * d.x,
        DEGREE_2.x * (d.x * d.y),
        -DEGREE_2.x * (d.y * d.z),
        DEGREE_2.y * (2.0 * d.z * d.z - d.x * d.x - d.y * d.y),
        -DEGREE_2.x * (d.x * d.z),
        DEGREE_2.z * (d.x * d.x - d.y * d.y),
    );
}
