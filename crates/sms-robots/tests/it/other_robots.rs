//! Other arms than the built-in one: with six joints, and with five, which cannot reach every attitude.

use glamx::{DPose3, DQuat, DVec3};
use sms_robots::{
    IkConfig, RobotModel, StrikeConfig, StrikeError, Sweep, UrdfOptions, Workspace, check_strike, floor,
    plan_strike, simulate_sweep,
};
use std::path::Path;

/// An arm with joints (axis, offset from the previous one, mass). The tool is `reach` beyond the last joint, with its z
/// axis reversed.
fn arm(joints: &[(&str, [f64; 3], f64)], tool_rpy: &str, reach: &str) -> RobotModel {
    let mut text = String::from("<robot name=\"made up\"><link name=\"l0\"/>");
    for (k, (axis, [x, y, z], mass)) in joints.iter().enumerate() {
        let next = k + 1;
        let i = 0.01 * mass;
        text += &format!(
            "<link name=\"l{next}\"><inertial><origin xyz=\"0 0 0.05\"/><mass value=\"{mass}\"/>\
             <inertia ixx=\"{i}\" ixy=\"0\" ixz=\"0\" iyy=\"{i}\" iyz=\"0\" izz=\"{i}\"/></inertial>\
             <collision><geometry><sphere radius=\"0.03\"/></geometry></collision></link>\
             <joint name=\"j{next}\" type=\"revolute\"><parent link=\"l{k}\"/><child link=\"l{next}\"/>\
             <origin xyz=\"{x} {y} {z}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-3.1\" upper=\"3.1\" velocity=\"3.1\" effort=\"150\"/>\
             <dynamics damping=\"0.5\" friction=\"0.8\" armature=\"0.1\"/></joint>"
        );
    }
    let last = joints.len();
    text += &format!(
        "<link name=\"tool\"/><joint name=\"t\" type=\"fixed\"><parent link=\"l{last}\"/><child link=\"tool\"/>\
         <origin xyz=\"{reach}\" rpy=\"{tool_rpy}\"/></joint></robot>"
    );
    let options = UrdfOptions { tool: Some("tool".into()), ..Default::default() };
    RobotModel::from_urdf_text(&text, Path::new("made-up.urdf"), &options).unwrap()
}

fn six() -> RobotModel {
    arm(
        &[
            ("0 0 1", [0.0, 0.0, 0.15], 3.0),
            ("0 1 0", [0.0, 0.13, 0.0], 8.0),
            ("0 1 0", [0.0, -0.12, 0.42], 3.0),
            ("0 1 0", [0.0, 0.0, 0.39], 1.2),
            ("0 0 1", [0.0, 0.1, 0.0], 1.2),
            ("0 1 0", [0.0, 0.0, 0.1], 0.3),
        ],
        "1.5707963267948966 0 0",
        "0 0.15 0",
    )
}

#[test]
fn all_eight_postures_of_an_arm_of_six_joints_are_found() {
    let model = six();
    let mut ws = Workspace::default();
    let pose = DPose3::from_translation(DVec3::new(0.44, 0.1, 0.05));
    let config = IkConfig { starts: 64, ..Default::default() };
    let found = model.inverse_kinematics(&pose, &config, &mut ws).unwrap();
    assert_eq!(found.len(), 8, "shoulder, elbow and wrist each to two sides: {found:?}");
    for s in &found {
        model.forward_kinematics(&s.q, &mut ws);
        assert!((model.frame_pose(model.tool(), &ws).translation - pose.translation).length() < 1e-8);
    }
}

#[test]
fn an_arm_of_six_joints_strikes() {
    let model = six();
    let mut ws = Workspace::default();
    let config = StrikeConfig::default();
    let mut done = 0;
    for (x, y, angle) in [(0.5, 0.1, 0.0f64), (0.4, -0.2, 0.6), (0.55, 0.0, -0.9)] {
        let sweep = Sweep::of_ball(DVec3::new(x, y, 0.05), 0.05, angle, 0.4, 0.01);
        let plan = match plan_strike(&model, &sweep, &[floor(0.0)], &config, &mut ws) {
            Ok(plan) => plan,
            Err(e) => panic!("{x} {y} {angle}: {e}"),
        };
        let t = simulate_sweep(&model, &plan.sweep, &config.osc, &model, 1.0, 0.00125);
        let c = t.contact.unwrap();
        assert!((c.speed / 0.4 - 1.0).abs() < 0.02 && c.direction_error_rad < 0.3f64.to_radians(), "{t:?}");
        done += usize::from(check_strike(&model, &plan, &[floor(0.0)], &config, &mut ws).executable());
    }
    assert_eq!(done, 3, "all of them pass every check");
}

#[test]
fn an_arm_of_five_joints_says_which_attitudes_it_cannot_reach() {
    let model = arm(
        &[
            ("0 0 1", [0.0, 0.0, 0.15], 3.0),
            ("0 1 0", [0.0, 0.0, 0.0], 4.0),
            ("0 1 0", [0.0, 0.0, 0.4], 3.0),
            ("0 1 0", [0.0, 0.0, 0.4], 1.0),
            ("0 0 1", [0.0, 0.0, 0.1], 1.0),
        ],
        "3.141592653589793 0 0",
        "0 0 0.1",
    );
    let mut ws = Workspace::default();
    let position_w = DVec3::new(0.4, 0.2, 0.1);
    let upright = DPose3::from_translation(position_w);
    let found = model.inverse_kinematics(&upright, &IkConfig::default(), &mut ws).unwrap();
    model.forward_kinematics(&found[0].q, &mut ws);
    let x = model.frame_pose(model.tool(), &ws);
    assert!((x.translation - position_w).length() < 1e-8 && x.rotation.angle_between(DQuat::IDENTITY) < 1e-6);
    // This attitude is out of reach: the arm moves in one upright plane.
    let lean = DQuat::from_rotation_arc(DVec3::Z, DVec3::new(-0.2, 0.4, 0.5).normalize());
    let aside = DPose3::from_parts(position_w, lean);
    let e = model.inverse_kinematics(&aside, &IkConfig::default(), &mut ws).unwrap_err();
    assert!(e.position_error_m > 1e-3 || e.angle_error_rad > 1e-2, "{e}");
    let sweep = Sweep { up_w: DVec3::new(0.0, 0.3, 1.0), ..Sweep::of_ball(position_w, 0.05, 0.0, 0.4, 0.01) };
    let e = plan_strike(&model, &sweep, &[], &StrikeConfig::default(), &mut ws).unwrap_err();
    assert!(matches!(e, StrikeError::Unreachable(_)), "{e}");
}
