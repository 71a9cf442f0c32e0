//! Settings of the experiment.

use super::LandingSight;
use crate::scenes::{LANDING_SCENES, no_scene};
use crate::{BenchError, BenchScene, BilliardsGeometry, MaterialPrior, MaterializeOptions, generated};
use glamx::DVec3;
use serde_json::{Map, Value, json};
use sms_core::{Hash, Seed, hash_serializable};
use sms_landing::{LandingAction, LandingSettings, LandingTask};
use sms_scene::Scene;
use sms_synth::{TruthScene, landing_structure};
use sms_target::TargetEngine;
use std::path::{Path, PathBuf};

/// Version of the kept files; incremented when their content or its computation changes.
const VERSION: u32 = 9;

/// Smallest height of platforms of scanned models, metres: bin and table are only 0.34 and 0.40 m high.
const SCANNED_HEIGHT_M: f64 = 0.3;

/// Distance of the planner's particles in the quick run, metres.
const QUICK_SPACING_M: f64 = 0.03;

/// A baseline planner, by its name in tables and keys. It gets the inputs of ours, and the recording.
pub struct LandingBaseline<'a> {
    /// The name ("geometric", "random", "visual_prompting").
    pub name: String,
    /// Which one of that name (the model that is asked); kept landings of another one are made again.
    pub variant: String,
    /// Chooses a landing in the planner's scene.
    pub choose: Box<dyn Fn(&LandingSight<'_>) -> Result<LandingChoice, BenchError> + 'a>,
}

/// A baseline's choice, or why it has none, which is a failed landing.
pub type LandingChoice = Result<LandingAction, String>;

/// One flight of the experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LandingPart {
    /// Number of the scene; those beyond the fixed ones are seeds of drawn structures, for tuning.
    pub scene: usize,
    /// Number of the start, from 0.
    pub start: usize,
    /// The planner's knowledge of materials.
    pub material_prior: MaterialPrior,
    /// Draw of the noise; 0 without noise.
    pub draw: usize,
}

/// Flights, planners and engine of a run.
pub struct LandingBench<'a> {
    /// Numbers of scenes: those of [`LANDING_SCENES`], and seeds of drawn ones beyond them.
    pub scenes: Vec<usize>,
    /// Whether scanned models replace shapes made in code, if they are present ([`crate::models_dir`]).
    pub scanned: bool,
    /// Starts on the circle (paper: 10), evenly spread.
    pub starts: usize,
    /// Draws of noisy materials for each scene; 0 leaves the noisy rows out.
    pub noisy_draws: usize,
    /// Starts for each draw.
    pub noisy_starts: usize,
    /// Only every n-th flight, from the i-th (from 1).
    pub part: (usize, usize),
    /// Source of the planner's geometry.
    pub geometry: BilliardsGeometry,
    /// Settings and folder of the scans.
    pub scan: MaterializeOptions,
    /// Target world.
    pub engine: TargetEngine,
    /// The planner.
    pub settings: LandingSettings,
    /// Planners to compare with; they use materials `class` only.
    pub baselines: Vec<LandingBaseline<'a>>,
    /// Random seed of all plans.
    pub seed: Seed,
    /// Folder of the results.
    pub out: PathBuf,
}

impl LandingBench<'_> {
    /// The headline experiment (materials `class`, masks by geometry) with scans in `keep` and results in `out`.
    pub fn new(scenes: Vec<usize>, keep: &Path, out: impl Into<PathBuf>) -> Self {
        Self {
            scenes,
            scanned: false,
            starts: 10,
            noisy_draws: 0,
            noisy_starts: 4,
            part: (1, 1),
            geometry: BilliardsGeometry::Scan,
            scan: MaterializeOptions::standard(keep),
            engine: TargetEngine::preferred(),
            settings: LandingSettings::default(),
            baselines: Vec::new(),
            seed: Seed(0),
            out: out.into(),
        }
    }

    /// One scene with four starts, few frames, a smaller search, and particles of 30 mm (15 mm in the target), which cost half of those of
    /// the whole run. The scan is of full size: 200 pixels do not separate a ladder from the object on it.
    pub fn quick(keep: &Path, out: impl Into<PathBuf>) -> Self {
        let mut bench = Self::new(vec![1], keep, out);
        bench.starts = 4;
        bench.scan.bench.frames = 24;
        bench.settings = LandingSettings::draft();
        bench.settings.sph.spacing = QUICK_SPACING_M;
        bench
    }

    /// All flights of the whole run, in their order.
    pub fn flights(&self) -> Vec<LandingPart> {
        let mut all = Vec::new();
        for &scene in &self.scenes {
            for start in 0..self.starts {
                // Spread over the ten starts of the scene.
                let start = start * 10 / self.starts.max(1);
                all.push(LandingPart { scene, start, material_prior: MaterialPrior::Class, draw: 0 });
            }
        }
        for &scene in &self.scenes {
            for draw in 0..self.noisy_draws {
                for start in 0..self.noisy_starts {
                    let start = start * 10 / self.noisy_starts.max(1);
                    all.push(LandingPart { scene, start, material_prior: MaterialPrior::Noisy, draw });
                }
            }
        }
        all
    }

    /// Settings that the flights depend on, besides scenes and code, for comparing parts of a run.
    pub fn settings(&self) -> Map<String, Value> {
        let mut map = self.scan.settings();
        let baselines: Vec<[&str; 2]> = self.baselines.iter().map(|b| [&*b.name, &*b.variant]).collect();
        for (name, value) in [
            ("geometry", json!(self.geometry)),
            ("scanned", json!(self.scanned)),
            ("starts", json!(self.starts)),
            ("noisy_draws", json!(self.noisy_draws)),
            ("noisy_starts", json!(self.noisy_starts)),
            ("engine", json!(self.engine.key())),
            ("landing", json!(self.settings)),
            ("baselines", json!(baselines)),
            ("seed", json!(self.seed)),
        ] {
            map.insert(name.to_owned(), value);
        }
        map
    }

    /// The scene of a number.
    pub(super) fn scene(&self, number: usize) -> BenchScene {
        if self.scanned { BenchScene::ScannedLanding(number) } else { BenchScene::Landing(number) }
    }

    /// Its truth.
    pub(super) fn truth(&self, number: usize) -> Result<TruthScene, BenchError> {
        let which = self.scene(number);
        Ok(generated(&which)?.ok_or_else(|| no_scene(&which))?.scene)
    }

    /// The task of a flight in a scene.
    pub(super) fn task(&self, scene: &Scene, truth: &TruthScene, part: LandingPart) -> LandingTask {
        let start_w = truth.landing.as_ref().map_or(DVec3::ZERO, |l| l.starts_w[part.start]);
        let mut task =
            LandingTask::new(scene.x_world_recording.transform_point(start_w).truncate().to_array());
        if self.scanned {
            task.surface.height_m = SCANNED_HEIGHT_M;
        }
        task
    }

    /// Names a flight by everything it is made from but the code.
    pub(super) fn key(&self, part: LandingPart) -> Result<Hash, BenchError> {
        let seen = match self.geometry {
            BilliardsGeometry::Truth => None,
            BilliardsGeometry::Scan => Some((self.scan.made_from(), &self.scan.bench.entities)),
        };
        let which = (part.scene, part.start, part.material_prior, part.draw);
        let truth = self.truth(part.scene)?;
        Ok(hash_serializable(&(VERSION, which, truth, seen, &self.settings, self.engine.key(), self.seed)))
    }

    /// File of a flight.
    pub(super) fn file(&self, part: LandingPart) -> PathBuf {
        let scanned = if self.scanned { "scanned-" } else { "" };
        let folder = format!("{scanned}{}-{}", self.geometry.as_str(), part.material_prior.as_str());
        let name = format!("landing_{}_draw_{}_start_{}.json", part.scene, part.draw, part.start);
        self.out.join(folder).join(name)
    }
}

/// Name of a scene in keys: the word of its structure, with the number for drawn ones, prefixed by `scanned_` for scanned
/// models.
pub(super) fn word(number: usize, scanned: bool) -> String {
    let structure = landing_structure(number as u64).as_str();
    let scanned = if scanned { "scanned_" } else { "" };
    match LANDING_SCENES.contains(&number) {
        true => format!("{scanned}{structure}"),
        false => format!("{scanned}{structure}_{number}"),
    }
}
