//! Landing structures with scanned models in place of generated objects.

use crate::assets::{Household, make_household};
use crate::landing::landing_scene_of;
use crate::model::{ModelScene, ScannedModel};
use crate::scanned::{NamedModel, Substance, made_of};
use crate::scene::TruthObject;
use crate::skin::Skin;
use glamx::{DQuat, DVec2, DVec3};
use sms_core::{InputError, Seed};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_2;

/// The generated object that a model replaces, a word in the model's name, its material class, and, if its surface encloses
/// air, its wall thickness in metres: that of the replaced object.
const IN_PLACE_OF: [(Household, &str, &str, Option<f64>); 4] = [
    (Household::FlatBox, "cardboard_box", "cardboard", Some(0.0065)),
    (Household::LiddedTote, "tote", "plastic", Some(0.0025)),
    (Household::RecyclingBin, "bin", "plastic", None),
    (Household::CounterStool, "table", "wood", None),
];

/// Smallest toppling load at the end of the overhang that counts as a standing structure, newtons.
const LEAST_LOAD_N: f64 = 1.0;
/// A side longer than the other by this factor is the longer one.
const LONGER: f64 = 1.01;

/// As [`crate::landing_scene`], with scanned models in place of the flat box (a model with `cardboard_box` in its name), the tote
/// (`tote`), the recycling bin (`bin`) and the stool of counter height (`table`), if there is such a model; of several the first
/// by name. Only whole words of names count. Models keep their size; overhangs follow from the same loads. Layout, ladder,
/// other stool, board and ballast are those of the generated scene.
///
/// # Errors
/// [`InputError`] naming the models if the structure does not stand, because a model has neither a level foot nor a rim.
pub fn landing_scene_among(number: u64, models: &[NamedModel]) -> Result<ModelScene, InputError> {
    let (mut skins, mut used): (BTreeMap<String, Skin>, Vec<&str>) = Default::default();
    let mut scene = landing_scene_of(number, &mut |kind, spread, yaw, seed| {
        let place = IN_PLACE_OF.iter().find(|(replaced, ..)| *replaced == kind);
        let is_called = |m: &NamedModel, word: &str| format!("_{}_", m.name).contains(&format!("_{word}_"));
        let model = |word: &str| models.iter().filter(|m| is_called(m, word)).min_by_key(|m| &m.name);
        match place.and_then(|&(_, word, class, wall_m)| Some((model(word)?, class, wall_m))) {
            None => make_household(kind, spread, yaw, seed),
            Some((model, class, wall_m)) => {
                let (object, skin) = stand(model, class, wall_m, yaw, seed);
                used.push(&model.name);
                skins.extend(skin.map(|s| (object.name.clone(), s)));
                object
            }
        }
    });
    if !used.is_empty() {
        let end_w = scene.landing.as_ref().map_or(DVec2::ZERO, |l| l.end_w.into());
        if scene.tipping_load_n(end_w).is_none_or(|load| load < LEAST_LOAD_N) {
            let what = format!("a structure with {} does not stand", used.join(" and "));
            let cure = "use models with a level foot and a level top or rim; remove this one from the folder";
            return Err(InputError::new(what, "--meshes", cure));
        }
        scene.name += ", with scanned models";
    }
    let skins = scene.objects.iter().map(|o| skins.remove(&o.name)).collect();
    Ok(ModelScene { scene, skins })
}

/// Places a model at the origin with its longer side at a yaw.
fn stand(
    named: &NamedModel,
    class: &str,
    wall_m: Option<f64>,
    yaw: f64,
    seed: Seed,
) -> (TruthObject, Option<Skin>) {
    let model = closed(&named.model);
    let mesh = &model.mesh;
    let fill = wall_m.map_or(1.0, |wall| (wall * mesh.area() / mesh.volume().abs().max(1e-9)).min(1.0));
    let long_in_y = mesh.aabb().is_some_and(|b| b.extents().y > LONGER * b.extents().x);
    let turn = DQuat::from_axis_angle(DVec3::Z, if long_in_y { yaw - FRAC_PI_2 } else { yaw });
    let mut rng = seed.derive("scanned model v1").rng();
    made_of(&named.name, &model, turn, &Substance { class, fill }, |_| wall_m, &mut rng)
}

/// Closes the model's holes by fans of triangles, so that open columns enclose a volume. Holes at edges with more than two
/// faces stay.
fn closed(model: &ScannedModel) -> ScannedModel {
    let mut closed = model.clone();
    // Half edges without their opposites, by their start.
    let mut next: BTreeMap<u32, u32> = BTreeMap::new();
    let half_edges = || model.mesh.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let there: BTreeSet<(u32, u32)> = half_edges().collect();
    for (a, b) in half_edges().filter(|&(a, b)| !there.contains(&(b, a))) {
        next.insert(b, a);
    }
    while let Some((&first, _)) = next.first_key_value() {
        let mut rim = vec![first];
        let mut to = next.remove(&first);
        while let Some(at) = to.filter(|&at| at != first) {
            rim.push(at);
            to = next.remove(&at);
        }
        if to.is_none() {
            continue;
        }
        let vertices = &mut closed.mesh.vertices;
        let middle: DVec3 = rim.iter().map(|&v| vertices[v as usize]).sum();
        vertices.push(middle / rim.len() as f64);
        let middle = vertices.len() as u32 - 1;
        for (k, &a) in rim.iter().enumerate() {
            closed.mesh.triangles.push([a, rim[(k + 1) % rim.len()], middle]);
            if let Some(texture) = &mut closed.texture {
                texture.corner_uv.push([[0.5; 2]; 3]);
            }
        }
    }
    closed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::landing_scene;
    use crate::scanned::test_models;
    use crate::scene::Hollow;
    use sms_core::Mesh;

    fn boxed(name: &str, half: DVec3) -> NamedModel {
        let mesh = Mesh::cuboid(half);
        NamedModel { name: name.into(), model: ScannedModel { mesh, texture: None, color: [9, 90, 9] } }
    }

    #[test]
    fn holes_are_closed() {
        let mut open = boxed("box", DVec3::new(0.3, 0.2, 0.1)).model;
        let whole = open.mesh.volume();
        // Without its top, and a corner at the bottom.
        open.mesh.triangles.retain(|t| t.iter().any(|&v| open.mesh.vertices[v as usize].z < 0.0));
        open.mesh.triangles.swap_remove(0);
        assert!(!open.mesh.is_closed_oriented());
        let mesh = closed(&open).mesh;
        assert!(mesh.is_closed_oriented() && (mesh.volume() / whole - 1.0).abs() < 1e-9, "{}", mesh.volume());
        let whole = boxed("box", DVec3::ONE).model;
        assert_eq!(closed(&whole), whole);
    }

    #[test]
    fn a_model_stands_in_for_its_kind_and_the_rest_stays() {
        let models = [boxed("a_cardboard_box", DVec3::new(0.3, 0.2, 0.1)), boxed("duck", DVec3::splat(0.1))];
        let made = landing_scene_among(1, &models).unwrap();
        let plain = landing_scene(1);
        assert_eq!(made.scene.objects[0], plain.objects[0]);
        let platform = &made.scene.objects[1];
        assert_eq!(platform.name, "a_cardboard_box");
        let landing = made.scene.landing.as_ref().unwrap();
        assert_eq!((&landing.platform, landing.outline_w.len()), (&platform.name, 4));
        // Walls of 6.5 mm around air.
        let Hollow::Shell { wall_density, .. } = platform.hollow else { panic!("{:?}", platform.hollow) };
        let area = 8.0 * (0.3 * 0.2 + 0.2 * 0.1 + 0.1 * 0.3);
        assert!((platform.mass.mass() / (area * 0.0065 * wall_density) - 1.0).abs() < 1e-9);
        assert_eq!(
            (made.skins.len(), made.scene.clone()),
            (2, landing_scene_among(1, &models).unwrap().scene)
        );
        for number in [2, 3, 4, 1003] {
            assert_eq!(landing_scene_among(number, &models).unwrap().scene, landing_scene(number));
        }
    }

    #[test]
    fn the_longer_side_overhangs_and_a_ball_is_refused() {
        let long_in_y = boxed("a_cardboard_box", DVec3::new(0.2, 0.3, 0.1));
        let made = landing_scene_among(1, &[long_in_y]).unwrap().scene;
        let landing = made.landing.as_ref().unwrap();
        let overhang = DVec2::from(landing.overhang_w);
        let along = |p: &[f64; 2]| DVec2::from(*p).dot(overhang);
        let (low, high) =
            landing.outline_w.iter().map(along).fold((9.0f64, -9.0f64), |(l, h), x| (l.min(x), h.max(x)));
        assert!((high - low - 0.6).abs() < 1e-9, "{}", high - low);
        // A ball has no level foot. The word "cabinet" contains "bin", but is not the word "bin".
        let mesh = Mesh::icosphere(0.2, 3);
        let ball = NamedModel {
            name: "cardboard_box".into(),
            model: ScannedModel { mesh, texture: None, color: [9; 3] },
        };
        assert_eq!(landing_scene_among(1, &[ball]).unwrap_err().path, "--meshes");
        let cabinet = boxed("a_cabinet", DVec3::splat(0.2));
        assert_eq!(landing_scene_among(3, &[cabinet]).unwrap().scene, landing_scene(3));
    }

    /// Support and toppling load are the same for a box given by its mesh and by its convex pieces.
    #[test]
    fn a_mesh_without_pieces_is_supported_by_its_faces() {
        let model = boxed("a_cardboard_box", DVec3::new(0.3, 0.2, 0.055));
        let made = landing_scene_among(1, std::slice::from_ref(&model)).unwrap().scene;
        let mut pieces = made.clone();
        pieces.objects[1].parts = vec![pieces.objects[1].mesh.clone()];
        let [ladder, platform] = &pieces.objects[..] else { panic!("two objects") };
        let exact = crate::tipping::support(platform, Some(ladder), &[]);
        let landing = made.landing.as_ref().unwrap();
        let of_mesh = &landing.supports[1];
        assert_eq!((&exact.above, exact.height_m), (&of_mesh.above, of_mesh.height_m));
        let end = DVec2::from(landing.end_w);
        let (a, b) = (pieces.support_load_n(&exact, end), made.support_load_n(of_mesh, end));
        assert!(
            (a / b - 1.0).abs() < 1e-9 && (made.tipping_load_n(end).unwrap() - 1.75).abs() < 1e-6,
            "{a} {b}"
        );
    }

    #[test]
    #[ignore = "needs the meshes of SMS_TEST_DATA"]
    fn structures_of_the_scanned_models_of_the_test_data_stand_and_topple_at_the_load_asked_for() {
        let models = test_models();
        for (number, scanned) in
            [(1, "gz_cardboard_box"), (2, "gz_grey_tote"), (3, "aws_waste_bin"), (4, "aws_low_table")]
        {
            let ModelScene { scene, skins } = landing_scene_among(number, &models).unwrap();
            let landing = scene.landing.as_ref().unwrap();
            let object = scene.object(scanned).unwrap();
            let at = scene.objects.iter().position(|o| o.name == scanned).unwrap();
            let pictures = models.iter().filter(|m| m.name == scanned && m.model.texture.is_some()).count();
            assert!(skins.iter().flatten().count() == pictures && skins[at].is_some() == (pictures == 1));
            for (i, s) in landing.supports.iter().enumerate() {
                assert!(s.footprint_w.len() >= 3, "{}: {s:?}", scene.name);
                assert!(
                    scene.support_load_n(s, s.footprint_w[0].into()) > 0.0,
                    "level {i} topples by itself"
                );
            }
            let load = scene.tipping_load_n(landing.end_w.into()).unwrap();
            let asked = crate::LandingStructure::ALL[number as usize - 1].fixed_end_load_n();
            assert!((load - asked).abs() < 1e-3, "{}: {load} N, asked {asked}", scene.name);
            assert!((0.3..9.0).contains(&object.mass.mass()), "{}", object.mass.mass());
        }
    }
}
