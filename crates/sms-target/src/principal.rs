//! Principal axes of a body's mass, as engines want them.

use glamx::{DMat3, DQuat, DSymmetricEigen3, DVec3};
use sms_core::MassProperties;

/// Principal moments of inertia (kg·m²) about the centre of mass and the rotation that carries principal axes into the
/// body's frame. Diagonalised at unit scale: the inertia of a small body, 1e-6 kg·m², is lost in tolerances else.
pub(crate) fn principal(mass: &MassProperties) -> (DVec3, DQuat) {
    let inertia = mass.inertia();
    let scale = inertia.x_axis.x + inertia.y_axis.y + inertia.z_axis.z;
    let eigen = DSymmetricEigen3::new(inertia * (1.0 / scale));
    let mut axes = eigen.eigenvectors;
    if axes.determinant() < 0.0 {
        axes = DMat3::from_cols(axes.x_axis, axes.y_axis, -axes.z_axis);
    }
    (eigen.eigenvalues * scale, DQuat::from_mat3(&axes).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::box_mass_properties;

    #[test]
    fn moments_and_axes_give_the_inertia_back() {
        let flat = box_mass_properties(DVec3::new(0.01, 0.02, 0.003), 700.0).unwrap();
        let turn = DMat3::from_quat(DQuat::from_rotation_z(0.4) * DQuat::from_rotation_x(1.1));
        let inertia = turn * flat.inertia() * turn.transpose();
        let mass = MassProperties::new(flat.mass(), DVec3::ZERO, inertia).unwrap();
        let (moments, axes) = principal(&mass);
        let axes = DMat3::from_quat(axes);
        let back = axes * DMat3::from_diagonal(moments) * axes.transpose();
        let off = (back - inertia).to_cols_array().iter().fold(0.0f64, |m, e| m.max(e.abs()));
        assert!(off < 1e-12 * moments.max_element() * 1e3, "{off} of {moments}");
    }
}
