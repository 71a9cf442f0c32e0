//! Scene and task → plan.

use super::poses::refuse_robot_in_foreign_world;
use super::{Refusal, Run, RunSettings};
use crate::cache::{inputs_hash, run_stage};
use crate::command_options::{record_options, record_task};
use crate::origin::{current_dir, stage_state};
use crate::settings::vlm_defaults;
use crate::stages::{ChosenLanding, LandingChooser, LandingProblem, StrikeProblem, choose_landing};
use crate::vlm::{REPLIES, client};
use crate::{Error, RobotPlace};
use sms_core::metrics::Metrics;
use sms_core::write_png_color;
use sms_core::{Hash, Hasher, InputError, RunFolder, Seed, StageContext, Warnings, atomic};
use sms_frames::{FloorAt, Sequence, floor_at, load_depths};
use sms_landing::{CarriedOut, LandingPlan, LandingPlanOutcome, LandingSettings, LandingTask};
use sms_plan::{Plan, PlanConfig, load_plan, save_plan, write_trials};
use sms_robots::autopilot::{FlightFiles, write_flight};
use sms_scene::{Scene, load_scene};
use sms_task::{ResolvedTask, Task};
use sms_vlm::Cache;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Number of frames that are checked for the floor at the task's positions.
const FLOOR_FRAMES: usize = 24;
/// File of a baseline's choice, beside its plan.
pub(super) const CHOICE_FILE: &str = "choice.json";
/// Pictures of the candidates, with their captions.
pub(super) const PICTURES: [(&str, &str); 2] = [
    ("choice_sites.png", "landing sites, the chosen one in green"),
    ("choice_approaches.png", "approaches to it, the chosen one in colour"),
];

/// A task that the scene does not fit: an earlier plan must not be flown by mistake.
const REFUSED_LANDING: Refusal =
    Refusal { code: "landing_refused", what: "no landing was planned", stages: &["plan", "target"] };

/// Options of [`Run::plan`].
#[derive(Debug, Clone, Default)]
pub struct PlanRequest {
    /// The task file (TOML), of a strike or a landing.
    pub task: PathBuf,
    /// Seed of the search; by default the scan's.
    pub seed: Option<Seed>,
    /// Number of perturbed worlds in which actions are compared; 0 plans for the scanned world alone.
    pub robust: Option<usize>,
    /// Chooser of a landing.
    pub chooser: LandingChooser,
    /// Whether to start from the settings of a quick search.
    pub draft: bool,
}

impl PlanRequest {
    /// Returns a request for a task file with default options.
    pub fn new(task: impl Into<PathBuf>) -> Self {
        Self { task: task.into(), ..Self::default() }
    }
}

/// Result of [`Run::plan`].
#[derive(Debug, Clone)]
pub enum PlannedTask {
    /// A strike.
    Strike {
        /// The plan.
        plan: Box<Plan>,
        /// Names of the struck ball and of the target.
        bodies: [String; 2],
        /// Folder of the plan.
        dir: PathBuf,
    },
    /// A landing.
    Landing {
        /// The plan.
        plan: Box<LandingPlan>,
        /// Folder of the plan and of the files to fly.
        dir: PathBuf,
    },
}

impl Run<'_> {
    /// Plans the best action for a task.
    ///
    /// # Errors
    /// [`Error::Input`], [`Error::Task`] or [`Error::Landing`] if the task does not fit the scene; otherwise the error
    /// of the planner.
    pub fn plan(&self, request: &PlanRequest) -> Result<PlannedTask, Error> {
        if LandingTask::is_landing(&request.task) {
            return self.plan_landing(request);
        }
        if request.chooser != LandingChooser::Search {
            let what = "only landings have a choice of choosers";
            return Err(InputError::new(what, "--chooser", "leave `--chooser` out").into());
        }
        let task = Task::read(&request.task)?;
        let base = if request.draft { PlanConfig::draft() } else { PlanConfig::default() };
        let usual = base.evaluations;
        let mut config = self.context.settings.section("plan", base)?;
        let is_evaluations_set = config.evaluations != usual;
        config.perturbation.worlds = request.robust.unwrap_or(config.perturbation.worlds);

        let run = self.open()?;
        let scene_dir = current_dir(&run, "scene", "materialize")?;
        self.warn_stale(&run, "scene");
        let scene = load_scene(&scene_dir)?;
        let seed = seed(request, &run)?;
        let scan = RunSettings::of(&run).ok();
        let robot = RobotPlace::of(&self.context.settings, scan.as_ref())?;
        refuse_robot_in_foreign_world(&run, &robot.config)?;
        let strike = StrikeProblem::new(&task, &scene, &robot)?;
        let out_of_view = refuse_places_off_the_floor(&run, &strike.task, &request.task)?;
        record_options(self.context, &run, "plan")?;
        record_task(&run, &request.task)?;
        run.record_settings("plan", &config)?;
        let urdf = robot.config.urdf.as_deref();
        let hash =
            inputs_hash(&[&scene_hash(&run, &scene_dir, urdf)?], &(&task, &config, seed, &robot.config))?;
        let dir = run_stage(self.context, &run, "plan", &hash, |stage, warnings| {
            let began = Instant::now();
            warn_out_of_view(&out_of_view, warnings);
            for doubt in task.selectors().iter().filter_map(|selector| selector.doubt(&scene)) {
                warnings.add("plan", "other_color", doubt, "if it is another body, select it by its `name`");
            }
            if config.perturbation.worlds > 0 && is_evaluations_set {
                warnings.add(
                    "plan",
                    "evaluations_unused",
                    "`plan.evaluations` has no effect when perturbed worlds are compared",
                    "set `plan.robust_evaluations`, or plan with --robust 0",
                );
            }
            let outcome = strike.plan(&scene, &config, self.context.stage(warnings, seed))?;
            save_plan(stage.dir(), &outcome)?;
            task.write(&stage.dir().join("task.toml"))?;
            let mut metrics = outcome.metrics();
            metrics.set("plan.seconds", began.elapsed().as_secs_f64());
            Ok(metrics)
        })?;
        self.tell_stale(&run);
        let bodies = [strike.task.cue(), strike.task.target()].map(|b| b.name.clone());
        Ok(PlannedTask::Strike { plan: Box::new(load_plan(&dir)?), bodies, dir })
    }

    /// Plans a landing. If the task is refused, an earlier plan is set aside.
    fn plan_landing(&self, request: &PlanRequest) -> Result<PlannedTask, Error> {
        let run = self.open()?;
        let order = self.landing_order(request, &run)?;
        record_task(&run, &request.task)?;
        let planned =
            self.landing_stage(&order, &run).map_err(|error| self.refused(&run, &REFUSED_LANDING, error))?;
        self.tell_stale(&run);
        Ok(planned)
    }

    /// Reads the files and settings of a landing. Their errors say nothing about the task.
    fn landing_order(&self, request: &PlanRequest, run: &RunFolder) -> Result<LandingOrder, Error> {
        let task = LandingTask::read(&request.task)?;
        let scene_dir = current_dir(run, "scene", "materialize")?;
        self.warn_stale(run, "scene");
        let base = if request.draft { LandingSettings::draft() } else { LandingSettings::default() };
        let mut settings = self.context.settings.section("landing", base)?;
        settings.worlds = request.robust.unwrap_or(settings.worlds);
        let files = self.context.settings.section("flight", FlightFiles::default())?;
        Ok(LandingOrder {
            task,
            scene: load_scene(&scene_dir)?,
            scene_hash: scene_hash(run, &scene_dir, None)?,
            settings,
            files,
            seed: seed(request, run)?,
            chooser: request.chooser,
        })
    }

    fn landing_stage(&self, order: &LandingOrder, run: &RunFolder) -> Result<PlannedTask, Error> {
        let LandingOrder { task, settings, files, seed, chooser, .. } = order;
        let landing = LandingProblem::new(task, order.scene.clone(), settings, *seed)?;
        record_options(self.context, run, "plan")?;
        run.record_settings("landing", settings)?;
        run.record_settings("flight", files)?;
        let vehicle = landing.task.vehicle();
        let inputs = (task, vehicle, settings, files, seed, chooser.name());
        let hash = inputs_hash(&[&order.scene_hash], &inputs)?;
        let dir = run_stage(self.context, run, "plan", &hash, |stage, warnings| {
            let began = Instant::now();
            landing.warn(warnings);
            let context = self.context.stage(warnings, *seed);
            let outcome = match *chooser {
                LandingChooser::Search => landing.plan(settings, context)?,
                chooser => self.baseline(chooser, run, &landing, settings, stage.dir(), context)?,
            };
            let plan = &outcome.plan;
            plan.save(stage.dir())?;
            write_trials(&stage.dir().join("trials.parquet"), &plan.parameters, &outcome.trials)?;
            task.write(&stage.dir().join("task.toml"))?;
            let flight = landing.task.flight(&plan.action, &CarriedOut::default())?;
            write_flight(stage.dir(), &flight, vehicle, files)?;
            let mut metrics = landing_metrics(plan, chooser.name());
            metrics.set("plan.seconds", began.elapsed().as_secs_f64());
            Ok(metrics)
        })?;
        Ok(PlannedTask::Landing { plan: Box::new(LandingPlan::load(&dir)?), dir })
    }

    /// The plan of a baseline, with its choice and pictures in the stage's folder.
    fn baseline(
        &self,
        chooser: LandingChooser,
        run: &RunFolder,
        landing: &LandingProblem,
        settings: &LandingSettings,
        dir: &Path,
        context: StageContext<'_>,
    ) -> Result<LandingPlanOutcome, Error> {
        let sequence = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?;
        let model = if chooser == LandingChooser::Visual {
            let config = self.context.settings.section("vlm", vlm_defaults())?;
            run.record_settings("vlm", &config)?;
            let client = client(&config, context.seed.derive("visual prompting"))?;
            Some((client, Cache::new(&run.root().join(REPLIES))))
        } else {
            None
        };
        let model = model.as_ref().map(|(client, cache)| (client, cache));
        let chosen = choose_landing(landing, chooser, &sequence.frames, settings, model, context)?;
        let ChosenLanding { outcome, record, pictures, candidates } = chosen;
        for ((file, _), image) in PICTURES.iter().zip(&pictures) {
            write_png_color(&dir.join(file), image)?;
        }
        atomic::write_json(&dir.join(CHOICE_FILE), &record)?;
        self.context.message(format!(
            "{}: site {} of {}, approach {} of {}",
            record.chooser, record.site, candidates.0, record.approach, candidates.1
        ));
        Ok(outcome)
    }
}

/// A landing task with its scene and settings.
struct LandingOrder {
    task: LandingTask,
    scene: Scene,
    scene_hash: Hash,
    settings: LandingSettings,
    files: FlightFiles,
    seed: Seed,
    chooser: LandingChooser,
}

fn seed(request: &PlanRequest, run: &RunFolder) -> Result<Seed, Error> {
    match request.seed {
        Some(seed) => Ok(seed),
        None => Ok(Seed(RunSettings::of(run)?.seed)),
    }
}

/// Hashes the current scene with its meshes and its manifest, in which a user may have edited a mass or a friction, and
/// the robot's URDF.
fn scene_hash(run: &RunFolder, scene_dir: &Path, urdf: Option<&Path>) -> Result<Hash, Error> {
    let mut hasher = Hasher::new();
    hasher.file(&scene_dir.join("scene.json"))?;
    if let Some(state) = stage_state(run, "scene") {
        hasher.text(&state.0);
    }
    if let Some(urdf) = urdf {
        hasher.file(urdf)?;
    }
    Ok(hasher.finish())
}

/// Refuses positions where the recording shows a lower surface, because the simulated floor is infinite. Returns the
/// positions that no frame shows.
fn refuse_places_off_the_floor(
    run: &RunFolder,
    task: &ResolvedTask,
    file: &Path,
) -> Result<Vec<String>, Error> {
    let places = task.floor_places();
    let Some(frames) = run.stage_dir("frames", "scan DIR --out").ok().filter(|_| !places.is_empty()) else {
        return Ok(Vec::new());
    };
    let frames = load_depths(&frames, FLOOR_FRAMES)?;
    let mut out_of_view = Vec::new();
    for (what, place_w) in places {
        let what = format!("{what}, at [{:.3}, {:.3}]", place_w.x, place_w.y);
        match floor_at(frames.iter().map(|(camera, depth)| (camera, depth)), place_w) {
            FloorAt::Missing => {
                return Err(InputError::new(
                    format!("{what}, is off the floor: the recording shows no surface at its height there"),
                    file,
                    "choose a position on the recorded floor (the report's 3-D view shows it and prints the line to paste)",
                )
                .into());
            }
            FloorAt::OutOfView => out_of_view.push(what),
            FloorAt::Seen | FloorAt::Hidden => {}
        }
    }
    Ok(out_of_view)
}

fn warn_out_of_view(places: &[String], warnings: &Warnings) {
    for place in places {
        warnings.add(
            "plan",
            "place_not_recorded",
            format!("no frame of the recording shows {place}; the floor is assumed to continue there"),
            "check the floor there, or choose a recorded position",
        );
    }
}

fn landing_metrics(plan: &LandingPlan, chooser: &str) -> Metrics {
    let mut m = Metrics::new();
    m.set("plan.chooser", chooser);
    m.set("plan.success", plan.nominal.is_success());
    if let Some(objective) = plan.nominal.objective {
        m.set("plan.objective", objective);
    }
    if let Some(p) = &plan.predicted {
        m.set("plan.success_share", p.success_share).set("plan.predicted_mean", p.mean);
    }
    m.set("plan.evaluations_jet", plan.evaluations.jet).set("plan.evaluations_sph", plan.evaluations.sph);
    m
}
