//! The help: commands in groups, and each `--help` on one screen. `sms help COMMAND` has the full texts.

use crate::cli::Arguments;
use clap::{Arg, ArgAction, Command, CommandFactory};

/// The commands in groups.
const GROUPS: [(&str, &[&str]); 4] = [
    (
        "Pipeline",
        &[
            "run",
            "check",
            "scan",
            "materialize",
            "simulate",
            "plan",
            "execute",
            "evaluate",
            "report",
            "export",
        ],
    ),
    ("Inspect", &["status", "view", "name", "masks", "materials", "settings", "devices", "models"]),
    ("Robot", &["robot"]),
    ("Generate", &["demo", "sample", "synth"]),
];

/// The options of all commands, in few lines: the help of each command describes them.
const GLOBAL: &str = "\
Global options (described by `sms COMMAND --help`):
  --json  --threads N  --force  --settings FILE  --set SECTION.KEY=VALUE
  -q, --quiet  --progress bar|plain|json|none  -h, --help  -V, --version

`sms help COMMAND` describes every option and value in full.";

/// Returns the command line with its help texts.
pub(crate) fn command() -> Command {
    let help = Arg::new("help").short('h').long("help").action(ArgAction::HelpShort).global(true);
    let help = help.help("Print this help (`sms help COMMAND`: in full)").help_heading("Global options");
    let command = Arguments::command().disable_help_flag(true).arg(help);
    let template = format!("{{about}}\n\n{{usage-heading}} {{usage}}\n\n{}\n{GLOBAL}\n", groups(&command));
    command.help_template(template)
}

/// Returns the commands with their descriptions, in groups.
fn groups(command: &Command) -> String {
    let mut text = String::new();
    for (heading, names) in GROUPS {
        text += &format!("{heading}:\n");
        for name in names {
            let about = command.find_subcommand(name).and_then(Command::get_about);
            text += &format!("  {name:<12} {}\n", about.map(ToString::to_string).unwrap_or_default());
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_is_in_one_group() {
        let command = command();
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|group| group.1).copied().collect();
        let shown = command.get_subcommands().filter(|c| !c.is_hide_set());
        let mut known: Vec<&str> = shown.map(Command::get_name).collect();
        grouped.sort_unstable();
        known.sort_unstable();
        assert_eq!(grouped, known);
    }

    #[test]
    fn the_list_of_commands_names_every_global_option() {
        let mut command = command();
        let text = command.render_help().to_string();
        for option in command.get_arguments() {
            let long = option.get_long().unwrap();
            assert!(text.contains(&format!("--{long}")), "--{long}");
        }
    }
}
