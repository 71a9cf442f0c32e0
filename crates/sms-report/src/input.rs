//! The content of a report.

use crate::figures::ViewPair;
use crate::landing::LandingInput;
use crate::photo::RecordedView;
use sms_core::metrics::Metrics;
use sms_core::{ColorImage, Warning};
use sms_gaussians::{GaussianModel, LossSample};
use sms_plan::Plan;
use sms_scene::Scene;
use sms_task::{Execution, Trajectory};
use std::time::SystemTime;

/// The data of a report. Results of stages that have not run are `None` or empty; the page
/// leaves their parts out.
#[derive(Debug, Default)]
pub struct ReportInput<'a> {
    /// Headline ("Billiards, seed 1").
    pub title: String,
    /// One line about the run: recording, masks, materials, engine.
    pub subtitle: String,
    /// Recorded frames, the first one first: photographs, cameras of the 3-D view, and the floor's image.
    pub recorded: Vec<RecordedView>,
    /// Label → name of the objects of the masks, for pages without a scene.
    pub names: Vec<(u16, String)>,
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
    pub losses: Vec<LossSample>,
    /// All metrics of the run.
    pub metrics: Metrics,
    /// All warnings of the run.
    pub warnings: Vec<Warning>,
    /// `run.toml` as text.
    pub settings_toml: String,
    /// Commands that make this run and this page.
    pub commands: Vec<String>,
    /// Time of writing.
    pub written: Option<SystemTime>,
}

impl<'a> ReportInput<'a> {
    /// Returns the planned motion of a strike or a landing.
    pub(crate) fn predicted(&self) -> Option<&'a Trajectory> {
        self.plan.map(|p| &p.trajectory).or(self.landing.map(|l| &l.plan.nominal.trajectory))
    }

    /// Returns the executed motion, with the names of its bodies (planner's, target's).
    pub(crate) fn realised(&self) -> Option<(&'a Trajectory, &'a [(String, String)])> {
        let landing = || self.landing?.realised.map(|r| (&r.outcome.trajectory, r.matches));
        self.execution.map(|e| (&e.trajectory, e.matches.as_slice())).or_else(landing)
    }
}
