//! Approximate convex decomposition of meshes.

mod cache;
mod cap;
mod config;
mod merge;
mod occupancy;
mod parts;
mod piece;
mod remesh;
mod repair;
mod round;
mod search;
mod solid;
mod sweep;
mod work;

pub use cache::convex_parts_cached;
pub use config::ConvexConfig;
pub use parts::convex_parts;
