//! Materials of a scene, and the user's edits to them.

use crate::Error;
use crate::object_names::{EDITS, FIXED, ObjectNames, follow};
use crate::run::Run;
use crate::stage_list::command_of;
use sms_core::metrics::Metrics;
use sms_core::{InputError, Material, Property, RunFolder, Warning, Warnings, atomic};
use sms_materials::{MATERIAL_UNUSUAL, MaterialTable, ObjectQuery, Overrides, assign};
use sms_scene::load_scene;
use std::path::{Path, PathBuf};

/// File of the material queries in the scene's folder: the effect of an edit can be shown without materializing again.
pub(crate) const QUERIES: &str = "materials.json";

/// Materials of the objects of a scene.
#[derive(Debug, Clone)]
pub struct ObjectMaterials {
    /// The objects under their present names, followed by the floor. Empty if there is no scene.
    pub objects: Vec<ObjectQuery>,
    /// The material of each.
    pub materials: Vec<Material>,
    /// Names of the objects with another material in the scene, which is older than the last edit.
    pub changed: Vec<String>,
    /// Names of the objects of this call's edits.
    pub edited: Vec<String>,
    /// Names in the file of the edits that belong to no object of the scene and of the masks; empty without a scene.
    pub unused: Vec<String>,
    /// File of the edits.
    pub edits: PathBuf,
    /// Command that rebuilds the scene with the edits and the earlier options.
    pub rebuild: String,
    /// Warnings of the user's values beyond those of every material in the handbook.
    pub unusual: Vec<Warning>,
}

impl Run<'_> {
    /// Edits the materials of the objects and returns them all. `set` has `OBJECT.KEY=VALUE` or
    /// `OBJECT.KEY=BEST,LOW,HIGH`; `unset` has `OBJECT.KEY`, or `OBJECT` for all its values. Without edits, no file is
    /// written. An object may have its name in `masks/labels.json` or in the scene. Values can be reset without a
    /// scene.
    ///
    /// # Errors
    /// [`Error::Input`] that names the invalid edit; no edit is saved then.
    pub fn materials(&self, set: &[String], unset: &[String]) -> Result<ObjectMaterials, Error> {
        let is_edit = !set.is_empty() || !unset.is_empty();
        let folder = self.folder();
        let run = if is_edit { RunFolder::open(folder)? } else { RunFolder::open_to_read(folder)? };
        let scene_dir = match run.stage_dir("scene", "materialize") {
            Err(_) if set.is_empty() && is_edit => None,
            found => Some(found?),
        };
        let in_scene = scene_dir.as_deref().map(known).transpose()?.unwrap_or_default();
        let edits = run.root().join(EDITS);
        let names = ObjectNames::of(&run)?;
        let mut overrides = follow(Overrides::read_optional(&edits)?, &names).overrides;
        let mut objects = in_scene.clone();
        for object in &mut objects {
            object.name = names.present_name_of_scene(&object.name).to_owned();
        }
        let table = MaterialTable::builtin();
        let known = Known { objects: &objects, names: &names };
        for text in unset {
            take_back(&mut overrides, text, known)?;
        }
        for text in set {
            edit(&mut overrides, text, known, &table)?;
        }
        let mut used = overrides.clone();
        used.object.retain(|name, _| objects.iter().any(|o| o.name == *name));
        used.check(&objects, &table)?;
        if is_edit {
            overrides.save(&edits)?;
        }
        let unused = match &scene_dir {
            Some(_) => unused(&overrides, &used, &names),
            None => Vec::new(),
        };
        let warnings = Warnings::new();
        let materials = assign(&objects, &table, Some(&used), &warnings)?;
        let unusual = warnings.snapshot().into_iter().filter(|w| w.code == MATERIAL_UNUSUAL).collect();
        let edited = edited(&objects, set.iter().chain(unset));
        let changed = match &scene_dir {
            Some(dir) => {
                changed(dir, &in_scene, &materials)?.into_iter().map(|i| objects[i].name.clone()).collect()
            }
            None => Vec::new(),
        };
        let rebuild = command_of(&run, "scene");
        Ok(ObjectMaterials { objects, materials, changed, edited, unused, edits, rebuild, unusual })
    }
}

/// The objects that edits may name.
#[derive(Clone, Copy)]
struct Known<'a> {
    /// The objects of the scene under their present names, if there is one.
    objects: &'a [ObjectQuery],
    names: &'a ObjectNames,
}

impl Known<'_> {
    fn has(self, name: &str) -> bool {
        self.objects.iter().any(|o| o.name == name)
    }

    fn unknown(self, name: &str, given: &str) -> InputError {
        let known = match self.names.known() {
            Some(known) if self.objects.is_empty() => known,
            _ if self.objects.is_empty() => FIXED.to_vec(),
            _ => self.objects.iter().map(|o| o.name.as_str()).collect(),
        };
        let cure = format!("name one of: {}", known.join(", "));
        InputError::new(format!("this scene has no object `{name}`"), given, cure)
    }
}

impl ObjectMaterials {
    /// Returns the objects and their materials that show the effect of the call: the edited ones, or all without edits.
    pub fn shown(&self) -> impl Iterator<Item = (&ObjectQuery, &Material)> {
        let all = self.objects.iter().zip(&self.materials);
        all.filter(|(object, _)| self.edited.is_empty() || self.edited.contains(&object.name))
    }

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

/// Returns the objects that edits (`OBJECT`, `OBJECT.KEY`, `OBJECT.KEY=VALUE`) name.
fn edited<'a>(objects: &[ObjectQuery], edits: impl Iterator<Item = &'a String>) -> Vec<String> {
    let targets: Vec<&str> = edits.map(|text| text.split('=').next().unwrap_or(text).trim()).collect();
    let is_named = |name: &str| {
        targets.iter().any(|t| *t == name || t.rsplit_once('.').is_some_and(|(object, _)| object == name))
    };
    objects.iter().filter(|o| is_named(&o.name)).map(|o| o.name.clone()).collect()
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
    known: Known<'_>,
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
    let name = known.names.present_name(name);
    let object = known.objects.iter().find(|o| o.name == name).ok_or_else(|| known.unknown(name, &given))?;
    let value = value.trim();
    if key == "class" && table.class(value).is_none() {
        let classes: Vec<&str> = table.classes().collect();
        return Err(InputError::new(
            format!("the material class `{value}` does not exist"),
            given,
            format!("use one of: {}", classes.join(", ")),
        ));
    }
    if key == "mass_kg" && object.volume_m3 <= 0.0 {
        return Err(InputError::new(format!("`{name}` is fixed and has no mass"), given, "leave it out"));
    }
    overrides.set(name, key, value)?;
    if let Some(values) = overrides.object.get_mut(name) {
        values.label = known.names.label(name);
    }
    Ok(())
}

/// Resets `OBJECT` or `OBJECT.KEY`.
fn take_back(overrides: &mut Overrides, text: &str, known: Known<'_>) -> Result<(), InputError> {
    let given = format!("--unset {text}");
    // Values of an object that no longer exists can be reset.
    let object = |name: &str| {
        let present = known.names.present_name(name).to_owned();
        [name.to_owned(), present].into_iter().find(|n| overrides.object.contains_key(n) || known.has(n))
    };
    let (name, key) = match (object(text), text.rsplit_once('.')) {
        (Some(name), _) => (name, None),
        (None, Some((name, key))) => (object(name).ok_or_else(|| known.unknown(name, &given))?, Some(key)),
        (None, None) => return Err(known.unknown(text, &given)),
    };
    if overrides.unset(&name, key)? {
        return Ok(());
    }
    let what = key.map_or_else(|| "nothing is".to_owned(), |key| format!("{key} is not"));
    Err(InputError::new(
        format!("{what} set for `{name}`"),
        given,
        "`sms materials RUN` lists all values; set ones have the source `user`",
    ))
}

/// Returns the names of edits that are of no use now and later. The scene lacks some objects of the masks, such as pieces
/// that were joined to others, but edits of those may be of use again.
fn unused(edits: &Overrides, used: &Overrides, names: &ObjectNames) -> Vec<String> {
    let known = names.known().unwrap_or_default();
    let is_unused = |name: &&String| !used.object.contains_key(*name) && !known.contains(&name.as_str());
    edits.object.keys().filter(is_unused).cloned().collect()
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

/// Returns the indices of the objects with another material in the scene; `objects` have the scene's names.
fn changed(scene_dir: &Path, objects: &[ObjectQuery], materials: &[Material]) -> Result<Vec<usize>, Error> {
    let scene = load_scene(scene_dir)?;
    let differs = |object: &ObjectQuery, material: &Material| {
        scene.bodies.iter().find(|b| b.name == object.name).is_some_and(|b| b.material != *material)
    };
    let pairs = objects.iter().zip(materials).enumerate();
    Ok(pairs.filter(|(_, (o, m))| differs(o, m)).map(|(i, _)| i).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Context;
    use crate::object_names::fixture::run_with_masks;

    #[test]
    fn only_values_of_objects_that_are_gone_are_unused() {
        let dir = tempfile::tempdir().unwrap();
        drop(run_with_masks(dir.path(), &["mug", "duck"]));
        let mut edits = Overrides::default();
        for name in ["mug", "duck", "teapot"] {
            edits.set(name, "class", "steel").unwrap();
        }
        edits.save(&dir.path().join(EDITS)).unwrap();
        // Without a scene, nothing says which values are of no use.
        let context = Context::default();
        let found = Run::new(dir.path(), &context).materials(&[], &["duck".to_owned()]).unwrap();
        assert_eq!((found.unused, found.objects), (Vec::new(), Vec::new()));
        let kept = Overrides::read(&found.edits).unwrap();
        assert_eq!(kept.object.keys().collect::<Vec<_>>(), ["mug", "teapot"]);

        // The scene has only the mug; the duck is an object of the masks.
        let mut used = edits.clone();
        used.object.retain(|name, _| name == "mug");
        let names = ObjectNames::of(&RunFolder::open_to_read(dir.path()).unwrap()).unwrap();
        assert_eq!(unused(&edits, &used, &names), ["teapot"]);
        assert_eq!(unused(&edits, &used, &ObjectNames::default()), ["duck", "teapot"]);
    }

    #[test]
    fn only_edited_objects_are_shown() {
        let objects =
            ["mug", "mug.2", "floor"].map(|name| ObjectQuery { name: name.into(), ..Default::default() });
        let of = |edits: &[&str]| {
            let edits: Vec<String> = edits.iter().map(|e| (*e).to_owned()).collect();
            edited(&objects, edits.iter())
        };
        assert_eq!(of(&["mug.friction=0.4,0.3,0.5"]), ["mug"]);
        assert_eq!(of(&["mug.2.density = 1.5", "floor"]), ["mug.2", "floor"]);
        assert_eq!(of(&[]), [""; 0]);
    }

    #[test]
    fn edits_name_what_is_wrong_and_change_nothing_then() {
        let table = MaterialTable::builtin();
        let objects = [
            ObjectQuery { name: "object_01".into(), volume_m3: 1e-3, ..Default::default() },
            ObjectQuery { name: "floor".into(), ..Default::default() },
        ];
        let names = ObjectNames::default();
        let known = Known { objects: &objects, names: &names };
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
            let message = edit(&mut overrides, text, known, &table).unwrap_err().to_string();
            assert!(words.iter().all(|w| message.contains(w)), "{message}");
        }
        assert!(overrides.object.is_empty());
        edit(&mut overrides, "object_01.friction=0.4,0.3,0.5", known, &table).unwrap();
        edit(&mut overrides, "object_01.class = steel", known, &table).unwrap();
        let message = take_back(&mut overrides, "object_01.density", known).unwrap_err().to_string();
        assert!(message.contains("density is not set"), "{message}");
        assert!(take_back(&mut overrides, "object_7", known).unwrap_err().to_string().contains("object_01"));
        take_back(&mut overrides, "object_01.friction", known).unwrap();
        assert_eq!(overrides.object["object_01"].class.as_deref(), Some("steel"));
        take_back(&mut overrides, "object_01", known).unwrap();
        assert!(overrides.object.is_empty());
    }
}
