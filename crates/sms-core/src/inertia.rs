//! Mass, centre of mass and inertia; physically impossible values cannot be constructed.

use crate::Mesh;
use glamx::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Reasons to refuse a mass or inertia.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum InertiaError {
    /// Mass is not positive and finite.
    #[error("mass must be positive and finite, got {0} kg")]
    Mass(f64),
    /// The inertia is not symmetric, positive definite, and satisfying A + B ≥ C for its principal moments.
    #[error("principal moments {0:?} kg·m² are not those of any mass distribution")]
    Moments([f64; 3]),
    /// The mesh encloses no positive volume.
    #[error("the mesh encloses no positive volume ({0} m³)")]
    Volume(f64),
}

/// Mass properties of a rigid body, in the frame its geometry is given in.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawMassProperties", into = "RawMassProperties")]
pub struct MassProperties {
    mass: f64,
    com: DVec3,
    inertia: DMat3,
}

#[derive(Serialize, Deserialize)]
struct RawMassProperties {
    mass_kg: f64,
    com_m: DVec3,
    inertia_kg_m2: [[f64; 3]; 3],
}

impl TryFrom<RawMassProperties> for MassProperties {
    type Error = InertiaError;
    fn try_from(raw: RawMassProperties) -> Result<Self, InertiaError> {
        let inertia = DMat3::from_cols_array_2d(&raw.inertia_kg_m2);
        Self::new(raw.mass_kg, raw.com_m, inertia)
    }
}

impl From<MassProperties> for RawMassProperties {
    fn from(m: MassProperties) -> Self {
        Self { mass_kg: m.mass, com_m: m.com, inertia_kg_m2: m.inertia.to_cols_array_2d() }
    }
}

impl MassProperties {
    /// Creates checked mass properties.
    ///
    /// # Errors
    /// [`InertiaError`] unless mass > 0 and the moments are physically possible (within rounding).
    pub fn new(mass: f64, com: DVec3, inertia: DMat3) -> Result<Self, InertiaError> {
        if !(mass > 0.0 && mass.is_finite() && com.is_finite()) {
            return Err(InertiaError::Mass(mass));
        }
        let symmetric = 0.5 * (inertia + inertia.transpose());
        let eigen = glamx::DSymmetricEigen3::new(symmetric);
        let [a, b, c] = eigen.eigenvalues.to_array();
        let largest = a.max(b).max(c);
        let slack = 1e-9 * largest;
        let possible = symmetric.is_finite()
            && a.min(b).min(c) > 0.0
            && a + b + slack >= c
            && b + c + slack >= a
            && a + c + slack >= b
            && (inertia - symmetric).abs_diff_eq(DMat3::ZERO, 1e-6 * largest);
        if possible {
            Ok(Self { mass, com, inertia: symmetric })
        } else {
            Err(InertiaError::Moments([a, b, c]))
        }
    }

    /// Returns the mass in kg.
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// Returns the centre of mass in metres.
    pub fn com(&self) -> DVec3 {
        self.com
    }

    /// Returns the rotational inertia about the centre of mass, kg·m², in the axes of the geometry's frame.
    pub fn inertia(&self) -> DMat3 {
        self.inertia
    }

    /// Principal moments of inertia (kg·m²) about the centre of mass, and the rotation that carries the principal axes
    /// into the geometry's frame. Diagonalised at unit scale: the solver's tolerances would swallow the inertia of a
    /// small body, 1e-6 kg·m².
    pub fn principal(&self) -> (DVec3, DQuat) {
        let scale = trace(self.inertia);
        let eigen = glamx::DSymmetricEigen3::new(self.inertia * (1.0 / scale));
        let mut axes = eigen.eigenvectors;
        if axes.determinant() < 0.0 {
            axes = DMat3::from_cols(axes.x_axis, axes.y_axis, -axes.z_axis);
        }
        (eigen.eigenvalues * scale, DQuat::from_mat3(&axes).normalize())
    }
}

/// Computes the exact mass properties of a homogeneous closed mesh with `density` kg/m³, by integration over the tetrahedra
/// that each face spans with a reference point (Tonon 2004; Eberly, "Polyhedral Mass Properties").
///
/// # Errors
/// [`InertiaError::Volume`] when the mesh encloses no positive volume.
pub fn polyhedron_mass_properties(mesh: &Mesh, density: f64) -> Result<MassProperties, InertiaError> {
    // Integrating about a vertex of the mesh keeps cancellation small when the body is far from the origin.
    let origin = mesh.vertices.first().copied().unwrap_or(DVec3::ZERO);
    let mut volume = 0.0;
    let mut first = DVec3::ZERO;
    let mut second = DMat3::ZERO;
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t).map(|p| p - origin);
        let det = a.dot(b.cross(c));
        volume += det / 6.0;
        first += (a + b + c) * (det / 24.0);
        // ∫ x xᵀ over the tetrahedron (0,a,b,c) = det/120 · (Σ pᵢpᵢᵀ + s sᵀ), s = a+b+c.
        let s = a + b + c;
        second += (outer(a) + outer(b) + outer(c) + outer(s)) * (det / 120.0);
    }
    if !(volume > 0.0 && volume.is_finite()) {
        return Err(InertiaError::Volume(volume));
    }
    let com = first / volume;
    let central = second - outer(com) * volume;
    let inertia = (DMat3::from_diagonal(DVec3::splat(trace(central))) - central) * density;
    MassProperties::new(volume * density, com + origin, inertia)
}

/// Computes the mass properties of a homogeneous solid sphere.
///
/// # Errors
/// [`InertiaError::Mass`] when radius or density is not positive.
pub fn sphere_mass_properties(
    center: DVec3,
    radius: f64,
    density: f64,
) -> Result<MassProperties, InertiaError> {
    let mass = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3) * density;
    MassProperties::new(mass, center, DMat3::from_diagonal(DVec3::splat(0.4 * mass * radius * radius)))
}

/// Computes the mass properties of a homogeneous box centred at the origin with its edges along the axes.
///
/// # Errors
/// [`InertiaError::Mass`] when a half extent or the density is not positive.
pub fn box_mass_properties(half_extents: DVec3, density: f64) -> Result<MassProperties, InertiaError> {
    let positive = half_extents.cmpgt(DVec3::ZERO).all();
    let mass = if positive { 8.0 * half_extents.element_product() * density } else { f64::NAN };
    let sq = half_extents * half_extents;
    let moments = DVec3::new(sq.y + sq.z, sq.x + sq.z, sq.x + sq.y) * (mass / 3.0);
    MassProperties::new(mass, DVec3::ZERO, DMat3::from_diagonal(moments))
}

/// Computes the mass properties of a homogeneous cylinder centred at the origin with its axis along z.
///
/// # Errors
/// [`InertiaError::Mass`] when a length or the density is not positive.
pub fn cylinder_mass_properties(
    radius: f64,
    half_length: f64,
    density: f64,
) -> Result<MassProperties, InertiaError> {
    let positive = radius > 0.0 && half_length > 0.0;
    let volume = 2.0 * std::f64::consts::PI * radius * radius * half_length;
    let mass = if positive { volume * density } else { f64::NAN };
    let across = mass * (radius * radius / 4.0 + half_length * half_length / 3.0);
    let moments = DVec3::new(across, across, 0.5 * mass * radius * radius);
    MassProperties::new(mass, DVec3::ZERO, DMat3::from_diagonal(moments))
}

fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

fn trace(m: DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;
    use proptest::prelude::*;

    #[test]
    fn moments_and_axes_give_the_inertia_back() {
        let flat = box_mass_properties(DVec3::new(0.01, 0.02, 0.003), 700.0).unwrap();
        let turn = DMat3::from_quat(DQuat::from_rotation_z(0.4) * DQuat::from_rotation_x(1.1));
        let inertia = turn * flat.inertia() * turn.transpose();
        let mass = MassProperties::new(flat.mass(), DVec3::ZERO, inertia).unwrap();
        let (moments, axes) = mass.principal();
        let axes = DMat3::from_quat(axes);
        let back = axes * DMat3::from_diagonal(moments) * axes.transpose();
        let off = (back - inertia).to_cols_array().iter().fold(0.0f64, |m, e| m.max(e.abs()));
        assert!(off < 1e-12 * moments.max_element() * 1e3, "{off} of {moments}");
    }

    #[test]
    fn a_box_has_its_textbook_inertia_wherever_it_is() {
        let half = DVec3::new(0.05, 0.1, 0.02);
        let pose = DPose3::from_parts(DVec3::new(3.0, -2.0, 5.0), DQuat::IDENTITY);
        let m = polyhedron_mass_properties(&Mesh::cuboid(half).transformed(&pose), 800.0).unwrap();
        let mass = 8.0 * half.x * half.y * half.z * 800.0;
        assert!((m.mass() / mass - 1.0).abs() < 1e-12);
        assert!((m.com() - pose.translation).length() < 1e-12);
        let expected = mass / 3.0 * (half.y * half.y + half.z * half.z);
        assert!((m.inertia().x_axis.x / expected - 1.0).abs() < 1e-9);
        assert!(m.inertia().x_axis.y.abs() < 1e-12);
    }

    #[test]
    fn closed_forms_agree_with_the_integral_over_fine_meshes() {
        let half = DVec3::new(0.05, 0.1, 0.02);
        let exact = box_mass_properties(half, 800.0).unwrap();
        let meshed = polyhedron_mass_properties(&Mesh::cuboid(half), 800.0).unwrap();
        assert!((exact.inertia() - meshed.inertia()).abs_diff_eq(DMat3::ZERO, 1e-12));
        let exact = cylinder_mass_properties(0.03, 0.08, 800.0).unwrap();
        let meshed = polyhedron_mass_properties(&Mesh::cylinder(0.03, 0.08, 2000), 800.0).unwrap();
        assert!((exact.mass() / meshed.mass() - 1.0).abs() < 1e-5);
        assert!(
            (exact.inertia() - meshed.inertia()).abs_diff_eq(DMat3::ZERO, 2e-5 * exact.inertia().x_axis.x)
        );
        assert!(box_mass_properties(DVec3::new(-1.0, -1.0, 1.0), 800.0).is_err());
        assert!(cylinder_mass_properties(0.1, 0.0, 800.0).is_err());
    }

    #[test]
    fn impossible_inertia_is_refused() {
        let thin = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 3.0));
        assert!(matches!(MassProperties::new(1.0, DVec3::ZERO, thin), Err(InertiaError::Moments(_))));
        assert!(matches!(
            MassProperties::new(-1.0, DVec3::ZERO, DMat3::IDENTITY),
            Err(InertiaError::Mass(_))
        ));
        let inside_out = {
            let mut mesh = Mesh::cuboid(DVec3::ONE);
            mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
            mesh
        };
        assert!(matches!(polyhedron_mass_properties(&inside_out, 1.0), Err(InertiaError::Volume(_))));
    }

    proptest! {
        #[test]
        fn rotating_the_mesh_rotates_the_inertia(x in -3.0..3.0f64, y in -3.0..3.0f64, z in -3.0..3.0f64) {
            let q = DQuat::from_scaled_axis(DVec3::new(x, y, z));
            let mesh = Mesh::cuboid(DVec3::new(0.1, 0.2, 0.05));
            let still = polyhedron_mass_properties(&mesh, 1000.0).unwrap().inertia();
            let turned = mesh.transformed(&DPose3::from_parts(DVec3::ZERO, q));
            let turned = polyhedron_mass_properties(&turned, 1000.0).unwrap().inertia();
            let r = DMat3::from_quat(q);
            prop_assert!((r * still * r.transpose()).abs_diff_eq(turned, 1e-9));
        }
    }
}
