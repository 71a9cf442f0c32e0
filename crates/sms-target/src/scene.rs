//! Physics scenes from the ground truth of generated scenes.

use glamx::{DPose3, DVec3};
use sms_core::{Hash, InertiaError, MassProperties, Mesh, hash_serializable};
use sms_mesh::{ConvexConfig, convex_parts};
use sms_robots::RobotConfig;
use sms_scene::{Body, BodyKind, BodyShape, GRAVITY, SCENE_VERSION, Scene, floor_body};
use sms_synth::{TruthObject, TruthScene};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Distance of the arm behind the generator's robot position, metres. Nearer, links 5 and 7 collide in one strike of
/// six.
const STAND_BACK_M: f64 = 0.1;

/// Returns the built-in arm in front of a generated scene. Its pose is given, as from a hand-eye calibration; a scan
/// does not estimate it.
pub fn robot_of(truth: &TruthScene) -> RobotConfig {
    let [x, y, z] = (truth.robot_base_w - DVec3::X * STAND_BACK_M).to_array();
    let x_recording_robot =
        [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z], [0.0, 0.0, 0.0, 1.0]];
    RobotConfig { x_recording_robot: Some(x_recording_robot), ..RobotConfig::default() }
}

/// Converts the ground truth into a scene in the world of the recording: exact spheres, the exact convex parts of
/// composed objects, a finer decomposition than the planner's of every other mesh (a scanned model), true masses and
/// materials, and a half space as floor. Bodies have the names of the true objects.
///
/// Decompositions take seconds; they are cached in memory until the process ends.
///
/// # Errors
/// [`InertiaError`] if the ground truth has an impossible mass or inertia.
pub fn scene_from_truth(truth: &TruthScene) -> Result<Scene, InertiaError> {
    let mut floor = floor_body(0.0, truth.floor.material.clone());
    // An object may have this name.
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
        size_sigma: 0.0,
        x_world_recording: DPose3::IDENTITY,
        bodies,
    })
}

/// Transforms a scene into another world: `x_vw` maps points of its world `W` into `V`. Gravity rotates with it.
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
        None if object.parts.is_empty() => BodyShape::Hulls { hulls: fine_parts(&object.mesh).to_vec() },
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
        // The true origin is the centre of mass up to rounding.
        mass: Some(MassProperties::new(object.mass.mass(), DVec3::ZERO, object.mass.inertia())?),
        material: object.material.clone(),
        color: mean_color(&object.mesh),
        observed_share: 1.0,
        fit_se_m: 0.0,
    })
}

/// Decomposition settings for meshes without parts: four times the planner's number of parts, a quarter of its
/// concavity.
fn fine() -> ConvexConfig {
    let planner = ConvexConfig::default();
    ConvexConfig {
        max_parts: 4 * planner.max_parts,
        threshold: 0.25 * planner.threshold,
        floor: 0.25 * planner.floor,
        ..planner
    }
}

fn fine_parts(mesh: &Mesh) -> Arc<Vec<Mesh>> {
    static KEPT: OnceLock<Mutex<BTreeMap<String, Arc<Vec<Mesh>>>>> = OnceLock::new();
    let kept = || KEPT.get_or_init(Mutex::default).lock().unwrap_or_else(PoisonError::into_inner);
    let Hash(key) = hash_serializable(&(&mesh.vertices, &mesh.triangles));
    let found = kept().get(&key).cloned();
    found.unwrap_or_else(|| {
        // Outside the lock: two threads that decompose the same mesh get the same parts.
        let parts = Arc::new(convex_parts(mesh, &fine()));
        kept().insert(key, parts.clone());
        parts
    })
}

fn mean_color(mesh: &Mesh) -> [u8; 3] {
    let count = mesh.colors.len().max(1) as f64;
    [0, 1, 2].map(|c| {
        let sum: f64 = mesh.colors.iter().map(|color| f64::from(color[c])).sum();
        (sum / count).round() as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DQuat;
    use sms_mesh::convex_hull;

    /// Excess volume of the parts over the mesh, for parts that do not overlap.
    fn excess(parts: &[Mesh], mesh: &Mesh) -> f64 {
        parts.iter().map(Mesh::volume).sum::<f64>() / mesh.volume() - 1.0
    }

    /// Returns a bent bar: an arc of a ring with a square section, closed and not convex.
    fn bent_bar() -> Mesh {
        let (steps, half) = (24, 0.01);
        let mut vertices = Vec::new();
        for k in 0..=steps {
            let turn = DQuat::from_rotation_z(std::f64::consts::PI * f64::from(k) / f64::from(steps));
            for (r, z) in [(-half, -half), (half, -half), (half, half), (-half, half)] {
                vertices.push(turn * DVec3::new(0.06 + r, 0.0, z));
            }
        }
        let mut triangles = vec![[0, 1, 2], [0, 2, 3]];
        let last = 4 * steps as u32;
        triangles.extend([[last, last + 2, last + 1], [last, last + 3, last + 2]]);
        for k in 0..steps as u32 {
            for side in 0..4 {
                let (a, b) = (4 * k + side, 4 * k + (side + 1) % 4);
                triangles.extend([[a, a + 4, b + 4], [a, b + 4, b]]);
            }
        }
        Mesh::new(vertices, triangles)
    }

    #[test]
    fn a_mesh_without_parts_is_followed_more_closely_than_by_the_planner() {
        let mesh = bent_bar();
        assert!(mesh.is_closed_oriented() && mesh.volume() > 0.0);
        let (planner, target) = (convex_parts(&mesh, &ConvexConfig::default()), fine_parts(&mesh));
        assert!(target.len() > planner.len(), "{} parts, {} of the planner's", target.len(), planner.len());
        let (coarse, finer) = (excess(&planner, &mesh), excess(&target, &mesh));
        assert!(finer < 0.6 * coarse, "{finer} {coarse}");
        let hull = convex_hull(&mesh.vertices, 64, 0.0).unwrap();
        assert!(excess(&[hull], &mesh) > 1.0, "one hull must be far off");
        assert!(Arc::ptr_eq(&target, &fine_parts(&mesh)), "cached");
    }
}
