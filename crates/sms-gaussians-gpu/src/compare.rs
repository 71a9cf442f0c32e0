//! Comparison of two back ends.

use sms_gaussians::parameters::{
    AFFINITY, COLOR, HARMONICS, LOG_SCALE, LOGIT_OPACITY, PARAMETERS, POSITION, Parameters, ROTATION,
};
use sms_gaussians::{RenderedMaps, TrainState, TrainerError};

/// 99.9th percentile and largest of a set of differences; NaN counts as infinite.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ErrorSpread {
    /// 99.9th percentile.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

impl ErrorSpread {
    /// The spread of differences in any order.
    pub(crate) fn of(differences: impl Iterator<Item = f64>) -> Self {
        let mut all: Vec<f64> =
            differences.map(|d| if d.is_nan() { f64::INFINITY } else { d.abs() }).collect();
        all.sort_by(f64::total_cmp);
        let Some(&max) = all.last() else {
            return Self::default();
        };
        Self { p999: all[(all.len() - 1) * 999 / 1000], max }
    }
}

impl std::fmt::Display for ErrorSpread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "p99.9 {:.1e}, largest {:.1e}", self.p999, self.max)
    }
}

/// Colours, opacities and normals of two renderings of one view.
pub(crate) fn images(a: &RenderedMaps, b: &RenderedMaps) -> ErrorSpread {
    let values = |m: &RenderedMaps| {
        let mut values: Vec<f32> = m.color.as_flattened().to_vec();
        values.extend_from_slice(m.normal_w.as_flattened());
        values.extend_from_slice(&m.alpha);
        values
    };
    let (a, b) = (values(a), values(b));
    if a.len() != b.len() {
        return ErrorSpread { p999: f64::INFINITY, max: f64::INFINITY };
    }
    ErrorSpread::of(a.iter().zip(&b).map(|(a, b)| f64::from(*a) - f64::from(*b)))
}

/// The groups of parameters: name, first index, one past the last.
pub(crate) const GROUPS: [(&str, usize, usize); 7] = [
    ("position", POSITION, ROTATION),
    ("rotation", ROTATION, LOG_SCALE),
    ("scale", LOG_SCALE, LOGIT_OPACITY),
    ("opacity", LOGIT_OPACITY, COLOR),
    ("color", COLOR, AFFINITY),
    ("affinity", AFFINITY, HARMONICS),
    ("harmonics", HARMONICS, PARAMETERS),
];

/// Compares Adam's first moments of two states, each group relative to the larger state's largest moment: after one
/// step from zero moments, this compares gradients.
///
/// # Errors
/// [`TrainerError::BadState`] if a state cannot be read or the numbers of Gaussians differ.
pub(crate) fn first_moments(
    a: &TrainState,
    b: &TrainState,
) -> Result<Vec<(&'static str, ErrorSpread)>, TrainerError> {
    let (a, b) = (Parameters::decode(a)?, Parameters::decode(b)?);
    if a.rows.len() != b.rows.len() || a.classifier.first.len() != b.classifier.first.len() {
        return Err(TrainerError::BadState("the states differ in size".to_owned()));
    }
    let of = |p: &Parameters, first: usize, end: usize| -> Vec<f64> {
        p.first.iter().flat_map(|r| r.0[first..end].iter().map(|v| f64::from(*v))).collect()
    };
    let mut all: Vec<_> = GROUPS
        .iter()
        .map(|(name, first, end)| (*name, relative(&of(&a, *first, *end), &of(&b, *first, *end))))
        .collect();
    let wide = |values: &[f32]| values.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    all.push(("classifier", relative(&wide(&a.classifier.first), &wide(&b.classifier.first))));
    Ok(all)
}

/// Returns the differences relative to the largest value of `b`.
pub(crate) fn relative(a: &[f64], b: &[f64]) -> ErrorSpread {
    let largest = b.iter().fold(1e-30f64, |m, v| m.max(v.abs()));
    ErrorSpread::of(a.iter().zip(b).map(|(a, b)| (a - b) / largest))
}
