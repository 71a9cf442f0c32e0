//! The scene of the speed target: two balls and eight vessels of eight hulls each, struck by the arm, simulated for four
//! seconds without ending early; and the same for another simulator.

use crate::BenchError;
use crate::plan_scenes::STAND_BACK_M;
use glamx::{DPose3, DQuat, DVec3};
use serde::Serialize;
use sms_core::metrics::Metrics;
use sms_core::process::thread_cpu_seconds;
use sms_core::{
    Cancel, InputError, Interval, Material, Mesh, Property, PropertySource, atomic,
    polyhedron_mass_properties, sphere_mass_properties,
};
use sms_export::{Format, Sources, export};
use sms_plan::PlanError;
use sms_robots::{FR3_URDF, RobotConfig};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, example_material, floor_body};
use sms_sim::{RapierFactory, Simulation, Striker, StrikerMotion};
use sms_task::{Action, Billiards, ResolvedTask, Selector, Task};
use std::path::Path;
use std::time::Instant;

/// Strikes that are timed, and seconds that are simulated of each.
const STRIKES: usize = 15;
const HORIZON_S: f64 = 4.0;

/// The scene of eight vessels with its task.
#[derive(Debug, Clone)]
pub struct VesselScene {
    /// The scene.
    pub scene: Scene,
    /// The task in it, carried out by a finger that gives no way.
    pub task: ResolvedTask,
    /// The robot that stands before it.
    pub robot: RobotConfig,
}

/// The scene, its task and the arm.
///
/// # Errors
/// [`BenchError`]: never, unless a shape loses its volume.
pub fn vessel_scene() -> Result<VesselScene, BenchError> {
    let impossible = |e: String| InputError::new(e, "(scene of vessels)", "report this");
    let mut bodies = vec![
        floor_body(0.0, material(0.4, 0.5)),
        ball("cue", DVec3::new(0.35, 0.0, 0.03)).map_err(|e| impossible(e.to_string()))?,
        ball("target", DVec3::new(0.6, 0.03, 0.03)).map_err(|e| impossible(e.to_string()))?,
    ];
    let places = [
        (0.45, 0.18),
        (0.70, 0.20),
        (0.85, 0.05),
        (0.80, -0.15),
        (0.55, -0.18),
        (0.95, 0.25),
        (1.05, -0.05),
        (0.65, 0.35),
    ];
    for (k, (x, y)) in places.into_iter().enumerate() {
        let vessel = vessel(&format!("vessel{k}"), x, y, 1.0 + 0.05 * k as f64);
        bodies.push(vessel.map_err(|e| impossible(e.to_string()))?);
    }
    let scene = Scene {
        version: SCENE_VERSION,
        name: "eight vessels".into(),
        gravity_w: DVec3::new(0.0, 0.0, -9.81),
        x_world_recording: DPose3::IDENTITY,
        bodies,
    };
    let task = Billiards::new(Selector::by_name("cue"), Selector::by_name("target"), [0.9, 0.1]);
    let task = Task::Billiards(task).resolve(&scene).map_err(PlanError::from)?;
    let x_world_robot =
        [[1.0, 0.0, 0.0, -STAND_BACK_M], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let robot = RobotConfig { x_world_robot: Some(x_world_robot), ..RobotConfig::default() };
    Ok(VesselScene { scene, task, robot })
}

fn material(friction: f64, restitution: f64) -> Material {
    let exact = |v| Property::new(Interval::exact(v), PropertySource::User);
    Material {
        friction: exact(friction),
        restitution: exact(restitution),
        rolling_m: exact(1e-4),
        ..example_material()
    }
}

fn ball(name: &str, center_w: DVec3) -> Result<Body, sms_core::InertiaError> {
    let radius = 0.03;
    Ok(Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_translation(center_w),
        shape: BodyShape::Sphere { radius },
        mass: Some(sphere_mass_properties(DVec3::ZERO, radius, 1700.0)?),
        ..floor_body(0.0, material(0.2, 0.9))
    })
}

/// A vessel of eight staves: each a hull of 16 corners.
fn vessel(name: &str, x: f64, y: f64, scale: f64) -> Result<Body, sms_core::InertiaError> {
    let (inner, outer, height) = (0.030 * scale, 0.036 * scale, 0.09 * scale);
    let corner = |radius: f64, angle: f64, z: f64| DVec3::new(radius * angle.cos(), radius * angle.sin(), z);
    let stave = |k: usize| {
        let step = std::f64::consts::TAU / 8.0;
        let corners: Vec<DVec3> = (0..4)
            .flat_map(|i| {
                let angle = (k as f64 + f64::from(i) / 3.0) * step;
                [-0.5, 0.5]
                    .into_iter()
                    .flat_map(move |z| [corner(inner, angle, z * height), corner(outer, angle, z * height)])
            })
            .collect();
        sms_mesh::convex_hull(&corners, 64, 0.0).unwrap_or_default()
    };
    let solid = Mesh::cuboid(DVec3::new(outer, outer, 0.5 * height));
    Ok(Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_parts(DVec3::new(x, y, 0.5 * height), DQuat::from_rotation_z(x + y)),
        mass: Some(polyhedron_mass_properties(&solid, 600.0)?),
        shape: BodyShape::Hulls { hulls: (0..8).map(stave).collect() },
        ..floor_body(0.0, material(0.4, 0.5))
    })
}

/// One strike as another simulator needs it. Metres, radians, seconds; quaternions x y z w.
#[derive(Debug, Serialize)]
struct StrikeFile {
    contact_w: [f64; 3],
    direction_w: [f64; 3],
    rotation_w_xyzw: [f64; 4],
    speed: f64,
    q_start: Vec<f64>,
    /// Where the balls were at the end: cue, target.
    balls_w: [[f64; 3]; 2],
}

#[derive(Debug, Serialize)]
struct PeerFile {
    base_w: [f64; 3],
    tool_half: [f64; 3],
    dt: f64,
    horizon_s: f64,
    striker_friction: f64,
    striker_restitution: f64,
    osc: sms_robots::OscConfig,
    /// Seconds of one evaluation: planning the sweep, and simulating.
    ours: [f64; 2],
    strikes: Vec<StrikeFile>,
}

/// CPU seconds of this thread so far, where the system tells; else those of the clock on the wall. Not the process's: what
/// other threads have used is gone from its sum when they end.
fn cpu() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    thread_cpu_seconds().unwrap_or_else(|| START.get_or_init(Instant::now).elapsed().as_secs_f64())
}

/// Times whole rollouts of [`vessel_scene`] on this thread, in CPU seconds (nothing of them runs on another thread), and
/// writes the scene as URDF, the robot and the strikes to `folder`, where one is given. Keys: `bench.plan.{full_evaluation_s, full_finger_evaluation_s, full_sweep_plan_s,
/// full_arm_s}`; the first is with the planning of the arm's sweep.
///
/// # Errors
/// [`BenchError`]: files, or interruption.
pub fn run_full_shots(folder: Option<&Path>, cancel: &Cancel) -> Result<Metrics, BenchError> {
    let bench = vessel_scene()?;
    let task = bench.task.clone().with_robot(&bench.robot, &bench.scene)?;
    let options = task.world_options();
    let mut simulation = Simulation::new(&RapierFactory, &bench.scene, &options).map_err(PlanError::from)?;
    simulation.save();
    let steps = (HORIZON_S / options.dt).round() as usize;
    let surface = sms_task::StrikerMaterial::default();
    let mut shoot = |strikers: &[Striker]| -> Result<(f64, Vec<[[f64; 3]; 2]>), BenchError> {
        let (began, mut ends) = (cpu(), Vec::new());
        for striker in strikers {
            cancel.check()?;
            simulation.restore();
            simulation.strike(striker, surface.friction, surface.restitution);
            for _ in 0..steps {
                simulation.advance(options.dt).map_err(PlanError::from)?;
            }
            ends.push([1, 2].map(|b| simulation.state(b).x_wb.translation.to_array()));
        }
        Ok((cpu() - began, ends))
    };
    let motion =
        |k: usize| task.strike(&Action(vec![0.4 + 0.03 * k as f64, 0.02 * k as f64 - 0.1, 0.0, 0.0]));
    let motions: Vec<StrikerMotion> = (0..STRIKES).map(motion).collect();
    let began = cpu();
    let arms: Vec<Striker> =
        motions.iter().map(|m| task.striker(m)).collect::<Result<_, _>>().map_err(PlanError::from)?;
    let planning_s = cpu() - began;
    let fingers: Vec<Striker> = motions.iter().map(Striker::from).collect();
    let (finger_s, _) = shoot(&fingers)?;
    let (arm_s, ends) = shoot(&arms)?;
    let file = |(striker, balls_w): (&Striker, [[f64; 3]; 2])| match striker {
        Striker::Finger(_) => None,
        Striker::Arm(arm) => Some(StrikeFile {
            contact_w: arm.sweep.contact_w.to_array(),
            direction_w: arm.sweep.direction_w.to_array(),
            rotation_w_xyzw: arm.rotation_w.to_array(),
            speed: arm.sweep.speed,
            q_start: arm.q_start.clone(),
            balls_w,
        }),
    };
    let files: Vec<StrikeFile> = arms.iter().zip(ends).filter_map(file).collect();
    let each = |v: f64| v / STRIKES as f64;
    if let Some(folder) = folder {
        export(&bench.scene, Format::Urdf, &Sources::default(), &folder.join("scene"))?;
        atomic::write_bytes(&folder.join("fr3.urdf"), FR3_URDF.as_bytes())?;
        let peer = PeerFile {
            base_w: [-STAND_BACK_M, 0.0, 0.0],
            tool_half: sms_robots::FIST_HALF.to_array(),
            dt: options.dt,
            horizon_s: HORIZON_S,
            striker_friction: surface.friction,
            striker_restitution: surface.restitution,
            osc: sms_robots::OscConfig::default(),
            ours: [each(planning_s), each(arm_s)],
            strikes: files,
        };
        atomic::write_json(&folder.join("strikes.json"), &peer)?;
    }
    let mut metrics = Metrics::new();
    metrics
        .set("bench.plan.full_evaluation_s", each(planning_s + arm_s))
        .set("bench.plan.full_finger_evaluation_s", each(finger_s))
        .set("bench.plan.full_sweep_plan_s", each(planning_s))
        .set("bench.plan.full_arm_s", each(arm_s - finger_s));
    Ok(metrics)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scene_is_written_whole() {
        let dir = tempfile::tempdir().unwrap();
        let metrics = run_full_shots(Some(dir.path()), &Cancel::new()).unwrap();
        println!("{metrics:?}");
        assert!(metrics.number("bench.plan.full_evaluation_s").unwrap() > 0.0);
        let text = std::fs::read_to_string(dir.path().join("strikes.json")).unwrap();
        let written: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(written["strikes"].as_array().unwrap().len(), STRIKES);
        assert!(dir.path().join("scene").join("bodies.json").is_file());
    }
}
