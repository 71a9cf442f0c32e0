//! Renames the objects of a run.

use super::Run;
use crate::Error;
use crate::object_names::{EDITS, ObjectNames, differ, follow};
use sms_core::{InputError, RunFolder};
use sms_masks::{LabelRow, Rename, check_renames, load_label_rows, rename_labels};
use sms_materials::Overrides;
use std::path::PathBuf;

impl Run<'_> {
    /// Renames objects, all at once. The user's material values follow their objects. A scene has the new names after
    /// [`Run::materialize`]. Returns all objects of the masks, with those that are merged into others; without renames,
    /// writes nothing.
    ///
    /// # Errors
    /// [`Error::Input`] if there are no masks, or naming the rename that is wrong: an unknown object, a name that cannot be
    /// used or that two objects would have. Nothing is renamed then.
    pub fn rename(&self, renames: &[Rename]) -> Result<Vec<LabelRow>, Error> {
        if renames.is_empty() {
            return Ok(load_label_rows(&masks_dir(&self.open_to_read()?)?)?);
        }
        rename_in(&self.open()?, renames)
    }
}

/// Returns the folder of the masks.
///
/// # Errors
/// [`Error::Input`] if there are none.
pub(super) fn masks_dir(run: &RunFolder) -> Result<PathBuf, Error> {
    let masks = run.root().join("masks");
    if masks.join("labels.json").is_file() {
        return Ok(masks);
    }
    let cure = "run `sms scan RECORDING --out RUN` first: it finds the objects";
    Err(InputError::new("this run has no objects yet", &masks, cure).into())
}

/// Renames objects as [`Run::rename`] does.
pub(super) fn rename_in(run: &RunFolder, renames: &[Rename]) -> Result<Vec<LabelRow>, Error> {
    let masks = masks_dir(run)?;
    let edits = run.root().join(EDITS);
    let read = Overrides::read_optional(&edits)?;
    let labelled = follow(read.clone(), &ObjectNames::of(run)?).overrides;
    check_renames(&masks, renames)?;
    // The file is rewritten only if values move, because its comments are lost then.
    let is_renamed = renames.iter().any(|r| labelled.object.contains_key(&r.from));
    let moves = is_renamed || differ(&read, &labelled);
    // The labels of the values are written before the names change: they identify the objects afterwards.
    if moves {
        labelled.save(&edits)?;
    }
    rename_labels(&masks, renames)?;
    if moves {
        follow(labelled, &ObjectNames::of(run)?).overrides.save(&edits)?;
    }
    Ok(load_label_rows(&masks)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Context;
    use crate::object_names::{fixture::run_with_masks, write_names};
    use sms_core::CoreError;
    use std::path::Path;

    const BY_HAND: &str = "# weighed on Monday\n[object.mug]\nmass_kg = 0.31\n";

    fn rename(dir: &Path, from: &str, to: &str) -> Result<Vec<LabelRow>, Error> {
        let context = Context::default();
        Run::new(dir, &context).rename(&[Rename::new(from, to)])
    }

    #[test]
    fn refused_names_change_no_file() {
        let dir = tempfile::tempdir().unwrap();
        drop(run_with_masks(dir.path(), &["mug", "duck"]));
        let edits = dir.path().join(EDITS);
        std::fs::write(&edits, BY_HAND).unwrap();
        let labels = std::fs::read(dir.path().join("masks/labels.json")).unwrap();
        let files = || {
            let entries = std::fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().file_name());
            entries.collect::<std::collections::BTreeSet<_>>()
        };
        let before = files();
        for (from, to) in [("teapot", "x"), ("mug", "duck"), ("mug", "a/b")] {
            assert!(matches!(rename(dir.path(), from, to), Err(Error::Core(CoreError::Input(_)))));
            assert_eq!(std::fs::read_to_string(&edits).unwrap(), BY_HAND);
            assert_eq!(std::fs::read(dir.path().join("masks/labels.json")).unwrap(), labels);
            assert_eq!(files(), before);
        }
    }

    #[test]
    fn a_file_by_hand_is_rewritten_only_if_its_values_move() {
        let dir = tempfile::tempdir().unwrap();
        drop(run_with_masks(dir.path(), &["mug", "duck"]));
        let edits = dir.path().join(EDITS);
        std::fs::write(&edits, BY_HAND).unwrap();
        rename(dir.path(), "duck", "goose").unwrap();
        assert_eq!(std::fs::read_to_string(&edits).unwrap(), BY_HAND);

        let rows = rename(dir.path(), "mug", "cup").unwrap();
        assert_eq!(rows.iter().map(|r| r.name.as_str()).collect::<Vec<_>>(), ["cup", "goose"]);
        let moved = Overrides::read(&edits).unwrap();
        let by_hand: Overrides = toml::from_str(BY_HAND).unwrap();
        assert_eq!(moved.object.keys().collect::<Vec<_>>(), ["cup"]);
        assert_eq!(moved.object["cup"].label, Some(1));
        assert_eq!(moved.object["cup"].mass_kg, by_hand.object["mug"].mass_kg);
    }

    /// The scene has the name of the table, and the object has got another one in labels.json since.
    #[test]
    fn a_table_with_the_name_in_the_scene_follows_a_rename_of_another_object() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_with_masks(dir.path(), &["mug", "duck"]);
        write_names(&run, &dir.path().join("scene"), [("object_01", 1)].into_iter()).unwrap();
        drop(run);
        let edits = dir.path().join(EDITS);
        std::fs::write(&edits, "[object.object_01]\nmass_kg = 0.31\n").unwrap();
        // The duck gets the name that the mug had: only the label tells them apart now.
        rename(dir.path(), "duck", "object_01").unwrap();
        let moved = Overrides::read(&edits).unwrap();
        assert_eq!(moved.object.keys().collect::<Vec<_>>(), ["mug"]);
        assert_eq!(moved.object["mug"].label, Some(1));
    }
}
