//! The command `sms-experiments`: the paper's experiments and studies of the stages of `sms`.
//!
//! One file per command. Exit codes are those of `sms`.

mod cli;
mod commands;

use clap::Parser;
use cli::{Experiment, ExperimentArguments};
use sms_cli::front::{Console, failure};
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = ExperimentArguments::parse();
    match Console::new(&arguments.common, false).and_then(|console| run(&console, &arguments.command)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => failure::report::<sms_experiments::BenchError>(&error),
    }
}

fn run(console: &Console, command: &Experiment) -> anyhow::Result<()> {
    match command {
        Experiment::Scan(a) => commands::scan::run(console, a),
        Experiment::Materialize(a) => commands::materialize::run(console, a),
        Experiment::Masks(a) => commands::masks::run(console, a),
        Experiment::Physics(a) => commands::physics::run(console, a),
        Experiment::Score(a) => commands::score::run(console, a),
        Experiment::Optimisers(a) => commands::optimisers::run(console, a),
        Experiment::Tracking(a) => commands::tracking::run(console, a),
        Experiment::Room(a) => commands::room::run(console, a),
        Experiment::Orbits(a) => commands::orbits::run(console, a),
        Experiment::RealLike(a) => commands::real_like::run(console, a),
        Experiment::Robust(a) => commands::robust::run(console, a),
        Experiment::Engines(a) => commands::engines::run(console, a),
        Experiment::Plan(a) => commands::plan::run(console, a),
        Experiment::Scenes(a) => commands::scenes::run(console, a),
        Experiment::Billiards(a) => commands::billiards::run(console, a),
        Experiment::Landing(a) => commands::landing::run(console, a),
        Experiment::Merge(a) => commands::merge::run(console, a),
    }
}
