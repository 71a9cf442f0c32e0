//! Loaded sequences: posed frames in one world.

use crate::{DepthNoise, normals_from_depth};
use glamx::DPose3;
use rayon::prelude::*;
use sms_core::{Camera, ColorImage, DepthImage, Image, NormalImage};
use std::path::PathBuf;
use std::sync::Arc;

/// One posed RGB-D frame; colour, depth and normals have the size of `camera.intrinsics`.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Position in the sequence, from 0.
    pub index: usize,
    /// Seconds since the first frame, where the recording has times.
    pub time_s: Option<f64>,
    /// Intrinsics and pose in the world `W`.
    pub camera: Camera,
    /// Colour; of frames that were loaded together, at the exposure that they have in common.
    pub color: ColorImage,
    /// Colour as recorded over `color`, per channel: the frame's own exposure. 1 if all frames have the same.
    pub gain: [f32; 3],
    /// Depth along the camera's z axis in metres, 0 where there is none.
    pub depth: DepthImage,
    /// Noise of the depth.
    pub depth_noise: DepthNoise,
    /// Unit normals from depth in the camera frame `C`, facing the camera; zero where unknown.
    pub normal_c: NormalImage,
    /// Pixels that show something attached to the camera, such as a gripper, in place of the scene. They have no depth and no normals.
    pub attached: Option<Arc<Image<bool>>>,
    /// The colour file this frame came from.
    pub color_path: PathBuf,
    /// The label image that came with the recording.
    pub mask_path: Option<PathBuf>,
}

impl Frame {
    /// Makes a frame of images alone: of an unknown time and file, with the default noise of depth.
    pub fn new(camera: Camera, color: ColorImage, depth: DepthImage, normal_c: NormalImage) -> Self {
        Self {
            index: 0,
            time_s: None,
            camera,
            color,
            gain: [1.0; 3],
            depth,
            depth_noise: DepthNoise::default(),
            normal_c,
            attached: None,
            color_path: PathBuf::new(),
            mask_path: None,
        }
    }

    /// Returns whether pixel `index`, counted row by row, shows the scene rather than something attached to the camera.
    pub fn shows_scene(&self, index: usize) -> bool {
        self.attached.as_ref().is_none_or(|attached| !attached.data[index])
    }
}

/// Returns up to `most` indices spread evenly over `count` ones, from the first on.
pub fn evenly_spread(count: usize, most: usize) -> Vec<usize> {
    let taken = most.min(count);
    (0..taken).map(|k| k * count / taken).collect()
}

/// A loaded recording: frames at scan resolution in a z-up metric world.
#[derive(Debug, Clone)]
pub struct Sequence {
    /// The frames in recorded order.
    pub frames: Vec<Frame>,
    /// `X_world_recording`: carries points of the recording's own world to ours.
    pub x_world_recording: DPose3,
    /// Where the recording lies.
    pub source: PathBuf,
}

impl Sequence {
    /// Returns the number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Returns whether there are no frames.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Sets the depth noise of all frames, and fits their normals again: the noise tells which neighbours lie on one surface.
    pub fn set_depth_noise(&mut self, noise: DepthNoise, normal_radius: usize) {
        self.frames.par_iter_mut().for_each(|frame| {
            frame.depth_noise = noise;
            frame.normal_c =
                normals_from_depth(&frame.depth, &frame.camera.intrinsics, &noise, normal_radius);
        });
    }

    /// Returns the indices of the frames trained on when every `holdout`-th frame is held out.
    pub fn trained(&self, holdout: usize) -> Vec<usize> {
        (0..self.len()).filter(|&i| !Self::is_held_out(i, holdout)).collect()
    }

    /// Returns the indices of the held-out frames.
    pub fn held_out(&self, holdout: usize) -> Vec<usize> {
        (0..self.len()).filter(|&i| Self::is_held_out(i, holdout)).collect()
    }

    /// Returns whether frame `index` is held out of training if every `holdout`-th frame is (0: none). The first frame is
    /// always used for training.
    pub fn is_held_out(index: usize, holdout: usize) -> bool {
        index > 0 && holdout > 0 && index % holdout == holdout - 1
    }
}
