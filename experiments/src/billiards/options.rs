//! Settings of the experiment.

use super::{GridBaseline, Row};
use crate::{MaterialPrior, MaterializeOptions};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use sms_core::{Hash, Seed, hash_serializable};
use sms_entities::{EntitiesConfig, MeshRule, PrimitiveConfig, TextureConfig};
use sms_mesh::ConvexConfig;
use sms_plan::{Perturbation, PlanConfig};
use sms_synth::FixedScene;
use sms_target::TargetEngine;
use sms_vlm::Client;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Target engines: the judge first, the slowest last.
pub(super) const ENGINES: [TargetEngine; 4] =
    [TargetEngine::Physx, TargetEngine::PhysxStock, TargetEngine::Rapier, TargetEngine::Mujoco];
/// Version of the kept files; incremented when their content or its computation changes.
const VERSION: u32 = 7;

/// The paper's way from Gaussians to bodies (section "Physics-ready scene" and its released code): discs sampled evenly and
/// not moved to the measured depth, tetrahedra pruned by edge length, spheres as the only exact bodies, convex parts at
/// CoACD's threshold of 0.075. Hulls have at most 64 corners instead of 256, a limit of the engines here, and objects at most
/// 32 hulls: the bumpy pruned meshes would need sixty, and rollouts would take twice as long. Stacks and bodies that do not
/// rest are repaired as in our own bodies, since the paper does not describe its post-processing.
pub fn paper_entities() -> EntitiesConfig {
    let own = EntitiesConfig::default();
    EntitiesConfig {
        mesh: MeshRule::Prune,
        prune_factor: 2.25,
        prune_neighbors: 10,
        prune_length: None,
        density_per_m2: 25_000.0,
        // None is sampled more finely for being small.
        point_budget: 50,
        disc_sigmas: 2.5,
        refine_to_depth: false,
        face_budget: 750,
        primitive: PrimitiveConfig { enabled: false, ..own.primitive.clone() },
        convex: ConvexConfig { threshold: 0.075, floor: 0.0, max_parts: 32, max_vertices: 64 },
        texture: TextureConfig { enabled: false, ..own.texture.clone() },
        ..own
    }
}

/// Source of the planner's geometry.
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

/// Scenes, planners and engines of a run.
#[derive(Debug, Clone)]
pub struct BilliardsBench {
    /// Scenes to run now.
    pub scenes: Vec<FixedScene>,
    /// Material priors, one after another.
    pub material_prior: Vec<MaterialPrior>,
    /// Source of its geometry.
    pub geometry: BilliardsGeometry,
    /// Settings and folder of the scans.
    pub scan: MaterializeOptions,
    /// Target worlds; the first is the judge of the ablation.
    pub engines: Vec<TargetEngine>,
    /// Rows that are planned.
    pub rows: Vec<Row>,
    /// Plans of row `paper` and of row `ours` (paper: 30).
    pub starts: usize,
    /// Row `paper`; its number of starts is [`BilliardsBench::starts`].
    pub paper: PlanConfig,
    /// Settings of row `paper` for making bodies from the scan.
    pub paper_entities: EntitiesConfig,
    /// Row `ours`: each start is a whole plan with these settings from a seed of its own.
    pub ours: PlanConfig,
    /// The single robust plan per scene that a user would execute.
    pub robust: PlanConfig,
    /// The paper's baseline.
    pub grid: GridBaseline,
    /// Starts of row `ours` with each thing replaced by the truth (see [`crate::Replaced`]); 0 leaves the ablation out.
    pub ablation_starts: usize,
    /// The vision-language model, for the prior `vlm`.
    pub vlm: Option<Arc<Client>>,
    /// Random seed of all plans.
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
            material_prior: vec![MaterialPrior::Class],
            geometry: BilliardsGeometry::Scan,
            scan: MaterializeOptions::standard(keep),
            engines: ENGINES.into_iter().filter(|e| e.is_built_in()).collect(),
            rows: Row::ALL.to_vec(),
            starts: 30,
            paper: PlanConfig::paper(),
            paper_entities: paper_entities(),
            ours: Self::small(),
            robust: PlanConfig { sensitivity_rollouts: 0, ..PlanConfig::default() },
            grid: GridBaseline::default(),
            ablation_starts: 0,
            vlm: None,
            seed: Seed(0),
            out: out.into(),
        }
    }

    /// The planner with about as many rollouts for each start as five of the paper's starts take: a short search of the
    /// scanned world, and the choice among its best by how they fare in a few perturbed ones, for as many of which the scanned
    /// world counts. Thirty of them for each of eighteen scenes take ninety minutes on two cores.
    fn small() -> PlanConfig {
        PlanConfig {
            starts: 12,
            survivors: 3,
            robust_evaluations: 300,
            restarts: 3,
            scan: 0,
            candidates: 12,
            descents: 0,
            finalists: 3,
            nominal_worlds: 4,
            polish_starts: 0,
            forecast_worlds: 1,
            sensitivity_rollouts: 0,
            perturbation: Perturbation { worlds: 4, ..Perturbation::default() },
            ..PlanConfig::default()
        }
    }

    /// Hash of the inputs of a scene's plans, except the code.
    pub(super) fn key(&self, scene: &FixedScene, material_prior: MaterialPrior) -> Hash {
        let known = match self.geometry {
            BilliardsGeometry::Truth => None,
            BilliardsGeometry::Scan => {
                Some((self.scan.made_from(), (&self.scan.bench.entities, &self.paper_entities)))
            }
        };
        let plans = (self.starts, &self.paper, &self.ours, &self.robust, &self.grid, self.seed);
        // The key of the full experiment does not name the rows.
        let rows = (!Row::ALL.iter().all(|r| self.rows.contains(r))).then_some(&self.rows);
        let asked = self.vlm.as_ref().filter(|_| material_prior == MaterialPrior::Vlm).map(|c| c.config());
        let made = (VERSION, scene.generate(), material_prior, known, plans);
        match (asked, rows) {
            (None, None) => hash_serializable(&made),
            (Some(c), None) => {
                hash_serializable(&(VERSION, made.1, material_prior, made.3, plans, &c.url, &c.model))
            }
            (asked, Some(rows)) => hash_serializable(&(made, asked.map(|c| (&c.url, &c.model)), rows)),
        }
    }

    /// Settings that the figures depend on, besides scenes and code, for comparing parts of a run.
    pub fn settings(&self) -> Map<String, Value> {
        let mut map = self.scan.settings();
        let engines: Vec<&str> = self.engines.iter().map(|e| e.key()).collect();
        for (name, value) in [
            ("materials", json!(self.material_prior)),
            ("geometry", json!(self.geometry)),
            ("paper_entities", json!(self.paper_entities)),
            ("engines", json!(engines)),
            ("rows", json!(self.rows)),
            ("starts", json!(self.starts)),
            ("ablation_starts", json!(self.ablation_starts)),
            ("paper", json!(self.paper)),
            ("ours", json!(self.ours)),
            ("robust", json!(self.robust)),
            ("grid", json!(self.grid)),
            ("seed", json!(self.seed)),
            ("vlm", json!(self.vlm.as_ref().map(|c| (&c.config().url, &c.config().model)))),
        ] {
            map.insert(name.to_owned(), value);
        }
        map
    }

    /// File of a scene.
    pub(super) fn file(&self, scene: &FixedScene, material_prior: MaterialPrior) -> PathBuf {
        let folder = format!("{}-{}", self.geometry.as_str(), material_prior.as_str());
        self.out.join(folder).join(format!("scene_{:02}.json", scene.number))
    }
}
