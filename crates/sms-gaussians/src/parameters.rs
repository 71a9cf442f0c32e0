//! The state of training: parameters in the optimiser's own units with their Adam moments, and their encoding in a
//! checkpoint. All back ends share this layout.

use crate::harmonics::{BASIS, Harmonics};
use crate::{AFFINITY_DIM, Classifier, GaussianModel, HIDDEN_DIM, Seedling, TrainState, TrainerError};
use glamx::{Quat, Vec3};
use rand::RngExt;
use rayon::prelude::*;
use sms_core::Seed;

/// First index of the position in a [`Row`] (metres, world).
pub const POSITION: usize = 0;
/// First index of the rotation: quaternion x, y, z, w from the Gaussian's axes to the world, unit length.
pub const ROTATION: usize = 3;
/// First index of the natural logarithms of the three scales (metres).
pub const LOG_SCALE: usize = 7;
/// Index of the logit of the opacity.
pub const LOGIT_OPACITY: usize = 10;
/// First index of the colour.
pub const COLOR: usize = 11;
/// First index of the affinity.
pub const AFFINITY: usize = 14;
/// First index of the view-dependent part of the colour ([`Harmonics`]).
pub const HARMONICS: usize = AFFINITY + AFFINITY_DIM;
/// Parameters of one Gaussian.
pub const PARAMETERS: usize = HARMONICS + 3 * BASIS;
/// Length of a row: parameters padded to whole vectors of sixteen.
pub const ROW: usize = 64;

/// Smallest and largest standard deviation, metres: the useful range for desk-size scans.
pub const SCALE_RANGE: (f32, f32) = (1e-6, 10.0);
/// Opacities are kept within this logit of one half.
pub const LOGIT_LIMIT: f32 = 12.0;

/// The parameters of one Gaussian, then padding that stays zero.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub struct Row(pub [f32; ROW]);

impl Row {
    /// All zeros.
    pub const ZERO: Self = Self([0.0; ROW]);

    /// Index of the shortest axis: the normal of a disc.
    pub(crate) fn shortest_axis(&self) -> usize {
        let log_scale = &self.0[LOG_SCALE..LOGIT_OPACITY];
        shortest_axis([log_scale[0], log_scale[1], log_scale[2]])
    }
}

/// Index of the shortest of three axes, from their lengths or the logarithms of these; the first of equal ones.
pub(crate) fn shortest_axis(lengths: [f32; 3]) -> usize {
    (0..3).min_by(|&a, &b| lengths[a].total_cmp(&lengths[b])).unwrap_or(2)
}

/// A flat array with its Adam moments.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ClassifierState {
    /// Number of classes K.
    pub classes: usize,
    /// `w1`, `b1`, `w2`, `b2` of [`Classifier`], one after the other.
    pub values: Vec<f32>,
    /// Adam's first moment.
    pub first: Vec<f32>,
    /// Adam's second moment.
    pub second: Vec<f32>,
    /// Adam steps taken.
    pub steps: u32,
}

/// The state changed by training.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Parameters {
    /// Parameters, one row per Gaussian.
    pub rows: Vec<Row>,
    /// Adam's first moments.
    pub first: Vec<Row>,
    /// Adam's second moments.
    pub second: Vec<Row>,
    /// Number of Adam steps of each Gaussian, for its own bias correction.
    pub steps: Vec<u32>,
    /// The classifier.
    pub classifier: ClassifierState,
}

/// Number of values in the classifier's flat array.
pub fn classifier_len(classes: usize) -> usize {
    HIDDEN_DIM * AFFINITY_DIM + HIDDEN_DIM + classes * (HIDDEN_DIM + 1)
}

impl ClassifierState {
    /// A classifier with weights uniform in ±√(3/fan_in)-like bounds (He et al. 2015 for the first layer).
    pub fn new(classes: usize, seed: Seed) -> Self {
        let mut rng = seed.derive("classifier").rng();
        let mut values = vec![0.0; classifier_len(classes)];
        let (w1, rest) = values.split_at_mut(HIDDEN_DIM * AFFINITY_DIM);
        let w2 = &mut rest[HIDDEN_DIM..HIDDEN_DIM + classes * HIDDEN_DIM];
        let bound = (6.0 / AFFINITY_DIM as f32).sqrt();
        w1.iter_mut().for_each(|w| *w = rng.random_range(-bound..bound));
        let bound = (3.0 / HIDDEN_DIM as f32).sqrt();
        w2.iter_mut().for_each(|w| *w = rng.random_range(-bound..bound));
        Self::without_moments(classes, values)
    }

    /// These values with zeroed moments.
    pub(crate) fn without_moments(classes: usize, values: Vec<f32>) -> Self {
        let zeros = vec![0.0; values.len()];
        Self { classes, values, first: zeros.clone(), second: zeros, steps: 0 }
    }

    /// The classifier in its public form.
    pub fn classifier(&self) -> Classifier {
        let (w1, rest) = self.values.split_at(HIDDEN_DIM * AFFINITY_DIM);
        let (b1, rest) = rest.split_at(HIDDEN_DIM);
        let (w2, b2) = rest.split_at(self.classes * HIDDEN_DIM);
        Classifier { classes: self.classes, w1: w1.into(), b1: b1.into(), w2: w2.into(), b2: b2.into() }
    }
}

/// Returns the row of a seedling with scales, opacity and rotation in range, or `None` if a number is not finite.
fn row_of(s: &Seedling) -> Option<Row> {
    let numbers = [s.opacity].into_iter().chain(s.color).chain(s.harmonics).chain(s.affinity);
    let finite = s.position_w.is_finite() && s.rotation_wg.is_finite() && s.scale.is_finite();
    if !finite || numbers.into_iter().any(|v| !v.is_finite()) {
        return None;
    }
    let mut row = [0.0; ROW];
    row[POSITION..POSITION + 3].copy_from_slice(&s.position_w.to_array());
    let unit = s.rotation_wg.length_squared() > 1e-12;
    let rotation = if unit { s.rotation_wg.normalize() } else { Quat::IDENTITY };
    row[ROTATION..ROTATION + 4].copy_from_slice(&rotation.to_array());
    for k in 0..3 {
        row[LOG_SCALE + k] = s.scale[k].clamp(SCALE_RANGE.0, SCALE_RANGE.1).ln();
    }
    let opacity = s.opacity.clamp(1e-5, 1.0 - 1e-5);
    row[LOGIT_OPACITY] = (opacity / (1.0 - opacity)).ln();
    row[COLOR..COLOR + 3].copy_from_slice(&s.color.map(|c| c.clamp(-1.0, 2.0)));
    row[AFFINITY..HARMONICS].copy_from_slice(&s.affinity.map(|a| a.clamp(-100.0, 100.0)));
    row[HARMONICS..PARAMETERS].copy_from_slice(&s.harmonics.map(|h| h.clamp(-100.0, 100.0)));
    row.iter().all(|v| v.is_finite()).then_some(Row(row))
}

fn keep<T>(values: &mut Vec<T>, mask: &[bool]) {
    let mut mask = mask.iter();
    values.retain(|_| mask.next() == Some(&true));
}

const STATE_VERSION: u32 = 2;

impl Parameters {
    /// No Gaussians, a fresh classifier.
    pub fn new(classes: usize, seed: Seed) -> Self {
        Self { classifier: ClassifierState::new(classes, seed), ..Self::default() }
    }

    /// Appends Gaussians with zeroed moments, except seedlings with a number that is not finite.
    pub fn insert(&mut self, seedlings: &[Seedling]) {
        self.rows.extend(seedlings.iter().filter_map(row_of));
        self.first.resize(self.rows.len(), Row::ZERO);
        self.second.resize(self.rows.len(), Row::ZERO);
        self.steps.resize(self.rows.len(), 0);
    }

    /// Keeps only Gaussians whose entry is true.
    ///
    /// # Panics
    /// If the mask has another length than the parameters.
    pub fn retain(&mut self, mask: &[bool]) {
        assert_eq!(mask.len(), self.rows.len(), "one entry per Gaussian");
        keep(&mut self.rows, mask);
        keep(&mut self.first, mask);
        keep(&mut self.second, mask);
        keep(&mut self.steps, mask);
    }

    /// Returns the model in natural units on a black background, each Gaussian labelled by the classifier on its
    /// own affinity.
    pub fn model(&self) -> GaussianModel {
        let classifier = self.classifier.classifier();
        let rows = &self.rows;
        let affinity = |r: &Row| std::array::from_fn(|k| r.0[AFFINITY + k]);
        let harmonics = |r: &Row| -> Harmonics { std::array::from_fn(|k| r.0[HARMONICS + k]) };
        let directed = rows.par_iter().any(|r| harmonics(r).iter().any(|v| *v != 0.0));
        let (labels, label_confidence) = rows.par_iter().map(|r| classifier.classify(&affinity(r))).unzip();
        GaussianModel {
            positions_w: rows.iter().map(|r| Vec3::from_slice(&r.0[POSITION..])).collect(),
            rotations_wg: rows.iter().map(|r| Quat::from_slice(&r.0[ROTATION..])).collect(),
            scales: rows.par_iter().map(|r| Vec3::from_slice(&r.0[LOG_SCALE..]).exp()).collect(),
            opacities: rows.par_iter().map(|r| sigmoid(r.0[LOGIT_OPACITY])).collect(),
            colors: rows.iter().map(|r| [r.0[COLOR], r.0[COLOR + 1], r.0[COLOR + 2]]).collect(),
            harmonics: if directed { rows.iter().map(harmonics).collect() } else { Vec::new() },
            affinities: rows.iter().map(affinity).collect(),
            labels,
            label_confidence,
            classifier,
            ..GaussianModel::default()
        }
    }

    /// Whether every parameter and moment is a finite number.
    pub fn is_finite(&self) -> bool {
        let c = &self.classifier;
        let finite = |rows: &Vec<Row>| rows.par_iter().all(|r| r.0.iter().all(|v| v.is_finite()));
        [&c.values, &c.first, &c.second].into_iter().flatten().all(|v| v.is_finite())
            && [&self.rows, &self.first, &self.second].into_iter().all(finite)
    }

    /// The whole state as bytes, little-endian: version, K, count N, classifier steps; the classifier's values,
    /// first and second moments; N step counts; N × [`PARAMETERS`] values, first moments, second moments.
    pub fn encode(&self) -> TrainState {
        let c = &self.classifier;
        let mut bytes =
            Vec::with_capacity(16 + 12 * c.values.len() + self.rows.len() * (4 + 12 * PARAMETERS));
        for word in [STATE_VERSION, c.classes as u32, self.rows.len() as u32, c.steps] {
            bytes.extend(word.to_le_bytes());
        }
        for values in [&c.values, &c.first, &c.second] {
            bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        }
        bytes.extend(self.steps.iter().flat_map(|v| v.to_le_bytes()));
        // Whole rows at a time: number by number took 60 ms for 75 000 Gaussians.
        let row_bytes = 4 * PARAMETERS;
        let mut at = bytes.len();
        bytes.resize(at + 3 * self.rows.len() * row_bytes, 0);
        for rows in [&self.rows, &self.first, &self.second] {
            let to = &mut bytes[at..at + rows.len() * row_bytes];
            to.par_chunks_exact_mut(row_bytes).zip(rows).with_min_len(1024).for_each(|(to, row)| {
                for (to, value) in to.as_chunks_mut::<4>().0.iter_mut().zip(&row.0[..PARAMETERS]) {
                    *to = value.to_le_bytes();
                }
            });
            at += rows.len() * row_bytes;
        }
        TrainState { bytes }
    }

    /// Decodes the output of [`Parameters::encode`].
    ///
    /// # Errors
    /// [`TrainerError::BadState`] if the version or the length differs, or a number is not finite.
    pub fn decode(state: &TrainState) -> Result<Self, TrainerError> {
        let bad = |why: &str| TrainerError::BadState(why.to_owned());
        let (words, remainder) = state.bytes.as_chunks::<4>();
        let [version, classes, count, classifier_steps, body @ ..] = words else {
            return Err(bad("it is too short"));
        };
        let (version, classes) = (u32::from_le_bytes(*version), u32::from_le_bytes(*classes) as usize);
        let count = u32::from_le_bytes(*count) as usize;
        if version != STATE_VERSION {
            return Err(TrainerError::BadState(format!(
                "its layout has version {version}, this program reads {STATE_VERSION}"
            )));
        }
        let fits = remainder.is_empty()
            && classes <= usize::from(u16::MAX)
            && body.len() == 3 * classifier_len(classes) + count * (1 + 3 * PARAMETERS);
        if !fits {
            return Err(bad("its length does not match its header"));
        }
        let length = classifier_len(classes);
        let floats = |words: &[[u8; 4]]| words.iter().map(|w| f32::from_le_bytes(*w)).collect::<Vec<_>>();
        let rows = |words: &[[u8; 4]]| {
            let mut rows = vec![Row::ZERO; count];
            rows.par_iter_mut().zip(words.par_chunks_exact(PARAMETERS)).with_min_len(1024).for_each(
                |(row, values)| {
                    for (to, from) in row.0.iter_mut().zip(values) {
                        *to = f32::from_le_bytes(*from);
                    }
                },
            );
            rows
        };
        let (flat, body) = body.split_at(3 * length);
        let (steps, body) = body.split_at(count);
        let read = Self {
            rows: rows(&body[..count * PARAMETERS]),
            first: rows(&body[count * PARAMETERS..2 * count * PARAMETERS]),
            second: rows(&body[2 * count * PARAMETERS..]),
            steps: steps.iter().map(|w| u32::from_le_bytes(*w)).collect(),
            classifier: ClassifierState {
                classes,
                values: floats(&flat[..length]),
                first: floats(&flat[length..2 * length]),
                second: floats(&flat[2 * length..]),
                steps: u32::from_le_bytes(*classifier_steps),
            },
        };
        if read.is_finite() { Ok(read) } else { Err(TrainerError::not_finite()) }
    }

    /// [`Parameters::decode`] for a trainer with `classes` classes.
    ///
    /// # Errors
    /// As [`Parameters::decode`], and if the state has another number of classes.
    pub fn decode_for(classes: usize, state: &TrainState) -> Result<Self, TrainerError> {
        let read = Self::decode(state)?;
        match read.classifier.classes {
            found if found == classes => Ok(read),
            found => Err(TrainerError::BadState(format!("it has {found} classes, the masks have {classes}"))),
        }
    }
}

/// The logistic function.
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}
