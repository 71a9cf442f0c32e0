//! Small dense matrices of fixed capacity, without heap allocation.

use glamx::{DMat3, DVec3};

/// Largest number of moving joints.
pub const MAX_JOINTS: usize = 16;

/// The inertia of a unit point mass at `r`: (r·r) 1 − r rᵀ.
pub(crate) fn point_inertia(r: DVec3) -> DMat3 {
    let d = r.length_squared();
    DMat3::from_cols(
        DVec3::new(d - r.x * r.x, -r.x * r.y, -r.x * r.z),
        DVec3::new(-r.y * r.x, d - r.y * r.y, -r.y * r.z),
        DVec3::new(-r.z * r.x, -r.z * r.y, d - r.z * r.z),
    )
}
