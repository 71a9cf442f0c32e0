//! Sweeps from several postures side by side, each only as far as it takes to know which is the best.

use crate::model::RobotModel;
use crate::motion::{Following, Meter, within_limits};
use crate::osc::TaskLaw;
use crate::shape::Obstacle;
use crate::strike::{StrikeConfig, StrikeError, SweepPlan, blocked};
use crate::sweep::{SweepPath, ToolPath};
use crate::workspace::Workspace;

/// Samples that are worked out between looks at who is the best.
const STRIDE: usize = 4;

/// A sweep from one posture, worked out in coarse steps.
pub(crate) struct Followed<'a> {
    model: &'a RobotModel,
    /// Its place among all postures.
    pub(crate) slot: usize,
    path: &'a SweepPath,
    q_start: &'a [f64],
    following: Following<'a, SweepPath>,
    meter: Meter<'a>,
}

impl<'a> Followed<'a> {
    pub(crate) fn new(
        model: &'a RobotModel,
        slot: usize,
        path: &'a SweepPath,
        q_start: &'a [f64],
        config: &StrikeConfig,
    ) -> Self {
        let coarse = 0.005f64.max(path.duration_s() / 40.0);
        let following = Following::new(model, path, q_start, q_start, &config.osc, coarse, 0.0);
        let meter = Meter::new(model, config.osc.torque_rate, following.period_s);
        Self { model, slot, path, q_start, following, meter }
    }

    /// The largest share of any limit that it has used so far.
    pub(crate) fn badness(&self) -> f64 {
        self.meter.largest()
    }

    /// Takes the one out that uses the least share of any limit to its end, the first among equals; `None` where none is
    /// left. The share only grows as a sweep goes on, so that the others need not be worked out beyond that share. (That of a
    /// sweep which stops being finite may fall; it breaks a limit in any case.)
    pub(crate) fn least(all: &mut Vec<Self>, law: &mut TaskLaw) -> Option<Self> {
        loop {
            let least = (0..all.len()).min_by(|&a, &b| all[a].badness().total_cmp(&all[b].badness()))?;
            if all[least].following.is_over() {
                return Some(all.remove(least));
            }
            let Self { following, meter, .. } = &mut all[least];
            for _ in 0..STRIDE {
                let Some(sample) = following.advance(law) else { break };
                meter.note(sample);
            }
        }
    }

    /// The plan, where it keeps the limits in these steps and nothing is in its way.
    pub(crate) fn into_plan(
        self,
        obstacles: &[Obstacle],
        config: &StrikeConfig,
        ws: &mut Workspace,
    ) -> Result<SweepPlan, StrikeError> {
        let uses = within_limits(self.model, self.meter.uses)?;
        let motion = self.following.into_motion();
        if let Some((clearance, at_s)) = blocked(self.model, &motion, obstacles, config.clearance_m, ws) {
            return Err(StrikeError::Blocked { clearance, at_s });
        }
        let SweepPath { sweep, rotation_w } = *self.path;
        Ok(SweepPlan { sweep, rotation_w, q_start: self.q_start.to_vec(), motion, uses })
    }
}
