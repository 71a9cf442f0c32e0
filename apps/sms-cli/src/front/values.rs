//! Argument values that several commands share.

use clap::ValueEnum;
use sms_gaussians::Preset;
use sms_poses::PosesMode;
use sms_synth::{CameraPath, Sensor};
use sms_target::TargetEngine;

/// Preset of the scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PresetName {
    /// 200 px, 300 steps: a quick test of a recording.
    Draft,
    /// 320 px, 600 steps: objects and planning (default).
    Standard,
    /// 640 px, at most 2000 steps: thin parts and sharp views; four times the pixels of standard, and up to thirteen times the steps × pixels.
    Fine,
}

impl PresetName {
    /// Returns the library's preset.
    pub fn preset(self) -> Preset {
        match self {
            Self::Draft => Preset::Draft,
            Self::Standard => Preset::Standard,
            Self::Fine => Preset::Fine,
        }
    }
}

/// Sensor of a generated recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum SensorName {
    /// Orbbec Gemini 2, structured-light stereo, with exact poses and colour at rest (default).
    Gemini2,
    /// Intel RealSense D435, active stereo.
    D435,
    /// Microsoft Azure Kinect, time of flight.
    AzureKinect,
    /// Asus Xtion Pro Live, structured light.
    Xtion,
    /// A phone's lidar: 256 × 192 depth from few dots, with confidence.
    PhoneLidar,
}

impl SensorName {
    /// Returns the library's preset.
    pub fn sensor(self) -> Sensor {
        match self {
            Self::Gemini2 => Sensor::Gemini2,
            Self::D435 => Sensor::D435,
            Self::AzureKinect => Sensor::AzureKinect,
            Self::Xtion => Sensor::Xtion,
            Self::PhoneLidar => Sensor::PhoneLidar,
        }
    }
}

/// Refinement of the camera poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PosesName {
    /// Refine the recorded poses, and use the result if held-out frames agree significantly better with it.
    Auto,
    /// Use the recorded poses.
    Given,
    /// Use refined poses.
    Refine,
    /// Estimate the poses from the images alone, then refine them as `auto` does; also what `auto` does without recorded poses.
    Estimate,
}

impl PosesName {
    /// Returns the library's mode.
    pub fn mode(self) -> PosesMode {
        match self {
            Self::Given => PosesMode::Given,
            Self::Refine => PosesMode::Refine,
            Self::Auto => PosesMode::Auto,
            Self::Estimate => PosesMode::Estimate,
        }
    }
}

/// Engine of the target world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EngineName {
    /// The planner's engine at a quarter of its time step; tables say "same engine".
    Rapier,
    /// PhysX with small contact offsets and split steps, for precision (feature physx).
    Physx,
    /// PhysX with its default parameters (feature physx).
    PhysxStock,
    /// MuJoCo (feature mujoco; SMS_MUJOCO is the folder of its library).
    Mujoco,
}

impl EngineName {
    /// Returns the library's engine.
    pub fn engine(self) -> TargetEngine {
        match self {
            Self::Rapier => TargetEngine::Rapier,
            Self::Physx => TargetEngine::Physx,
            Self::PhysxStock => TargetEngine::PhysxStock,
            Self::Mujoco => TargetEngine::Mujoco,
        }
    }
}

/// Camera path of a generated billiards recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PathName {
    /// Heights from 0.25 to 0.6 m, which show hollows and the floor between objects.
    High,
    /// The paper's heights, 0.1 to 0.25 m.
    Paper,
}

impl PathName {
    /// Returns the path of a billiards recording.
    pub fn path(self) -> CameraPath {
        match self {
            Self::High => CameraPath::default(),
            Self::Paper => CameraPath::paper(),
        }
    }
}
