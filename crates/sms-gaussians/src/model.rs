//! The stage's result: labelled Gaussians.

use crate::harmonics::{Harmonics, mean_difference, rotated, rotation_of};
use crate::parameters::shortest_axis;
use glamx::{DPose3, Quat, Vec3};

/// Width of the affinity feature (paper: d; released code: 16).
pub const AFFINITY_DIM: usize = 16;
/// Hidden width of the classifier.
pub(crate) const HIDDEN_DIM: usize = 32;

/// Gaussians as a structure of arrays, in natural units (not the optimiser's).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GaussianModel {
    /// Centres in the world, metres.
    pub positions_w: Vec<Vec3>,
    /// Rotation from the Gaussian's axes to the world, unit quaternions.
    pub rotations_wg: Vec<Quat>,
    /// Standard deviations along the Gaussian's axes, metres.
    pub scales: Vec<Vec3>,
    /// Opacities in (0, 1).
    pub opacities: Vec<f32>,
    /// Constant part of the colours: linear values as trained against sRGB images, nominally 0 to 1.
    pub colors: Vec<[f32; 3]>,
    /// View-dependent part of the colours; empty if there is none. From a direction, the colour is `colors[i]` plus
    /// [`harmonics::difference`](crate::harmonics::difference).
    pub harmonics: Vec<Harmonics>,
    /// Affinity features.
    pub affinities: Vec<[f32; AFFINITY_DIM]>,
    /// The classifier's label of each Gaussian's own affinity.
    pub labels: Vec<u16>,
    /// Softmax probability of that label.
    pub label_confidence: Vec<f32>,
    /// The classifier.
    pub classifier: Classifier,
    /// Whether a frame measured a surface at each Gaussian; empty if all are on a measured surface. Others are placed by colour
    /// alone, to fill the picture: no surface of a body, with the label of the background.
    pub measured: Vec<bool>,
    /// Colour behind all Gaussians, 0 to 1: the colour of empty pixels.
    pub background: [f32; 3],
}

/// The two-layer perceptron φ of the paper (Section "Scan"): affinity → ReLU hidden layer → logits.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Classifier {
    /// Number of classes K, the background included.
    pub classes: usize,
    /// First layer, `[HIDDEN_DIM][AFFINITY_DIM]` row by row.
    pub w1: Vec<f32>,
    /// First bias, `[HIDDEN_DIM]`.
    pub b1: Vec<f32>,
    /// Second layer, `[classes][HIDDEN_DIM]` row by row.
    pub w2: Vec<f32>,
    /// Second bias, `[classes]`.
    pub b2: Vec<f32>,
}

impl GaussianModel {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.positions_w.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.positions_w.is_empty()
    }

    /// Whether a frame measured a surface at Gaussian `i`.
    pub fn is_measured(&self, i: usize) -> bool {
        self.measured.get(i).is_none_or(|measured| *measured)
    }

    /// Returns the Gaussians with these indices, in their order.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn subset(&self, indices: &[usize]) -> Self {
        fn pick<T: Copy>(values: &[T], indices: &[usize]) -> Vec<T> {
            indices.iter().map(|&i| values[i]).collect()
        }
        fn pick_if_any<T: Copy>(values: &[T], indices: &[usize]) -> Vec<T> {
            if values.is_empty() { Vec::new() } else { pick(values, indices) }
        }
        Self {
            positions_w: pick(&self.positions_w, indices),
            rotations_wg: pick(&self.rotations_wg, indices),
            scales: pick(&self.scales, indices),
            opacities: pick(&self.opacities, indices),
            colors: pick(&self.colors, indices),
            affinities: pick(&self.affinities, indices),
            labels: pick(&self.labels, indices),
            label_confidence: pick(&self.label_confidence, indices),
            harmonics: pick_if_any(&self.harmonics, indices),
            measured: pick_if_any(&self.measured, indices),
            classifier: self.classifier.clone(),
            background: self.background,
        }
    }

    /// Transforms the model from the world to the frame `A` by `x_aw`; the view-dependent part of the colours turns along.
    pub fn transformed(&self, x_aw: &DPose3) -> Self {
        let rotation = x_aw.rotation.as_quat();
        let of_harmonics = rotation_of(rotation);
        Self {
            positions_w: self
                .positions_w
                .iter()
                .map(|p| x_aw.transform_point(p.as_dvec3()).as_vec3())
                .collect(),
            rotations_wg: self.rotations_wg.iter().map(|&q| (rotation * q).normalize()).collect(),
            harmonics: self.harmonics.iter().map(|h| rotated(h, &of_harmonics)).collect(),
            ..self.clone()
        }
    }

    /// Returns the mean colour of Gaussian `i` over the directions from which a surface with this outward normal is seen.
    pub fn mean_color(&self, i: usize, outward_w: Vec3) -> [f32; 3] {
        let Some(harmonics) = self.harmonics.get(i) else { return self.colors[i] };
        let difference = mean_difference(harmonics, outward_w.to_array());
        std::array::from_fn(|c| self.colors[i][c] + difference[c])
    }

    /// The shortest principal axis of Gaussian `i` in the world (unit; outwards where the scan placed the Gaussian on a
    /// surface and training did not make another axis the shortest), and the two larger standard
    /// deviations with their axes: `(normal, [(axis, sigma); 2])`.
    pub fn disc(&self, i: usize) -> (Vec3, [(Vec3, f32); 2]) {
        let q = self.rotations_wg[i];
        let s = self.scales[i].to_array();
        let axes = [q * Vec3::X, q * Vec3::Y, q * Vec3::Z];
        let smallest = shortest_axis(s);
        let others = [(smallest + 1) % 3, (smallest + 2) % 3];
        (axes[smallest], others.map(|k| (axes[k], s[k])))
    }
}

impl Classifier {
    /// The logits of one affinity feature, `[classes]`.
    pub fn logits(&self, affinity: &[f32; AFFINITY_DIM]) -> Vec<f32> {
        let mut hidden = [0.0; HIDDEN_DIM];
        for (h, (row, bias)) in hidden.iter_mut().zip(self.w1.chunks_exact(AFFINITY_DIM).zip(&self.b1)) {
            *h = row.iter().zip(affinity).fold(*bias, |sum, (w, a)| sum + w * a).max(0.0);
        }
        let rows = self.w2.chunks_exact(HIDDEN_DIM).zip(&self.b2);
        rows.map(|(row, bias)| row.iter().zip(&hidden).fold(*bias, |sum, (w, h)| sum + w * h)).collect()
    }

    /// Returns the most likely label of one affinity feature and its softmax probability; label 0 without classes.
    pub fn classify(&self, affinity: &[f32; AFFINITY_DIM]) -> (u16, f32) {
        let logits = self.logits(affinity);
        let mut best = 0;
        for (k, logit) in logits.iter().enumerate() {
            if *logit > logits[best] {
                best = k;
            }
        }
        let Some(&largest) = logits.get(best) else {
            return (0, 0.0);
        };
        let sum: f32 = logits.iter().map(|l| (l - largest).exp()).sum();
        (best as u16, 1.0 / sum)
    }
}
