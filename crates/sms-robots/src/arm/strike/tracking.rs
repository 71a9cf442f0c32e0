//! A sweep under torque control in free space.

use crate::{ArmSim, OscConfig, RobotModel, SEGMENT_M, SweepPlan, ToolPath, Workspace};
use glamx::DVec3;
use serde::{Deserialize, Serialize};

/// The tool's motion at the contact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ContactTracking {
    /// Speed along the sweep, m/s.
    pub speed: f64,
    /// Angle between the velocity and the sweep, radians.
    pub direction_error_rad: f64,
    /// Distance of the tool from the sweep's line, metres.
    pub offset_m: f64,
    /// Time from the start of the sweep, seconds.
    pub at_s: f64,
}

/// Tracking of a sweep under control in free space.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Tracking {
    /// The tool at the contact; `None` if it was not reached.
    pub contact: Option<ContactTracking>,
    /// Largest position error of the tool over the sweep, metres.
    pub largest_error_m: f64,
    /// Control periods in which an effort limit cut a torque.
    pub saturated_periods: usize,
    /// Control periods in which the rate limit cut a torque.
    pub rate_limited_periods: usize,
    /// Control periods in which a joint exceeded its speed limit.
    pub over_speed_periods: usize,
}

/// Simulates a sweep in free space: the controller uses `model` and drives `real`, which may differ from it, in steps
/// of `dt` seconds.
pub fn simulate_sweep(
    model: &RobotModel,
    plan: &SweepPlan,
    config: &OscConfig,
    real: &RobotModel,
    friction_scale: f64,
    dt: f64,
) -> Tracking {
    let n = model.dof();
    let mut ws = Workspace::default();
    let mut osc = plan.controller(model, config, &mut ws);
    let mut sim = ArmSim::new(&plan.q_start);
    sim.friction_scale = friction_scale;
    let path = plan.path();
    let d = plan.sweep.direction_w.normalize();
    let start_w = plan.sweep.contact_w - SEGMENT_M * d;
    let mut tracking = Tracking::default();
    let sub_steps = (config.period_s / dt).round().max(1.0) as usize;
    let h = config.period_s / sub_steps as f64;
    let periods = (path.duration_s() / config.period_s).ceil() as usize + 40;
    let (mut before_p, mut before_v) = (start_w, DVec3::ZERO);
    for k in 0..periods {
        let t = k as f64 * config.period_s;
        let reference = path.held(t, config.period_s);
        let error = (before_p - reference.x_wt.translation).length();
        tracking.largest_error_m = tracking.largest_error_m.max(error);
        let out = osc.step(model, &sim.q[..n], &sim.qd[..n], &reference);
        tracking.saturated_periods += usize::from(out.saturated.is_some());
        tracking.rate_limited_periods += usize::from(out.rate_limited.is_some());
        tracking.over_speed_periods += usize::from(out.over_speed.is_some());
        for s in 0..sub_steps {
            sim.step(real, &out.tau[..n], h);
            let (x, v, _) = sim.tool(real);
            let p = x.translation;
            let (was, is) = ((before_p - start_w).dot(d), (p - start_w).dot(d));
            if tracking.contact.is_none() && is >= SEGMENT_M {
                let share = (SEGMENT_M - was) / (is - was);
                let v_at = before_v + share * (v - before_v);
                let p_at = before_p + share * (p - before_p) - start_w;
                tracking.contact = Some(ContactTracking {
                    speed: v_at.dot(d),
                    direction_error_rad: v_at.cross(d).length().atan2(v_at.dot(d)),
                    offset_m: (p_at - p_at.dot(d) * d).length(),
                    at_s: t + (s as f64 + share) * h,
                });
            }
            (before_p, before_v) = (p, v);
        }
    }
    tracking
}
