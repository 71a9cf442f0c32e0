//! A generated scene's truth as a physics scene.

use glamx::{DPose3, DVec3};
use sms_core::{InertiaError, MassProperties, Mesh};
use sms_scene::{Body, BodyKind, BodyShape, GRAVITY, SCENE_VERSION, Scene, floor_body};
use sms_synth::{TruthObject, TruthScene};

/// The truth as a scene in the world of the recording: exact spheres, the exact convex parts of every other object,
/// true masses and materials, and a half space as floor. Bodies have the names of the truth's objects.
///
/// # Errors
/// [`InertiaError`] when a truth file names masses that no body has.
pub fn scene_from_truth(truth: &TruthScene) -> Result<Scene, InertiaError> {
    let mut floor = floor_body(0.0, truth.floor.material.clone());
    // An object may be called so.
    while truth.object(&floor.name).is_some() {
        floor.name.push('_');
    }
    let mut bodies = vec![floor];
    for (index, object) in truth.objects.iter().enumerate() {
        bodies.push(body(object, index as u16 + 1)?);
    }
    Ok(Scene {
        version: SCENE_VERSION,
        name: format!("{} (truth)", truth.name),
        gravity_w: DVec3::new(0.0, 0.0, -GRAVITY),
        x_world_recording: DPose3::IDENTITY,
        bodies,
    })
}

/// The same scene seen from another world: `x_vw` carries points of its world `W` into `V`. Gravity turns with it.
pub(crate) fn carried(mut scene: Scene, x_vw: &DPose3) -> Scene {
    scene.gravity_w = x_vw.rotation * scene.gravity_w;
    for body in &mut scene.bodies {
        body.x_wb = *x_vw * body.x_wb;
    }
    scene.x_world_recording = *x_vw * scene.x_world_recording;
    scene
}

fn body(object: &TruthObject, label: u16) -> Result<Body, InertiaError> {
    let shape = match object.sphere_radius {
        Some(radius) => BodyShape::Sphere { radius },
        None => BodyShape::Hulls { hulls: object.parts.clone() },
    };
    Ok(Body {
        name: object.name.clone(),
        label,
        description: object.class.clone(),
        kind: BodyKind::Dynamic,
        x_wb: object.x_wb,
        shape,
        visual: object.mesh.clone(),
        texture: None,
        // The truth's origin is the centre of mass up to rounding.
        mass: Some(MassProperties::new(object.mass.mass(), DVec3::ZERO, object.mass.inertia())?),
        material: object.material.clone(),
        color: mean_color(&object.mesh),
        observed_share: 1.0,
        fit_se_m: 0.0,
    })
}

fn mean_color(mesh: &Mesh) -> [u8; 3] {
    let count = mesh.colors.len().max(1) as f64;
    [0, 1, 2].map(|c| {
        let sum: f64 = mesh.colors.iter().map(|color| f64::from(color[c])).sum();
        (sum / count).round() as u8
    })
}
