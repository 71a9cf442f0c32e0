//! `sms scan`: recording → frames → masks → Gaussians.

use super::models;
use super::{inputs_hash, length_text, run_stage, shown};
use crate::cli::{MasksName, Scan};
use crate::device;
use crate::live::Watch;
use serde::{Deserialize, Serialize};
use sms_cli::front::{Console, peak_bytes};
use sms_cli::front::{PresetName, RefinePoses};
use sms_cli::settings::poses_defaults;
use sms_core::metrics::Metrics;
use sms_core::{Hash, Hasher, InputError, RunFolder, Seed, StageContext, Warnings, atomic};
use sms_frames::{Align, LoadSettings, ReadOptions, Recording, Sequence, Severity, check, load};
use sms_gaussians::ScanConfig;
use sms_masks::{
    Completed, FileMasks, GeometryConfig, GeometryMasks, Labels, Segmenter, TruthMasks, complete,
    load_labels, save_labels,
};
use sms_poses::{PosesConfig, PosesMode, refine_poses};
use std::path::Path;
use std::time::Instant;

/// What the command line itself chose; kept in `run.toml` for later commands.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct RunSettings {
    /// The recording's folder.
    pub recording: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Preset.
    pub preset: String,
    /// Source of the masks.
    pub masks: String,
    /// Every so many frames one was kept out of training (0: none).
    #[serde(default)]
    pub holdout: usize,
    /// Of the Gaussians, the [`regions_hash`] of the labels that they were trained with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub regions: Option<String>,
}

/// The run's settings as the Gaussians were made with them, in their folder: `run.toml` may already speak of a scan
/// that was begun later and not finished.
pub(crate) const SETTINGS: &str = "settings.json";

/// Runs the scan's stages; returns the open run.
pub(crate) fn run(console: &Console, a: &Scan) -> anyhow::Result<RunFolder> {
    let preset = a.preset.unwrap_or(PresetName::Standard);
    let read = console.context.settings.section("read", ReadOptions::default())?;
    let recording = Recording::open(&a.recording, &read)?;
    let kind = preset.preset();
    let long_side = LoadSettings { long_side: kind.long_side(), ..LoadSettings::default() };
    let mut frames_settings = console.context.settings.section("frames", long_side)?;
    if let Some(up) = &a.up {
        frames_settings.align = Align::Up(up_direction(up)?);
    }
    let mut poses_config = console.context.settings.section("poses", poses_defaults(&frames_settings))?;
    if let Some(mode) = a.refine_poses {
        poses_config.mode = match mode {
            RefinePoses::Off => PosesMode::Off,
            RefinePoses::On => PosesMode::On,
            RefinePoses::Auto => PosesMode::Auto,
        };
    }
    let mut scan_config = console.context.settings.section("scan", ScanConfig::preset(kind))?;
    if let Some(holdout) = a.holdout {
        scan_config.holdout = holdout;
    }
    // Before anything is written: a refused setting must leave an earlier run as it was.
    frames_settings.validate()?;
    scan_config.validate()?;
    let geometry = console.context.settings.section("masks", GeometryConfig::default())?;
    let seed = Seed(a.seed.unwrap_or(0));
    let mut observer = Watch::start(a.live.as_deref(), &a.recording)?;

    let run = RunFolder::create(&a.out)?;
    let settings = RunSettings {
        recording: std::path::absolute(&a.recording)?.display().to_string(),
        seed: seed.0,
        preset: preset.name().into(),
        masks: format!("{:?}", a.masks).to_lowercase(),
        holdout: scan_config.holdout,
        regions: None,
    };
    let fingerprint = recording_fingerprint(&recording)?;
    let frames_hash = inputs_hash(&[&fingerprint], &(&read, &frames_settings, refinement(&poses_config)))?;
    let frames_dir =
        run_stage(console, &run, "frames", &["check.", "poses."], &frames_hash, |stage, warnings| {
            let mut metrics = checked(console, &recording, a.no_check, warnings)?;
            let sequence = load(
                &recording,
                &frames_settings,
                StageContext::new(console.context.progress.as_ref(), &console.context.cancel, warnings),
            )?;
            let sequence = match refinement(&poses_config) {
                None => sequence,
                Some(config) => refined(console, &sequence, config, stage.dir(), &mut metrics, warnings)?,
            };
            sequence.save_with_settings(stage.dir(), &frames_settings)?;
            Ok(metrics)
        })?;
    let sequence = Sequence::load(&frames_dir)?;
    // Not before the recording was accepted: a refused one must leave an earlier run as it was.
    run.record_settings("run", &settings)?;
    run.record_settings("read", &read)?;
    run.record_settings("frames", &frames_settings)?;
    run.record_settings("poses", &poses_config)?;
    run.record_settings("scan", &scan_config)?;

    let nets =
        (a.masks == MasksName::Sam2).then(|| models::Chosen::new(console, &a.nets, a.device)).transpose()?;
    let kind = nets.as_ref().map_or_else(|| settings.masks.clone(), models::Chosen::settings);
    // Geometry finds objects, or those that the other sources missed; the truth it leaves alone.
    let masks_settings = (kind, (a.masks != MasksName::Truth).then_some(&geometry));
    let names = mask_names_hash(&recording, a.masks)?;
    let masks_hash = inputs_hash(&[&frames_hash, &names], &masks_settings)?;
    if a.masks != MasksName::Truth {
        run.record_settings("masks", &geometry)?;
    }
    let masks_dir = run_stage(console, &run, "masks", &["masks."], &masks_hash, |stage, warnings| {
        let by = |segmenter: &dyn Segmenter| {
            segmenter.segment(
                &sequence,
                StageContext::new(console.context.progress.as_ref(), &console.context.cancel, warnings),
            )
        };
        let labels = match a.masks {
            MasksName::Geometry => by(&GeometryMasks { config: geometry.clone() })?,
            MasksName::Files => by(&FileMasks::default())?,
            MasksName::Truth => by(&TruthMasks)?,
            MasksName::Sam2 => {
                models::labels(console, nets.as_ref(), &sequence, run.root(), stage, warnings)?
            }
        };
        let pixels: usize = labels.maps.iter().map(|m| m.data.len()).sum();
        let (labels, done) = complete(
            labels,
            &sequence,
            &geometry,
            console.context.progress.as_ref(),
            &console.context.cancel,
        )?;
        save_labels(stage.dir(), &labels)?;
        let mut metrics = Metrics::new();
        metrics.set("masks.objects", labels.objects.len()).set("masks.source", settings.masks.clone());
        if let Some(chosen) = &nets {
            chosen.told(&mut metrics);
        }
        if let Some(moved) = done.moved_pixels {
            metrics.set("masks.refined_share", moved as f64 / pixels.max(1) as f64);
        }
        if let Some(unknown) = done.unknown {
            metrics.set("masks.unknown", unknown);
        }
        console.say(masks_line(&settings.masks, labels.objects.len(), pixels, &done));
        Ok(metrics)
    })?;
    let labels = load_labels(&masks_dir)?;

    // A user may have edited labels.json: what was merged there is trained anew, other names change nothing here.
    let regions = regions_hash(&labels);
    let settings = RunSettings { regions: Some(regions.0.clone()), ..settings };
    // How often checkpoints are written changes nothing.
    let hashed = ScanConfig { checkpoint_seconds: 0.0, ..scan_config.clone() };
    let scan_hash = inputs_hash(&[&frames_hash, &regions], &(&hashed, seed))?;
    run_stage(console, &run, "gaussians", &["scan."], &scan_hash, |stage, warnings| {
        let (mut trainer, device) =
            device::trainer(console, a.device, &scan_config.train, labels.class_count(), seed, warnings)?;
        let result = sms_gaussians::scan_observed(
            &sequence,
            &labels,
            &scan_config,
            stage.dir(),
            trainer.as_mut(),
            &mut observer,
            StageContext::new(console.context.progress.as_ref(), &console.context.cancel, warnings)
                .with_seed(seed),
        )?;
        let mut metrics = result.metrics;
        metrics.set("scan.seconds", result.seconds).set("scan.device", device);
        atomic::write_json(&stage.dir().join(SETTINGS), &settings)?;
        if let Some(bytes) = peak_bytes() {
            metrics.set("scan.peak_bytes", bytes);
        }
        Ok(metrics)
    })?;
    if let Some(problem) = observer.finish() {
        eprintln!("warning: {problem}");
    }
    summary(console, &run, labels.objects.len())?;
    console.print_metrics(&run)?;
    Ok(run)
}

/// The settings of the refinement, where one is wanted: without one they change nothing.
fn refinement(config: &PosesConfig) -> Option<&PosesConfig> {
    (config.mode != PosesMode::Off).then_some(config)
}

/// The sequence with the poses to use; what was done to them goes to `poses.json`, the metrics and the user.
fn refined(
    console: &Console,
    sequence: &Sequence,
    config: &PosesConfig,
    dir: &Path,
    metrics: &mut Metrics,
    warnings: &Warnings,
) -> anyhow::Result<Sequence> {
    let began = Instant::now();
    let result = refine_poses(
        sequence,
        config,
        StageContext::new(console.context.progress.as_ref(), &console.context.cancel, warnings),
    )?;
    metrics.merge(result.report.metrics());
    metrics.set("poses.seconds", began.elapsed().as_secs_f64());
    atomic::write_json(&dir.join("poses.json"), &result.report)?;
    console.say(result.report.summary());
    Ok(result.sequence)
}

fn up_direction(values: &[f64]) -> Result<[f64; 3], InputError> {
    match values {
        &[x, y, z] if [x, y, z].iter().all(|v| v.is_finite()) && x * x + y * y + z * z > 1e-12 => {
            Ok([x, y, z])
        }
        _ => Err(InputError::new(
            format!("{values:?} is no direction"),
            "--up",
            "give three numbers that are not all zero, such as --up 0,0,1",
        )),
    }
}

/// Checks the recording; a fault stops the scan unless `--no-check`.
fn checked(
    console: &Console,
    recording: &Recording,
    no_check: bool,
    warnings: &Warnings,
) -> anyhow::Result<Metrics> {
    let report = check(recording, console.context.progress.as_ref(), &console.context.cancel)?;
    for finding in &report.findings {
        if finding.severity == Severity::Fault && !no_check {
            return Err(InputError::new(
                finding.what.clone(),
                &recording.root,
                format!("{}; or scan as it is with --no-check", finding.cure),
            )
            .into());
        }
        if finding.severity != Severity::Info {
            warnings.add("frames", finding.code, finding.what.clone(), finding.cure.clone());
        }
    }
    Ok(report.metrics())
}

/// Content hash of everything that the recording's frames consist of.
fn recording_fingerprint(recording: &Recording) -> anyhow::Result<Hash> {
    let mut hasher = Hasher::new();
    hasher.text(&std::path::absolute(&recording.root)?.display().to_string());
    let statements = (
        recording.depth_unit_m,
        recording.axes,
        recording.poses,
        recording.pixel_center,
        recording.world_up_r,
        recording.world_is_aligned,
    );
    hasher.text(&format!("{statements:?}"));
    for frame in &recording.frames {
        // Pose, time, lenses and paths; `Debug` writes floats exactly.
        hasher.text(&format!("{frame:?}"));
        let files = [Some(&frame.color_path), Some(&frame.depth_path), frame.mask_path.as_ref()];
        for path in files.into_iter().flatten() {
            hash_file(&mut hasher, path)?;
        }
    }
    Ok(hasher.finish())
}

/// Content hash of what the Gaussians are trained with: which pixel belongs to which object, whatever the objects are called.
pub(crate) fn regions_hash(labels: &Labels) -> Hash {
    let mut hasher = Hasher::new();
    let ids: Vec<u16> = labels.objects.iter().map(|o| o.id).collect();
    hasher.text(&format!("{:?} {ids:?}", labels.source));
    for map in &labels.maps {
        hasher.text(&format!("{:?}", map.size()));
        let bytes: Vec<u8> = map.data.iter().flat_map(|label| label.to_le_bytes()).collect();
        hasher.bytes(&bytes);
    }
    hasher.finish()
}

/// Content hash of what names the objects of masks from files, or of a generated recording's truth.
fn mask_names_hash(recording: &Recording, masks: MasksName) -> anyhow::Result<Hash> {
    let file = match masks {
        MasksName::Geometry | MasksName::Sam2 => None,
        MasksName::Files => Some(recording.root.join("objects.json")),
        MasksName::Truth => Some(recording.root.join("truth").join("truth.json")),
    };
    let mut hasher = Hasher::new();
    if let Some(path) = file {
        hash_file(&mut hasher, &path)?;
    }
    Ok(hasher.finish())
}

/// A missing or unreadable image is not the fingerprint's to report: the reader names it with its cure.
fn hash_file(hasher: &mut Hasher, path: &Path) -> anyhow::Result<()> {
    hasher.text(&path.display().to_string());
    if path.is_file() {
        hasher.file(path)?;
    }
    Ok(())
}

/// One line on the masks: how many objects, whence, and what was done to them.
fn masks_line(source: &str, objects: usize, pixels: usize, done: &Completed) -> String {
    let mut line = format!("masks: {objects} objects from {source}");
    if let Some(unknown @ 1..) = done.unknown {
        line += &format!(", {unknown} of them unknown to it (masks.add_unknown)");
    }
    if let Some(moved) = done.moved_pixels {
        let percent = 100.0 * moved as f64 / pixels.max(1) as f64;
        line +=
            &format!("; borders refined in 3-D, {percent:.2} % of the pixels changed (masks.refine_edges)");
    }
    line
}

fn summary(console: &Console, run: &RunFolder, objects: usize) -> anyhow::Result<()> {
    let m = Metrics::load(&run.metrics_path())?;
    let n = |key: &str| m.number(key);
    let mut line = format!(
        "scan: {} Gaussians from {} frames, {objects} objects",
        n("scan.gaussians").unwrap_or(0.0),
        n("scan.frames").unwrap_or(0.0)
    );
    if let Some(psnr) = n("scan.holdout_psnr_db") {
        line += &format!(", {psnr:.1} dB on held-out views");
    } else if let Some(psnr) = n("scan.train_psnr_db") {
        line += &format!(", {psnr:.1} dB");
    }
    if let Some(depth) = n("scan.holdout_depth_mae_m") {
        line += &format!(", depth error {}", length_text(depth));
    }
    console.say(line);
    console.say(format!("  in {}", shown(&run.root().join("gaussians").join("scene.ply"))));
    Ok(())
}
