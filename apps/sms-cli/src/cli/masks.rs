//! Arguments of masks and of the networks that make them.

use clap::{Args, Subcommand, ValueEnum};
use sms_pipeline::{MasksSource, NetworksRequest, TrackMode};
use std::path::PathBuf;

#[derive(Debug, Args)]
pub(crate) struct MasksArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Write preview.png, the first frame with masks, boxes and scores.
    ///
    /// With --objects, --box, --threshold or --max-overlap, detect again with these options; this needs no masks and
    /// changes none.
    #[arg(long)]
    pub preview: bool,
    #[command(flatten)]
    pub nets: NetsArguments,
}

#[derive(Debug, Subcommand)]
pub(crate) enum ModelsArguments {
    /// List the models, and the location of those already fetched.
    List,
    /// Fetch models into the Hugging Face cache.
    Fetch {
        /// Names from `sms models list` (default: the two that `--masks sam2` uses).
        models: Vec<String>,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum MasksName {
    /// Clusters of the fused depth; needs no weights.
    Geometry,
    /// Label images of the recording.
    Files,
    /// The truth of a generated recording (ablations only).
    Truth,
    /// Objects named by --objects, found in the first frame by OWLv2 and tracked by SAM 2.1 (feature `nets`).
    Sam2,
}

impl MasksName {
    /// Returns the library's source; `nets` has the options of the networks.
    pub(crate) fn source(self, nets: &NetsArguments) -> MasksSource {
        match self {
            Self::Geometry => MasksSource::Geometry,
            Self::Files => MasksSource::Files,
            Self::Truth => MasksSource::Truth,
            Self::Sam2 => MasksSource::Networks(nets.request()),
        }
    }
}

/// Tracking method of SAM 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum TrackName {
    /// With the memory of each object, as in the paper.
    Memory,
    /// Segments each image from a box projected by pose and depth; several times cheaper.
    Reprompt,
}

/// Options of `--masks sam2`.
#[derive(Debug, Args, Clone, Default)]
pub(crate) struct NetsArguments {
    /// Objects to detect: "mug, toy duck" (default: household objects).
    #[arg(long, value_name = "LIST")]
    pub objects: Option<String>,
    /// An object's box in the first frame (repeatable).
    ///
    /// For example --box "mug=x0,y0,x1,y1". Without --objects, nothing else is detected.
    #[arg(long = "box", value_name = "NAME=X0,Y0,X1,Y1")]
    pub boxes: Vec<String>,
    /// Lowest score of a detection, 0 to 1 (default: 0.2).
    #[arg(long, value_name = "SCORE")]
    pub threshold: Option<f64>,
    /// Highest overlap of two detections, 0 to 1 (default: 0.5).
    ///
    /// Of two that overlap more, the weaker one is dropped.
    #[arg(long, value_name = "SHARE", hide_short_help = true)]
    pub max_overlap: Option<f64>,
    /// Tracking method of SAM 2.
    ///
    /// By default memory on a GPU, reprompt on a CPU.
    #[arg(long, value_enum, value_name = "HOW")]
    pub track: Option<TrackName>,
    /// Name of the SAM 2.1 model (see `sms models list`).
    #[arg(long, value_name = "MODEL")]
    pub sam2: Option<String>,
    /// Folder of the model files (default: the Hugging Face cache).
    #[arg(long, value_name = "DIR")]
    pub weights: Option<PathBuf>,
}

impl NetsArguments {
    /// Returns the library's request.
    pub(crate) fn request(&self) -> NetworksRequest {
        let a = self.clone();
        NetworksRequest {
            objects: a.objects,
            boxes: a.boxes,
            threshold: a.threshold,
            max_overlap: a.max_overlap,
            tracking: a.track.map(|track| match track {
                TrackName::Memory => TrackMode::Memory,
                TrackName::Reprompt => TrackMode::Reprompt,
            }),
            sam2: a.sam2,
            weights: a.weights,
        }
    }
}
