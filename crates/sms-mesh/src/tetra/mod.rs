//! Tetrahedra: Delaunay tetrahedralisation, selection of the solid's tetrahedra, and the solid's boundary.

mod boundary;
mod delaunay;
mod hilbert;
mod inside;
mod maxflow;

pub use crate::predicates::FACES;
pub use boundary::boundary;
pub(crate) use delaunay::to_circumcenter;
pub use delaunay::{NONE, Tetrahedralization, delaunay};
pub use inside::{cut, largest_component, normal_votes, prune};
