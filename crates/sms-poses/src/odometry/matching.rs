//! The motion between two frames from matched corners: for frames whose relative pose is not known at all.

use super::features::{Descriptor, Feature};
use crate::align::align_rigidly;
use glamx::{DMat3, DPose3, DQuat, DVec3};
use rand::RngExt;
use sms_core::Seed;

/// Largest number of different bits of a match. Random descriptors differ in 128 ± 8 bits.
const MOST_BITS: u32 = 72;
/// Drawn triples of matches.
const DRAWS: usize = 400;
/// Positions of a match may differ by this many standard deviations.
const INLIER_SIGMA: f64 = 3.0;
/// Least number of agreeing matches. Of a few hundred wrong matches, one in a hundred agrees with a wrong motion: ten do not
/// agree by chance.
pub(super) const LEAST_INLIERS: usize = 12;

fn distance(a: &Descriptor, b: &Descriptor) -> u32 {
    (0..4).map(|k| (a[k] ^ b[k]).count_ones()).sum()
}

/// Returns the pairs of features that are each other's most similar.
fn matches(a: &[Feature], b: &[Feature]) -> Vec<(usize, usize)> {
    let mut best_of_a = vec![(u32::MAX, 0usize); a.len()];
    let mut best_of_b = vec![(u32::MAX, 0usize); b.len()];
    for (i, fa) in a.iter().enumerate() {
        for (j, fb) in b.iter().enumerate() {
            let bits = distance(&fa.descriptor, &fb.descriptor);
            if bits < best_of_a[i].0 {
                best_of_a[i] = (bits, j);
            }
            if bits < best_of_b[j].0 {
                best_of_b[j] = (bits, i);
            }
        }
    }
    let mutual = |(i, &(bits, j)): (usize, &(u32, usize))| {
        (bits <= MOST_BITS && best_of_b.get(j).is_some_and(|b| b.1 == i)).then_some((i, j))
    };
    best_of_a.iter().enumerate().filter_map(mutual).collect()
}

/// Returns the number of matches of two frames.
pub(super) fn likeness(a: &[Feature], b: &[Feature]) -> usize {
    matches(a, b).len()
}

/// Returns the motion on which most matched corners of two frames agree, from camera b to camera a; `None` if too few do.
pub(super) fn motion_by_features(a: &[Feature], b: &[Feature], seed: Seed) -> Option<DPose3> {
    let pairs = matches(a, b);
    if pairs.len() < LEAST_INLIERS {
        return None;
    }
    let from: Vec<DVec3> = pairs.iter().map(|p| b[p.1].p_c).collect();
    let to: Vec<DVec3> = pairs.iter().map(|p| a[p.0].p_c).collect();
    let allowed: Vec<f64> =
        pairs.iter().map(|p| (INLIER_SIGMA * a[p.0].sigma_m.hypot(b[p.1].sigma_m)).powi(2)).collect();
    let agreeing = |x: &DPose3| -> Vec<usize> {
        let agrees = |&k: &usize| (x.transform_point(from[k]) - to[k]).length_squared() <= allowed[k];
        (0..pairs.len()).filter(agrees).collect()
    };
    let mut rng = seed.rng();
    let mut best: Option<(DPose3, usize)> = None;
    for _ in 0..DRAWS {
        let triple: [usize; 3] = std::array::from_fn(|_| rng.random_range(0..pairs.len()));
        let Some(x) = motion_of_three(&triple.map(|k| from[k]), &triple.map(|k| to[k])) else { continue };
        let count = agreeing(&x).len();
        if best.as_ref().is_none_or(|b| count > b.1) {
            best = Some((x, count));
        }
    }
    let (mut x_ab, _) = best?;
    // The least-squares motion of those that agree finds more of them.
    for _ in 0..3 {
        let inliers = agreeing(&x_ab);
        if inliers.len() < LEAST_INLIERS {
            return None;
        }
        let of = |points: &[DVec3]| -> Vec<DVec3> { inliers.iter().map(|&k| points[k]).collect() };
        x_ab = align_rigidly(&of(&from), &of(&to));
    }
    Some(x_ab)
}

/// Returns the motion that carries three points to three others, with their middles on each other; `None` if they are nearly on a line, or
/// their distances differ by more than a tenth.
fn motion_of_three(from: &[DVec3; 3], to: &[DVec3; 3]) -> Option<DPose3> {
    let sides = |p: &[DVec3; 3]| [p[1] - p[0], p[2] - p[0], p[2] - p[1]].map(|d| d.length());
    let alike = sides(from).iter().zip(sides(to)).all(|(a, b)| (a - b).abs() <= 0.1 * a.max(b));
    let axes = |p: &[DVec3; 3]| -> Option<DMat3> {
        let x = (p[1] - p[0]).try_normalize()?;
        let across = p[2] - p[0];
        let y = across - x * x.dot(across);
        // A thin triangle tells nothing about the turn about its long side.
        (y.length() > 0.1 * across.length()).then_some(())?;
        let y = y.try_normalize()?;
        Some(DMat3::from_cols(x, y, x.cross(y)))
    };
    if !alike {
        return None;
    }
    let turn = axes(to)? * axes(from)?.transpose();
    let rotation = DQuat::from_mat3(&turn).normalize();
    let middle = |p: &[DVec3; 3]| (p[0] + p[1] + p[2]) / 3.0;
    Some(DPose3::from_parts(middle(to) - rotation * middle(from), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_motion_is_found_among_wrong_matches() {
        let mut rng = Seed(5).rng();
        let truth = DPose3::from_parts(DVec3::new(0.3, -0.2, 0.1), DQuat::from_rotation_y(0.9));
        let feature = |p_c: DVec3, descriptor: Descriptor| Feature { p_c, sigma_m: 0.003, descriptor };
        let (mut a, mut b) = (Vec::new(), Vec::new());
        for k in 0..120 {
            let mut draw =
                || DVec3::from_array(std::array::from_fn(|_| rng.random::<f64>() - 0.5)) + DVec3::Z;
            let (p, wrong) = (draw(), draw());
            let bits = std::array::from_fn(|_| rng.random::<u64>());
            // Two thirds of the matches are wrong.
            a.push(feature(if k % 3 == 0 { truth.transform_point(p) } else { wrong }, bits));
            b.push(feature(p, bits));
        }
        b.reverse();
        let found = motion_by_features(&a, &b, Seed(1)).unwrap();
        assert!((found.translation - truth.translation).length() < 1e-9);
        assert!(found.rotation.angle_between(truth.rotation) < 1e-7);
    }

    #[test]
    fn unrelated_frames_have_no_motion() {
        let mut rng = Seed(6).rng();
        let mut side = || -> Vec<Feature> {
            (0..200)
                .map(|_| Feature {
                    p_c: DVec3::from_array(std::array::from_fn(|_| rng.random::<f64>() - 0.5)) + DVec3::Z,
                    sigma_m: 0.005,
                    descriptor: std::array::from_fn(|_| rng.random::<u64>() & 0xffff),
                })
                .collect()
        };
        let (a, b) = (side(), side());
        assert!(matches(&a, &b).len() > LEAST_INLIERS);
        assert!(motion_by_features(&a, &b, Seed(1)).is_none());
    }
}
