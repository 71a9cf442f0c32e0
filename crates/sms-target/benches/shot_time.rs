//! Measures the processor time of a shot in each target engine, on the true geometry of the eighteen fixed scenes:
//! `shot_time ENGINES SCENES SHOTS`, such as `shot_time physx,physx-stock 1,8 2`.

use rand::RngExt;
use sms_core::Seed;
use sms_robots::RobotConfig;
use sms_sim::{RapierFactory, SimError};
use sms_synth::FIXED_SCENES;
use sms_target::{TargetEngine, scene_from_truth};
use sms_task::{Action, ActionForm, Billiards, Selector, Task};

/// Distance of the arm behind the generator's robot position, metres.
const STAND_BACK_M: f64 = 0.1;

/// Processor time of this thread, seconds.
fn cpu_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(0.0) * 1e-9
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1).filter(|a| a != "--bench");
    let engines = args.next().unwrap_or_else(|| "physx".to_owned());
    let scenes = args.next().unwrap_or_else(|| (1..=18).map(|n| n.to_string()).collect::<Vec<_>>().join(","));
    let shots: usize = args.next().map_or(Ok(1), |s| s.parse())?;
    let recorded = args.next().is_none_or(|s| s == "recorded");
    for number in scenes.split(',') {
        let number: usize = number.parse()?;
        let fixed = FIXED_SCENES.iter().find(|s| s.number == number).ok_or("unknown scene")?;
        let truth = fixed.generate();
        let scene = scene_from_truth(&truth)?;
        let (cue, target) = (Selector::by_name(&truth.cue), Selector::by_name(&truth.target));
        let mut billiards = Billiards::new(cue, target, truth.goal_w);
        billiards.form = ActionForm::SpeedAngle;
        // Same robot pose as in the benchmarks.
        let [x, y, z] = (truth.robot_base_w - glamx::DVec3::X * STAND_BACK_M).to_array();
        let x_wr = [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]];
        let robot = RobotConfig { x_recording_robot: Some(x_wr), ..RobotConfig::default() };
        let task = Task::Billiards(billiards).resolve(&scene)?.with_robot(&robot, &scene)?;
        let bodies = task.bodies_in(&scene, &task.target().name)?;
        let mut planner = task.prepare(&RapierFactory, &scene, &task.world_options(), &bodies)?;
        let parameters = task.parameters();
        let mut rng = Seed(fixed.seed).derive("shot time").rng();
        let parts: usize = scene
            .bodies
            .iter()
            .map(|b| match &b.shape {
                sms_scene::BodyShape::Hulls { hulls } => hulls.len(),
                _ => 1,
            })
            .sum();
        let mut done = 0;
        for i in 0..200 {
            if done == shots {
                break;
            }
            let values = parameters.iter().map(|p| rng.random_range(p.low..=p.high)).collect();
            let action = Action(values);
            planner.restore();
            let struck = match task.striker(&task.strike(&action)) {
                Ok(s) => s,
                Err(SimError::Refused(_)) => continue,
                Err(e) => return Err(e.into()),
            };
            let Ok(first) = task.rollout(&mut planner, &struck, &bodies, None) else { continue };
            // Shots must touch the target ball: misses end early.
            if !first.contacts.iter().any(|c| [c.body, c.other].contains(&task.target().index)) {
                continue;
            }
            done += 1;
            for name in engines.split(',') {
                let engine =
                    TargetEngine::ALL.into_iter().find(|e| e.name() == name).ok_or("unknown engine")?;
                let target = engine.target()?;
                let began = cpu_s();
                let mut simulation = target.simulation(&scene, &task.world_options())?;
                let built = cpu_s() - began;
                simulation.begin_profile();
                let recording = recorded.then_some(sms_task::MotionRecording { every_s: 1.0 / 120.0 });
                let outcome = task.rollout(&mut simulation, &struck, &bodies, recording);
                let total = cpu_s() - began;
                let p = simulation.profile().unwrap_or_default();
                let (objective, end) = outcome.map_or((f64::NAN, f64::NAN), |o| (o.objective, o.end_s));
                println!(
                    "scene {number:2} parts {parts:4} shot {i:3} {name:12} cpu {total:6.3} s, build {built:.3}, engine {:.3} impacts {:.3} striker {:.3}, {} steps ({} splits), end {end:.2} s, {:.2} mm (planner {:.2})",
                    p.engine_s,
                    p.impacts_s,
                    p.striker_s,
                    p.steps,
                    p.splits,
                    1e3 * objective,
                    1e3 * first.objective,
                );
            }
        }
    }
    Ok(())
}
