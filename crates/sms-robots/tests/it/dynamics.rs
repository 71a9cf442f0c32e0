//! Kinematics and dynamics against closed forms, finite differences and conservation laws.

use glamx::{DMat3, DQuat, DVec3};
use proptest::prelude::*;
use sms_core::MassProperties;
use sms_robots::{ArmSim, Jacobian, MAX_JOINTS, OffChain, RobotModel, UrdfOptions, Workspace};
use std::path::Path;

/// Two rods in the vertical plane x-z: lengths, distances of their centres, masses and inertias.
const L1: f64 = 0.7;
const C1: f64 = 0.3;
const C2: f64 = 0.25;
const M1: f64 = 2.0;
const M2: f64 = 1.3;
const I1: f64 = 0.05;
const I2: f64 = 0.03;

fn double_pendulum() -> RobotModel {
    let link = |name: &str, m: f64, c: f64, i: f64| {
        format!(
            "<link name=\"{name}\"><inertial><origin xyz=\"{c} 0 0\"/><mass value=\"{m}\"/>\
             <inertia ixx=\"{i}\" ixy=\"0\" ixz=\"0\" iyy=\"{i}\" iyz=\"0\" izz=\"{i}\"/></inertial></link>"
        )
    };
    let joint = |name: &str, parent: &str, child: &str, x: f64| {
        format!(
            "<joint name=\"{name}\" type=\"continuous\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
             <origin xyz=\"{x} 0 0\"/><axis xyz=\"0 -1 0\"/><limit velocity=\"9\" effort=\"99\"/></joint>"
        )
    };
    let text = format!(
        "<robot name=\"p\"><link name=\"base\"/>{}{}<link name=\"tip\"/>{}{}\
         <joint name=\"t\" type=\"fixed\"><parent link=\"two\"/><child link=\"tip\"/><origin xyz=\"0.5 0 0\"/></joint></robot>",
        link("one", M1, C1, I1),
        link("two", M2, C2, I2),
        joint("a", "base", "one", 0.0),
        joint("b", "one", "two", L1),
    );
    RobotModel::from_urdf_text(&text, Path::new("pendulum.urdf"), &UrdfOptions::default()).unwrap()
}

fn branch() -> RobotModel {
    let options =
        UrdfOptions { tool: Some("tip".into()), off_chain: OffChain::Move, ..UrdfOptions::default() };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/oracle/branch.urdf");
    RobotModel::from_urdf(&path, &options).unwrap()
}

/// Potential energy under gravity, J, zero with all masses at the world's origin.
fn potential_energy(model: &RobotModel, ws: &Workspace) -> f64 {
    let of = |(i, m): (usize, MassProperties)| {
        9.81 * m.mass() * model.body_pose(Some(i), ws).transform_point(m.com()).z
    };
    model.joints().iter().enumerate().filter_map(|(i, j)| Some((i, j.mass?))).map(of).sum()
}

proptest! {
    /// The textbook's equations (angles from the horizontal, upwards).
    #[test]
    fn the_double_pendulum_is_the_textbooks(
        q in prop::array::uniform2(-3.0..3.0f64),
        v in prop::array::uniform2(-5.0..5.0f64),
        a in prop::array::uniform2(-20.0..20.0f64),
    ) {
        let g = 9.81;
        let (s2, c2) = q[1].sin_cos();
        let m11 = I1 + I2 + M1 * C1 * C1 + M2 * (L1 * L1 + C2 * C2 + 2.0 * L1 * C2 * c2);
        let m12 = I2 + M2 * (C2 * C2 + L1 * C2 * c2);
        let m22 = I2 + M2 * C2 * C2;
        let h = M2 * L1 * C2 * s2;
        let lean = M2 * C2 * g * (q[0] + q[1]).cos();
        let expected = [
            m11 * a[0] + m12 * a[1] - h * (2.0 * v[0] * v[1] + v[1] * v[1])
                + (M1 * C1 + M2 * L1) * g * q[0].cos() + lean,
            m12 * a[0] + m22 * a[1] + h * v[0] * v[0] + lean,
        ];
        let model = double_pendulum();
        let mut ws = Workspace::default();
        let mut tau = [0.0; 2];
        model.inverse_dynamics(&q, &v, &a, &mut ws, &mut tau);
        for i in 0..2 {
            prop_assert!((tau[i] - expected[i]).abs() < 1e-11, "{tau:?} {expected:?}");
        }
        let mut qdd = [0.0; 2];
        prop_assert!(model.forward_dynamics(&q, &v, &tau, &mut ws, &mut qdd));
        for i in 0..2 {
            prop_assert!((qdd[i] - a[i]).abs() < 1e-9, "{qdd:?} {a:?}");
        }
    }

    /// Compares Jacobian and J̇ q̇ with differences of the pose and of the velocity.
    #[test]
    fn derivatives_are_those_of_the_motion(
        q in prop::array::uniform5(-0.4..0.4f64), v in prop::array::uniform5(-2.0..2.0f64),
    ) {
        let model = branch();
        let mut ws = Workspace::default();
        let h = 1e-6;
        let at = |sign: f64| -> [f64; 5] { std::array::from_fn(|i| q[i] + sign * h * v[i]) };
        let mut pose = |q: &[f64]| {
            model.forward_kinematics(q, &mut ws);
            model.frame_pose(model.tool(), &ws)
        };
        let (before, after) = (pose(&at(-1.0)), pose(&at(1.0)));
        let turn = after.rotation * before.rotation.inverse();
        let slope = (after.translation - before.translation) / (2.0 * h);
        let spin = DVec3::new(turn.x, turn.y, turn.z) * turn.w.signum() / h;
        let mut ws = Workspace::default();
        model.forward_kinematics(&q, &mut ws);
        let mut jacobian = Jacobian::default();
        model.jacobian(model.tool(), &ws, &mut jacobian);
        let (linear, angular) = jacobian.times(&v);
        prop_assert!((slope - linear).length() < 1e-7 && (spin - angular).length() < 1e-7);
        let mut velocity = |sign: f64| {
            model.forward_kinematics(&at(sign), &mut ws);
            model.forward_motion(&v, &[0.0; MAX_JOINTS], &mut ws);
            model.frame_velocity(model.tool(), &ws)
        };
        let (before, after) = (velocity(-1.0), velocity(1.0));
        model.forward_kinematics(&q, &mut ws);
        model.forward_motion(&v, &[0.0; MAX_JOINTS], &mut ws);
        let (a, alpha) = model.frame_acceleration(model.tool(), &ws);
        prop_assert!(((after.0 - before.0) / (2.0 * h) - a).length() < 1e-6);
        prop_assert!(((after.1 - before.1) / (2.0 * h) - alpha).length() < 1e-6);
    }

    /// An impulse p at a point adds p · (v before + v after) / 2 of kinetic energy, and changes the velocity of the
    /// point by mobility times p.
    #[test]
    fn an_impulse_does_the_work_that_it_must(
        q in prop::array::uniform7(-0.8..0.8f64), v in prop::array::uniform7(-1.0..1.0f64),
        p in prop::array::uniform3(-1.0..1.0f64), at in prop::array::uniform3(-0.1..0.1f64),
    ) {
        let model = RobotModel::fr3();
        let mut ws = Workspace::default();
        model.forward_kinematics(&q, &mut ws);
        let x = model.frame_pose(model.tool(), &ws);
        let (arm, p) = (x.rotation * DVec3::from(at), DVec3::from(p));
        let point_w = x.translation + arm;
        let mut jacobian = Jacobian::default();
        model.jacobian(model.tool(), &ws, &mut jacobian);
        let velocity = |qd: &[f64]| {
            let (v, w) = jacobian.times(qd);
            v + w.cross(arm)
        };
        let mut after = v;
        let before = model.kinetic_energy(&v, &mut ws);
        model.apply_impulse(model.tool(), point_w, p, &mut ws, &mut after);
        let work = model.kinetic_energy(&after, &mut ws) - before;
        let expected = 0.5 * p.dot(velocity(&v) + velocity(&after));
        prop_assert!((work - expected).abs() < 1e-9, "{work} {expected}");
        let mobility = model.point_mobility(model.tool(), point_w, &mut ws);
        prop_assert!((velocity(&after) - velocity(&v) - mobility * p).length() < 1e-10);
    }

    /// M from composite bodies equals Newton-Euler for unit accelerations.
    #[test]
    fn the_mass_matrix_is_the_derivative_of_inverse_dynamics(q in prop::array::uniform5(-0.4..0.4f64)) {
        let model = branch();
        let mut ws = Workspace::default();
        let zero = [0.0; 5];
        let mut gravity = [0.0; 5];
        model.gravity_torques(&q, &mut ws, &mut gravity);
        model.forward_kinematics(&q, &mut ws);
        let mass = *model.mass_matrix(&mut ws);
        for j in 0..5 {
            let mut unit = zero;
            unit[j] = 1.0;
            let mut tau = zero;
            model.inverse_dynamics(&q, &zero, &unit, &mut ws, &mut tau);
            for i in 0..5 {
                prop_assert!((tau[i] - gravity[i] - mass[i][j]).abs() < 1e-12);
            }
        }
    }

    /// The torques of gravity are the gradient of the potential energy.
    #[test]
    fn gravity_is_the_slope_of_the_potential(q in prop::array::uniform7(-1.0..1.0f64)) {
        let model = RobotModel::fr3();
        let mut ws = Workspace::default();
        let mut tau = [0.0; 7];
        model.gravity_torques(&q, &mut ws, &mut tau);
        for i in 0..7 {
            let mut energy = |sign: f64| {
                let mut q = q;
                q[i] += sign * 1e-5;
                model.forward_kinematics(&q, &mut ws);
                potential_energy(&model, &ws)
            };
            let slope = (energy(1.0) - energy(-1.0)) / 2e-5;
            prop_assert!((slope - tau[i]).abs() < 1e-7, "{slope} {}", tau[i]);
        }
    }
}

#[test]
fn energy_is_kept_without_friction() {
    let model = double_pendulum();
    let mut sim = ArmSim::new(&[1.0, 0.5]);
    let energy = |sim: &ArmSim| {
        let mut ws = Workspace::default();
        model.forward_kinematics(&sim.q, &mut ws);
        model.kinetic_energy(&sim.qd, &mut ws) + potential_energy(&model, &ws)
    };
    let start = energy(&sim);
    for _ in 0..4000 {
        sim.step(&model, &[0.0; 2], 5e-4);
    }
    assert!(sim.qd[0].abs() + sim.qd[1].abs() > 0.1, "it swings");
    assert!((energy(&sim) - start).abs() < 1e-6, "{} {start}", energy(&sim));
}

#[test]
fn friction_only_takes_energy_away() {
    let model = RobotModel::fr3();
    let mut sim = ArmSim::new(model.home());
    sim.qd[..7].copy_from_slice(&[0.5, -0.3, 0.4, 0.2, -0.6, 0.3, 0.8]);
    let mut ws = Workspace::default();
    let mut last = f64::INFINITY;
    for _ in 0..2000 {
        // Gravity is balanced, so that only kinetic energy remains.
        let q = sim.q;
        let mut tau = [0.0; 7];
        model.gravity_torques(&q, &mut ws, &mut tau);
        model.forward_kinematics(&q, &mut ws);
        let energy = model.kinetic_energy(&sim.qd[..7], &mut ws);
        assert!(energy <= last + 1e-6, "{energy} after {last}");
        last = energy;
        sim.step(&model, &tau, 0.00125);
    }
    assert!(last < 1e-3, "{last} J are left");
}

#[test]
fn a_robot_on_a_wall_feels_gravity_from_the_side() {
    let turn = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
    let wall = RobotModel::fr3().with_base(glamx::DPose3::from_parts(DVec3::new(1.0, 2.0, 3.0), turn));
    let side =
        RobotModel::fr3().with_gravity(DMat3::from_quat(turn).transpose() * DVec3::new(0.0, 0.0, -9.81));
    let mut ws = Workspace::default();
    let (mut a, mut b) = ([0.0; 7], [0.0; 7]);
    wall.gravity_torques(&[0.1; 7], &mut ws, &mut a);
    side.gravity_torques(&[0.1; 7], &mut ws, &mut b);
    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-11), "{a:?} {b:?}");
}
