//! Renames the objects of a run.

use super::Run;
use crate::Error;
use crate::object_names::{EDITS, ObjectNames, follow};
use sms_core::InputError;
use sms_masks::{LabelRow, load_label_rows, rename_labels};
use sms_materials::Overrides;

impl Run<'_> {
    /// Renames objects, all at once: each pair has the present and the new name. The user's material values follow
    /// their objects. A scene has the new names after [`Run::materialize`]. Returns all objects of the masks, with those
    /// that are merged into others; without renames, writes nothing.
    ///
    /// # Errors
    /// [`Error::Input`] if there are no masks, or naming the pair that is wrong: an unknown object, a name that cannot be
    /// used or that two objects would have. Nothing is renamed then.
    pub fn rename(&self, renames: &[(String, String)]) -> Result<Vec<LabelRow>, Error> {
        let run = if renames.is_empty() { self.open_to_read()? } else { self.open()? };
        let masks = run.root().join("masks");
        if !masks.join("labels.json").is_file() {
            let cure = "run `sms scan RECORDING --out RUN` first: it finds the objects";
            return Err(InputError::new("this run has no objects yet", &masks, cure).into());
        }
        if renames.is_empty() {
            return Ok(load_label_rows(&masks)?);
        }
        // The labels of the edits are written before the names change: they identify the objects afterwards.
        let edits = run.root().join(EDITS);
        let labelled = follow(Overrides::read_optional(&edits)?, &ObjectNames::of(&run)?).overrides;
        let has_edits = !labelled.object.is_empty();
        if has_edits {
            labelled.save(&edits)?;
        }
        rename_labels(&masks, renames)?;
        if has_edits {
            follow(labelled, &ObjectNames::of(&run)?).overrides.save(&edits)?;
        }
        Ok(load_label_rows(&masks)?)
    }
}
