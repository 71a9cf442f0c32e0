//! The hash of all inputs of a scan. It takes as long as a hundred steps on a GPU, so it is computed while the first
//! frame is trained.

use super::config::ScanConfig;
use sms_core::{Hash, Hasher, Labels, Seed};
use sms_frames::Sequence;
use std::thread::ScopedJoinHandle;

/// Returns the hash of all inputs of the result.
pub(crate) fn settings_hash(
    sequence: &Sequence,
    labels: &Labels,
    config: &ScanConfig,
    seed: Seed,
    background: [f32; 3],
) -> Hash {
    // The interval of checkpoints does not affect the result.
    let config = ScanConfig { checkpoint_seconds: 0.0, ..config.clone() };
    let mut hasher = Hasher::new();
    hasher.text(&sms_core::hash_serializable(&(config, seed, labels.class_count(), background)).0);
    for (frame, map) in sequence.frames.iter().zip(&labels.maps) {
        hasher.text(&sms_core::hash_serializable(&frame.camera).0);
        hasher.bytes(frame.color.data.as_flattened());
        hasher.bytes(&bytes_of(&frame.gain, f32::to_le_bytes));
        hasher.bytes(&bytes_of(&frame.depth.data, |z| z.to_le_bytes()));
        hasher.bytes(&bytes_of(frame.normal_c.data.as_flattened(), |n| n.to_le_bytes()));
        hasher.bytes(&bytes_of(&map.data, |l| l.to_le_bytes()));
        if let Some(attached) = &frame.attached {
            hasher.bytes(&bytes_of(&attached.data, |is| [u8::from(is)]));
        }
    }
    hasher.finish()
}

fn bytes_of<T: Copy, const N: usize>(values: &[T], bytes: impl Fn(T) -> [u8; N]) -> Vec<u8> {
    let mut all = vec![0; N * values.len()];
    for (to, value) in all.as_chunks_mut::<N>().0.iter_mut().zip(values) {
        *to = bytes(*value);
    }
    all
}

/// The hash, and the thread that computes it.
pub(crate) struct SettingsHash<'scope> {
    thread: Option<ScopedJoinHandle<'scope, Hash>>,
    /// Empty until the thread ends, and if it panics, which is reported to the first caller.
    hash: Hash,
}

impl<'scope> SettingsHash<'scope> {
    pub(crate) fn of(thread: ScopedJoinHandle<'scope, Hash>) -> Self {
        Self { thread: Some(thread), hash: Hash(String::new()) }
    }

    /// Returns the hash, waiting for it if needed.
    pub(crate) fn hash(&mut self) -> Hash {
        if let Some(thread) = self.thread.take() {
            self.hash = thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
        self.hash.clone()
    }
}
