//! `sms demo`: the whole flow on a generated scene.

use super::{
    evaluate, execute, landing, length_text, materialize, plan, report, sample, scan, shown, simulate,
};
use crate::cli::{self, Demo, DemoName};
use sms_cli::front::Console;
use sms_cli::front::PresetName;
use sms_core::metrics::Metrics;
use sms_core::{InputError, Seed};
use sms_landing::LandingSettings;
use sms_plan::PlanConfig;
use sms_synth::{
    BilliardsSettings, HelicalPath, RecordingSettings, SceneViews, generate_billiards, landing_scene,
    record_views,
};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The design keeps every eighth frame out of training in demos, so that quality is measured on unseen views.
const HOLDOUT: usize = 8;

pub(crate) fn run(console: &Console, a: &Demo) -> anyhow::Result<()> {
    if a.name == DemoName::Landing {
        return run_landing(console, a);
    }
    let began = Instant::now();
    let (root, recording) = folders(a, "billiards")?;
    console.say(format!("billiards, seed {}: recording a generated scene …", a.seed));
    let truth = generate_billiards(Seed(a.seed), &BilliardsSettings::default());
    let settings = if a.quick { RecordingSettings::quick() } else { RecordingSettings::default() };
    sample::write(console, &truth, &RecordingSettings { seed: Seed(a.seed), ..settings }, &recording)?;

    scan_and_materialize(console, a, &root, &recording, 1.0)?;
    let task = sample::task_of(&truth);
    let plan_arguments = plan_arguments(&root, &recording);
    let base = if a.quick { PlanConfig::draft() } else { PlanConfig::default() };
    plan::run_with(console, &plan_arguments, &task, &console.context.settings.section("plan", base)?)?;
    execute::run(console, &cli::Execute { run: root.clone(), engine: None, arm: cli::ArmName::Shared })?;
    evaluate::run(console, &cli::Evaluate { run: root.clone(), objects: None })?;
    let page = report::run(console, &cli::Report { run: root.clone() })?;

    let m = Metrics::load(&root.join("metrics.json"))?;
    let length = |key: &str| m.number(key).map_or_else(|| "?".to_owned(), length_text);
    console.say("");
    console.say(format!("predicted: {} from the goal", length("plan.objective")));
    console.say(format!("realised:  {} from the goal", length("execute.objective")));
    say_end(console, &root, &page, began);
    if console.json {
        console.print_json(&m)?;
    }
    Ok(())
}

/// Where the run and its recording lie; refused where something else lies there.
fn folders(a: &Demo, name: &str) -> anyhow::Result<(PathBuf, PathBuf)> {
    let root = a.out.clone().unwrap_or_else(|| {
        PathBuf::from("runs").join(format!("{name}-{}{}", a.seed, if a.quick { "-quick" } else { "" }))
    });
    let recording = root.join("recording");
    let occupied = root.read_dir().is_ok_and(|mut entries| entries.next().is_some());
    if occupied && !recording.exists() {
        let what = "this folder holds something else";
        return Err(InputError::new(what, &root, "name a new folder with --out").into());
    }
    Ok((root, recording))
}

fn scan_and_materialize(
    console: &Console,
    a: &Demo,
    root: &Path,
    recording: &Path,
    rest_s: f64,
) -> anyhow::Result<()> {
    let scan_arguments = cli::Scan {
        recording: recording.to_owned(),
        out: root.to_owned(),
        // 200 pixels do not tell what stands on a ladder from the ladder.
        preset: a.preset.or((a.quick && a.name == DemoName::Billiards).then_some(PresetName::Draft)),
        masks: a.masks,
        nets: cli::NetsArguments::default(),
        holdout: Some(HOLDOUT),
        seed: Some(a.seed),
        up: None,
        refine_poses: None,
        no_check: false,
        device: sms_cli::front::Device::Auto,
        live: a.live.clone(),
    };
    drop(scan::run(console, &scan_arguments)?);
    let run = root.to_owned();
    materialize::run(console, &cli::Materialize { run, materials: None, vlm: cli::VlmMode::default() })?;
    simulate::run(console, &cli::Simulate { run: root.to_owned(), seconds: rest_s })
}

fn plan_arguments(root: &Path, recording: &Path) -> cli::Plan {
    let task = recording.join("task.toml");
    cli::Plan { run: root.to_owned(), task, seed: None, robust: None, chooser: cli::ChooserName::Ours }
}

fn say_end(console: &Console, root: &Path, page: &Path, began: Instant) {
    console.say(format!("report:    {}", shown(page)));
    console.say(format!(
        "           ({:.0} s in all; `sms view {}` opens it)",
        began.elapsed().as_secs_f64(),
        shown(root)
    ));
}

/// The landing: a structure filmed from a helix, and a flight whose straight way would lead over its overhang.
fn run_landing(console: &Console, a: &Demo) -> anyhow::Result<()> {
    let began = Instant::now();
    let (root, recording) = folders(a, "landing")?;
    let truth = landing_scene(a.seed);
    console.say(format!("{}: recording a generated scene …", truth.name));
    let base = if a.quick { RecordingSettings::quick() } else { RecordingSettings::default() };
    let settings = RecordingSettings { seed: Seed(a.seed), ..base };
    let poses = HelicalPath::default().poses(&truth, settings.frames);
    let (progress, cancel) = (console.context.progress.as_ref(), &console.context.cancel);
    let views = SceneViews { scene: &truth, skins: &[], poses: &poses, source: "0" };
    record_views(&views, &settings, &recording, progress, cancel)?;
    sample::write_beside(&truth, &recording)?;
    scan_and_materialize(console, a, &root, &recording, 2.0)?;
    let config = if a.quick { LandingSettings::draft() } else { LandingSettings::default() };
    landing::plan(console, &plan_arguments(&root, &recording), config)?;
    execute::run(console, &cli::Execute { run: root.clone(), engine: None, arm: cli::ArmName::Shared })?;
    evaluate::run(console, &cli::Evaluate { run: root.clone(), objects: None })?;
    let page = report::run(console, &cli::Report { run: root.clone() })?;
    console.say("");
    say_end(console, &root, &page, began);
    if console.json {
        console.print_json(&Metrics::load(&root.join("metrics.json"))?)?;
    }
    Ok(())
}
