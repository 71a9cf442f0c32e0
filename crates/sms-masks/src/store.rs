//! Labels in the run folder: `masks/000000.png …` and `labels.json`, which a user may edit.

use crate::MasksError;
use crate::names::is_usable;
use serde::{Deserialize, Serialize};
use sms_core::{
    BACKGROUND, InputError, LabelInfo, LabelMap, Labels, MaskSource, atomic, read_png_labels,
    write_png_gray16,
};
use std::collections::BTreeMap;
use std::path::Path;

/// Contents of `labels.json`. `name`, `description` and `merge_into` may be edited.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct LabelsFile {
    source: MaskSource,
    frames: usize,
    objects: Vec<LabelRow>,
}

/// One object of `labels.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelRow {
    /// Value in the label maps, at least 1. It stays the same when the object is renamed.
    pub id: u16,
    /// Name, unique in the scene, usable as a file name.
    pub name: String,
    /// Free text; may be empty.
    #[serde(default)]
    pub description: String,
    /// Name of the object that contains this one; the two are merged when labels are read.
    #[serde(default)]
    pub merge_into: Option<String>,
    /// Name that the source of the masks gave; not to be edited. `None` in a file of an earlier version.
    #[serde(default)]
    pub found_as: Option<String>,
}

impl LabelRow {
    /// Returns whether the user renamed or merged the object.
    pub fn is_edited(&self) -> bool {
        self.merge_into.is_some() || self.found_as.as_ref() != Some(&self.name)
    }
}

/// A new name of an object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rename {
    /// The present name.
    pub from: String,
    /// The new name.
    pub to: String,
    /// The new description; `None` keeps the present one.
    pub description: Option<String>,
}

impl Rename {
    /// A new name that keeps the description.
    pub fn new(from: impl Into<String>, to: impl Into<String>) -> Self {
        Self { from: from.into(), to: to.into(), description: None }
    }
}

/// Writes one 16-bit label PNG per frame (`000000.png`, …) and `labels.json` into `dir`.
///
/// # Errors
/// [`MasksError::Write`].
pub fn save_labels(dir: &Path, labels: &Labels) -> Result<(), MasksError> {
    let row = |o: &LabelInfo| {
        let LabelInfo { id, name, description } = o.clone();
        LabelRow { id, found_as: Some(name.clone()), name, description, merge_into: None }
    };
    save_rows(dir, &labels.maps, labels.source, labels.objects.iter().map(row).collect())
}

/// Does the same as [`save_labels`] with the rows of `labels.json`.
pub(crate) fn save_rows(
    dir: &Path,
    maps: &[LabelMap],
    source: MaskSource,
    objects: Vec<LabelRow>,
) -> Result<(), MasksError> {
    for (index, map) in maps.iter().enumerate() {
        write_png_gray16(&dir.join(format!("{index:06}.png")), map)?;
    }
    let file = LabelsFile { source, frames: maps.len(), objects };
    // The index is written last: a folder with `labels.json` is complete.
    atomic::write_json(&dir.join("labels.json"), &file)
}

/// Reads the files written by [`save_labels`], and applies the user's edits of `labels.json`: names and descriptions
/// are used as they are, an object with `"merge_into": "other"` becomes part of `other` (chains are followed) and its
/// id is no longer used.
///
/// # Errors
/// [`MasksError::Input`] naming the file if a name is not unique or unusable, a merge names an unknown object or is
/// cyclic, a mask is missing, has another size, or contains a value that `labels.json` does not list.
pub fn load_labels(dir: &Path) -> Result<Labels, MasksError> {
    let path = dir.join("labels.json");
    let file: LabelsFile = atomic::read_json(&path)?;
    let targets = check_and_merge(&file, &path)?;
    let maps = load_maps(dir, file.frames, &targets)?;
    let mut objects: Vec<LabelInfo> = file
        .objects
        .into_iter()
        .filter(|o| o.merge_into.is_none())
        .map(|o| LabelInfo { id: o.id, name: o.name, description: o.description })
        .collect();
    objects.sort_by_key(|o| o.id);
    Ok(Labels { maps, objects, source: file.source })
}

/// Reads the masks of these objects, without merging any.
///
/// # Errors
/// As [`load_labels`].
pub(crate) fn load_unmerged(dir: &Path, rows: &[LabelRow]) -> Result<Vec<LabelMap>, MasksError> {
    let file: LabelsFile = atomic::read_json(&dir.join("labels.json"))?;
    let own = rows.iter().map(|o| (o.id, o.id)).collect();
    load_maps(dir, file.frames, &own)
}

/// Reads the masks of all frames and replaces each label by its target.
fn load_maps(dir: &Path, frames: usize, targets: &BTreeMap<u16, u16>) -> Result<Vec<LabelMap>, MasksError> {
    // No preallocation: the edited file may contain any number.
    let mut maps = Vec::new();
    for index in 0..frames {
        let path = dir.join(format!("{index:06}.png"));
        let mut map = read_png_labels(&path)?;
        if maps.first().is_some_and(|first: &LabelMap| first.size() != map.size()) {
            return Err(InputError::new("this mask differs in size from the first", &path, CURE).into());
        }
        for value in map.data.iter_mut().filter(|v| **v != BACKGROUND) {
            *value = *targets.get(value).ok_or_else(|| {
                let what = format!("this mask contains the value {value}, which labels.json does not list");
                InputError::new(what, &path, CURE)
            })?;
        }
        maps.push(map);
    }
    Ok(maps)
}

/// Reads the objects of `labels.json`, also those that are merged into others, ordered by id. Reads no label maps.
///
/// # Errors
/// As [`load_labels`], without those of the label maps.
pub fn load_label_rows(dir: &Path) -> Result<Vec<LabelRow>, MasksError> {
    let path = dir.join("labels.json");
    let mut file: LabelsFile = atomic::read_json(&path)?;
    check_and_merge(&file, &path)?;
    file.objects.sort_by_key(|o| o.id);
    Ok(file.objects)
}

/// Renames objects in `labels.json`, all at once, so that two objects can exchange their names. Merges are kept, and
/// descriptions without a new one.
///
/// # Errors
/// [`MasksError::Input`] naming the assignment `PRESENT=NEW` that is wrong: an object that does not exist, a name that
/// cannot be used, or one that two objects would have. The file is unchanged then.
pub fn rename_labels(dir: &Path, renames: &[Rename]) -> Result<(), MasksError> {
    let path = dir.join("labels.json");
    atomic::write_json(&path, &renamed_file(&path, renames)?)
}

/// Checks whether [`rename_labels`] would accept these renames; writes nothing.
///
/// # Errors
/// As [`rename_labels`].
pub fn check_renames(dir: &Path, renames: &[Rename]) -> Result<(), MasksError> {
    renamed_file(&dir.join("labels.json"), renames).map(drop)
}

/// Returns the contents of `labels.json` with the new names and descriptions.
fn renamed_file(path: &Path, renames: &[Rename]) -> Result<LabelsFile, MasksError> {
    let mut file: LabelsFile = atomic::read_json(path)?;
    check_and_merge(&file, path)?;
    for (i, Rename { from, to, .. }) in renames.iter().enumerate() {
        let refuse = |what: String, cure: &str| -> Result<LabelsFile, MasksError> {
            Err(InputError::new(what, format!("{from}={to}"), cure).into())
        };
        if !file.objects.iter().any(|o| o.name == *from) {
            let known: Vec<&str> = file.objects.iter().map(|o| o.name.as_str()).collect();
            return refuse(
                format!("there is no object `{from}`"),
                &format!("name one of: {}", known.join(", ")),
            );
        }
        if renames[..i].iter().any(|earlier| earlier.from == *from) {
            return refuse(format!("`{from}` is given two names"), "give every object one name");
        }
        if !is_usable(to) {
            return refuse(format!("the name `{to}` cannot be used for an object"), NAMES);
        }
    }
    let rename_of = |name: &str| renames.iter().find(|r| r.from == name);
    let renamed = |name: &str| rename_of(name).map_or_else(|| name.to_owned(), |r| r.to.clone());
    for row in &mut file.objects {
        if let Some(description) = rename_of(&row.name).and_then(|r| r.description.as_ref()) {
            row.description.clone_from(description);
        }
        row.name = renamed(&row.name);
        row.merge_into = row.merge_into.as_deref().map(renamed);
    }
    for Rename { from, to, .. } in renames {
        if file.objects.iter().filter(|o| o.name == *to).count() > 1 {
            let what = format!("two objects would have the name `{to}`");
            let cure =
                "give every object its own name; to merge two objects, set `merge_into` in masks/labels.json";
            return Err(InputError::new(what, format!("{from}={to}"), cure).into());
        }
    }
    Ok(file)
}

/// The cure for a name that cannot be used.
const NAMES: &str = "use letters, digits, `_` and `-`, at most 64, and not floor, environment or world; free text belongs in \
                     `description`";
const CURE: &str = "restore the file, or make the masks again with `sms scan --force`";

/// Validates the rows and returns the final id of every id.
fn check_and_merge(file: &LabelsFile, path: &Path) -> Result<BTreeMap<u16, u16>, InputError> {
    let fault = |message: String, cure: &str| Err(InputError::new(message, path, cure));
    let mut by_name: BTreeMap<&str, &LabelRow> = BTreeMap::new();
    let mut by_id = BTreeMap::new();
    for row in &file.objects {
        if !is_usable(&row.name) {
            return fault(format!("the name `{}` cannot be used for an object", row.name), NAMES);
        }
        if by_name.insert(&row.name, row).is_some() {
            return fault(
                format!("the name `{}` is used twice", row.name),
                "give every object its own name; to merge two objects, set `merge_into`",
            );
        }
        if row.id == BACKGROUND || by_id.insert(row.id, row).is_some() {
            return fault(
                format!("the id {} is 0 or used twice", row.id),
                "ids must not be edited: restore them",
            );
        }
    }
    let mut targets = BTreeMap::new();
    for row in &file.objects {
        let mut end = row;
        // A chain without a cycle is shorter than the list.
        for step in 0.. {
            let Some(name) = &end.merge_into else { break };
            end = match by_name.get(name.as_str()) {
                Some(next) if step < file.objects.len() => next,
                Some(_) => {
                    return fault(
                        format!("`merge_into` of `{}` runs in a circle", row.name),
                        "one object of a merged group must have no `merge_into`",
                    );
                }
                None => {
                    let known: Vec<_> = by_name.keys().copied().collect();
                    return fault(
                        format!("`merge_into` of `{}` names `{name}`, which does not exist", end.name),
                        &format!("use one of: {}", known.join(", ")),
                    );
                }
            };
        }
        targets.insert(row.id, end.id);
    }
    Ok(targets)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Image;

    fn labels() -> Labels {
        let info = |id, name: &str| LabelInfo { id, name: name.into(), description: String::new() };
        Labels {
            maps: vec![Image::from_vec(3, 1, vec![0, 1, 2]), Image::from_vec(3, 1, vec![3, 300, 0])],
            objects: vec![info(1, "object_01"), info(2, "object_02"), info(3, "object_03"), info(300, "far")],
            source: MaskSource::Geometry,
        }
    }

    /// Saves labels, edits `labels.json` as text, and loads them.
    fn edited(edit: impl Fn(String) -> String) -> Result<Labels, MasksError> {
        let dir = tempfile::tempdir().unwrap();
        save_labels(dir.path(), &labels()).unwrap();
        let path = dir.path().join("labels.json");
        std::fs::write(&path, edit(std::fs::read_to_string(&path).unwrap())).unwrap();
        load_labels(dir.path())
    }

    fn merging(from: &str, into: &str) -> impl Fn(String) -> String {
        let (from, into) = (format!("\"name\": \"{from}\""), into.to_owned());
        move |text| {
            let at = text.find(&from).unwrap();
            let tail = text[at..].replacen("\"merge_into\": null", &format!("\"merge_into\": \"{into}\""), 1);
            format!("{}{tail}", &text[..at])
        }
    }

    #[test]
    fn labels_round_trip() {
        assert_eq!(edited(|t| t).unwrap(), labels());
    }

    #[test]
    fn a_user_may_rename_describe_and_merge() {
        let renamed = edited(|t| {
            let t = t.replacen("object_02", "mug", 1);
            t.replacen("\"description\": \"\"", "\"description\": \"a red ball\"", 1)
        })
        .unwrap();
        assert_eq!(renamed.objects[1].name, "mug");
        assert_eq!(renamed.objects[0].description, "a red ball");
        // A chain: 1 into 2, 2 into far.
        let merged = edited(|t| merging("object_02", "far")(merging("object_01", "object_02")(t))).unwrap();
        assert_eq!(merged.maps[0].data, [0, 300, 300]);
        assert_eq!(merged.maps[1].data, [3, 300, 0]);
        let names: Vec<_> = merged.objects.iter().map(|o| o.name.as_str()).collect();
        assert_eq!(names, ["object_03", "far"]);
    }

    #[test]
    fn names_are_exchanged_and_merges_follow_them() {
        let dir = tempfile::tempdir().unwrap();
        save_labels(dir.path(), &labels()).unwrap();
        let path = dir.path().join("labels.json");
        let merged = merging("object_01", "object_02")(std::fs::read_to_string(&path).unwrap());
        std::fs::write(&path, merged).unwrap();
        let pair = |from: &str, to: &str| Rename::new(from, to);
        let exchanged = [pair("object_02", "far"), pair("far", "object_02"), pair("object_03", "duck")];
        rename_labels(dir.path(), &exchanged).unwrap();
        let rows = load_label_rows(dir.path()).unwrap();
        let named: Vec<_> = rows.iter().map(|r| (r.id, r.name.as_str(), r.merge_into.as_deref())).collect();
        let expected =
            [(1, "object_01", Some("far")), (2, "far", None), (3, "duck", None), (300, "object_02", None)];
        assert_eq!(named, expected);
        let described =
            Rename { description: Some("yellow rubber duck".into()), ..Rename::new("duck", "duck") };
        rename_labels(dir.path(), &[described]).unwrap();
        rename_labels(dir.path(), &[pair("duck", "goose"), pair("far", "near")]).unwrap();
        let rows = load_label_rows(dir.path()).unwrap();
        let texts: Vec<_> = rows.iter().map(|r| (r.name.as_str(), r.description.as_str())).collect();
        assert_eq!(texts[1..3], [("near", ""), ("goose", "yellow rubber duck")], "descriptions stay");
        rename_labels(dir.path(), &[pair("goose", "duck"), pair("near", "far")]).unwrap();
        // A refused name changes nothing.
        let before = std::fs::read(&path).unwrap();
        for wrong in [
            &[pair("duck", "far")][..],
            &[pair("duck", "goose"), pair("object_01", "goose")],
            &[pair("duck", "a"), pair("duck", "b")],
            &[pair("duck", "floor")],
            &[pair("duck", "a/b")],
            &[pair("teapot", "cup")],
        ] {
            let error = rename_labels(dir.path(), wrong).unwrap_err();
            assert!(matches!(error, MasksError::Input(_)), "{error}");
            assert_eq!(std::fs::read(&path).unwrap(), before);
        }
        let unknown = rename_labels(dir.path(), &[pair("teapot", "cup")]).unwrap_err().to_string();
        assert!(unknown.contains("object_01, far, duck, object_02"), "{unknown}");
    }

    #[test]
    fn bad_edits_are_explained() {
        let fault = |edit: &dyn Fn(String) -> String| match edited(edit) {
            Err(MasksError::Input(e)) => e,
            other => panic!("{other:?}"),
        };
        let unknown = fault(&merging("object_01", "teapot"));
        let [name, known] = ["teapot", "far, object_01"];
        assert!(unknown.what.contains(name) && unknown.cure.contains(known), "{unknown}");
        fault(&|t| merging("object_02", "object_01")(merging("object_01", "object_02")(t)));
        fault(&merging("object_01", "object_01"));
        let edits = [
            ("object_02", "object_01", "labels.json"),
            ("object_02", "a/b", "labels.json"),
            ("\"id\": 2", "\"id\": 1", "labels.json"),
            ("\"id\": 3", "\"id\": 4", "000001.png"),
            ("\"name\"", "\"nane\"", "labels.json"),
            ("\"frames\": 2", "\"frames\": 3", "000002.png"),
        ];
        for (from, to, file) in edits {
            let error = fault(&|t| t.replacen(from, to, 1));
            assert!(error.path.ends_with(file), "{from} -> {to}: {error}");
        }
    }
}
