//! The networks: `sms models`, and masks by them in `sms scan --masks sam2`.

#[cfg(feature = "nets")]
pub(crate) use with_nets::{Chosen, labels, preview, run};
#[cfg(not(feature = "nets"))]
pub(crate) use without_nets::{Chosen, labels, preview, run};

#[cfg(feature = "nets")]
mod with_nets {
    use super::super::masks::{self, FoundBox};
    use crate::cli::{Models, NetsArguments, TrackName};
    use sms_cli::front::Console;
    use sms_cli::front::Device as Asked;
    use sms_core::metrics::Metrics;
    use sms_core::{Stage, Warnings, atomic};
    use sms_frames::{ReadOptions, Sequence};
    use sms_masks::{Labels, MasksError};
    use sms_nets::hub::{HubConfig, MODELS, Model, model, model_folders};
    use sms_nets::{Device, Found, ModelFolders, NamedBox, NetsConfig, NetsMasks, Track, parse_objects};
    use std::path::{Path, PathBuf};
    use std::time::SystemTime;

    const DETECTOR: &str = "owlv2";
    const TRACKER: &str = "sam2-tiny";

    /// What was asked for.
    pub(crate) struct Chosen {
        config: NetsConfig,
        boxes: Vec<NamedBox>,
        tracker: Model,
        weights: Option<PathBuf>,
        device: Device,
        /// Why no GPU computes, where one was to be expected.
        without_gpu: Option<String>,
        read: ReadOptions,
    }

    impl Chosen {
        /// Checks the arguments; nothing is fetched yet.
        pub(crate) fn new(console: &Console, a: &NetsArguments, asked: Asked) -> anyhow::Result<Self> {
            let read = console.context.settings.section("read", ReadOptions::default())?;
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
            match a.track {
                Some(TrackName::Memory) => config.track = Track::Memory,
                Some(TrackName::Reprompt) => config.track = Track::Reprompt,
                None if device.is_cpu() => config.track = Track::Reprompt,
                None => {}
            }
            let tracker = known(a.sam2.as_deref().unwrap_or(TRACKER))?;
            Ok(Self { config, boxes, tracker, weights: a.weights.clone(), device, without_gpu, read })
        }

        /// Everything that the masks depend on. Local weights count by their files' sizes and times: reading half a gigabyte to
        /// find that nothing changed would take as long as some of the work.
        pub(crate) fn settings(&self) -> String {
            let Model { repository, revision, .. } = self.tracker;
            let files = self.weights.as_deref().map(files_of).unwrap_or_default();
            format!("{:?} {:?} {repository} {revision} {:?} {files:?}", self.config, self.boxes, self.weights)
        }

        /// Which network tracked, and how, for metrics and the report.
        pub(crate) fn told(&self, metrics: &mut Metrics) {
            let track = match self.config.track {
                Track::Memory => "with memory",
                Track::Reprompt => "prompted anew in each frame",
            };
            let device = if self.device.is_cpu() { "cpu" } else { "gpu" };
            metrics.set("masks.model", self.tracker.repository).set("masks.track", track);
            metrics.set("masks.device", device);
            if self.weights.is_none() {
                metrics.set("masks.model_commit", self.tracker.revision);
            }
        }

        /// Warns where a GPU was to be expected and the CPU computes.
        fn warn(&self, warnings: &Warnings) {
            if let Some(why) = &self.without_gpu {
                warnings.add(
                    "masks",
                    "gpu_not_used",
                    format!("{why}; the networks compute on the CPU"),
                    "build with `--features cuda` or `metal`; --device cpu asks for no GPU",
                );
            }
        }

        fn detector(&self) -> Result<Option<Model>, MasksError> {
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

    /// Names, sizes and times of the weights in a folder and its subfolders, sorted.
    fn files_of(folder: &Path) -> Vec<(PathBuf, u64, Option<SystemTime>)> {
        let entries = |dir: &Path| -> Vec<PathBuf> {
            std::fs::read_dir(dir).into_iter().flatten().flatten().map(|e| e.path()).collect()
        };
        let (folders, mut paths): (Vec<_>, Vec<_>) = entries(folder).into_iter().partition(|p| p.is_dir());
        paths.extend(folders.iter().flat_map(|f| entries(f)));
        paths.sort();
        let of = |path: PathBuf| {
            let about = std::fs::metadata(&path).ok().filter(|m| m.is_file())?;
            Some((path, about.len(), about.modified().ok()))
        };
        paths.into_iter().filter_map(of).collect()
    }

    /// What computes, and why no GPU does where one was asked for or the build is for one. Of several GPUs it is the first that CUDA
    /// or Metal names: the numbers of `sms devices` are those of another interface.
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

    /// What went wrong, without the backtrace that candle appends under `RUST_BACKTRACE`.
    #[cfg(any(feature = "cuda", feature = "metal"))]
    fn first_line(error: &impl std::fmt::Display) -> String {
        error.to_string().lines().next().unwrap_or_default().to_owned()
    }

    #[cfg(not(any(feature = "cuda", feature = "metal")))]
    fn gpu() -> Result<Device, String> {
        Err("this program was built without the features `cuda` and `metal`".into())
    }

    /// The labels of a sequence, models fetched where they are not there. What was found in the first frame is told and drawn
    /// (`preview.png` of the run) before it is followed through the rest, which takes minutes; it is kept with the labels.
    pub(crate) fn labels(
        console: &Console,
        chosen: Option<&Chosen>,
        sequence: &Sequence,
        run: &Path,
        stage: &Stage,
        warnings: &Warnings,
    ) -> anyhow::Result<Labels> {
        let chosen = chosen.ok_or_else(|| anyhow::anyhow!("no networks were chosen"))?;
        chosen.warn(warnings);
        let models = model_folders(
            chosen.detector()?,
            chosen.tracker,
            chosen.weights.as_deref(),
            &HubConfig::from_environment(),
            console.context.progress.as_ref(),
            &console.context.cancel,
        )
        .map_err(MasksError::from)?;
        let networks = chosen.masks(models);
        let found = networks.find_first(sequence, &console.context.cancel, warnings)?;
        let boxes = boxes_of(&found);
        atomic::write_json(&stage.dir().join(masks::FOUND), &boxes)?;
        masks::tell_found(console, run, sequence, &boxes)?;
        Ok(networks.follow(
            sequence,
            &found,
            console.context.progress.as_ref(),
            &console.context.cancel,
            warnings,
        )?)
    }

    /// What is found in the first frame of a run, told and drawn; nothing is followed and no mask is changed.
    pub(crate) fn preview(
        console: &Console,
        a: &NetsArguments,
        sequence: &Sequence,
        run: &Path,
    ) -> anyhow::Result<()> {
        let chosen = Chosen::new(console, a, Asked::Auto)?;
        let hub = HubConfig::from_environment();
        let folder = |model: Model| {
            model.folder(
                chosen.weights.as_deref(),
                &hub,
                console.context.progress.as_ref(),
                &console.context.cancel,
            )
        };
        let owlv2 = chosen.detector()?.map(folder).transpose().map_err(MasksError::from)?;
        // The tracker is not looked at.
        let networks = chosen.masks(ModelFolders { owlv2, sam2: PathBuf::new() });
        let warnings = Warnings::new();
        chosen.warn(&warnings);
        let found = networks.find_first(sequence, &console.context.cancel, &warnings)?;
        console.tell(&warnings);
        masks::tell_found(console, run, sequence, &boxes_of(&found))
    }

    /// Boxes with the ids that their labels get.
    fn boxes_of(found: &[Found]) -> Vec<FoundBox> {
        let of = |(i, f): (usize, &Found)| FoundBox {
            id: i as u16 + 1,
            name: f.name.clone(),
            score: f.score,
            box_px: [f.bbox.x0, f.bbox.y0, f.bbox.x1, f.bbox.y1],
        };
        found.iter().enumerate().map(of).collect()
    }

    /// A model by name. Errors of the networks go on as those of masks, which have their exit codes.
    fn known(name: &str) -> Result<Model, MasksError> {
        Ok(model(name)?)
    }

    pub(crate) fn run(console: &Console, a: &Models) -> anyhow::Result<()> {
        let hub = HubConfig::from_environment();
        match a {
            Models::List => {
                for m in MODELS {
                    let at = match hub.cached(&m) {
                        Some(cached) => format!("{} (commit {})", cached.folder.display(), cached.commit),
                        None => "not fetched".into(),
                    };
                    console.say(format!("{:15} {:40} {}\n{:15} {at}", m.name, m.repository, m.about, ""));
                }
            }
            Models::Fetch { models } => {
                let names: Vec<&str> = if models.is_empty() {
                    vec![DETECTOR, TRACKER]
                } else {
                    models.iter().map(String::as_str).collect()
                };
                for name in names {
                    let folder = hub
                        .fetch(&known(name)?, console.context.progress.as_ref(), &console.context.cancel)
                        .map_err(MasksError::from)?;
                    console.say(format!("{name}: {}", folder.display()));
                }
            }
        }
        Ok(())
    }
}

#[cfg(not(feature = "nets"))]
mod without_nets {
    use crate::cli::{Models, NetsArguments};
    use sms_cli::front::Console;
    use sms_cli::front::Device;
    use sms_core::metrics::Metrics;
    use sms_core::{InputError, Stage, Warnings};
    use sms_frames::Sequence;
    use sms_masks::Labels;
    use std::convert::Infallible;
    use std::path::Path;

    /// There is nothing to choose.
    pub(crate) struct Chosen(Infallible);

    impl Chosen {
        pub(crate) fn new(_: &Console, _: &NetsArguments, _: Device) -> anyhow::Result<Self> {
            Err(none().into())
        }

        pub(crate) fn settings(&self) -> String {
            match self.0 {}
        }

        pub(crate) fn told(&self, _: &mut Metrics) {
            match self.0 {}
        }
    }

    pub(crate) fn labels(
        _: &Console,
        _: Option<&Chosen>,
        _: &Sequence,
        _: &Path,
        _: &Stage,
        _: &Warnings,
    ) -> anyhow::Result<Labels> {
        Err(none().into())
    }

    pub(crate) fn preview(_: &Console, _: &NetsArguments, _: &Sequence, _: &Path) -> anyhow::Result<()> {
        Err(none().into())
    }

    pub(crate) fn run(_: &Console, _: &Models) -> anyhow::Result<()> {
        Err(none().into())
    }

    fn none() -> InputError {
        InputError::new(
            "this build has no networks",
            "--masks sam2",
            "build with `cargo build --release --features nets`, or use --masks geometry",
        )
    }
}
