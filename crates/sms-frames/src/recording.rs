//! Opened recordings, before their images are loaded.

use crate::depth_file::read_depth;
use crate::{Axes, FramesError, Lens, PoseDirection, ReadOptions, formats};
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{DepthImage, InputError};
use std::path::{Path, PathBuf};

/// The format of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordingFormat {
    /// `transforms.json` with depth, as nerfstudio reads it.
    Nerfstudio,
    /// `rgb.txt`, `depth.txt` and, with poses, `groundtruth.txt` of the TUM RGB-D benchmark.
    TumRgbd,
}

impl RecordingFormat {
    /// Returns the name for messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nerfstudio => "nerfstudio transforms.json",
            Self::TumRgbd => "TUM RGB-D",
        }
    }
}

/// One frame of a recording, before its images are read.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordedFrame {
    /// Colour image, PNG or JPEG.
    pub color_path: PathBuf,
    /// Depth image, 16-bit PNG.
    pub depth_path: PathBuf,
    /// Label image, where the recording has one.
    pub mask_path: Option<PathBuf>,
    /// Lens of the colour image at its recorded size, pixel centres at +0.5.
    pub color_lens: Lens,
    /// Lens of the depth image at its recorded size; depth and colour share the camera frame.
    pub depth_lens: Lens,
    /// Pose of the camera (OpenCV axes) in the recording's world `R`.
    pub x_rc: DPose3,
    /// Largest entry of |RᵀR − I| that was removed from the recorded rotation.
    pub pose_rounding: f64,
    /// Seconds since the first frame.
    pub time_s: Option<f64>,
}

/// An assumption of the reader; becomes a warning when the recording is loaded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Notice {
    /// Stable identifier.
    pub code: &'static str,
    /// The assumption.
    pub message: String,
    /// How to state the value instead.
    pub cure: String,
}

/// An opened recording: paths, lenses and poses of every frame, all files present and of matching size.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Its folder.
    pub root: PathBuf,
    /// Its format.
    pub format: RecordingFormat,
    /// Its frames in recorded order, at least one.
    pub frames: Vec<RecordedFrame>,
    /// Metres of one unit of the depth images.
    pub depth_unit_m: f64,
    /// Camera axes the poses were read with.
    pub axes: Axes,
    /// Direction the pose matrices were read with.
    pub poses: PoseDirection,
    /// Whether the frames have poses. Without, [`RecordedFrame::x_rc`] is the identity.
    pub has_poses: bool,
    /// Centre of pixel (0, 0) that the recorded intrinsics were read with.
    pub pixel_center: f64,
    /// The up direction of the recording's world, if the recording states it.
    pub world_up_r: Option<DVec3>,
    /// Whether the recording declares its world to be metric, z up, with the support at z = 0.
    pub world_is_aligned: bool,
    /// The reader's assumptions.
    pub notices: Vec<Notice>,
    /// The options it was opened with.
    pub options: ReadOptions,
}

impl Recording {
    /// Opens the recording in `dir`; `transforms.json` makes it a nerfstudio one, `rgb.txt` and `depth.txt` (and
    /// `groundtruth.txt` with its poses) a TUM RGB-D one. Checks that every file exists and reads every image header, so that faults
    /// are found before any long work.
    ///
    /// # Errors
    /// [`sms_core::InputError`] (inside [`FramesError`]) naming the file and the cure.
    pub fn open(dir: impl AsRef<Path>, options: &ReadOptions) -> Result<Self, FramesError> {
        let dir = dir.as_ref();
        check_options(options)?;
        if dir.is_file() && dir.file_name().is_some_and(|n| n == "transforms.json") {
            let parent = dir.parent().filter(|p| !p.as_os_str().is_empty());
            return Self::open(parent.unwrap_or(Path::new(".")), options);
        }
        if !dir.is_dir() {
            let cure = "give the folder that holds transforms.json, or rgb.txt and depth.txt";
            return Err(InputError::new("this recording folder does not exist", dir, cure).into());
        }
        if dir.join("transforms.json").is_file() {
            formats::nerfstudio::open(dir, options)
        } else if dir.join("rgb.txt").is_file() || dir.join("groundtruth.txt").is_file() {
            formats::tum::open(dir, options)
        } else {
            let what = "this folder does not hold a recording of a known format";
            let cure = "it must hold transforms.json (nerfstudio, with depth_file_path), or rgb.txt and \
                        depth.txt (TUM RGB-D)";
            Err(InputError::new(what, dir, cure).into())
        }
    }

    /// Reads the depth image of a frame in metres at its recorded size, distortion included; 0 where there is no
    /// measurement or it lies outside the options' depth range.
    ///
    /// # Errors
    /// When the file is missing, damaged, or holds no depth at all.
    pub fn read_depth_m(&self, index: usize) -> Result<DepthImage, FramesError> {
        let path = &self.frames[index].depth_path;
        let raw = read_depth(path)?;
        if raw.data.iter().all(|&v| v == 0) {
            let cure =
                "record or export this frame again, remove it from the recording, or set skip_empty_depth";
            return Err(InputError::new("the depth image is empty: every pixel is 0", path, cure).into());
        }
        let (low, high) = (self.options.min_depth_m as f32, self.options.max_depth_m as f32);
        let unit = self.depth_unit_m;
        let depth = raw.map(|&v| {
            let z = (f64::from(v) * unit) as f32;
            if z >= low && z <= high { z } else { 0.0 }
        });
        if depth.data.iter().all(|&z| z == 0.0) {
            let most = raw.data.iter().copied().max().unwrap_or(0);
            let what =
                format!("no depth lies between {low} and {high} m (the largest value is {most} × {unit} m)");
            let cure = "check the depth unit (depth_unit_scale_factor) with `sms check`, or set min_depth_m and \
                        max_depth_m";
            return Err(InputError::new(what, path, cure).into());
        }
        Ok(depth)
    }

    /// Returns the recording with these poses in place of its own, in a world of theirs: `x_rc` of each frame. Frames without a
    /// pose are left out.
    pub fn with_poses(mut self, x_rc: &[Option<DPose3>]) -> Self {
        let posed = |(frame, x_rc): (RecordedFrame, &Option<DPose3>)| {
            x_rc.map(|x_rc| RecordedFrame { x_rc, pose_rounding: 0.0, ..frame })
        };
        self.frames = self.frames.into_iter().zip(x_rc).filter_map(posed).collect();
        (self.axes, self.poses, self.has_poses) = (Axes::Opencv, PoseDirection::CameraToWorld, true);
        (self.world_up_r, self.world_is_aligned) = (None, false);
        self
    }

    /// The error for a recording without any depth.
    pub(crate) fn without_depth(&self) -> InputError {
        InputError::new("every depth image is empty", &self.root, "record again with depth")
    }

    /// The error for a recording that is used without any camera poses.
    pub fn without_poses(&self) -> InputError {
        let cure = "have them estimated from the images: --poses estimate";
        InputError::new("the recording has no camera poses, or they are ignored", &self.root, cure)
    }

    /// Returns the index of the recorded frame of a loaded frame.
    pub fn index_of(&self, frame: &crate::Frame) -> Option<usize> {
        self.frames.iter().position(|f| f.color_path == frame.color_path)
    }
}

/// Checks the ranges of the options.
pub(crate) fn check_options(options: &ReadOptions) -> Result<(), FramesError> {
    let bad = |what: String, cure: &str| Err(InputError::new(what, "the read options", cure).into());
    if let Some(unit) = options.depth_unit_m
        && !(unit.is_finite() && unit > 0.0)
    {
        return bad(format!("a depth unit of {unit} m is not possible"), "use 0.001 for millimetres");
    }
    if let Some(center) = options.pixel_center
        && !(0.0..=1.0).contains(&center)
    {
        return bad(format!("pixel_center = {center} is not possible"), "use 0.5 or 0");
    }
    if options.min_depth_m.is_nan()
        || options.max_depth_m.is_nan()
        || options.min_depth_m >= options.max_depth_m
    {
        return bad(
            format!("the depth range {} to {} m is empty", options.min_depth_m, options.max_depth_m),
            "set min_depth_m below max_depth_m",
        );
    }
    Ok(())
}
