//! Names the objects of a run with a vision-language model.

use super::Run;
use super::names::{masks_dir, rename_in};
use super::recorded::RecordedFrames;
use crate::settings::vlm_defaults;
use crate::vlm::{REPLIES, client, refuse_given_up, summary};
use crate::{Context, Error};
use sms_core::{LabelInfo, RunFolder, Seed, Warning, Warnings};
use sms_masks::{LabelRow, Rename, check_renames, is_automatic, load_label_rows, unique};
use sms_vlm::{Cache, Client, ObjectName, ask_names, question_about_label, warn_not_named};

/// Result of [`Run::rename_and_ask`].
#[derive(Debug, Clone)]
pub struct NamedObjects {
    /// All objects of the masks, with those that are merged into others.
    pub objects: Vec<LabelRow>,
    /// The new names: those of the user, then those of the model.
    pub renames: Vec<Rename>,
    /// The reasons why other objects keep their names.
    pub warnings: Vec<Warning>,
}

impl Run<'_> {
    /// Renames objects as [`Run::rename`] does. Other objects with automatic names ([`is_automatic`]) get the name and the
    /// description that a vision-language model gives them; a description of the user stays. All names change at once, after
    /// the last reply. Replies are stored in the run.
    ///
    /// # Errors
    /// Those of [`Run::rename`]; [`Error::Input`] if no server is set or it cannot be used; [`Error::Core`] if interrupted.
    /// Nothing is renamed then.
    pub fn rename_and_ask(&self, renames: &[Rename]) -> Result<NamedObjects, Error> {
        let run = self.open()?;
        let masks = masks_dir(&run)?;
        check_renames(&masks, renames)?;
        let config = self.context.settings.section("vlm", vlm_defaults())?;
        let client = client(&config, Seed(0).derive("name"))?;
        let rows = load_label_rows(&masks)?;
        let is_asked = |name: &str| is_automatic(name) && !renames.iter().any(|r| r.from == name);
        let warnings = Warnings::new();
        let found = if rows.iter().any(|o| o.merge_into.is_none() && is_asked(&o.name)) {
            ask(self.context, &run, &client, is_asked, &warnings)?
        } else {
            self.context.message("no object has an automatic name: the model was not asked");
            Vec::new()
        };
        let mut renames = renames.to_vec();
        let renamed = |name: &str| renames.iter().find(|r| r.from == name).map(|r| r.to.clone());
        let mut taken: Vec<String> =
            rows.iter().map(|o| renamed(&o.name).unwrap_or_else(|| o.name.clone())).collect();
        for (object, ObjectName { name, description }) in found {
            let Some(name) = name else { continue };
            let to = unique(name, &taken);
            taken.push(to.clone());
            let is_described = !object.description.is_empty() || description.is_empty();
            let description = (!is_described).then_some(description);
            renames.push(Rename { from: object.name, to, description });
        }
        let objects = if renames.is_empty() { rows } else { rename_in(&run, &renames)? };
        Ok(NamedObjects { objects, renames, warnings: warnings.snapshot() })
    }
}

/// Asks about the objects for which `is_asked` is true. Returns those with an answer, ordered by label.
fn ask(
    context: &Context,
    run: &RunFolder,
    client: &Client,
    is_asked: impl Fn(&str) -> bool,
    warnings: &Warnings,
) -> Result<Vec<(LabelInfo, ObjectName)>, Error> {
    let RecordedFrames { sequence, labels } = &RecordedFrames::of(run)?;
    let mut objects = Vec::new();
    let mut questions = Vec::new();
    for object in labels.objects.iter().filter(|o| is_asked(&o.name)) {
        match question_about_label(object, sequence, labels, client.config()) {
            Some(question) => {
                objects.push(object.clone());
                questions.push(question);
            }
            None => {
                let why = format!("no view shows enough of {} to ask about it", object.name);
                warn_not_named(warnings, &object.name, &why);
            }
        }
    }
    let cache = Cache::new(&run.root().join(REPLIES));
    let answers = ask_names(&questions, client, &cache, context.stage(warnings, Seed(0)))?;
    refuse_given_up(&answers, client.config())?;
    context.message(summary(&answers, objects.len(), client.config()));
    let named = objects.into_iter().zip(answers.outcomes);
    Ok(named.filter_map(|(object, outcome)| Some((object, outcome.answer()?.clone()))).collect())
}
