//! Memory of a scan, stated before masks and training.

use sms_core::process;
use sms_frames::Sequence;

/// Memory for each pixel of the frames: images, labels, and the targets of the training. Measured on the CPU with 60 to 1,000 frames
/// (`experiments/studies/scan/rooms.md`).
const BYTES_PER_PIXEL: f64 = 75.0;
/// Memory for everything else, measured likewise.
const OTHER_BYTES: f64 = 1.5e8;

/// Estimate of the memory that a scan takes.
pub(crate) struct ScanMemory {
    frames: usize,
    needed_bytes: f64,
    /// Memory that this process has or can have; `None` on systems that do not tell.
    available_bytes: Option<f64>,
}

impl ScanMemory {
    /// Estimates the memory of a scan whose frames are loaded.
    pub(crate) fn of(sequence: &Sequence) -> Self {
        let pixels: usize = sequence.frames.iter().map(|f| f.depth.data.len()).sum();
        let available = process::available_bytes().zip(process::resident_bytes());
        Self {
            frames: sequence.len(),
            needed_bytes: OTHER_BYTES + BYTES_PER_PIXEL * pixels as f64,
            available_bytes: available.map(|(free, own)| (free + own) as f64),
        }
    }

    /// Whether the machine has too little.
    fn is_short(&self) -> bool {
        self.available_bytes.is_some_and(|available| available < self.needed_bytes)
    }

    /// Returns the statement for the user.
    pub(crate) fn text(&self) -> String {
        let gib = |bytes: f64| bytes / f64::from(1 << 30);
        let text =
            format!("memory: a scan of {} frames takes about {:.1} GiB", self.frames, gib(self.needed_bytes));
        if !self.is_short() {
            return text;
        }
        let available = gib(self.available_bytes.unwrap_or(0.0));
        format!(
            "{text}, of which the machine has {available:.1}: use fewer frames (`--set frames.keyframe_views=30`, or a `frames.stride`) or \
             a smaller `--preset`"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_machine_with_less_memory_is_short_of_it() {
        let memory = |available_bytes| ScanMemory { frames: 100, needed_bytes: 2e9, available_bytes };
        assert!(memory(Some(1e9)).is_short());
        assert!(!memory(Some(3e9)).is_short() && !memory(None).is_short());
        assert!(memory(Some(1e9)).text().len() > memory(None).text().len());
    }
}
