//! Approximate convex decomposition: a mesh in, convex parts out (paper, Section "Materialize").
//!
//! ```
//! use sms_mesh::{ConvexConfig, convex_parts};
//! use sms_core::{Mesh, glamx::DVec3};
//! let cube = Mesh::cuboid(DVec3::splat(0.05));
//! assert_eq!(convex_parts(&cube, &ConvexConfig::default()).len(), 1);
//! ```

mod cache;
mod cap;
mod clip;
mod config;
mod convex;
mod hull;
mod limit;
mod merge;
mod occupancy;
mod piece;
mod predicates;
mod remesh;
mod repair;
mod round;
mod search;
mod solid;
mod sweep;
mod work;

pub use cache::convex_parts_cached;
pub use clip::clip;
pub use config::ConvexConfig;
pub use convex::convex_parts;
pub use hull::convex_hull;
pub use limit::limited_hull;
pub use predicates::{collinear, orient};
