//! Scan, materialize, plan and export, with and without the cache.

use sms_core::{Cancel, Seed, StageContext, StageError, Warnings};
use sms_entities::{EntitiesConfig, material_queries};
use sms_frames::{LoadSettings, ReadOptions, Recording};
use sms_gaussians::{CpuTrainer, Preset, ScanConfig};
use sms_masks::{GeometryConfig, GeometryMasks};
use sms_pipeline::stages::{
    FramesRequest, GaussiansRequest, SceneRequest, StrikeProblem, entities, frames, gaussians, masks, scene,
    trained_only,
};
use sms_pipeline::{
    Context, Event, EventSink, Format, MaterializeRequest, PlanRequest, PlannedTask, RobotPlace, Run,
    ScanRequest, Settings, strike_task_of, write_task_files,
};
use sms_plan::PlanConfig;
use sms_scene::{Scene, load_scene};
use sms_synth::{BilliardsSettings, RecordingSettings, TruthScene, generate_billiards, write_recording};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Every N-th frame is held out, so that both ways must agree on the training frames.
const HOLDOUT: usize = 5;

/// The settings of a short scan and a short search.
const SHORT: [&str; 4] =
    ["scan.fused.steps=60", "entities.texture.enabled=false", "plan.evaluations=12", "plan.starts=6"];

/// Records for each stage whether it was computed.
#[derive(Clone, Default)]
struct Stages(Arc<Mutex<Vec<(String, bool)>>>);

impl EventSink for Stages {
    fn event(&self, event: &Event<'_>) {
        if let Event::Stage { name, is_cached } = event {
            self.0.lock().unwrap().push(((*name).to_owned(), *is_cached));
        }
    }
}

pub(crate) fn short_settings() -> Settings {
    Settings::read(None, &SHORT.map(str::to_owned)).unwrap()
}

/// Writes a small recording of two balls with its task.
pub(crate) fn record(dir: &Path) -> TruthScene {
    let truth =
        generate_billiards(Seed(1), &BilliardsSettings { objects: 1, ..BilliardsSettings::default() });
    let small = RecordingSettings { frames: 10, ..RecordingSettings::small() };
    write_recording(&truth, &small, dir, &sms_core::NoProgress, &Cancel::new()).unwrap();
    write_task_files(&truth, dir).unwrap();
    truth
}

pub(crate) fn request() -> ScanRequest {
    ScanRequest { preset: Preset::Draft, holdout: Some(HOLDOUT), ..ScanRequest::default() }
}

/// Runs the commands; returns the scene and the objective of the plan.
fn with_cache(recording: &Path, folder: &Path, events: Stages) -> (Scene, f64) {
    let context = Context { settings: short_settings(), events: Box::new(events), ..Context::default() };
    let run = Run::new(folder, &context);
    run.scan(recording, &request()).unwrap();
    let made = run.materialize(&MaterializeRequest::default()).unwrap();
    let task = PlanRequest { robust: Some(0), ..PlanRequest::new(recording.join("task.toml")) };
    let PlannedTask::Strike { plan, .. } = run.plan(&task).unwrap() else { panic!("the task is a strike") };
    let files = run.export(&[Format::Mjcf], None).unwrap();
    assert!(std::fs::read_to_string(&files[0]).unwrap().contains("<mujoco"));
    (load_scene(&made.scene_dir).unwrap(), plan.objective)
}

/// Calls the stages; returns the scene and the objective of the plan.
fn without_cache(recording: &Path, truth: &TruthScene, work_dir: &Path) -> (Scene, f64) {
    let given = short_settings();
    let (cancel, warnings) = (Cancel::new(), Warnings::new());
    let context = StageContext::quiet(&cancel, &warnings);
    let load = LoadSettings { long_side: Preset::Draft.long_side(), ..LoadSettings::default() };
    let poses = sms_poses::PosesConfig::default();
    let read = ReadOptions::default();
    let opened = Recording::open(recording, &read).unwrap();
    let frames_request = FramesRequest { load, poses, accept_faults: false };
    let sequence = frames(&opened, &frames_request, context).unwrap().sequence;
    let geometry = GeometryConfig::default();
    let segmenter = GeometryMasks { config: geometry.clone() };
    let labels = masks(&sequence, &segmenter, &geometry, context).unwrap().labels;

    let config = ScanConfig { holdout: HOLDOUT, ..ScanConfig::preset(Preset::Draft) };
    let config = given.section("scan", config).unwrap();
    let mut trainer = CpuTrainer::new(&config.train, labels.class_count(), context.seed);
    let work = GaussiansRequest { config: &config, work_dir };
    let scanned = gaussians(&sequence, &labels, &work, &mut trainer, &mut (), context).unwrap();

    let (sequence, labels) = trained_only(sequence, labels, HOLDOUT);
    let config = given.section("entities", EntitiesConfig::default()).unwrap();
    let set = entities(scanned.model, &sequence, &labels, &config, &read, context).unwrap().set;
    let queries = material_queries(&set);
    let of_scene = SceneRequest {
        name: "recording",
        queries: &queries,
        overrides: None,
        size_sigma: 0.0,
        x_world_recording: sequence.x_world_recording,
        fix_restless: true,
    };
    let scene = scene(&set, &of_scene, context).unwrap();

    let robot = RobotPlace { config: sms_target::robot_of(truth), is_from_recording: true };
    let mut plan = given.section("plan", PlanConfig::default()).unwrap();
    plan.perturbation.worlds = 0;
    let strike = StrikeProblem::new(&strike_task_of(truth), &scene, &robot).unwrap();
    let objective = strike.plan(&scene, &plan, context).unwrap().plan.objective;
    (scene, objective)
}

/// Checks that the comparison of the scene with the recorded depth keeps the other figures and the warnings of `evaluate`.
fn compare_with_depth(folder: &Path) {
    let context = Context { settings: short_settings(), ..Context::default() };
    let run = Run::new(folder, &context);
    let evaluated = run.evaluate(None).unwrap();
    let kept = || (std::fs::read(folder.join("warnings.json")).unwrap(), run.metrics().unwrap());
    let before = kept();
    let compared = run.compare_depth().unwrap();
    assert_eq!(compared, evaluated.agreement);
    assert_eq!(kept(), before);
    // Every fifth of ten frames is held out.
    let held_out = compared.held_out.measured as f64 / compared.all.measured as f64;
    assert!((0.1..0.35).contains(&held_out), "{compared:?}");
    let number = |key: &str| before.1.number(key).unwrap();
    assert!(number("evaluate.holdout_depth_agrees") > 0.8, "{compared:?}");
    assert_eq!(number("evaluate.depth_pixels"), compared.all.measured as f64);
    assert!(number("evaluate.floor.depth_agrees") > 0.8 && number("evaluate.objects") > 1.0);
}

#[test]
fn the_cache_changes_no_result_and_spares_all_work() {
    let dir = tempfile::tempdir().unwrap();
    let recording = dir.path().join("recording");
    let truth = record(&recording);
    let folder = dir.path().join("run");
    let stages = ["frames", "masks", "gaussians", "entities", "scene", "plan"];
    let expected = |is_cached: bool| stages.map(|s| (s.to_owned(), is_cached)).to_vec();

    let events = Stages::default();
    let (scene, objective) = with_cache(&recording, &folder, events.clone());
    assert_eq!(*events.0.lock().unwrap(), expected(false));
    assert!(scene.bodies.len() > 2, "the scene must have a floor and two balls");

    let events = Stages::default();
    let otherwise_spelled = folder.join("..").join("recording");
    let again = with_cache(&otherwise_spelled, &folder, events.clone());
    assert_eq!(*events.0.lock().unwrap(), expected(true));
    assert_eq!(again, (scene.clone(), objective));

    compare_with_depth(&folder);

    let (bare, bare_objective) = without_cache(&recording, &truth, &dir.path().join("work"));
    let names = |scene: &Scene| scene.bodies.iter().map(|b| b.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&bare), names(&scene));
    for (bare, cached) in bare.bodies.iter().zip(&scene.bodies) {
        assert!(bare.x_wb.translation.distance(cached.x_wb.translation) < 1e-6, "{}", bare.name);
    }
    assert!((bare_objective - objective).abs() < 0.05, "{bare_objective} and {objective}");
}

#[test]
fn a_missing_recording_is_bad_input_and_makes_no_run() {
    let dir = tempfile::tempdir().unwrap();
    let context = Context::default();
    let run = Run::new(dir.path().join("run"), &context);
    let error = run.scan(&dir.path().join("nowhere"), &ScanRequest::default()).unwrap_err();
    assert!(error.input().unwrap().path.contains("nowhere"));
    assert!(!run.folder().exists());
    assert!(run.materialize(&MaterializeRequest::default()).unwrap_err().input().is_some());
}
