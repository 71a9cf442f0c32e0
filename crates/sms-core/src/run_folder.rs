//! The run folder: one sub-folder a stage, each either whole or not there.
//!
//! A stage works in `.<name>.partial/` (where it may keep checkpoints) and becomes `<name>/` by a rename once it is
//! complete. `<name>/stage.json` holds the hash of everything that went into it; a stage whose hash has not changed
//! is not run again, and a partial stage whose hash has not changed is resumed.

use crate::{CoreError, Hash, InputError, atomic, shell_argument};
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::path::{Path, PathBuf};

#[derive(Debug, Serialize, Deserialize)]
struct StageRecord {
    stage: String,
    inputs: Hash,
    program: String,
}

/// File in the folder of a complete stage: the hash of its inputs and the program that made it.
pub const STAGE_RECORD: &str = "stage.json";

/// A run on disk.
#[derive(Debug)]
pub struct RunFolder {
    root: PathBuf,
    lock: Option<File>,
}

/// Result of [`RunFolder::begin`].
#[derive(Debug)]
pub enum StageState {
    /// The stage is complete for these inputs; its folder.
    Done(PathBuf),
    /// The stage has to be run (or resumed).
    Todo(Stage),
}

/// A stage in progress.
#[derive(Debug)]
pub struct Stage {
    name: String,
    work: PathBuf,
    done: PathBuf,
}

impl RunFolder {
    /// Opens a run for writing, creates a missing folder, and locks it against a second writer.
    ///
    /// # Errors
    /// [`CoreError::Input`] when another process is writing to this run, or the path is a file.
    pub fn create(root: &Path) -> Result<Self, CoreError> {
        if root.is_file() {
            return Err(InputError::new("this is a file, not a folder", root, "name another folder").into());
        }
        fs::create_dir_all(root).map_err(CoreError::write(root))?;
        Self::open_locked(root)
    }

    /// Opens an existing run for writing.
    ///
    /// # Errors
    /// [`CoreError::Input`] when there is no such run, or another process is writing to it.
    pub fn open(root: &Path) -> Result<Self, CoreError> {
        must_be_run(root)?;
        Self::open_locked(root)
    }

    /// Opens an existing run for reading its complete stages, even while another process writes to it or the folder is
    /// read-only. Stages cannot be begun or recorded in it.
    ///
    /// # Errors
    /// [`CoreError::Input`] when there is no such run.
    pub fn open_to_read(root: &Path) -> Result<Self, CoreError> {
        must_be_run(root)?;
        Ok(Self { root: root.to_owned(), lock: None })
    }

    fn open_locked(root: &Path) -> Result<Self, CoreError> {
        let path = root.join(".lock");
        let file = File::create(&path).map_err(CoreError::write(&path))?;
        if file.try_lock().is_err() {
            return Err(InputError::new(
                "another sms process is writing to this run",
                root,
                "wait for it to end, or use another folder",
            )
            .into());
        }
        atomic::remove_leftovers(root);
        Ok(Self { root: root.to_owned(), lock: Some(file) })
    }

    /// Returns the run's folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns the folder of a complete stage.
    ///
    /// # Errors
    /// [`CoreError::Input`] naming the command to run first.
    pub fn stage_dir(&self, name: &str, made_by: &str) -> Result<PathBuf, CoreError> {
        let dir = self.root.join(name);
        if dir.join(STAGE_RECORD).is_file() {
            return Ok(dir);
        }
        Err(InputError::new(
            format!("this run has no `{name}` yet"),
            &self.root,
            format!("run `sms {made_by} {}` first", shell_argument(&self.root)),
        )
        .into())
    }

    /// Returns the hash of the inputs of a complete stage.
    pub fn stage_hash(&self, name: &str) -> Option<Hash> {
        read_record(&self.root.join(name)).map(|r| r.inputs)
    }

    /// Renames a stage to `<name>.earlier`, so that no later stage uses it, and returns that folder; `None` if the stage is
    /// absent. It replaces one that was set aside before. Partial work stays.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn set_aside(&self, name: &str) -> Result<Option<PathBuf>, CoreError> {
        debug_assert!(self.lock.is_some(), "a run that was opened to read");
        let (dir, aside) = (self.root.join(name), self.root.join(format!("{name}.earlier")));
        if !dir.join(STAGE_RECORD).is_file() {
            return Ok(None);
        }
        if aside.exists() {
            fs::remove_dir_all(&aside).map_err(CoreError::write(&aside))?;
        }
        fs::rename(&dir, &aside).map_err(CoreError::write(&dir))?;
        Ok(Some(aside))
    }

    /// Begins a stage with this hash of inputs and settings. With `force` it is run again from the start.
    ///
    /// # Errors
    /// [`CoreError::Write`] when the folder cannot be prepared.
    pub fn begin(&self, name: &str, inputs: &Hash, force: bool) -> Result<StageState, CoreError> {
        debug_assert!(self.lock.is_some(), "a run that was opened to read");
        let done = self.root.join(name);
        let work = self.root.join(format!(".{name}.partial"));
        let old = self.root.join(format!(".{name}.old"));
        // A kill between the two renames of `commit` leaves the old result under its hidden name.
        if old.exists() {
            if done.exists() {
                fs::remove_dir_all(&old).map_err(CoreError::write(&old))?;
            } else {
                fs::rename(&old, &done).map_err(CoreError::write(&done))?;
            }
        }
        let same =
            |dir: &Path| read_record(dir).is_some_and(|r| r.inputs == *inputs && r.program == program());
        if !force && same(&done) {
            return Ok(StageState::Done(done));
        }
        if !force && same(&work) {
            atomic::remove_leftovers(&work);
        } else {
            if work.exists() {
                fs::remove_dir_all(&work).map_err(CoreError::write(&work))?;
            }
            fs::create_dir_all(&work).map_err(CoreError::write(&work))?;
            let record =
                StageRecord { stage: name.to_owned(), inputs: inputs.clone(), program: program().to_owned() };
            atomic::write_json(&work.join(STAGE_RECORD), &record)?;
        }
        Ok(StageState::Todo(Stage { name: name.to_owned(), work, done }))
    }

    /// Records the settings of a stage in `run.toml`, under the stage's name; other stages are kept.
    ///
    /// # Errors
    /// When `run.toml` cannot be read or written.
    pub fn record_settings<T: Serialize>(&self, stage: &str, settings: &T) -> Result<(), CoreError> {
        let path = self.root.join("run.toml");
        let mut table: toml::Table =
            if path.exists() { atomic::read_toml(&path)? } else { toml::Table::new() };
        let value = serde_json::to_value(settings).map_err(|e| {
            InputError::new("these settings cannot be written", &path, "report this as a bug").because(e)
        })?;
        if let Some(value) = toml_value(&value) {
            table.insert(stage.to_owned(), value);
        }
        atomic::write_bytes(&path, table.to_string().as_bytes())
    }

    /// Returns the path of `metrics.json`.
    pub fn metrics_path(&self) -> PathBuf {
        self.root.join("metrics.json")
    }

    /// Returns the path of `warnings.json`.
    pub fn warnings_path(&self) -> PathBuf {
        self.root.join("warnings.json")
    }
}

impl Drop for RunFolder {
    fn drop(&mut self) {
        if let Some(file) = self.lock.take() {
            let _ = file.unlock();
        }
    }
}

impl Stage {
    /// Returns the folder to write into; it holds checkpoints if the stage is resumed.
    pub fn dir(&self) -> &Path {
        &self.work
    }

    /// Makes the work the stage's result; the earlier result is removed after the new one is in place.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn commit(self) -> Result<PathBuf, CoreError> {
        let old = self.done.with_file_name(format!(".{}.old", self.name));
        if self.done.exists() {
            fs::rename(&self.done, &old).map_err(CoreError::write(&self.done))?;
        }
        fs::rename(&self.work, &self.done).map_err(CoreError::write(&self.done))?;
        if old.exists() {
            fs::remove_dir_all(&old).map_err(CoreError::write(&old))?;
        }
        Ok(self.done)
    }
}

/// Converts a value to readable TOML: without nulls, with floats in their shortest form (0.1 instead of the
/// 0.10000000149011612 of `f32`), and with whole numbers beyond TOML's 2⁶³ as text. `None` for null.
pub fn toml_value(value: &serde_json::Value) -> Option<toml::Value> {
    use serde_json::Value;
    Some(match value {
        Value::Null => return None,
        Value::Bool(b) => toml::Value::Boolean(*b),
        Value::String(s) => toml::Value::String(s.clone()),
        Value::Array(items) => toml::Value::Array(items.iter().filter_map(toml_value).collect()),
        Value::Object(map) => toml::Value::Table(
            map.iter().filter_map(|(k, v)| toml_value(v).map(|v| (k.clone(), v))).collect(),
        ),
        Value::Number(n) => match (n.as_i64(), n.as_f64()) {
            (Some(i), _) => toml::Value::Integer(i),
            (None, Some(x)) if !n.is_u64() => toml::Value::Float(shortest(x)),
            _ => toml::Value::String(n.to_string()),
        },
    })
}

/// Returns the number with the fewest decimals that is the same `f32`, if `x` is one.
fn shortest(x: f64) -> f64 {
    let single = x as f32;
    if f64::from(single) == x { single.to_string().parse().unwrap_or(x) } else { x }
}

fn must_be_run(root: &Path) -> Result<(), InputError> {
    if root.join("run.toml").is_file() {
        return Ok(());
    }
    Err(InputError::new(
        "this folder does not hold a run",
        root,
        "give the folder that `sms scan … --out RUN` wrote (it holds run.toml)",
    ))
}

fn read_record(dir: &Path) -> Option<StageRecord> {
    atomic::read_json(&dir.join(STAGE_RECORD)).ok()
}

fn program() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash_serializable;

    fn todo(state: StageState) -> Stage {
        match state {
            StageState::Todo(stage) => stage,
            StageState::Done(dir) => panic!("{} is already done", dir.display()),
        }
    }

    #[test]
    fn a_stage_is_done_once_resumed_when_partial_and_redone_when_its_inputs_change() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::create(dir.path()).unwrap();
        let (a, b) = (hash_serializable(&1), hash_serializable(&2));
        let stage = todo(run.begin("scan", &a, false).unwrap());
        atomic::write_bytes(&stage.dir().join("checkpoint.bin"), b"half").unwrap();
        drop(stage);
        let stage = todo(run.begin("scan", &a, false).unwrap());
        assert!(stage.dir().join("checkpoint.bin").exists());
        stage.commit().unwrap();
        assert!(matches!(run.begin("scan", &a, false).unwrap(), StageState::Done(_)));
        let changed = todo(run.begin("scan", &b, false).unwrap());
        assert!(!changed.dir().join("checkpoint.bin").exists());
        assert!(
            run.stage_dir("scan", "scan").is_ok(),
            "the earlier result stays whole until the new one is done"
        );
        changed.commit().unwrap();
        assert_eq!(run.stage_hash("scan"), Some(b));
    }

    #[test]
    fn settings_read_as_people_write_them_and_large_seeds_are_kept() {
        #[derive(Serialize)]
        struct Settings {
            seed: u64,
            rate: f32,
            share: f64,
            none: Option<u8>,
        }
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::create(dir.path()).unwrap();
        run.record_settings("a", &Settings { seed: u64::MAX, rate: 3e-6, share: 0.1, none: None }).unwrap();
        run.record_settings("b", &Settings { seed: 7, rate: 0.5, share: 1e-9, none: Some(3) }).unwrap();
        let text = fs::read_to_string(dir.path().join("run.toml")).unwrap();
        let table: toml::Table = toml::from_str(&text).unwrap();
        assert_eq!(table["a"]["seed"].as_str(), Some("18446744073709551615"));
        assert_eq!((table["a"]["rate"].as_float(), table["a"]["share"].as_float()), (Some(3e-6), Some(0.1)));
        assert!(table["a"].get("none").is_none());
        assert_eq!((table["b"]["seed"].as_integer(), table["b"]["none"].as_integer()), (Some(7), Some(3)));
    }

    #[test]
    fn a_stage_that_is_set_aside_is_absent_and_its_files_are_kept() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::create(dir.path()).unwrap();
        for text in ["first", "second"] {
            let stage = todo(run.begin("plan", &hash_serializable(&text), false).unwrap());
            fs::write(stage.dir().join("plan.json"), text).unwrap();
            stage.commit().unwrap();
            let aside = run.set_aside("plan").unwrap().unwrap();
            assert_eq!(fs::read_to_string(aside.join("plan.json")).unwrap(), text);
            assert!(run.stage_dir("plan", "plan").is_err());
        }
        assert_eq!(run.set_aside("plan").unwrap(), None);
    }

    #[test]
    fn a_kill_between_the_renames_keeps_the_old_result() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::create(dir.path()).unwrap();
        let a = hash_serializable(&1);
        todo(run.begin("scan", &a, false).unwrap()).commit().unwrap();
        fs::rename(dir.path().join("scan"), dir.path().join(".scan.old")).unwrap();
        assert!(matches!(run.begin("scan", &a, false).unwrap(), StageState::Done(_)));
    }

    #[test]
    fn a_second_writer_is_refused_and_a_missing_run_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let _run = RunFolder::create(dir.path()).unwrap();
        assert!(matches!(RunFolder::create(dir.path()), Err(CoreError::Input(_))));
        std::fs::write(dir.path().join("run.toml"), "").unwrap();
        assert!(matches!(RunFolder::open(dir.path()), Err(CoreError::Input(_))));
        assert_eq!(RunFolder::open_to_read(dir.path()).unwrap().root(), dir.path());
        assert!(RunFolder::open_to_read(&dir.path().join("no")).is_err());
        assert!(matches!(RunFolder::open(&dir.path().join("no")), Err(CoreError::Input(_))));
    }
}
