//! `sms-experiments scan`: time, memory and quality of scans on fixed scenes with exact truth.

use super::gpu;
use super::shared::{finish, parse_shard, read_baseline, settings, with_settings};
use anyhow::Context as _;
use clap::Args;
use serde_json::json;
use sms_cli::front::{Console, PosesName, PresetName};
use sms_core::metrics::Metrics;
use sms_core::{InputError, StageContext, Warnings};
use sms_experiments::{
    BenchOptions, BenchScene, Disturbance, FRAMES, HOLDOUT, Shard, add_means, export_scene, locate,
    parse_length_m, parse_pose_noise, part_of, prepare, run_scene, select_scenes, table,
};
use sms_pipeline::Device;
use sms_poses::{PosesConfig, PosesMode};
use std::path::{Path, PathBuf};
use std::process::Stdio;

#[derive(Debug, Args, Clone)]
pub(crate) struct ScanStudyArguments {
    /// Preset of the scans.
    #[arg(long, value_enum, default_value = "standard")]
    pub preset: PresetName,
    /// `all` (ten seeds and the real recordings), `real`, a number of seeds, or ids such as 1003,seq_tabletop_bin.
    #[arg(long, value_name = "N|IDS", default_value = "all")]
    pub scenes: String,
    /// Other seeds of the billiards family, in place of the fixed ones.
    #[arg(long, value_name = "SEEDS", value_delimiter = ',')]
    pub seed_list: Vec<u64>,
    /// Only every n-th scene, from the i-th (i/n, from 1); for `sms-experiments merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// Recorded frames per generated scene.
    #[arg(long, value_name = "N", default_value_t = FRAMES)]
    pub frames: usize,
    /// Disturb every pose: root mean square shift and turn, such as 10mm,0.5deg.
    #[arg(long, value_name = "LENGTH,ANGLE")]
    pub pose_noise: Option<String>,
    /// Add white depth noise of this standard deviation at 1 m, such as 2mm (it grows with the square of depth).
    #[arg(long, value_name = "LENGTH")]
    pub depth_noise: Option<String>,
    /// Share of depth pixels removed at random.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pub missing: f64,
    /// Shift of colour against depth, pixels of the loaded frames.
    #[arg(long, value_name = "PX", default_value_t = 0, allow_hyphen_values = true)]
    pub color_shift_px: i64,
    /// Camera poses of masks and scan; `given` without this option, as generated poses are exact.
    #[arg(long, value_enum, value_name = "MODE")]
    pub poses: Option<PosesName>,
    /// Device of the scan; `auto` here means the CPU, so that figures stay comparable.
    #[arg(long, value_name = "cpu|gpu[:N]", default_value = "auto")]
    pub device: Device,
    /// Measure a map that grows frame by frame (`sms scan --follow`), too.
    #[arg(long)]
    pub follow: bool,
    /// Skip meshes.
    #[arg(long)]
    pub no_meshes: bool,
    /// Measure time and memory only.
    #[arg(long)]
    pub no_quality: bool,
    /// Folder for results.json and, for each scene, scene.ply, metrics.json, objects.json and panel.png.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// results.json (or the output of --json) of an earlier run, to print ratios to.
    #[arg(long, value_name = "FILE")]
    pub compare: Option<PathBuf>,
    /// Folder of rendered recordings.
    #[arg(long, value_name = "DIR", default_value = "runs/bench-recordings")]
    pub cache: PathBuf,
    /// Scan nothing; write for each scene the input of other programs (frames, masks, poses, and the truth apart) to DIR.
    #[arg(long, value_name = "DIR")]
    pub export: Option<PathBuf>,
    /// One scene in this process, results to the folder given with --out.
    #[arg(long, hide = true, value_name = "ID")]
    pub child: Option<String>,
    #[arg(long, hide = true, value_name = "DIR", requires = "child")]
    pub child_dir: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &ScanStudyArguments) -> anyhow::Result<()> {
    let options = options(console, a)?;
    if let (Some(id), Some(dir)) = (&a.child, &a.child_dir) {
        return run_child(console, &id.parse()?, &options, a.device, dir);
    }
    let baseline = a.compare.as_deref().map(read_baseline).transpose()?;
    let scenes = if a.seed_list.is_empty() {
        select_scenes(&a.scenes)?
    } else {
        a.seed_list.iter().map(|&seed| BenchScene::Billiards(seed)).collect()
    };
    let part = a.shard.as_deref().map(parse_shard).transpose()?;
    let mut present = Vec::new();
    for scene in part_of(scenes, part.unwrap_or((1, 1))) {
        if matches!(scene, BenchScene::Real(_)) && options.disturbance.disturbs_poses() {
            eprintln!("skipped {scene}: a real recording has no true poses to align a result to");
        } else if is_absent(&scene) {
            let dir = sms_experiments::real_data_dir();
            eprintln!("skipped {scene}: no recording of this name in {} (SMS_TEST_DATA)", dir.display());
        } else {
            present.push(scene);
        }
    }
    // A part may consist of missing scenes; the other parts are still valid.
    if present.is_empty() && part.is_none() {
        return Err(InputError::new(
            "none of these scenes is present",
            "--scenes",
            "give seeds, or set SMS_TEST_DATA to the folder of the real recordings",
        )
        .into());
    }
    if let Some(dir) = &a.export {
        return export(console, &present, &options, dir);
    }
    let aside = std::env::temp_dir().join(format!("sms-experiments-{}", std::process::id()));
    let out = a.out.as_ref().unwrap_or(&aside);
    let measured = run_children(console, &present, &options, out);
    if a.out.is_none() {
        // Best effort: the results are printed.
        let _ = std::fs::remove_dir_all(&aside);
    }
    let metrics = measured?;
    if let Some(part) = part {
        part_of_scans(part, &options, &present, &metrics).save_in(out)?;
    }
    let results = a.out.as_ref().map(|out| out.join("results.json"));
    show_scans(console, metrics, &present, options.preset_name(), baseline.as_ref(), results.as_ref())
}

/// Figures and table of the scenes that were measured, with their means.
fn show_scans(
    console: &Console,
    mut metrics: Metrics,
    scenes: &[BenchScene],
    preset: &str,
    baseline: Option<&Metrics>,
    out: Option<&PathBuf>,
) -> anyhow::Result<()> {
    add_means(&mut metrics, scenes);
    metrics.set("bench.scan.preset", preset);
    finish(console, &metrics, out, table(&metrics, scenes, preset, baseline).trim_end())
}

/// The shard of a part's figures.
fn part_of_scans(
    part: (usize, usize),
    options: &BenchOptions,
    scenes: &[BenchScene],
    metrics: &Metrics,
) -> Shard {
    let mut settings = settings(options.settings());
    settings.insert("poses".to_owned(), json!(options.poses));
    settings.insert("disturbance".to_owned(), json!(options.disturbance));
    settings.insert("measured".to_owned(), json!([options.meshes, options.quality]));
    let mut shard = Shard::new("scan", part, settings);
    for scene in scenes {
        let mut own = Metrics::new();
        let prefix = format!("bench.scan.{scene}.");
        metrics.iter().filter(|(key, _)| key.starts_with(&prefix)).for_each(|(key, value)| {
            own.set(key.clone(), value.clone());
        });
        shard.add(&scene.to_string(), &own);
    }
    shard
}

/// Figures and table of merged parts.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    let scenes = whole.items.keys().map(|id| id.parse()).collect::<Result<Vec<BenchScene>, _>>()?;
    let mut metrics = Metrics::new();
    whole.items.keys().for_each(|id| metrics.merge(whole.figures(id)));
    show_scans(console, metrics, &scenes, &whole.setting::<String>("preset")?, None, out)
}

/// Returns whether the data of the scene is missing.
fn is_absent(scene: &BenchScene) -> bool {
    match scene {
        BenchScene::Billiards(_)
        | BenchScene::Ten(_)
        | BenchScene::Fixed(_)
        | BenchScene::Stacked(_)
        | BenchScene::DrawnStacked(..)
        | BenchScene::Landing(_)
        | BenchScene::ScannedLanding(_) => false,
        BenchScene::Model(name) => !sms_experiments::model_path(name).is_file(),
        BenchScene::Real(name) => {
            !sms_experiments::real_data_dir().join(name).join("transforms.json").is_file()
        }
    }
}

fn export(
    console: &Console,
    scenes: &[BenchScene],
    options: &BenchOptions,
    dir: &Path,
) -> anyhow::Result<()> {
    if scenes.iter().all(|s| matches!(s, BenchScene::Real(_))) {
        return Err(InputError::new(
            "only generated scenes can be exported",
            "--scenes",
            "give seeds: real recordings have no truth to export",
        )
        .into());
    }
    for scene in scenes.iter().filter(|s| matches!(s, BenchScene::Billiards(_))) {
        let warnings = Warnings::new();
        let prepared = prepare(
            scene,
            options,
            StageContext::new(console.context.progress.as_ref(), &console.context.cancel, &warnings),
        )?;
        if let Some(prepared) = prepared {
            let to = dir.join(scene.to_string());
            export_scene(scene, &prepared, options, &to)?;
            console.say(format!("{scene} is in {}", to.display()));
        }
    }
    Ok(())
}

fn options(console: &Console, a: &ScanStudyArguments) -> anyhow::Result<BenchOptions> {
    let base = BenchOptions::new(a.preset.preset(), &a.cache);
    let mut disturbance =
        Disturbance { missing: a.missing, color_shift_px: a.color_shift_px, ..Disturbance::default() };
    if !(0.0..1.0).contains(&a.missing) {
        return Err(
            InputError::new("the share of pixels is out of range", "--missing", "give 0 to below 1").into()
        );
    }
    if let Some(text) = &a.pose_noise {
        (disturbance.pose_shift_m, disturbance.pose_turn_rad) = parse_pose_noise(text)?;
    }
    if let Some(text) = &a.depth_noise {
        disturbance.depth_noise_m = parse_length_m(text, "--depth-noise")?;
    }
    if a.frames < HOLDOUT {
        let cure = format!("record at least {HOLDOUT} frames");
        return Err(InputError::new("no frame would be held out", "--frames", cure).into());
    }
    let base = with_settings(console, base)?;
    let mut poses = console.context.settings.section("poses", PosesConfig::default())?;
    poses.mode = a.poses.map_or(PosesMode::Given, PosesName::mode);
    Ok(BenchOptions {
        poses,
        frames: a.frames,
        disturbance,
        follow: a.follow,
        meshes: !a.no_meshes,
        quality: !a.no_quality,
        ..base
    })
}

/// Runs each scene in its own process, so that peak memory and CPU time are those of the scene.
fn run_children(
    console: &Console,
    scenes: &[BenchScene],
    options: &BenchOptions,
    out: &Path,
) -> anyhow::Result<Metrics> {
    let program = std::env::current_exe().context("cannot find this program")?;
    let mut metrics = Metrics::new();
    for (i, scene) in scenes.iter().enumerate() {
        console.context.cancel.check()?;
        if !console.json {
            eprintln!("{scene} ({} of {})", i + 1, scenes.len());
        }
        // Here, so that the scan's process does not account for rendering.
        locate(scene, options, console.context.progress.as_ref(), &console.context.cancel)?;
        let dir = out.join(scene.to_string());
        let status = std::process::Command::new(&program)
            .args(std::env::args_os().skip(1))
            .args(["--child", &scene.to_string(), "--child-dir"])
            .arg(&dir)
            .stdout(Stdio::null())
            .status()
            .with_context(|| format!("cannot run {}", program.display()))?;
        console.context.cancel.check()?;
        if !status.success() {
            anyhow::bail!("{scene} was not measured ({status})");
        }
        metrics.merge(Metrics::load(&dir.join("metrics.json"))?);
    }
    Ok(metrics)
}

fn run_child(
    console: &Console,
    scene: &BenchScene,
    options: &BenchOptions,
    device: Device,
    dir: &Path,
) -> anyhow::Result<()> {
    let warnings = Warnings::new();
    match device {
        Device::Auto | Device::Cpu => {
            run_scene(
                scene,
                options,
                dir,
                StageContext::new(console.context.progress.as_ref(), &console.context.cancel, &warnings),
            )?;
        }
        Device::Gpu(index) => gpu::run(console, scene, options, index, dir, &warnings)?,
    }
    for w in warnings.snapshot() {
        eprintln!("warning: {scene}: {}", w.message);
    }
    Ok(())
}
