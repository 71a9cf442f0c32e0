//! The command `sms`: from a posed RGB-D recording to a simulated scene, a plan, an execution and a report.
//!
//! One file per command: each calls [`sms_pipeline`] and prints the outcome. Exit codes: 0 done, 2 bad input, 130
//! interrupted (run the same command again to resume), 1 any other failure or a fault found by `sms check`.

mod cli;
mod commands;
mod help;
mod live;
mod repeat;

use clap::FromArgMatches;
use cli::{Arguments, Command};
use sms_cli::front::{Console, failure};
use std::process::ExitCode;

fn main() -> ExitCode {
    let program = help::command();
    let matches = program.clone().get_matches();
    let options = repeat::options(&program, &matches);
    let parsed = Arguments::from_arg_matches(&matches);
    let mut arguments = parsed.unwrap_or_else(|error| error.exit());
    if let Command::Materials(a) = &mut arguments.command {
        // The `--set` of this command sets values of objects, not settings.
        a.set = std::mem::take(&mut arguments.common.assignments);
    }
    let is_flow = matches!(arguments.command, Command::Demo(_) | Command::Run(_));
    let mut console = match Console::new(&arguments.common, is_flow) {
        Ok(console) => console,
        Err(error) => return failure::report::<sms_pipeline::Error>(&error),
    };
    console.context.options = options;
    match run(&console, arguments.command) {
        Ok(code) => code,
        Err(error) => failure::report::<sms_pipeline::Error>(&error),
    }
}

fn run(console: &Console, command: Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Check(a) => return commands::check::run(console, &a),
        Command::Run(a) => commands::run::run(console, &a),
        Command::Status(a) => commands::status::run(console, &a),
        Command::Name(a) => commands::name::run(console, &a),
        Command::Scan(a) => commands::scan::run(console, &a),
        Command::Materialize(a) => commands::materialize::run(console, &a),
        Command::Materials(a) => commands::materials::run(console, &a),
        Command::Simulate(a) => commands::simulate::run(console, &a),
        Command::Plan(a) => commands::plan::run(console, &a),
        Command::Robot(a) => commands::robot::run(console, &a),
        Command::Execute(a) => commands::execute::run(console, &a),
        Command::Evaluate(a) => commands::evaluate::run(console, &a),
        Command::Report(a) => commands::report::run(console, &a).map(drop),
        Command::Export(a) => commands::export::run(console, &a),
        Command::View(a) => commands::view::run(console, &a),
        Command::Demo(a) => commands::demo::run(console, &a),
        Command::Sample(a) => commands::sample::run(console, &a),
        Command::Synth(a) => commands::synth::run(console, &a),
        Command::Devices => commands::devices::run(console),
        Command::Masks(a) => commands::masks::run(console, &a),
        Command::Models(a) => commands::models::run(console, &a),
        Command::Settings(a) => commands::settings::run(console, &a),
        Command::Manual(a) => commands::manual::run(console, &a),
    }
    .map(|()| ExitCode::SUCCESS)
}
