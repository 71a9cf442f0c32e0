//! Arguments that every command has.

use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Arguments of every command.
#[derive(Debug, Args)]
pub struct Common {
    /// Print the flat metrics object alone, as JSON.
    #[arg(long, global = true)]
    pub json: bool,
    /// Worker threads (default: all cores). Results do not depend on it.
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<usize>,
    /// Redo stages even where nothing has changed.
    #[arg(long, global = true)]
    pub force: bool,
    /// A TOML file with settings of any stage; `run.toml` of a run shows all of them.
    #[arg(long, global = true, value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// One setting of any stage, over the file's: --set scan.final_steps=500 (repeatable; `sms settings` lists them).
    #[arg(long = "set", global = true, value_name = "SECTION.KEY=VALUE")]
    pub assignments: Vec<String>,
    /// Show no progress (the same as --progress none).
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// How progress is shown, on standard error. By default a bar on a terminal, else plain lines; none with --json.
    #[arg(long, global = true, value_enum, value_name = "HOW", conflicts_with = "quiet")]
    pub progress: Option<ProgressKind>,
}

/// Form of the progress on standard error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProgressKind {
    /// A bar with step, losses and time left.
    Bar,
    /// A line every few seconds.
    Plain,
    /// JSON objects, one a line: event, part, done, units, seconds, seconds_left, and the part's figures.
    Json,
    /// Nothing.
    None,
}
