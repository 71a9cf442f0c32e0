//! Errors of the stage.

use sms_core::{CoreError, ErrorKind, InputError, StageError};

/// Errors of the entities stage.
#[derive(Debug, thiserror::Error)]
pub enum EntitiesError {
    /// The sequence has no frames.
    #[error("there are no frames to build objects from")]
    NoFrames,
    /// The labels belong to another sequence.
    #[error("there are {maps} label maps for {frames} frames; make the masks again for this recording")]
    LabelMapCount {
        /// Number of label maps.
        maps: usize,
        /// Number of frames.
        frames: usize,
    },
    /// A label map has another size than its frame.
    #[error(
        "label map {frame} is {}×{} but its frame is {}×{}; make the masks again at this size",
        .map.0, .map.1, .depth.0, .depth.1
    )]
    LabelMapSize {
        /// Index of the frame.
        frame: usize,
        /// Width and height of the label map, pixels.
        map: (usize, usize),
        /// Width and height of the frame, pixels.
        depth: (usize, usize),
    },
    /// A depth is negative or not finite.
    #[error("the depth of frame {frame} holds {depth}; give metres, and 0 where there is none")]
    InvalidDepth {
        /// Index of the frame.
        frame: usize,
        /// The depth, metres.
        depth: f32,
    },
    /// Bad settings or files.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Files or interruption.
    #[error(transparent)]
    Core(#[from] CoreError),
}

impl StageError for EntitiesError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Input(e) => e.kind(),
            Self::Core(e) => e.kind(),
            Self::NoFrames
            | Self::LabelMapCount { .. }
            | Self::LabelMapSize { .. }
            | Self::InvalidDepth { .. } => ErrorKind::Other,
        }
    }
}
