//! Writes the report page of a run.

use super::execute::is_landing;
use super::plan::{CHOICE_FILE, PICTURES};
use super::recorded::RecordedFrames;
use super::status::is_generated;
use super::{Run, RunSettings, read_optional, stale_warning};
use crate::Error;
use crate::origin::{PageSources, Staleness, current_dir, staleness};
use crate::stage_list::{command_of, prefixes};
use crate::stages::{ChoiceRecord, recording};
use sms_core::metrics::Metrics;
use sms_core::{ColorImage, RunFolder, Warning, read_png_color, shell_argument};
use sms_gaussians::read_ply;
use sms_landing::{LandingPlan, RolloutOptions, rollout_landing};
use sms_plan::load_plan;
use sms_report::{LandingInput, LandingRealised, ReportInput, write_report};
use sms_scene::{Scene, load_scene};
use sms_sim::{FINGER_HALF, RapierFactory};
use sms_target::{LANDING_EXECUTION_FILE, LandingExecution};
use sms_task::{Execution, ResolvedTask, Task};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

impl Run<'_> {
    /// Writes the report and returns the page's path. With the feature `rerun`, also writes `run.rrd` for the Rerun
    /// viewer.
    ///
    /// # Errors
    /// [`Error::Core`] if there is no scan or a file cannot be written.
    pub fn report(&self) -> Result<PathBuf, Error> {
        let run = self.open_to_read()?;
        let sources = PageSources::of(&run);
        let settings = RunSettings::of(&run)?;
        let gaussians_dir = current_dir(&run, "gaussians", "scan DIR --out")?;
        let model = read_ply(&gaussians_dir.join("scene.ply"))?;
        let frames = RecordedFrames::of(&run)?;
        let shown = Shown::of(&run);
        let scene = shown.scene.as_deref().map(load_scene).transpose()?;
        let landed = landed(&shown, scene.as_ref())?;
        let plan_dir = shown.plan.clone().filter(|_| landed.is_none());
        let plan = plan_dir.as_deref().map(load_plan).transpose()?;
        let target_dir = shown.target.clone().filter(|_| landed.is_none());
        let execution = target_dir.map(|d| Execution::load(&d)).transpose()?;
        let resolved = match (&plan_dir, &scene) {
            (Some(dir), Some(scene)) => Some(Task::read(&dir.join("task.toml"))?.resolve(scene)?),
            _ => None,
        };
        let mut metrics = self.metrics()?;
        let mut warnings: Vec<Warning> = read_optional(&run.warnings_path())?.unwrap_or_default();
        for stage in &shown.left_out {
            prefixes(stage).iter().for_each(|prefix| metrics.remove_prefix(prefix));
            warnings.retain(|w| w.stage != *stage);
        }
        warnings.extend(shown.warnings);
        let landing = landed.as_ref().map(Landed::input);
        let title = match (&landing, is_generated(Path::new(&settings.recording))) {
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
            recorded: frames.photographs(self, &run, settings.holdout)?,
            names: frames.names(),
            views: frames.views(&model, settings.holdout),
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
            commands: commands(&run),
            written: Some(SystemTime::now()),
        };
        let page = write_report(&run.root().join("report"), &input)?;
        sources.write(&run.root().join("report"))?;
        #[cfg(feature = "rerun")]
        {
            let path = run.root().join("report").join("run.rrd");
            sms_report::write_rrd(&path, &input)?;
            self.context.message(format!("for Rerun: {}", path.display()));
        }
        Ok(page)
    }
}

/// The results that the page shows. Stale ones are left out, because their bodies and poses may be others than those of
/// the page; a scene without the latest edits is shown with a warning.
struct Shown {
    scene: Option<PathBuf>,
    plan: Option<PathBuf>,
    target: Option<PathBuf>,
    left_out: Vec<&'static str>,
    warnings: Vec<Warning>,
}

impl Shown {
    fn of(run: &RunFolder) -> Self {
        let mut left_out = Vec::new();
        let mut warnings = Vec::new();
        let (all, current) = (staleness(run), Staleness::default());
        let mut folder = |stage: &'static str| {
            let dir = run.stage_dir(stage, stage).ok()?;
            let stale = all.iter().find(|s| s.0 == stage).map_or(&current, |s| &s.1);
            // The scene is stale whenever the entities are, and its warning has their reasons.
            if stage != "entities" {
                warnings.extend(stale_warning(run, stage, stale).snapshot());
            }
            if stale.replaced.is_empty() {
                return Some(dir);
            }
            left_out.push(stage);
            None
        };
        let [_, scene, plan, target, _] = ["entities", "scene", "plan", "target", "robot"].map(&mut folder);
        Self { scene, plan, target, left_out, warnings }
    }
}

/// Returns the commands that make the scan and the page again.
fn commands(run: &RunFolder) -> Vec<String> {
    vec![command_of(run, "gaussians"), format!("sms report {}", shell_argument(run.root()))]
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
fn landed(shown: &Shown, scene: Option<&Scene>) -> Result<Option<Landed>, Error> {
    let Some(dir) = shown.plan.clone().filter(|d| is_landing(d)) else { return Ok(None) };
    let mut plan = LandingPlan::load(&dir)?;
    if let Some(scene) = scene.filter(|_| cfg!(feature = "rerun")) {
        // Files do not contain particles, so the flight is simulated again.
        let options = RolloutOptions { recording: Some(recording(true)), ..RolloutOptions::default() };
        let (world, landing) = (plan.world(scene), plan.landing());
        let flown = rollout_landing(&RapierFactory, &plan.wash, &world, &landing, &plan.action, &options)?;
        plan.nominal.particles = flown.particles;
    }
    let execution = shown
        .target
        .clone()
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
        Some(task) if is_generated(Path::new(recording)) => {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::origin::Sources;
    use sms_core::{StageState, hash_serializable};

    /// Makes the result of a stage from its present inputs.
    fn make(run: &RunFolder, stage: &str, content: &str) {
        let begun = run.begin(stage, &hash_serializable(&content), false).unwrap();
        let StageState::Todo(work) = begun else { panic!("{stage} has this content already") };
        std::fs::write(work.dir().join("content"), content).unwrap();
        Sources::of(run, stage).write(work.dir()).unwrap();
        work.commit().unwrap();
    }

    #[test]
    fn results_of_an_earlier_scan_are_left_out() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::create(dir.path()).unwrap();
        ["gaussians", "entities", "scene"].iter().for_each(|stage| make(&run, stage, "first"));
        let shown = Shown::of(&run);
        assert_eq!((shown.left_out.len(), shown.warnings.len()), (0, 0));
        assert_eq!(shown.scene, Some(dir.path().join("scene")));

        make(&run, "gaussians", "second");
        let shown = Shown::of(&run);
        assert_eq!((shown.left_out, shown.scene), (vec!["entities", "scene"], None));
        assert_eq!(shown.warnings.iter().map(|w| w.stage.as_str()).collect::<Vec<_>>(), ["scene"]);
        let removed: Vec<&str> = prefixes("entities").to_vec();
        assert!(removed.contains(&"entities.") && removed.contains(&"materialize."));
    }
}
