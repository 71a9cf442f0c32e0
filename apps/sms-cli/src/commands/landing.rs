//! Tasks of the kind `landing`: what `sms plan`, `sms execute` and `sms report` do with them.

use super::materialize::{drift_text, run_settings};
use super::vlm;
use super::{inputs_hash, length_text, run_stage, shown, timed};
use crate::cli::{ChooserName, Plan};
use serde::{Deserialize, Serialize};
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{
    ColorImage, Hasher, InputError, RunFolder, Seed, StageContext, StageError, Warnings, atomic,
    read_png_color, write_png_color,
};
use sms_frames::{Frame, Sequence};
use sms_landing::{
    CarriedOut, Freed, LANDING_PLAN_FILE, LandingAction, LandingError, LandingEvaluations, LandingOutcome,
    LandingPlan, LandingPlanOutcome, LandingRecording, LandingSettings, LandingTask, PlannedBody,
    ResolvedLanding, RolloutOptions, Stuck, plan_landing, rollout_landing,
};
use sms_plan::write_trials;
use sms_prompting::{
    ApproachSettings, Choice, Observation, SiteSettings, Sites, approaches, best_view, geometric,
    landing_sites, paths_picture, random, resized, sites_picture, surfaces_of, visual_prompting,
};
use sms_robots::autopilot::{FlightFiles, write_flight};
use sms_scene::{Scene, load_scene};
use sms_sim::RapierFactory;
use sms_synth::TruthScene;
use sms_target::{LANDING_EXECUTION_FILE, LandingExecution, LandingTargetOptions, Target, execute_landing};
use sms_vlm::{ApiKey, Cache, Client, picture};
use sms_wash::{WashModel, WashSettings};
use std::path::Path;

/// What a baseline chose, beside its plan.
const CHOICE_FILE: &str = "choice.json";
/// Pictures of the candidates, with what they show.
const PICTURES: [(&str, &str); 2] = [
    ("choice_sites.png", "landing sites, the chosen one in green"),
    ("choice_approaches.png", "approaches to it, the chosen one in colour"),
];
/// Time between recorded states, seconds.
const RECORD_EVERY_S: f64 = 1.0 / 60.0;

/// What a baseline chose, in words.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct ChoiceRecord {
    /// Its name in tables.
    pub chooser: String,
    /// Number of the site.
    pub site: u32,
    /// Number of the approach.
    pub approach: u32,
    /// Why this site and this approach.
    pub reasons: [String; 2],
}

/// Whether a run's plan is one of a landing.
pub(crate) fn is_planned(plan_dir: &Path) -> bool {
    plan_dir.join(LANDING_PLAN_FILE).is_file()
}

/// `sms plan` of a landing. What refuses the task is also kept as a warning, so that the report says it, and no earlier plan stays, which
/// would be flown in its place.
pub(crate) fn plan(console: &Console, a: &Plan, base: LandingSettings) -> anyhow::Result<()> {
    let run = RunFolder::open(&a.run)?;
    let error = match planned(console, a, base, &run) {
        Ok(()) => return Ok(()),
        Err(error) => error,
    };
    let refused = error
        .downcast_ref::<LandingError>()
        .and_then(StageError::input)
        .or(error.downcast_ref::<InputError>())
        .cloned();
    let Some(refused) = refused else { return Err(error) };
    for stage in ["target", "plan"] {
        run.discard(stage)?;
    }
    let warnings = Warnings::new();
    let what = format!("no landing was planned: {}", refused.what);
    warnings.add("plan", "landing_refused", what, refused.cure.clone());
    console.finish(&run, "plan", &["plan."], Metrics::new(), &warnings)?;
    Err(refused.into())
}

fn planned(console: &Console, a: &Plan, base: LandingSettings, run: &RunFolder) -> anyhow::Result<()> {
    let task = LandingTask::read(&a.task)?;
    let scene_dir = run.stage_dir("scene", "materialize")?;
    let mut scene = load_scene(&scene_dir)?;
    let seed = Seed(a.seed.map_or_else(|| run_settings(run).map(|s| s.seed), Ok)?);
    let mut config = console.context.settings.section("landing", base)?;
    if let Some(worlds) = a.robust {
        config.worlds = worlds;
    }
    let files = console.context.settings.section("flight", FlightFiles::default())?;
    let freed = task.freed(&RapierFactory, &scene, &config.disturbances, seed)?;
    if let Some(freed) = &freed {
        scene = freed.scene.clone();
    }
    let landing = task.resolve(&scene)?;
    run.record_settings("landing", &config)?;
    run.record_settings("flight", &files)?;
    // What the manifest says now: a user may have edited a mass or a friction.
    let mut manifest = Hasher::new();
    manifest.file(&scene_dir.join("scene.json"))?;
    let inputs = (&task, landing.vehicle(), config, files, seed, a.chooser.name());
    let hash = inputs_hash(&[&manifest.finish()], &inputs)?;
    let dir = run_stage(console, run, "plan", &["plan."], &hash, |stage, warnings| {
        timed("plan.seconds", || {
            let progress = console.context.progress.as_ref();
            freed.iter().for_each(|freed| tell_freed(freed, warnings));
            let outcome = match a.chooser {
                ChooserName::Ours => {
                    let cancel = &console.context.cancel;
                    plan_landing(
                        &landing,
                        &scene,
                        &RapierFactory,
                        &config,
                        StageContext::new(progress, cancel, warnings).with_seed(seed),
                    )?
                }
                _ => {
                    baseline(console, a.chooser, run, &landing, &scene, &config, seed, stage.dir(), warnings)?
                }
            };
            let plan = &outcome.plan;
            plan.save(stage.dir())?;
            write_trials(&stage.dir().join("trials.parquet"), &plan.parameters, &outcome.trials)?;
            task.write(&stage.dir().join("task.toml"))?;
            let flight = landing.flight(&plan.action, &CarriedOut::default())?;
            write_flight(stage.dir(), &flight, landing.vehicle(), &files)?;
            Ok(metrics(plan, a.chooser.name()))
        })
    })?;
    let plan = LandingPlan::load(&dir)?;
    for line in summary(&plan) {
        console.say(line);
    }
    let has_mission = dir.join("mission.plan").is_file();
    let mission = if has_mission { ", mission.plan" } else { "" };
    console.say(format!(
        "  in {}; to fly: flight.json, setpoints.csv{mission}",
        shown(&dir.join(LANDING_PLAN_FILE))
    ));
    console.print_metrics(run)
}

/// What stays fixed, and why.
pub(crate) fn stuck_text(stuck: &Stuck) -> String {
    let names = stuck.bodies.iter().map(|b| format!("`{b}`")).collect::<Vec<_>>().join(", ");
    let leaves = drift_text(&stuck.leaves);
    format!(
        "{names} cannot topple in this plan: fixed, because the structure does not stand otherwise ({leaves})"
    )
}

/// What can move in the plan and not in the scene, and what still cannot.
fn tell_freed(freed: &Freed, warnings: &Warnings) {
    let others = if freed.other_masses {
        ", with masses within their intervals, because the structure would fall with the most likely ones"
    } else {
        ""
    };
    for body in &freed.bodies {
        let message = format!("`{body}` is fixed in the scene; here it can move, and topple{others}");
        let cure = "if it is fixed in truth, write `free = false` in the task";
        warnings.add("plan", "freed", message, cure);
    }
    if let Some(stuck) = &freed.stuck {
        let message = stuck_text(stuck);
        let cure = "see what it touches in `sms report`: something that was not told apart from it, or a wrong contact";
        warnings.add("plan", "held", message, cure);
    }
    for drift in &freed.held {
        let message = format!("{}: it stays fixed, and cannot topple", drift_text(drift));
        warnings.add(
            "plan",
            "held",
            message,
            "scan it from more sides, or correct what it is made of (`sms materials`)",
        );
    }
}

fn metrics(plan: &LandingPlan, chooser: &str) -> Metrics {
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

/// What is planned, in lines.
fn summary(plan: &LandingPlan) -> Vec<String> {
    let a = &plan.action;
    let [x, y] = a.landing_w;
    let mut lines = vec![
        format!("plan: land on {} at ({x:.3}, {y:.3}) m", plan.surface.body),
        format!(
            "  approach point {:.2} m from there, {:.0}° about z from x",
            a.approach_radius,
            a.approach_angle.to_degrees()
        ),
    ];
    let nominal = verdict(&plan.nominal);
    lines.push(match &plan.predicted {
        Some(p) => format!(
            "  predicted: success in {:.0} % of {} worlds; in the scanned one: {nominal}",
            100.0 * p.success_share,
            p.worlds
        ),
        None => format!("  predicted in the scanned world: {nominal}"),
    });
    let e = plan.evaluations;
    lines.push(format!(
        "  {} rollouts with jets, {} with particles, {} of them not valid",
        e.jet, e.sph, e.invalid
    ));
    lines
}

fn verdict(outcome: &LandingOutcome) -> String {
    match &outcome.failure {
        None => format!("success, {} from the chosen point", length_text(outcome.landing_error_m)),
        Some(failure) if outcome.is_toppled_by_wash() => format!("{failure}, by the wash alone"),
        Some(failure) => failure.to_string(),
    }
}

/// A choice among geometric candidates, flown once with particles in the scanned world.
fn baseline(
    console: &Console,
    chooser: ChooserName,
    run: &RunFolder,
    landing: &ResolvedLanding,
    scene: &Scene,
    config: &LandingSettings,
    seed: Seed,
    dir: &Path,
    warnings: &Warnings,
) -> anyhow::Result<LandingPlanOutcome> {
    landing.check_rest(&RapierFactory, scene)?;
    let limits = landing.task().surface;
    let settings =
        SiteSettings { min_height: limits.height_m, max_tilt: limits.slope_rad, ..SiteSettings::default() };
    let sites = landing_sites(&surfaces_of(scene), landing.vehicle(), &settings).map_err(|e| {
        let cure = "lower `surface.height_m` in the task, or use a smaller vehicle";
        InputError::new(e.to_string(), landing.task().path(), cure)
    })?;
    let ways = ApproachSettings::default();
    let start_w = landing.start_w();
    let sequence = Sequence::load(&run.stage_dir("frames", "scan DIR --out")?)?;
    let seen = observation(&sequence.frames, scene, &sites);
    let (choice, pictures) = match chooser {
        ChooserName::Visual => prompted(console, run, seen, &sites, landing, &ways, seed, warnings)?,
        ChooserName::Random => drawn(seen, &sites, random(&sites, start_w, &ways, seed), landing, &ways),
        ChooserName::Ours | ChooserName::Geometric => {
            drawn(seen, &sites, geometric(&sites, start_w, &ways), landing, &ways)
        }
    };
    for ((file, _), image) in PICTURES.iter().zip(&pictures) {
        write_png_color(&dir.join(file), image)?;
    }
    let record = ChoiceRecord {
        chooser: choice.chooser.name().to_owned(),
        site: choice.site.id,
        approach: choice.approach.id,
        reasons: choice.reasons.clone(),
    };
    atomic::write_json(&dir.join(CHOICE_FILE), &record)?;
    console.say(format!(
        "{}: site {} of {}, approach {} of {}",
        record.chooser,
        record.site,
        sites.sites.len(),
        record.approach,
        ways.count
    ));
    let action = action_of(&choice);
    let options = RolloutOptions { recording: Some(recording(false)), ..RolloutOptions::default() };
    let nominal = rollout_landing(&RapierFactory, &particles(config), scene, landing, &action, &options)?;
    let invalid = usize::from(nominal.objective.is_none());
    let plan = LandingPlan {
        task: landing.task().clone(),
        engine: nominal.engine.clone(),
        vehicle: landing.vehicle().clone(),
        surface: landing.surface().clone(),
        structure: landing.structure().to_vec(),
        parameters: landing.parameters(),
        action,
        bodies: PlannedBody::all_of(scene),
        nominal,
        wash: particles(config),
        predicted: None,
        alternatives: Vec::new(),
        evaluations: LandingEvaluations { jet: 0, sph: 1, invalid },
    };
    Ok(LandingPlanOutcome { plan, trials: Vec::new() })
}

/// The landing that was chosen.
pub(crate) fn action_of(choice: &Choice) -> LandingAction {
    LandingAction {
        landing_w: choice.site.p_w.truncate().to_array(),
        approach_radius: choice.approach.radius,
        approach_angle: choice.approach.angle.rem_euclid(std::f64::consts::TAU),
    }
}

fn recording(particles: bool) -> LandingRecording {
    LandingRecording { every_s: RECORD_EVERY_S, particles }
}

fn particles(config: &LandingSettings) -> WashSettings {
    WashSettings { model: WashModel::Sph, stream: config.jet, sph: config.sph }
}

/// The frame that shows the sites best; `None` where none does.
pub(crate) fn observation(frames: &[Frame], scene: &Scene, sites: &Sites) -> Option<Observation> {
    let frame = &frames[best_view(frames.iter().map(|f| &f.camera), &sites.sites)?];
    let image = picture(&frame.color_path, frame.color.size()).unwrap_or_else(|| frame.color.clone());
    let called = scene.body(&sites.platform).map(|b| b.description.clone()).filter(|d| !d.trim().is_empty());
    let target = called.unwrap_or_else(|| sites.platform.replace('_', " "));
    Some(Observation { image, camera: frame.camera, target })
}

/// The choice with pictures of it.
fn drawn(
    seen: Option<Observation>,
    sites: &Sites,
    choice: Choice,
    landing: &ResolvedLanding,
    ways: &ApproachSettings,
) -> (Choice, Vec<ColorImage>) {
    let Some(seen) = seen else { return (choice, Vec::new()) };
    let (image, camera) =
        resized(&seen.image, &seen.camera, sms_cli::settings::vlm_defaults().max_image_side);
    let all = approaches(landing.start_w(), choice.site.p_w, ways);
    let pictures = vec![
        sites_picture(&image, &camera, sites, Some(choice.site.id)).image,
        paths_picture(&image, &camera, &choice.site, &all, Some(choice.approach.id)).image,
    ];
    (choice, pictures)
}

/// The choice of a vision-language model.
fn prompted(
    console: &Console,
    run: &RunFolder,
    seen: Option<Observation>,
    sites: &Sites,
    landing: &ResolvedLanding,
    ways: &ApproachSettings,
    seed: Seed,
    warnings: &Warnings,
) -> anyhow::Result<(Choice, Vec<ColorImage>)> {
    let config = console.context.settings.section("vlm", sms_cli::settings::vlm_defaults())?;
    let seen = seen.ok_or_else(|| {
        InputError::new(
            "no frame of the recording shows the landing sites from above",
            "--chooser visual",
            "record the structure from higher up, or use another chooser",
        )
    })?;
    run.record_settings("vlm", &config)?;
    let key = ApiKey::new(&std::env::var("OPENAI_API_KEY").unwrap_or_default())?;
    let client = Client::new(&config, key, seed.derive("visual prompting"))?;
    let cache = Cache::new(&run.root().join(vlm::REPLIES));
    let start_w = landing.start_w();
    let done =
        visual_prompting(&seen, sites, start_w, ways, &client, &cache, &console.context.cancel, warnings);
    let prompted = done.map_err(|e| match e.input(&config.url) {
        Ok(refused) => anyhow::Error::from(refused),
        Err(e) => e.into(),
    })?;
    Ok((prompted.choice, prompted.chosen.into()))
}

/// `sms execute` of a landing's plan: the stage's figures.
pub(crate) fn execute(
    target: &dyn Target,
    plan: &LandingPlan,
    scene: &Scene,
    truth: &TruthScene,
    dir: &Path,
    options: &LandingTargetOptions,
) -> anyhow::Result<Metrics> {
    let world = plan.world(scene);
    let execution = execute_landing(target, &plan.landing(), &plan.action, &world, truth, options)?;
    execution.save(dir)?;
    let outcome = &execution.outcome;
    let mut m = Metrics::new();
    m.set("execute.engine", execution.engine.clone());
    m.set("execute.success", outcome.is_success());
    if let Some(objective) = outcome.objective {
        m.set("execute.objective", objective).set("execute.landing_error_m", outcome.landing_error_m);
    }
    if let Some(second) = &execution.second_opinion {
        m.set("execute.jet_success", second.is_success());
    }
    Ok(m)
}

/// What happened, in lines.
pub(crate) fn execution_summary(dir: &Path) -> anyhow::Result<Vec<String>> {
    let e = LandingExecution::load(dir)?;
    let mut lines = vec![format!("execute: {}", e.engine), format!("  realised: {}", verdict(&e.outcome))];
    lines.extend(e.second_opinion.map(|s| format!("  with wash by jets: {}", verdict(&s))));
    lines.push(format!("  in {}", shown(&dir.join(LANDING_EXECUTION_FILE))));
    Ok(lines)
}

/// What the report shows of a landing.
pub(crate) struct Reported {
    pub plan: LandingPlan,
    pub execution: Option<LandingExecution>,
    pub pictures: Vec<(String, ColorImage)>,
}

/// Loads it; `None` where the plan is of another kind.
pub(crate) fn reported(run: &RunFolder, scene: Option<&Scene>) -> anyhow::Result<Option<Reported>> {
    let Some(dir) = run.stage_dir("plan", "plan").ok().filter(|d| is_planned(d)) else { return Ok(None) };
    let mut plan = LandingPlan::load(&dir)?;
    if let Some(scene) = scene.filter(|_| cfg!(feature = "rerun")) {
        // Files hold no particles: the flight is simulated again for them.
        let options = RolloutOptions { recording: Some(recording(true)), ..RolloutOptions::default() };
        let flown = rollout_landing(
            &RapierFactory,
            &plan.wash,
            &plan.world(scene),
            &plan.landing(),
            &plan.action,
            &options,
        )?;
        plan.nominal.particles = flown.particles;
    }
    let target = run.stage_dir("target", "execute").ok();
    let execution = target
        .filter(|d| d.join(LANDING_EXECUTION_FILE).is_file())
        .map(|d| LandingExecution::load(&d))
        .transpose()?;
    let record: Option<ChoiceRecord> = super::materialize::read_optional(&dir.join(CHOICE_FILE))?;
    let mut pictures = Vec::new();
    if let Some(record) = &record {
        for ((file, what), why) in PICTURES.iter().zip(&record.reasons) {
            let path = dir.join(file);
            if path.is_file() {
                let why = if why.is_empty() { String::new() } else { format!(": {why}") };
                pictures.push((format!("{}, {what}{why}", record.chooser), read_png_color(&path)?));
            }
        }
    }
    Ok(Some(Reported { plan, execution, pictures }))
}
