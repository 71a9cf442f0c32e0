//! Spheres, boxes and cylinders fitted to point clouds.

mod config;
mod linear;
mod primitive;
mod sphere;

pub use config::{PrimitiveConfig, SphereConfig};
pub use primitive::{PrimitiveFit, fit_primitive, primitive_mesh};
pub use sphere::{RaySample, SphereFit, fit_sphere, refine_on_rays};
