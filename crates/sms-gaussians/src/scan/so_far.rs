//! Record of earlier, interrupted attempts at the same scan: their time and their warnings.
//!
//! The record is separate from the checkpoint, so that the bytes of the checkpoint do not depend on interruptions.

use serde::{Deserialize, Serialize};
use sms_core::{CoreError, Warning, Warnings, atomic};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// File name.
const FILE: &str = "so_far.json";

#[derive(Debug, Default, Serialize, Deserialize)]
struct AttemptRecord {
    seconds: f64,
    warnings: Vec<Warning>,
}

/// Time over all attempts.
#[derive(Debug)]
pub(crate) struct SoFar {
    path: PathBuf,
    began: Instant,
    earlier_s: f64,
}

impl SoFar {
    /// A first attempt in `work_dir`, starting now.
    pub(crate) fn new(work_dir: &Path) -> Self {
        Self { path: work_dir.join(FILE), began: Instant::now(), earlier_s: 0.0 }
    }

    /// Adds the record of the previous attempt; called when its checkpoint is resumed.
    pub(crate) fn resume(&mut self, stage: &str, warnings: &Warnings) {
        if !self.path.exists() {
            return;
        }
        match atomic::read_json::<AttemptRecord>(&self.path) {
            Ok(record) if record.seconds.is_finite() => {
                self.earlier_s = record.seconds.max(0.0);
                warnings.take_over(record.warnings);
            }
            _ => warnings.add(
                stage,
                "attempt_lost",
                format!(
                    "{} is damaged: time and warnings of the scan before its interruption are lost",
                    self.path.display()
                ),
                "",
            ),
        }
    }

    /// Seconds over all attempts.
    pub(crate) fn seconds(&self) -> f64 {
        self.earlier_s + self.began.elapsed().as_secs_f64()
    }

    /// Writes the record for a possible next attempt.
    pub(crate) fn save(&self, warnings: &Warnings) -> Result<(), CoreError> {
        atomic::write_json(
            &self.path,
            &AttemptRecord { seconds: self.seconds(), warnings: warnings.snapshot() },
        )
    }

    /// Removes the file: no attempt follows.
    pub(crate) fn remove(&self) {
        let _ = std::fs::remove_file(&self.path);
    }
}
