//! A scan that is interrupted and continued.

use crate::flow::{record, request, short_settings};
use sms_core::{Cancel, ErrorKind, StageError};
use sms_gaussians::{BatchDone, ScanObserver, ScanResumed};
use sms_pipeline::{Context, Event, EventSink, Run};
use std::sync::{Arc, Mutex};

/// Keeps the messages.
#[derive(Clone, Default)]
struct Messages(Arc<Mutex<Vec<String>>>);

impl EventSink for Messages {
    fn event(&self, event: &Event<'_>) {
        if let Event::Message(text) = event {
            self.0.lock().unwrap().push((*text).to_owned());
        }
    }
}

/// Cancels after a number of steps, and records where the scan is resumed.
struct Interrupting {
    after: u64,
    cancel: Cancel,
    resumed: Option<ScanResumed>,
}

impl ScanObserver for Interrupting {
    fn resumed(&mut self, resumed: &ScanResumed) {
        self.resumed = Some(*resumed);
    }

    fn batch(&mut self, batch: &BatchDone) {
        if batch.sample.step >= self.after {
            self.cancel.cancel();
        }
    }
}

#[test]
fn a_resumed_scan_says_from_where() {
    let dir = tempfile::tempdir().unwrap();
    let (recording, folder) = (dir.path().join("recording"), dir.path().join("run"));
    record(&recording);
    let scan = |after: u64| {
        let messages = Messages::default();
        let context =
            Context { settings: short_settings(), events: Box::new(messages.clone()), ..Context::default() };
        let mut observer = Interrupting { after, cancel: context.cancel.clone(), resumed: None };
        let result =
            Run::new(&folder, &context).scan_observed(&recording, &request(), &mut observer).map(drop);
        let about: Vec<String> =
            messages.0.lock().unwrap().iter().filter(|m| m.starts_with("gaussians:")).cloned().collect();
        (result, observer.resumed, about)
    };
    let (result, resumed, about) = scan(30);
    assert!(matches!(result.unwrap_err().kind(), ErrorKind::Interrupted));
    assert_eq!((resumed, about), (None, Vec::new()));

    let (result, resumed, about) = scan(u64::MAX);
    result.unwrap();
    let at = resumed.expect("the scan is resumed");
    // All frames are trained on together.
    assert!(at.steps >= 30 && at.slot == at.frames, "{at:?}");
    assert_eq!(about.len(), 1);
    assert!(about[0].contains(&format!("{} frames", at.frames)), "{about:?}");
    assert!(about[0].contains(&format!("{} steps", at.steps)), "{about:?}");
}
