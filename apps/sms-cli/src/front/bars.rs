//! Progress on a terminal: one bar for the current part of the work.

use super::console::note;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use sms_core::{Progress, RemainingTime, Status, duration_text, shown_units};
use std::sync::Mutex;
use std::time::Duration;

/// Shows progress as a bar on standard error.
#[derive(Debug, Default)]
pub(super) struct Bars {
    current: Mutex<Option<CurrentBar>>,
}

/// The bar of the current part.
#[derive(Debug)]
struct CurrentBar {
    bar: ProgressBar,
    /// Planned units; 0 if unknown.
    units: u64,
    time: RemainingTime,
}

impl CurrentBar {
    fn show(&self, done: u64, message: &str, seconds_left: Option<f64>) {
        self.bar.set_position(shown_units(done, self.units));
        self.bar.set_message(match seconds_left {
            Some(seconds) => format!("{} left · {message}", duration_text(seconds)),
            None => message.to_owned(),
        });
    }
}

impl Progress for Bars {
    fn begin(&self, part: &str, units: u64) {
        let bar = if units > 0 { ProgressBar::new(units) } else { ProgressBar::new_spinner() };
        bar.set_draw_target(ProgressDrawTarget::stderr_with_hz(5));
        // The time left is part of the message, because the bar cannot estimate it for work that may end early.
        let shape = if units > 0 {
            "{prefix:>22} {bar:24.cyan/dim} {percent:>3} % {elapsed} {wide_msg}"
        } else {
            "{prefix:>22} {spinner} {elapsed} {wide_msg}"
        };
        if let Ok(style) = ProgressStyle::with_template(shape) {
            bar.set_style(style);
        }
        bar.set_prefix(part.to_owned());
        bar.enable_steady_tick(Duration::from_millis(250));
        let Ok(mut current) = self.current.lock() else { return };
        if let Some(old) = current.replace(CurrentBar { bar, units, time: RemainingTime::default() }) {
            old.bar.finish_and_clear();
        }
    }

    fn update(&self, done: u64, message: &str) {
        let Ok(mut current) = self.current.lock() else { return };
        let Some(part) = current.as_mut() else { return };
        let left = part.time.report(part.bar.elapsed().as_secs_f64(), done, part.units);
        part.show(done, message, left);
    }

    fn status(&self, status: &Status<'_>) {
        let Ok(current) = self.current.lock() else { return };
        if let Some(part) = current.as_ref() {
            part.show(status.done, status.message, status.seconds_left);
        }
    }

    fn end(&self, message: &str) {
        let Ok(mut current) = self.current.lock() else { return };
        if let Some(CurrentBar { bar, .. }) = current.take() {
            let line = format!("{:>22} {message} ({:.1} s)", bar.prefix(), bar.elapsed().as_secs_f64());
            bar.finish_and_clear();
            note(line);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_ends_at_its_length() {
        let bars = Bars::default();
        bars.begin("plan", 3216);
        bars.update(3558, "shots simulated");
        let current = bars.current.lock().unwrap();
        let bar = &current.as_ref().unwrap().bar;
        assert_eq!((bar.position(), bar.length()), (3216, Some(3216)));
        assert_eq!(bar.message(), "shots simulated");
    }
}
