//! Labels by consensus of the masks.
//!
//! A Gaussian behind an object may shine through by a thousandth. Adam moves it as far as one in front, so its affinity
//! drifts towards the object's label. The masks are more reliable: in each frame that measures the Gaussian on the
//! surface, the mask is a vote. If a clear majority contradicts the label of a Gaussian, it receives the affinity of
//! the most confident Gaussian of the voted label. Classifier, renders and labels then stay consistent.

use super::config::ScanConfig;
use crate::parameters::{AFFINITY, HARMONICS, Parameters};
use crate::{AFFINITY_DIM, GaussianModel};
use sms_core::LabelMap;
use sms_frames::Frame;
use sms_surface::map_nearby;

/// Smallest share of the votes for a label.
const MAJORITY: f64 = 0.6;

/// Corrects labels that contradict the masks of `frames`.
pub(crate) fn correct_labels(
    parameters: &mut Parameters,
    frames: &[(&Frame, &LabelMap)],
    config: &ScanConfig,
) {
    let model = parameters.model();
    let classes = model.classifier.classes;
    let votes = map_nearby(&model.positions_w, |group| voted_labels(group, &model, frames, classes, config));
    let surest = surest_of_labels(&model, &votes);
    for (i, vote) in votes.iter().enumerate() {
        let Some(label) = vote.filter(|&label| label != model.labels[i]) else { continue };
        if let Some(affinity) = surest[usize::from(label)] {
            parameters.rows[i].0[AFFINITY..HARMONICS].copy_from_slice(&affinity);
            // Otherwise the moments would move the affinity back.
            parameters.first[i].0[AFFINITY..HARMONICS].fill(0.0);
        }
    }
}

/// Returns, for each Gaussian, the label with a clear majority among the frames that measure a surface there.
fn voted_labels(
    gaussians: &[u32],
    model: &GaussianModel,
    frames: &[(&Frame, &LabelMap)],
    classes: usize,
    config: &ScanConfig,
) -> Vec<Option<u16>> {
    let mut counts = vec![0usize; classes * gaussians.len()];
    for (frame, labels) in frames {
        for (i, counts) in gaussians.iter().zip(counts.chunks_exact_mut(classes.max(1))) {
            let p_w = model.positions_w[*i as usize];
            let Some((u, v, z)) = frame.camera.project(p_w.as_dvec3()) else { continue };
            let Some(pixel) = frame.camera.pixel_at(u, v) else { continue };
            let depth = f64::from(frame.depth[pixel]);
            if depth > 0.0
                && (depth - z).abs() <= config.tolerance_m(&frame.depth_noise, z)
                && let Some(count) = counts.get_mut(usize::from(labels[pixel]))
            {
                *count += 1;
            }
        }
    }
    (0..gaussians.len()).map(|i| majority(&counts[classes * i..classes * (i + 1)])).collect()
}

/// Returns the label with the most votes (the lower of equals) if its share is large enough.
fn majority(counts: &[usize]) -> Option<u16> {
    let total: usize = counts.iter().sum();
    let (label, most) =
        counts.iter().enumerate().max_by_key(|&(label, count)| (*count, std::cmp::Reverse(label)))?;
    (*most > 0 && *most as f64 >= MAJORITY * total as f64).then_some(label as u16)
}

/// Returns, for each label, the affinity of the most confident Gaussian on which classifier and votes agree.
fn surest_of_labels(model: &GaussianModel, votes: &[Option<u16>]) -> Vec<Option<[f32; AFFINITY_DIM]>> {
    let mut best: Vec<Option<usize>> = vec![None; model.classifier.classes];
    for (i, vote) in votes.iter().enumerate() {
        let label = model.labels[i];
        if *vote == Some(label) {
            let slot = &mut best[usize::from(label)];
            if slot.is_none_or(|b| model.label_confidence[i] > model.label_confidence[b]) {
                *slot = Some(i);
            }
        }
    }
    best.into_iter().map(|b| b.map(|i| model.affinities[i])).collect()
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{BALL, BALL_CENTER, BALL_RADIUS, Recorded, SMALL, record};
    use super::*;
    use crate::harmonics::CONSTANT;
    use crate::{CpuTrainer, Seedling, TrainConfig, Trainer};
    use glamx::{Quat, Vec3};
    use sms_core::Seed;

    #[test]
    fn a_label_that_the_masks_contradict_is_corrected_and_a_hidden_one_is_left() {
        let (sequence, labels) = record(Recorded { noise_m: 0.0, ..SMALL });
        let frames: Vec<_> = sequence.frames.iter().zip(&labels.maps).collect();
        let mut trainer = CpuTrainer::new(&TrainConfig::default(), 3, Seed(1));
        // Affinities that the untrained classifier labels as the ball and as the background.
        let classifier = trainer.model().classifier;
        let affinity = |label: u16| {
            let axes = (0..AFFINITY_DIM).flat_map(|k| [3.0f32, -3.0].map(|v| (k, v)));
            let mut candidates = axes.map(|(k, v)| std::array::from_fn(|j| if j == k { v } else { 0.0 }));
            candidates.find(|a| classifier.classify(a).0 == label).unwrap()
        };
        let top = (BALL_CENTER + glamx::DVec3::new(0.0, -0.6, 0.8) * BALL_RADIUS).as_vec3();
        let seedling = |position_w: Vec3, label: u16| Seedling {
            position_w,
            rotation_wg: Quat::IDENTITY,
            scale: Vec3::splat(1e-3),
            opacity: 0.5,
            color: [0.5; 3],
            harmonics: CONSTANT,
            affinity: affinity(label),
        };
        let hidden = BALL_CENTER.as_vec3();
        trainer.insert(&[
            seedling(top, BALL),
            seedling(top + Vec3::X * 1e-3, 0),
            seedling(hidden, 0),
            seedling(Vec3::new(0.0, -0.12, 0.0), BALL),
            seedling(Vec3::new(0.01, -0.12, 0.0), 0),
        ]);
        assert_eq!(trainer.model().labels, [BALL, 0, 0, BALL, 0]);
        trainer.edit(&mut |p| correct_labels(p, &frames, &ScanConfig::default())).unwrap();
        assert_eq!(trainer.model().labels, [BALL, BALL, 0, 0, 0]);
    }
}
