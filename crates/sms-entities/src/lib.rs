//! From Gaussians to objects: grouping, meshing, spheres, convex parts.

mod delaunay;
mod hilbert;
mod hull;
mod predicates;

pub use delaunay::{FACES, NONE, Tetrahedralization, delaunay};
pub use hull::convex_hull;
