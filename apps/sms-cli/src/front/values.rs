//! Values of arguments that several commands have.

use clap::ValueEnum;
use sms_gaussians::Preset;
use sms_poses::PosesMode;
use sms_synth::CameraPath;
use sms_target::TargetEngine;

/// Preset of the scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PresetName {
    /// 200 px, at most 100 + 10 a frame + 150 steps: whether a recording is any good.
    Draft,
    /// 320 px, at most 200 + 30 a frame + 300 steps: objects and planning. The default.
    Standard,
    /// 640 px, at most 400 + 30 a frame + 1000 steps: thin parts, views to look at; six times standard's steps × pixels.
    Fine,
}

impl PresetName {
    /// The library's preset.
    pub fn preset(self) -> Preset {
        match self {
            Self::Draft => Preset::Draft,
            Self::Standard => Preset::Standard,
            Self::Fine => Preset::Fine,
        }
    }
}

/// Whether camera poses are refined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RefinePoses {
    /// Use the poses as they are.
    Off,
    /// Use refined poses.
    On,
    /// Use refined poses where held-out frames agree significantly better with them.
    Auto,
}

impl RefinePoses {
    /// The library's mode.
    pub fn mode(self) -> PosesMode {
        match self {
            Self::Off => PosesMode::Off,
            Self::On => PosesMode::On,
            Self::Auto => PosesMode::Auto,
        }
    }
}

/// Target engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum EngineName {
    /// The planner's engine in double precision at a quarter of the step: "same engine" in every table.
    Rapier,
    /// PhysX, precise: small offsets, split steps (feature physx).
    Physx,
    /// PhysX with the engine's defaults (feature physx).
    PhysxStock,
    /// MuJoCo (feature mujoco; SMS_MUJOCO names its library).
    Mujoco,
}

impl EngineName {
    /// The library's engine.
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
    /// Heights from 0.25 to 0.6 m, from which hollows and the floor between objects are seen.
    High,
    /// The paper's heights, 0.1 to 0.25 m.
    Paper,
}

impl PathName {
    /// The path of a billiards recording.
    pub fn path(self) -> CameraPath {
        match self {
            Self::High => CameraPath::default(),
            Self::Paper => CameraPath::paper(),
        }
    }
}
