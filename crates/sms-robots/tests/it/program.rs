//! The files that a robot's own program replays.

use glamx::{DPose3, DQuat, DVec3};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::RowAccessor;
use sms_core::atomic;
use sms_robots::{
    ArmSim, FIST_HALF, JointProgram, Phase, RobotModel, StrikeConfig, Sweep, Workspace, floor, plan_strike,
};

fn program() -> (RobotModel, JointProgram) {
    let x_wr = DPose3::from_parts(DVec3::new(0.1, -0.2, 0.0), DQuat::from_rotation_z(0.3));
    let model = RobotModel::fr3().with_base(x_wr);
    let mut ws = Workspace::default();
    let sweep = Sweep::of_ball(DVec3::new(0.55, 0.0, 0.03), 0.03, 0.2, 0.6, FIST_HALF.x);
    let plan = plan_strike(&model, &sweep, &[floor(0.0)], &StrikeConfig::default(), &mut ws).unwrap();
    let program = JointProgram::of_strike(&model, &plan, 0.001, &mut ws);
    (model, program)
}

#[test]
fn the_program_is_sampled_at_1_khz_and_passes_the_contact_as_asked() {
    let (model, program) = program();
    assert_eq!(program.points[0].q, model.home());
    assert_eq!(DVec3::from(program.base_position_w), model.x_wr().translation);
    for (k, p) in program.points.iter().enumerate() {
        assert!((p.time_s - 1e-3 * k as f64).abs() < 1e-9);
    }
    for phase in [Phase::Approach, Phase::Descent, Phase::Sweep, Phase::Lift] {
        assert!(program.points.iter().any(|p| p.phase == phase));
    }
    // The points are smooth enough for a robot that rejects jumps.
    for pair in program.points.windows(2) {
        for i in 0..7 {
            let limit = &model.joints()[i].limits;
            let speed = (pair[1].q[i] - pair[0].q[i]) / 1e-3;
            assert!(speed.abs() <= limit.velocity, "joint {i} at {}: {speed}", pair[0].time_s);
            let mean = 0.5 * (pair[0].qd[i] + pair[1].qd[i]);
            assert!((speed - mean).abs() < 0.01, "joint {i} at {}: {speed} {mean}", pair[0].time_s);
            let rate = (pair[1].tau_command[i] - pair[0].tau_command[i]) / 1e-3;
            assert!(rate.abs() <= 1000.0, "joint {i} at {}: {rate} N·m/s", pair[0].time_s);
        }
    }
    // Speed of the tool around the contact, computed from the table alone.
    let k = (program.contact_s / 1e-3).round() as usize;
    let at = |k: usize| DVec3::from(program.points[k].tool_position_w);
    let v = (at(k + 1) - at(k - 1)) / 2e-3;
    assert!((v.length() / 0.6 - 1.0).abs() < 2e-3, "{}", v.length());
    assert!(v.angle_between(DVec3::new(0.2f64.cos(), 0.2f64.sin(), 0.0)) < 1e-3);
}

#[test]
fn the_torques_of_the_table_move_the_arm_through_the_sweep() {
    let (model, program) = program();
    let first = program.points.iter().position(|p| p.phase == Phase::Sweep).unwrap();
    let mut sim = ArmSim::new(&program.points[first].q);
    sim.qd[..7].copy_from_slice(&program.points[first].qd);
    let last = (program.contact_s / 1e-3) as usize;
    for k in first..last {
        // The mean of two points drives the interval between them.
        let tau: Vec<f64> =
            (0..7).map(|i| 0.5 * (program.points[k].tau[i] + program.points[k + 1].tau[i])).collect();
        sim.step(&model, &tau, 1e-3);
    }
    let (x, v, _) = sim.tool(&model);
    let gap = (x.translation - DVec3::from(program.points[last].tool_position_w)).length();
    assert!(gap < 1e-3, "{gap} m off without any feedback");
    assert!((v.length() / 0.6 - 1.0).abs() < 0.01, "{}", v.length());
}

#[test]
fn the_files_hold_the_program() {
    let (_, program) = program();
    let dir = tempfile::tempdir().unwrap();
    let json = dir.path().join("strike.json");
    sms_core::atomic::write_json(&json, &program).unwrap();
    assert_eq!(atomic::read_json::<JointProgram>(&json).unwrap(), program);

    let table = dir.path().join("strike.parquet");
    program.write_parquet(&table).unwrap();
    let bytes = std::fs::read(&table).unwrap();
    program.write_parquet(&table).unwrap();
    assert_eq!(std::fs::read(&table).unwrap(), bytes, "the same program gives the same bytes");
    let reader = SerializedFileReader::new(std::fs::File::open(&table).unwrap()).unwrap();
    let schema = reader.metadata().file_metadata().schema_descr();
    let column = |name: &str| (0..schema.num_columns()).find(|&c| schema.column(c).name() == name).unwrap();
    let (time, phase) = (column("time_s"), column("phase"));
    let (tau, command, z) = (column("tau_fr3_joint4"), column("tau_command_fr3_joint4"), column("z"));
    assert_eq!(schema.num_columns(), 3 + 4 * 7 + 7);
    let mut rows = 0;
    for (row, point) in reader.get_row_iter(None).unwrap().zip(&program.points) {
        let row = row.unwrap();
        assert_eq!(row.get_double(time).unwrap(), point.time_s);
        assert_eq!(row.get_string(phase).unwrap(), point.phase.name());
        assert_eq!(row.get_double(tau).unwrap(), point.tau[3]);
        assert_eq!(row.get_double(command).unwrap(), point.tau_command[3]);
        assert_eq!(row.get_double(z).unwrap(), point.tool_position_w[2]);
        rows += 1;
    }
    assert_eq!(rows, program.points.len());
}
