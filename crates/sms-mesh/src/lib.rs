//! Generic geometry of points, triangles and planes: hulls, convex decomposition, tetrahedralisation, fits, open surfaces.
//!
//! - [`convex_parts`]: approximate convex decomposition of a mesh (paper, Section "Materialize"); [`convex_hull`].
//! - [`tetra`]: Delaunay tetrahedralisation, and rules that choose the tetrahedra of a solid.
//! - [`fit_sphere`], [`fit_primitive`]: spheres, boxes and cylinders fitted to a cloud.
//! - [`outline`]: convex polygons in the plane.
//! - [`triangulate`]: open meshes through oriented points. [`decimate`], [`simplify`], [`taubin`]: fewer faces, smoother ones.
//! - [`cloud`], [`PointGrid`], [`Plane`]: point clouds, neighbour queries, planes.
//!
//! ```
//! use sms_core::{Mesh, Seed, glamx::DVec3};
//! use sms_mesh::{ConvexConfig, SphereConfig, convex_parts, fit_sphere, tetra::delaunay};
//! // A ball is recognised by its shape …
//! let ball = Mesh::icosphere(0.03, 3);
//! let fit = fit_sphere(&ball.vertices, &SphereConfig::default(), Seed(0)).unwrap();
//! assert!((fit.radius - 0.03).abs() < 1e-4);
//! // … and a box is one convex part that its tetrahedra fill.
//! let cube = Mesh::cuboid(DVec3::splat(0.05));
//! assert_eq!(convex_parts(&cube, &ConvexConfig::default()).len(), 1);
//! let solid = delaunay(&cube.vertices);
//! let volume: f64 = (0..solid.tetrahedra.len()).map(|t| solid.volume(t)).sum();
//! assert!((volume - 1e-3).abs() < 1e-12);
//! ```

mod clip;
pub mod cloud;
mod convex;
mod decimate;
mod distance;
mod fit;
mod hull;
mod limit;
pub mod outline;
mod pca;
mod plane;
mod point_grid;
mod predicates;
mod smooth;
mod statistics;
pub mod tetra;
mod triangulate;
mod union_find;

pub use clip::clip;
pub use convex::{ConvexConfig, convex_parts, convex_parts_cached};
pub use decimate::decimate;
pub use distance::distances;
pub use fit::{
    PrimitiveConfig, PrimitiveFit, RaySample, SphereConfig, SphereFit, fit_primitive, fit_sphere,
    primitive_mesh, refine_on_rays,
};
pub use hull::convex_hull;
pub use limit::limited_hull;
pub use pca::{principal_axes, scatter};
pub use plane::Plane;
pub use point_grid::PointGrid;
pub use smooth::{colors_from, simplify, taubin};
pub use statistics::{median, quantile};
pub use triangulate::triangulate;
