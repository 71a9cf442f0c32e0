//! Values of the user beyond those of every material in the table.

use crate::{MaterialTable, ObjectQuery};
use sms_core::{Material, Property, PropertySource, Warnings};

/// Code of the warning.
pub const MATERIAL_UNUSUAL: &str = "material_unusual";

/// The properties that are compared: those of the material itself, not of an object's form.
const COMPARED: [(&str, fn(&Material) -> Property); 6] = [
    ("density", |m| m.density),
    ("friction", |m| m.friction),
    ("restitution", |m| m.restitution),
    ("rolling_m", |m| m.rolling_m),
    ("youngs_modulus_pa", |m| m.youngs_modulus_pa),
    ("poissons_ratio", |m| m.poissons_ratio),
];

/// Warns of best estimates of the user outside the intervals of all classes of the table: a friction of 2 is possible,
/// but it is more often a slip or another unit.
pub(crate) fn warn_unusual(
    objects: &[ObjectQuery],
    materials: &[Material],
    table: &MaterialTable,
    warnings: &Warnings,
) {
    let classes: Vec<Material> = table.classes().filter_map(|name| table.class(name)).collect();
    for (object, material) in objects.iter().zip(materials) {
        for (key, of) in COMPARED {
            let given = of(material);
            if given.source != PropertySource::User {
                continue;
            }
            let known = classes.iter().map(|class| of(class).value);
            let (low, high) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v.low), high.max(v.high))
            });
            let best = given.value.best;
            if classes.is_empty() || (low..=high).contains(&best) {
                continue;
            }
            warnings.add(
                "scene",
                MATERIAL_UNUSUAL,
                format!(
                    "{key} of `{}` is {best}, but every material of the table has {low} to {high}",
                    object.name
                ),
                "check the value and its unit; numbers of an interval are best, low, high",
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Overrides, assign};

    fn warned(edits: &[(&str, &str)]) -> Vec<String> {
        let objects = [ObjectQuery { name: "mug".into(), volume_m3: 1e-3, ..Default::default() }];
        let mut overrides = Overrides::default();
        for (key, text) in edits {
            overrides.set("mug", key, text).unwrap();
        }
        let warnings = Warnings::new();
        assign(&objects, &MaterialTable::builtin(), Some(&overrides), &warnings).unwrap();
        let unusual = warnings.snapshot().into_iter().filter(|w| w.code == MATERIAL_UNUSUAL);
        unusual.map(|w| w.message.split(' ').next().unwrap_or_default().to_owned()).collect()
    }

    #[test]
    fn only_values_beyond_all_materials_are_unusual() {
        assert_eq!(warned(&[("friction", "2,1,3")]), ["friction"]);
        assert_eq!(warned(&[("friction", "0.5,0.4,0.6"), ("density", "7850")]), [""; 0]);
        assert_eq!(warned(&[("class", "rubber")]), [""; 0]);
        // Grams per cubic centimetre.
        assert_eq!(warned(&[("density", "2.7"), ("restitution", "0.5")]), ["density"]);
    }
}
