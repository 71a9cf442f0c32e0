//! One file for each command.

pub(crate) mod billiards;
pub(crate) mod engines;
mod gpu;
pub(crate) mod landing;
pub(crate) mod masks;
pub(crate) mod materialize;
pub(crate) mod merge;
pub(crate) mod optimisers;
pub(crate) mod orbits;
pub(crate) mod physics;
pub(crate) mod plan;
pub(crate) mod real_like;
pub(crate) mod robust;
pub(crate) mod room;
pub(crate) mod scan;
pub(crate) mod scenes;
pub(crate) mod score;
mod shared;
pub(crate) mod tracking;
