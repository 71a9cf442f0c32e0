//! Adam (Kingma and Ba 2015), applied only to Gaussians visible in the step, each with its own step count.

use super::lanes::{Chunk, Lanes, WIDTH, by_simd};
use crate::LearningRates;
use crate::parameters::{
    AFFINITY, COLOR, ClassifierState, HARMONICS, LOG_SCALE, LOGIT_LIMIT, LOGIT_OPACITY, PARAMETERS, POSITION,
    ROTATION, ROW, Row, SCALE_RANGE,
};
use glamx::{Quat, Vec3};

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

/// Takes one step with each visible row. `rates` are those of the row's entries; `off_plane` is the share of
/// [`LearningRates::off_plane`]. A row with a gradient that is not finite remains unchanged.
#[inline(always)]
fn descend<L: Lanes>(
    rows: &mut [Row],
    first: &mut [Row],
    second: &mut [Row],
    steps: &mut [u32],
    gradients: &[Row],
    seen: &[bool],
    (rates, off_plane): (&Row, f32),
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
        let (values, _) = row.0.as_chunks_mut::<WIDTH>();
        let (m, _) = first[i].0.as_chunks_mut::<WIDTH>();
        let (v, _) = second[i].0.as_chunks_mut::<WIDTH>();
        let (g, _) = gradients[i].0.as_chunks::<WIDTH>();
        let (rate, _) = rates.0.as_chunks::<WIDTH>();
        for k in 0..chunks {
            update::<L>(&mut values[k], &mut m[k], &mut v[k], &g[k], &rate[k], correction);
        }
        if off_plane < 1.0 {
            hold_in_plane(&rows[i], &mut row, off_plane);
        }
        if constrain(&mut row) {
            rows[i] = row;
        } else {
            (first[i], second[i], steps[i]) = (Row::ZERO, Row::ZERO, 0);
        }
    }
}

/// Reduces the move of a disc along its normal, and its turn about axes in its plane, to a share.
fn hold_in_plane(before: &Row, after: &mut Row, share: f32) {
    let rotation = |row: &Row| Quat::from_slice(&row.0[ROTATION..]);
    let center = |row: &Row| Vec3::from_slice(&row.0[POSITION..]);
    let axis = before.shortest_axis();
    let normal_w = rotation(before) * Vec3::AXES[axis];
    let moved = center(after) - center(before);
    let moved = moved - normal_w * ((1.0 - share) * normal_w.dot(moved));
    after.0[POSITION..ROTATION].copy_from_slice(&(center(before) + moved).to_array());
    let mut turn = (rotation(before).conjugate() * rotation(after)).to_array();
    (0..3).filter(|&a| a != axis).for_each(|a| turn[a] *= share);
    let turned = rotation(before) * Quat::from_array(turn);
    after.0[ROTATION..LOG_SCALE].copy_from_slice(&turned.to_array());
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

    /// A disc with this normal axis after one step, with the same gradient in all positions and quaternion components.
    fn step(rotation: Quat, normal: usize, off_plane: f32) -> Row {
        let rates = LearningRates { position: 1e-3, rotation: 2e-3, off_plane, ..LearningRates::default() };
        let mut row = Row::ZERO;
        row.0[ROTATION..LOG_SCALE].copy_from_slice(&rotation.to_array());
        row.0[LOG_SCALE..LOGIT_OPACITY].copy_from_slice(&[-5.0, -5.5, -6.0]);
        row.0[LOG_SCALE + normal] = -9.0;
        let mut gradient = Row::ZERO;
        gradient.0[..LOG_SCALE].fill(-0.7);
        let (mut rows, mut first, mut second) = ([row], [Row::ZERO], [Row::ZERO]);
        let rates = (&rates_of_row(&rates), rates.off_plane);
        descend_rows(
            Simd::detect(),
            &mut rows,
            &mut first,
            &mut second,
            &mut [0],
            &[gradient],
            &[true],
            rates,
        );
        rows[0]
    }

    #[test]
    fn a_share_of_the_step_leaves_the_plane_of_a_disc() {
        let rotation = Quat::from_euler(glamx::EulerRot::XYZ, 0.4, -0.9, 0.3);
        let axes_w = Vec3::AXES.map(|a| rotation * a);
        let center = |row: &Row| Vec3::from_slice(&row.0[POSITION..]);
        let turn = |row: &Row| (rotation.conjugate() * Quat::from_slice(&row.0[ROTATION..])).to_scaled_axis();
        for normal in 0..3 {
            let free = step(rotation, normal, 1.0);
            // The first step of Adam has the length of the rate in every entry.
            assert!((center(&free) - Vec3::splat(1e-3)).length() < 1e-8);
            assert!(turn(&free).abs().min_element() > 1e-4, "{}", turn(&free));
            for share in [0.0, 0.25, 0.9] {
                let held = step(rotation, normal, share);
                let moved = axes_w.map(|a| a.dot(center(&held)) / a.dot(center(&free)));
                let turned = turn(&held) / turn(&free);
                for k in 0..3 {
                    let (shift, turn) = if k == normal { (share, 1.0) } else { (1.0, share) };
                    assert!(
                        (moved[k] - shift).abs() < 1e-4,
                        "share {share}, axes {k}, {normal}: {}",
                        moved[k]
                    );
                    assert!(
                        (turned[k] - turn).abs() < 0.01,
                        "share {share}, axes {k}, {normal}: {}",
                        turned[k]
                    );
                }
                assert!((Quat::from_slice(&held.0[ROTATION..]).length() - 1.0).abs() < 1e-6);
            }
        }
    }
}
