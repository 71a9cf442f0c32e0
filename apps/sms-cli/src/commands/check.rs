//! `sms check`: checks the consistency of a recording.

use crate::cli::CheckArguments;
use sms_cli::front::Console;
use sms_core::{Seed, Warnings};
use sms_frames::{LoadSettings, ReadOptions, Recording, check};
use sms_pipeline::stages::sensor;
use sms_poses::{PoseReport, PosesConfig};
use std::process::ExitCode;

pub(crate) fn run(console: &Console, a: &CheckArguments) -> anyhow::Result<ExitCode> {
    let options = console.context.settings.section("read", ReadOptions::default())?;
    let recording = Recording::open(&a.recording, &options)?;
    let progress = console.context.progress.as_ref();
    let report = check(&recording, progress, &console.context.cancel)?;
    let load = console.context.settings.section("frames", LoadSettings::default())?;
    let sensor = if report.approved() { examined(console, &recording, &load)? } else { None };
    if console.json {
        let mut metrics = report.metrics();
        if let Some(sensor) = &sensor {
            metrics.merge(sensor.metrics());
        }
        metrics.set("check.approved", report.approved());
        metrics.set("check.findings", serde_json::to_value(&report.findings)?);
        console.print_json(&metrics)?;
    } else {
        console.say(report.to_string());
        let [_, middle, far] = report.depth_range_m;
        let long_side = report.color_size.0.max(report.color_size.1);
        let loaded = if load.long_side == 0 { long_side } else { load.long_side.min(long_side) };
        let pixel_scale = long_side as f64 / loaded.max(1) as f64;
        for line in sensor.iter().flat_map(|s| s.sensor_lines([middle, far], pixel_scale)) {
            console.say(format!("  {line}"));
        }
    }
    // Exit code 2 means that the recording cannot be read; a fault in its content gives 1.
    Ok(if report.approved() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// Estimates the errors of depth, colour and poses; `None` if the frames cannot be compared. An interruption is an error.
fn examined(
    console: &Console,
    recording: &Recording,
    load: &LoadSettings,
) -> anyhow::Result<Option<PoseReport>> {
    let config = console.context.settings.section("poses", PosesConfig::default())?;
    // What keeps frames from being compared is told by the findings of the check.
    let warnings = Warnings::new();
    let found = sensor(recording, load, &config, console.context.stage(&warnings, Seed(0)));
    console.context.cancel.check()?;
    Ok(found.ok())
}
