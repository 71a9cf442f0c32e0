//! The options of a run's commands, kept so that printed commands repeat them.

use crate::{Context, Error};
use serde::de::DeserializeOwned;
use sms_core::{RunFolder, atomic, shell_word};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// File of the options by command, in the run's folder.
const FILE: &str = "commands.json";

type Options = BTreeMap<String, Vec<String>>;

/// Records the options of a command of this run. A program that calls the library has none, and changes nothing.
///
/// # Errors
/// [`Error::Core`] if the file cannot be written.
pub(crate) fn record_options(context: &Context, run: &RunFolder, command: &str) -> Result<(), Error> {
    let Some(given) = context.options.get(command) else { return Ok(()) };
    let before = read(run);
    let mut all = before.clone();
    if given.is_empty() {
        all.remove(command);
    } else {
        all.insert(command.to_owned(), given.clone());
    }
    if all != before {
        atomic::write_json(&run.root().join(FILE), &all)?;
    }
    Ok(())
}

/// Records the task file of the last plan that was asked for.
///
/// # Errors
/// [`Error::Core`] if the file cannot be written.
pub(crate) fn record_task(run: &RunFolder, file: &Path) -> Result<(), Error> {
    let file = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    Ok(run.record_settings("task", &BTreeMap::from([("file", file)]))?)
}

/// Returns the task file of the last plan that was asked for.
pub(crate) fn recorded_task(run: &RunFolder) -> Option<PathBuf> {
    recorded_setting(run, "task", "file")
}

/// Returns a setting from `run.toml`; `None` if it is absent or of another type.
pub(crate) fn recorded_setting<T: DeserializeOwned>(run: &RunFolder, section: &str, key: &str) -> Option<T> {
    let table: toml::Table = atomic::read_toml(&run.root().join("run.toml")).ok()?;
    table.get(section)?.get(key)?.clone().try_into().ok()
}

/// Returns the recorded options of a command as arguments for a shell, each after a space.
pub(crate) fn recorded_options(run: &RunFolder, command: &str) -> String {
    let options = read(run).remove(command).unwrap_or_default();
    options.iter().map(|option| format!(" {}", shell_word(option))).collect()
}

/// A damaged file costs no more than the options of printed commands.
fn read(run: &RunFolder) -> Options {
    atomic::read_json(&run.root().join(FILE)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_options_of_each_command_are_kept() {
        let dir = tempfile::tempdir().unwrap();
        let run = RunFolder::create(dir.path()).unwrap();
        let with = |command: &str, options: &[&str]| Context {
            options: BTreeMap::from([(
                command.to_owned(),
                options.iter().map(|o| (*o).to_owned()).collect(),
            )]),
            ..Context::default()
        };
        record_options(&with("scan", &["--up", "0,0,1"]), &run, "scan").unwrap();
        record_options(&with("materialize", &["--materials", "my file.toml"]), &run, "materialize").unwrap();
        // A library call has no options and keeps those of the user.
        record_options(&Context::default(), &run, "scan").unwrap();
        assert_eq!(recorded_options(&run, "scan"), " --up 0,0,1");
        assert_eq!(recorded_options(&run, "materialize"), " --materials 'my file.toml'");
        record_options(&with("scan", &[]), &run, "scan").unwrap();
        assert_eq!(
            (recorded_options(&run, "scan"), recorded_options(&run, "plan")),
            (String::new(), String::new())
        );
    }
}
