//! Compares the reconstruction with known models or the ground truth.

use super::poses::refuse_foreign_world;
use super::status::is_generated;
use super::{Run, RunSettings};
use crate::Error;
use crate::cache::record;
use crate::origin::current_dir;
use crate::stages::{Comparison, MetricNames, add_drifts, evaluate, known_models, known_truth};
use sms_core::metrics::Metrics;
use sms_core::{InputError, Warnings};
use sms_entities::load_entities;
use sms_eval::EvaluateSettings;
use sms_frames::Sequence;
use sms_scene::{BodyKind, Scene, load_scene};
use sms_sim::{RapierFactory, RestingDrift, resting_drift};
use sms_synth::{TruthScene, read_truth};
use std::path::Path;

/// Simulated time of the rest check, seconds.
const REST_S: f64 = 1.0;

/// Result of [`Run::evaluate`].
#[derive(Debug, Clone)]
pub struct EvaluateOutcome {
    /// The compared pairs, in the order of the known objects.
    pub comparisons: Vec<Comparison>,
    /// Whether the known objects are the ground truth of a generated recording.
    pub is_truth: bool,
    /// Largest drift of a body at rest (metres, radians), and the simulated time in seconds; `None` if the scene cannot
    /// be simulated.
    pub drift: Option<(f64, f64, f64)>,
}

impl Run<'_> {
    /// Compares the entities with the models of an `objects.json`, or with the ground truth of a generated recording.
    ///
    /// # Errors
    /// [`Error::Input`] without known objects, or if the scene is stale.
    pub fn evaluate(&self, objects: Option<&Path>) -> Result<EvaluateOutcome, Error> {
        let run = self.open()?;
        let set = load_entities(&current_dir(&run, "entities", "materialize")?)?;
        let settings = self.context.settings.section("evaluate", EvaluateSettings::default())?;
        let x_wr = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?.x_world_recording;
        refuse_foreign_world(
            &run,
            "the known objects are placed in the recording's world",
            "give the recording its poses; --poses estimate moves estimated ones to these",
        )?;
        let scan = RunSettings::of(&run)?;
        let warnings = Warnings::new();
        let scene = load_scene(&current_dir(&run, "scene", "materialize")?)?;
        let drifts = contact_drift(&scene, &warnings);
        self.warn_stale(&run, "scene");
        let (known, truth) = match objects {
            Some(path) => (known_models(path, &x_wr, scan.masks == "files")?, None),
            None => {
                let truth = truth_of(Path::new(&scan.recording))?;
                (known_truth(&truth, &x_wr), Some(truth))
            }
        };
        let names = if truth.is_some() { MetricNames::Entity } else { MetricNames::Known };
        let mut metrics = Metrics::new();
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
        Ok(EvaluateOutcome { comparisons, is_truth: truth.is_some(), drift })
    }
}

fn truth_of(recording: &Path) -> Result<TruthScene, Error> {
    if !is_generated(recording) {
        let cure = "pass known models with --objects FILE (see docs/book/src/reference/objects-json.md)";
        return Err(InputError::new("no known models to compare with", recording, cure).into());
    }
    Ok(read_truth(recording)?)
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
