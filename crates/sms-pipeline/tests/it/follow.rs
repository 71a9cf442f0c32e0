//! A scan that follows a recording while its folder grows.

use crate::flow::{record, request, short_settings};
use sms_gaussians::{BatchDone, ScanObserver, SlotDone};
use sms_pipeline::{Context, Run, ScanRequest};
use std::path::Path;
use std::time::Duration;

/// Records the steps, and the number of frames and of Gaussians of each report.
#[derive(Default)]
struct Seen {
    steps: Vec<u64>,
    frames: Vec<usize>,
    gaussians: Vec<usize>,
}

impl ScanObserver for Seen {
    fn batch(&mut self, batch: &BatchDone) {
        self.steps.push(batch.sample.step);
    }

    fn slot(&mut self, slot: &SlotDone<'_>) {
        self.frames.push(slot.frames);
        self.gaussians.push((slot.model)().len());
    }
}

fn scanned(recording: &Path, folder: &Path, follow: Option<Duration>, seen: &mut Seen) -> Vec<u8> {
    let context = Context { settings: short_settings(), ..Context::default() };
    let request = ScanRequest { follow, ..request() };
    let outcome = Run::new(folder, &context).scan_observed(recording, &request, seen).unwrap();
    std::fs::read(outcome.gaussians).unwrap()
}

/// Writes the listing with more and more frames.
fn list_slowly(recording: &Path) {
    let path = recording.join("transforms.json");
    let complete: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for count in [4, 7, 10] {
        let mut so_far = complete.clone();
        so_far["frames"].as_array_mut().unwrap().truncate(count);
        std::fs::write(&path, serde_json::to_vec(&so_far).unwrap()).unwrap();
        std::thread::sleep(Duration::from_millis(400));
    }
}

#[test]
fn a_followed_recording_gives_the_scan_of_the_complete_one() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    record(&at("recording"));
    let (mut at_once, mut followed) = (Seen::default(), Seen::default());
    let expected = scanned(&at("recording"), &at("at-once"), None, &mut at_once);
    let patience = Some(Duration::from_secs(3));
    let (recording, run) = (at("recording"), at("followed"));
    let result = std::thread::scope(|scope| {
        scope.spawn(|| list_slowly(&recording));
        scanned(&recording, &run, patience, &mut followed)
    });
    assert!(result == expected, "the same bytes");
    // Frames as they arrive, then the refinement of those that are not held out.
    let arrived = followed.frames.len() - at_once.frames.len();
    assert!((3..=10).contains(&arrived), "{arrived}");
    assert!(followed.frames[..arrived].iter().copied().eq(1..=arrived));
    assert_eq!(followed.frames[arrived..], at_once.frames);
    assert!(followed.gaussians.iter().all(|count| *count > 100), "{:?}", followed.gaussians);
    assert!(followed.steps.is_sorted_by(|a, b| a < b), "{:?}", followed.steps);
    assert!(followed.steps.len() > at_once.steps.len());
}
