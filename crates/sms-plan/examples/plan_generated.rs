//! Plans shots on generated scenes with their true geometry, and executes them in a finer world with the true
//! materials. This measures the planner for a scan that is accurate to a millimetre.
//!
//! `cargo run --release -p sms-plan --example plan_generated -- [first seed] [number] [draft|standard|fine|paper]
//! [speed_angle_contact|speed_angle] [free|blocked]`; `blocked` allows obstacles anywhere and goals at any cut. Use
//! seeds from 1000 on for tuning; lower ones are for reported results.

use rand::RngExt;
use sms_core::{Cancel, Interval, Material, Mesh, Property, PropertySource, Seed, StageContext, Warnings};
use sms_plan::{PlanConfig, plan};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, floor_body};
use sms_sim::{RapierF64Factory, RapierFactory, Simulation, WorldOptions};
use sms_synth::{BilliardsSettings, TruthScene, generate_billiards};
use sms_task::{Action, ActionForm, Billiards, Selector, Task};
use std::time::Instant;

fn true_scene(truth: &TruthScene) -> Scene {
    let body = |o: &sms_synth::TruthObject| Body {
        name: o.name.clone(),
        label: 1,
        description: o.class.clone(),
        kind: BodyKind::Dynamic,
        x_wb: o.x_wb,
        shape: match o.sphere_radius {
            Some(radius) => BodyShape::Sphere { radius },
            None => BodyShape::Hulls { hulls: o.parts.clone() },
        },
        visual: Mesh::default(),
        texture: None,
        mass: Some(o.mass),
        material: o.material.clone(),
        color: [128; 3],
        observed_share: 1.0,
        fit_se_m: 0.0,
    };
    let floor = floor_body(0.0, truth.floor.material.clone());
    Scene {
        version: SCENE_VERSION,
        name: truth.name.clone(),
        gravity_w: glamx::DVec3::new(0.0, 0.0, -9.806_65),
        x_world_recording: glamx::DPose3::identity(),
        bodies: std::iter::once(floor).chain(truth.objects.iter().map(body)).collect(),
    }
}

/// A scene as a good scan would reconstruct it: balls within a millimetre, materials within their intervals.
fn believed_scene(truth: &Scene, seed: Seed) -> Scene {
    let mut rng = seed.rng();
    let mut believed = truth.clone();
    for body in &mut believed.bodies {
        let mut guess = |p: &Property, share: f64| {
            let best = p.value.best * (1.0 + share * rng.random_range(-1.0..1.0));
            Property::new(
                Interval::new(best, (1.0 - share) * best, (1.0 + share) * best),
                PropertySource::Table,
            )
        };
        let m = body.material.clone();
        body.material = Material {
            density: guess(&m.density, 0.25),
            friction: guess(&m.friction, 0.25),
            restitution: guess(&m.restitution, 0.1),
            rolling_m: guess(&m.rolling_m, 0.3),
            ..m
        };
        if body.kind == BodyKind::Dynamic {
            body.x_wb.translation.x += rng.random_range(-0.001..0.001);
            body.x_wb.translation.y += rng.random_range(-0.001..0.001);
        }
    }
    believed
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, default: u64| arguments.get(i).map_or(Ok(default), |a| a.parse());
    let (first, count) = (number(0, 1000)?, number(1, 6)?);
    let config = match arguments.get(2).map(String::as_str) {
        Some("standard") => PlanConfig::default(),
        Some("fine") => PlanConfig::fine(),
        Some("paper") => PlanConfig::paper(),
        _ => PlanConfig::draft(),
    };
    let form = match arguments.get(3).map(String::as_str) {
        Some("speed_angle") => ActionForm::SpeedAngle,
        _ => ActionForm::SpeedAngleContact,
    };
    let settings = match arguments.get(4).map(String::as_str) {
        Some("blocked") => BilliardsSettings {
            corridor_half_width_m: 0.0,
            max_cut_angle: std::f64::consts::FRAC_PI_2,
            ..BilliardsSettings::default()
        },
        _ => BilliardsSettings::default(),
    };
    println!("seed  start cm  planned mm  q90 mm  realised mm  shots  s   ms/shot·core  speed  angle°");
    let (mut planned, mut realised) = (Vec::new(), Vec::new());
    for seed in first..first + count {
        let truth = generate_billiards(Seed(seed), &settings);
        let true_scene = true_scene(&truth);
        let believed = believed_scene(&true_scene, Seed(seed).derive("scan"));
        let mut task =
            Billiards::new(Selector::by_name(&truth.cue), Selector::by_name(&truth.target), truth.goal_w);
        task.form = form;
        let task = Task::Billiards(task).resolve(&believed)?;
        let began = Instant::now();
        let warnings = Warnings::new();
        let outcome = plan(
            &task,
            &believed,
            &RapierFactory,
            &config,
            StageContext::quiet(&Cancel::new(), &warnings).with_seed(Seed(1)),
        )?;
        let seconds = began.elapsed().as_secs_f64();
        let options = WorldOptions { dt: 0.25 * task.world_options().dt, ..task.world_options() };
        let mut target = Simulation::new(&RapierF64Factory, &true_scene, &options)?;
        let bodies = task.bodies_in(&true_scene, &truth.target)?;
        let Action(values) = &outcome.plan.action;
        let real = task.rollout(&mut target, task.strike(&outcome.plan.action), &bodies, None)?;
        println!(
            "{seed:4}  {:8.1}  {:10.2}  {:6.1}  {:11.1}  {:5}  {seconds:4.1}  {:12.1}  {:5.3}  {:6.2}",
            1e2 * task.initial_objective(),
            1e3 * outcome.plan.objective,
            1e3 * outcome.plan.objective_q90,
            1e3 * real.objective,
            outcome.plan.evaluations,
            1e3 * seconds * rayon::current_num_threads() as f64 / outcome.plan.evaluations as f64,
            values[0],
            values[1].to_degrees(),
        );
        for warning in warnings.snapshot() {
            println!("      {}: {}", warning.code, warning.message);
        }
        planned.push(outcome.plan.objective);
        realised.push(real.objective);
    }
    for (name, values) in [("planned", &mut planned), ("realised", &mut realised)] {
        values.sort_by(f64::total_cmp);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        println!("{name}: median {:.1} mm, mean {:.1} mm", 1e3 * values[values.len() / 2], 1e3 * mean);
    }
    Ok(())
}
