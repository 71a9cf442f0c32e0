//! Time of one control step of the FR3 and of its parts, of inverse kinematics and of planning a strike.
//!
//! `cargo bench -p sms-robots`.

use criterion::Criterion;
use glamx::{DPose3, DVec3};
use sms_core::Mesh;
use sms_robots::{
    ArmSim, FIST_HALF, IkConfig, LinkShape, MAX_JOINTS, Obstacle, ObstacleShape, Osc, OscConfig, RobotModel,
    StrikeConfig, Sweep, ToolReference, Workspace, check_strike, floor, plan_strike, plan_sweep,
};
use std::hint::black_box;
use std::time::Duration;

fn main() {
    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .sample_size(20)
        .without_plots()
        .configure_from_args();
    benches(&mut criterion);
    criterion.final_summary();
}

fn benches(c: &mut Criterion) {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let q = [0.3, 0.4, -0.2, -1.9, 0.1, 2.2, 0.6];
    let qd = [0.5, -0.4, 0.3, 0.8, -0.6, 0.2, 0.1];
    let tau = [3.0; 7];
    model.forward_kinematics(&q, &mut ws);
    let reference = ToolReference::at_rest(model.frame_pose(model.tool(), &ws));
    let mut osc = Osc::new(OscConfig::default(), &q, &tau);
    c.bench_function("osc step", |b| b.iter(|| osc.step(&model, black_box(&q), &qd, &reference)));
    let mut out = [0.0; MAX_JOINTS];
    c.bench_function("rnea", |b| {
        b.iter(|| model.inverse_dynamics(black_box(&q), &qd, &qd, &mut ws, &mut out))
    });
    c.bench_function("forward dynamics", |b| {
        b.iter(|| model.forward_dynamics(black_box(&q), &qd, &tau, &mut ws, &mut out))
    });
    let mut sim = ArmSim::new(&q);
    c.bench_function("arm step (rk4)", |b| {
        b.iter(|| {
            sim.q[..7].copy_from_slice(&q);
            sim.step(&model, black_box(&tau), 0.00125);
        })
    });
    let target = reference.x_wt;
    c.bench_function("ik, 16 starts", |b| {
        b.iter(|| model.inverse_kinematics(black_box(&target), &IkConfig::default(), &mut ws))
    });
    let sweep = Sweep::of_ball(DVec3::new(0.5, 0.1, 0.03), 0.03, -0.3, 0.6, FIST_HALF.x);
    let (config, floor) = (StrikeConfig::default(), [floor(0.0)]);
    c.bench_function("plan sweep", |b| {
        b.iter(|| plan_sweep(&model, black_box(&sweep), &floor, &config, &mut ws))
    });
    // Eight obstacles of eight hulls each in a ring around the ball.
    let mut around = vec![sms_robots::floor(0.0)];
    for k in 0..8 {
        let angle = std::f64::consts::TAU * f64::from(k) / 8.0;
        let hull = |j: u32| {
            let at = DVec3::new(0.0, 0.0, 0.012 * f64::from(j));
            let points: Vec<DVec3> =
                Mesh::cylinder(0.03, 0.006, 16).vertices.iter().map(|&p| p + at).collect();
            LinkShape::convex(&points).expect("a disc has a volume")
        };
        let center = DVec3::new(0.55 + 0.25 * angle.cos(), 0.05 + 0.3 * angle.sin(), 0.01);
        let shape = ObstacleShape::Hulls((0..8).map(hull).collect());
        around.push(Obstacle::new(format!("jar {k}"), DPose3::from_translation(center), shape));
    }
    c.bench_function("plan sweep among 64 hulls", |b| {
        b.iter(|| plan_sweep(&model, black_box(&sweep), &around, &config, &mut ws))
    });
    c.bench_function("plan strike and check", |b| {
        b.iter(|| {
            plan_strike(&model, black_box(&sweep), &floor, &config, &mut ws)
                .map(|plan| check_strike(&model, &plan, &floor, &config, &mut ws))
        })
    });
}
