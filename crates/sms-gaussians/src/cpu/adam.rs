//! Adam (Kingma and Ba 2015), applied only to Gaussians visible in the step, each with its own step count.

use super::lanes::{Chunk, Lanes, WIDTH, by_simd};
use crate::LearningRates;
use crate::parameters::{
    AFFINITY, COLOR, ClassifierState, HARMONICS, LOG_SCALE, LOGIT_LIMIT, LOGIT_OPACITY, PARAMETERS, POSITION,
    ROTATION, ROW, Row, SCALE_RANGE,
};

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const EPSILON: f32 = 1e-15;
/// Moments below these are set to zero before they become subnormal, which would slow every later step.
const FIRST_MIN: f32 = 1e-30;
const SECOND_MIN: f32 = 1e-36;
/// Limit of gradients, so that their squares stay finite.
const GRADIENT_MAX: f32 = 1e12;

/// The learning rate of each entry of a row.
pub(super) fn rates_of_row(rates: &LearningRates) -> Row {
    let mut row = [0.0; ROW];
    row[POSITION..ROTATION].fill(rates.position);
    row[ROTATION..LOG_SCALE].fill(rates.rotation);
    row[LOG_SCALE..LOGIT_OPACITY].fill(rates.log_scale);
    row[LOGIT_OPACITY] = rates.opacity;
    row[COLOR..AFFINITY].fill(rates.color);
    row[AFFINITY..HARMONICS].fill(rates.affinity);
    row[HARMONICS..PARAMETERS].fill(rates.harmonics);
    Row(row)
}

#[inline(always)]
fn update<L: Lanes>(
    value: &mut Chunk,
    first: &mut Chunk,
    second: &mut Chunk,
    gradient: &Chunk,
    rate: &Chunk,
    (correction1, correction2): (f32, f32),
) {
    let limit = L::splat(GRADIENT_MAX);
    let g = L::load(gradient).min(limit).max(L::splat(-GRADIENT_MAX));
    let m = L::splat(1.0 - BETA1).mul_add(g, L::splat(BETA1) * L::load(first));
    let v = L::splat(1.0 - BETA2).mul_add(g * g, L::splat(BETA2) * L::load(second));
    let m = m.keep(m.abs().gt(L::splat(FIRST_MIN)));
    let v = v.keep(v.gt(L::splat(SECOND_MIN)));
    m.store(first);
    v.store(second);
    let denominator = (v * L::splat(correction2)).sqrt() + L::splat(EPSILON);
    let step = L::load(rate) * m * L::splat(correction1) / denominator;
    (L::load(value) - step).store(value);
}

fn corrections(steps: u32) -> (f32, f32) {
    let t = steps.min(1_000_000) as i32;
    (1.0 / (1.0 - BETA1.powi(t)), 1.0 / (1.0 - BETA2.powi(t)))
}

/// Takes one step with each visible row. `rates` are those of the row's entries; those of rotations are at most `rim` over the largest
/// scale. A row with a gradient that is not finite remains unchanged.
#[inline(always)]
fn descend<L: Lanes>(
    rows: &mut [Row],
    first: &mut [Row],
    second: &mut [Row],
    steps: &mut [u32],
    gradients: &[Row],
    seen: &[bool],
    (rates, rim): (&Row, f32),
) {
    // View-dependent colour that is not trained has no gradients.
    let chunks = if rates.0[HARMONICS] > 0.0 { ROW / WIDTH } else { HARMONICS.div_ceil(WIDTH) };
    for i in 0..rows.len() {
        if !seen[i] || !gradients[i].0.iter().all(|g| g.is_finite()) {
            continue;
        }
        let mut row = rows[i];
        steps[i] += 1;
        let correction = corrections(steps[i]);
        let largest = row.0[LOG_SCALE..LOGIT_OPACITY].iter().fold(f32::MIN, |a, &b| a.max(b)).exp();
        let (values, _) = row.0.as_chunks_mut::<WIDTH>();
        let (m, _) = first[i].0.as_chunks_mut::<WIDTH>();
        let (v, _) = second[i].0.as_chunks_mut::<WIDTH>();
        let (g, _) = gradients[i].0.as_chunks::<WIDTH>();
        let (rate, _) = rates.0.as_chunks::<WIDTH>();
        let mut first_rates = rate[0];
        first_rates[ROTATION..LOG_SCALE].fill(rates.0[ROTATION].min(rim / largest));
        for k in 0..chunks {
            let rate = if k == 0 { &first_rates } else { &rate[k] };
            update::<L>(&mut values[k], &mut m[k], &mut v[k], &g[k], rate, correction);
        }
        if constrain(&mut row) {
            rows[i] = row;
        } else {
            (first[i], second[i], steps[i]) = (Row::ZERO, Row::ZERO, 0);
        }
    }
}

/// Normalizes the rotation of a row and clamps its values; returns false if this is impossible.
fn constrain(row: &mut Row) -> bool {
    let row = &mut row.0;
    let squared: f32 = row[ROTATION..LOG_SCALE].iter().map(|v| v * v).sum();
    if !(row.iter().all(|v| v.is_finite()) && squared > 1e-12) {
        return false;
    }
    let length = squared.sqrt();
    row[ROTATION..LOG_SCALE].iter_mut().for_each(|v| *v /= length);
    let (low, high) = (SCALE_RANGE.0.ln(), SCALE_RANGE.1.ln());
    row[LOG_SCALE..LOGIT_OPACITY].iter_mut().for_each(|v| *v = v.clamp(low, high));
    row[LOGIT_OPACITY] = row[LOGIT_OPACITY].clamp(-LOGIT_LIMIT, LOGIT_LIMIT);
    true
}

by_simd! {
    /// One Adam step of a chunk of Gaussians.
    fn descend_rows = descend(
        rows: &mut [Row], first: &mut [Row], second: &mut [Row], steps: &mut [u32], gradients: &[Row],
        seen: &[bool], rates: (&Row, f32),
    )
}

/// Takes one Adam step of the classifier, or none if a gradient is not finite.
pub(super) fn descend_classifier(state: &mut ClassifierState, gradient: &[f32], rate: f32) {
    if !gradient.iter().all(|g| g.is_finite()) {
        return;
    }
    state.steps += 1;
    let (correction1, correction2) = corrections(state.steps);
    for (i, &g) in gradient.iter().enumerate() {
        let g = g.clamp(-GRADIENT_MAX, GRADIENT_MAX);
        let m = BETA1 * state.first[i] + (1.0 - BETA1) * g;
        let v = BETA2 * state.second[i] + (1.0 - BETA2) * g * g;
        state.first[i] = if m.abs() > FIRST_MIN { m } else { 0.0 };
        state.second[i] = if v > SECOND_MIN { v } else { 0.0 };
        let step = rate * state.first[i] * correction1 / ((state.second[i] * correction2).sqrt() + EPSILON);
        state.values[i] -= step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::lanes::Simd;

    #[test]
    fn wide_discs_turn_less_so_that_their_rims_move_alike() {
        let rates = LearningRates { rotation: 2e-3, rim: 1e-5, ..LearningRates::default() };
        let turn_of = |scale: f32| {
            let mut row = Row::ZERO;
            row.0[ROTATION + 3] = 1.0;
            row.0[LOG_SCALE..LOGIT_OPACITY].copy_from_slice(&[scale.ln(), (scale / 3.0).ln(), -9.0]);
            let mut gradient = Row::ZERO;
            gradient.0[ROTATION] = -0.7;
            let mut rows = [row];
            descend_rows(
                Simd::detect(),
                &mut rows,
                &mut [Row::ZERO],
                &mut [Row::ZERO],
                &mut [0],
                &[gradient],
                &[true],
                (&rates_of_row(&rates), rates.rim),
            );
            rows[0].0[ROTATION]
        };
        // The first step of Adam has the length of the rate.
        for (scale, expected) in [(1e-3, 2e-3), (5e-3, 2e-3), (0.01, 1e-3), (0.1, 1e-4)] {
            assert!((turn_of(scale) / expected - 1.0).abs() < 1e-3, "{scale}: {}", turn_of(scale));
        }
    }
}
