//! The oracle's gradients against finite differences of its loss.

use crate::oracle::{CHANNELS, Oracle};
use crate::parameters::{
    AFFINITY, COLOR, HARMONICS, LOG_SCALE, LOGIT_OPACITY, PARAMETERS, POSITION, Parameters, ROTATION,
};
use crate::test_scene::{CLASSES, camera, frame, seedlings};
use crate::{DepthTerm, LossWeights, TrainConfig};
use sms_core::Seed;

const NONE: LossWeights = LossWeights {
    color: 0.0,
    ssim: 0.0,
    isotropic: 0.0,
    depth: 0.0,
    normal: 0.0,
    flat: 0.0,
    segmentation: 0.0,
};

/// Returns the largest difference between analytic and central-difference derivatives of each parameter group, and the
/// group's largest derivative: their ratio is the relative error.
fn worst(
    weights: LossWeights,
    depth_term: DepthTerm,
    background: [f64; 3],
    seed: u64,
) -> Vec<(&'static str, f64, f64)> {
    let config = TrainConfig { weights, depth_term, ..TrainConfig::default() };
    let camera = camera(17, 13);
    let frame = frame(camera, Seed(seed));
    let mut parameters = Parameters::new(CLASSES, Seed(2));
    parameters.insert(&seedlings(&camera, 10, Seed(seed - 1)));
    let oracle = Oracle { background, ..Oracle::new(&parameters, &config, false) };
    let gradient = oracle.gradient(&frame);
    let (slopes, bases) = (oracle.own_depth_slopes(&camera), oracle.own_bases(&camera));
    let oracle = Oracle { depth_slopes: Some(slopes), bases: Some(bases), ..oracle };
    // Only the form with a constant divisor differs from the plain derivative.
    let divisors = oracle.depth_divisors(&camera);
    let held = (depth_term == DepthTerm::Detached).then_some(&divisors[..]);
    let total = |oracle: &Oracle| oracle.terms(&frame, held).total(&config.weights);
    let step = 1e-6;
    let mut groups = Vec::new();
    let ranges = [
        ("position", POSITION, ROTATION),
        ("rotation", ROTATION, LOG_SCALE),
        ("scale", LOG_SCALE, LOGIT_OPACITY),
        ("opacity", LOGIT_OPACITY, COLOR),
        ("color", COLOR, AFFINITY),
        ("affinity", AFFINITY, HARMONICS),
        ("harmonics", HARMONICS, PARAMETERS),
    ];
    for (name, first, end) in ranges {
        let (mut error, mut size) = (0.0f64, 0.0f64);
        for i in 0..oracle.rows.len() {
            for k in first..end {
                let mut moved = oracle.clone();
                moved.rows[i][k] += step;
                let above = total(&moved);
                moved.rows[i][k] -= 2.0 * step;
                let numeric = (above - total(&moved)) / (2.0 * step);
                error = error.max((numeric - gradient.rows[i][k]).abs());
                size = size.max(numeric.abs());
            }
        }
        groups.push((name, error, size));
    }
    let (mut error, mut size) = (0.0f64, 0.0f64);
    for k in (0..oracle.classifier.len()).step_by(3) {
        let mut moved = oracle.clone();
        moved.classifier[k] += step;
        let above = total(&moved);
        moved.classifier[k] -= 2.0 * step;
        let numeric = (above - total(&moved)) / (2.0 * step);
        error = error.max((numeric - gradient.classifier[k]).abs());
        size = size.max(numeric.abs());
    }
    groups.push(("classifier", error, size));
    groups
}

fn check(weights: LossWeights, depth_term: DepthTerm, moving: &[&str]) {
    check_before([0.0; 3], weights, depth_term, moving);
}

fn check_before(background: [f64; 3], weights: LossWeights, depth_term: DepthTerm, moving: &[&str]) {
    for seed in [4, 8] {
        for (name, error, size) in worst(weights, depth_term, background, seed) {
            println!("{name}: relative error {:.1e} of {size:.1e}", error / size.max(1e-12));
            assert!(error <= 1e-6 * size, "{name}: {error:e} of {size:e}, seed {seed}");
            assert_eq!(size > 1e-9, moving.contains(&name), "{name} has derivatives up to {size:e}");
        }
    }
}

const SHAPE: [&str; 4] = ["position", "rotation", "scale", "opacity"];

#[test]
fn absolute_color_error() {
    let moving = [&SHAPE[..], &["color", "harmonics"]].concat();
    check(LossWeights { color: 1.0, ..NONE }, DepthTerm::Normalized, &moving);
}

#[test]
fn structural_similarity() {
    let moving = [&SHAPE[..], &["color", "harmonics"]].concat();
    check(LossWeights { color: 1.0, ssim: 1.0, ..NONE }, DepthTerm::Normalized, &moving);
}

#[test]
fn colors_before_a_background() {
    let moving = [&SHAPE[..], &["color", "harmonics"]].concat();
    let background = [0.9, 0.3, 0.6];
    for ssim in [0.0, 1.0] {
        let weights = LossWeights { color: 1.0, ssim, ..NONE };
        check_before(background, weights, DepthTerm::Normalized, &moving);
    }
    // Only colours depend on the background.
    check_before(background, LossWeights { normal: 1.0, ..NONE }, DepthTerm::Normalized, &SHAPE);
}

#[test]
fn the_remaining_transmittance_shows_the_background() {
    let camera = camera(17, 13);
    let mut parameters = Parameters::new(CLASSES, Seed(2));
    parameters.insert(&seedlings(&camera, 10, Seed(3)));
    let black = Oracle::new(&parameters, &TrainConfig::default(), true);
    let background = [0.9, 0.3, 0.6];
    let (dark, lit) = (black.render(&camera), Oracle { background, ..black.clone() }.render(&camera));
    for (dark, lit) in dark.pixels.iter().zip(&lit.pixels) {
        for c in 0..CHANNELS {
            let share = background.get(c).map_or(0.0, |b| b * (1.0 - dark[CHANNELS - 1]));
            assert!((lit[c] - dark[c] - share).abs() < 1e-12, "channel {c}");
        }
    }
}

#[test]
fn depth_in_every_form() {
    for term in [DepthTerm::Normalized, DepthTerm::Detached, DepthTerm::Accumulated] {
        check(LossWeights { depth: 1.0, ..NONE }, term, &SHAPE);
    }
}

#[test]
fn normals() {
    check(LossWeights { normal: 1.0, ..NONE }, DepthTerm::Normalized, &SHAPE);
}

#[test]
fn regularizers_of_scale() {
    check(LossWeights { isotropic: 1.0, ..NONE }, DepthTerm::Normalized, &["scale"]);
    check(LossWeights { flat: 1.0, ..NONE }, DepthTerm::Normalized, &["scale"]);
    check(LossWeights { flat: 1.0, isotropic: 1.0, ..NONE }, DepthTerm::Normalized, &["scale"]);
}

#[test]
fn cross_entropy_moves_affinities_and_classifier() {
    let moving = [&SHAPE[..], &["affinity", "classifier"]].concat();
    check(LossWeights { segmentation: 1.0, ..NONE }, DepthTerm::Normalized, &moving);
}

#[test]
fn all_terms_together() {
    let moving = [&SHAPE[..], &["color", "harmonics", "affinity", "classifier"]].concat();
    for term in [DepthTerm::Normalized, DepthTerm::Detached, DepthTerm::Accumulated] {
        check(LossWeights::default(), term, &moving);
    }
}
