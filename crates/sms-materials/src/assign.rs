//! Which material each object gets.

use crate::{MaterialTable, Overrides};
use sms_core::{CoreError, Material, Warnings};

/// What is known of an object.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ObjectQuery {
    /// Its name in the scene.
    pub name: String,
    /// What the labeller called it; may be empty.
    pub description: String,
    /// Whether its surface is a sphere.
    pub is_sphere: bool,
    /// Mean sRGB colour.
    pub mean_color: [u8; 3],
}

/// One material an object, in order: the user's word, else what the table knows by the description or the name, else
/// the prior (with a warning, because a prior is a guess).
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
        let known: Vec<&str> = objects.iter().map(|o| o.name.as_str()).collect();
        overrides.check(&known, table)?;
    }
    let mut guessed = Vec::new();
    let materials = objects
        .iter()
        .map(|object| {
            let known = table.by_words(&object.description).or_else(|| table.by_words(&object.name));
            let said = overrides.is_some_and(|o| o.object.contains_key(&object.name));
            if known.is_none() && !said {
                guessed.push(object.name.as_str());
            }
            let base = known.unwrap_or_else(|| table.prior(object.is_sphere));
            match overrides {
                Some(overrides) => overrides.apply(&object.name, base, table),
                None => base,
            }
        })
        .collect();
    if !guessed.is_empty() {
        warnings.add(
            "scene",
            "material_prior",
            format!("nothing is known of the material of {}: a wide prior is used", guessed.join(", ")),
            "give names or descriptions in masks/labels.json, or values with --materials FILE",
        );
    }
    Ok(materials)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::PropertySource;
    use std::path::Path;

    fn query(name: &str, description: &str, is_sphere: bool) -> ObjectQuery {
        ObjectQuery { name: name.into(), description: description.into(), is_sphere, mean_color: [0; 3] }
    }

    fn overrides(dir: &Path, text: &str) -> Result<Overrides, CoreError> {
        let path = dir.join("mine.toml");
        std::fs::write(&path, text).unwrap();
        Overrides::read(&path)
    }

    #[test]
    fn each_source_in_its_turn() {
        let dir = tempfile::tempdir().unwrap();
        let objects =
            [query("object_01", "mug", false), query("object_02", "", true), query("object_03", "", false)];
        let mine = overrides(
            dir.path(),
            "[object.object_03]\nclass = \"brass\"\nfriction = { best = 0.3, low = 0.2, high = 0.4 }\ndensity = 8400\n",
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
        let said = warnings.snapshot();
        assert_eq!(said.len(), 1);
        assert!(said[0].message.contains("object_02") && !said[0].message.contains("object_03"));
    }

    #[test]
    fn mistakes_name_the_file_and_what_there_is() {
        let dir = tempfile::tempdir().unwrap();
        let objects = [query("object_01", "", false)];
        let assigned = |text: &str| {
            overrides(dir.path(), text)
                .and_then(|o| assign(&objects, &MaterialTable::builtin(), Some(&o), &Warnings::new()))
                .map_err(|e| e.to_string())
        };
        for (text, words) in [
            ("[object.object_9]\nfriction = 0.2\n", ["object_9", "object_01"]),
            ("[object.object_01]\nclass = \"stone\"\n", ["stone", "marble"]),
            ("[object.object_01]\nfrition = 0.2\n", ["frition", "friction"]),
            ("[object.object_01]\nrestitution = 1.5\n", ["restitution", "≤ 1"]),
            ("[object.object_01]\nfriction = { best = 0.1, low = 0.2, high = 0.3 }\n", ["friction", "low"]),
        ] {
            let message = assigned(text).unwrap_err();
            assert!(message.contains("mine.toml"), "{message}");
            assert!(words.iter().all(|w| message.contains(w)), "{message}");
        }
    }
}
