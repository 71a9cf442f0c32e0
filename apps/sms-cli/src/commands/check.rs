//! `sms check`: checks the consistency of a recording, and estimates the errors of its sensor.

use crate::cli::CheckArguments;
use sms_cli::front::Console;
use sms_core::{Seed, Warnings};
use sms_frames::{CheckReport, LoadSettings, ReadOptions, Recording, check};
use sms_pipeline::stages::{SensorErrors, sensor};
use sms_poses::PosesConfig;
use std::process::ExitCode;

pub(crate) fn run(console: &Console, a: &CheckArguments) -> anyhow::Result<ExitCode> {
    let settings = &console.context.settings;
    let options = settings.section("read", ReadOptions::default())?;
    let load = settings.section("frames", LoadSettings::default())?;
    let poses = settings.section("poses", PosesConfig::default())?;
    load.validate()?;
    poses.validate()?;
    let recording = Recording::open(&a.recording, &options)?;
    let report = check(&recording, console.context.progress.as_ref(), &console.context.cancel)?;
    // The frames of a faulty recording do not fit together.
    let sensor = report.approved().then(|| {
        let warnings = Warnings::new();
        sensor(&recording, &load, &poses, console.context.stage(&warnings, Seed(0)))
    });
    console.context.cancel.check()?;
    if console.json {
        let mut metrics = report.metrics();
        if let Some(Ok(sensor)) = &sensor {
            metrics.merge(sensor.report.sensor_metrics());
        }
        metrics.set("check.approved", report.approved());
        metrics.set("check.findings", serde_json::to_value(&report.findings)?);
        console.print_json(&metrics)?;
    } else {
        console.say(report.to_string());
        match &sensor {
            Some(Ok(sensor)) => {
                for line in sensor_lines(sensor, &report) {
                    console.say(format!("  {line}"));
                }
            }
            Some(Err(error)) => console.say(format!("  errors of the sensor: not measurable ({error})")),
            None => {}
        }
    }
    // Exit code 2 means that the recording cannot be read; a fault in its content gives 1.
    Ok(if report.approved() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

fn sensor_lines(sensor: &SensorErrors, report: &CheckReport) -> Vec<String> {
    let [_, middle, far] = report.depth_range_m;
    let lines = sensor.report.sensor_lines([middle, far], sensor.pixel_scale);
    if lines.is_empty() {
        return vec!["errors of the sensor: not measurable, as too few frames overlap".to_owned()];
    }
    lines
}
