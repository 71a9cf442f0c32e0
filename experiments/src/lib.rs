//! The yardstick of the scan: fixed scenes with exact truth, disturbances, and what is measured on them.
//!
//! [`run_scene`] takes one of the [`SEEDS`] of the billiards family (or a real recording), makes frames and masks of it as
//! the pipeline does, scans it, and measures the result against the truth of the generator, which the scan never sees.
//! `sms-experiments scan` runs it for every scene in a process of its own, so that peak memory is the scene's.
//!
//! # What is measured
//! - **Colour**: PSNR of held-out views against the observed colour, all pixels, mean over the views.
//! - **Depth**: see [`DepthErrors`]: against noise-free depth where the camera can measure and something is shown.
//! - **Labels**: [`mean_iou`] of rendered labels with the true ones. Which mask label stands for which true object is
//!   decided before, by [`match_labels`], from the masks themselves.
//! - **Surfaces**: points on the discs of the Gaussians of each object ([`disc_points`]), against the true surface of that
//!   object ([`score_labelled`]); recall over the [`observed_surface`], what at least three of the cameras trained on see
//!   of the true surface. The figure of a scene is the mean over its objects.
//! - **Others**: [`export_scene`] writes what the scan is given and the truth beside it, and [`score_files`] measures what
//!   another program made of it by the same functions; the format is in `export.rs`.
//! - **Disturbed poses**: the result is aligned rigidly first ([`align_cameras`], [`refine_on_surfaces`]).
//!
//!
//! # The planner
//! [`run_optimisers`] compares search methods on generated scenes, [`run_robust`] compares what plans are worth when the
//! true world is one more sample of what is not known.
//!
//! # Masks
//! [`run_masks`] measures label images against the true ones: objects found, labels that are none, and how well they overlap.
//!
//! # The whole experiment
//! [`run_billiards`] is the paper's Table 1 on eighteen fixed scenes: scan, materialize, plan, and carry out in the target
//! worlds.
//!
//! [`run_landings`] is its landing experiment on four structures, beside planners that know nothing of wash.
//!
//! # In parts
//! What is too long for one machine runs as `--shard i/n` on several: [`Shard`] is what each writes, [`merge_shards`] puts
//! them together.
//!
//! ```
//! use sms_experiments::{F1_M, SurfacePoint, score_surface};
//! use sms_core::glamx::DVec3;
//! // A floor 2 mm too high is precise to 2.5 mm, and 2 mm off.
//! let observed: Vec<SurfacePoint> = (0..100)
//!     .map(|i| SurfacePoint { point: DVec3::new(0.001 * f64::from(i), 0.0, 0.0), normal: DVec3::Z })
//!     .collect();
//! let found: Vec<DVec3> = observed.iter().map(|s| s.point + DVec3::Z * 0.002).collect();
//! let scores = score_surface(&found, |p| p.z.abs(), &observed);
//! assert!((scores.median_m - 0.002).abs() < 1e-12 && scores.f1 == 1.0 && F1_M == 0.0025);
//! ```

mod billiards;
mod disturb;
mod engines;
mod error;
mod export;
mod landing;
mod masks;
mod material_prior;
mod materialize;
mod optimisers;
mod options;
mod panels;
mod plan_scenes;
mod plan_speed;
mod prepare;
mod reachability;
mod real;
mod recordings;
mod robust;
mod robust_table;
mod run;
mod scenes;
mod score;
mod seed_parts;
mod shards;
mod solvability;
mod steps;
mod table;
mod timer;
mod trainer;
mod true_worlds;

pub use billiards::{
    Ablated, Ablation, BilliardsBench, BilliardsGeometry, BilliardsScene, Drawing, Replaced, Row, Shot,
    Unfinished, Way, billiards_metrics, billiards_table, paper_entities, read_billiards, run_billiards,
    scan_billiards, write_pictures, write_shots,
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
pub use panels::write_panel;
pub use plan_scenes::{PlanScene, SceneFamily, TUNING_SEEDS};
pub use plan_speed::run_plan_speed;
pub use prepare::{Prepared, prepare};
pub use reachability::{
    Reachability, ReachabilityBench, reachability_metrics, reachability_table, run_reachability,
};
pub use recordings::{locate, recording};
pub use robust::{RobustBench, run_robust};
pub use robust_table::robust_table;
pub use run::{Yardstick, run_scene, run_scene_with};
pub use scenes::{
    BenchScene, FRAMES, HOLDOUT, LANDING_SCENES, MODELS, REAL, SEEDS, STACKED_SEED, generated, model_path,
    models_dir, real_data_dir, select_mask_scenes, select_models, select_scenes, truth_scene,
};
pub use score::{score_files, write_points, write_view};
pub use seed_parts::{merge_optimisers, merge_plan_speed};
pub use shards::{Merged, Shard, merge_shards, part_of};
pub use solvability::{Solvability, SolvabilityBench, run_solvability};
pub use steps::{STEP_GAUSSIANS, fixed_step_cpu_ms, step_shares};
pub use table::{Target, add_means, table, targets};
pub use trainer::TrainerMaker;
pub use true_worlds::TrueWorlds;
