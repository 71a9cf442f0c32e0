//! The operational-space controller on the FR3.

use glamx::{DPose3, DQuat, DVec3};
use proptest::prelude::*;
use sms_robots::{ArmSim, Jacobian, Osc, OscConfig, RobotModel, ToolReference, Workspace};

const PERIOD: f64 = 0.0025;

/// The gains of the paper's released code: position 100/45, rotation 7.5/5, posture 3/4.5.
fn papers_gains() -> OscConfig {
    OscConfig {
        position_stiffness: 100.0,
        position_damping: 45.0,
        rotation_stiffness: 7.5,
        rotation_damping: 5.0,
        posture_stiffness: 100.0,
        posture_damping: 20.0,
        ..OscConfig::default()
    }
}

/// The reference of a tool at rest in this posture.
fn hold_reference(model: &RobotModel, q: &[f64], ws: &mut Workspace) -> ToolReference {
    model.forward_kinematics(q, ws);
    ToolReference::at_rest(model.frame_pose(model.tool(), ws))
}

fn gravity(model: &RobotModel, q: &[f64]) -> [f64; 7] {
    let mut tau = [0.0; 7];
    model.gravity_torques(q, &mut Workspace::default(), &mut tau);
    tau
}

/// Accelerations of the joints and of the tool under torques, without friction.
fn accelerations(model: &RobotModel, q: &[f64], qd: &[f64], tau: &[f64]) -> ([f64; 7], DVec3, DVec3) {
    let mut ws = Workspace::default();
    let mut qdd = [0.0; 7];
    assert!(model.forward_dynamics(q, qd, tau, &mut ws, &mut qdd));
    model.forward_motion(qd, &qdd, &mut ws);
    let (a, alpha) = model.frame_acceleration(model.tool(), &ws);
    (qdd, a, alpha)
}

/// Without limits, so that the result is that of the control law.
fn unlimited() -> OscConfig {
    OscConfig { torque_rate: 1e12, friction_compensation: false, ..OscConfig::default() }
}

proptest! {
    /// On its own model, the controller gives the tool exactly the acceleration of the law, in any posture: the null
    /// space is dynamically consistent.
    #[test]
    fn the_tool_gets_its_acceleration_and_the_posture_what_is_left(
        shares in prop::array::uniform7(-0.25..0.25f64),
        qd in prop::array::uniform7(-0.3..0.3f64),
        a in prop::array::uniform6(-1.0..1.0f64),
        away in prop::array::uniform7(-0.3..0.3f64),
    ) {
        let model = RobotModel::fr3();
        let q: [f64; 7] = std::array::from_fn(|i| model.home()[i] + shares[i]);
        let mut ws = Workspace::default();
        let here = hold_reference(&model, &q, &mut ws);
        let mut jacobian = Jacobian::default();
        model.jacobian(model.tool(), &ws, &mut jacobian);
        let (v, w) = jacobian.times(&qd);
        let reference = ToolReference {
            v_w: v,
            w_w: w,
            a_w: DVec3::new(a[0], a[1], a[2]),
            alpha_w: DVec3::new(a[3], a[4], a[5]),
            ..here
        };
        let posture: [f64; 7] = std::array::from_fn(|i| q[i] + away[i]);
        let out = Osc::new(unlimited(), &posture, &gravity(&model, &q)).step(&model, &q, &qd, &reference);
        prop_assume!(out.saturated.is_none());
        let (_, linear, angular) = accelerations(&model, &q, &qd, &out.tau);
        prop_assert!((linear - reference.a_w).length() < 1e-3, "{linear} {}", reference.a_w);
        prop_assert!((angular - reference.alpha_w).length() < 1e-3, "{angular} {}", reference.alpha_w);
        // Another null-space posture changes the accelerations of the joints but not that of the tool.
        let other = Osc::new(unlimited(), &q, &gravity(&model, &q)).step(&model, &q, &qd, &reference);
        prop_assume!(other.saturated.is_none());
        let (_, again, _) = accelerations(&model, &q, &qd, &other.tau);
        prop_assert!((again - linear).length() < 1e-3);
    }

    /// Torques stay within their limits and rate limits for any reference.
    #[test]
    fn torques_never_leave_their_limits(
        seed in prop::array::uniform3(-0.5..0.5f64), qd in prop::array::uniform7(-4.0..4.0f64),
    ) {
        let model = RobotModel::fr3();
        let q: Vec<f64> = model.home().to_vec();
        let mut last = gravity(&model, &q);
        let mut osc = Osc::new(OscConfig::default(), &q, &last);
        let far = DPose3::from_parts(DVec3::new(seed[0], seed[1], seed[2]), DQuat::from_rotation_x(3.0 * seed[0]));
        for _ in 0..40 {
            let out = osc.step(&model, &q, &qd, &ToolReference::at_rest(far));
            for i in 0..7 {
                prop_assert!(out.tau[i].abs() <= model.joints()[i].limits.effort + 1e-9);
                prop_assert!((out.tau[i] - last[i]).abs() <= 1000.0 * PERIOD + 1e-9);
                last[i] = out.tau[i];
            }
        }
    }
}

#[test]
fn the_tool_comes_back_from_a_push_and_stays() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let goal = hold_reference(&model, model.home(), &mut ws);
    let mut pushed = model.home().to_vec();
    pushed.iter_mut().enumerate().for_each(|(i, q)| *q += 0.02 * (i as f64 - 3.0));
    let mut sim = ArmSim::new(&pushed);
    let mut osc = Osc::new(OscConfig::default(), model.home(), &gravity(&model, &pushed));
    for _ in 0..800 {
        let out = osc.step(&model, &sim.q[..7], &sim.qd[..7], &goal);
        sim.step(&model, &out.tau[..7], 0.5 * PERIOD);
        sim.step(&model, &out.tau[..7], 0.5 * PERIOD);
    }
    let (x, v, _) = sim.tool(&model);
    assert!((x.translation - goal.x_wt.translation).length() < 1e-5, "{x:?}");
    assert!(x.rotation.angle_between(goal.x_wt.rotation) < 1e-4);
    assert!(v.length() < 1e-4);
    let off = sim.q.iter().zip(model.home()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 5e-3, "the elbow comes back, too: {off}");
}

#[test]
fn a_joint_that_is_too_fast_is_named_and_braked() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let q = model.home().to_vec();
    let mut reference = hold_reference(&model, &q, &mut ws);
    // The tool's reference is as fast as joint 1 moves the tool, and faster.
    let mut qd = [0.0; 7];
    qd[0] = 3.2;
    let mut jacobian = Jacobian::default();
    model.jacobian(model.tool(), &ws, &mut jacobian);
    (reference.v_w, reference.w_w) = jacobian.times(&qd);
    reference.v_w *= 1.5;
    let out = Osc::new(unlimited(), &q, &gravity(&model, &q)).step(&model, &q, &qd, &reference);
    assert_eq!(out.over_speed, Some(0));
    let mut bias = [0.0; 7];
    model.bias_torques(&q, &qd, &mut ws, &mut bias);
    assert!(out.tau[0] < bias[0], "braked: {} {}", out.tau[0], bias[0]);
    qd[0] = 2.0;
    let out = Osc::new(unlimited(), &q, &gravity(&model, &q)).step(&model, &q, &qd, &reference);
    assert_eq!(out.over_speed, None);
}

#[test]
fn the_papers_gains_hold_the_tool() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let goal = hold_reference(&model, model.home(), &mut ws);
    let mut sim = ArmSim::new(model.home());
    let mut osc = Osc::new(papers_gains(), model.home(), &gravity(&model, model.home()));
    for _ in 0..400 {
        let out = osc.step(&model, &sim.q[..7], &sim.qd[..7], &goal);
        sim.step(&model, &out.tau[..7], PERIOD);
    }
    assert!((sim.tool(&model).0.translation - goal.x_wt.translation).length() < 1e-4);
}
