//! True materials: drawn per object around the published ranges of its class (`true_materials.toml`).

use crate::scene::{Hollow, TruthScene};
use rand::RngExt;
use serde::Deserialize;
use sms_core::{Interval, MassProperties, Material, Property, PropertySource, Seed, StageRng};
use std::collections::BTreeMap;
use std::sync::LazyLock;

/// The ranges of one class; see the comments in `true_materials.toml` for units and sources.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct ClassRanges {
    name: String,
    #[serde(rename = "sources")]
    _sources: Vec<String>,
    density_kg_m3: [f64; 2],
    friction: [f64; 2],
    restitution: [f64; 2],
    rolling_m: [f64; 2],
    youngs_modulus_pa: [f64; 2],
    poissons_ratio: [f64; 2],
}

static TABLE: LazyLock<BTreeMap<String, ClassRanges>> = LazyLock::new(|| {
    // The file is compiled in and tested, so this cannot fail for a user.
    toml::from_str(include_str!("true_materials.toml")).expect("the built-in material table is valid")
});

/// Draws the true material of one object. `Material::density` is that of the substance; see [`with_effective_density`] for
/// hollow bodies.
///
/// # Panics
/// If `class` is not a key of the built-in table, which is a bug of this crate.
pub(crate) fn draw_material(class: &str, rng: &mut StageRng) -> Material {
    draw_from(TABLE.get(class).unwrap_or_else(|| panic!("no true material class `{class}`")), rng)
}

fn draw_from(ranges: &ClassRanges, rng: &mut StageRng) -> Material {
    let mut draw = |[low, high]: [f64; 2]| truth(low + (high - low) * rng.random::<f64>());
    Material {
        class: ranges.name.clone(),
        density: draw(ranges.density_kg_m3),
        fill_factor: truth(1.0),
        friction: draw(ranges.friction),
        restitution: draw(ranges.restitution),
        rolling_m: draw(ranges.rolling_m),
        youngs_modulus_pa: draw(ranges.youngs_modulus_pa),
        poissons_ratio: draw(ranges.poissons_ratio),
    }
}

/// Replaces the density by that over the closed outer volume, kg/m³.
pub(crate) fn with_effective_density(material: Material, density: f64) -> Material {
    Material { density: truth(density), ..material }
}

/// Draws the materials and masses of all objects and the floor again from the ranges of their classes: another world that
/// correct classes do not distinguish from this one. Objects without a class of the table keep their material.
pub fn redraw_materials(truth: &TruthScene, seed: Seed) -> TruthScene {
    let seed = seed.derive("redrawn materials");
    let class = |name: &str| TABLE.values().find(|r| r.name == name);
    let mut redrawn = truth.clone();
    for object in &mut redrawn.objects {
        let Some(ranges) = class(&object.material.class) else { continue };
        let material = draw_from(ranges, &mut seed.derive(&object.name).rng());
        let effective = object.material.density.value.best;
        let substance = match object.hollow {
            Hollow::Shell { wall_density, .. } => wall_density,
            Hollow::Solid | Hollow::Vessel { .. } => effective,
        };
        let ratio = material.density.value.best / substance;
        let (mass, com, inertia) = (object.mass.mass(), object.mass.com(), object.mass.inertia());
        // A positive multiple of a possible inertia is possible.
        let Ok(mass) = MassProperties::new(mass * ratio, com, inertia * ratio) else { continue };
        if let Hollow::Shell { wall_density, .. } = &mut object.hollow {
            *wall_density *= ratio;
        }
        object.mass = mass;
        object.material = with_effective_density(material, effective * ratio);
    }
    if let Some(ranges) = class(&redrawn.floor.material.class) {
        redrawn.floor.material = draw_from(ranges, &mut seed.derive("(floor)").rng());
    }
    redrawn
}

fn truth(value: f64) -> Property {
    Property::new(Interval::exact(value), PropertySource::Truth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Seed;

    #[test]
    fn the_table_is_complete_and_physical() {
        assert!(TABLE.len() >= 12);
        for (key, r) in TABLE.iter() {
            assert!(!r._sources.is_empty(), "{key} cites no source");
            for (low, high, floor, ceiling) in [
                (r.density_kg_m3[0], r.density_kg_m3[1], 20.0, 20_000.0),
                (r.friction[0], r.friction[1], 0.01, 1.5),
                (r.restitution[0], r.restitution[1], 0.05, 1.0),
                (r.rolling_m[0], r.rolling_m[1], 0.0, 2e-3),
                (r.youngs_modulus_pa[0], r.youngs_modulus_pa[1], 1e5, 1e12),
                (r.poissons_ratio[0], r.poissons_ratio[1], 0.0, 0.5),
            ] {
                assert!(low <= high && low >= floor && high <= ceiling, "{key}: {low}..{high}");
            }
        }
    }

    #[test]
    fn redrawn_materials_stay_in_their_class_and_masses_go_with_them() {
        let names: Vec<&str> = TABLE.values().map(|r| r.name.as_str()).collect();
        let distinct: std::collections::BTreeSet<&str> = names.iter().copied().collect();
        assert_eq!(names.len(), distinct.len(), "classes are told apart by name");
        let scene = crate::generate_billiards(Seed(3), &crate::BilliardsSettings::default());
        let other = redraw_materials(&scene, Seed(1));
        assert_eq!(other, redraw_materials(&scene, Seed(1)));
        assert_ne!(scene.floor.material, other.floor.material);
        for (a, b) in scene.objects.iter().zip(&other.objects) {
            assert_ne!(a.material.friction, b.material.friction);
            let ranges = TABLE.values().find(|r| r.name == b.material.class).unwrap();
            let friction = b.material.friction.value.best;
            assert!((ranges.friction[0]..=ranges.friction[1]).contains(&friction));
            let substance = match b.hollow {
                Hollow::Shell { wall_density, .. } => wall_density,
                _ => b.material.density.value.best,
            };
            let [low, high] = ranges.density_kg_m3;
            assert!(substance > low - 1e-6 && substance < high + 1e-6, "{}: {substance}", b.name);
            let (mass, density) = (
                b.mass.mass() / a.mass.mass(),
                b.material.density.value.best / a.material.density.value.best,
            );
            assert!((mass / density - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn draws_stay_in_range_and_differ_between_objects() {
        let mut rng = Seed(3).rng();
        let (a, b) = (draw_material("wood", &mut rng), draw_material("wood", &mut rng));
        assert_ne!(a, b);
        for m in [&a, &b] {
            assert!((480.0..=760.0).contains(&m.density.value.best));
            assert_eq!(m.density.source, PropertySource::Truth);
            assert_eq!(m.friction.value.low, m.friction.value.high);
        }
    }
}
