//! The front end that programs on top of the pipeline share: common arguments, start, printing and exit codes.
//!
//! ```no_run
//! use clap::Parser;
//! use sms_cli::front::{Common, Console, failure};
//! use std::process::ExitCode;
//!
//! #[derive(Parser)]
//! struct Arguments {
//!     #[command(flatten)]
//!     common: Common,
//! }
//!
//! fn main() -> ExitCode {
//!     match Console::new(&Arguments::parse().common, false) {
//!         Ok(console) => {
//!             console.say("ready");
//!             ExitCode::SUCCESS
//!         }
//!         Err(error) => failure::report::<sms_pipeline::Error>(&error),
//!     }
//! }
//! ```

mod arguments;
mod bars;
mod console;
pub mod failure;
mod values;
mod warning_text;

pub use arguments::{Common, ProgressKind};
pub use console::{Console, note};
pub use values::{EngineName, PathName, PosesName, PresetName, SensorName};
