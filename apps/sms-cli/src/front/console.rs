//! Start of a program, and its output.

use super::arguments::{Common, ProgressKind};
use super::bars::Bars;
use crate::settings::Settings;
use anyhow::Context as _;
use sms_core::metrics::Metrics;
use sms_core::{Cancel, JsonProgress, NoProgress, PlainProgress, Progress, RunFolder, Warnings};
use std::io::{IsTerminal, Write};
use std::time::Duration;

/// Least time between two updates of `--progress json`.
const JSON_EVERY: Duration = Duration::from_millis(100);

/// Progress, interruption and settings of one invocation.
pub struct Context {
    /// Shows progress.
    pub progress: Box<dyn Progress>,
    /// Set by Ctrl-C.
    pub cancel: Cancel,
    /// Settings of all stages.
    pub settings: Settings,
    /// Redo stages even where nothing has changed.
    pub force: bool,
}

/// One invocation of a program: its context, and how it prints.
pub struct Console {
    /// Progress, interruption and settings.
    pub context: Context,
    /// Whether a command runs as a step of another (the demo), which prints the metrics itself.
    pub part_of_a_flow: bool,
    /// Print metrics as JSON and nothing else.
    pub json: bool,
}

impl Console {
    /// Starts the thread pool, listens for Ctrl-C and reads the settings.
    ///
    /// # Errors
    /// When threads or the handler cannot be started, and for wrong settings.
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
        let settings = Settings::read(common.settings.as_deref(), &common.assignments)?;
        let context = Context { progress, cancel, settings, force: common.force };
        Ok(Self { context, part_of_a_flow, json: common.json })
    }

    /// A line for people; nothing with `--json`.
    pub fn say(&self, line: impl std::fmt::Display) {
        if !self.json {
            // Whoever closed the pipe has read enough.
            let _ = writeln!(std::io::stdout(), "{line}");
        }
    }

    /// What a command was asked to print.
    pub fn print(&self, text: impl std::fmt::Display) {
        let _ = writeln!(std::io::stdout(), "{text}");
    }

    /// Merges metrics into the run's (keys that start with one of `prefixes` are replaced as a whole), saves the
    /// warnings as those of `stage`, and shows them.
    ///
    /// # Errors
    /// When a file cannot be read or written.
    pub fn finish(
        &self,
        run: &RunFolder,
        stage: &str,
        prefixes: &[&str],
        metrics: Metrics,
        warnings: &Warnings,
    ) -> anyhow::Result<()> {
        let path = run.metrics_path();
        let mut all = Metrics::load(&path)?;
        for prefix in prefixes {
            all.remove_prefix(prefix);
        }
        all.merge(metrics);
        all.save(&path)?;
        warnings.save_as(&run.warnings_path(), stage)?;
        self.tell(warnings);
        Ok(())
    }

    /// Shows warnings.
    pub fn tell(&self, warnings: &Warnings) {
        for w in warnings.snapshot() {
            let times = if w.count > 1 { format!(" ({} times)", w.count) } else { String::new() };
            eprintln!("warning: {}{times}{}{}", w.message, if w.cure.is_empty() { "" } else { "; " }, w.cure);
        }
    }

    /// With `--json`, prints all metrics of the run (once, at the end of a flow of several commands).
    ///
    /// # Errors
    /// When a file cannot be read or written.
    pub fn print_metrics(&self, run: &RunFolder) -> anyhow::Result<()> {
        if self.json && !self.part_of_a_flow {
            let all = Metrics::load(&run.metrics_path())?;
            self.print_json(&all)?;
        }
        Ok(())
    }

    /// Prints a metrics object as JSON.
    ///
    /// # Errors
    /// When a value has no form in JSON.
    pub fn print_json(&self, metrics: &Metrics) -> anyhow::Result<()> {
        let map: serde_json::Map<_, _> = metrics.iter().map(|(k, v)| (k.clone(), v.clone())).collect();
        let _ = writeln!(std::io::stdout(), "{}", serde_json::to_string_pretty(&map)?);
        Ok(())
    }
}

/// Peak resident memory of this process in bytes, where the system tells.
pub fn peak_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}
