//! Progress of long work, without knowing where it is shown.

use std::io::Write;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Receives progress. Implementations must be cheap: stages report after every unit.
pub trait Progress: Sync {
    /// A part of the work begins, with so many units (0 where unknown).
    fn begin(&self, part: &str, units: u64);
    /// `done` units of the current part are done; `message` says what is happening ("frame 12, PSNR 27.1 dB").
    fn update(&self, done: u64, message: &str);
    /// The current part is over.
    fn end(&self, message: &str);
}

/// Shows nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn begin(&self, _part: &str, _units: u64) {}
    fn update(&self, _done: u64, _message: &str) {}
    fn end(&self, _message: &str) {}
}

/// Plain lines on standard error, at most one every few seconds: for logs and pipes.
#[derive(Debug)]
pub struct PlainProgress {
    state: Mutex<PlainState>,
    every: Duration,
}

#[derive(Debug)]
struct PlainState {
    part: String,
    units: u64,
    began: Instant,
    last: Instant,
}

impl PlainProgress {
    /// Lines at most every `every`.
    pub fn new(every: Duration) -> Self {
        let now = Instant::now();
        Self { state: Mutex::new(PlainState { part: String::new(), units: 0, began: now, last: now }), every }
    }
}

impl Default for PlainProgress {
    fn default() -> Self {
        Self::new(Duration::from_secs(5))
    }
}

impl Progress for PlainProgress {
    fn begin(&self, part: &str, units: u64) {
        let Ok(mut state) = self.state.lock() else { return };
        let now = Instant::now();
        *state = PlainState { part: part.to_owned(), units, began: now, last: now };
        let _ = writeln!(std::io::stderr(), "{part} …");
    }

    fn update(&self, done: u64, message: &str) {
        let Ok(mut state) = self.state.lock() else { return };
        if state.last.elapsed() < self.every {
            return;
        }
        state.last = Instant::now();
        let elapsed = state.began.elapsed().as_secs_f64();
        let left = if done > 0 && state.units > done {
            format!(", about {:.0} s left", elapsed / done as f64 * (state.units - done) as f64)
        } else {
            String::new()
        };
        let _ = writeln!(std::io::stderr(), "{} {}/{}: {}{}", state.part, done, state.units, message, left);
    }

    fn end(&self, message: &str) {
        let Ok(state) = self.state.lock() else { return };
        let seconds = state.began.elapsed().as_secs_f64();
        let _ = writeln!(std::io::stderr(), "{}: {message} ({seconds:.1} s)", state.part);
    }
}
