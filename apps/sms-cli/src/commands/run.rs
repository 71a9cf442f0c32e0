//! `sms run`: all stages on a recording, with one summary at the end.

use super::{evaluate, execute, materialize, plan, report, scan, simulate};
use crate::cli::{self, RunArguments};
use sms_cli::front::{Console, note};
use sms_core::metrics::Metrics;
use sms_core::{DepthAgreement, InputError, counted, duration_text, length_text};
use sms_pipeline::{PlanRequest, Run, StageCondition};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Simulated time of the check at rest, seconds.
const REST_S: f64 = 1.0;

pub(crate) fn run(console: &Console, a: &RunArguments) -> anyhow::Result<()> {
    let began = Instant::now();
    let root = match &a.out {
        Some(out) => out.clone(),
        None => own_folder(console, &a.recording)?,
    };
    let page = match stages(console, a, &root) {
        Ok(page) => page,
        Err(error) => {
            if !console.json && has_result(&Run::new(&root, &console.context)) {
                note(format_args!(
                    "finished stages are in {}; the same command goes on from there",
                    root.display()
                ));
            }
            return Err(error);
        }
    };
    let run = Run::new(&root, &console.context);
    let metrics = run.metrics()?;
    console.say("");
    summary(&metrics).iter().for_each(|(part, text)| console.say(format!("{part:>10}  {text}")));
    console.say(format!("{:>10}  {}", "report", page.display()));
    console.say(format!("{:>10}  {}", "time", duration_text(began.elapsed().as_secs_f64())));
    console.say(format!("next: {}", run.status()?.next.join("\n      ")));
    if console.json {
        console.print_json(&metrics)?;
    }
    Ok(())
}

/// Returns whether a stage of the run is finished.
fn has_result(run: &Run<'_>) -> bool {
    run.status().is_ok_and(|s| s.stages.iter().any(|stage| stage.condition != StageCondition::Absent))
}

/// Runs the stages; returns the report page.
fn stages(console: &Console, a: &RunArguments, root: &Path) -> anyhow::Result<PathBuf> {
    let arguments = cli::ScanArguments {
        recording: a.recording.clone(),
        out: root.to_owned(),
        preset: a.preset,
        masks: a.masks,
        nets: cli::NetsArguments { objects: a.objects.clone(), ..cli::NetsArguments::default() },
        poses: a.poses.clone(),
        holdout: a.holdout,
        device: a.device,
        seed: a.seed,
        follow: None,
        live: None,
    };
    scan::run(console, &arguments)?;
    let (run, materials) = (root.to_owned(), a.materials.clone());
    let arguments = cli::MaterializeArguments { run, materials, vlm: cli::VlmName::default() };
    materialize::run(console, &arguments)?;
    evaluate::say_agreement(console, &Run::new(root, &console.context).compare_depth()?);
    simulate::run(console, &cli::SimulateArguments { run: root.to_owned(), seconds: REST_S })?;
    if let Some(task) = &a.task {
        let run = Run::new(root, &console.context);
        plan::show(console, &run.plan(&PlanRequest::new(task))?);
        if run.has_truth() {
            let run = root.to_owned();
            let arguments = cli::ExecuteArguments { run, engine: None, arm: cli::ArmName::Shared };
            execute::run(console, &arguments)?;
        }
    }
    report::run(console, &cli::ReportArguments { run: root.to_owned() })
}

/// Returns the folder `runs/NAME` of a recording; refuses that of another recording with the same name.
fn own_folder(console: &Console, recording: &Path) -> anyhow::Result<PathBuf> {
    let absolute = std::path::absolute(recording).unwrap_or_else(|_| recording.to_owned());
    let name = absolute.file_name().map_or_else(|| "scene".into(), ToOwned::to_owned);
    let root = PathBuf::from("runs").join(name);
    let other = Run::new(&root, &console.context).status().ok().and_then(|s| s.recording);
    // The recording may be given by another spelling of its path.
    let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    if let Some(other) = other.filter(|other| whole(other) != whole(&absolute)) {
        let what = format!("this folder has a run of another recording, {}", other.display());
        return Err(InputError::new(what, &root, "name another folder with --out").into());
    }
    Ok(root)
}

/// Returns one line for each part of the run, from its metrics.
fn summary(m: &Metrics) -> Vec<(&'static str, String)> {
    let mut lines = Vec::new();
    let length = |key: &str| m.number(key).map(length_text);
    let count = |key: &str, one: &str, more: &str| counted(m.number(key).unwrap_or(0.0) as usize, one, more);
    let frames = count("scan.frames", "frame", "frames");
    let mut scan = format!("{frames}, {} in the masks", count("masks.objects", "object", "objects"));
    if let Some(psnr) = m.number("scan.holdout_psnr_db") {
        scan += &format!(", {psnr:.1} dB on held-out views");
    }
    lines.push(("scan", scan));
    let mut scene = match m.number("simulate.moving_bodies").zip(m.number("simulate.fixed_bodies")) {
        Some((moving, fixed)) if fixed > 0.0 => {
            format!("{moving} moving and {}", count("simulate.fixed_bodies", "fixed body", "fixed bodies"))
        }
        _ => count("simulate.moving_bodies", "moving body", "moving bodies"),
    };
    if let Some(drift) = length("simulate.drift_m") {
        let seconds = m.number("simulate.seconds_simulated").unwrap_or(0.0);
        scene += &format!("; at rest for {seconds} s, they move at most {drift}");
    }
    lines.push(("scene", scene));
    if let Some(agreement) = DepthAgreement::of_run(m) {
        let (percent, judged) = (100.0 * agreement.agrees, agreement.judge());
        let of = if agreement.held_out { "that of held-out views" } else { "the recorded depth" };
        lines.push(("depth", format!("{percent:.1} % of {of} lies on the scene: {judged}")));
    }
    let is = |key: &str| m.get(key).and_then(serde_json::Value::as_bool);
    let is_stale = |stage: &str| m.get(&format!("stale.{stage}")).is_some();
    let share = m.number("plan.predicted_success_share").or_else(|| m.number("plan.success_share"));
    let predicted = length("plan.predicted_mean").or_else(|| length("plan.objective"));
    if let Some(predicted) = predicted.filter(|_| !is_stale("plan")) {
        let success =
            share.map_or_else(String::new, |s| format!("; success in {:.0} % of worlds", 100.0 * s));
        lines.push(("plan", format!("{predicted} predicted{success}")));
    }
    if let Some(success) = is("execute.success").filter(|_| !is_stale("target")) {
        let realised = length("execute.objective").map_or_else(String::new, |o| format!("{o} realised; "));
        lines.push(("execution", format!("{realised}{}", if success { "success" } else { "missed" })));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_has_the_parts_that_were_run_and_none_that_are_stale() {
        let mut m = Metrics::new();
        m.set("scan.frames", 60)
            .set("masks.objects", 5)
            .set("simulate.moving_bodies", 6)
            .set("simulate.fixed_bodies", 0)
            .set("simulate.drift_m", 3e-5);
        let parts = |m: &Metrics| summary(m).iter().map(|line| line.0).collect::<Vec<_>>();
        assert_eq!(parts(&m), ["scan", "scene"]);
        assert!(summary(&m)[1].1.starts_with("6 moving bodies; "));
        m.set("simulate.fixed_bodies", 11);
        assert!(summary(&m)[1].1.starts_with("6 moving and 11 fixed bodies; "));
        m.set("evaluate.depth_agrees", 0.99).set("evaluate.depth_false_surface", 0.001);
        assert_eq!(parts(&m), ["scan", "scene", "depth"]);
        assert!(summary(&m)[2].1.contains("99.0 %"));
        m.set("evaluate.holdout_depth_agrees", 0.7).set("evaluate.holdout_depth_false_surface", 0.001);
        assert!(summary(&m)[2].1.contains("70.0 %"));
        m.set("plan.predicted_mean", 0.0056).set("execute.objective", 0.0068).set("execute.success", true);
        assert_eq!(parts(&m), ["scan", "scene", "depth", "plan", "execution"]);
        assert!(summary(&m)[4].1.contains("6.80 mm"));
        m.set("stale.plan", "`scene` has another result now").set("stale.target", "");
        assert_eq!(parts(&m), ["scan", "scene", "depth"]);
    }
}
