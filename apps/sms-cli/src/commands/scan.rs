//! `sms scan`: recording → frames → masks → Gaussians.

use crate::cli::ScanArguments;
use crate::live::Watch;
use sms_cli::front::{Console, PosesName, PresetName, note};
use sms_core::{InputError, Seed, counted, judge_depth_error, judge_psnr, length_text};
use sms_pipeline::{Run, ScanOutcome, ScanRequest};
use std::time::Duration;

pub(crate) fn run(console: &Console, a: &ScanArguments) -> anyhow::Result<()> {
    let request = ScanRequest {
        preset: a.preset.unwrap_or(PresetName::Standard).preset(),
        masks: a.masks.source(&a.nets),
        poses: a.poses.poses.map(PosesName::mode),
        holdout: a.holdout,
        device: a.device,
        seed: a.seed.map(Seed),
        up: a.poses.up.as_deref().map(direction).transpose()?,
        accept_faults: a.poses.no_check,
        follow: a.follow.map(patience).transpose()?,
    };
    let mut observer = Watch::start(a.live.as_deref(), &a.recording)?;
    let run = Run::new(&a.out, &console.context);
    let outcome = run.scan_observed(&a.recording, &request, &mut observer)?;
    if let Some(problem) = observer.finish() {
        note(format_args!("warning: {problem}"));
    }
    summary(console, &run, &outcome)?;
    console.conclude(&run)
}

fn direction(values: &[f64]) -> Result<[f64; 3], InputError> {
    values.try_into().map_err(|_| {
        let what = format!("{values:?} is not a direction");
        InputError::new(what, "--up", "use three numbers that are not all zero, such as --up 0,0,1")
    })
}

fn patience(seconds: f64) -> Result<Duration, InputError> {
    Duration::try_from_secs_f64(seconds).map_err(|_| {
        InputError::new(
            format!("{seconds} s is not a time to wait"),
            "--follow",
            "give seconds, such as --follow=10",
        )
    })
}

fn summary(console: &Console, run: &Run<'_>, outcome: &ScanOutcome) -> anyhow::Result<()> {
    let m = run.metrics()?;
    let n = |key: &str| m.number(key);
    console.say(format!(
        "scan: {} Gaussians from {} frames, {}",
        n("scan.gaussians").unwrap_or(0.0),
        n("scan.frames").unwrap_or(0.0),
        counted(outcome.objects, "object", "objects")
    ));
    let (held_out, trained) = ("on held-out views", "on the views of the training");
    let figure = |name: &str| {
        let of = |views: &str| n(&format!("scan.{views}_{name}"));
        of("holdout").map(|v| (v, held_out)).or_else(|| of("train").map(|v| (v, trained)))
    };
    if let Some((db, views)) = figure("psnr_db") {
        console.say(format!("  colour {db:.1} dB {views}: {}", judge_psnr(db)));
    }
    if let Some((error, views)) = figure("depth_mae_m") {
        console.say(format!("  depth error {} {views}: {}", length_text(error), judge_depth_error(error)));
    }
    console.say(format!("  in {}", outcome.gaussians.display()));
    Ok(())
}
