//! The context of a pipeline: progress, cancellation, settings, and events for the user.

use crate::Settings;
use sms_core::{Cancel, NoProgress, Progress, Seed, StageContext, Warning, Warnings};
use std::collections::BTreeMap;

/// An event during a command of a [`Run`](crate::Run).
#[derive(Debug)]
pub enum Event<'a> {
    /// A stage was computed, or its earlier result is up to date.
    Stage {
        /// Name of the stage and of its folder.
        name: &'a str,
        /// Whether the earlier result was up to date.
        is_cached: bool,
    },
    /// A line about an intermediate result.
    Message(&'a str),
    /// A problem to report at once; a warning follows.
    Alert(&'a str),
    /// A warning that was saved with the run.
    Warning(&'a Warning),
}

/// Receives events; a program prints or shows them.
pub trait EventSink: Send + Sync {
    /// Receives one event.
    fn event(&self, event: &Event<'_>);
}

/// Ignores all events.
impl EventSink for () {
    fn event(&self, _: &Event<'_>) {}
}

/// The services and settings that all commands of a pipeline share.
pub struct Context {
    /// Receives progress.
    pub progress: Box<dyn Progress>,
    /// Cancels the work.
    pub cancel: Cancel,
    /// Settings of all stages.
    pub settings: Settings,
    /// Whether to repeat stages even if nothing has changed.
    pub force: bool,
    /// Receives events.
    pub events: Box<dyn EventSink>,
    /// Options of the user by command (`scan`, `materialize`, `plan`, `execute`). A run records them, so that printed
    /// commands repeat them. Empty for a program that has no command line.
    pub options: BTreeMap<String, Vec<String>>,
}

impl Default for Context {
    /// Returns a context with default settings, without progress and events.
    fn default() -> Self {
        Self {
            progress: Box::new(NoProgress),
            cancel: Cancel::new(),
            settings: Settings::default(),
            force: false,
            events: Box::new(()),
            options: BTreeMap::new(),
        }
    }
}

impl Context {
    /// Returns the context of a stage.
    pub fn stage<'a>(&'a self, warnings: &'a Warnings, seed: Seed) -> StageContext<'a> {
        StageContext { progress: self.progress.as_ref(), cancel: &self.cancel, warnings, seed }
    }

    pub(crate) fn message(&self, text: impl AsRef<str>) {
        self.events.event(&Event::Message(text.as_ref()));
    }

    /// Reports warnings as events.
    pub fn warn(&self, warnings: &Warnings) {
        warnings.snapshot().iter().for_each(|w| self.events.event(&Event::Warning(w)));
    }
}
