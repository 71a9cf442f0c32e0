//! The command `sms`: from a posed RGB-D recording to a simulated scene, a plan, an execution and a report.
//!
//! One file per command; each only wires stages together. Exit codes: 0 done, 2 bad input, 130
//! interrupted (run the same command again to resume), 1 any other failure, and `sms check` found a fault.

mod bars;
mod cli;
mod commands;
mod context;
mod device;
mod failure;
mod live;
mod picture;
mod settings;

use clap::Parser;
use cli::{Arguments, Command};
use context::Context;
use std::process::ExitCode;

fn main() -> ExitCode {
    let mut arguments = Arguments::parse();
    if let Command::Materials(a) = &mut arguments.command {
        // This command's `--set` is about objects, not about settings.
        a.set = std::mem::take(&mut arguments.common.assignments);
    }
    let context = match Context::new(&arguments.common, matches!(arguments.command, Command::Demo(_))) {
        Ok(context) => context,
        Err(error) => return failure::report(&error),
    };
    match run(&context, arguments.command) {
        Ok(code) => code,
        Err(error) => failure::report(&error),
    }
}

fn run(context: &Context, command: Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Check(a) => return commands::check::run(context, &a),
        Command::Scan(a) => commands::scan::run(context, &a).map(drop),
        Command::Materialize(a) => commands::materialize::run(context, &a),
        Command::Materials(a) => commands::materials::run(context, &a),
        Command::Simulate(a) => commands::simulate::run(context, &a),
        Command::Plan(a) => commands::plan::run(context, &a),
        Command::Robot(a) => commands::robot::run(context, &a),
        Command::Execute(a) => commands::execute::run(context, &a),
        Command::Evaluate(a) => commands::evaluate::run(context, &a),
        Command::Report(a) => commands::report::run(context, &a).map(drop),
        Command::Export(a) => commands::export::run(context, &a),
        Command::View(a) => commands::view::run(context, &a),
        Command::Demo(a) => commands::demo::run(context, &a),
        Command::Sample(a) => commands::sample::run(context, &a),
        Command::Synth(a) => commands::synth::run(context, &a),
        Command::Devices => commands::devices::run(context),
        Command::Bench(a) => commands::bench::run(context, &a),
        Command::Masks(a) => commands::masks::run(context, &a),
        Command::Models(a) => commands::models::run(context, &a),
        Command::Settings(a) => commands::settings::run(context, &a),
    }
    .map(|()| ExitCode::SUCCESS)
}
