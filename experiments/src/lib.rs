//! The paper's experiments, and studies of the stages of `sms` on scenes with exact truth.
//!
//! - [`run_scene`] scans one of the [`SEEDS`] of the billiards family, or a real recording, and measures the result by
//!   [`sms_eval`] against the generator's truth. `sms-experiments scan` runs it for every scene in a process of its own, so
//!   that peak memory is the scene's.
//! - [`export_scene`] writes the input of a scan and its truth for other programs; [`score_files`] measures their results
//!   by the same functions.
//! - [`run_masks`] scores masks, [`run_materialize`] the entities of scanned models.
//! - [`run_real_like`] does both on recordings with the errors of real sensors.
//! - [`run_optimisers`] compares search methods on generated scenes; [`run_robust`] compares plans in true worlds that are
//!   samples of the planner's uncertainty.
//! - [`run_billiards`] is the paper's Table 1 on eighteen fixed scenes: scan, materialize, plan, execute in the target
//!   worlds.
//! - [`run_landings`] is its landing experiment on four structures, with baselines without a wash model.
//! - [`Shard`] holds the results of a part (`--shard i/n`) of a run on several machines; [`merge_shards`] merges them.
//!
//! ```
//! use sms_experiments::part_of;
//! assert_eq!(part_of(vec![1001, 1002, 1003, 1004], (2, 2)), [1002, 1004]);
//! ```

mod align;
mod billiards;
mod bootstrap;
mod cpu_time;
mod disturb;
mod engines;
mod error;
mod export;
mod furniture;
mod growing;
mod landing;
mod masks;
mod material_prior;
mod materialize;
mod models;
mod optimisers;
mod options;
mod orbits;
mod panels;
mod plan_scenes;
mod plan_speed;
mod prepare;
mod reachability;
mod real;
mod real_like;
mod recordings;
mod redrawn;
mod reference;
mod robust;
mod robust_table;
mod room;
mod run;
mod scenes;
mod score;
mod seed_parts;
mod shards;
mod shown_view;
mod solvability;
mod stacked;
mod steps;
mod table;
mod timer;
mod tracking;
mod trainer;
mod true_worlds;
#[path = "../../crates/sms-gaussians/benches/scene/wall.rs"]
mod wall;

pub use billiards::{
    Ablated, Ablation, BilliardsBench, BilliardsGeometry, BilliardsScene, Drawing, GridBaseline, GridPlan,
    Replaced, Row, Shot, Unfinished, Way, billiards_metrics, billiards_table, paper_entities, read_billiards,
    run_billiards, scan_billiards, write_pictures, write_shots,
};
pub use disturb::{Disturbance, parse_length_m, parse_pose_noise};
pub use engines::{engines_table, run_engines};
pub use error::BenchError;
pub use export::{DEPTH_UNIT_M, export_scene};
pub use landing::{
    EdgeLoad, LandingBaseline, LandingBench, LandingChoice, LandingFlight, LandingPart, LandingPlanned,
    LandingScan, LandingSight, Standing, landing_metrics, landing_scan_metrics, landing_table, read_landings,
    run_landing, run_landings, scan_landings,
};
pub use masks::{masks_metrics, masks_table, run_masks};
pub use material_prior::{
    DENSITY_LOG_SD, FRICTION_ERROR, MaterialPrior, RESTITUTION_ERROR, ROLLING_LOG_SD, apply_material_prior,
};
pub use materialize::{
    Inputs, MaskChoice, MaterializeOptions, MaterializeTarget, Trained, add_materialize_means,
    materialize_markdown, materialize_table, materialize_targets, run_materialize, train,
};
pub use optimisers::{Entrant, OptimiserBench, optimiser_table, run_optimisers};
pub use options::BenchOptions;
pub use orbits::{
    BoxErrors, Orbit, OrbitKind, OrbitRow, PoseFault, Sigmas, box_errors, center_scale, orbit_metrics,
    orbit_table, refine_orbit,
};
pub use panels::write_panel;
pub use plan_scenes::{PlanScene, SceneFamily, TUNING_SEEDS};
pub use plan_speed::run_plan_speed;
pub use prepare::{Prepared, prepare};
pub use reachability::{
    Reachability, ReachabilityBench, reachability_metrics, reachability_table, run_reachability,
};
pub use real_like::{
    RealLikeRow, is_held_out, real_like_metrics, real_like_scenes, real_like_table, run_real_like,
};
pub use recordings::{locate, recording};
pub use reference::Yardstick;
pub use robust::{RobustBench, run_robust};
pub use robust_table::robust_table;
pub use room::Room;
pub use run::{run_scene, run_scene_with};
pub use scenes::{
    BenchScene, FRAMES, HOLDOUT, LANDING_SCENES, MODELS, REAL, SEEDS, STACKED_SEED, generated, model_path,
    models_dir, real_data_dir, select_mask_scenes, select_models, select_scenes, truth_scene,
};
pub use score::{score_files, write_points, write_view};
pub use seed_parts::{merge_optimisers, merge_plan_speed};
pub use shards::{Merged, Shard, merge_shards, part_of};
pub use shown_view::ShownView;
pub use solvability::{Solvability, SolvabilityBench, run_solvability};
pub use stacked::Structure;
pub use steps::{STEP_GAUSSIANS, fixed_step_cpu_ms, step_shares};
pub use table::{FigureTarget, add_means, table, targets};
pub use tracking::{
    TrackedKind, TrackingRow, track_generated, track_recording, tracking_metrics, tracking_table,
};
pub use trainer::TrainerMaker;
pub use true_worlds::TrueWorlds;
