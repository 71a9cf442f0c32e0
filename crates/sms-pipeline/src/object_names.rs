//! The names of a run's objects by label, and the user's material values that follow them through renames.

use crate::Error;
use serde::{Deserialize, Serialize};
use sms_core::{Hash, RunFolder, atomic};
use sms_masks::load_label_rows;
use sms_materials::Overrides;
use std::collections::BTreeMap;
use std::path::Path;

/// File of the user's edits in the run's folder, in the format of `sms materialize --materials FILE`.
pub(crate) const EDITS: &str = "materials.toml";
/// File of the labels by name in the scene's folder: names may change in `masks/labels.json` before the scene does.
const NAMES: &str = "names.json";
/// Bodies of a scene that are no objects of the masks.
pub(crate) const FIXED: [&str; 2] = ["environment", "floor"];

/// Content of the file of the labels by name. A file of an earlier version has other keys and names no labels.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
struct SceneNames {
    /// Hash of the inputs of the masks with these labels.
    masks: Option<Hash>,
    labels: BTreeMap<String, u16>,
}

/// The names of a run's objects by label.
#[derive(Debug, Clone, Default)]
pub(crate) struct ObjectNames {
    /// Label and name of each object of `masks/labels.json`, without those merged into others; `None` without masks.
    present: Option<Vec<(u16, String)>>,
    /// Labels by the names in the scene.
    in_scene: BTreeMap<String, u16>,
}

impl ObjectNames {
    /// Reads the names.
    ///
    /// # Errors
    /// [`Error::Core`] if `masks/labels.json` is wrong.
    pub(crate) fn of(run: &RunFolder) -> Result<Self, Error> {
        let masks = run.root().join("masks");
        let present = if masks.join("labels.json").is_file() {
            let kept = load_label_rows(&masks)?.into_iter().filter(|o| o.merge_into.is_none());
            Some(kept.map(|o| (o.id, o.name)).collect())
        } else {
            None
        };
        let file = run.root().join("scene").join(NAMES);
        let of_scene = if file.is_file() { atomic::read_json(&file)? } else { SceneNames::default() };
        // Masks that were made again may have given the labels to other objects.
        let is_current = of_scene.masks == run.stage_hash("masks");
        let in_scene = if is_current { of_scene.labels } else { BTreeMap::new() };
        Ok(Self { present, in_scene })
    }

    /// Returns the label of an object by its present name, or else by its name in the scene.
    pub(crate) fn label(&self, name: &str) -> Option<u16> {
        let present = self.present.iter().flatten().find(|o| o.1 == name).map(|o| o.0);
        present.or_else(|| self.in_scene.get(name).copied())
    }

    /// Returns the present name of an object by its label.
    fn name(&self, label: u16) -> Option<&str> {
        self.present.iter().flatten().find(|o| o.0 == label).map(|o| o.1.as_str())
    }

    /// Returns the present name of an object that the scene calls `name`.
    pub(crate) fn present_name_of_scene<'a>(&'a self, name: &'a str) -> &'a str {
        self.in_scene.get(name).and_then(|label| self.name(*label)).unwrap_or(name)
    }

    /// Returns the present name of an object that the user calls `name`, which may be its name in the scene.
    pub(crate) fn present_name<'a>(&'a self, name: &'a str) -> &'a str {
        self.label(name).and_then(|label| self.name(label)).unwrap_or(name)
    }

    /// Returns the names that material values may have; `None` without masks.
    pub(crate) fn known(&self) -> Option<Vec<&str>> {
        let objects = self.present.as_ref()?.iter().map(|o| o.1.as_str());
        Some(objects.chain(FIXED).collect())
    }
}

/// Writes the labels by name into the folder of a new scene.
///
/// # Errors
/// [`Error::Core`] if the file cannot be written.
pub(crate) fn write_names<'a>(
    run: &RunFolder,
    scene_dir: &Path,
    objects: impl Iterator<Item = (&'a str, u16)>,
) -> Result<(), Error> {
    let labels = objects.map(|(name, label)| (name.to_owned(), label)).collect();
    let names = SceneNames { masks: run.stage_hash("masks"), labels };
    Ok(atomic::write_json(&scene_dir.join(NAMES), &names)?)
}

/// Result of [`follow`].
#[derive(Debug, Clone)]
pub(crate) struct Followed {
    /// The values under the present names, with labels. Those of lost objects keep their names.
    pub(crate) overrides: Overrides,
    /// Names of the objects that no longer exist.
    pub(crate) lost: Vec<String>,
}

/// Moves each object's values to its present name. The label in the file identifies the object; without it, the name
/// does. Values already under the present name take precedence.
pub(crate) fn follow(edits: Overrides, names: &ObjectNames) -> Followed {
    let mut lost = Vec::new();
    if names.present.is_none() {
        return Followed { overrides: edits, lost };
    }
    let (mut here, mut moved) = (edits.clone(), edits.clone());
    here.object.clear();
    moved.object.clear();
    for (name, values) in &edits.object {
        let mut values = values.clone();
        let by_name = names.label(name);
        // A copied table has the label of another one; the original has the object's name.
        let original =
            |label: u16| names.name(label).is_some_and(|now| now != name && has_label(&edits, now, label));
        let label = values.label.filter(|label| by_name.is_none() || !original(*label)).or(by_name);
        let Some(now) = label.and_then(|label| names.name(label)) else {
            if !FIXED.contains(&name.as_str()) {
                lost.push(name.clone());
            }
            here.object.insert(name.clone(), values);
            continue;
        };
        values.label = label;
        if now == name {
            here.object.insert(name.clone(), values);
        } else {
            let mut one = edits.clone();
            one.object = BTreeMap::from([(now.to_owned(), values)]);
            moved = moved.under(one);
        }
    }
    Followed { overrides: moved.under(here), lost }
}

/// Returns whether two sets of values differ in a name or a value. Labels do not count: they are derived from the names,
/// and are no reason to rewrite a file that a user wrote.
pub(crate) fn differ(a: &Overrides, b: &Overrides) -> bool {
    let unlabelled = |edits: &Overrides| {
        let mut objects = edits.object.clone();
        objects.values_mut().for_each(|values| values.label = None);
        objects
    };
    unlabelled(a) != unlabelled(b)
}

fn has_label(edits: &Overrides, name: &str, label: u16) -> bool {
    edits.object.get(name).is_some_and(|o| o.label == Some(label))
}

#[cfg(test)]
pub(crate) mod fixture {
    use sms_core::{LabelInfo, Labels, MaskSource, RunFolder};
    use std::path::Path;

    /// Makes a run that has no result but masks without frames, of objects with these names and the labels 1, 2, ….
    pub(crate) fn run_with_masks(dir: &Path, names: &[&str]) -> RunFolder {
        let run = RunFolder::create(dir).unwrap();
        run.record_settings("test", &serde_json::json!({})).unwrap();
        let info =
            |(id, name): (u16, &&str)| LabelInfo { id, name: (*name).to_owned(), description: String::new() };
        let objects = (1u16..).zip(names).map(info).collect();
        let labels = Labels { maps: Vec::new(), objects, source: MaskSource::Geometry };
        sms_masks::save_labels(&dir.join("masks"), &labels).unwrap();
        run
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_an_earlier_version_names_no_labels() {
        let read: SceneNames = serde_json::from_str(r#"{"duck": 3, "cup": 4}"#).unwrap();
        assert!(read.masks.is_none() && read.labels.is_empty());
        assert!(serde_json::from_str::<SceneNames>(r#"{"labels": "#).is_err(), "a damaged file is an error");
    }

    #[test]
    fn labels_are_no_difference_but_names_and_values_are() {
        let plain = edits(&[("mug", None, "steel")]);
        assert!(!differ(&plain, &edits(&[("mug", Some(3), "steel")])));
        assert!(differ(&plain, &edits(&[("mug", None, "ceramic")])));
        assert!(differ(&plain, &edits(&[("cup", None, "steel")])));
    }

    fn names(present: &[(u16, &str)], in_scene: &[(&str, u16)]) -> ObjectNames {
        ObjectNames {
            present: Some(present.iter().map(|(id, name)| (*id, (*name).to_owned())).collect()),
            in_scene: in_scene.iter().map(|(name, id)| ((*name).to_owned(), *id)).collect(),
        }
    }

    fn edits(objects: &[(&str, Option<u16>, &str)]) -> Overrides {
        let mut edits = Overrides::default();
        for (name, label, class) in objects {
            edits.set(name, "class", class).unwrap();
            edits.object.get_mut(*name).unwrap().label = *label;
        }
        edits
    }

    /// Name, label and class of each object.
    fn listed(followed: &Followed) -> Vec<(&str, Option<u16>, &str)> {
        let objects = followed.overrides.object.iter();
        objects.map(|(name, o)| (name.as_str(), o.label, o.class.as_deref().unwrap())).collect()
    }

    #[test]
    fn values_follow_the_label_and_without_one_the_name_in_the_scene() {
        let now = names(&[(3, "duck"), (4, "cup")], &[("object_03", 3), ("object_04", 4)]);
        let given =
            edits(&[("object_03", Some(3), "rubber"), ("object_04", None, "steel"), ("floor", None, "cork")]);
        let followed = follow(given, &now);
        let expected = [("cup", Some(4), "steel"), ("duck", Some(3), "rubber"), ("floor", None, "cork")];
        assert_eq!(listed(&followed), expected);
        assert!(followed.lost.is_empty());
        // The same again changes nothing.
        assert_eq!(listed(&follow(followed.overrides.clone(), &now)), expected);
    }

    #[test]
    fn exchanged_names_exchange_the_values() {
        let now = names(&[(1, "b"), (2, "a")], &[("a", 1), ("b", 2)]);
        let followed = follow(edits(&[("a", Some(1), "rubber"), ("b", Some(2), "steel")]), &now);
        assert_eq!(listed(&followed), [("a", Some(2), "steel"), ("b", Some(1), "rubber")]);
    }

    #[test]
    fn objects_that_are_gone_are_lost_and_copied_tables_keep_their_name() {
        let now = names(&[(1, "duck"), (2, "cup")], &[]);
        let followed = follow(edits(&[("bowl", Some(9), "steel"), ("pan", None, "steel")]), &now);
        assert_eq!(followed.lost, ["bowl", "pan"]);
        let followed = follow(edits(&[("cup", Some(1), "cork"), ("duck", Some(1), "rubber")]), &now);
        assert_eq!(listed(&followed), [("cup", Some(2), "cork"), ("duck", Some(1), "rubber")]);
        // Without masks, there is nothing to follow.
        let followed = follow(edits(&[("bowl", Some(9), "steel")]), &ObjectNames::default());
        assert!(followed.lost.is_empty() && followed.overrides.object.contains_key("bowl"));
    }
}
