//! Scanned models among the obstacles of generated billiards scenes.

use crate::billiards::{BallPositions, BilliardsSettings, find_place, footprint, generate_billiards};
use crate::materials::{draw_material, with_effective_density};
use crate::model::{ModelScene, ScannedModel, read_model, standing};
use crate::scene::{Hollow, TruthObject, name_uniquely};
use crate::skin::Skin;
use glamx::{DQuat, DVec2, DVec3};
use rand::RngExt;
use sms_core::{CoreError, Mesh, Seed, StageRng};
use std::path::Path;

/// A scanned model and the name of its folder.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedModel {
    /// Name, such as `ycb_025_mug`.
    pub name: String,
    /// Surface and image texture.
    pub model: ScannedModel,
}

/// Words in models' names with the material class and the share of the enclosed volume that is material. The first match
/// counts.
const MADE_OF: [(&str, &str, f64); 12] = [
    ("can", "full_can", 1.0),
    ("wood", "wood", 1.0),
    ("box", "cardboard", 0.6),
    ("mug", "ceramic", 0.6),
    ("bowl", "ceramic", 1.0),
    ("ramekin", "ceramic", 1.0),
    ("piggybank", "ceramic", 0.25),
    ("duck", "rubber", 0.4),
    ("ball", "synthetic_leather", 0.3),
    ("pitcher", "plastic", 0.08),
    ("bottle", "plastic", 0.8),
    ("", "plastic", 0.5),
];
/// Size limits of models among balls: radius of the footprint and height, metres.
const LARGEST_RADIUS_M: f64 = 0.11;
const LARGEST_HEIGHT_M: f64 = 0.26;

/// Reads the models in a folder, `NAME/model.obj` with their images, ordered by name.
///
/// # Errors
/// [`CoreError::Read`] when there is no such folder or a file in it cannot be read, [`CoreError::Input`] for a damaged model.
pub fn read_models(dir: &Path) -> Result<Vec<NamedModel>, CoreError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(CoreError::read(dir))? {
        let entry = entry.map_err(CoreError::read(dir))?;
        if let Ok(name) = entry.file_name().into_string()
            && entry.path().join("model.obj").is_file()
        {
            names.push(name);
        }
    }
    names.sort();
    let read = |name: String| {
        let model = read_model(&dir.join(&name).join("model.obj"))?;
        Ok(NamedModel { name, model })
    };
    names.into_iter().map(read).collect()
}

/// Generates the billiards scene of this seed with scanned models in place of every second obstacle, if the models are of
/// household size and there is room. The seed determines the models and their places. Balls, goal, floor and the other
/// obstacles are those of [`generate_billiards`]. Models keep their size; their names determine their materials.
pub fn generate_billiards_among(
    seed: Seed,
    settings: &BilliardsSettings,
    models: &[NamedModel],
) -> ModelScene {
    let scanned = if models.is_empty() { 0 } else { settings.objects.div_ceil(2) };
    let own = BilliardsSettings { objects: settings.objects - scanned, ..settings.clone() };
    let mut scene = generate_billiards(seed, &own);
    let mut skins: Vec<Option<Skin>> = scene.objects.iter().map(|_| None).collect();
    let seed = seed.derive("scanned models v1");
    let mut deck: Vec<&NamedModel> = models.iter().filter(|m| is_of_household_size(&m.model.mesh)).collect();
    let mut rng = seed.derive("kinds").rng();
    let at = |name: &str| scene.object(name).map(|o| o.x_wb.translation.truncate()).unwrap_or_default();
    let balls = BallPositions {
        cue: at(&scene.cue),
        target: at(&scene.target),
        goal: DVec2::from_array(scene.goal_w),
    };
    for index in 0..scanned {
        if deck.is_empty() {
            break;
        }
        let chosen = deck.swap_remove(rng.random_range(0..deck.len()));
        let own = seed.derive_index("obstacle", index as u64);
        let (mut object, skin) = make(chosen, own);
        let others: Vec<(DVec2, f64)> = scene.objects.iter().map(footprint).collect();
        let (center, radius) = footprint(&object);
        if let Some(p) = find_place(&mut own.derive("place").rng(), radius, settings, &balls, &others) {
            let p = p - center;
            object.x_wb.translation += DVec3::new(p.x, p.y, 0.0);
            scene.objects.push(object);
            skins.push(skin);
        }
    }
    name_uniquely(&mut scene.objects);
    scene.name += ", with scanned models";
    ModelScene { scene, skins }
}

fn is_of_household_size(mesh: &Mesh) -> bool {
    mesh.aabb().is_some_and(|b| {
        let e = b.extents();
        0.5 * e.x.hypot(e.y) <= LARGEST_RADIUS_M && e.z <= LARGEST_HEIGHT_M
    })
}

/// Places a model at the origin, turned, and draws its material.
fn make(named: &NamedModel, seed: Seed) -> (TruthObject, Option<Skin>) {
    let mut rng = seed.derive("asset").rng();
    let turn = DQuat::from_rotation_z(rng.random::<f64>() * std::f64::consts::TAU);
    let (_, class, fill) =
        MADE_OF.iter().find(|(word, ..)| named.name.contains(word)).copied().unwrap_or(MADE_OF[11]);
    let wall_m = |mesh: &Mesh| (fill < 1.0).then(|| fill * mesh.volume().abs() / mesh.area().max(1e-6));
    made_of(&named.name, &named.model, turn, &Substance { class, fill }, wall_m, &mut rng)
}

/// The material of a scanned model.
pub(crate) struct Substance<'a> {
    /// Key of the table of true materials.
    pub(crate) class: &'a str,
    /// Share of the enclosed volume that is material.
    pub(crate) fill: f64,
}

/// Places a model at the origin, turned, and draws its material. `wall_m` returns the wall thickness of the placed mesh if it
/// is hollow.
pub(crate) fn made_of(
    name: &str,
    model: &ScannedModel,
    turn: DQuat,
    substance: &Substance<'_>,
    wall_m: impl FnOnce(&Mesh) -> Option<f64>,
    rng: &mut StageRng,
) -> (TruthObject, Option<Skin>) {
    let Substance { class, fill } = *substance;
    let material = draw_material(class, rng);
    let wall_density = material.density.value.best;
    let material = with_effective_density(material, fill * wall_density);
    let (mut object, skin) = standing(name, model, turn, material, fill * wall_density, rng);
    if let Some(wall_m) = wall_m(&object.mesh) {
        object.hollow = Hollow::Shell { wall_m, wall_density };
    }
    object.mesh.colors = vertex_colors(&object.mesh, skin.as_ref(), model.color);
    (object, skin)
}

/// Returns the texture's colour at one corner of each vertex.
fn vertex_colors(mesh: &Mesh, skin: Option<&Skin>, plain: [u8; 3]) -> Vec<[u8; 3]> {
    const FOOTPRINT_M: f32 = 0.004;
    let mut colors = vec![plain; mesh.vertices.len()];
    if let Some(skin) = skin {
        for (t, corners) in mesh.triangles.iter().enumerate() {
            for (k, &vertex) in corners.iter().enumerate() {
                let mut weights = [0.0; 3];
                weights[k] = 1.0;
                colors[vertex as usize] =
                    crate::texture::srgb_from_linear(skin.albedo(t, weights, FOOTPRINT_M));
            }
        }
    }
    colors
}

/// Reads the models of the test data.
#[cfg(test)]
pub(crate) fn test_models() -> Vec<NamedModel> {
    let data = std::env::var_os("SMS_TEST_DATA").unwrap_or_else(|| "../../../shared/data".into());
    read_models(&Path::new(&data).join("meshes")).unwrap()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::{ColorImage, MeshTexture};

    fn boxed(name: &str, half: DVec3) -> NamedModel {
        let mesh = Mesh::cuboid(half);
        let corner_uv = vec![[[0.25, 0.75]; 3]; mesh.triangles.len()];
        let image = ColorImage::filled(4, 4, [200, 40, 30]);
        let texture = Some(MeshTexture { corner_uv, image });
        NamedModel { name: name.into(), model: ScannedModel { mesh, texture, color: [9, 9, 9] } }
    }

    #[test]
    fn models_take_every_second_place_and_leave_the_rest_as_it_was() {
        let settings = BilliardsSettings::default();
        let models = [
            boxed("red_box", DVec3::new(0.04, 0.03, 0.05)),
            boxed("a_mug", DVec3::new(0.03, 0.03, 0.04)),
            boxed("a_thing", DVec3::new(0.02, 0.05, 0.03)),
            boxed("a_table", DVec3::new(0.3, 0.3, 0.2)),
        ];
        for seed in 1..6 {
            let made = generate_billiards_among(Seed(seed), &settings, &models);
            assert_eq!(made.skins.len(), made.scene.objects.len());
            let plain = generate_billiards(Seed(seed), &BilliardsSettings { objects: 2, ..settings.clone() });
            assert_eq!(made.scene.objects[..4], plain.objects[..]);
            assert_eq!(made.scene.objects.len(), 7, "three models stand");
            for (i, o) in made.scene.objects.iter().enumerate().skip(4) {
                assert_ne!(o.name, "a_table", "too large");
                assert!(made.skins[i].is_some() && o.mesh.colors[0][0] > 190);
                assert!(o.aabb_w().min.z.abs() < 1e-12);
                let density = o.mass.mass() / o.mesh.volume();
                assert!((density / o.material.density.value.best - 1.0).abs() < 1e-9);
                if o.name == "a_mug" {
                    assert_eq!(o.material.class, "ceramic");
                    assert!((density / 0.6 - 2300.0).abs() < 200.0, "{density}");
                }
                let (p, r) = footprint(o);
                for other in &made.scene.objects[..i] {
                    let (q, s) = footprint(other);
                    assert!(p.distance(q) >= r + s + settings.gap_m - 1e-9, "{} {}", o.name, other.name);
                }
            }
            assert_eq!(made.scene, generate_billiards_among(Seed(seed), &settings, &models).scene);
        }
        let none = generate_billiards_among(Seed(3), &settings, &[]);
        assert_eq!(none.scene.objects, generate_billiards(Seed(3), &settings).objects);
    }

    #[test]
    #[ignore = "needs the meshes of SMS_TEST_DATA"]
    fn scanned_models_of_the_test_data_stand_among_the_balls() {
        let models = test_models();
        assert!(models.len() >= 10 && models.windows(2).all(|w| w[0].name < w[1].name));
        let made = generate_billiards_among(Seed(1), &BilliardsSettings::default(), &models);
        let scanned = made.skins.iter().flatten().count();
        assert!(scanned >= 2, "{scanned} models with pictures stand");
        for o in &made.scene.objects {
            assert!((0.005..4.0).contains(&o.mass.mass()), "{} weighs {} kg", o.name, o.mass.mass());
        }
    }
}
