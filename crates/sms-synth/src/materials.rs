//! True materials: drawn per object around the published ranges of its class (`true_materials.toml`).

use rand::RngExt;
use serde::Deserialize;
use sms_core::{Interval, Material, Property, PropertySource, StageRng};
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

/// Draws a true material of the class with this [`Material::class`]; `None` if the table has no such class.
pub fn draw_material_named(class: &str, rng: &mut StageRng) -> Option<Material> {
    TABLE.values().find(|r| r.name == class).map(|r| draw_from(r, rng))
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
    fn classes_are_told_apart_by_name() {
        let distinct: std::collections::BTreeSet<&str> = TABLE.values().map(|r| r.name.as_str()).collect();
        assert_eq!(TABLE.len(), distinct.len());
        let named = |name: &str| draw_material_named(name, &mut Seed(3).rng());
        assert_eq!(named("full steel can").unwrap(), draw_material("full_can", &mut Seed(3).rng()));
        assert_eq!(named("full_can"), None);
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
