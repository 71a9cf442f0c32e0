//! The command `sms-experiments`: the paper's experiments and studies of the stages of `sms`.
//!
//! One file per command. Exit codes are those of `sms`.

mod cli;
mod commands;

use clap::Parser;
use cli::{Arguments, Command};
use sms_cli::front::{Console, failure};
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match Console::new(&arguments.common, false).and_then(|console| run(&console, &arguments.command)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => failure::report::<sms_experiments::BenchError>(&error),
    }
}

fn run(console: &Console, command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Scan(a) => commands::scan::run(console, a),
        Command::Materialize(a) => commands::materialize::run(console, a),
        Command::Masks(a) => commands::masks::run(console, a),
        Command::Physics(a) => commands::physics::run(console, a),
        Command::Score(a) => commands::score::run(console, a),
        Command::Optimisers(a) => commands::optimisers::run(console, a),
        Command::Robust(a) => commands::robust::run(console, a),
        Command::Engines(a) => commands::engines::run(console, a),
        Command::Plan(a) => commands::plan::run(console, a),
        Command::Scenes(a) => commands::scenes::run(console, a),
        Command::Billiards(a) => commands::billiards::run(console, a),
        Command::Landing(a) => commands::landing::run(console, a),
        Command::Merge(a) => commands::merge::run(console, a),
    }
}
