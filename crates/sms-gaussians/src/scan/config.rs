//! Settings of the scan.

use crate::{LearningRates, LossWeights, TrainConfig};
use serde::{Deserialize, Serialize};
use sms_frames::DepthNoise;
use sms_surface::{SAME_SURFACE_COSINE, SurfaceConfig, SurfaceTolerance};

/// Trade-off between time and quality of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// For experiments.
    Draft,
    /// The default: a quarter of the paper's camera.
    #[default]
    Standard,
    /// The paper's half resolution.
    Fine,
}

impl Preset {
    /// Longer side of the frames in pixels.
    pub fn long_side(self) -> usize {
        match self {
            Self::Draft => 200,
            Self::Standard => 320,
            Self::Fine => 640,
        }
    }

    /// Returns the name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Standard => "standard",
            Self::Fine => "fine",
        }
    }
}

impl std::str::FromStr for Preset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut all = [Self::Draft, Self::Standard, Self::Fine].into_iter();
        all.find(|preset| preset.name() == text)
            .ok_or_else(|| format!("unknown preset `{text}`; use draft, standard or fine"))
    }
}

/// Settings of seeding (paper, Section "Scan").
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SeedingConfig {
    /// Distance between neighbouring Gaussians in pixels of the frame that seeds them.
    pub spacing_px: f64,
    /// Distance on edges of colour or depth, as a share of `spacing_px`.
    pub edge_spacing: f64,
    /// Greatest distance where the surface is flat and of one colour, as a multiple of the distances above (schedule `fused`); 1 for
    /// no greater distances.
    pub coarsest: f32,
    /// Difference of a colour channel (0..1) above which a surface is not of one colour.
    pub color_step: f32,
    /// Change of brightness (0..1, Sobel, per pixel) above which a pixel counts as an edge.
    pub edge_threshold: f32,
    /// Later frames seed where the accumulated opacity is below this.
    pub alpha_below: f32,
    /// Later frames also seed where the rendered depth is behind the measured depth by more than this, metres.
    pub min_tolerance_m: f64,
    /// The difference must also exceed this number of standard deviations of the depth noise. So must heights over a plane for a surface
    /// not to be flat.
    pub tolerance_sigmas: f64,
    /// No Gaussian is seeded within this radius (metres) of another one, nor within the spacing (schedule `sequential`).
    pub radius_m: f64,
    /// In-plane standard deviation of a new disc as a share of the spacing.
    pub sigma_of_spacing: f64,
    /// Thickness of a new disc as a share of the in-plane standard deviation that it has without `coarsest`.
    pub thickness: f64,
    /// Opacity of a new Gaussian.
    pub opacity: f32,
    /// Surfaces with a smaller cosine between normal and ray are left to other frames.
    pub min_cosine: f64,
    /// Whether Gaussians are also placed where colour was recorded but no depth, with the schedule `fused`. They are marked
    /// and never part of a body.
    pub unmeasured: bool,
}

impl Default for SeedingConfig {
    fn default() -> Self {
        let surface = SurfaceConfig::default();
        Self {
            spacing_px: surface.spacing_px,
            edge_spacing: surface.edge_spacing,
            coarsest: 4.0,
            color_step: 0.05,
            edge_threshold: surface.edge_threshold,
            alpha_below: 0.6,
            min_tolerance_m: surface.tolerance.min_m,
            tolerance_sigmas: surface.tolerance.sigmas,
            radius_m: 0.0005,
            sigma_of_spacing: 0.6,
            thickness: 0.02,
            opacity: 0.5,
            min_cosine: surface.min_cosine,
            unmeasured: true,
        }
    }
}

/// Settings of the removal of Gaussians.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PruningConfig {
    /// Gaussians below this opacity are removed halfway through a frame and at its end; with the schedule `fused`, as rates begin to fall and at
    /// the end.
    pub opacity_below: f32,
    /// Whether to remove Gaussians in front of the measured depth by more than the seeding tolerance (schedule `sequential`;
    /// the fused surface has none).
    pub floaters: bool,
}

impl Default for PruningConfig {
    fn default() -> Self {
        Self { opacity_below: 0.1, floaters: true }
    }
}

/// Settings of early stopping.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StopConfig {
    /// Whether frames stop early.
    pub enabled: bool,
    /// Number of batches in each of the two consecutive windows for comparing mean losses.
    pub window: usize,
    /// A frame is done when its loss falls by less than this share from one window to the next.
    pub min_gain: f32,
}

impl Default for StopConfig {
    fn default() -> Self {
        Self { enabled: true, window: 3, min_gain: 0.02 }
    }
}

/// Order in which a scan finds geometry and colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScanOrder {
    /// All frames are fused into one surface, Gaussians are placed on it, and all frames are trained on together.
    #[default]
    Fused,
    /// Frame after frame is seeded and optimised while earlier ones are replayed (paper, Section "Scan"); the
    /// Gaussians move onto the fused surface before and after the refinement over all frames.
    Sequential,
}

/// Training with the schedule `fused`. Rates are constant, and fall in the last third of the steps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FusedConfig {
    /// Greatest number of steps over all frames.
    pub steps: usize,
    /// Rates fall as soon as the errors of a few frames that are not trained on until then have not fallen by this share for 200 steps;
    /// 0 to take all steps.
    pub min_gain: f32,
    /// Learning rates of the first step.
    pub rates: LearningRates,
}

impl Default for FusedConfig {
    fn default() -> Self {
        // Discs slide and turn on the fused surface, and hardly leave it; those without depth do so across the ray that they were
        // placed on. Twice these rates of positions and scales have 0.2 dB more and an F1 of 0.002 less on generated scenes, on real
        // recordings 0.6 and 0.9 dB more. Free discs at 3e-6 m leave the surface by 0.24 instead of 0.16 mm without better pictures; with 0, it is 0.13 mm
        // and F1 is 0.001 lower (experiments/studies/scan/fused.md).
        let rates = LearningRates {
            position: 2.5e-5,
            off_plane: 0.03,
            log_scale: 1e-2,
            harmonics: 1e-2,
            ..training().rates
        };
        Self { steps: 600, min_gain: 0.01, rates }
    }
}

/// Settings of the scan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScanConfig {
    /// Order in which geometry and colour are found.
    pub schedule: ScanOrder,
    /// Training with the schedule `fused`.
    pub fused: FusedConfig,
    /// Largest number of steps on the first frame.
    pub steps_first: usize,
    /// Largest number of steps on each later frame.
    pub steps_frame: usize,
    /// Largest number of steps over all frames together at the end of the schedule `sequential`.
    pub final_steps: usize,
    /// Share to which learning rates fall exponentially over the steps on all frames together; with the schedule `fused`, over the last
    /// third of them.
    pub final_decay: f32,
    /// Steps between checks of the clock, the losses and cancellation.
    pub batch_steps: usize,
    /// Share of a frame's steps on the frame itself; the rest replays earlier frames.
    pub current_share: f64,
    /// Seeding.
    pub seeding: SeedingConfig,
    /// Pruning.
    pub pruning: PruningConfig,
    /// Whether to move the Gaussians onto the fused surface of all frames, before and after the refinement of the schedule
    /// `sequential`.
    pub fuse_depth: bool,
    /// Whether to correct labels that contradict the masks, before and after the refinement.
    pub correct_labels: bool,
    /// Early stopping with the schedule `sequential`.
    pub stop: StopConfig,
    /// Greatest number of Gaussians with the schedule `sequential`; with `fused` it follows from the surface.
    pub max_gaussians: usize,
    /// Every `holdout`-th frame is excluded from training and seeding and used to measure quality; 0 for none.
    pub holdout: usize,
    /// Seconds between checkpoints within a frame. There is also one at the end, and one after each frame unless the
    /// last checkpoint is recent (a second, or a fifth of this setting).
    pub checkpoint_seconds: f64,
    /// Losses, and the learning rates of the schedule `sequential`.
    pub train: TrainConfig,
}

impl Default for ScanConfig {
    fn default() -> Self {
        Self {
            schedule: ScanOrder::default(),
            fused: FusedConfig::default(),
            steps_first: 1000,
            steps_frame: 100,
            final_steps: 300,
            final_decay: 0.1,
            batch_steps: 10,
            current_share: 0.4,
            seeding: SeedingConfig::default(),
            pruning: PruningConfig::default(),
            fuse_depth: true,
            correct_labels: true,
            stop: StopConfig::default(),
            max_gaussians: 60_000,
            holdout: 0,
            checkpoint_seconds: 5.0,
            train: training(),
        }
    }
}

/// Returns the losses and rates of the schedule `sequential`. Positions start and end on the fused depth, so they hardly move (see
/// `fusion`). A normal weight of 0.1 instead of 0.03 costs 0.3 dB. A depth weight of 10 instead of 3 costs 0.1
/// to 0.2 dB, on a real recording 0.6 to 0.9 dB, where it makes depth better by 0.5 mm (experiments/studies/scan/fused.md).
fn training() -> TrainConfig {
    TrainConfig {
        weights: LossWeights { depth: 3.0, normal: 0.03, ..LossWeights::default() },
        rates: LearningRates { position: 3e-6, color: 5e-3, ..LearningRates::default() },
        ..TrainConfig::default()
    }
}

impl ScanConfig {
    /// The settings of a preset.
    pub fn preset(preset: Preset) -> Self {
        // Measured on the test's recording at 320 × 200, 24 frames, 1 mm of noise: 900 steps (200, then 30 per
        // frame) reach the surface error, label accuracy and, within 0.5 dB, the PSNR of 2700 steps.
        let standard = Self { steps_first: 200, steps_frame: 30, ..Self::default() };
        match preset {
            Preset::Draft => Self { steps_first: 100, steps_frame: 10, final_steps: 150, ..standard }
                .with_fused(300, standard.fused.rates),
            Preset::Standard => standard,
            // For three scenes at 640 × 400, 60 steps per frame raise PSNR by 0.02 to 0.04 dB, but the depth of
            // held-out views is 3 to 5 % worse and F1 0.001 to 0.003 lower. The refinement makes up for fewer steps
            // (experiments/studies/gpu.md).
            Preset::Fine => Self {
                steps_first: 400,
                final_steps: 1000,
                seeding: SeedingConfig { spacing_px: 3.2, ..standard.seeding },
                max_gaussians: 200_000,
                ..standard
            }
            // A real recording gains 2.2 dB from 600 to 2000 steps; generated scenes stall before. What slides on a curved surface leaves it:
            // positions are slower. Twice the rate of scales gains 0.6 dB on the recording (experiments/studies/scan/fused.md).
            .with_fused(2000, LearningRates { position: 1e-5, log_scale: 2e-2, ..standard.fused.rates }),
        }
    }

    /// Sets the number of steps over all frames and the rates of the schedule `fused`.
    fn with_fused(mut self, steps: usize, rates: LearningRates) -> Self {
        self.fused = FusedConfig { steps, rates, ..self.fused };
        self
    }

    /// Returns the greatest number of steps over all frames together.
    pub(crate) fn last_steps(&self) -> usize {
        match self.schedule {
            ScanOrder::Fused => self.fused.steps,
            ScanOrder::Sequential => self.final_steps,
        }
    }

    /// Returns the learning rates of the first step over all frames together.
    pub(crate) fn last_rates(&self) -> LearningRates {
        match self.schedule {
            ScanOrder::Fused => self.fused.rates,
            ScanOrder::Sequential => self.train.rates,
        }
    }

    /// Returns the first slot of the schedule: with `fused`, all frames are optimised together from the start.
    pub(crate) fn first_slot(&self, frames: usize) -> usize {
        if self.schedule == ScanOrder::Fused { frames } else { 0 }
    }

    /// Returns the settings of the fused surface.
    pub(crate) fn surface(&self) -> SurfaceConfig {
        let seeding = &self.seeding;
        SurfaceConfig {
            tolerance: SurfaceTolerance { min_m: seeding.min_tolerance_m, sigmas: seeding.tolerance_sigmas },
            spacing_px: seeding.spacing_px,
            edge_spacing: seeding.edge_spacing,
            edge_threshold: seeding.edge_threshold,
            min_cosine: seeding.min_cosine,
            // Trained Gaussians have the normal of their surface.
            first_alike: match self.schedule {
                ScanOrder::Fused => SurfaceConfig::default().first_alike,
                ScanOrder::Sequential => SAME_SURFACE_COSINE,
            },
        }
    }

    /// Returns the least difference in depth at depth `z_m` that separates two surfaces, metres.
    pub fn tolerance_m(&self, noise: &DepthNoise, z_m: f64) -> f64 {
        self.surface().tolerance.at(noise, z_m)
    }
}
