//! Kinematics and dynamics against Pinocchio (tables of `oracle/make_tables.py`).

use glamx::DMat3;
use sms_robots::{Jacobian, JointKind, OffChain, RobotModel, UrdfOptions, Workspace};
use std::path::Path;

/// Largest difference to an entry, relative to the largest entry of the block (the vector or matrix of that state).
const RELATIVE: f64 = 1e-9;

/// The generator of `make_tables.py`.
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^= z >> 31;
        (z >> 11) as f64 * 2f64.powi(-53)
    }
}

fn folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/oracle")
}

fn compare(model: &RobotModel, table: &str, seed: u64, states: usize) {
    let bytes = std::fs::read(folder().join(table)).unwrap();
    let numbers: Vec<f64> =
        bytes.chunks_exact(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect();
    let n = model.dof();
    let width = 2 * n + n * (n + 1) / 2 + 6 * n + 6 + 12;
    assert_eq!(numbers.len(), width * states);
    let mut draw = SplitMix(seed);
    let mut ws = Workspace::default();
    let mut worst = [0.0f64; 6];
    for state in numbers.chunks_exact(width) {
        let (mut q, mut v, mut a) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        for (i, joint) in model.joints().iter().enumerate() {
            let x = draw.next();
            q[i] = match joint.kind {
                JointKind::Continuous => -3.0 + 6.0 * x,
                _ => joint.limits.lower + x * (joint.limits.upper - joint.limits.lower),
            };
            v[i] = 3.0 * (2.0 * draw.next() - 1.0);
            a[i] = 20.0 * (2.0 * draw.next() - 1.0);
        }
        let mut rest = state;
        let mut block = 0;
        let mut check = |ours: &[f64]| {
            let (theirs, after) = rest.split_at(ours.len());
            rest = after;
            let scale = theirs.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            let off = ours.iter().zip(theirs).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
            worst[block] = worst[block].max(off / scale);
            block += 1;
        };
        let mut tau = vec![0.0; n];
        model.inverse_dynamics(&q, &v, &a, &mut ws, &mut tau);
        check(&tau);
        model.bias_torques(&q, &v, &mut ws, &mut tau);
        check(&tau);
        let drift = model.frame_acceleration(model.tool(), &ws);
        let mass = *model.mass_matrix(&mut ws);
        check(&(0..n).flat_map(|i| mass[i][i..n].to_vec()).collect::<Vec<_>>());
        let mut jacobian = Jacobian::default();
        model.jacobian(model.tool(), &ws, &mut jacobian);
        check(
            &(0..6)
                .flat_map(|r| (0..n).map(move |i| (r, i)))
                .map(|(r, i)| jacobian.get(r, i))
                .collect::<Vec<_>>(),
        );
        check(&[drift.0.to_array(), drift.1.to_array()].concat());
        let x = model.frame_pose(model.tool(), &ws);
        let r = DMat3::from_quat(x.rotation).transpose().to_cols_array();
        check(&[r.as_slice(), x.translation.to_array().as_slice()].concat());
    }
    let names = ["RNEA", "C q' + g", "CRBA", "Jacobian", "J' q'", "pose"];
    for (name, worst) in names.iter().zip(worst) {
        println!("{table}: {name}: worst relative difference {worst:.1e}");
        assert!(worst <= RELATIVE, "{name}: {worst:e}");
    }
}

#[test]
fn the_fr3_agrees_with_pinocchio_on_1000_states() {
    let model = RobotModel::fr3();
    assert_eq!(model.dof(), 7);
    compare(&model, "fr3.bin", 1, 1000);
}

#[test]
fn a_branched_robot_with_slides_and_skew_axes_agrees_with_pinocchio() {
    let options =
        UrdfOptions { tool: Some("tip".into()), off_chain: OffChain::Move, ..UrdfOptions::default() };
    let model = RobotModel::from_urdf(&folder().join("branch.urdf"), &options).unwrap();
    let names: Vec<&str> = model.joints().iter().map(|j| j.name.as_str()).collect();
    assert_eq!(names, ["j1_slide", "j2_turn", "j3_spin", "j4_twin", "j5_push"]);
    compare(&model, "branch.bin", 2, 500);
}
