//! The origin of a stage's result: the state of its inputs when it was made. A result is stale if an input has another
//! state now; its files stay in place until their successor is complete.
//!
//! `<stage>/origin.json` has a hash of the stage's files and the state of each input. Staleness is computed from it and
//! never stored, so that it cannot be out of date: a result is current again when its inputs are.

use crate::Error;
use crate::object_names::{EDITS, ObjectNames, follow};
use crate::stage_list::{STAGES, command_of};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, Hash, Hasher, InputError, RunFolder, STAGE_RECORD, atomic, hash_serializable};
use sms_landing::LANDING_PLAN_FILE;
use sms_masks::load_label_rows;
use sms_materials::Overrides;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// File of the origin, in the stage's folder.
pub(crate) const ORIGIN: &str = "origin.json";

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Origin {
    /// Hash of the files of the stage.
    content: Hash,
    /// State of each input, by [`Input::key`].
    made_from: BTreeMap<String, Hash>,
}

/// An input of a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Input {
    /// The result of another stage.
    Stage(&'static str),
    /// `merge_into` in `masks/labels.json`.
    Merges,
    /// Names and descriptions in `masks/labels.json`.
    Names,
    /// The user's values in `materials.toml`.
    Materials,
}

/// Returns the inputs of a stage besides settings.
fn inputs(stage: &str) -> &'static [Input] {
    use Input::{Materials, Merges, Names, Stage};
    match stage {
        "masks" => &[Stage("frames")],
        "gaussians" => &[Stage("frames"), Stage("masks"), Merges],
        "entities" => &[Stage("gaussians"), Names],
        "scene" => &[Stage("entities"), Materials],
        "plan" => &[Stage("scene")],
        "target" | "robot" => &[Stage("plan"), Stage("scene")],
        _ => &[],
    }
}

/// Returns the files of a stage that a user may edit; a later stage reads them as they are.
fn editable(stage: &str) -> &'static [&'static str] {
    match stage {
        "scene" => &["scene.json"],
        "plan" => &["plan.json", LANDING_PLAN_FILE],
        _ => &[],
    }
}

impl Input {
    fn key(self) -> &'static str {
        match self {
            Self::Stage(name) => name,
            Self::Merges => "merges",
            Self::Names => "names",
            Self::Materials => "materials",
        }
    }

    /// Returns the present state; `None` if the input is missing or cannot be read.
    fn state(self, run: &RunFolder) -> Option<Hash> {
        let rows = || load_label_rows(&run.root().join("masks")).ok();
        match self {
            Self::Stage(name) => stage_state(run, name),
            Self::Merges => {
                let rows = rows()?;
                let id_of = |name: &String| rows.iter().find(|o| o.name == *name).map(|o| o.id);
                let merges: Vec<_> =
                    rows.iter().map(|o| (o.id, o.merge_into.as_ref().and_then(id_of))).collect();
                Some(hash_serializable(&merges))
            }
            Self::Names => {
                // With the rows of merged objects: a merge is no new name.
                let names: Vec<_> = rows()?.into_iter().map(|o| (o.id, o.name, o.description)).collect();
                Some(hash_serializable(&names))
            }
            Self::Materials => {
                let edits = Overrides::read_optional(&run.root().join(EDITS)).ok()?;
                let followed = follow(edits, &ObjectNames::of(run).ok()?);
                // Other names are no other values.
                let mut values: Vec<_> = followed.overrides.object.into_iter().collect();
                for (name, values) in &mut values {
                    *name = values.label.take().map_or_else(|| name.clone(), |label| label.to_string());
                }
                values.sort_by(|a, b| a.0.cmp(&b.0));
                Some(hash_serializable(&values))
            }
        }
    }
}

/// The reasons why a result is stale.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Staleness {
    /// Inputs with another result now: later stages must not use the result.
    pub(crate) replaced: Vec<String>,
    /// The user's edits that are not applied yet: the result fits its inputs, but not the edits.
    pub(crate) edited: Vec<String>,
}

impl Staleness {
    /// Returns whether the result is current.
    pub(crate) fn is_empty(&self) -> bool {
        self.replaced.is_empty() && self.edited.is_empty()
    }

    /// Returns all reasons.
    pub(crate) fn reasons(&self) -> Vec<String> {
        [&self.replaced[..], &self.edited[..]].concat()
    }
}

/// Returns the staleness of every complete stage, in the order of the data flow.
pub(crate) fn staleness(run: &RunFolder) -> Vec<(&'static str, Staleness)> {
    let mut found: Vec<(&'static str, Staleness)> = Vec::new();
    for (name, _) in STAGES {
        let dir = run.root().join(name);
        if run.stage_hash(name).is_none() {
            continue;
        }
        let made_from = read(&dir).map(|o| o.made_from).unwrap_or_default();
        let mut own = Staleness::default();
        for input in inputs(name) {
            // An earlier version recorded no origin. Such a result is current until an input is made again.
            let is_changed =
                made_from.get(input.key()).is_some_and(|state| input.state(run).as_ref() != Some(state));
            let Input::Stage(stage) = *input else {
                if is_changed {
                    own.edited.push(edited_text(*input).to_owned());
                }
                continue;
            };
            if is_changed {
                let is_missing = run.stage_hash(stage).is_none();
                let reason = if is_missing {
                    format!("`{stage}` is missing")
                } else {
                    format!("`{stage}` has another result now")
                };
                if !own.replaced.contains(&reason) {
                    own.replaced.push(reason);
                }
                continue;
            }
            let Some((_, upstream)) = found.iter().find(|f| f.0 == stage) else { continue };
            for (reasons, of) in
                [(&mut own.replaced, &upstream.replaced), (&mut own.edited, &upstream.edited)]
            {
                let new: Vec<String> = of.iter().filter(|r| !reasons.contains(r)).cloned().collect();
                reasons.extend(new);
            }
        }
        found.push((name, own));
    }
    found
}

fn edited_text(input: Input) -> &'static str {
    match input {
        Input::Merges => "objects were merged or separated in masks/labels.json",
        Input::Names => "names or descriptions in masks/labels.json have changed",
        _ => "materials.toml has changed",
    }
}

/// Returns the staleness of one stage; nothing is stale if the stage is absent.
pub(crate) fn staleness_of(run: &RunFolder, stage: &str) -> Staleness {
    staleness(run).into_iter().find(|s| s.0 == stage).map(|s| s.1).unwrap_or_default()
}

/// Returns the folder of a complete stage whose inputs still have the results that it was made from.
///
/// # Errors
/// [`Error::Input`] if the stage is absent or stale, with the command to run first.
pub(crate) fn current_dir(run: &RunFolder, stage: &str, made_by: &str) -> Result<PathBuf, Error> {
    let dir = run.stage_dir(stage, made_by)?;
    let all = staleness(run);
    let Some((_, stale)) = all.iter().find(|s| s.0 == stage && !s.1.replaced.is_empty()) else {
        return Ok(dir);
    };
    // A stage can only be made again when those before it are current.
    let first = all.iter().find(|s| needs(stage, s.0) && !s.1.replaced.is_empty()).map_or(stage, |s| s.0);
    let what = format!("the result `{stage}` of this run is stale: {}", stale.replaced.join("; "));
    let cure = format!("run `{}` first", command_of(run, first));
    Err(InputError::new(what, dir, cure).into())
}

/// Returns whether `stage` is `other` or is made from it.
fn needs(stage: &str, other: &str) -> bool {
    stage == other || inputs(stage).iter().any(|i| matches!(i, Input::Stage(name) if needs(name, other)))
}

/// Returns the state of a stage's result: a hash of its files, of those that a user may edit as they are now. `None` if
/// the stage is absent.
pub(crate) fn stage_state(run: &RunFolder, stage: &str) -> Option<Hash> {
    let made = run.stage_hash(stage)?;
    let dir = run.root().join(stage);
    let content = read(&dir).map_or(made, |o| o.content);
    let files: Vec<PathBuf> = editable(stage).iter().map(|f| dir.join(f)).filter(|f| f.is_file()).collect();
    if files.is_empty() {
        return Some(content);
    }
    let mut hasher = Hasher::new();
    hasher.text(&content.0);
    for file in files {
        hasher.file(&file).ok()?;
    }
    Some(hasher.finish())
}

/// Returns whether a user has edited a file of a stage since it was made; an earlier version, which recorded no origin,
/// counts as not edited.
pub(crate) fn is_edited(run: &RunFolder, stage: &str) -> bool {
    let dir = run.root().join(stage);
    let Some(origin) = read(&dir).filter(|_| !editable(stage).is_empty()) else { return false };
    content_hash(&dir).is_ok_and(|content| content != origin.content)
}

/// Inputs of a stage that is about to be made.
pub(crate) struct Sources(BTreeMap<String, Hash>);

impl Sources {
    /// Takes the present states of the inputs: a user may edit files while the stage is made.
    pub(crate) fn of(run: &RunFolder, stage: &str) -> Self {
        let states = inputs(stage).iter().filter_map(|i| Some((i.key().to_owned(), i.state(run)?)));
        Self(states.collect())
    }

    /// Writes the origin of complete work into its folder, before it becomes the stage's result.
    ///
    /// # Errors
    /// [`CoreError::Read`] or [`CoreError::Write`].
    pub(crate) fn write(self, work: &Path) -> Result<(), CoreError> {
        let origin = Origin { content: content_hash(work)?, made_from: self.0 };
        atomic::write_json(&work.join(ORIGIN), &origin)
    }

    /// Records these inputs for a result that is up to date: they may have been made again with another content that
    /// does not matter to it.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub(crate) fn confirm(self, run: &RunFolder, stage: &str) -> Result<(), CoreError> {
        let dir = run.root().join(stage);
        let before = read(&dir);
        let Some(content) = before.as_ref().map(|o| o.content.clone()).or_else(|| run.stage_hash(stage))
        else {
            return Ok(());
        };
        let origin = Origin { content, made_from: self.0 };
        if before.as_ref() == Some(&origin) {
            return Ok(());
        }
        atomic::write_json(&dir.join(ORIGIN), &origin)
    }
}

/// Records the present inputs of every later result without an origin, which an earlier version made: it becomes stale
/// with the successor of `stage`.
///
/// # Errors
/// [`CoreError::Write`].
pub(crate) fn keep_later_origins(run: &RunFolder, stage: &str) -> Result<(), CoreError> {
    for (later, _) in STAGES {
        let dir = run.root().join(later);
        if later != stage && needs(later, stage) && run.stage_hash(later).is_some() && read(&dir).is_none() {
            Sources::of(run, later).confirm(run, later)?;
        }
    }
    Ok(())
}

/// The states of everything that a report page shows, by name: the results, the user's edits, and the figures and
/// warnings, which checks without a result change, too.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(crate) struct PageSources(BTreeMap<String, Hash>);

impl PageSources {
    /// Takes the present states, before the page's contents are read: what changes afterwards may be missing in it.
    pub(crate) fn of(run: &RunFolder) -> Self {
        let stages = STAGES.iter().map(|(name, _)| Input::Stage(name));
        let inputs = stages.chain([Input::Merges, Input::Names, Input::Materials]);
        let states = inputs.filter_map(|input| Some((input.key().to_owned(), input.state(run)?)));
        let files = [("metrics", run.metrics_path()), ("warnings", run.warnings_path())];
        let contents =
            files.into_iter().filter_map(|(name, path)| Some((name.to_owned(), file_hash(&path)?)));
        Self(states.chain(contents).collect())
    }

    /// Records them in the page's folder.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub(crate) fn write(&self, page_dir: &Path) -> Result<(), CoreError> {
        atomic::write_json(&page_dir.join(ORIGIN), self)
    }
}

/// Returns whether the report page shows the present results; `None` if there is no page, or its origin is not known.
pub(crate) fn is_page_current(run: &RunFolder) -> Option<bool> {
    let shown: PageSources = atomic::read_json(&run.root().join("report").join(ORIGIN)).ok()?;
    Some(shown == PageSources::of(run))
}

/// Returns the hash of a file's content; `None` if it cannot be read.
fn file_hash(path: &Path) -> Option<Hash> {
    let mut hasher = Hasher::new();
    hasher.file(path).ok()?;
    Some(hasher.finish())
}

fn read(dir: &Path) -> Option<Origin> {
    atomic::read_json(&dir.join(ORIGIN)).ok()
}

/// Hashes the names and contents of all files of a stage.
fn content_hash(dir: &Path) -> Result<Hash, CoreError> {
    let mut files = Vec::new();
    list(dir, &mut files)?;
    files.sort();
    let mut hasher = Hasher::new();
    for file in files {
        let name = file.strip_prefix(dir).unwrap_or(&file);
        if name == Path::new(STAGE_RECORD) || name == Path::new(ORIGIN) {
            continue;
        }
        hasher.text(&name.to_string_lossy()).file(&file)?;
    }
    Ok(hasher.finish())
}

fn list(dir: &Path, files: &mut Vec<PathBuf>) -> Result<(), CoreError> {
    for entry in std::fs::read_dir(dir).map_err(CoreError::read(dir))? {
        let path = entry.map_err(CoreError::read(dir))?.path();
        if path.is_dir() {
            list(&path, files)?;
        } else {
            files.push(path);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object_names::fixture::run_with_masks;

    #[test]
    fn a_page_is_stale_after_checks_and_edits_until_they_are_undone() {
        let dir = tempfile::tempdir().unwrap();
        let run = run_with_masks(dir.path(), &["mug"]);
        std::fs::write(run.metrics_path(), "{}").unwrap();
        assert_eq!(is_page_current(&run), None);
        PageSources::of(&run).write(&dir.path().join("report")).unwrap();
        assert_eq!(is_page_current(&run), Some(true));
        let labels = dir.path().join("masks/labels.json");
        let renamed =
            std::fs::read_to_string(&labels).unwrap().replace("\"name\": \"mug\"", "\"name\": \"cup\"");
        for (file, text) in [
            (run.metrics_path(), "{\"simulate.drift_m\": 0.001}"),
            (run.warnings_path(), "[]"),
            (dir.path().join(EDITS), "[object.mug]\nclass = \"steel\"\n"),
            (labels, renamed.as_str()),
        ] {
            let before = std::fs::read(&file).ok();
            std::fs::write(&file, text).unwrap();
            assert_eq!(is_page_current(&run), Some(false), "{}", file.display());
            match before {
                Some(bytes) => std::fs::write(&file, bytes).unwrap(),
                None => std::fs::remove_file(&file).unwrap(),
            }
            assert_eq!(is_page_current(&run), Some(true), "{}", file.display());
        }
    }
}
