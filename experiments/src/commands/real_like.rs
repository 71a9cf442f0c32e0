//! `sms-experiments real-like`: recordings with the errors of real sensors.

use super::gpu;
use super::shared::{finish, parse_seeds, with_settings};
use clap::Args;
use sms_cli::front::{Console, PresetName};
use sms_core::{InputError, StageContext, Warnings, atomic};
use sms_experiments::{
    BenchOptions, FRAMES, HOLDOUT, MaskChoice, MaterializeOptions, RealLikeRow, real_like_metrics,
    real_like_scenes, real_like_table, run_real_like,
};
use sms_pipeline::Device;
use sms_poses::PosesConfig;
use sms_synth::Sensor;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct RealLikeArguments {
    /// Seeds of the scenes: 2001..2004, or 1,2,5. Each gives a billiards scene and a stack; those of even seeds count as held out.
    #[arg(long, value_name = "SEEDS", default_value = "2001..2004")]
    pub seeds: String,
    /// Only these sensors: gemini2, d435, azure_kinect, xtion, phone_lidar.
    #[arg(long, value_name = "SENSORS", value_delimiter = ',')]
    pub sensors: Vec<String>,
    /// Preset of the scans.
    #[arg(long, value_enum, default_value = "standard")]
    pub preset: PresetName,
    /// Smaller recordings (24 frames, 640 pixels wide) and the preset draft.
    #[arg(long)]
    pub quick: bool,
    /// Device of the scans; `auto` here means the CPU, so that figures stay comparable.
    #[arg(long, value_name = "cpu|gpu[:N]", default_value = "auto")]
    pub device: Device,
    /// Folder of kept scans, of their recordings (recordings/) and of the meshes, a folder for each sensor.
    #[arg(long, value_name = "DIR", default_value = "runs/real-like")]
    pub keep: PathBuf,
    /// Folder for results.json and rows.json.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Measure nothing; print the table of the rows.json of earlier runs, such as of runs with some of the sensors.
    #[arg(long, value_name = "FILES", num_args = 1..)]
    pub table: Vec<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &RealLikeArguments) -> anyhow::Result<()> {
    if !a.table.is_empty() {
        let mut rows: Vec<RealLikeRow> = Vec::new();
        for path in &a.table {
            rows.extend(atomic::read_json::<Vec<RealLikeRow>>(path)?);
        }
        return show(console, a, &rows);
    }
    let sensors = sensors(&a.sensors)?;
    let scenes = real_like_scenes(&parse_seeds(&a.seeds)?);
    let mut rows = Vec::new();
    for &sensor in &sensors {
        let options = options(console, a, sensor)?;
        for (i, scene) in scenes.iter().enumerate() {
            if !console.json {
                eprintln!("{} {scene} ({} of {})", sensor.as_str(), i + 1, scenes.len());
            }
            let warnings = Warnings::new();
            let (progress, cancel) = (console.context.progress.as_ref(), &console.context.cancel);
            let context = StageContext::new(progress, cancel, &warnings);
            rows.push(run_real_like(scene, &options, context)?);
            if let Some(out) = &a.out {
                // After each scene, so that an interrupted run leaves its results.
                atomic::write_json(&out.join("rows.json"), &rows)?;
            }
        }
    }
    show(console, a, &rows)
}

fn show(console: &Console, a: &RealLikeArguments, rows: &[RealLikeRow]) -> anyhow::Result<()> {
    let results = a.out.as_ref().map(|out| out.join("results.json"));
    finish(console, &real_like_metrics(rows), results.as_ref(), real_like_table(rows).trim_end())
}

fn sensors(names: &[String]) -> Result<Vec<Sensor>, InputError> {
    if names.is_empty() {
        return Ok(Sensor::ALL.to_vec());
    }
    let find = |name: &String| {
        Sensor::named(name).ok_or_else(|| {
            let known: Vec<&str> = Sensor::ALL.into_iter().map(Sensor::as_str).collect();
            let cure = format!("use: {}", known.join(", "));
            InputError::new(format!("no sensor is called `{name}`"), "--sensors", cure)
        })
    };
    names.iter().map(find).collect()
}

fn options(console: &Console, a: &RealLikeArguments, sensor: Sensor) -> anyhow::Result<MaterializeOptions> {
    let preset = if a.quick { PresetName::Draft } else { a.preset };
    let keep = a.keep.join(sensor.as_str());
    let base = BenchOptions::new(preset.preset(), keep.join("recordings"));
    let (frames, width) = if a.quick { (3 * HOLDOUT, 640) } else { (FRAMES, 0) };
    let base = with_settings(console, base)?;
    // As `sms scan`, which refines poses where that helps.
    let poses = console.context.settings.section("poses", PosesConfig::default())?;
    Ok(MaterializeOptions {
        bench: BenchOptions { frames, width, sensor, poses, ..base },
        masks: MaskChoice::Geometry,
        keep,
        rescan: false,
        trainer: gpu::trainer_maker(a.device)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensors_are_named() {
        assert_eq!(sensors(&[]).unwrap(), Sensor::ALL);
        assert_eq!(sensors(&["xtion".to_owned()]).unwrap(), [Sensor::Xtion]);
        assert!(sensors(&["sonar".to_owned()]).unwrap_err().to_string().contains("sonar"));
    }
}
