//! Reports of a running scan: progress, observers, and time and warnings over several attempts.

use super::fixture::{SMALL, record};
use super::observer::{BatchDone, ScanObserver, ScanResumed, SlotDone};
use super::schedule::{ScanResult, scan};
use super::tests::{SEED, bytes, quick};
use super::{ScanConfig, ScanError};
use crate::CpuTrainer;
use sms_core::{Cancel, CoreError, Labels, NoProgress, Progress, StageContext, Status, Warnings};
use sms_frames::Sequence;
use std::path::Path;
use std::sync::Mutex;

fn watched(
    (sequence, labels): &(Sequence, Labels),
    config: &ScanConfig,
    dir: &Path,
    observer: &mut dyn ScanObserver,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<ScanResult, ScanError> {
    let mut trainer = CpuTrainer::new(&config.train, labels.class_count(), SEED);
    scan(
        sequence,
        labels,
        config,
        dir,
        &mut trainer,
        observer,
        StageContext::new(progress, cancel, warnings).with_seed(SEED),
    )
}

/// Records everything, and requests every optional report.
#[derive(Default)]
struct Notes {
    batches: Vec<BatchDone>,
    /// Slot, frame, PSNR, number of Gaussians, number of rendered pixels.
    slots: Vec<(usize, usize, f64, usize, usize)>,
    resumed: Vec<ScanResumed>,
}

impl ScanObserver for Notes {
    fn resumed(&mut self, resumed: &ScanResumed) {
        self.resumed.push(*resumed);
    }

    fn batch(&mut self, batch: &BatchDone) {
        self.batches.push(*batch);
    }

    fn slot(&mut self, s: &SlotDone<'_>) {
        let model = (s.model)();
        self.slots.push((s.slot, s.frame.index, s.score.psnr_db, model.len(), s.rendered.color.len()));
    }
}

/// Records every status: units done, seconds left, named values.
#[derive(Default)]
struct Kept(Mutex<Vec<(u64, Option<f64>, Vec<(String, f64)>)>>, Mutex<u64>);

impl Progress for Kept {
    fn begin(&self, _part: &str, units: u64) {
        *self.1.lock().unwrap() = units;
    }
    fn update(&self, _done: u64, _message: &str) {}
    fn end(&self, _message: &str) {}
    fn status(&self, s: &Status<'_>) {
        let values = s.values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        self.0.lock().unwrap().push((s.done, s.seconds_left, values));
    }
}

#[test]
fn whoever_watches_sees_every_batch_and_frame_and_changes_nothing() {
    let recording = record(SMALL);
    let config = quick();
    let (alone, seen) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (cancel, warnings) = (Cancel::new(), Warnings::new());
    watched(&recording, &config, alone.path(), &mut (), &NoProgress, &cancel, &warnings).unwrap();
    let (mut notes, kept) = (Notes::default(), Kept::default());
    let result = watched(&recording, &config, seen.path(), &mut notes, &kept, &cancel, &warnings).unwrap();
    assert_eq!(bytes(seen.path()), bytes(alone.path()));

    assert_eq!(notes.batches.iter().map(|b| b.sample).collect::<Vec<_>>(), result.losses);
    // Eight frames minus two held out, then the refinement, represented by the last frame.
    let slots: Vec<(usize, usize)> = notes.slots.iter().map(|s| (s.0, s.1)).collect();
    assert_eq!(slots, [(0, 0), (1, 1), (2, 2), (3, 4), (4, 5), (5, 6), (6, 6)]);
    let last = notes.slots.last().unwrap();
    assert_eq!((last.3, last.4), (result.model.len(), SMALL.width * SMALL.height));
    assert!(notes.slots.iter().all(|s| s.2 > 10.0 && s.3 > 100));

    assert_eq!(notes.resumed, []);

    let (statuses, units) = (kept.0.into_inner().unwrap(), kept.1.into_inner().unwrap());
    assert_eq!(units, 40 + 5 * 20 + 20);
    assert_eq!(statuses.len(), result.losses.len());
    assert!(statuses.windows(2).all(|w| w[0].0 < w[1].0) && statuses.last().unwrap().0 <= units);
    let (_, left, values) = &statuses[2];
    let value = |name: &str| values.iter().find(|v| v.0 == name).unwrap().1;
    assert!(left.unwrap() > 0.0);
    assert_eq!((value("frame"), value("frames"), value("step"), value("steps")), (1.0, 6.0, 30.0, 40.0));
    assert_eq!(value("color_l1"), f64::from(result.losses[2].loss.color_l1));
    assert_eq!(value("gaussians"), result.losses[2].gaussians as f64);
    assert_eq!(statuses.last().unwrap().2.iter().find(|v| v.0 == "refining").unwrap().1, 1.0);
}

/// Requests cancellation at a batch.
struct StopAt(usize, Cancel);

impl ScanObserver for StopAt {
    fn batch(&mut self, batch: &BatchDone) {
        if batch.sample.step as usize >= self.0 {
            self.1.cancel();
        }
    }
}

#[test]
fn time_and_warnings_of_interrupted_attempts_are_kept() {
    let recording = record(SMALL);
    let config = ScanConfig { max_gaussians: 300, ..quick() };
    let once = tempfile::tempdir().unwrap();
    let expected = Warnings::new();
    watched(&recording, &config, once.path(), &mut (), &NoProgress, &Cancel::new(), &expected).unwrap();
    assert_eq!(expected.snapshot().len(), 1, "{:?}", expected.snapshot());

    let dir = tempfile::tempdir().unwrap();
    let mut seconds = 0.0;
    for stop in [60, 100] {
        let (cancel, warnings) = (Cancel::new(), Warnings::new());
        let mut observer = StopAt(stop, cancel.clone());
        let stopped =
            watched(&recording, &config, dir.path(), &mut observer, &NoProgress, &cancel, &warnings);
        assert!(matches!(stopped, Err(ScanError::Core(CoreError::Interrupted))));
        let left: serde_json::Value =
            serde_json::from_slice(&std::fs::read(dir.path().join("so_far.json")).unwrap()).unwrap();
        assert!(left["seconds"].as_f64().unwrap() > seconds);
        seconds = left["seconds"].as_f64().unwrap();
    }
    let (warnings, mut notes) = (Warnings::new(), Notes::default());
    let result =
        watched(&recording, &config, dir.path(), &mut notes, &NoProgress, &Cancel::new(), &warnings).unwrap();
    assert!(result.seconds > seconds);
    // 40 steps on the first frame and up to 20 on each of five others.
    let [resumed] = notes.resumed[..] else { panic!("{:?}", notes.resumed) };
    assert!(resumed.steps >= 100 && resumed.slot > 0 && resumed.slot <= resumed.frames, "{resumed:?}");
    assert_eq!((resumed.frames, notes.batches[0].slot), (6, resumed.slot));
    assert_eq!(warnings.snapshot(), expected.snapshot());
    assert_eq!(bytes(dir.path()), bytes(once.path()));
    assert!(!dir.path().join("so_far.json").exists());
}

#[test]
fn a_damaged_record_of_earlier_attempts_is_a_warning() {
    let recording = record(SMALL);
    let dir = tempfile::tempdir().unwrap();
    let cancel = Cancel::new();
    let mut observer = StopAt(50, cancel.clone());
    let warnings = Warnings::new();
    watched(&recording, &quick(), dir.path(), &mut observer, &NoProgress, &cancel, &warnings).unwrap_err();
    std::fs::write(dir.path().join("so_far.json"), "{\"seconds\": ").unwrap();
    watched(&recording, &quick(), dir.path(), &mut (), &NoProgress, &Cancel::new(), &warnings).unwrap();
    assert_eq!(warnings.snapshot()[0].code, "attempt_lost");
}
