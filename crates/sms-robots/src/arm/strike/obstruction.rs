//! Clearance along a motion.

use crate::arm::shape::Clearance;
use crate::{JointMotion, Obstacle, RobotModel, Workspace};

/// Required clearance of a motion from obstacles and between links.
#[derive(Clone, Copy)]
pub(crate) struct ClearanceCheck<'a> {
    pub(crate) obstacles: &'a [Obstacle],
    /// Whether the body to strike counts as an obstacle.
    pub(crate) with_struck: bool,
    /// Smallest permitted distance, metres.
    pub(crate) clearance_m: f64,
    /// Largest time between checked postures of a motion, seconds. At least thirteen postures are checked.
    pub(crate) interval_s: f64,
}

impl ClearanceCheck<'_> {
    /// The first violation in a motion, and its time in seconds from the motion's start.
    pub(crate) fn first_violation(
        &self,
        model: &RobotModel,
        motion: &JointMotion,
        ws: &mut Workspace,
    ) -> Option<(Clearance, f64)> {
        let last = motion.samples.len() - 1;
        let places = 12.max((motion.duration_s() / self.interval_s) as usize).min(last.max(1));
        (0..=places).map(|k| k * last / places).find_map(|index| {
            let near = self.violation(model, &motion.samples[index].q, ws)?;
            Some((near, index as f64 * motion.period_s))
        })
    }

    /// Returns the nearest pair of links, or link and obstacle, if it is closer than the clearance.
    pub(crate) fn violation(&self, model: &RobotModel, q: &[f64], ws: &mut Workspace) -> Option<Clearance> {
        let clearance_m = self.clearance_m;
        let mut poses = Vec::new();
        model.forward_kinematics(q, ws);
        model.shape_poses(ws, &mut poses);
        let near = |c: Clearance| (c.distance_m < clearance_m).then_some(c);
        let with_itself = model.self_clearance(&poses, clearance_m).and_then(near);
        let with_others = self
            .obstacles
            .iter()
            .filter(|o| (self.with_struck || !o.is_struck) && model.may_be_near(&poses, o, clearance_m))
            .filter_map(|o| model.obstacle_clearance(&poses, o, clearance_m).and_then(near));
        with_itself.into_iter().chain(with_others).min_by(|a, b| a.distance_m.total_cmp(&b.distance_m))
    }
}
