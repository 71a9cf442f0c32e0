//! Sweeps from several postures, advanced side by side, each only as far as needed to find the best.

use crate::arm::osc::TaskLaw;
use crate::arm::strike::motion::{Meter, StepwiseRollout, within_limits};
use crate::arm::strike::obstruction::ClearanceCheck;
use crate::arm::strike::sweep::SweepPath;
use crate::{RobotModel, StrikeConfig, StrikeError, SweepPlan, ToolPath, Workspace};

/// Samples between comparisons.
const STRIDE: usize = 4;

/// A sweep from one posture, in coarse steps.
pub(crate) struct SweepCandidate<'a> {
    model: &'a RobotModel,
    /// Index among all postures.
    pub(crate) slot: usize,
    path: &'a SweepPath,
    q_start: &'a [f64],
    rollout: StepwiseRollout<'a, SweepPath>,
    meter: Meter<'a>,
}

impl<'a> SweepCandidate<'a> {
    pub(crate) fn new(
        model: &'a RobotModel,
        slot: usize,
        path: &'a SweepPath,
        q_start: &'a [f64],
        config: &StrikeConfig,
    ) -> Self {
        let coarse = 0.005f64.max(path.duration_s() / 40.0);
        let rollout = StepwiseRollout::new(model, path, q_start, &config.osc, coarse, 0.0);
        let meter = Meter::new(model, config.osc.torque_rate, rollout.period_s);
        Self { model, slot, path, q_start, rollout, meter }
    }

    /// The largest share of any limit used so far.
    pub(crate) fn limit_share(&self) -> f64 {
        self.meter.largest()
    }

    /// Removes and returns the sweep with the smallest limit share at its end, the first among equals; `None` if none
    /// is left. The share never decreases along a sweep, so a sweep is advanced only until its share exceeds that of
    /// the best one. (The share of a diverging sweep may decrease, but such a sweep exceeds a limit in any case.)
    pub(crate) fn take_best(all: &mut Vec<Self>, law: &mut TaskLaw) -> Option<Self> {
        loop {
            let least =
                (0..all.len()).min_by(|&a, &b| all[a].limit_share().total_cmp(&all[b].limit_share()))?;
            if all[least].rollout.is_over() {
                return Some(all.remove(least));
            }
            let Self { rollout, meter, .. } = &mut all[least];
            for _ in 0..STRIDE {
                let Some(sample) = rollout.advance(law) else { break };
                meter.note(sample);
            }
        }
    }

    /// The plan, if it stays within the limits at this resolution and is free of collisions.
    pub(crate) fn into_plan(
        self,
        check: &ClearanceCheck<'_>,
        ws: &mut Workspace,
    ) -> Result<SweepPlan, StrikeError> {
        let uses = within_limits(self.model, self.meter.uses)?;
        let motion = self.rollout.into_motion();
        if let Some((clearance, at_s)) = check.first_violation(self.model, &motion, ws) {
            return Err(StrikeError::Blocked { clearance, at_s });
        }
        let SweepPath { sweep, rotation_w } = *self.path;
        Ok(SweepPlan { sweep, rotation_w, q_start: self.q_start.to_vec(), motion, uses })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::strike::motion::roll_out;
    use crate::arm::strike::posture::postures;
    use crate::arm::strike::sweep_plan::COARSE_ENOUGH;
    use crate::{FIST_HALF, Sweep};
    use glamx::{DPose3, DVec3};

    /// Sweeps over the workspace, each with the postures at its start.
    fn sweeps(model: &RobotModel, config: &StrikeConfig) -> Vec<(SweepPath, Vec<Vec<f64>>)> {
        let ws = &mut Workspace::default();
        let mut all = Vec::new();
        for (k, speed) in [0.2, 0.4, 0.7, 1.0, 1.4].into_iter().enumerate() {
            for (x, y) in [(0.4, 0.1), (0.55, -0.15), (0.65, 0.2)] {
                let ball = DVec3::new(x, y, 0.03);
                let sweep = Sweep::of_ball(ball, 0.03, 0.9 * k as f64 - 1.8 + y, speed, FIST_HALF.x);
                let path = sweep.path(sweep.rotation_w());
                let target = DPose3::from_parts(sweep.contact_w, path.rotation_w);
                let at_contact = postures(model, &target, &config.ik, ws).unwrap_or_default();
                let start = path.at(0.0).x_wt;
                let starts =
                    at_contact.iter().filter_map(|q| model.refine(&start, q, &config.ik, ws).ok()).take(8);
                all.push((path, starts.collect()));
            }
        }
        all
    }

    #[test]
    fn they_come_in_the_order_of_their_whole_motions_and_bit_for_bit_the_same() {
        let (model, config) = (RobotModel::fr3(), StrikeConfig::default());
        let mut law = TaskLaw::default();
        let (mut orders, mut saved) = (0, 0);
        for (path, starts) in sweeps(&model, &config) {
            let coarse = 0.005f64.max(path.duration_s() / 40.0);
            let whole: Vec<_> =
                starts.iter().map(|q| roll_out(&model, &path, q, &config.osc, coarse, 0.0)).collect();
            let badness: Vec<f64> = whole
                .iter()
                .map(|m| m.uses(&model, config.osc.torque_rate).iter().map(|u| u.1.share).fold(0.0, f64::max))
                .collect();
            let mut expected: Vec<usize> = (0..starts.len()).collect();
            expected.sort_by(|&a, &b| badness[a].total_cmp(&badness[b]));
            let mut running: Vec<SweepCandidate<'_>> = starts
                .iter()
                .enumerate()
                .map(|(i, q)| SweepCandidate::new(&model, i, &path, q, &config))
                .collect();
            for (place, i) in expected.into_iter().enumerate() {
                let next = SweepCandidate::take_best(&mut running, &mut law).unwrap();
                assert_eq!((next.slot, next.limit_share()), (i, badness[i]));
                assert_eq!(next.rollout.into_motion(), whole[i]);
                if place == 0 {
                    saved += running.iter().filter(|f| !f.rollout.is_over()).count();
                }
                orders += 1;
            }
            assert!(SweepCandidate::take_best(&mut running, &mut law).is_none());
        }
        // Fails if no case tests the ordering or the early stop.
        assert!(orders > 50 && saved > 20, "{orders} {saved}");
    }

    #[test]
    fn what_is_far_from_all_limits_in_coarse_steps_is_within_them_in_fine_ones() {
        let (model, config) = (RobotModel::fr3(), StrikeConfig::default());
        let (mut looked_at, mut worst) = (0, f64::NEG_INFINITY);
        for (path, starts) in sweeps(&model, &config) {
            for q in &starts {
                let [coarse, fine] =
                    [0.005f64.max(path.duration_s() / 40.0), config.period_s.max(path.duration_s() / 200.0)]
                        .map(|period_s| roll_out(&model, &path, q, &config.osc, period_s, 0.0))
                        .map(|m| m.uses(&model, config.osc.torque_rate))
                        .map(|uses| uses.iter().map(|u| u.1.share).fold(0.0, f64::max));
                if coarse <= COARSE_ENOUGH {
                    looked_at += 1;
                    worst = worst.max(fine - coarse);
                }
            }
        }
        println!("{looked_at} sweeps: fine steps show {worst:.3} more of a limit than coarse ones at most");
        assert!(looked_at > 20 && worst < 1.0 - COARSE_ENOUGH, "{looked_at} {worst}");
    }
}
