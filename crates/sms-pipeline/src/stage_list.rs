//! The stages of a run in the order of the data flow, and the commands that make them.

use crate::command_options::{recorded_options, recorded_setting, recorded_task};
use serde::de::DeserializeOwned;
use sms_core::{RunFolder, shell_argument};
use std::path::Path;

/// The stages in the order of the data flow, with the metrics that each writes.
pub(crate) const STAGES: [(&str, &[&str]); 8] = [
    ("frames", &["check.", "poses."]),
    ("masks", &["masks."]),
    ("gaussians", &["scan."]),
    ("entities", &["entities.", "materialize."]),
    ("scene", &["scene."]),
    ("plan", &["plan."]),
    ("target", &["execute."]),
    // Depends only on the plan, like `target`.
    ("robot", &["robot."]),
];

/// Checks without a folder, with the stage that they check.
pub(crate) const CHECKS: [(&str, &str); 2] = [("evaluate", "scene"), ("simulate", "scene")];

/// Returns the prefixes of the metrics of a stage.
pub(crate) fn prefixes(stage: &str) -> &'static [&'static str] {
    STAGES.iter().find(|s| s.0 == stage).map_or(&[], |s| s.1)
}

/// Returns the command that makes a stage of this run, with the earlier options and the earlier task.
pub(crate) fn command_of(run: &RunFolder, stage: &str) -> String {
    let root = shell_argument(run.root());
    let repeated = |command: &str| recorded_options(run, command);
    match stage {
        "frames" | "masks" | "gaussians" => scan_command(run),
        "plan" => {
            let kept = run.root().join("plan").join("task.toml");
            let recorded = scan_option::<String>(run, "recording").map(|r| Path::new(&r).join("task.toml"));
            let asked = recorded_task(run);
            let file = Some(kept).into_iter().chain(asked).chain(recorded).find(|f| f.is_file());
            let file = file.map_or_else(|| "TASK.toml".to_owned(), |f| shell_argument(&f));
            format!("sms plan {root} --task {file}{}", repeated("plan"))
        }
        "target" => format!("sms execute {root}{}", repeated("execute")),
        "robot" => format!("sms robot {root}"),
        _ => format!("sms materialize {root}{}", repeated("materialize")),
    }
}

fn scan_command(run: &RunFolder) -> String {
    let recording = scan_option::<String>(run, "recording")
        .map_or("RECORDING".to_owned(), |r| shell_argument(Path::new(&r)));
    let mut command = format!("sms scan {recording} --out {}", shell_argument(run.root()));
    for (key, usual) in [("preset", "standard"), ("masks", "geometry")] {
        if let Some(value) = scan_option::<String>(run, key).filter(|v| v != usual) {
            command += &format!(" --{key} {value}");
        }
    }
    for key in ["holdout", "seed"] {
        // A seed beyond the integers of TOML is text.
        let number =
            scan_option::<u64>(run, key).map(|n| n.to_string()).or_else(|| scan_option::<String>(run, key));
        if let Some(value) = number.filter(|v| v != "0") {
            command += &format!(" --{key} {value}");
        }
    }
    command + &recorded_options(run, "scan")
}

/// Returns an option of the scan from `run.toml`; `None` if it is absent or of another type.
pub(crate) fn scan_option<T: DeserializeOwned>(run: &RunFolder, key: &str) -> Option<T> {
    recorded_setting(run, "run", key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command_options::record_task;

    #[test]
    fn commands_repeat_the_options_of_the_run() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("my run");
        let run = RunFolder::create(&root).unwrap();
        let settings = serde_json::json!({"recording": "/data/desk", "preset": "draft", "masks": "geometry",
            "holdout": 8, "seed": u64::MAX});
        run.record_settings("run", &settings).unwrap();
        let options =
            serde_json::json!({"scan": ["--up", "0,0,1"], "materialize": ["--materials", "my file.toml"]});
        std::fs::write(root.join("commands.json"), options.to_string()).unwrap();
        let quoted = format!("'{}'", root.display());
        let scan = format!(
            "sms scan /data/desk --out {quoted} --preset draft --holdout 8 --seed {} --up 0,0,1",
            u64::MAX
        );
        assert_eq!(command_of(&run, "gaussians"), scan);
        assert_eq!(command_of(&run, "plan"), format!("sms plan {quoted} --task TASK.toml"));
        // A task that was refused has no plan.
        let refused = dir.path().join("refused.toml");
        std::fs::write(&refused, "").unwrap();
        record_task(&run, &refused).unwrap();
        assert_eq!(command_of(&run, "plan"), format!("sms plan {quoted} --task {}", refused.display()));
        std::fs::create_dir(root.join("plan")).unwrap();
        std::fs::write(root.join("plan/task.toml"), "").unwrap();
        let task = root.join("plan/task.toml");
        assert_eq!(command_of(&run, "plan"), format!("sms plan {quoted} --task '{}'", task.display()));
        assert_eq!(command_of(&run, "scene"), format!("sms materialize {quoted} --materials 'my file.toml'"));
    }
}
