//! Materials of a scene, and the user's edits to them.

use crate::Error;
use crate::run::Run;
use sms_core::metrics::Metrics;
use sms_core::{InputError, Material, Property, RunFolder, Warning, Warnings, atomic};
use sms_materials::{MATERIAL_UNUSUAL, MaterialTable, ObjectQuery, Overrides, assign};
use sms_scene::load_scene;
use std::path::{Path, PathBuf};

/// File of the user's edits in the run's folder, in the format of `sms materialize --materials FILE`.
pub(crate) const EDITS: &str = "materials.toml";
/// File of the material queries in the scene's folder: the effect of an edit can be shown without materializing again.
pub(crate) const QUERIES: &str = "materials.json";

/// Materials of the objects of a scene.
#[derive(Debug, Clone)]
pub struct ObjectMaterials {
    /// The objects, followed by the floor.
    pub objects: Vec<ObjectQuery>,
    /// The material of each.
    pub materials: Vec<Material>,
    /// Names of the objects with another material in the scene, which is older than the last edit.
    pub changed: Vec<String>,
    /// File of the edits.
    pub edits: PathBuf,
    /// Warnings of the user's values beyond those of every material in the handbook.
    pub unusual: Vec<Warning>,
}

impl Run<'_> {
    /// Edits the materials of the objects and returns them all. `set` has `OBJECT.KEY=VALUE` or
    /// `OBJECT.KEY=BEST,LOW,HIGH`; `unset` has `OBJECT.KEY`, or `OBJECT` for all its values. Without edits, no file is
    /// written.
    ///
    /// # Errors
    /// [`Error::Input`] that names the invalid edit; no edit is saved then.
    pub fn materials(&self, set: &[String], unset: &[String]) -> Result<ObjectMaterials, Error> {
        let is_edit = !set.is_empty() || !unset.is_empty();
        let folder = self.folder();
        let run = if is_edit { RunFolder::open(folder)? } else { RunFolder::open_to_read(folder)? };
        let scene_dir = run.stage_dir("scene", "materialize")?;
        let objects = known(&scene_dir)?;
        let table = MaterialTable::builtin();
        let edits = run.root().join(EDITS);
        let mut overrides = Overrides::read_optional(&edits)?;
        for text in unset {
            take_back(&mut overrides, text, &objects)?;
        }
        for text in set {
            edit(&mut overrides, text, &objects, &table)?;
        }
        overrides.check(&objects, &table)?;
        if is_edit {
            overrides.save(&edits)?;
        }
        let warnings = Warnings::new();
        let materials = assign(&objects, &table, Some(&overrides), &warnings)?;
        let changed = changed(&scene_dir, &objects, &materials)?;
        let unusual = warnings.snapshot().into_iter().filter(|w| w.code == MATERIAL_UNUSUAL).collect();
        Ok(ObjectMaterials { objects, materials, changed, edits, unusual })
    }
}

impl ObjectMaterials {
    /// Returns the metrics `materials.*`.
    pub fn metrics(&self) -> Metrics {
        let mut m = Metrics::new();
        for (object, material) in self.objects.iter().zip(&self.materials) {
            let name = &object.name;
            m.set(format!("materials.{name}.class"), material.class.clone());
            if object.volume_m3 > 0.0 {
                m.set(format!("materials.{name}.mass_kg"), material.effective_density() * object.volume_m3);
            }
            for (key, property, _) in material_properties(material) {
                let v = property.value;
                m.set(format!("materials.{name}.{key}"), v.best);
                m.set(format!("materials.{name}.{key}_low"), v.low)
                    .set(format!("materials.{name}.{key}_high"), v.high);
                m.set(format!("materials.{name}.{key}_source"), source_name(property));
            }
        }
        m
    }
}

fn known(scene_dir: &Path) -> Result<Vec<ObjectQuery>, Error> {
    let path = scene_dir.join(QUERIES);
    if !path.is_file() {
        let what = "this scene is damaged, or an earlier version wrote it";
        return Err(InputError::new(what, &path, "run `sms materialize` again").into());
    }
    Ok(atomic::read_json(&path)?)
}

/// Applies an edit `OBJECT.KEY=VALUE`.
fn edit(
    overrides: &mut Overrides,
    text: &str,
    objects: &[ObjectQuery],
    table: &MaterialTable,
) -> Result<(), InputError> {
    let given = format!("--set {text}");
    let malformed = || {
        InputError::new(
            "this is not an assignment",
            &given,
            "write OBJECT.KEY=VALUE, such as --set object_01.density=2400 or --set object_01.friction=0.4,0.3,0.5",
        )
    };
    let (target, value) = text.split_once('=').ok_or_else(malformed)?;
    let (name, key) = target.trim().rsplit_once('.').ok_or_else(malformed)?;
    object(name, &given, objects)?;
    let value = value.trim();
    if key == "class" && table.class(value).is_none() {
        let classes: Vec<&str> = table.classes().collect();
        return Err(InputError::new(
            format!("the material class `{value}` does not exist"),
            given,
            format!("use one of: {}", classes.join(", ")),
        ));
    }
    if key == "mass_kg" && objects.iter().any(|o| o.name == name && o.volume_m3 <= 0.0) {
        return Err(InputError::new(format!("`{name}` is fixed and has no mass"), given, "leave it out"));
    }
    overrides.set(name, key, value)
}

/// Resets `OBJECT` or `OBJECT.KEY`.
fn take_back(overrides: &mut Overrides, text: &str, objects: &[ObjectQuery]) -> Result<(), InputError> {
    let given = format!("--unset {text}");
    let is_object =
        |name: &str| objects.iter().any(|o| o.name == name) || overrides.object.contains_key(name);
    let (name, key) = match text.rsplit_once('.') {
        Some((name, key)) if !is_object(text) => (name, Some(key)),
        _ => (text, None),
    };
    // Values of an object that no longer exists can be reset.
    if !is_object(name) {
        object(name, &given, objects)?;
    }
    if overrides.unset(name, key)? {
        return Ok(());
    }
    let what = key.map_or_else(|| "nothing is".to_owned(), |key| format!("{key} is not"));
    Err(InputError::new(
        format!("{what} set for `{name}`"),
        given,
        "`sms materials RUN` lists all values; set ones have the source `user`",
    ))
}

fn object(name: &str, given: &str, objects: &[ObjectQuery]) -> Result<(), InputError> {
    if objects.iter().any(|o| o.name == name) {
        return Ok(());
    }
    let names: Vec<&str> = objects.iter().map(|o| o.name.as_str()).collect();
    Err(InputError::new(
        format!("this scene has no object `{name}`"),
        given,
        format!("name one of: {}", names.join(", ")),
    ))
}

/// Returns the properties of a material with their names and units.
pub fn material_properties(m: &Material) -> [(&'static str, Property, &'static str); 7] {
    [
        ("density", m.density, "kg/m³"),
        ("fill_factor", m.fill_factor, ""),
        ("friction", m.friction, ""),
        ("restitution", m.restitution, ""),
        ("rolling_m", m.rolling_m, "m"),
        ("youngs_modulus_pa", m.youngs_modulus_pa, "Pa"),
        ("poissons_ratio", m.poissons_ratio, ""),
    ]
}

/// Returns the name of a value's source.
pub fn source_name(property: Property) -> String {
    format!("{:?}", property.source).to_lowercase()
}

/// Returns the objects with another material in the scene.
fn changed(scene_dir: &Path, objects: &[ObjectQuery], materials: &[Material]) -> Result<Vec<String>, Error> {
    let scene = load_scene(scene_dir)?;
    let differs = |object: &ObjectQuery, material: &Material| {
        scene.bodies.iter().find(|b| b.name == object.name).is_some_and(|b| b.material != *material)
    };
    let pairs = objects.iter().zip(materials);
    Ok(pairs.filter(|(o, m)| differs(o, m)).map(|(o, _)| o.name.clone()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edits_name_what_is_wrong_and_change_nothing_then() {
        let table = MaterialTable::builtin();
        let objects = [
            ObjectQuery { name: "object_01".into(), volume_m3: 1e-3, ..Default::default() },
            ObjectQuery { name: "floor".into(), ..Default::default() },
        ];
        let mut overrides = Overrides::default();
        for (text, words) in [
            ("object_01", ["--set object_01", "OBJECT.KEY=VALUE"]),
            ("object_01=3", ["--set object_01=3", "OBJECT.KEY=VALUE"]),
            ("object_9.friction=0.3", ["object_9", "object_01, floor"]),
            ("object_01.frition=0.3", ["frition", "friction"]),
            ("object_01.class=stone", ["stone", "marble"]),
            ("object_01.friction=much", ["much", "best,low,high"]),
            ("floor.mass_kg=3", ["floor", "no mass"]),
        ] {
            let message = edit(&mut overrides, text, &objects, &table).unwrap_err().to_string();
            assert!(words.iter().all(|w| message.contains(w)), "{message}");
        }
        assert!(overrides.object.is_empty());
        edit(&mut overrides, "object_01.friction=0.4,0.3,0.5", &objects, &table).unwrap();
        edit(&mut overrides, "object_01.class = steel", &objects, &table).unwrap();
        let message = take_back(&mut overrides, "object_01.density", &objects).unwrap_err().to_string();
        assert!(message.contains("density is not set"), "{message}");
        assert!(
            take_back(&mut overrides, "object_7", &objects).unwrap_err().to_string().contains("object_01")
        );
        take_back(&mut overrides, "object_01.friction", &objects).unwrap();
        assert_eq!(overrides.object["object_01"].class.as_deref(), Some("steel"));
        take_back(&mut overrides, "object_01", &objects).unwrap();
        assert!(overrides.object.is_empty());
    }
}
