//! `sms demo`: runs all stages on a generated scene.

use super::{evaluate, execute, materialize, plan, report, scan, simulate};
use crate::cli::{self, DemoArguments, DemoName};
use sms_cli::front::{Console, PresetName};
use sms_core::{InputError, Seed, length_text};
use sms_pipeline::{PlanRequest, Run, write_task_files};
use sms_synth::{
    BilliardsSettings, HelicalPath, RecordingSettings, SceneViews, generate_billiards, landing_scene,
    record_views, write_recording,
};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Interval of the held-out frames, on which quality is measured.
const HOLDOUT: usize = 8;

pub(crate) fn run(console: &Console, a: &DemoArguments) -> anyhow::Result<()> {
    let began = Instant::now();
    let name = if a.name == DemoName::Landing { "landing" } else { "billiards" };
    let (root, recording) = folders(a, name)?;
    let base = if a.quick { RecordingSettings::quick() } else { RecordingSettings::default() };
    record(console, a, &RecordingSettings { seed: Seed(a.seed), ..base }, &recording)?;
    reconstruct(console, a, &root, &recording)?;

    let run = Run::new(&root, &console.context);
    let request = PlanRequest { draft: a.quick, ..PlanRequest::new(recording.join("task.toml")) };
    plan::show(console, &run.plan(&request)?);
    execute::run(
        console,
        &cli::ExecuteArguments { run: root.clone(), engine: None, arm: cli::ArmName::Shared },
    )?;
    evaluate::run(console, &cli::EvaluateArguments { run: root.clone(), objects: None })?;
    let page = report::run(console, &cli::ReportArguments { run: root.clone() })?;

    let m = run.metrics()?;
    console.say("");
    if a.name == DemoName::Billiards {
        let length = |key: &str| m.number(key).map_or_else(|| "?".to_owned(), length_text);
        console.say(format!("predicted: {} from the goal", length("plan.objective")));
        console.say(format!("realised:  {} from the goal", length("execute.objective")));
    }
    console.say(format!("report:    {}", page.display()));
    console.say(format!(
        "           ({:.0} s in total; `sms view {}` opens it)",
        began.elapsed().as_secs_f64(),
        root.display()
    ));
    if console.json {
        console.print_json(&m)?;
    }
    Ok(())
}

/// Records the scene: billiards from above, or a structure from a helix, with a straight flight across its overhang.
fn record(
    console: &Console,
    a: &DemoArguments,
    settings: &RecordingSettings,
    folder: &Path,
) -> anyhow::Result<()> {
    let (progress, cancel) = (console.context.progress.as_ref(), &console.context.cancel);
    let truth = match a.name {
        DemoName::Billiards => generate_billiards(Seed(a.seed), &BilliardsSettings::default()),
        DemoName::Landing => landing_scene(a.seed),
    };
    match a.name {
        DemoName::Billiards => {
            console.say(format!("billiards, seed {}: recording a generated scene …", a.seed));
            write_recording(&truth, settings, folder, progress, cancel)?;
        }
        DemoName::Landing => {
            console.say(format!("{}: recording a generated scene …", truth.name));
            let poses = HelicalPath::default().poses(&truth, settings.frames);
            let views = SceneViews { scene: &truth, skins: &[], poses: &poses, source: "0" };
            record_views(&views, settings, folder, progress, cancel)?;
        }
    }
    Ok(write_task_files(&truth, folder)?)
}

/// Returns the folders of the run and its recording; refuses a folder with other content.
fn folders(a: &DemoArguments, name: &str) -> anyhow::Result<(PathBuf, PathBuf)> {
    let root = a.out.clone().unwrap_or_else(|| {
        PathBuf::from("runs").join(format!("{name}-{}{}", a.seed, if a.quick { "-quick" } else { "" }))
    });
    let recording = root.join("recording");
    let occupied = root.read_dir().is_ok_and(|mut entries| entries.next().is_some());
    if occupied && !recording.exists() {
        let what = "this folder has other content";
        return Err(InputError::new(what, &root, "name a new folder with --out").into());
    }
    Ok((root, recording))
}

/// Scans, materializes, and simulates the scene at rest: two seconds for a structure, which may fall slowly.
fn reconstruct(console: &Console, a: &DemoArguments, root: &Path, recording: &Path) -> anyhow::Result<()> {
    let is_billiards = a.name == DemoName::Billiards;
    let arguments = cli::ScanArguments {
        recording: recording.to_owned(),
        out: root.to_owned(),
        // At 200 pixels, an object on a ladder merges with the ladder.
        preset: a.preset.or((a.quick && is_billiards).then_some(PresetName::Draft)),
        masks: a.masks,
        nets: cli::NetsArguments::default(),
        holdout: Some(HOLDOUT),
        seed: Some(a.seed),
        up: None,
        refine_poses: None,
        no_check: false,
        device: sms_pipeline::Device::Auto,
        live: a.live.clone(),
    };
    scan::run(console, &arguments)?;
    let run = root.to_owned();
    materialize::run(
        console,
        &cli::MaterializeArguments { run, materials: None, vlm: cli::VlmName::default() },
    )?;
    let seconds = if is_billiards { 1.0 } else { 2.0 };
    simulate::run(console, &cli::SimulateArguments { run: root.to_owned(), seconds })
}
