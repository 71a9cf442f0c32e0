//! Assignment of materials to objects.

use crate::table::{CavityKind, KnownObjectMaterial, fill_of_another};
use crate::unusual::warn_unusual;
use crate::{Estimate, MaterialTable, Overrides};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, Interval, Material, Property, PropertySource, Warnings};

/// A mesh that fills less than this share of its convex hull counts as a mesh of its walls. A mug with a visible inside fills
/// 0.2 to 0.45 of its hull, a plate 0.3 to 0.5; a mug that was closed at the rim fills 0.85 with its handle, and solid
/// figures 0.6 to 0.9.
const WALLS_VISIBLE_BELOW: f64 = 0.55;

/// The known facts about an object.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectQuery {
    /// Its name in the scene.
    pub name: String,
    /// The labeller's description; may be empty.
    pub description: String,
    /// Whether its surface is a sphere.
    pub is_sphere: bool,
    /// Mean sRGB colour.
    pub mean_color: [u8; 3],
    /// Volume of the mesh over that of its convex hull; 0 if unknown.
    pub hull_fill: f64,
    /// Volume of the mesh (or of its sphere, box or cylinder), m³; 0 if unknown or open.
    pub volume_m3: f64,
    /// Area of its convex hull, m²; 0 if unknown.
    pub hull_area_m2: f64,
    /// The estimate of a vision-language model.
    pub estimate: Option<Estimate>,
}

/// Assigns one material to each object: the user's values, else a model's estimate, else the table's entry for the description
/// or the name, else the prior (with a warning).
///
/// # Errors
/// [`CoreError::Input`] when the user's file names an object or a class that does not exist.
pub fn assign(
    objects: &[ObjectQuery],
    table: &MaterialTable,
    overrides: Option<&Overrides>,
    warnings: &Warnings,
) -> Result<Vec<Material>, CoreError> {
    if let Some(overrides) = overrides {
        overrides.check(objects, table)?;
    }
    let mut guessed = Vec::new();
    let materials: Vec<Material> = objects
        .iter()
        .map(|object| {
            let base = without_override(object, table);
            let said = overrides.is_some_and(|o| o.object.contains_key(&object.name));
            if base.density.source == PropertySource::Prior && !said {
                guessed.push(object.name.as_str());
            }
            match overrides {
                Some(overrides) => overrides.apply(object, base, table),
                None => base,
            }
        })
        .collect();
    if !guessed.is_empty() {
        warnings.add(
            "scene",
            "material_prior",
            format!("the material of {} is unknown: a wide prior is used", guessed.join(", ")),
            "give names or descriptions in masks/labels.json, or values with `sms materials RUN --set` or --materials FILE, \
             or name a vision-language model ([vlm])",
        );
    }
    warn_unusual(objects, &materials, table, warnings);
    Ok(materials)
}

/// Returns the material of one object before the user's values.
pub fn without_override(object: &ObjectQuery, table: &MaterialTable) -> Material {
    let by_label = || table.known(&object.description).or_else(|| table.known(&object.name));
    let known = match &object.estimate {
        Some(estimate) => known_of_estimate(estimate, table)
            .or_else(|| if estimate.label_is_right == Some(false) { None } else { by_label() }),
        None => by_label(),
    };
    let known = known.map(|k| of_size(k, object));
    let form = known.as_ref().map_or(CavityKind::Plain, |k| k.form);
    let mut material = known.map_or_else(|| table.prior(object.is_sphere), |k| k.material);
    if let Some(estimate) = &object.estimate {
        if table.class_of(&estimate.material).is_none() {
            // Materials without a class of the table keep their given name.
            material.class = estimate.class().unwrap_or(material.class);
        }
        for (slot, said) in [
            (&mut material.density, estimate.density),
            (&mut material.fill_factor, estimate.fill_factor),
            (&mut material.friction, estimate.friction),
            (&mut material.restitution, estimate.restitution),
            (&mut material.youngs_modulus_pa, estimate.youngs_modulus_pa),
            (&mut material.poissons_ratio, estimate.poissons_ratio),
        ] {
            *slot = said.map_or(*slot, |value| Property::new(value, PropertySource::Vlm));
        }
    }
    material.fill_factor = fill_of_mesh(material.fill_factor, form, object);
    material
}

/// Looks up the model's words in the table. The material that it names precedes the words of its label: a "glass" of plastic is
/// plastic.
pub(crate) fn known_of_estimate(estimate: &Estimate, table: &MaterialTable) -> Option<KnownObjectMaterial> {
    let words = format!("{} {}", estimate.material, estimate.label);
    let known = table.known(&words)?;
    let Some(class) = table.class_of(&estimate.material) else { return Some(known) };
    if known.material.class == class {
        return Some(known);
    }
    let mut material = table.class(class)?;
    material.fill_factor = match known.form {
        CavityKind::Plain => material.fill_factor,
        _ => fill_of_another(&known.material.fill_factor, &known.material, &material),
    };
    // Walls of another material have another thickness: only the fill factor is known.
    Some(KnownObjectMaterial { material, walls_m: None, ..known })
}

/// Sets the fill factor over the convex hull from the walls and the size of the object.
fn of_size(mut known: KnownObjectMaterial, object: &ObjectQuery) -> KnownObjectMaterial {
    let Some(walls) = known.walls_m else { return known };
    let hull_m3 = object.volume_m3 / object.hull_fill;
    if hull_m3.is_finite() && hull_m3 > 0.0 && object.hull_area_m2 > 0.0 {
        let over_hull = |wall_m: f64| (wall_m * object.hull_area_m2 / hull_m3).clamp(1e-3, 1.0);
        known.material.fill_factor = Property::new(mapped(walls.value, over_hull), walls.source);
    }
    known
}

/// Converts the fill factor over the outer volume to that over the volume enclosed by the mesh.
fn fill_of_mesh(fill: Property, form: CavityKind, object: &ObjectQuery) -> Property {
    let has_hollow = object.hull_fill > 0.0 && object.hull_fill < WALLS_VISIBLE_BELOW && !object.is_sphere;
    if has_hollow && !matches!(form, CavityKind::Closed | CavityKind::Frame) {
        // An unknown closed object of irregular shape may still be hollow.
        let low = if fill.source == PropertySource::Prior { fill.value.low } else { 1.0 };
        return Property::new(Interval::new(1.0, low, 1.0), fill.source);
    }
    let is_over_hull = matches!(form, CavityKind::Open | CavityKind::Frame);
    if !is_over_hull || !(0.0..1.0).contains(&object.hull_fill) || object.hull_fill <= 0.0 {
        return fill;
    }
    // The mesh excludes part of the cavity or of a frame's gaps: the same material in a smaller volume.
    let over_mesh = |share: f64| (share / object.hull_fill).min(1.0);
    Property::new(mapped(fill.value, over_mesh), fill.source)
}

/// Applies an increasing function to an interval.
pub(crate) fn mapped(i: Interval, f: impl Fn(f64) -> f64) -> Interval {
    Interval::new(f(i.best), f(i.low), f(i.high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Mass (kg: best, low, high) of an object with this description and convex hull (m³, m²), of which the mesh encloses a share.
    fn mass(description: &str, hull_m3: f64, hull_area_m2: f64, hull_fill: f64) -> [f64; 3] {
        let (volume_m3, name) = (hull_m3 * hull_fill, "object_01".to_owned());
        let object = ObjectQuery {
            name,
            description: description.into(),
            volume_m3,
            hull_fill,
            hull_area_m2,
            ..Default::default()
        };
        let m = without_override(&object, &MaterialTable::builtin());
        let (d, f) = (m.density.value, m.fill_factor.value);
        [d.best * f.best, d.low * f.low, d.high * f.high].map(|density| density * volume_m3)
    }

    /// Commercial objects with their usual sizes and weights.
    #[test]
    fn hollow_household_objects_have_realistic_masses() {
        for (what, size, kg) in [
            ("cardboard box", [0.60, 0.40, 0.40], 1.1),
            ("cardboard box", [0.30, 0.20, 0.10], 0.25),
            ("plastic tote", [0.60, 0.40, 0.30], 2.9),
            ("plastic recycling bin", [0.37, 0.27, 0.38], 1.4),
            ("plastic crate", [0.40, 0.30, 0.25], 1.5),
        ] {
            let [x, y, z]: [f64; 3] = size;
            let [best, low, high] = mass(what, x * y * z, 2.0 * (x * y + y * z + z * x), 0.97);
            assert!((low..high).contains(&kg), "{what}: {low:.2} to {high:.2} kg");
            assert!((kg / 2.5..kg * 2.5).contains(&best), "{what}: {best:.2} kg, usual are {kg}");
        }
    }

    #[test]
    fn how_much_of_a_frame_a_mesh_encloses_does_not_change_its_mass() {
        for (what, hull_m3, kg) in [("aluminium step ladder", 0.12, 4.5), ("wooden stool", 0.065, 3.2)] {
            let [a, ..] = mass(what, hull_m3, 0.9, 0.1);
            let [b, low, high] = mass(what, hull_m3, 0.9, 0.4);
            assert!((a / b - 1.0).abs() < 1e-9, "{what}: {a} {b}");
            assert!((low..high).contains(&kg) && (kg / 1.6..kg * 1.6).contains(&b), "{what}: {b} kg");
        }
        // A frame weighs at most its enclosed volume filled with its material.
        let [best, ..] = mass("wooden stool", 0.065, 0.9, 0.02);
        assert!((best - 650.0 * 0.02 * 0.065).abs() < 1e-9);
    }

    fn query(name: &str, description: &str, is_sphere: bool) -> ObjectQuery {
        ObjectQuery { name: name.into(), description: description.into(), is_sphere, ..Default::default() }
    }

    fn overrides(dir: &Path, text: &str) -> Result<Overrides, CoreError> {
        let path = dir.join("mine.toml");
        std::fs::write(&path, text).unwrap();
        Overrides::read(&path)
    }

    #[test]
    fn each_source_in_its_turn() {
        let dir = tempfile::tempdir().unwrap();
        let estimate = Estimate {
            material: "Glazed stoneware".into(),
            label: "coffee mug".into(),
            density: Some(Interval::new(2350.0, 2200.0, 2500.0)),
            friction: Some(Interval::new(0.5, 0.4, 0.6)),
            ..Default::default()
        };
        let seen = ObjectQuery { estimate: Some(estimate), ..query("object_04", "", false) };
        let objects = [
            query("object_01", "mug", false),
            query("object_02", "", true),
            query("object_03", "", false),
            seen.clone(),
            ObjectQuery { name: "object_05".into(), ..seen },
        ];
        let mine = overrides(
            dir.path(),
            "[object.object_03]\nclass = \"brass\"\nfriction = { best = 0.3, low = 0.2, high = 0.4 }\ndensity = 8400\n\
             [object.object_05]\nfriction = 0.9\n",
        )
        .unwrap();
        let warnings = Warnings::new();
        let m = assign(&objects, &MaterialTable::builtin(), Some(&mine), &warnings).unwrap();
        assert_eq!((m[0].class.as_str(), m[0].density.source), ("ceramic", PropertySource::Table));
        assert_eq!((m[1].class.as_str(), m[1].density.source), ("unknown", PropertySource::Prior));
        assert!(
            m[1].restitution.value.best > m[0].restitution.value.best,
            "an unknown sphere bounces like a ball"
        );
        assert_eq!((m[2].class.as_str(), m[2].friction.source), ("brass", PropertySource::User));
        assert_eq!((m[2].density.value.low, m[2].density.value.high), (8400.0, 8400.0));
        assert_eq!(m[2].restitution.source, PropertySource::Table);
        assert_eq!(m[3].class, "ceramic", "stoneware is ceramic");
        assert_eq!((m[3].density.value.best, m[3].density.source), (2350.0, PropertySource::Vlm));
        assert_eq!((m[3].friction.value.best, m[3].friction.source), (0.5, PropertySource::Vlm));
        assert_eq!(m[3].restitution, m[0].restitution, "values missing from the estimate are the table's");
        assert_eq!(m[3].fill_factor, m[0].fill_factor, "a mug is hollow by its label");
        assert_eq!((m[4].friction.source, m[4].density.source), (PropertySource::User, PropertySource::Vlm));
        assert_eq!(warnings.snapshot().len(), 1, "the prior is used for one object");
    }

    #[test]
    fn the_models_material_comes_before_its_label_and_before_a_wrong_label_of_ours() {
        let table = MaterialTable::builtin();
        let seen = |material: &str, label: &str, ours: &str, right: Option<bool>| {
            let estimate = Estimate {
                material: material.into(),
                label: label.into(),
                label_is_right: right,
                ..Default::default()
            };
            without_override(&ObjectQuery { estimate: Some(estimate), ..query("o", ours, false) }, &table)
        };
        assert_eq!(seen("plastic", "drinking glass", "", None).class, "plastic");
        assert!(seen("plastic", "drinking glass", "", None).fill_factor.value.best < 0.5, "and hollow");
        assert_eq!(seen("neoprene", "wetsuit", "", None).class, "neoprene");
        assert_eq!(seen("neoprene", "wetsuit", "", None).density.source, PropertySource::Prior);
        assert_eq!(seen("", "", "brass statue", Some(true)).class, "brass");
        assert_eq!(seen("", "", "brass statue", Some(false)).class, "unknown");
    }

    #[test]
    fn the_mass_of_hollow_objects_does_not_depend_on_the_observed_cavity() {
        let table = MaterialTable::builtin();
        let fill = |description: &str, hull_fill: f64| {
            let q = ObjectQuery { hull_fill, ..query("o", description, false) };
            without_override(&q, &table).fill_factor.value
        };
        let closed = fill("mug", 0.95);
        assert!(closed.high > 2.0 * closed.low, "wide: {closed:?}");
        for hull_fill in [0.6, 0.75, 0.95] {
            let over_hull = fill("mug", hull_fill).best * hull_fill;
            assert!((over_hull - 0.375).abs() < 1e-12, "the mass does not depend on how much was seen");
        }
        assert_eq!(fill("mug", 0.3), Interval::exact(1.0), "the mesh has the walls");
        assert_eq!(fill("plush bear", 0.5).best, 0.48, "a concave outside says nothing of the inside");
        let odd = fill("", 0.3);
        assert_eq!((odd.best, odd.high), (1.0, 1.0));
        assert_eq!(
            odd.low,
            table.prior(false).fill_factor.value.low,
            "it may be closed and hollow all the same"
        );
        assert_eq!(fill("", 0.0), table.prior(false).fill_factor.value, "unknown shape");
        assert_eq!(fill("wooden block", 0.99), Interval::exact(1.0));
        let ball = ObjectQuery { hull_fill: 0.4, ..query("o", "soccer ball", true) };
        assert_eq!(without_override(&ball, &table).fill_factor.value.best, 0.07);
    }

    #[test]
    fn mistakes_name_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let objects = [query("object_01", "", false)];
        let assigned = |text: &str| {
            overrides(dir.path(), text)
                .and_then(|o| assign(&objects, &MaterialTable::builtin(), Some(&o), &Warnings::new()))
        };
        for text in [
            "[object.object_9]\nfriction = 0.2\n",
            "[object.object_01]\nclass = \"stone\"\n",
            "[object.object_01]\nfrition = 0.2\n",
            "[object.object_01]\nrestitution = 1.5\n",
            "[object.object_01]\nfill_factor = 1.5\n",
            "[object.object_01]\nmass_kg = 0.3\n",
            "[object.object_01]\nfriction = { best = 0.1, low = 0.2, high = 0.3 }\n",
        ] {
            let Err(CoreError::Input(error)) = assigned(text) else { panic!("{text}") };
            assert!(error.path.ends_with("mine.toml"), "{error}");
        }
    }
}
