//! One evaluation of a landing: five seconds of flight over a structure in Rapier f32, with each wash model. CPU
//! seconds include all threads of the process.
//!
//! `cargo bench -p sms-sim --bench wash -- [spacing in metres …] [emitters=FILE]`; the file passes the propellers'
//! motion to another program (`benches/peers/genesis_wash.py`).

use glamx::{DPose3, DVec3};
use sms_core::box_mass_properties;
use sms_robots::{BezierPath, Flight, FlightSettings, Quadrotor};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, example_material, floor_body};
use sms_sim::{RapierFactory, Simulation, WashInWorld, WorldOptions, wash_surfaces};
use sms_wash::{SphSettings, SphWash, StreamSettings, StreamWash, VehicleState, Wash};
use std::error::Error;
use std::fmt::Write;
use std::time::Instant;

const DT: f64 = 0.0025;
const SECONDS: f64 = 5.0;

fn cuboid(name: &str, center_w: DVec3, half: DVec3, density: f64) -> Result<Body, Box<dyn Error>> {
    Ok(Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_translation(center_w),
        shape: BodyShape::Box { half_extents: half },
        mass: Some(box_mass_properties(half, density)?),
        ..floor_body(0.0, example_material())
    })
}

/// A platform that hangs over a box on one side, held by a ballast.
fn structure() -> Result<Scene, Box<dyn Error>> {
    Ok(Scene {
        version: SCENE_VERSION,
        name: "cantilever".into(),
        gravity_w: DVec3::new(0.0, 0.0, -9.81),
        size_sigma: 0.0,
        x_world_recording: DPose3::IDENTITY,
        bodies: vec![
            floor_body(0.0, example_material()),
            cuboid("base", DVec3::new(0.0, 0.0, 0.25), DVec3::new(0.15, 0.15, 0.25), 150.0)?,
            cuboid("platform", DVec3::new(0.12, 0.0, 0.51), DVec3::new(0.3, 0.2, 0.01), 600.0)?,
            cuboid("ballast", DVec3::new(-0.08, 0.0, 0.57), DVec3::new(0.05, 0.1, 0.05), 3000.0)?,
        ],
    })
}

/// CPU time of the process, seconds, if the system reports it.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

/// Centres of the propellers (x, y, z, metres) in each step with wash.
type Blown = Vec<Option<Vec<DVec3>>>;

fn evaluate(wash: Box<dyn Wash>, scene: &Scene, label: &str) -> Result<Blown, Box<dyn Error>> {
    let vehicle = Quadrotor::default();
    let settings = FlightSettings::default();
    let (top, stands) = (0.52, vehicle.standing_height());
    let start_w = DVec3::new(-2.0, 0.3, top + stands + settings.height);
    let path = BezierPath::approach(start_w, DVec3::new(0.05, 0.0, top), 0.8, 2.5);
    let flight = Flight::new(path, settings)?;
    let (rotors, hover) = (vehicle.propellers(), vehicle.hover_thrusts(9.81));
    let off = vec![0.0; hover.len()];
    let mut simulation =
        Simulation::new(&RapierFactory, scene, &WorldOptions { dt: DT, ..WorldOptions::default() })?;
    let mut wash = WashInWorld::new(wash, scene.bodies.len());
    let (mut active, mut particles) = (0, 0);
    let mut blown = Blown::new();
    let (began, cpu) = (Instant::now(), cpu_s());
    let steps = (SECONDS / DT).round() as usize;
    for k in 0..steps {
        let state = flight.state(k as f64 * DT);
        let thrusts = if state.motors { &hover } else { &off };
        let now = VehicleState { x_wv: state.x_wv, v_w: state.v_w, rotors: &rotors, thrusts };
        wash.advance(&mut simulation, &now, DT)?;
        active += usize::from(wash.wash().is_active());
        particles = particles.max(wash.wash().particles_w().len());
        let centers = || rotors.iter().map(|r| state.x_wv.transform_point(r.p_v)).collect();
        blown.push((state.motors && wash.wash().is_active()).then(centers));
    }
    println!(
        "{label}: {:.2} CPU-s, {:.2} s wall for {SECONDS} s (flight {:.1} s, wash {:.2} s, at most {particles} particles)",
        cpu_s() - cpu,
        began.elapsed().as_secs_f64(),
        flight.duration_s(),
        active as f64 * DT,
    );
    Ok(blown)
}

/// Writes `# key value …` of the air and of each box (centre, half extents, mass; mass 0 is fixed), then a line for
/// each step: either empty, or the centres of the propellers.
fn write_emitters(path: &str, scene: &Scene, sph: &SphSettings, blown: &Blown) -> Result<(), Box<dyn Error>> {
    let vehicle = Quadrotor::default();
    let thrust = vehicle.mass * 9.81 / vehicle.rotors.len() as f64;
    // The far wake: half the disk, twice its speed (experiments/studies/wash.md).
    let radius = vehicle.rotor_radius / 2f64.sqrt();
    let speed = (thrust / (sph.air_density * std::f64::consts::PI * radius * radius)).sqrt();
    let mut text = format!(
        "# air step_s {DT} spacing_m {} support_m {} sound_speed {} density {} stream_speed {speed} stream_radius_m {radius}\n",
        sph.spacing,
        sph.support_spacings * sph.spacing,
        sph.sound_speed,
        sph.air_density,
    );
    for body in &scene.bodies {
        let BodyShape::Box { half_extents: h } = body.shape else { continue };
        let (p, mass) = (body.x_wb.translation, body.mass.map_or(0.0, |m| m.mass()));
        writeln!(text, "# box {} {} {} {} {} {} {} {mass}", body.name, p.x, p.y, p.z, h.x, h.y, h.z)?;
    }
    for centers in blown {
        let each = centers.iter().flatten().flat_map(|p| p.to_array());
        writeln!(text, "{}", each.map(|v| v.to_string()).collect::<Vec<_>>().join(" "))?;
    }
    Ok(std::fs::write(path, text)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let scene = structure()?;
    let surfaces = wash_surfaces(&scene)?;
    let streams = StreamSettings::default();
    evaluate(Box::new(StreamWash::disk(surfaces.clone(), streams)?), &scene, "disk")?;
    evaluate(Box::new(StreamWash::jet(surfaces.clone(), streams)?), &scene, "jet")?;
    let asked: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let spacings = if asked.is_empty() { vec![SphSettings::default().spacing] } else { asked };
    for spacing in spacings {
        let settings = SphSettings { spacing, ..SphSettings::default() };
        let wash = SphWash::new(surfaces.clone(), settings)?;
        let blown = evaluate(Box::new(wash), &scene, &format!("sph {:.1} mm", 1e3 * spacing))?;
        if let Some(path) = std::env::args().find_map(|a| a.strip_prefix("emitters=").map(str::to_owned)) {
            write_emitters(&path, &scene, &settings, &blown)?;
        }
    }
    Ok(())
}
