//! Poses of keyframes from measured motions between them, by Gauss-Newton with robust weights.

use super::registration::{Registration, about};
use crate::align::moved_about;
use crate::floor::{PairFloor, PairForm};
use crate::linear::{Block, COMMON, Row, Six, System, product};
use crate::pair::CameraSums;
use glamx::{DMat3, DPose3, DVec3};

/// A measured motion from one keyframe to another.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) motion: Registration,
    /// Whether it is part of the track of frame after frame, without which there is no pose.
    pub(super) is_tracked: bool,
}

/// Rounds of estimating the floor of the registration errors, and the poses with it.
const ROUNDS: usize = 3;
/// Most Gauss-Newton iterations of a round.
const ITERATIONS: usize = 10;
/// Weight of a pose that is held.
const HELD: f64 = 1e12;
/// χ² per degree of freedom at which an edge has half of its weight (Cauchy): wrong loops then lose against right ones.
const HALF_WEIGHT: f64 = 9.0;
/// Edges with less weight than this contradict the others.
const LEAST_WEIGHT: f64 = 0.1;

/// The quadratic form of an edge about the common centre, and its disagreement.
struct Weighed {
    form: PairForm,
    weight: f64,
}

/// Moves the poses `x_wc` of keyframes to agree best with the edges. The keyframes `held` keep theirs: one of each connected
/// part. Returns whether each edge agrees with the result.
pub(super) fn settle(x_wc: &mut [DPose3], edges: &[Edge], held: &[usize]) -> Vec<bool> {
    let n = x_wc.len().max(1) as f64;
    let center_w = x_wc.iter().map(|x| x.translation).sum::<DVec3>() / n;
    let arm_m = edges.iter().map(|e| e.motion.arm_m).sum::<f64>() / edges.len().max(1) as f64;
    // At first, the floor is such that no edge dominates by its number of points.
    let mut floor = PairFloor { shift_m: 0.002, arm_m };
    let mut agrees = vec![true; edges.len()];
    for _ in 0..ROUNDS {
        for _ in 0..ITERATIONS {
            let weighed: Vec<Weighed> = edges.iter().map(|e| weighed(e, x_wc, center_w, &floor)).collect();
            let mut system = System::new(x_wc.len());
            (0..COMMON).for_each(|k| system.add_common(k, 0.0, HELD));
            for &frame in held {
                for k in 0..6 {
                    let unit: Six = std::array::from_fn(|a| f64::from(u8::from(a == k)));
                    system.add_row(&Row { frames: vec![(frame, unit)], common: [0.0; COMMON] }, 0.0, HELD);
                }
            }
            for (edge, Weighed { form, weight }) in edges.iter().zip(&weighed) {
                let h = form.h.map(|row| row.map(|v| weight * v));
                system.add_pair(edge.from, edge.to, &h, &form.g.map(|v| weight * v), &CameraSums::default());
            }
            let Some((steps, _)) = system.solve() else { return agrees };
            let mut largest = 0f64;
            for (x, step) in x_wc.iter_mut().zip(&steps) {
                let moved = moved_about(center_w, step) * *x;
                largest = largest.max((moved.translation - x.translation).length());
                *x = DPose3::from_parts(moved.translation, moved.rotation.normalize());
            }
            if largest < 1e-6 {
                break;
            }
        }
        let now: Vec<Weighed> = edges.iter().map(|e| weighed(e, x_wc, center_w, &floor)).collect();
        agrees = now.iter().map(|w| w.weight >= LEAST_WEIGHT).collect();
        // The forms without a floor, each about its own centre, tell its size.
        let fitting: Vec<PairForm> = edges
            .iter()
            .zip(&agrees)
            .filter(|(_, agrees)| **agrees)
            .map(|(e, _)| own_form(e, x_wc))
            .collect();
        let unknown = 6 * x_wc.len().saturating_sub(held.len());
        floor = PairFloor::fitted(&fitting, floor.arm_m, unknown);
    }
    agrees
}

/// Returns the motion about `center_w` that carries the second camera to the place that the first one expects.
fn disagreement(edge: &Edge, x_wc: &[DPose3], center_w: DVec3) -> Six {
    let expected = x_wc[edge.from] * edge.motion.x_ab * x_wc[edge.to].inverse();
    let turn = expected.rotation.to_scaled_axis();
    let shift = expected.transform_point(center_w) - center_w;
    [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
}

/// Returns the form of an edge about its own centre, in the axes of the world.
fn own_form(edge: &Edge, x_wc: &[DPose3]) -> PairForm {
    let x_wi = &x_wc[edge.from];
    let h = in_world(&edge.motion.information, &DMat3::from_quat(x_wi.rotation));
    let g = product(&h, &disagreement(edge, x_wc, x_wi.transform_point(edge.motion.center_a)));
    PairForm { h, g, camera: CameraSums::default() }
}

fn weighed(edge: &Edge, x_wc: &[DPose3], center_w: DVec3, floor: &PairFloor) -> Weighed {
    let off = disagreement(edge, x_wc, center_w);
    let form = own_form(edge, x_wc);
    let h = floor.applied(&form).h;
    let to_center = about(x_wc[edge.from].transform_point(edge.motion.center_a), center_w);
    let h: Block = times(&transposed(&to_center), &times(&h, &to_center));
    let g = product(&h, &off);
    let chi_squared: f64 = (0..6).map(|k| off[k] * g[k]).sum();
    let weight = (1.0 + chi_squared / (6.0 * HALF_WEIGHT)).recip();
    Weighed { form: PairForm { h, g, ..form }, weight }
}

/// Returns the block in the axes of the world.
fn in_world(h: &Block, r_wi: &DMat3) -> Block {
    let mut turn = [[0.0; 6]; 6];
    for a in 0..3 {
        for b in 0..3 {
            turn[a][b] = r_wi.col(b)[a];
            turn[3 + a][3 + b] = r_wi.col(b)[a];
        }
    }
    times(&turn, &times(h, &transposed(&turn)))
}

fn times(a: &Block, b: &Block) -> Block {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| a[i][k] * b[k][j]).sum()))
}

fn transposed(a: &Block) -> Block {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}
