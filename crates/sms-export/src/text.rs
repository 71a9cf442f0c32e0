//! Numbers, names and colours as text, and rotations in other conventions.

use glamx::{DMat3, DPose3, DQuat, DVec3};
use sms_core::MassProperties;

/// Formats a number for a file: nanometre resolution, stable text, no negative zero.
pub(crate) fn number(value: f64) -> String {
    let text = format!("{value:.9}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.to_owned() }
}

/// Formats numbers separated by spaces.
pub(crate) fn numbers(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().map(number).collect::<Vec<_>>().join(" ")
}

/// Formats a small number (an inertia in kg·m²) with ten significant digits.
pub(crate) fn small(value: f64) -> String {
    format!("{value:.9e}")
}

/// Formats sRGB in [0, 1], with alpha 1.
pub(crate) fn rgba(color: [u8; 3]) -> String {
    let [r, g, b] = color.map(|c| f64::from(c) / 255.0);
    format!("{r:.4} {g:.4} {b:.4} 1")
}

/// Converts an sRGB byte to linear light in [0, 1] (IEC 61966-2-1).
pub(crate) fn linear(byte: u8) -> f64 {
    let c = f64::from(byte) / 255.0;
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Returns roll, pitch and yaw (about fixed x, then y, then z; radians), the convention of URDF and SDFormat.
pub(crate) fn rpy(q: DQuat) -> DVec3 {
    let m = DMat3::from_quat(q);
    // m = Rz(yaw) Ry(pitch) Rx(roll).
    let sin_pitch = -m.x_axis.z;
    let cos_pitch = m.x_axis.x.hypot(m.x_axis.y);
    let pitch = sin_pitch.atan2(cos_pitch);
    if cos_pitch > 1e-9 {
        return DVec3::new(m.y_axis.z.atan2(m.z_axis.z), pitch, m.x_axis.y.atan2(m.x_axis.x));
    }
    // At a pitch of ±90°, roll and yaw turn about the same axis: all of it is yaw.
    DVec3::new(0.0, pitch, (-m.y_axis.x).atan2(m.y_axis.y))
}

/// Formats position, then roll, pitch and yaw: the six numbers of an SDFormat pose.
pub(crate) fn pose_rpy(pose: &DPose3) -> String {
    numbers(pose.translation.to_array().into_iter().chain(rpy(pose.rotation).to_array()))
}

/// Returns the principal moments of inertia in kg·m² and the rotation `R_BP` that carries their axes into the body frame `B`.
/// Every format accepts moments in this form, so that no reader has to diagonalise a rounded matrix.
pub(crate) fn principal(mass: &MassProperties) -> (DVec3, DQuat) {
    // Jacobi rotations: unlike closed forms, they are exact to rounding for nearly equal moments (a can, a bottle) and at every
    // size.
    let mut a = mass.inertia().to_cols_array_2d();
    let mut axes = DMat3::IDENTITY.to_cols_array_2d();
    for _ in 0..16 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q].abs() <= 1e-15 * (a[0][0] + a[1][1] + a[2][2]) {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let tan = theta.signum() / (theta.abs() + theta.hypot(1.0));
            let cos = 1.0 / tan.hypot(1.0);
            let sin = tan * cos;
            let mix = |x: f64, y: f64| (cos * x - sin * y, sin * x + cos * y);
            for k in 0..3 {
                (a[k][p], a[k][q]) = mix(a[k][p], a[k][q]);
                (axes[p][k], axes[q][k]) = mix(axes[p][k], axes[q][k]);
            }
            for k in 0..3 {
                (a[p][k], a[q][k]) = mix(a[p][k], a[q][k]);
            }
        }
    }
    let moments = DVec3::new(a[0][0], a[1][1], a[2][2]);
    (moments, DQuat::from_mat3(&DMat3::from_cols_array_2d(&axes)).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from_rpy(v: DVec3) -> DQuat {
        DQuat::from_rotation_z(v.z) * DQuat::from_rotation_y(v.y) * DQuat::from_rotation_x(v.x)
    }

    #[test]
    fn roll_pitch_yaw_give_the_rotation_back() {
        let half = std::f64::consts::FRAC_PI_2;
        for x in [-2.5, -0.3, 0.0, 1.1, 3.0] {
            for y in [-half, -0.9, 0.0, 0.4, half] {
                for z in [-3.0, 0.0, 0.7] {
                    let q = from_rpy(DVec3::new(x, y, z));
                    let back = from_rpy(rpy(q));
                    assert!(q.dot(back).abs() > 1.0 - 1e-12, "{x} {y} {z}");
                }
            }
        }
    }

    #[test]
    fn principal_axes_give_the_inertia_back() {
        let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.5, -0.2, 0.9)));
        // From a crate to a crumb; with different, nearly equal and equal moments.
        for scale in [1.0, 1e-4, 1e-8, 1e-12] {
            for moments in [[1.0, 2.0, 2.5], [1.0, 1.0 + 1e-9, 1.5], [1.0, 1.0, 1.0], [0.1, 1.14, 1.2]] {
                let moments = scale * DVec3::from_array(moments);
                let inertia = turn * DMat3::from_diagonal(moments) * turn.transpose();
                let mass = MassProperties::new(0.3, DVec3::ZERO, inertia).unwrap();
                let (found, q) = principal(&mass);
                let r = DMat3::from_quat(q);
                let back = r * DMat3::from_diagonal(found) * r.transpose();
                assert!(back.abs_diff_eq(mass.inertia(), 1e-14 * scale), "{moments}: {found}");
            }
        }
    }

    #[test]
    fn numbers_are_short_and_stable() {
        assert_eq!(numbers([1.0, -0.0, 0.1 + 0.2, -1e-12, 100.0]), "1 0 0.3 0 100");
        assert!((linear(188) - 0.502_886).abs() < 1e-6);
    }
}
