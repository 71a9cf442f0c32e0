//! Compares the reconstruction with known models or the ground truth.

use super::poses::refuse_foreign_world;
use super::status::is_generated;
use super::{Run, RunSettings};
use crate::Error;
use crate::cache::record;
use crate::origin::current_dir;
use crate::stages::{Comparison, MetricNames, add_drifts, evaluate, known_models, known_truth};
use sms_core::Warnings;
use sms_core::metrics::Metrics;
use sms_entities::load_entities;
use sms_eval::{DepthAgreement, EvaluateSettings, SceneAgreement, depth_agreement};
use sms_frames::Sequence;
use sms_scene::{BodyKind, Scene, load_scene};
use sms_sim::{RapierFactory, RestingDrift, resting_drift};
use sms_synth::{TruthScene, read_truth};
use std::path::Path;

/// Simulated time of the rest check, seconds.
const REST_S: f64 = 1.0;

/// Distance between the compared pixels, in both directions.
const PIXEL_STEP: usize = 4;

/// The scene's surfaces against the recorded depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordedAgreement {
    /// In all frames.
    pub all: DepthAgreement,
    /// In the frames that the scan did not use; empty if it used all.
    pub held_out: DepthAgreement,
}

/// Result of [`Run::evaluate`].
#[derive(Debug, Clone)]
pub struct EvaluateOutcome {
    /// The scene's surfaces against the recorded depth.
    pub agreement: RecordedAgreement,
    /// The compared pairs, in the order of the known objects; empty without known objects.
    pub comparisons: Vec<Comparison>,
    /// Whether the known objects are the ground truth of a generated recording.
    pub is_truth: bool,
    /// Largest drift of a body at rest (metres, radians), and the simulated time in seconds; `None` if the scene cannot
    /// be simulated.
    pub drift: Option<(f64, f64, f64)>,
}

impl Run<'_> {
    /// Compares the scene with the recorded depth, and adds the result to the metrics of [`Run::evaluate`].
    ///
    /// # Errors
    /// [`Error::Core`] if there is no scene, [`Error::Input`] if it is stale because of an earlier stage.
    pub fn compare_depth(&self) -> Result<RecordedAgreement, Error> {
        let run = self.open()?;
        let sequence = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?;
        let scene = load_scene(&current_dir(&run, "scene", "materialize")?)?;
        self.warn_stale(&run, "scene");
        let path = run.metrics_path();
        // Figures of another scene were removed when this one was made.
        let mut metrics = Metrics::load(&path)?;
        let agreement = add_agreement(&scene, &sequence, RunSettings::of(&run)?.holdout, &mut metrics);
        metrics.save(&path)?;
        Ok(agreement)
    }

    /// Compares the scene with the recorded depth, and the entities with the models of an `objects.json` or with the ground truth of a
    /// generated recording, if there are any.
    ///
    /// # Errors
    /// [`Error::Input`] if the scene is stale, or if known objects are given and the world of the poses is not that of the recording.
    pub fn evaluate(&self, objects: Option<&Path>) -> Result<EvaluateOutcome, Error> {
        let run = self.open()?;
        let set = load_entities(&current_dir(&run, "entities", "materialize")?)?;
        let settings = self.context.settings.section("evaluate", EvaluateSettings::default())?;
        let sequence = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?;
        let x_wr = sequence.x_world_recording;
        let scan = RunSettings::of(&run)?;
        let warnings = Warnings::new();
        let scene = load_scene(&current_dir(&run, "scene", "materialize")?)?;
        let drifts = contact_drift(&scene, &warnings);
        self.warn_stale(&run, "scene");
        let recording = Path::new(&scan.recording);
        if objects.is_some() || is_generated(recording) {
            refuse_foreign_world(
                &run,
                "the known objects are placed in the recording's world",
                "give the recording its poses; --poses estimate moves estimated ones to these",
            )?;
        }
        let (known, truth) = match objects {
            Some(path) => (known_models(path, &x_wr, scan.masks == "files")?, None),
            None if is_generated(recording) => {
                let truth = read_truth(recording)?;
                (known_truth(&truth, &x_wr), Some(truth))
            }
            None => (Vec::new(), None),
        };
        let names = if truth.is_some() { MetricNames::Entity } else { MetricNames::Known };
        let mut metrics = Metrics::new();
        let agreement = add_agreement(&scene, &sequence, scan.holdout, &mut metrics);
        let fixed: Vec<&str> =
            scene.bodies.iter().filter(|b| b.kind == BodyKind::Static).map(|b| b.name.as_str()).collect();
        let comparisons = evaluate(&known, &set.entities, &fixed, &settings, names, &mut metrics, &warnings)?;
        add_drifts(&comparisons, names, &drifts, &mut metrics);
        if let Some(truth) = &truth {
            add_found(&comparisons, truth, &mut metrics);
            metrics.set("evaluate.objects", known.len());
        }
        let worst = |f: fn(&RestingDrift) -> f64| drifts.iter().map(f).fold(0.0, f64::max);
        let drift = (!drifts.is_empty()).then(|| (worst(|d| d.moved_m), worst(|d| d.turned_rad), REST_S));
        if let Some((moved, turned, _)) = drift {
            metrics.set("evaluate.drift_m", moved).set("evaluate.turn_rad", turned);
        }
        record(self.context, &run, "evaluate", &["evaluate."], metrics, &warnings)?;
        Ok(EvaluateOutcome { agreement, comparisons, is_truth: truth.is_some(), drift })
    }
}

/// Compares the scene with the depth of all frames, and adds the shares of measured pixels to the metrics: of all, of those in the
/// frames that the scan did not use, and of those that each body is first in.
fn add_agreement(
    scene: &Scene,
    sequence: &Sequence,
    holdout: usize,
    metrics: &mut Metrics,
) -> RecordedAgreement {
    let views: Vec<_> = sequence.frames.iter().map(|f| (f.camera, &f.depth)).collect();
    let (mut found, mut held_out) = (SceneAgreement::default(), DepthAgreement::default());
    for (i, of_view) in depth_agreement(scene, &views, PIXEL_STEP).iter().enumerate() {
        found += of_view;
        if Sequence::is_held_out(i, holdout) {
            held_out += of_view.all;
        }
    }
    let mut add = |prefix: &str, of: &DepthAgreement| {
        if let Some([agrees, false_surface, hole]) = of.shares() {
            for (figure, share) in [("agrees", agrees), ("false_surface", false_surface), ("hole", hole)] {
                metrics.set(format!("evaluate.{prefix}depth_{figure}"), share);
            }
        }
    };
    add("", &found.all);
    add("holdout_", &held_out);
    for (body, of_body) in scene.bodies.iter().zip(&found.bodies) {
        add(&format!("{}.", body.name), of_body);
    }
    metrics.set("evaluate.depth_pixels", found.all.measured);
    RecordedAgreement { all: found.all, held_out }
}

/// Adds metrics of the found objects and balls of the ground truth.
fn add_found(comparisons: &[Comparison], truth: &TruthScene, metrics: &mut Metrics) {
    for c in comparisons {
        metrics.set(format!("evaluate.{}.truth", c.entity), c.known.clone());
    }
    let is_ball = |c: &&Comparison| c.sphere.is_some() && [&truth.cue, &truth.target].contains(&&c.known);
    metrics.set("evaluate.balls_found", comparisons.iter().filter(is_ball).count());
    metrics.set("evaluate.objects_found", comparisons.len());
}

/// Returns the drift of each body when the scene is simulated at rest. Warns if the scene cannot be simulated.
fn contact_drift(scene: &Scene, warnings: &Warnings) -> Vec<RestingDrift> {
    resting_drift(&RapierFactory, scene, REST_S).unwrap_or_else(|error| {
        warnings.add(
            "evaluate",
            "not_simulated",
            format!("the scene cannot be simulated, so its drift at rest is unknown: {error}"),
            "check the objects in the report",
        );
        Vec::new()
    })
}
