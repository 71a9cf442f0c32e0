//! The content of a report.

use crate::figures::ViewPair;
use crate::landing::LandingInput;
use serde::{Deserialize, Serialize};
use sms_core::metrics::Metrics;
use sms_core::{ColorImage, Warning};
use sms_gaussians::GaussianModel;
use sms_plan::Plan;
use sms_scene::Scene;
use sms_task::Execution;

/// One point of the training curves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LossPoint {
    /// Step from the start of the scan.
    pub step: u64,
    /// Mean absolute colour error.
    pub color_l1: f64,
    /// Depth error in metres.
    pub depth_m: f64,
    /// Weighted total.
    pub total: f64,
}

/// The data of a report. Results of stages that have not run are `None` or empty, and the page says so.
#[derive(Debug, Default)]
pub struct ReportInput<'a> {
    /// Headline ("Billiards, seed 1").
    pub title: String,
    /// One line about the run: recording, masks, materials, engine.
    pub subtitle: String,
    /// Observed and rendered frames.
    pub views: Vec<ViewPair>,
    /// The Gaussians.
    pub gaussians: Option<&'a GaussianModel>,
    /// The scene.
    pub scene: Option<&'a Scene>,
    /// The plan.
    pub plan: Option<&'a Plan>,
    /// The execution in the target world.
    pub execution: Option<&'a Execution>,
    /// A landing, in place of plan and execution.
    pub landing: Option<LandingInput<'a>>,
    /// Pictures that a vision-language model chose from, with captions.
    pub pictures: Vec<(String, ColorImage)>,
    /// Goal on the floor, metres.
    pub goal_w: Option<[f64; 2]>,
    /// Half extents of the striker's box, metres.
    pub striker_half_m: Option<[f64; 3]>,
    /// Body name → role ("cue", "target").
    pub roles: Vec<(String, String)>,
    /// Training curves.
    pub losses: Vec<LossPoint>,
    /// All metrics of the run.
    pub metrics: Metrics,
    /// All warnings of the run.
    pub warnings: Vec<Warning>,
    /// `run.toml` as text.
    pub settings_toml: String,
}
