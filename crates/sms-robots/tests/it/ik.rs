//! Inverse kinematics of the FR3.

use glamx::{DPose3, DQuat, DVec3};
use proptest::prelude::*;
use sms_robots::{IkConfig, RobotModel, Workspace};

fn tool_at(model: &RobotModel, q: &[f64]) -> DPose3 {
    let mut ws = Workspace::default();
    model.forward_kinematics(q, &mut ws);
    model.frame_pose(model.tool(), &ws)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Targets from postures well inside the limits are found, and all solutions reach them.
    #[test]
    fn what_can_be_reached_is_found(shares in prop::array::uniform7(0.1..0.9f64)) {
        let model = RobotModel::fr3();
        let q: Vec<f64> = model
            .joints()
            .iter()
            .zip(shares)
            .map(|(j, s)| j.limits.lower + s * (j.limits.upper - j.limits.lower))
            .collect();
        let goal = tool_at(&model, &q);
        // More starts than for a strike: poses behind the back are rare in practice.
        let config = IkConfig { starts: 48, ..Default::default() };
        let found = model.inverse_kinematics(&goal, &config, &mut Workspace::default());
        let found = found.map_err(|e| TestCaseError::fail(e.to_string()))?;
        for solution in &found {
            let x = tool_at(&model, &solution.q);
            prop_assert!((x.translation - goal.translation).length() < 1e-8);
            prop_assert!(x.rotation.angle_between(goal.rotation) < 1e-6);
            let margins = model.joints().iter().zip(&solution.q).map(|(j, q)| {
                (q - j.limits.lower).min(j.limits.upper - q)
            });
            let margin = margins.fold(f64::INFINITY, f64::min);
            prop_assert!(margin >= 0.02 - 1e-12);
            // The smallest margin is 0.02 rad, and no half range exceeds 3.1 rad.
            prop_assert!(solution.limit_share > 0.02 / 3.1 && solution.limit_share <= margin, "{solution:?}");
        }
        let worth = |s: &sms_robots::IkSolution| s.limit_share * s.manipulability;
        prop_assert!(found.windows(2).all(|w| worth(&w[0]) >= worth(&w[1])), "{found:?}");
    }
}

#[test]
fn what_is_out_of_reach_is_said_with_how_far() {
    let model = RobotModel::fr3();
    let far = DPose3::from_parts(DVec3::new(1.5, 0.0, 0.333), DQuat::IDENTITY);
    let e = model.inverse_kinematics(&far, &IkConfig::default(), &mut Workspace::default()).unwrap_err();
    // The wrist reaches 0.855 m, and the tool extends at most 0.3 m beyond it.
    assert!((0.345..1.0).contains(&e.position_error_m), "{e}");
    let reached = tool_at(&model, &e.best_q);
    assert!((reached.translation.distance(far.translation) - e.position_error_m).abs() < 1e-12);
    // A point within reach, but not with this attitude: palm up close to the floor.
    let twisted =
        DPose3::from_parts(DVec3::new(0.5, 0.0, 0.03), DQuat::from_rotation_x(std::f64::consts::PI));
    let e = model.inverse_kinematics(&twisted, &IkConfig::default(), &mut Workspace::default()).unwrap_err();
    assert!(!e.binding.is_empty(), "{e}");
}

#[test]
fn limits_that_cannot_reach_are_named() {
    // An arm that can hardly leave the plane y = 0 cannot bring the tool to its side.
    let mut text = sms_robots::FR3_URDF.to_owned();
    for limit in ["2.7437", "2.9007", "2.8065"] {
        let wide = format!("lower=\"-{limit}\" upper=\"{limit}\"");
        assert!(text.contains(&wide));
        text = text.replace(&wide, "lower=\"-0.1\" upper=\"0.1\"");
    }
    let options = sms_robots::UrdfOptions { tool: Some("fr3_fist".into()), ..Default::default() };
    let model = RobotModel::from_urdf_text(&text, std::path::Path::new("stiff.urdf"), &options).unwrap();
    let aside = DPose3::from_translation(DVec3::new(0.3, 0.4, 0.1));
    let e = model.inverse_kinematics(&aside, &IkConfig::default(), &mut Workspace::default()).unwrap_err();
    assert!(e.binding.iter().any(|(name, upper)| name == "fr3_joint1" && *upper), "{e}");
}

#[test]
fn the_best_posture_is_pinned() {
    let model = RobotModel::fr3();
    let target = DPose3::from_translation(DVec3::new(0.5, 0.1, 0.05));
    let found = model.inverse_kinematics(&target, &IkConfig::default(), &mut Workspace::default()).unwrap();
    let expected =
        [1.209_588_25, 0.732_591_29, -0.928_852_47, -2.261_871_12, 1.035_552_36, 2.469_328_05, 0.290_090_40];
    assert_eq!(found.len(), 12);
    for (q, expected) in found[0].q.iter().zip(expected) {
        assert!((q - expected).abs() < 1e-6, "{:?}", found[0].q);
    }
}
