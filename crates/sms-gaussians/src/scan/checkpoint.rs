//! The checkpoint: the position in the schedule and the whole state of the trainer, with a checksum.
//!
//! All randomness derives from the seed and the position in the schedule, so the checkpoint needs no random state.

use super::losses::LossSample;
use crate::TrainState;
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, Hash, Hasher, atomic};
use std::path::Path;

const MAGIC: &[u8; 8] = b"SMSSCAN1";
/// Hexadecimal digits of the checksum at the end.
const CHECKSUM: usize = 32;

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct SchedulePosition {
    /// Index in the list of trained frames. The length of the list means the refinement over all frames, and one more
    /// means the end.
    pub(crate) slot: usize,
    /// Steps taken in this slot.
    pub(crate) step: usize,
    /// Whether this slot's Gaussians have been seeded.
    pub(crate) seeded: bool,
    /// Step of this slot from which on learning rates fall, once it is known.
    #[serde(default)]
    pub(crate) fall: Option<usize>,
    /// Errors of the frames that are not trained on until then.
    #[serde(default)]
    pub(crate) validation_errors: Vec<f32>,
    /// Whether this slot's pruning midway has been done.
    pub(crate) pruned_midway: bool,
    /// Loss of each batch of this slot, for early stopping.
    pub(crate) batch_losses: Vec<f32>,
    /// Number of Gaussians on measured surfaces, which come first; `None` if all are.
    pub(crate) measured: Option<usize>,
    /// Steps taken since the start.
    pub(crate) total_steps: u64,
    /// The history.
    pub(crate) losses: Vec<LossSample>,
}

#[derive(Serialize, Deserialize)]
struct Header {
    settings: Hash,
    place: SchedulePosition,
}

/// Result of looking for a checkpoint in the work folder.
pub(crate) enum FoundCheckpoint {
    /// There is none, or it belongs to other settings or data.
    Nothing,
    /// The checkpoint is incomplete, with the reason.
    Damaged(String),
    /// A checkpoint to resume from.
    Resume(SchedulePosition, TrainState),
}

/// Writes the checkpoint atomically.
pub(crate) fn save(
    path: &Path,
    settings: &Hash,
    place: &SchedulePosition,
    state: &TrainState,
) -> Result<(), CoreError> {
    let header = serde_json::to_vec(&Header { settings: settings.clone(), place: place.clone() })
        .map_err(|e| CoreError::Write { path: path.to_owned(), source: std::io::Error::other(e) })?;
    let mut bytes = Vec::with_capacity(64 + header.len() + state.bytes.len());
    bytes.extend_from_slice(MAGIC);
    for part in [&header, &state.bytes] {
        bytes.extend_from_slice(&(part.len() as u64).to_le_bytes());
        bytes.extend_from_slice(part);
    }
    let sum = checksum(&bytes);
    bytes.extend_from_slice(sum.as_bytes());
    atomic::write_bytes(path, &bytes)
}

/// Reads the checkpoint.
pub(crate) fn load(path: &Path, settings: &Hash) -> FoundCheckpoint {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return FoundCheckpoint::Nothing,
        Err(e) => return FoundCheckpoint::Damaged(e.to_string()),
    };
    match parse(&bytes) {
        Err(reason) => FoundCheckpoint::Damaged(reason),
        Ok((header, _)) if header.settings != *settings => FoundCheckpoint::Nothing,
        Ok((header, state)) => FoundCheckpoint::Resume(header.place, state),
    }
}

fn checksum(bytes: &[u8]) -> String {
    let mut hasher = Hasher::new();
    hasher.bytes(bytes);
    hasher.finish().0
}

fn parse(bytes: &[u8]) -> Result<(Header, TrainState), String> {
    let split = bytes.len().checked_sub(CHECKSUM).ok_or("it is too short")?;
    let (body, sum) = bytes.split_at(split);
    if checksum(body).as_bytes() != sum {
        return Err("its checksum does not match".into());
    }
    let rest = body.strip_prefix(MAGIC).ok_or("it was written by another version")?;
    let (header, rest) = take_part(rest)?;
    let (state, _) = take_part(rest)?;
    let header = serde_json::from_slice(header).map_err(|e| e.to_string())?;
    Ok((header, TrainState { bytes: state.to_vec() }))
}

fn take_part(bytes: &[u8]) -> Result<(&[u8], &[u8]), &'static str> {
    let (length, rest) = bytes.split_first_chunk::<8>().ok_or("it is cut short")?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| "its lengths are wrong")?;
    rest.split_at_checked(length).ok_or("it is cut short")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LossTerms;

    fn sample() -> (SchedulePosition, TrainState) {
        let losses = vec![LossSample {
            step: 7,
            frame: Some(3),
            loss: LossTerms { total: 0.1, depth: 1e-3, ..LossTerms::default() },
            gaussians: 11,
        }];
        let place = SchedulePosition {
            slot: 2,
            step: 30,
            seeded: true,
            batch_losses: vec![0.3, 0.1],
            losses,
            ..SchedulePosition::default()
        };
        (place, TrainState { bytes: (0..200).collect() })
    }

    #[test]
    fn a_checkpoint_comes_back_as_it_was_and_only_for_its_settings() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("checkpoint.bin");
        let (place, state) = sample();
        let (ours, other) = (Hash("a".into()), Hash("b".into()));
        assert!(matches!(load(&path, &ours), FoundCheckpoint::Nothing));
        save(&path, &ours, &place, &state).unwrap();
        match load(&path, &ours) {
            FoundCheckpoint::Resume(p, s) => assert_eq!((p, s), (place, state)),
            _ => panic!("not resumed"),
        }
        assert!(matches!(load(&path, &other), FoundCheckpoint::Nothing));
    }

    #[test]
    fn every_truncation_and_every_changed_byte_is_noticed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("checkpoint.bin");
        let hash = Hash("a".into());
        let (place, state) = sample();
        save(&path, &hash, &place, &state).unwrap();
        let good = std::fs::read(&path).unwrap();
        for cut in (0..good.len()).step_by(13) {
            std::fs::write(&path, &good[..cut]).unwrap();
            assert!(matches!(load(&path, &hash), FoundCheckpoint::Damaged(_)), "cut at {cut}");
        }
        for at in (0..good.len()).step_by(7) {
            let mut bad = good.clone();
            bad[at] ^= 0x10;
            std::fs::write(&path, &bad).unwrap();
            assert!(matches!(load(&path, &hash), FoundCheckpoint::Damaged(_)), "byte {at}");
        }
    }
}
