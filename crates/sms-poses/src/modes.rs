//! Common modes of a refinement: changes that many frames share, and that residuals between neighbouring frames hardly see.
//!
//! The deviations of the refined camera centres from the given ones (after the hand-eye correction) should look like the noise
//! of the given poses. Independent errors average out in a scale, a shear, or the mean shift of one side of an orbit, so their
//! standard deviation there follows from the noise. A mode far beyond it comes from a bias of the images: depth in another unit,
//! another focal length, colour beside the depth.
//!
//! Two things hide a mode. A hand-eye correction explains changes that are the same for every camera: on a circle around the scene,
//! a shift along the optical axes is a scale. And the noise is estimated from the same deviations: a smooth mode looks like a drift.

use crate::given::GivenNoise;
use glamx::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Kinds of common modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ModeKind {
    /// The camera centres are enlarged about their mean; the value is a share.
    Scale,
    /// They are stretched in one direction against another, or sheared; the value is a share.
    Shear,
    /// The cameras on one side are shifted; the value is in metres.
    SideShift,
}

/// A common mode, with its standard deviation under the noise of the given poses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CommonMode {
    /// Kind.
    pub kind: ModeKind,
    /// Deviation of the refined poses from the given ones: a share, or metres.
    pub value: f64,
    /// Standard deviation of it that the noise of the given poses allows, in the same unit.
    pub sigma: f64,
}

/// Number of sides, as sectors of the horizontal direction from the mean of the camera centres. Each overlaps half of its
/// neighbours, so that none is cut in two.
const SIDES: usize = 16;
/// Fewest cameras on a side.
const LEAST_ON_SIDE: usize = 3;
/// Standard deviations beyond which a mode is no chance: one in a thousand recordings with all 55 modes.
const MOST_SIGMAS: f64 = 4.3;

impl CommonMode {
    /// Returns the deviation in standard deviations.
    pub fn ratio(&self) -> f64 {
        self.value.abs() / self.sigma
    }

    /// Returns whether the noise of the given poses explains the deviation.
    pub fn is_allowed(&self) -> bool {
        self.ratio() <= MOST_SIGMAS
    }

    /// Returns a statement for people.
    pub(crate) fn summary(&self) -> String {
        let (value, sigma) = (self.value, self.sigma);
        match self.kind {
            ModeKind::Scale => {
                format!("scale the recording by {:+.2} % (noise ±{:.2} %)", 1e2 * value, 1e2 * sigma)
            }
            ModeKind::Shear => {
                format!("shear the recording by {:.2} % (noise ±{:.2} %)", 1e2 * value.abs(), 1e2 * sigma)
            }
            ModeKind::SideShift => format!(
                "shift the cameras on one side by {:.1} mm (noise ±{:.1} mm)",
                1e3 * value.abs(),
                1e3 * sigma
            ),
        }
    }
}

/// Returns the mode that is least like noise; `None` for fewer than three frames. `deviations` are those of the camera centres
/// from `centers_w`, metres in the world.
pub(crate) fn largest_mode(
    centers_w: &[DVec3],
    deviations: &[DVec3],
    noise: &GivenNoise,
) -> Option<CommonMode> {
    let n = centers_w.len();
    if n < LEAST_ON_SIDE {
        return None;
    }
    let mean = centers_w.iter().sum::<DVec3>() / n as f64;
    let arms: Vec<DVec3> = centers_w.iter().map(|c| *c - mean).collect();
    let mut modes: Vec<(ModeKind, Vec<DVec3>)> = Vec::new();
    let mut strain = |kind, basis: DMat3| {
        let along: Vec<DVec3> = arms.iter().map(|a| basis * *a).collect();
        let square: f64 = along.iter().map(|a| a.length_squared()).sum();
        if square > 0.0 {
            modes.push((kind, along.into_iter().map(|a| a / square).collect()));
        }
    };
    strain(ModeKind::Scale, DMat3::IDENTITY);
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        let (a, b) = (DVec3::AXES[a], DVec3::AXES[b]);
        let outer = |u: DVec3, v: DVec3| DMat3::from_cols(u * v.x, u * v.y, u * v.z);
        strain(ModeKind::Shear, outer(a, b) + outer(b, a));
        strain(ModeKind::Shear, outer(a, a) - outer(b, b));
    }
    let width = std::f64::consts::TAU / SIDES as f64;
    for side in 0..SIDES {
        let (sin, cos) = (width * side as f64).sin_cos();
        let middle = DVec3::new(cos, sin, 0.0);
        let is_on = |arm: &DVec3| arm.dot(middle) >= width.cos() * arm.with_z(0.0).length();
        let on: Vec<bool> = arms.iter().map(is_on).collect();
        let count = on.iter().filter(|on| **on).count();
        if count < LEAST_ON_SIDE {
            continue;
        }
        for axis in DVec3::AXES {
            let weight = |on: &bool| if *on { axis / count as f64 } else { DVec3::ZERO };
            modes.push((ModeKind::SideShift, on.iter().map(weight).collect()));
        }
    }
    let measured = |(kind, weights): (ModeKind, Vec<DVec3>)| {
        let value = weights.iter().zip(deviations).map(|(w, d)| w.dot(*d)).sum();
        CommonMode { kind, value, sigma: noise.position_sigma(&weights) }
    };
    modes.into_iter().map(measured).max_by(|a, b| a.ratio().total_cmp(&b.ratio()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use sms_core::Seed;

    /// Cameras on a circle, and the noise of independent errors of 5 mm.
    fn orbit() -> (Vec<DVec3>, GivenNoise) {
        let center = |i: usize| {
            let angle = std::f64::consts::TAU * i as f64 / 60.0;
            DVec3::new(angle.cos(), angle.sin(), 0.2 * (3.0 * angle).sin())
        };
        let noise = GivenNoise { frame: [1e6, 0.005f64.powi(-2)], step: [0.0; 2] };
        ((0..60).map(center).collect(), noise)
    }

    #[test]
    fn independent_errors_are_allowed_and_a_common_change_of_their_size_is_not() {
        let (centers, noise) = orbit();
        for seed in 0..50 {
            let mut rng = Seed(seed).rng();
            let mut normal = || 0.005 * ((0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0);
            let deviations: Vec<DVec3> =
                centers.iter().map(|_| DVec3::new(normal(), normal(), normal())).collect();
            let mode = largest_mode(&centers, &deviations, &noise).unwrap();
            assert!(mode.is_allowed(), "seed {seed}: {mode:?}");
        }
        let larger: Vec<DVec3> = centers.iter().map(|c| 0.005 * *c).collect();
        let scale = largest_mode(&centers, &larger, &noise).unwrap();
        assert_eq!(scale.kind, ModeKind::Scale);
        assert!((scale.value - 0.005).abs() < 1e-12 && !scale.is_allowed(), "{scale:?}");
        let one_side: Vec<DVec3> =
            centers.iter().map(|c| if c.x > 0.8 { 0.01 * DVec3::Z } else { DVec3::ZERO }).collect();
        assert!(!largest_mode(&centers, &one_side, &noise).unwrap().is_allowed());
        assert_eq!(largest_mode(&centers[..2], &larger[..2], &noise), None);
    }

    #[test]
    fn a_drift_may_shift_a_side() {
        let (centers, noise) = orbit();
        // A random walk with steps of 2 mm goes farther than independent errors of a frame.
        let drifting = GivenNoise { frame: [1e6, 1.0], step: [0.0, 0.002f64.powi(-2)] };
        let mut rng = Seed(3).rng();
        let mut at = DVec3::ZERO;
        let deviations: Vec<DVec3> = centers
            .iter()
            .map(|_| {
                let mut normal = || 0.002 * ((0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0);
                at += DVec3::new(normal(), normal(), normal());
                at
            })
            .collect();
        assert!(largest_mode(&centers, &deviations, &drifting).unwrap().is_allowed());
        let steady = GivenNoise { frame: noise.frame.map(|a| 16.0 * a), ..noise };
        assert!(!largest_mode(&centers, &deviations, &steady).unwrap().is_allowed());
    }
}
