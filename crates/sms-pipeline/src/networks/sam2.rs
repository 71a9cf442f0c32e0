//! Masks by OWLv2 and SAM 2.1.

use super::{ModelEntry, NetworksRequest, TrackMode};
use crate::preview::{FOUND, FoundBox, show_found};
use crate::{Context, Device as Asked, Error};
use sms_core::metrics::Metrics;
use sms_core::{Labels, StageContext, Warnings, atomic};
use sms_frames::{ReadOptions, Sequence};
use sms_masks::{MasksError, Segmenter};
use sms_nets::hub::{HubConfig, HubModel, MODELS, model, model_folders};
use sms_nets::{DetectedObject, Device, ModelFolders, NamedBox, NetsConfig, NetsMasks, Track, parse_objects};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

const DETECTOR: &str = "owlv2";
const TRACKER: &str = "sam2-tiny";

/// The networks of a request, with their device.
pub(crate) struct Networks {
    config: NetsConfig,
    boxes: Vec<NamedBox>,
    tracker: HubModel,
    weights: Option<PathBuf>,
    device: Device,
    /// Reason for using the CPU although a GPU was expected.
    without_gpu: Option<String>,
    read: ReadOptions,
}

impl Networks {
    /// Checks the request without fetching any model.
    pub(crate) fn new(a: &NetworksRequest, asked: Asked, read: &ReadOptions) -> Result<Self, Error> {
        let mut config = NetsConfig::default();
        config.threshold = a.threshold.unwrap_or(config.threshold);
        config.max_overlap = a.max_overlap.unwrap_or(config.max_overlap);
        config.validate()?;
        let boxes: Vec<NamedBox> = a.boxes.iter().map(|b| b.parse()).collect::<Result<_, _>>()?;
        match &a.objects {
            Some(list) => config.objects = parse_objects(list).map_err(MasksError::from)?,
            None if !boxes.is_empty() => config.objects = Vec::new(),
            None => {}
        }
        let (device, without_gpu) = device(asked);
        match a.tracking {
            Some(TrackMode::Memory) => config.track = Track::Memory,
            Some(TrackMode::Reprompt) => config.track = Track::Reprompt,
            None if device.is_cpu() => config.track = Track::Reprompt,
            None => {}
        }
        let tracker = known(a.sam2.as_deref().unwrap_or(TRACKER))?;
        Ok(Self {
            config,
            boxes,
            tracker,
            weights: a.weights.clone(),
            device,
            without_gpu,
            read: read.clone(),
        })
    }

    /// Returns the inputs of the masks, for the stage's hash. Local weights are represented by the sizes and times of
    /// their files, because reading half a gigabyte takes too long.
    pub(crate) fn settings(&self) -> Result<String, Error> {
        let HubModel { repository, revision, .. } = self.tracker;
        let boxes: Vec<_> =
            self.boxes.iter().map(|b| (&b.name, [b.bbox.x0, b.bbox.y0, b.bbox.x1, b.bbox.y1])).collect();
        let files = self.weights.as_deref().map(files_of).unwrap_or_default();
        Ok(serde_json::to_string(&(&self.config, boxes, repository, revision, &self.weights, files))?)
    }

    /// Adds the metrics that name the networks and the device.
    pub(crate) fn describe(&self, metrics: &mut Metrics) {
        let track = match self.config.track {
            Track::Memory => "with memory",
            Track::Reprompt => "prompted again in each frame",
        };
        let device = if self.device.is_cpu() { "cpu" } else { "gpu" };
        metrics.set("masks.model", self.tracker.repository).set("masks.track", track);
        metrics.set("masks.device", device);
        if self.weights.is_none() {
            metrics.set("masks.model_commit", self.tracker.revision);
        }
    }

    /// Returns a segmenter that shows the detections of the first frame before tracking, which takes minutes.
    pub(crate) fn segmenter<'a>(
        &'a self,
        context: &'a Context,
        dir: &'a Path,
        run: &'a Path,
    ) -> Box<dyn Segmenter + 'a> {
        Box::new(ShownSegmenter { networks: self, context, dir, run })
    }

    /// Shows the detections in the first frame of a run without changing its masks.
    pub(crate) fn preview(&self, context: &Context, sequence: &Sequence, run: &Path) -> Result<(), Error> {
        let hub = HubConfig::from_environment();
        let folder = |model: HubModel| {
            model.folder(self.weights.as_deref(), &hub, context.progress.as_ref(), &context.cancel)
        };
        let owlv2 = self.detector()?.map(folder).transpose().map_err(MasksError::from)?;
        // The tracker is not needed here.
        let networks = self.masks(ModelFolders { owlv2, sam2: PathBuf::new() });
        let warnings = Warnings::new();
        self.warn(&warnings);
        let found = networks.find_first(sequence, &context.cancel, &warnings)?;
        context.warn(&warnings);
        show_found(context, run, sequence, &boxes_of(&found))
    }

    /// Warns if the networks run on the CPU although a GPU was expected.
    fn warn(&self, warnings: &Warnings) {
        if let Some(why) = &self.without_gpu {
            warnings.add(
                "masks",
                "gpu_not_used",
                format!("{why}; the networks run on the CPU"),
                "build with `--features cuda` or `metal`; --device cpu avoids this warning",
            );
        }
    }

    fn detector(&self) -> Result<Option<HubModel>, MasksError> {
        (!self.config.objects.is_empty()).then(|| known(DETECTOR)).transpose()
    }

    fn masks(&self, models: ModelFolders) -> NetsMasks {
        NetsMasks {
            config: self.config.clone(),
            boxes: self.boxes.clone(),
            models,
            device: self.device.clone(),
            read: self.read.clone(),
        }
    }
}

/// A segmenter that keeps the detections of the first frame with the masks (`found.json`) and shows them.
struct ShownSegmenter<'a> {
    networks: &'a Networks,
    context: &'a Context,
    dir: &'a Path,
    run: &'a Path,
}

impl Segmenter for ShownSegmenter<'_> {
    fn segment(&self, sequence: &Sequence, context: StageContext<'_>) -> Result<Labels, MasksError> {
        let Self { networks, dir, run, .. } = self;
        networks.warn(context.warnings);
        let models = model_folders(
            networks.detector()?,
            networks.tracker,
            networks.weights.as_deref(),
            &HubConfig::from_environment(),
            context.progress,
            context.cancel,
        )?;
        let masks = networks.masks(models);
        let found = masks.find_first(sequence, context.cancel, context.warnings)?;
        let boxes = boxes_of(&found);
        atomic::write_json(&dir.join(FOUND), &boxes)?;
        show_found(self.context, run, sequence, &boxes).map_err(|error| match error {
            Error::Core(core) => core,
            Error::Input(input) => input.into(),
            other => MasksError::Input(sms_core::InputError::new(other.to_string(), run, "")),
        })?;
        masks.follow(sequence, &found, context.progress, context.cancel, context.warnings)
    }
}

/// Names, sizes and times (seconds since 1970) of the weights in a folder and its subfolders, sorted.
fn files_of(folder: &Path) -> Vec<(PathBuf, u64, Option<f64>)> {
    let entries = |dir: &Path| -> Vec<PathBuf> {
        std::fs::read_dir(dir).into_iter().flatten().flatten().map(|e| e.path()).collect()
    };
    let (folders, mut paths): (Vec<_>, Vec<_>) = entries(folder).into_iter().partition(|p| p.is_dir());
    paths.extend(folders.iter().flat_map(|f| entries(f)));
    paths.sort();
    let seconds = |time: SystemTime| time.duration_since(UNIX_EPOCH).ok().map(|d| d.as_secs_f64());
    let of = |path: PathBuf| {
        let about = std::fs::metadata(&path).ok().filter(|m| m.is_file())?;
        Some((path, about.len(), about.modified().ok().and_then(seconds)))
    };
    paths.into_iter().filter_map(of).collect()
}

/// Returns the device and, if a GPU was requested or the build is for one, the reason why it is not a GPU. Of several
/// GPUs it uses the first of CUDA or Metal; the indices of `sms devices` belong to another interface.
fn device(asked: Asked) -> (Device, Option<String>) {
    let is_for_gpu = cfg!(any(feature = "cuda", feature = "metal"));
    match asked {
        Asked::Cpu => (Device::Cpu, None),
        Asked::Auto if !is_for_gpu => (Device::Cpu, None),
        Asked::Auto | Asked::Gpu(_) => match gpu() {
            Ok(device) => (device, None),
            Err(why) => (Device::Cpu, Some(why)),
        },
    }
}

#[cfg(feature = "cuda")]
fn gpu() -> Result<Device, String> {
    Device::new_cuda(0).map_err(|e| format!("CUDA cannot be used: {}", first_line(&e)))
}

#[cfg(all(feature = "metal", not(feature = "cuda")))]
fn gpu() -> Result<Device, String> {
    Device::new_metal(0).map_err(|e| format!("Metal cannot be used: {}", first_line(&e)))
}

/// Returns the message without the backtrace that candle appends under `RUST_BACKTRACE`.
#[cfg(any(feature = "cuda", feature = "metal"))]
fn first_line(error: &impl std::fmt::Display) -> String {
    error.to_string().lines().next().unwrap_or_default().to_owned()
}

#[cfg(not(any(feature = "cuda", feature = "metal")))]
fn gpu() -> Result<Device, String> {
    Err("this program was built without the features `cuda` and `metal`".into())
}

/// Returns the boxes with the ids of their labels.
fn boxes_of(found: &[DetectedObject]) -> Vec<FoundBox> {
    let of = |(i, f): (usize, &DetectedObject)| FoundBox {
        id: i as u16 + 1,
        name: f.name.clone(),
        score: f.score,
        box_px: [f.bbox.x0, f.bbox.y0, f.bbox.x1, f.bbox.y1],
    };
    found.iter().enumerate().map(of).collect()
}

/// Finds a model by name. Errors of the networks become errors of masks, which define the exit codes.
fn known(name: &str) -> Result<HubModel, MasksError> {
    Ok(model(name)?)
}

/// Lists the networks.
///
/// # Errors
/// None in this build.
pub fn list_models() -> Result<Vec<ModelEntry>, Error> {
    let hub = HubConfig::from_environment();
    let entry = |m: &HubModel| ModelEntry {
        name: m.name,
        repository: m.repository,
        about: m.about,
        cached: hub.cached(m).map(|c| (c.folder, c.commit)),
    };
    Ok(MODELS.iter().map(entry).collect())
}

/// Fetches networks into the Hugging Face cache, by default the two that masks need; returns names and folders.
///
/// # Errors
/// [`Error::Core`] for unknown names and failed downloads.
pub fn fetch_models(names: &[String], context: &Context) -> Result<Vec<(String, PathBuf)>, Error> {
    let hub = HubConfig::from_environment();
    let names: Vec<&str> =
        if names.is_empty() { vec![DETECTOR, TRACKER] } else { names.iter().map(String::as_str).collect() };
    let mut fetched = Vec::new();
    for name in names {
        let folder =
            hub.fetch(&known(name)?, context.progress.as_ref(), &context.cancel).map_err(MasksError::from)?;
        context.message(format!("{name}: {}", folder.display()));
        fetched.push((name.to_owned(), folder));
    }
    Ok(fetched)
}
