//! The scan: seeding, the sequential schedule with replay and pruning, the fused one, early stopping, checkpoint and exact resume,
//! evaluation on held-out views, and the model as a `.ply` (paper, Section "Scan").
//!
//! All code in this module uses the [`Trainer`](crate::Trainer) trait and is shared by all back ends.

mod appearance;
mod background;
mod checkpoint;
mod config;
mod consensus;
mod error;
mod evaluate;
mod frames;
mod fusion;
mod growing;
mod losses;
mod observer;
mod occupancy;
mod pace;
mod phases;
mod placement;
mod ply;
mod pruning;
mod saving;
mod schedule;
mod seeding;
mod settings;
mod so_far;
mod stages;
mod thinning;
mod unmeasured;
mod validate;
mod views;

#[cfg(test)]
mod fixture;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod watched_tests;

pub use config::{FusedConfig, Preset, PruningConfig, ScanConfig, ScanOrder, SeedingConfig, StopConfig};
pub use error::ScanError;
pub use evaluate::ViewScore;
pub use growing::{GROWING_CLASSES, GrowingScan};
pub use losses::LossSample;
pub use observer::{BatchDone, ScanObserver, ScanResumed, SlotDone};
pub use ply::{read_ply, write_ply};
pub use schedule::{ScanResult, scan};
pub use stages::StageSeconds;
pub use views::{ViewRender, render_views};
