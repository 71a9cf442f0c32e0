//! Start of a program, and its output.

use super::arguments::{Common, ProgressKind};
use super::bars::Bars;
use super::warning_text::{warning_line, warning_lines};
use anyhow::Context as _;
use sms_core::metrics::Metrics;
use sms_core::{Cancel, JsonProgress, NoProgress, PlainProgress, Progress, Warning};
use sms_pipeline::{Context, Event, EventSink, Run, Settings};
use std::io::{IsTerminal, Write};
use std::path::Path;
use std::time::Duration;

/// Smallest time between two updates of `--progress json`.
const JSON_EVERY: Duration = Duration::from_millis(100);

/// File of settings in the working folder, below those of `--settings`.
const OWN_SETTINGS: &str = "sms.toml";

/// Prints a line on standard error. A reader that has closed the pipe does not end the work.
pub fn note(line: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// One invocation of a program: its context and its output options.
pub struct Console {
    /// Progress, interruption and settings.
    pub context: Context,
    /// Whether a command runs as a step of another (the demo), which prints the metrics itself.
    pub part_of_a_flow: bool,
    /// Print metrics as JSON and nothing else.
    pub json: bool,
}

impl Console {
    /// Starts the thread pool, listens for Ctrl-C and reads the settings: `sms.toml` of the working folder, then the
    /// file and the values of the arguments.
    ///
    /// # Errors
    /// If threads or the handler cannot be started, or for invalid settings.
    pub fn new(common: &Common, part_of_a_flow: bool) -> anyhow::Result<Self> {
        if let Some(threads) = common.threads {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads.max(1))
                .build_global()
                .context("cannot start the worker threads")?;
        }
        let cancel = Cancel::new();
        let on_signal = cancel.clone();
        ctrlc::set_handler(move || {
            if on_signal.is_cancelled() {
                // The second Ctrl-C does not wait for the current unit of work.
                std::process::exit(130);
            }
            on_signal.cancel();
        })
        .context("cannot listen for Ctrl-C")?;
        let kind = match common.progress {
            Some(kind) => kind,
            None if common.quiet || common.json => ProgressKind::None,
            None if std::io::stderr().is_terminal() => ProgressKind::Bar,
            None => ProgressKind::Plain,
        };
        let progress: Box<dyn Progress> = match kind {
            ProgressKind::Bar => Box::new(Bars::default()),
            ProgressKind::Plain => Box::new(PlainProgress::default()),
            ProgressKind::Json => Box::new(JsonProgress::new(JSON_EVERY)),
            ProgressKind::None => Box::new(NoProgress),
        };
        let own = Some(Path::new(OWN_SETTINGS)).filter(|path| path.is_file());
        if own.is_some() && !matches!(kind, ProgressKind::None | ProgressKind::Json) {
            note(format_args!("settings of {OWN_SETTINGS} are used"));
        }
        let files: Vec<&Path> = own.into_iter().chain(common.settings.as_deref()).collect();
        let settings = Settings::read_layers(&files, &common.assignments)?;
        let events = Box::new(Printer { json: common.json, one_line: kind == ProgressKind::Json });
        let context =
            Context { progress, cancel, settings, force: common.force, events, ..Context::default() };
        Ok(Self { context, part_of_a_flow, json: common.json })
    }

    /// Prints a line for people; nothing with `--json`.
    pub fn say(&self, line: impl std::fmt::Display) {
        if !self.json {
            self.print(line);
        }
    }

    /// Prints the text that the user requested.
    pub fn print(&self, text: impl std::fmt::Display) {
        // Ignores a closed pipe.
        let _ = writeln!(std::io::stdout(), "{text}");
    }

    /// Prints a warning on standard error.
    pub fn warn(&self, warning: &Warning) {
        self.context.events.event(&Event::Warning(warning));
    }

    /// Ends a command of a run: prints the command to run next or, with `--json`, all metrics of the run. A step of a flow
    /// prints neither.
    ///
    /// # Errors
    /// If they cannot be read.
    pub fn conclude(&self, run: &Run<'_>) -> anyhow::Result<()> {
        self.end(run, None)
    }

    /// Ends the command `sms NAME` as [`Console::conclude`] does, without a proposal to run it again.
    ///
    /// # Errors
    /// As [`Console::conclude`].
    pub fn conclude_without(&self, run: &Run<'_>, name: &str) -> anyhow::Result<()> {
        self.end(run, Some(name))
    }

    fn end(&self, run: &Run<'_>, without: Option<&str>) -> anyhow::Result<()> {
        match self.part_of_a_flow {
            true => Ok(()),
            false if self.json => self.print_json(&run.metrics()?),
            false => self.say_next_without(run, without),
        }
    }

    /// Prints the command to run next.
    ///
    /// # Errors
    /// If the state of the run cannot be read.
    pub fn say_next(&self, run: &Run<'_>) -> anyhow::Result<()> {
        self.say_next_without(run, None)
    }

    fn say_next_without(&self, run: &Run<'_>, name: Option<&str>) -> anyhow::Result<()> {
        let again = name.map(|name| format!("sms {name} "));
        let is_other = |next: &&String| again.as_ref().is_none_or(|again| !next.starts_with(again));
        if let Some(next) = run.status()?.next.iter().find(is_other) {
            self.say(format!("next: {next}"));
        }
        Ok(())
    }

    /// Prints a metrics object as JSON.
    ///
    /// # Errors
    /// If a value cannot be represented in JSON.
    pub fn print_json(&self, metrics: &Metrics) -> anyhow::Result<()> {
        let map: serde_json::Map<_, _> = metrics.iter().map(|(k, v)| (k.clone(), v.clone())).collect();
        let _ = writeln!(std::io::stdout(), "{}", serde_json::to_string_pretty(&map)?);
        Ok(())
    }
}

/// Prints the pipeline's events: messages on standard output, warnings on standard error.
struct Printer {
    json: bool,
    /// Whether a warning is one line among the lines of JSON.
    one_line: bool,
}

impl EventSink for Printer {
    fn event(&self, event: &Event<'_>) {
        match event {
            Event::Message(text) if !self.json => drop(writeln!(std::io::stdout(), "{text}")),
            Event::Alert(text) if !self.json => note(format_args!("warning: {text}")),
            Event::Warning(w) => {
                note(if self.one_line { warning_line(w) } else { warning_lines(w) });
            }
            Event::Stage { name, is_cached: true } if !self.json => {
                drop(writeln!(std::io::stdout(), "{name}: up to date"));
            }
            Event::Message(_) | Event::Alert(_) | Event::Stage { .. } => {}
        }
    }
}
