//! `sms demo`: runs all stages on a generated scene.

use super::{evaluate, execute, materialize, plan, report, scan, simulate};
use crate::cli::{self, DemoArguments, DemoName};
use sms_cli::front::{Console, PresetName};
use sms_core::metrics::Metrics;
use sms_core::{InputError, Seed, lengths_text, shell_argument};
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
    let usual = if a.quick { RecordingSettings::quick() } else { RecordingSettings::default() };
    let sensor = a.sensor.sensor();
    let base = if a.quick { sensor.recording_at(usual.width) } else { sensor.recording() };
    let base = RecordingSettings { frames: usual.frames, ..base };
    let settings = console.context.settings.section("recording", base)?;
    record(console, a, &RecordingSettings { seed: Seed(a.seed), ..settings }, &recording)?;
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
    if let Some(line) = comparison(&m).filter(|_| a.name == DemoName::Billiards) {
        console.say(format!("result:    {line}"));
    }
    console.say(format!("report:    {}", page.display()));
    console.say(format!(
        "           ({:.0} s in total; `sms view {}` opens it)",
        began.elapsed().as_secs_f64(),
        shell_argument(&root)
    ));
    if console.json {
        console.print_json(&m)?;
    }
    Ok(())
}

/// Compares the realised distance from the goal with its prediction, which is for perturbed worlds if there are any.
fn comparison(m: &Metrics) -> Option<String> {
    let realised = m.number("execute.objective")?;
    let predicted = ["execute.predicted_mean", "execute.predicted_q90"].map(|key| m.number(key));
    if let [Some(mean), Some(q90)] = predicted {
        let [mean, q90, realised] = lengths_text([mean, q90, realised]);
        return Some(format!(
            "predicted {mean} from the goal on average, within {q90} in 90 % of worlds; realised {realised}"
        ));
    }
    let [predicted, realised] = lengths_text([m.number("plan.objective")?, realised]);
    Some(format!("predicted {predicted} from the goal in the scanned world; realised {realised}"))
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
        poses: cli::PosesArguments::default(),
        device: sms_pipeline::Device::Auto,
        follow: None,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_realised_distance_is_compared_with_the_predicted_mean_in_one_unit() {
        let mut m = Metrics::new();
        assert_eq!(comparison(&m), None);
        m.set("plan.objective", 0.00473).set("execute.objective", 0.0105);
        let line = comparison(&m).unwrap();
        assert!(line.contains("0.47 cm") && line.contains("1.05 cm"), "{line}");
        m.set("execute.predicted_mean", 0.0081).set("execute.predicted_q90", 0.016);
        let line = comparison(&m).unwrap();
        assert!(["0.81 cm", "1.60 cm", "1.05 cm"].iter().all(|length| line.contains(length)), "{line}");
        assert!(!line.contains("mm") && !line.contains("0.47"), "the scanned world is one of many: {line}");
    }
}
