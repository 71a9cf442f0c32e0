//! Posed RGB-D recordings: readers, checks, resampling, normals and world alignment.
//!
//! [`Recording::open`] opens a folder (nerfstudio's `transforms.json` with depth, or TUM RGB-D) and finds faults before
//! any long work; [`load`] turns it into a [`Sequence`]: pinhole frames at scan resolution with normals, in a
//! metric world with z up.
//!
//! # Conventions
//! The recording's own world is `R`, ours is `W`; [`Sequence::x_world_recording`] carries points from `R` to `W`.
//! Camera axes are OpenCV's and pixel centres lie at +0.5, independent of the recording.
//!
//! ```no_run
//! use sms_core::{Cancel, StageContext, Warnings};
//! use sms_frames::{LoadSettings, ReadOptions, Recording, load};
//! let recording = Recording::open("scan_of_my_desk", &ReadOptions::default())?;
//! let settings = LoadSettings { long_side: 320, ..LoadSettings::default() };
//! let sequence = load(&recording, &settings, StageContext::quiet(&Cancel::new(), &Warnings::new()))?;
//! assert_eq!(sequence.frames[0].color.width.max(sequence.frames[0].color.height), 320);
//! # Ok::<(), sms_frames::FramesError>(())
//! ```

mod align;
mod attached;
mod cache;
mod check;
mod colors;
mod depth_file;
mod exposure;
mod floor;
mod following;
mod formats;
mod gaps;
mod keyframes;
mod lens;
mod load;
mod normals;
mod options;
mod pattern;
mod plane_fit;
mod recording;
mod resample;
mod rigid;
mod sequence;

pub use cache::load_depths;
pub use check::{CheckReport, Finding, OverlapError, PixelCenterFit, ReadingFit, Severity, UnitFit, check};
pub use colors::recorded_colors;
pub use floor::{FloorAt, floor_at};
pub use following::FollowedFrames;
pub use lens::{Distortion, Lens};
pub use load::{load, load_frame};
pub use normals::{normals_at, normals_from_depth};
pub use options::{Align, Axes, DepthNoise, LoadSettings, PoseDirection, ReadOptions};
pub use recording::{Notice, RecordedFrame, Recording, RecordingFormat};
pub use resample::{resample_depth, resize_color, target_intrinsics, undistort_color};
pub use sequence::{Frame, Sequence, evenly_spread};

/// Errors of this crate: bad input, unreadable files, an interruption.
pub type FramesError = sms_core::CoreError;
