//! Arguments of the program.

use crate::commands::billiards::BilliardsArguments;
use crate::commands::engines::EnginesArguments;
use crate::commands::landing::LandingArguments;
use crate::commands::masks::MaskStudyArguments;
use crate::commands::materialize::MaterializeStudyArguments;
use crate::commands::merge::MergeArguments;
use crate::commands::optimisers::OptimisersArguments;
use crate::commands::orbits::OrbitsArguments;
use crate::commands::physics::PhysicsArguments;
use crate::commands::plan::PlanSpeedArguments;
use crate::commands::real_like::RealLikeArguments;
use crate::commands::robust::RobustArguments;
use crate::commands::room::RoomArguments;
use crate::commands::scan::ScanStudyArguments;
use crate::commands::scenes::ScenesArguments;
use crate::commands::score::ScoreArguments;
use crate::commands::tracking::TrackingArguments;
use clap::{Parser, Subcommand};
use sms_cli::front::Common;

/// Experiments on `sms`: the paper's two, and studies of its stages on scenes with exact truth.
#[derive(Debug, Parser)]
#[command(name = "sms-experiments", version, about, propagate_version = true)]
pub(crate) struct ExperimentArguments {
    #[command(subcommand)]
    pub command: Experiment,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Experiment {
    /// Scan fixed generated scenes (and the real recordings, where present): time, memory and quality.
    Scan(Box<ScanStudyArguments>),
    /// Scan models of known shape (../shared/data/meshes) once, and measure the meshes made of the scans.
    Materialize(Box<MaterializeStudyArguments>),
    /// Compare masks from geometry with the true ones, on billiards scenes, stacked structures and a real shelf.
    Masks(MaskStudyArguments),
    /// Run closed-form experiments in the physics engines: impacts, throw, rolling, sliding, tipping, a stack.
    Physics(PhysicsArguments),
    /// Measure another program's reconstruction of a scene that `sms-experiments scan --export` wrote.
    Score(ScoreArguments),
    /// Compare search methods at equal numbers of simulated shots. The planner is given the true geometry and materials of
    /// generated scenes: this measures search, not reconstruction.
    Optimisers(OptimisersArguments),
    /// Refine the poses of generated orbits with faults of trackers and cameras: errors of scale, and of a box's extents.
    Orbits(OrbitsArguments),
    /// Estimate the camera poses of recordings from their images alone, and compare them with the recorded or true ones.
    Tracking(TrackingArguments),
    /// Find and reconstruct objects in recordings with the errors of real sensors: billiards scenes and stacks with each of five
    /// sensors.
    RealLike(RealLikeArguments),
    /// Scan a furnished room that a camera is carried through, and make its bodies: time, memory and quality.
    Room(RoomArguments),
    /// Compare nominal with robust planning at equal cost, in true worlds with other materials than the planner was given
    /// (`--materials noisy`) and slightly displaced bodies. True geometry of generated scenes; by default the striker is a
    /// kinematic finger, and the engine the planner's.
    Robust(RobustArguments),
    /// Simulate the same shots in every engine that is built in, and compare their ends.
    Engines(EnginesArguments),
    /// Measure the speed of simulated shots and of plans, and the share of each part.
    Plan(PlanSpeedArguments),
    /// Determine by brute force whether generated challenge scenes have a straight solution, or only rebounds.
    Scenes(ScenesArguments),
    /// Run the paper's billiards experiment: eighteen scenes are scanned and planned in from many starts, and every plan is
    /// executed in the target engines. A second run on the same folder resumes the first; shards share a folder.
    Billiards(Box<BilliardsArguments>),
    /// Run the paper's landing experiment: four structures are scanned, landings are planned from ten starts, and each is flown
    /// in the target world, together with baselines without a wash model. A second run on the same folder resumes the first.
    Landing(Box<LandingArguments>),
    /// Merge the parts of a run with --shard on several machines: the same tables and keys as one run.
    Merge(MergeArguments),
}
