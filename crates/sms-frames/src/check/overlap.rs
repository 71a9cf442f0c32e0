//! Overlap error: depth of one frame carried into another.

use crate::{Lens, Recording};
use glamx::DPose3;
use sms_core::{Image, QuantileRule, quantile};

/// Number of samples taken from a frame.
const SAMPLES: usize = 6000;

/// The depth of one frame, prepared for the checks.
pub(super) struct DepthSamples {
    /// Index in the recording.
    pub(super) index: usize,
    /// Raw values.
    pub(super) raw: Image<u16>,
    lens: Lens,
    /// Recorded pixel centres (u, v) and raw value of evenly spread valid pixels.
    samples: Vec<(f64, f64, f64)>,
}

/// One reading of the recording: depth unit and pixel centre.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hypothesis {
    /// Metres of one raw unit.
    pub(super) unit_m: f64,
    /// Offset added to the principal points, pixels.
    pub(super) center_shift: f64,
    /// Stride of the samples that are used.
    pub(super) every: usize,
}

/// Depth differences of one pair of frames.
pub(super) struct PairErrors {
    /// |Δdepth| in metres.
    pub(super) absolute: Vec<f64>,
    /// |Δdepth| over depth.
    pub(super) relative: Vec<f64>,
    /// Samples that were carried over.
    pub(super) tried: usize,
}

impl DepthSamples {
    pub(super) fn new(recording: &Recording, index: usize, raw: Image<u16>) -> Self {
        let valid = raw.data.iter().filter(|&&v| v > 0).count();
        // An odd stride in row-major order is not aligned with a sensor's grid of holes.
        let stride = (valid / SAMPLES).max(1) | 1;
        let samples = raw
            .data
            .iter()
            .enumerate()
            .filter(|(_, v)| **v > 0)
            .step_by(stride)
            .map(|(i, &v)| ((i % raw.width) as f64 + 0.5, (i / raw.width) as f64 + 0.5, f64::from(v)))
            .collect();
        Self { index, raw, lens: recording.frames[index].depth_lens, samples }
    }

    fn shifted_lens(&self, shift: f64) -> Lens {
        let mut lens = self.lens;
        lens.intrinsics.cx += shift;
        lens.intrinsics.cy += shift;
        lens
    }

    /// Carries this frame's samples into `other`, whose camera sees this camera's points through `x_oc`.
    pub(super) fn carry_into(&self, other: &Self, x_oc: &DPose3, reading: &Hypothesis) -> PairErrors {
        let (own, theirs) =
            (self.shifted_lens(reading.center_shift), other.shifted_lens(reading.center_shift));
        let ko = theirs.intrinsics;
        let mut errors = PairErrors { absolute: Vec::new(), relative: Vec::new(), tried: 0 };
        for &(u, v, raw) in self.samples.iter().step_by(reading.every) {
            errors.tried += 1;
            let Some(ray_c) = own.ray_c(u, v) else { continue };
            let p = x_oc.transform_point(ray_c * (raw * reading.unit_m));
            if p.z <= 1e-6 {
                continue;
            }
            let (xd, yd) = theirs.distortion.distort(p.x / p.z, p.y / p.z);
            let (uo, vo) = (ko.fx * xd + ko.cx, ko.fy * yd + ko.cy);
            if !(uo.abs() < 1e6 && vo.abs() < 1e6) {
                continue;
            }
            let Some(&seen) = other.raw.get(uo.floor() as i64, vo.floor() as i64) else { continue };
            if seen > 0 {
                let difference = (f64::from(seen) * reading.unit_m - p.z).abs();
                errors.absolute.push(difference);
                errors.relative.push(difference / p.z);
            }
        }
        errors
    }
}

/// Returns the upper median; `None` without values.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    quantile(values, 0.5, QuantileRule::Nearest)
}
