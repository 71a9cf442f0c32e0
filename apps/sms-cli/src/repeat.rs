//! The options of this call that a repetition of each stage needs.

use clap::{Arg, ArgMatches, Command, parser::ValueSource};
use std::any::TypeId;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The commands whose options a run keeps.
const KEPT: [&str; 4] = ["scan", "materialize", "plan", "execute"];
/// The commands that make several stages.
const FLOWS: [&str; 2] = ["run", "demo"];
/// Options that do not change results, that every run records by itself, or that name its folders.
const LEFT_OUT: [&str; 15] = [
    "json",
    "threads",
    "force",
    "quiet",
    "progress",
    "help",
    "live",
    "follow",
    "out",
    "run",
    "recording",
    "task",
    "preset",
    "masks",
    "holdout",
];

/// Returns the options that the user gave, by the command that they belong to.
pub(crate) fn options(program: &Command, matches: &ArgMatches) -> BTreeMap<String, Vec<String>> {
    let Some((name, given)) = matches.subcommand() else { return BTreeMap::new() };
    let made = |stage: &&&str| **stage == name || FLOWS.contains(&name);
    KEPT.iter()
        .filter(made)
        .map(|stage| ((*stage).to_owned(), of_stage(program, stage, name, given)))
        .collect()
}

fn of_stage(program: &Command, stage: &str, name: &str, given: &ArgMatches) -> Vec<String> {
    let own = program.find_subcommand(stage).into_iter().flat_map(Command::get_arguments);
    let global = program.get_arguments().filter(|a| a.is_global_set());
    // The scan's seed is recorded with its settings; that of a whole flow is the scan's.
    let is_recorded = |a: &&Arg| {
        let id = a.get_id().as_str();
        LEFT_OUT.contains(&id) || (id == "seed" && (stage == "scan" || FLOWS.contains(&name)))
    };
    own.chain(global).filter(|a| !is_recorded(a)).flat_map(|a| of_argument(a, given)).collect()
}

/// Returns the occurrences of an option as arguments.
fn of_argument(argument: &Arg, given: &ArgMatches) -> Vec<String> {
    let id = argument.get_id().as_str();
    let (Some(long), Ok(true)) = (argument.get_long(), given.try_contains_id(id)) else { return Vec::new() };
    if given.value_source(id) != Some(ValueSource::CommandLine) {
        return Vec::new();
    }
    if !argument.get_action().takes_values() {
        return vec![format!("--{long}")];
    }
    let is_path = argument.get_value_parser().type_id() == TypeId::of::<PathBuf>();
    let occurrences = given.get_raw_occurrences(id).into_iter().flatten();
    occurrences
        .flat_map(|values| {
            let values: Vec<String> = values.map(|v| v.to_string_lossy().into_owned()).collect();
            let mut value = values.join(",");
            if is_path {
                // The command may be repeated from another folder.
                let absolute = std::path::absolute(Path::new(&value));
                value = absolute.map_or(value, |p| p.display().to_string());
            }
            if value.starts_with('-') {
                vec![format!("--{long}={value}")]
            } else {
                vec![format!("--{long}"), value]
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(line: &[&str]) -> BTreeMap<String, Vec<String>> {
        let program = crate::help::command();
        let matches = program.clone().try_get_matches_from(line).unwrap();
        options(&program, &matches)
    }

    #[test]
    fn options_that_change_a_stage_are_kept_for_it() {
        let scan = of(&[
            "sms",
            "scan",
            "rec",
            "--out",
            "run",
            "--preset",
            "draft",
            "--up",
            "-0.1,0,1",
            "--no-check",
            "--poses",
            "refine",
            "--set",
            "masks.max_object_m=0.7",
            "--set",
            "scan.final_steps=9",
            "--box",
            "mug=1,2,3,4",
            "--threads",
            "2",
            "--seed",
            "3",
        ]);
        let expected = [
            "--box",
            "mug=1,2,3,4",
            "--poses",
            "refine",
            "--up=-0.1,0,1",
            "--no-check",
            "--set",
            "masks.max_object_m=0.7",
            "--set",
            "scan.final_steps=9",
        ];
        assert_eq!(scan["scan"], expected);
        assert_eq!(scan.len(), 1);
        assert_eq!(of(&["sms", "plan", "run", "--task", "t.toml", "--seed", "4"])["plan"], ["--seed", "4"]);
        assert!(of(&["sms", "status", "run"]).is_empty());
    }

    #[test]
    fn a_flow_keeps_the_options_of_each_stage_and_whole_paths() {
        let run = of(&["sms", "run", "rec", "--materials", "my.toml", "--up", "0,0,1", "--seed", "3"]);
        let file = std::path::absolute("my.toml").unwrap().display().to_string();
        assert_eq!(run["materialize"], ["--materials".to_owned(), file]);
        assert_eq!(run["scan"], ["--up", "0,0,1"]);
        assert!(run["plan"].is_empty() && run["execute"].is_empty());
    }
}
