//! Progress of long work, independent of its display.

use crate::{RemainingTime, duration_text};
use serde_json::{Map, Value, json};
use std::io::Write;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Receives progress. Implementations must be cheap: stages report after every unit.
pub trait Progress: Sync {
    /// Begins a part of the work with `units` units (0 if unknown).
    fn begin(&self, part: &str, units: u64);
    /// Reports that `done` units of the current part are done; `message` describes the state ("frame 12, PSNR 27.1 dB").
    fn update(&self, done: u64, message: &str);
    /// Ends the current part.
    fn end(&self, message: &str);
    /// As [`Progress::update`], with the time left and the figures of the message.
    fn status(&self, status: &Status<'_>) {
        self.update(status.done, status.message);
    }
}

/// State of a part of the work.
#[derive(Debug, Clone, Copy)]
pub struct Status<'a> {
    /// Units done. Work that ends early jumps ahead.
    pub done: u64,
    /// Description of the state.
    pub message: &'a str,
    /// Seconds left by the work's own estimate, which is better than one by the share of units done.
    pub seconds_left: Option<f64>,
    /// The figures in the message, by name.
    pub values: &'a [(&'a str, f64)],
}

/// Returns the units done for display: plans of work are estimates, and more than planned is not shown.
pub fn shown_units(done: u64, units: u64) -> u64 {
    if units > 0 { done.min(units) } else { done }
}

/// Discards progress.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn begin(&self, _part: &str, _units: u64) {}
    fn update(&self, _done: u64, _message: &str) {}
    fn end(&self, _message: &str) {}
}

/// The current part of the work, reported as lines.
struct CurrentPart {
    out: Box<dyn Write + Send>,
    every: Duration,
    name: String,
    units: u64,
    began: Instant,
    /// Time of its last line.
    last: Instant,
    time: RemainingTime,
}

impl CurrentPart {
    fn new(out: Box<dyn Write + Send>, every: Duration) -> Mutex<Self> {
        let now = Instant::now();
        let time = RemainingTime::default();
        Mutex::new(Self { out, every, name: String::new(), units: 0, began: now, last: now, time })
    }

    fn begin(&mut self, name: &str, units: u64) {
        let now = Instant::now();
        (self.name, self.units, self.began, self.last) = (name.to_owned(), units, now, now);
        self.time = RemainingTime::default();
    }

    /// Counts units done and returns the seconds left, if they are known.
    fn seconds_left(&mut self, done: u64) -> Option<f64> {
        self.time.report(self.began.elapsed().as_secs_f64(), done, self.units)
    }

    /// Returns whether the last line is at least `every` ago, and restarts the interval if so.
    fn is_due(&mut self) -> bool {
        let due = self.last.elapsed() >= self.every;
        if due {
            self.last = Instant::now();
        }
        due
    }

    fn line(&mut self, line: impl std::fmt::Display) {
        // A closed pipe is not an error.
        let _ = writeln!(self.out, "{line}");
    }

    fn json(&mut self, event: &str, message: &str, more: impl FnOnce(&mut Map<String, Value>)) {
        let mut object = Map::new();
        object.insert("event".into(), json!(event));
        object.insert("part".into(), json!(self.name));
        object.insert("units".into(), json!(self.units));
        object.insert("seconds".into(), json!(self.began.elapsed().as_secs_f64()));
        more(&mut object);
        object.insert("message".into(), json!(message));
        self.line(Value::Object(object));
    }
}

impl std::fmt::Debug for CurrentPart {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CurrentPart").field("every", &self.every).finish_non_exhaustive()
    }
}

/// Writes plain lines, at most one every few seconds: for logs and pipes.
#[derive(Debug)]
pub struct PlainProgress(Mutex<CurrentPart>);

impl PlainProgress {
    /// Writes lines to standard error, at most every `every`.
    pub fn new(every: Duration) -> Self {
        Self(CurrentPart::new(Box::new(std::io::stderr()), every))
    }
}

impl Default for PlainProgress {
    fn default() -> Self {
        Self::new(Duration::from_secs(5))
    }
}

impl Progress for PlainProgress {
    fn begin(&self, part: &str, units: u64) {
        let Ok(mut state) = self.0.lock() else { return };
        state.begin(part, units);
        state.line(format_args!("{part} …"));
    }

    fn update(&self, done: u64, message: &str) {
        let Ok(mut state) = self.0.lock() else { return };
        let left = state.seconds_left(done);
        if !state.is_due() {
            return;
        }
        let of = if state.units > 0 { format!("/{}", state.units) } else { String::new() };
        let shown = shown_units(done, state.units);
        let line = format!("{} {shown}{of}: {message}{}", state.name, left_text(left));
        state.line(line);
    }

    fn status(&self, status: &Status<'_>) {
        let Ok(mut state) = self.0.lock() else { return };
        if !state.is_due() {
            return;
        }
        let percent = 100 * status.done.min(state.units) / state.units.max(1);
        let left = left_text(status.seconds_left);
        let line = format!("{} {percent} %: {}{left}", state.name, status.message);
        state.line(line);
    }

    fn end(&self, message: &str) {
        let Ok(mut state) = self.0.lock() else { return };
        let seconds = state.began.elapsed().as_secs_f64();
        let line = format!("{}: {message} ({seconds:.1} s)", state.name);
        state.line(line);
    }
}

fn left_text(seconds_left: Option<f64>) -> String {
    seconds_left.map(|s| format!(", about {} left", duration_text(s))).unwrap_or_default()
}

/// Writes one JSON object per line, for programs that show progress themselves.
///
/// Each has `event` (`begin`, `update` or `end`), `part`, `units`, `seconds` since the part began and `message`;
/// updates also have `done`, `seconds_left` (null if unknown) and the part's own figures.
#[derive(Debug)]
pub struct JsonProgress(Mutex<CurrentPart>);

impl JsonProgress {
    /// Writes to standard error; updates at most every `every`.
    pub fn new(every: Duration) -> Self {
        Self(CurrentPart::new(Box::new(std::io::stderr()), every))
    }
}

impl Progress for JsonProgress {
    fn begin(&self, part: &str, units: u64) {
        let Ok(mut state) = self.0.lock() else { return };
        state.begin(part, units);
        state.json("begin", "", |_| {});
    }

    fn update(&self, done: u64, message: &str) {
        let seconds_left = match self.0.lock() {
            Ok(mut state) => state.seconds_left(done),
            Err(_) => return,
        };
        self.status(&Status { done, message, seconds_left, values: &[] });
    }

    fn status(&self, status: &Status<'_>) {
        let Ok(mut state) = self.0.lock() else { return };
        if !state.is_due() {
            return;
        }
        let shown = shown_units(status.done, state.units);
        state.json("update", status.message, |object| {
            object.insert("done".into(), json!(shown));
            object.insert("seconds_left".into(), json!(status.seconds_left));
            for (name, value) in status.values {
                object.insert((*name).to_owned(), json!(value));
            }
        });
    }

    fn end(&self, message: &str) {
        let Ok(mut state) = self.0.lock() else { return };
        state.json("end", message, |_| {});
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// A writer with readable text.
    #[derive(Clone, Default)]
    struct Written(Arc<Mutex<Vec<u8>>>);

    impl Write for Written {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    impl Written {
        fn lines(&self) -> Vec<String> {
            String::from_utf8(self.0.lock().unwrap().clone()).unwrap().lines().map(str::to_owned).collect()
        }
    }

    const STATUS: Status<'_> = Status {
        done: 30,
        message: "frame 2/5, colour 0.021",
        seconds_left: Some(130.4),
        values: &[("frame", 2.0), ("color_l1", 0.021)],
    };

    #[test]
    fn plain_lines_tell_share_message_and_time_left_and_are_rare() {
        let out = Written::default();
        let progress = PlainProgress(CurrentPart::new(Box::new(out.clone()), Duration::ZERO));
        progress.begin("scan", 120);
        progress.status(&STATUS);
        progress.end("done");
        let lines = out.lines();
        assert_eq!(lines[0], "scan …");
        assert_eq!(lines[1], "scan 25 %: frame 2/5, colour 0.021, about 2 min 10 s left");
        assert!(lines[2].starts_with("scan: done ("), "{lines:?}");
        let out = Written::default();
        let progress = PlainProgress(CurrentPart::new(Box::new(out.clone()), Duration::from_secs(3600)));
        progress.begin("scan", 120);
        (0..100).for_each(|_| progress.status(&STATUS));
        assert_eq!(out.lines().len(), 1);
    }

    #[test]
    fn json_lines_hold_the_figures() {
        let out = Written::default();
        let progress = JsonProgress(CurrentPart::new(Box::new(out.clone()), Duration::ZERO));
        progress.begin("scan", 120);
        progress.status(&STATUS);
        progress.update(60, "a \"quoted\" word");
        progress.end("done");
        let lines: Vec<Value> = out.lines().iter().map(|l| serde_json::from_str(l).unwrap()).collect();
        let events: Vec<_> = lines.iter().map(|l| l["event"].as_str().unwrap()).collect();
        assert_eq!(events, ["begin", "update", "update", "end"]);
        assert_eq!((&lines[1]["done"], &lines[1]["units"]), (&json!(30), &json!(120)));
        assert_eq!((&lines[1]["color_l1"], &lines[1]["seconds_left"]), (&json!(0.021), &json!(130.4)));
        assert_eq!(lines[2]["message"], "a \"quoted\" word");
        assert!(lines.iter().all(|l| l["part"] == "scan" && l["seconds"].is_f64()));
    }

    /// Plans are estimates: a search may need more rollouts.
    #[test]
    fn no_more_units_are_shown_than_planned() {
        let out = Written::default();
        let progress = PlainProgress(CurrentPart::new(Box::new(out.clone()), Duration::ZERO));
        progress.begin("plan", 3216);
        progress.update(3558, "shots simulated");
        progress.begin("reasons", 0);
        progress.update(7, "shots simulated");
        let lines = out.lines();
        assert_eq!(
            (&*lines[1], &*lines[3]),
            ("plan 3216/3216: shots simulated", "reasons 7: shots simulated")
        );
        let out = Written::default();
        let progress = JsonProgress(CurrentPart::new(Box::new(out.clone()), Duration::ZERO));
        progress.begin("plan", 3216);
        progress.update(3558, "shots simulated");
        let update: Value = serde_json::from_str(&out.lines()[1]).unwrap();
        assert_eq!((&update["done"], &update["seconds_left"]), (&json!(3216), &Value::Null));
    }
}
