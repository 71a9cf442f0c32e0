//! Writes the report page of a run.

use super::execute::is_landing;
use super::plan::{CHOICE_FILE, PICTURES};
use super::{Run, RunSettings, read_optional};
use crate::Error;
use crate::stages::{ChoiceRecord, recording};
use sms_core::metrics::Metrics;
use sms_core::{ColorImage, InputError, RunFolder, Warning, read_png_color};
use sms_frames::Sequence;
use sms_gaussians::{GaussianModel, read_ply, render_views};
use sms_landing::{LandingPlan, RolloutOptions, rollout_landing};
use sms_masks::load_labels;
use sms_plan::load_plan;
use sms_report::{LandingInput, LandingRealised, ReportInput, ViewPair, write_report};
use sms_scene::{Scene, load_scene};
use sms_sim::{FINGER_HALF, RapierFactory};
use sms_target::{LANDING_EXECUTION_FILE, LandingExecution};
use sms_task::{Execution, ResolvedTask, Task};
use std::path::{Path, PathBuf};

/// Number of frames shown, spread over the recording; held-out ones if there are any.
const VIEWS: usize = 3;

impl Run<'_> {
    /// Writes the report and returns the page's path. With the feature `rerun`, also writes `run.rrd` for the Rerun
    /// viewer.
    ///
    /// # Errors
    /// [`Error::Core`] if there is no scan or a file cannot be written.
    pub fn report(&self) -> Result<PathBuf, Error> {
        let run = self.open_to_read()?;
        let settings = RunSettings::of(&run)?;
        let gaussians_dir = run.stage_dir("gaussians", "scan DIR --out")?;
        let model = read_ply(&gaussians_dir.join("scene.ply"))?;
        let scene = run.stage_dir("scene", "materialize").ok().map(|d| load_scene(&d)).transpose()?;
        let landed = landed(&run, scene.as_ref())?;
        let plan_dir = run.stage_dir("plan", "plan").ok().filter(|_| landed.is_none());
        let plan = plan_dir.as_deref().map(load_plan).transpose()?;
        let target_dir = run.stage_dir("target", "execute").ok().filter(|_| landed.is_none());
        let execution = target_dir.map(|d| Execution::load(&d)).transpose()?;
        let resolved = match (&plan_dir, &scene) {
            (Some(dir), Some(scene)) => Some(Task::read(&dir.join("task.toml"))?.resolve(scene)?),
            _ => None,
        };
        let metrics = self.metrics()?;
        let warnings: Vec<Warning> = read_optional(&run.warnings_path())?.unwrap_or_default();
        let landing = landed.as_ref().map(Landed::input);
        let is_generated = Path::new(&settings.recording).join("truth").is_dir();
        let title = match (&landing, is_generated) {
            (Some(_), true) => format!("Landing, seed {}", settings.seed),
            _ => title(&settings.recording, resolved.as_ref(), settings.seed),
        };
        let engine = execution.as_ref().map(|e| &e.engine);
        let landed_in = landed.as_ref().and_then(|l| l.execution.as_ref()).map(|e| &e.engine);
        // The plan of a landing stores which bodies could move.
        let planned_in = landed.as_ref().zip(scene.as_ref()).map(|(l, scene)| l.plan.world(scene));
        let input = ReportInput {
            title,
            subtitle: subtitle(&settings, &metrics, engine.or(landed_in)),
            views: views(&run, &model, settings.holdout)?,
            gaussians: Some(&model),
            scene: planned_in.as_ref().or(scene.as_ref()),
            plan: plan.as_ref(),
            execution: execution.as_ref(),
            landing,
            pictures: landed.as_ref().map(|l| l.pictures.clone()).unwrap_or_default(),
            goal_w: resolved.as_ref().and_then(|t| t.goal_w()).map(|p| p.to_array()),
            striker_half_m: Some(FINGER_HALF.to_array()),
            roles: resolved.as_ref().map(roles).unwrap_or_default(),
            losses: read_optional(&gaussians_dir.join("losses.json"))?.unwrap_or_default(),
            metrics,
            warnings,
            settings_toml: std::fs::read_to_string(run.root().join("run.toml")).unwrap_or_default(),
        };
        let page = write_report(&run.root().join("report"), &input)?;
        #[cfg(feature = "rerun")]
        {
            let path = run.root().join("report").join("run.rrd");
            sms_report::write_rrd(&path, &input)?;
            self.context.message(format!("for Rerun: {}", path.display()));
        }
        Ok(page)
    }
}

/// Returns one line with recording, masks, preset and engine.
fn subtitle(settings: &RunSettings, metrics: &Metrics, engine: Option<&String>) -> String {
    let unknown = metrics.number("masks.unknown").filter(|n| *n > 0.0);
    let unknown = unknown.map_or_else(String::new, |n| format!(" and {n} unknown"));
    let word = |key: &str| metrics.get(key).and_then(|v| v.as_str());
    let networks = word("masks.model").zip(word("masks.track"));
    let networks = networks.map_or_else(String::new, |(model, track)| format!(" ({model}, {track})"));
    let (name, preset) = (settings.recording_name(), &settings.preset);
    let mut line = format!("{name} · masks from {}{networks}{unknown} · preset {preset}", settings.masks);
    if let Some(engine) = engine {
        line += &format!(" · executed in {engine}");
    }
    line
}

/// The landing of a run.
struct Landed {
    plan: LandingPlan,
    execution: Option<LandingExecution>,
    /// Pictures of a baseline's choice, with captions.
    pictures: Vec<(String, ColorImage)>,
}

impl Landed {
    fn input(&self) -> LandingInput<'_> {
        LandingInput {
            plan: &self.plan,
            realised: self.execution.as_ref().map(|e| LandingRealised {
                engine: &e.engine,
                outcome: &e.outcome,
                second_opinion: e.second_opinion.as_ref(),
                matches: &e.matches,
            }),
        }
    }
}

/// Loads the landing; `None` if the plan is of another kind.
fn landed(run: &RunFolder, scene: Option<&Scene>) -> Result<Option<Landed>, Error> {
    let Some(dir) = run.stage_dir("plan", "plan").ok().filter(|d| is_landing(d)) else { return Ok(None) };
    let mut plan = LandingPlan::load(&dir)?;
    if let Some(scene) = scene.filter(|_| cfg!(feature = "rerun")) {
        // Files do not contain particles, so the flight is simulated again.
        let options = RolloutOptions { recording: Some(recording(true)), ..RolloutOptions::default() };
        let (world, landing) = (plan.world(scene), plan.landing());
        let flown = rollout_landing(&RapierFactory, &plan.wash, &world, &landing, &plan.action, &options)?;
        plan.nominal.particles = flown.particles;
    }
    let target = run.stage_dir("target", "execute").ok();
    let execution = target
        .filter(|d| d.join(LANDING_EXECUTION_FILE).is_file())
        .map(|d| LandingExecution::load(&d))
        .transpose()?;
    let record: Option<ChoiceRecord> = read_optional(&dir.join(CHOICE_FILE))?;
    let mut pictures = Vec::new();
    if let Some(record) = &record {
        for ((file, caption), why) in PICTURES.iter().zip(&record.reasons) {
            let path = dir.join(file);
            if path.is_file() {
                let why = if why.is_empty() { String::new() } else { format!(": {why}") };
                pictures.push((format!("{}, {caption}{why}", record.chooser), read_png_color(&path)?));
            }
        }
    }
    Ok(Some(Landed { plan, execution, pictures }))
}

fn title(recording: &str, task: Option<&ResolvedTask>, seed: u64) -> String {
    match task {
        Some(task) if Path::new(recording).join("truth").is_dir() => {
            let kind = task.kind();
            let (first, rest) = kind.split_at(1);
            format!("{}{rest}, seed {seed}", first.to_uppercase())
        }
        _ => Path::new(recording)
            .file_name()
            .map_or_else(|| "Scan".into(), |n| n.to_string_lossy().into_owned()),
    }
}

fn roles(task: &ResolvedTask) -> Vec<(String, String)> {
    vec![(task.cue().name.clone(), "cue".into()), (task.target().name.clone(), "target".into())]
}

fn views(run: &RunFolder, model: &GaussianModel, holdout: usize) -> Result<Vec<ViewPair>, Error> {
    let sequence = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?;
    let masks_dir = run.stage_dir("masks", "scan DIR --out")?;
    let labels = load_labels(&masks_dir)?;
    if labels.maps.len() != sequence.len() {
        let what = format!("there are {} masks for {} frames", labels.maps.len(), sequence.len());
        return Err(InputError::new(what, &masks_dir, "run `sms scan` again with the same folder").into());
    }
    let mut candidates = sequence.held_out(holdout);
    if candidates.is_empty() {
        candidates = (0..sequence.len()).collect();
    }
    let count = VIEWS.min(candidates.len());
    let chosen: Vec<usize> =
        (0..count).map(|i| candidates[(2 * i + 1) * candidates.len() / (2 * count)]).collect();
    let renders = render_views(model, &sequence, &chosen);
    Ok(renders
        .into_iter()
        .map(|view| {
            let frame = &sequence.frames[view.frame_index];
            ViewPair {
                frame_index: view.frame_index,
                held_out: Sequence::is_held_out(view.frame_index, holdout),
                camera: frame.camera,
                observed_color: frame.color.clone(),
                observed_depth: frame.depth.clone(),
                observed_label: labels.maps[view.frame_index].clone(),
                rendered_color: view.color,
                rendered_depth: view.depth,
                rendered_label: view.label,
            }
        })
        .collect())
}
