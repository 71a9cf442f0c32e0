//! Arguments common to all commands.

use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Arguments common to all commands.
#[derive(Debug, Args)]
#[command(next_help_heading = "Global options")]
pub struct Common {
    /// Print only the flat metrics object, as JSON.
    #[arg(long, global = true)]
    pub json: bool,
    /// Number of worker threads (default: all cores).
    ///
    /// It does not affect results.
    #[arg(long, global = true, value_name = "N")]
    pub threads: Option<usize>,
    /// Repeat stages even if nothing has changed.
    #[arg(long, global = true)]
    pub force: bool,
    /// TOML file with settings of any stage.
    ///
    /// `sms settings` prints all of them. The file takes precedence over `sms.toml` in the working folder, which is read
    /// always.
    #[arg(long, global = true, value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// One setting of any stage (repeatable), over those of files.
    ///
    /// For example --set scan.final_steps=500.
    #[arg(long = "set", global = true, value_name = "SECTION.KEY=VALUE")]
    pub assignments: Vec<String>,
    /// Show no progress (same as --progress none).
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Form of the progress on standard error.
    ///
    /// By default a bar on a terminal, else plain; none with --json.
    #[arg(long, global = true, value_enum, value_name = "HOW", conflicts_with = "quiet")]
    pub progress: Option<ProgressKind>,
}

/// Form of the progress on standard error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ProgressKind {
    /// A bar with step, losses and time left.
    Bar,
    /// One line every few seconds.
    Plain,
    /// One JSON object per line: event, part, done, units, seconds, seconds_left, and figures of the part.
    Json,
    /// No progress.
    None,
}
