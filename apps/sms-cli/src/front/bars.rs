//! Progress on a terminal: one bar for the current part of the work.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use sms_core::{Progress, Status, duration_text, linear_seconds_left};
use std::sync::Mutex;
use std::time::Duration;

/// Shows progress as a bar on standard error.
#[derive(Debug, Default)]
pub(super) struct Bars {
    current: Mutex<Option<ProgressBar>>,
}

impl Bars {
    fn show(&self, done: u64, message: &str, seconds_left: impl FnOnce(&ProgressBar) -> Option<f64>) {
        let Ok(current) = self.current.lock() else { return };
        let Some(bar) = current.as_ref() else { return };
        bar.set_position(done);
        bar.set_message(match seconds_left(bar) {
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
        if let Some(old) = current.replace(bar) {
            old.finish_and_clear();
        }
    }

    fn update(&self, done: u64, message: &str) {
        self.show(done, message, |bar| {
            linear_seconds_left(bar.elapsed().as_secs_f64(), done, bar.length().unwrap_or(0))
        });
    }

    fn status(&self, status: &Status<'_>) {
        self.show(status.done, status.message, |_| status.seconds_left);
    }

    fn end(&self, message: &str) {
        let Ok(mut current) = self.current.lock() else { return };
        if let Some(bar) = current.take() {
            let line = format!("{:>22} {message} ({:.1} s)", bar.prefix(), bar.elapsed().as_secs_f64());
            bar.finish_and_clear();
            eprintln!("{line}");
        }
    }
}
