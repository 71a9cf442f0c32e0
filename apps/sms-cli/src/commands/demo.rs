//! `sms demo`: the whole flow on a generated scene.

use super::{evaluate, execute, length_text, materialize, plan, report, sample, scan, shown, simulate};
use crate::cli::{self, Demo, DemoName, PresetName};
use crate::context::Context;
use sms_core::metrics::Metrics;
use sms_core::{InputError, Seed};
use sms_plan::PlanConfig;
use sms_synth::{BilliardsSettings, RecordingSettings, generate_billiards};
use std::path::PathBuf;
use std::time::Instant;

/// The design keeps every eighth frame out of training in demos, so that quality is measured on unseen views.
const HOLDOUT: usize = 8;

pub(crate) fn run(context: &Context, a: &Demo) -> anyhow::Result<()> {
    let DemoName::Billiards = a.name;
    let began = Instant::now();
    let root = a.out.clone().unwrap_or_else(|| {
        PathBuf::from("runs").join(format!("billiards-{}{}", a.seed, if a.quick { "-quick" } else { "" }))
    });
    let recording = root.join("recording");
    let occupied = root.read_dir().is_ok_and(|mut entries| entries.next().is_some());
    if occupied && !recording.exists() {
        return Err(InputError::new(
            "this folder holds something else",
            &root,
            "name a new folder with --out",
        )
        .into());
    }
    context.say(format!("billiards, seed {}: recording a generated scene …", a.seed));
    let truth = generate_billiards(Seed(a.seed), &BilliardsSettings::default());
    let settings = if a.quick { RecordingSettings::quick() } else { RecordingSettings::default() };
    sample::write(context, &truth, &RecordingSettings { seed: Seed(a.seed), ..settings }, &recording)?;

    let preset = a.preset.or(a.quick.then_some(PresetName::Draft));
    let scan_arguments = cli::Scan {
        recording: recording.clone(),
        out: root.clone(),
        preset,
        masks: a.masks,
        holdout: Some(HOLDOUT),
        seed: Some(a.seed),
        up: None,
        refine_poses: None,
        no_check: false,
        live: a.live.clone(),
    };
    drop(scan::run(context, &scan_arguments)?);
    materialize::run(
        context,
        &cli::Materialize { run: root.clone(), materials: None, vlm: cli::VlmMode::default() },
    )?;
    simulate::run(context, &cli::Simulate { run: root.clone(), seconds: 1.0 })?;
    let task = sample::task_of(&truth);
    let plan_arguments =
        cli::Plan { run: root.clone(), task: recording.join("task.toml"), seed: None, robust: None };
    let base = if a.quick { PlanConfig::draft() } else { PlanConfig::default() };
    plan::run_with(context, &plan_arguments, &task, &context.settings.section("plan", base)?)?;
    execute::run(context, &cli::Execute { run: root.clone(), engine: None, arm: cli::ArmName::Shared })?;
    evaluate::run(context, &cli::Evaluate { run: root.clone(), objects: None })?;
    let page = report::run(context, &cli::Report { run: root.clone() })?;

    let m = Metrics::load(&root.join("metrics.json"))?;
    let length = |key: &str| m.number(key).map_or_else(|| "?".to_owned(), length_text);
    context.say("");
    context.say(format!("predicted: {} from the goal", length("plan.objective")));
    context.say(format!("realised:  {} from the goal", length("execute.objective")));
    context.say(format!("report:    {}", shown(&page)));
    context.say(format!(
        "           ({:.0} s in all; `sms view {}` opens it)",
        began.elapsed().as_secs_f64(),
        shown(&root)
    ));
    if context.json {
        context.print_json(&m)?;
    }
    Ok(())
}
