//! A table with two billiard balls.

use sms_core::glamx::{DPose3, DVec3};
use sms_core::{Interval, Material, Mesh, Property, PropertySource, sphere_mass_properties};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, floor_body};

/// Radius of a pool ball, metres.
pub(crate) const RADIUS: f64 = 0.0286;

pub(crate) fn material(friction: f64, restitution: f64) -> Material {
    let known = |best: f64, share: f64| {
        Property::new(Interval::new(best, (1.0 - share) * best, (1.0 + share) * best), PropertySource::Table)
    };
    Material {
        class: "phenolic resin".into(),
        density: known(1750.0, 0.05),
        friction: known(friction, 0.2),
        restitution: known(restitution, 0.05),
        rolling_m: known(2e-4, 0.3),
        youngs_modulus_pa: known(5.8e9, 0.1),
        fill_factor: known(1.0, 0.0),
        poissons_ratio: known(0.34, 0.1),
    }
}

pub(crate) fn ball(name: &str, x: f64, y: f64, color: [u8; 3], material: Material) -> Body {
    Body {
        name: name.into(),
        label: 1,
        description: "ball".into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_translation(DVec3::new(x, y, RADIUS)),
        shape: BodyShape::Sphere { radius: RADIUS },
        visual: Mesh::default(),
        texture: None,
        mass: Some(sphere_mass_properties(DVec3::ZERO, RADIUS, material.density.value.best).unwrap()),
        material,
        color,
        observed_share: 1.0,
        fit_se_m: 0.0,
    }
}

/// A cue ball at (0.3, 0) and a blue ball straight ahead of it at (0.6, 0). The balls have no friction, so that the
/// target ball leaves along the line of centres (no throw).
pub(crate) fn two_balls() -> Scene {
    let resin = material(0.0, 0.92);
    Scene {
        version: SCENE_VERSION,
        name: "two balls".into(),
        gravity_w: DVec3::new(0.0, 0.0, -9.81),
        size_sigma: 0.0,
        x_world_recording: DPose3::identity(),
        bodies: vec![
            floor_body(0.0, material(0.4, 0.5)),
            ball("cue", 0.3, 0.0, [235, 232, 225], resin.clone()),
            ball("blue", 0.6, 0.0, [30, 60, 180], resin),
        ],
    }
}
