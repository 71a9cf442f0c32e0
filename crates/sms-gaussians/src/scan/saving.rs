//! Timing of checkpoints, and the thread that writes them.

use super::checkpoint::{self, SchedulePosition};
use crate::TrainState;
use sms_core::{CoreError, Hash};
use std::path::PathBuf;
use std::thread::JoinHandle;
use std::time::Instant;

/// The next checkpoint of a frame waits for this multiple of the time that the last checkpoint took from the scan.
const LAST_TIMES: f64 = 20.0;

/// Writes checkpoints beside the scan, one at a time.
pub(crate) struct Saver {
    path: PathBuf,
    /// Seconds between checkpoints within a frame.
    seconds: f64,
    saved: Instant,
    /// Time that the last checkpoint took from the scan.
    took_s: f64,
    writing: Option<JoinHandle<Result<(), CoreError>>>,
}

impl Saver {
    pub(crate) fn new(path: PathBuf, seconds: f64) -> Self {
        Self { path, seconds, saved: Instant::now(), took_s: 0.0, writing: None }
    }

    pub(crate) fn path(&self) -> &std::path::Path {
        &self.path
    }

    /// Whether a checkpoint is due within a frame.
    pub(crate) fn due(&self) -> bool {
        self.saved.elapsed().as_secs_f64() > self.seconds
    }

    /// Whether a checkpoint is due after a frame. On a GPU, a frame can take less time than reading the state.
    pub(crate) fn due_after_frame(&self) -> bool {
        let least = (0.2 * self.seconds).min(1.0).max((LAST_TIMES * self.took_s).min(self.seconds));
        self.saved.elapsed().as_secs_f64() >= least
    }

    /// Starts writing a checkpoint, whose preparation started at `began`, once the previous one is written.
    ///
    /// # Errors
    /// [`CoreError::Write`] of the previous one.
    pub(crate) fn save(
        &mut self,
        began: Instant,
        settings: Hash,
        place: SchedulePosition,
        state: TrainState,
    ) -> Result<(), CoreError> {
        self.written()?;
        let path = self.path.clone();
        self.writing = Some(std::thread::spawn(move || checkpoint::save(&path, &settings, &place, &state)));
        self.saved = Instant::now();
        self.took_s = began.elapsed().as_secs_f64();
        Ok(())
    }

    /// Waits until the last checkpoint is on the disk.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub(crate) fn written(&mut self) -> Result<(), CoreError> {
        match self.writing.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(panic)) => std::panic::resume_unwind(panic),
        }
    }
}

impl Drop for Saver {
    /// Nothing may be written after the end of the scan, because its folder may be removed.
    fn drop(&mut self) {
        if let Some(writing) = self.writing.take() {
            // Another error of the scan takes precedence.
            let _ = writing.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_that_cannot_be_written_is_told_at_the_next_look() {
        let dir = tempfile::tempdir().unwrap();
        let (file, hash) = (dir.path().join("file"), Hash("a".into()));
        std::fs::write(&file, "no folder").unwrap();
        let mut saver = Saver::new(file.join("checkpoint.bin"), 5.0);
        saver.save(Instant::now(), hash.clone(), SchedulePosition::default(), TrainState::default()).unwrap();
        assert!(matches!(saver.written(), Err(CoreError::Write { .. })));
        saver.written().unwrap();

        let path = dir.path().join("checkpoint.bin");
        let mut saver = Saver::new(path.clone(), 5.0);
        saver.save(Instant::now(), hash.clone(), SchedulePosition::default(), TrainState::default()).unwrap();
        drop(saver);
        assert!(matches!(checkpoint::load(&path, &hash), checkpoint::FoundCheckpoint::Resume(..)));
    }

    #[test]
    fn frames_save_at_once_only_where_that_is_cheap() {
        let saver = |seconds, took_s| {
            let mut saver = Saver::new("nowhere".into(), seconds);
            saver.took_s = took_s;
            saver
        };
        assert!(saver(0.0, 0.0).due_after_frame() && saver(0.0, 3.0).due_after_frame());
        assert!(!saver(5.0, 0.0).due_after_frame() && !saver(5.0, 0.0).due());
        let later = |mut saver: Saver, seconds: f64| {
            saver.saved -= std::time::Duration::from_secs_f64(seconds);
            saver
        };
        assert!(later(saver(5.0, 0.01), 1.1).due_after_frame());
        assert!(!later(saver(5.0, 0.2), 1.1).due_after_frame());
        assert!(later(saver(5.0, 9.0), 5.1).due_after_frame());
    }
}
