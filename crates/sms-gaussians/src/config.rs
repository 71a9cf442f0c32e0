//! Settings of one training step: weights of the losses and learning rates.

use serde::{Deserialize, Serialize};

/// Weights of the loss terms (paper, Section "Scan").
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossWeights {
    /// Weight of the colour term as a whole.
    pub color: f32,
    /// λ_photo: the share of 1 − SSIM in the colour term; the rest is the mean absolute error.
    pub ssim: f32,
    /// Weight of the isotropic term, whose value is in metres.
    pub isotropic: f32,
    /// Weight of the depth term, whose value is in metres.
    pub depth: f32,
    /// λ_normal.
    pub normal: f32,
    /// λ_scale: weight of the mean smallest scale, whose value is in metres.
    pub flat: f32,
    /// Weight of the cross-entropy.
    pub segmentation: f32,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { color: 1.0, ssim: 0.2, isotropic: 1.0, depth: 1.0, normal: 0.1, flat: 0.1, segmentation: 1.0 }
    }
}

/// Adam's learning rates, in the optimiser's units per step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearningRates {
    /// Positions, metres.
    pub position: f32,
    /// Logarithms of the scales.
    pub log_scale: f32,
    /// Quaternion components.
    pub rotation: f32,
    /// Share (0 to 1) of the steps out of the plane of a disc: of positions along its normal, and of turns about axes in its plane.
    /// With 0, discs remain on the surface that they were placed on.
    pub off_plane: f32,
    /// Logits of the opacities.
    pub opacity: f32,
    /// Colours.
    pub color: f32,
    /// Dependence of colours on the viewing direction (spherical harmonics up to degree 2); 0 for none.
    pub harmonics: f32,
    /// Affinity features.
    pub affinity: f32,
    /// Weights and biases of the classifier.
    pub classifier: f32,
}

impl LearningRates {
    /// All rates times `share`; `off_plane` is no rate and remains.
    #[must_use]
    pub fn scaled(&self, share: f32) -> Self {
        Self {
            position: self.position * share,
            log_scale: self.log_scale * share,
            rotation: self.rotation * share,
            off_plane: self.off_plane,
            opacity: self.opacity * share,
            color: self.color * share,
            harmonics: self.harmonics * share,
            affinity: self.affinity * share,
            classifier: self.classifier * share,
        }
    }
}

impl Default for LearningRates {
    fn default() -> Self {
        Self {
            position: 1e-4,
            log_scale: 5e-3,
            rotation: 2e-3,
            off_plane: 1.0,
            opacity: 0.05,
            color: 2.5e-3,
            harmonics: 0.0,
            affinity: 1e-2,
            classifier: 1e-2,
        }
    }
}

/// Definition of the rendered depth in the depth term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthTerm {
    /// Σ zαT / Σ αT, with the gradient of the quotient. Opacities depend on depth only where depths differ.
    ///
    /// Fitted to one view of a noisy recording (1 mm), 400 steps from discs every second pixel: the rendered depth is
    /// off by 0.96 mm, and colour reaches 45.8 dB.
    #[default]
    Normalized,
    /// Like `Normalized`, but with a constant divisor in the gradient. A depth that is too large then lowers opacities,
    /// and one that is too small raises them without limit. In the fit above, the mean opacity falls from 0.97 to 0.85
    /// and colour to 26 dB. Kept for comparison.
    Detached,
    /// Σ zαT, as in the paper. Depth then compensates for missing opacity (2.4 mm, 42.6 dB in the fit above).
    Accumulated,
}

/// Settings of a training step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Weights of the losses.
    pub weights: LossWeights,
    /// Learning rates.
    pub rates: LearningRates,
    /// Form of the depth term.
    pub depth_term: DepthTerm,
    /// Share of the pixels (0.01 to 1) in the segmentation term, drawn again in every step. A smaller share makes steps
    /// shorter; the estimate of the term and its gradients is unbiased.
    pub segmentation_share: f32,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            weights: LossWeights::default(),
            rates: LearningRates::default(),
            depth_term: DepthTerm::default(),
            segmentation_share: 1.0,
        }
    }
}
