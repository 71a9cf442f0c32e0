//! Structures of objects that stand on each other or touch, for masks: their fused surface is connected.

use crate::furniture::{Furniture, make_furniture, uniform};
use glamx::DVec2;
use serde::{Deserialize, Serialize};
use sms_core::Seed;
use sms_synth::{
    AssetKind, BALL_RADIUS_M, TruthObject, TruthScene, bounds_w, draw_floor, make_asset, make_pool_ball,
    name_uniquely, on_top,
};

/// Kinds of stacked structures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Structure {
    /// A cardboard box that overhangs the seat of a stool.
    BoxOnStool,
    /// An open tote that overhangs a low table.
    ToteOnTable,
    /// A plank that juts out from a crate, held down by a heavy block.
    BallastOnPlank,
    /// A pool ball that touches a mug, and another that touches the first.
    BallAgainstMug,
}

impl Structure {
    /// All of them.
    pub const ALL: [Self; 4] =
        [Self::BoxOnStool, Self::ToteOnTable, Self::BallastOnPlank, Self::BallAgainstMug];

    /// The word in files, names and seeds.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::BoxOnStool => "box_on_stool",
            Self::ToteOnTable => "tote_on_table",
            Self::BallastOnPlank => "ballast_on_plank",
            Self::BallAgainstMug => "ball_against_mug",
        }
    }
}

/// Generates a structure on the floor at the world's origin; sizes, colours, turns and overhangs follow from the seed. There
/// are no balls to play: `cue` and `target` are empty.
pub(crate) fn generate_stacked(structure: Structure, scene_seed: Seed) -> TruthScene {
    let seed = scene_seed.derive("stacked v1").derive(structure.as_str());
    let mut rng = seed.derive("layout").rng();
    let mut draw = |low: f64, high: f64| uniform(&mut rng, [low, high]);
    let yaw = draw(0.0, std::f64::consts::TAU);
    let along = DVec2::from_angle(yaw);
    let furniture = |kind: Furniture, p_w: DVec2, yaw: f64| {
        make_furniture(kind, p_w, yaw, &mut seed.derive(kind.as_str()).rng())
    };
    let mut objects = Vec::new();
    match structure {
        Structure::BoxOnStool | Structure::ToteOnTable => {
            let (base, load) = match structure {
                Structure::BoxOnStool => (Furniture::Stool, Furniture::FlatBox),
                _ => (Furniture::Table, Furniture::Tote),
            };
            objects.push(furniture(base, DVec2::ZERO, yaw));
            let overhang = along * draw(0.05, 0.09);
            objects.push(on_top(furniture(load, overhang, yaw + draw(-0.5, 0.5)), &objects[0]));
        }
        Structure::BallastOnPlank => {
            objects.push(furniture(Furniture::Crate, DVec2::ZERO, yaw + draw(-0.15, 0.15)));
            objects.push(on_top(furniture(Furniture::Plank, along * draw(0.10, 0.15), yaw), &objects[0]));
            let mut block = seed.derive("ballast").rng();
            let back = -along * draw(0.06, 0.08);
            let ballast = make_asset(AssetKind::BrassBlock, back, yaw + draw(-0.6, 0.6), 1.0, &mut block);
            objects.push(on_top(ballast, &objects[1]));
        }
        Structure::BallAgainstMug => {
            let mug = make_asset(AssetKind::Mug, DVec2::ZERO, yaw, 1.0, &mut seed.derive("mug").rng());
            // Opposite the handle, or beside it.
            let away = DVec2::from_angle(yaw + draw(1.8, 4.4));
            let first = away * (wall_radius(&mug) + BALL_RADIUS_M);
            let turned = DVec2::from_angle(away.to_angle() + draw(-1.0, 1.0));
            let second = first + turned * 2.0 * BALL_RADIUS_M;
            let mut balls = seed.derive("balls").rng();
            objects.extend([
                mug,
                make_pool_ball(false, first, &mut balls),
                make_pool_ball(true, second, &mut balls),
            ]);
        }
    }
    name_uniquely(&mut objects);
    let name = format!("{}, seed {}", structure.as_str(), scene_seed.0);
    let mut scene = TruthScene::of_objects(name, scene_seed, objects, draw_floor(scene_seed, seed));
    scene.workspace_center_w = bounds_w(&scene).center();
    scene
}

/// Returns the radius of the wall of a mug at the origin without its handle, from its foot with a bevel of 2 mm.
fn wall_radius(mug: &TruthObject) -> f64 {
    let radii = mug.mesh_w().vertices.into_iter().filter(|v| v.z < 0.003).map(|v| v.truncate().length());
    radii.fold(0.0, f64::max) + 0.002
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec3;

    #[test]
    fn structures_stand_on_each_other_and_do_not_overlap() {
        for structure in Structure::ALL {
            for seed in 1001..1006 {
                let scene = generate_stacked(structure, Seed(seed));
                assert_eq!(scene, generate_stacked(structure, Seed(seed)));
                assert!(scene.objects.len() >= 2);
                for (i, o) in scene.objects.iter().enumerate() {
                    let own = o.aabb_w();
                    assert!(
                        o.mass.mass() > 0.0 && (o.sphere_radius.is_some() || o.mesh.is_closed_oriented())
                    );
                    let below = match structure {
                        Structure::BallAgainstMug => 0.0,
                        _ if i == 0 => 0.0,
                        _ => scene.objects[i - 1].aabb_w().max.z,
                    };
                    assert!((own.min.z - below).abs() < 1e-9, "{} {}", scene.name, o.name);
                }
            }
        }
    }

    #[test]
    fn the_balls_touch_what_they_lie_against() {
        for seed in 1001..1011 {
            let scene = generate_stacked(Structure::BallAgainstMug, Seed(seed));
            let centers: Vec<DVec3> = scene.objects.iter().map(|o| o.x_wb.translation).collect();
            let r = BALL_RADIUS_M;
            assert!((centers[1].distance(centers[2]) - 2.0 * r).abs() < 1e-9);
            let near =
                scene.objects[0].mesh_w().vertices.iter().map(|v| v.distance(centers[1])).fold(9.0, f64::min);
            // The wall has facets, so its corners lie up to a few millimetres from the point of contact.
            assert!(near > r - 1e-4 && near < r + 0.004, "{near}");
            let other =
                scene.objects[0].mesh_w().vertices.iter().map(|v| v.distance(centers[2])).fold(9.0, f64::min);
            assert!(other > r, "{other}");
        }
    }
}
