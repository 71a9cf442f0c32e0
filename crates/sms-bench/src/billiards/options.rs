//! What the experiment depends on.

use crate::{BenchOptions, MaskChoice, MaterializeOptions, MaterialsTold};
use serde::{Deserialize, Serialize};
use sms_core::{Hash, Seed, hash_serializable};
use sms_gaussians::Preset;
use sms_plan::{Disturbances, GridBaseline, PlanConfig};
use sms_synth::FixedScene;
use sms_target::TargetEngine;
use std::path::{Path, PathBuf};

/// Counts up when what is kept of a scene, or how it is made, changes.
const VERSION: u32 = 1;

/// Where the planner's geometry comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BilliardsGeometry {
    /// A scan of a generated recording.
    Scan,
    /// The truth, for ablations and quick tests.
    Truth,
}

impl BilliardsGeometry {
    /// The word in tables and options.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Truth => "truth",
        }
    }
}

/// What to run.
#[derive(Debug, Clone)]
pub struct BilliardsBench {
    /// Scenes to run now.
    pub scenes: Vec<FixedScene>,
    /// What the planner is told of materials, one after another.
    pub told: Vec<MaterialsTold>,
    /// Where its geometry comes from.
    pub geometry: BilliardsGeometry,
    /// How scenes are scanned, and where scans are kept.
    pub scan: MaterializeOptions,
    /// Target worlds.
    pub engines: Vec<TargetEngine>,
    /// Plans of row `paper` and of row `ours` (paper: 30).
    pub starts: usize,
    /// Row `paper`; its number of starts is [`BilliardsBench::starts`].
    pub paper: PlanConfig,
    /// Row `ours`: each start is a whole plan with these settings from a seed of its own.
    pub ours: PlanConfig,
    /// The one plan a scene that a user would carry out.
    pub robust: PlanConfig,
    /// The paper's baseline.
    pub grid: GridBaseline,
    /// Seed of all plans.
    pub seed: Seed,
    /// Folder of the results.
    pub out: PathBuf,
}

impl BilliardsBench {
    /// The headline experiment (materials `class`, masks by geometry, all engines that are built in) with scans in `keep`
    /// and results in `out`.
    pub fn new(scenes: Vec<FixedScene>, keep: &Path, out: impl Into<PathBuf>) -> Self {
        Self {
            scenes,
            told: vec![MaterialsTold::Class],
            geometry: BilliardsGeometry::Scan,
            scan: MaterializeOptions {
                bench: BenchOptions::new(Preset::Standard, keep.join("recordings")),
                masks: MaskChoice::Geometry,
                keep: keep.to_owned(),
                rescan: false,
            },
            engines: TargetEngine::ALL.into_iter().filter(|e| e.is_built_in()).collect(),
            starts: 30,
            paper: PlanConfig::paper(),
            ours: Self::small(),
            robust: PlanConfig { sensitivity_rollouts: 0, ..PlanConfig::default() },
            grid: GridBaseline::default(),
            seed: Seed(0),
            out: out.into(),
        }
    }

    /// The planner with about as many rollouts for each start as two of the paper's starts take: a short search of the
    /// scanned world, and the choice among its best by how they fare in a few disturbed ones.
    fn small() -> PlanConfig {
        PlanConfig {
            starts: 8,
            survivors: 2,
            robust_evaluations: 120,
            scan: 0,
            candidates: 10,
            descents: 0,
            finalists: 3,
            polish_starts: 0,
            forecast_worlds: 1,
            sensitivity_rollouts: 0,
            disturbances: Disturbances { worlds: 4, ..Disturbances::default() },
            ..PlanConfig::default()
        }
    }

    /// Names the plans of a scene by everything they are made from but the code.
    pub(super) fn key(&self, scene: &FixedScene, told: MaterialsTold) -> Hash {
        let bench = &self.scan.bench;
        let masks = self.scan.masks == MaskChoice::Truth;
        let seen = match self.geometry {
            BilliardsGeometry::Truth => None,
            BilliardsGeometry::Scan => Some((
                (&bench.read, &bench.load, &bench.masks, masks, &bench.scan, bench.frames),
                &bench.entities,
            )),
        };
        let plans = (self.starts, &self.paper, &self.ours, &self.robust, &self.grid, self.seed);
        hash_serializable(&(VERSION, scene.generate(), told, seen, plans))
    }

    /// File of a scene.
    pub(super) fn file(&self, scene: &FixedScene, told: MaterialsTold) -> PathBuf {
        let folder = format!("{}-{}", self.geometry.as_str(), told.as_str());
        self.out.join(folder).join(format!("scene_{:02}.json", scene.number))
    }
}
