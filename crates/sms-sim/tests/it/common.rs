//! Small scenes for tests.
#![allow(dead_code, unreachable_pub, reason = "each test file uses a part of it")]

use glamx::{DPose3, DVec3};
use sms_core::{
    Interval, MassProperties, Material, Mesh, Property, PropertySource, polyhedron_mass_properties,
    sphere_mass_properties,
};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, floor_body};
use sms_sim::{BodyId, BodyState, RapierF64Factory, RapierFactory, Simulation, WorldFactory, WorldOptions};

/// Radius of the test balls, metres.
pub const R: f64 = 0.03;
/// Their mass, kg.
pub const M: f64 = 0.19;
/// Gravity, m/s².
pub const G: f64 = 9.81;
/// Nominal step, seconds.
pub const DT: f64 = 0.0025;

/// Both precisions.
pub fn factories() -> [&'static dyn WorldFactory; 2] {
    [&RapierFactory, &RapierF64Factory]
}

pub fn material(friction: f64, restitution: f64, rolling_m: f64) -> Material {
    let exact = |v| Property::new(Interval::exact(v), PropertySource::User);
    Material {
        class: "test".into(),
        density: exact(1700.0),
        friction: exact(friction),
        restitution: exact(restitution),
        rolling_m: exact(rolling_m),
        youngs_modulus_pa: exact(1e9),
        fill_factor: exact(1.0),
        poissons_ratio: exact(0.3),
    }
}

pub fn floor(material: Material) -> Body {
    floor_body(0.0, material)
}

pub fn ball(name: &str, center_w: DVec3, material: Material) -> Body {
    let density = M / (4.0 / 3.0 * std::f64::consts::PI * R.powi(3));
    Body {
        name: name.into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_translation(center_w),
        shape: BodyShape::Sphere { radius: R },
        mass: Some(sphere_mass_properties(DVec3::ZERO, R, density).unwrap()),
        ..floor_body(0.0, material)
    }
}

/// A box as one hull.
pub fn cuboid(name: &str, x_wb: DPose3, half: DVec3, kind: BodyKind, material: Material) -> Body {
    let mesh = Mesh::cuboid(half);
    let mass = polyhedron_mass_properties(&mesh, 500.0).unwrap();
    Body {
        name: name.into(),
        kind,
        x_wb,
        mass: (kind == BodyKind::Dynamic)
            .then(|| MassProperties::new(mass.mass(), DVec3::ZERO, mass.inertia()).unwrap()),
        shape: BodyShape::Hulls { hulls: vec![mesh] },
        ..floor_body(0.0, material)
    }
}

/// The same box as a static triangle mesh.
pub fn mesh_box(name: &str, x_wb: DPose3, half: DVec3, material: Material) -> Body {
    Body {
        shape: BodyShape::TriMesh { mesh: Mesh::cuboid(half) },
        ..cuboid(name, x_wb, half, BodyKind::Static, material)
    }
}

pub fn scene(gravity: f64, bodies: Vec<Body>) -> Scene {
    Scene {
        version: SCENE_VERSION,
        name: "test".into(),
        gravity_w: DVec3::new(0.0, 0.0, -gravity),
        size_sigma: 0.0,
        x_world_recording: DPose3::IDENTITY,
        bodies,
    }
}

pub fn awake() -> WorldOptions {
    WorldOptions { dt: DT, sleep: false, ..WorldOptions::default() }
}

pub fn simulate(factory: &dyn WorldFactory, scene: &Scene, options: &WorldOptions) -> Simulation {
    Simulation::new(factory, scene, options).unwrap()
}

/// Sets a body in motion at its current position.
pub fn launch(simulation: &mut Simulation, body: BodyId, v_w: DVec3, w_w: DVec3) {
    let state = BodyState { v_w, w_w, ..simulation.state(body) };
    simulation.set_state(body, &state);
}

pub fn run(simulation: &mut Simulation, seconds: f64) {
    for _ in 0..(seconds / DT).round() as usize {
        simulation.advance(DT).unwrap();
    }
}

/// Largest absolute value.
pub fn worst(values: &[f64]) -> f64 {
    values.iter().map(|v| v.abs()).fold(0.0, f64::max)
}

pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
