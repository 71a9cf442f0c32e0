//! Small scenes: balls of 30 mm and 0.19 kg, boxes, a floor.

use glamx::{DPose3, DVec3};
use sms_core::{
    Interval, Material, Mesh, Property, PropertySource, box_mass_properties, sphere_mass_properties,
};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, example_material, floor_body};
use sms_sim::{BodyId, BodyState, SimError, Simulation, WorldFactory, WorldOptions};

/// Radius of the balls, metres.
pub(super) const R: f64 = 0.03;
/// Their mass, kg.
pub(super) const M: f64 = 0.19;
/// Gravity, m/s².
pub(super) const G: f64 = 9.81;
/// Nominal step, seconds.
pub(super) const DT: f64 = 0.0025;
/// Experiments begin at this many phases of a step.
pub(super) const PHASES: usize = 12;

pub(super) fn material(friction: f64, restitution: f64, rolling_m: f64) -> Material {
    let exact = |v| Property::new(Interval::exact(v), PropertySource::User);
    Material {
        friction: exact(friction),
        restitution: exact(restitution),
        rolling_m: exact(rolling_m),
        ..example_material()
    }
}

pub(super) fn floor(material: Material) -> Body {
    floor_body(0.0, material)
}

fn refuse(name: &str, why: impl ToString) -> SimError {
    SimError::Body { body: name.to_owned(), why: why.to_string() }
}

pub(super) fn ball(name: &str, center_w: DVec3, material: Material) -> Result<Body, SimError> {
    let density = M / (4.0 / 3.0 * std::f64::consts::PI * R.powi(3));
    let mass = sphere_mass_properties(DVec3::ZERO, R, density).map_err(|e| refuse(name, e))?;
    Ok(Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_translation(center_w),
        shape: BodyShape::Sphere { radius: R },
        mass: Some(mass),
        ..floor_body(0.0, material)
    })
}

/// A box as one hull, of 500 kg/m³.
pub(super) fn cuboid(name: &str, x_wb: DPose3, half: DVec3, material: Material) -> Result<Body, SimError> {
    let mass = box_mass_properties(half, 500.0).map_err(|e| refuse(name, e))?;
    Ok(Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb,
        shape: BodyShape::Hulls { hulls: vec![Mesh::cuboid(half)] },
        mass: Some(mass),
        ..floor_body(0.0, material)
    })
}

/// Returns the same body, made static.
pub(super) fn fixed(body: Body) -> Body {
    Body { kind: BodyKind::Static, mass: None, ..body }
}

/// A world of bodies that may not sleep.
pub(super) fn simulate(
    factory: &dyn WorldFactory,
    gravity: f64,
    bodies: Vec<Body>,
) -> Result<Simulation, SimError> {
    simulate_with(factory, gravity, bodies, true)
}

pub(super) fn simulate_with(
    factory: &dyn WorldFactory,
    gravity: f64,
    bodies: Vec<Body>,
    contact_timing: bool,
) -> Result<Simulation, SimError> {
    let scene = Scene {
        version: SCENE_VERSION,
        name: "probe".into(),
        gravity_w: DVec3::new(0.0, 0.0, -gravity),
        size_sigma: 0.0,
        x_world_recording: DPose3::IDENTITY,
        bodies,
    };
    Simulation::new(
        factory,
        &scene,
        &WorldOptions { dt: DT, sleep: false, contact_timing, ..WorldOptions::default() },
    )
}

/// Sets a body in motion at its current position.
pub(super) fn launch(simulation: &mut Simulation, body: BodyId, v_w: DVec3, w_w: DVec3) {
    let state = BodyState { v_w, w_w, ..simulation.state(body) };
    simulation.set_state(body, &state);
}

pub(super) fn run(simulation: &mut Simulation, seconds: f64) -> Result<(), SimError> {
    for _ in 0..(seconds / DT).round() as usize {
        simulation.advance(DT)?;
    }
    Ok(())
}

/// Phases of a step at which experiments begin.
pub(super) fn phases() -> impl Iterator<Item = f64> {
    (0..PHASES).map(|k| k as f64 / PHASES as f64)
}
