//! Recording → frames → masks → Gaussians.

use super::Run;
use super::follow::Afterwards;
use super::poses::POSES;
use super::settings::{RunSettings, SETTINGS, regions_hash};
use crate::cache::{inputs_hash, run_stage};
use crate::command_options::record_options;
use crate::memory::ScanMemory;
use crate::networks::Networks;
use crate::object_names::{EDITS, ObjectNames, follow};
use crate::preview::{FOUND, FoundBox};
use crate::resumption::AnnouncedScan;
use crate::separate::refuse_run_in_recording;
use crate::stages::{FramesRequest, GaussiansRequest, frames, gaussians, masks, recorded_poses};
use crate::{Device, Error, MasksSource, device};
use sms_core::{CoreError, Hash, Hasher, InputError, RunFolder, Seed, Warnings, atomic};
use sms_frames::{Align, LoadSettings, ReadOptions, RecordedFrame, Recording, Sequence};
use sms_gaussians::{Preset, ScanConfig, ScanObserver};
use sms_masks::{
    FileMasks, GeometryConfig, GeometryMasks, Labels, Segmenter, TruthMasks, load_labels, save_labels_again,
};
use sms_materials::Overrides;
use sms_poses::{PosesConfig, PosesMode};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Options of a scan that are not settings of a stage, or override these.
#[derive(Debug, Clone, Default)]
pub struct ScanRequest {
    /// Preset of resolution and training steps.
    pub preset: Preset,
    /// Source of the object masks.
    pub masks: MasksSource,
    /// Mode of the pose refinement; by default from the settings.
    pub poses: Option<PosesMode>,
    /// Holds every N-th frame out of training (0: none); by default from the settings.
    pub holdout: Option<usize>,
    /// Device of the scan.
    pub device: Device,
    /// Random seed; by default 0.
    pub seed: Option<Seed>,
    /// Up direction in the recording's world.
    pub up: Option<[f64; 3]>,
    /// Whether to scan even if the check finds a fault.
    pub accept_faults: bool,
    /// Follows the recording while its folder grows, with a map that the observer sees, until no frame has arrived for this time. The
    /// scan is that of the complete recording.
    pub follow: Option<Duration>,
}

impl ScanRequest {
    pub(super) fn seed(&self) -> Seed {
        self.seed.unwrap_or(Seed(0))
    }
}

/// Result of a scan.
#[derive(Debug, Clone)]
pub struct ScanOutcome {
    /// Number of objects in the masks.
    pub objects: usize,
    /// File of the Gaussians.
    pub gaussians: PathBuf,
}

/// Complete and valid settings of a scan.
pub(super) struct ScanSettings {
    pub(super) read: ReadOptions,
    pub(super) frames: FramesRequest,
    geometry: GeometryConfig,
    pub(super) scan: ScanConfig,
}

impl Run<'_> {
    /// Scans a recording into the run: loads its frames, segments objects and trains Gaussians. An interrupted scan is
    /// resumed.
    ///
    /// # Errors
    /// [`Error::Input`] for a bad recording or setting, before an earlier run in this folder changes; otherwise the
    /// error of the stage that failed.
    pub fn scan(&self, recording: &Path, request: &ScanRequest) -> Result<ScanOutcome, Error> {
        self.scan_observed(recording, request, &mut ())
    }

    /// Does the same as [`Run::scan`], with an observer of the training.
    ///
    /// # Errors
    /// As [`Run::scan`].
    pub fn scan_observed(
        &self,
        recording: &Path,
        request: &ScanRequest,
        observer: &mut dyn ScanObserver,
    ) -> Result<ScanOutcome, Error> {
        request.device.refuse_missing()?;
        let settings = self.scan_settings(request)?;
        let mut observer = Afterwards { inner: observer, steps: 0 };
        if let Some(patience) = request.follow {
            refuse_run_in_recording(&self.folder, recording)?;
            observer.steps = self.follow(recording, patience, (request, &settings), observer.inner)?;
        }
        let opened = Recording::open(recording, &settings.read)?;
        refuse_run_in_recording(&self.folder, &opened.root)?;
        let run = RunFolder::create(&self.folder)?;
        let (frames_hash, sequence) = self.frames_stage(&run, &opened, request, &settings)?;
        // Written only after the recording was accepted: a refused one must not change an earlier run.
        let recorded = RunSettings {
            recording: std::path::absolute(recording)
                .map_err(CoreError::read(recording))?
                .display()
                .to_string(),
            seed: request.seed().0,
            preset: request.preset.name().into(),
            masks: request.masks.name().into(),
            holdout: settings.scan.holdout,
            regions: None,
        };
        record_options(self.context, &run, "scan")?;
        run.record_settings("run", &recorded)?;
        run.record_settings("read", &settings.read)?;
        run.record_settings("frames", &settings.frames.load)?;
        run.record_settings("poses", &settings.frames.poses)?;
        run.record_settings("scan", &settings.scan)?;
        let work = ScanWork {
            run: &run,
            request,
            settings: &settings,
            frames_hash: &frames_hash,
            sequence: &sequence,
        };
        self.context.message(ScanMemory::of(&sequence).text());
        let labels = self.masks_stage(&work, &opened)?;
        self.gaussians_stage(&work, &labels, recorded, &mut observer)?;
        self.tell_stale(&run);
        let gaussians = run.root().join("gaussians").join("scene.ply");
        Ok(ScanOutcome { objects: labels.objects.len(), gaussians })
    }

    /// Collects and checks the settings before any file is written: a refused setting must not change an earlier run.
    fn scan_settings(&self, request: &ScanRequest) -> Result<ScanSettings, Error> {
        let given = &self.context.settings;
        let mut read = given.section("read", ReadOptions::default())?;
        let defaults = LoadSettings { long_side: request.preset.long_side(), ..LoadSettings::default() };
        let mut load = given.section("frames", defaults)?;
        if let Some(up) = request.up {
            load.align = Align::Up(up_direction(up)?);
        }
        let mut poses = given.section("poses", PosesConfig::default())?;
        poses.mode = request.poses.unwrap_or(poses.mode);
        read.ignore_poses |= poses.mode == PosesMode::Estimate;
        let mut scan = given.section("scan", ScanConfig::preset(request.preset))?;
        scan.holdout = request.holdout.unwrap_or(scan.holdout);
        load.validate()?;
        scan.validate()?;
        let geometry = given.section("masks", GeometryConfig::default())?;
        let frames = FramesRequest { load, poses, accept_faults: request.accept_faults };
        Ok(ScanSettings { read, frames, geometry, scan })
    }

    fn frames_stage(
        &self,
        run: &RunFolder,
        recording: &Recording,
        request: &ScanRequest,
        settings: &ScanSettings,
    ) -> Result<(Hash, Sequence), Error> {
        let FramesRequest { load, poses, .. } = &settings.frames;
        // Without refinement, its settings do not matter.
        let refinement: Option<&PosesConfig> = (poses.mode != PosesMode::Given).then_some(poses);
        // Estimated poses are moved to those that the files hold, which the fingerprint then lacks.
        let ignored = (!recording.has_poses).then(|| recorded_poses(recording, &Warnings::new()));
        let hash = inputs_hash(&[&fingerprint(recording)?], &(&settings.read, load, refinement, ignored))?;
        let dir = run_stage(self.context, run, "frames", &hash, |stage, warnings| {
            let made = frames(recording, &settings.frames, self.context.stage(warnings, request.seed()))?;
            if let Some(report) = &made.poses {
                atomic::write_json(&stage.dir().join(POSES), report)?;
                self.context.message(report.summary());
            }
            made.sequence.save_with_settings(stage.dir(), load)?;
            Ok(made.metrics)
        })?;
        Ok((hash, Sequence::load(&dir)?))
    }

    fn masks_stage(&self, work: &ScanWork<'_>, recording: &Recording) -> Result<Labels, Error> {
        let &ScanWork { run, request, settings, frames_hash, sequence } = work;
        let (source, geometry) = (&request.masks, &settings.geometry);
        let networks = match source {
            MasksSource::Networks(asked) => Some(Networks::new(asked, request.device, &settings.read)?),
            _ => None,
        };
        let kind = match &networks {
            Some(networks) => networks.settings()?,
            None => source.name().to_owned(),
        };
        // Geometry finds objects, or those that other sources missed; it does not change the ground truth.
        let by_geometry = !matches!(source, MasksSource::Truth);
        let hashed = (kind, by_geometry.then_some(geometry));
        let hash = inputs_hash(&[frames_hash, &mask_names_hash(recording, source)?], &hashed)?;
        if by_geometry {
            run.record_settings("masks", geometry)?;
        }
        let dir = run_stage(self.context, run, "masks", &hash, |stage, warnings| {
            let segmenter: Box<dyn Segmenter + '_> = match (source, &networks) {
                (_, Some(networks)) => networks.segmenter(self.context, stage.dir(), run.root()),
                (MasksSource::Files, _) => Box::new(FileMasks::default()),
                (MasksSource::Truth, _) => Box::new(TruthMasks),
                _ => Box::new(GeometryMasks { config: geometry.clone() }),
            };
            let made = masks(sequence, &*segmenter, geometry, self.context.stage(warnings, request.seed()))?;
            let (mut metrics, summary) = (made.metrics(source.name()), made.summary(source.name()));
            self.save_masks(run, stage.dir(), made.labels, warnings)?;
            if let Some(networks) = &networks {
                networks.describe(&mut metrics);
            }
            self.context.message(summary);
            Ok(metrics)
        })?;
        Ok(load_labels(&dir)?)
    }

    /// Writes new masks with the user's edits of the earlier ones.
    fn save_masks(
        &self,
        run: &RunFolder,
        dir: &Path,
        labels: Labels,
        warnings: &Warnings,
    ) -> Result<(), Error> {
        let names = ObjectNames::of(run).unwrap_or_default();
        let values = follow(Overrides::read_optional(&run.root().join(EDITS))?, &names).overrides;
        let has_values = |id: u16| values.object.values().any(|o| o.label == Some(id));
        let carried = save_labels_again(dir, labels, &run.root().join("masks"), has_values)?;
        if !carried.ids.is_empty() {
            renumber_found(dir, &carried.ids)?;
        }
        if !carried.lost.is_empty() {
            warnings.add(
                "masks",
                "names_lost",
                format!("the new masks have no counterpart of: {}", carried.lost.join(", ")),
                "name the objects again (`sms name RUN`), and set their materials; values of objects that are gone \
                 stay in materials.toml",
            );
        }
        Ok(())
    }

    fn gaussians_stage(
        &self,
        work: &ScanWork<'_>,
        labels: &Labels,
        recorded: RunSettings,
        observer: &mut dyn ScanObserver,
    ) -> Result<(), Error> {
        let &ScanWork { run, request, settings, frames_hash, sequence } = work;
        // A user may have edited labels.json: merged objects need a new training, other names do not.
        let regions = regions_hash(labels)?;
        let recorded = RunSettings { regions: Some(regions.0.clone()), ..recorded };
        // The checkpoint interval does not affect the result.
        let hashed = ScanConfig { checkpoint_seconds: 0.0, ..settings.scan.clone() };
        let hash = inputs_hash(&[frames_hash, &regions], &(&hashed, request.seed()))?;
        run_stage(self.context, run, "gaussians", &hash, |stage, warnings| {
            let context = self.context.stage(warnings, request.seed());
            let (train, classes) = (&settings.scan.train, labels.class_count());
            let (mut trainer, device) =
                device::trainer(request.device, train, classes, self.context.events.as_ref(), context)?;
            let training = GaussiansRequest { config: &settings.scan, work_dir: stage.dir() };
            let mut observer = AnnouncedScan { inner: observer, context: self.context };
            let result = gaussians(sequence, labels, &training, trainer.as_mut(), &mut observer, context)?;
            let mut metrics = result.metrics;
            metrics.set("scan.device", device);
            atomic::write_json(&stage.dir().join(SETTINGS), &recorded)?;
            Ok(metrics)
        })?;
        Ok(())
    }
}

/// Gives the detections of the first frame, if there are any, the new ids of their objects.
fn renumber_found(dir: &Path, ids: &BTreeMap<u16, u16>) -> Result<(), Error> {
    let path = dir.join(FOUND);
    if !path.is_file() {
        return Ok(());
    }
    let mut found: Vec<FoundBox> = atomic::read_json(&path)?;
    for one in &mut found {
        one.id = ids.get(&one.id).copied().unwrap_or(one.id);
    }
    Ok(atomic::write_json(&path, &found)?)
}

/// A scan with loaded frames.
struct ScanWork<'a> {
    run: &'a RunFolder,
    request: &'a ScanRequest,
    settings: &'a ScanSettings,
    frames_hash: &'a Hash,
    sequence: &'a Sequence,
}

fn up_direction(up: [f64; 3]) -> Result<[f64; 3], InputError> {
    if up.iter().all(|v| v.is_finite()) && up.iter().map(|v| v * v).sum::<f64>() > 1e-12 {
        return Ok(up);
    }
    let what = format!("{up:?} is not a direction");
    Err(InputError::new(what, "--up", "use three numbers that are not all zero, such as --up 0,0,1"))
}

/// Returns the content hash of all files of the recording's frames. The recording's path may be spelled in any way.
fn fingerprint(recording: &Recording) -> Result<Hash, Error> {
    let mut hasher = Hasher::new();
    let root = recording.root.canonicalize().map_err(CoreError::read(&recording.root))?;
    hasher.text(&root.display().to_string());
    let statements = (
        recording.depth_unit_m,
        recording.axes,
        recording.poses,
        recording.pixel_center,
        recording.world_up_r,
        recording.world_is_aligned,
    );
    hasher.text(&serde_json::to_string(&statements)?);
    for frame in &recording.frames {
        let within = |path: &Path| path.strip_prefix(&recording.root).unwrap_or(path).to_owned();
        let named = RecordedFrame {
            color_path: within(&frame.color_path),
            depth_path: within(&frame.depth_path),
            mask_path: frame.mask_path.as_deref().map(within),
            ..frame.clone()
        };
        hasher.text(&serde_json::to_string(&named)?);
        let files = [Some(&frame.color_path), Some(&frame.depth_path), frame.mask_path.as_ref()];
        for path in files.into_iter().flatten() {
            hash_file(&mut hasher, path)?;
        }
    }
    Ok(hasher.finish())
}

/// Returns the content hash of the file with the object names of masks from files or from the ground truth.
fn mask_names_hash(recording: &Recording, masks: &MasksSource) -> Result<Hash, Error> {
    let file = match masks {
        MasksSource::Geometry | MasksSource::Networks(_) => None,
        MasksSource::Files => Some(recording.root.join("objects.json")),
        MasksSource::Truth => Some(recording.root.join("truth").join("truth.json")),
    };
    let mut hasher = Hasher::new();
    if let Some(path) = file {
        hash_file(&mut hasher, &path)?;
    }
    Ok(hasher.finish())
}

/// Adds a file's content if it exists; the reader reports missing images.
fn hash_file(hasher: &mut Hasher, path: &Path) -> Result<(), Error> {
    let exists = path.is_file();
    hasher.text(if exists { "file" } else { "no file" });
    if exists {
        hasher.file(path)?;
    }
    Ok(())
}
