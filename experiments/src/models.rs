//! Scanned models as scenes, and an orbit of cameras scaled to their size.

use glamx::{DPose3, DQuat, DVec3};
use rand::RngExt;
use sms_core::{Aabb, Camera, Intrinsics, Material, Seed};
use sms_synth::{ModelScene, ScannedModel, TruthScene, draw_floor, draw_material_named, standing};

/// Places a model on a floor in its file's orientation, its lowest point at z = 0, its middle above the origin, turned about z
/// by an angle from the seed (so that no edge is aligned with the axes by chance).
///
/// Its material is unknown: it is called `unknown` and has the values of wood. Its mass properties are those of the enclosed
/// volume, or of a box around it if it encloses none.
pub(crate) fn model_scene(name: &str, model: &ScannedModel, seed: Seed) -> ModelScene {
    let seed = seed.derive("model scene v1").derive(name);
    let mut rng = seed.derive("object").rng();
    let turn = DQuat::from_rotation_z(rng.random::<f64>() * std::f64::consts::TAU);
    let wood = draw_material_named("wood", &mut rng).expect("wood is a class of the table");
    let material = Material { class: "unknown".into(), ..wood };
    let density = material.density.value.best;
    let (object, skin) = standing(name, model, turn, material, density, &mut rng);
    let bounds = object.aabb_w();
    let mut scene = TruthScene::of_objects(name.to_owned(), seed, vec![object], draw_floor(seed, seed));
    scene.workspace_center_w = bounds.center();
    ModelScene { scene, skins: vec![skin] }
}

/// Rings of the orbit: elevation in degrees, and the share of the frames. The highest ring shows cavities.
const RINGS: [(f64, f64); 3] = [(15.0, 0.40), (40.0, 0.33), (68.0, 0.27)];
/// Distance of the cameras from the middle of the object, in radii of the sphere around it. The object fills most of the
/// height of an image with the default field of view.
const ORBIT_RADII: f64 = 2.8;
/// Minimum distance of the cameras from the middle, metres: nearer, the near side of a small object would be below the depth
/// camera's range.
const NEAREST_M: f64 = 0.25;

/// Returns camera poses `X_WC` (OpenCV axes) on three rings around the box of an object, all aimed at its middle. Distances
/// grow with the object, so that every object has about the same size in the images; no part of it is nearer than `near_m`,
/// the shortest depth that the camera measures.
pub(crate) fn orbit_poses(bounds: &Aabb, frames: usize, near_m: f64) -> Vec<DPose3> {
    let center = bounds.center();
    let radius = 0.5 * bounds.extents().length();
    let distance = (ORBIT_RADII * radius).max(NEAREST_M).max(near_m + radius);
    // Only the pose is used.
    let intrinsics = Intrinsics::from_fov(2, 2, 1.0);
    let mut ends = [0; 3];
    let mut share = 0.0;
    for (end, (_, s)) in ends.iter_mut().zip(RINGS) {
        share += s;
        *end = (share * frames as f64).round() as usize;
    }
    (0..frames)
        .map(|i| {
            let ring = ends.iter().position(|&end| i < end).unwrap_or(RINGS.len() - 1);
            let start = if ring == 0 { 0 } else { ends[ring - 1] };
            let count = (ends[ring] - start).max(1) as f64;
            // Rings are turned against each other, so that directions do not repeat.
            let azimuth = std::f64::consts::TAU * ((i - start) as f64 + ring as f64 / 3.0) / count;
            let (up, flat) = RINGS[ring].0.to_radians().sin_cos();
            let eye = center + distance * DVec3::new(flat * azimuth.cos(), flat * azimuth.sin(), up);
            Camera::look_at(intrinsics, eye, center, DVec3::Z).x_wc
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Mesh;

    #[test]
    fn a_model_stands_amid_cameras_at_a_distance() {
        let mesh = Mesh::cuboid(DVec3::splat(0.05));
        let model = ScannedModel { mesh, texture: None, color: [9, 9, 9] };
        let placed = model_scene("cube", &model, Seed(1));
        let bounds = placed.scene.objects[0].aabb_w();
        assert!(bounds.min.z.abs() < 1e-12 && bounds.center().truncate().length() < 1e-12);
        let poses = orbit_poses(&bounds, 60, 0.15);
        assert_eq!(poses.len(), 60);
        for x_wc in &poses {
            assert!((x_wc.translation - bounds.center()).length() >= 0.25 - 1e-12);
            assert!(x_wc.translation.z > 0.1);
        }
        for x_wc in orbit_poses(&bounds, 60, 0.5) {
            assert!((x_wc.translation - bounds.center()).length() >= 0.5 + 0.05 * 3f64.sqrt() - 1e-12);
        }
    }
}
