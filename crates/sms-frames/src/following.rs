//! Frames of a recording while its folder grows.

use crate::keyframes::{KeyframeFilter, Samples};
use crate::load::selected_frames;
use crate::recording::check_options;
use crate::{Frame, FramesError, LoadSettings, ReadOptions, RecordedFrame, Recording, load_frame};
use sms_core::Cancel;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Least time between two looks at the folder.
const POLL: Duration = Duration::from_millis(200);
/// Looking takes at most one part in so many of the time.
const LOOKING: u32 = 10;

/// The frames of a recording as they arrive: an iterator that waits for the next one, and ends once no further one has arrived for some
/// time: `patience`.
///
/// The newest frame comes first, so that a caller who is slower than the recorder keeps up; frames that were passed over follow while no new
/// one arrives, in the middle of the longest gap each. Of more than [`LoadSettings::keyframe_views`] views of the same surface, the later
/// ones are left out. Frames are in the recording's world, at their own exposure. Frames without poses are waited for, but not returned.
///
/// Files that are missing, incomplete or damaged are tried again until the end: they may be being written. What is wrong with them is for
/// [`crate::load`] to say.
pub struct FollowedFrames<'a> {
    dir: PathBuf,
    read: &'a ReadOptions,
    settings: &'a LoadSettings,
    patience: Duration,
    cancel: &'a Cancel,
    recording: Option<Recording>,
    keyframes: KeyframeFilter,
    /// Colour files of the frames that were returned or left out.
    done: BTreeSet<PathBuf>,
    /// Frames that could not be read, by index, with the sizes of their files then.
    unreadable: BTreeMap<usize, [u64; 2]>,
    returned: usize,
    /// Time of the first look that found no further frame after the last one that did.
    idle_since: Option<Instant>,
    /// Time of the last look at the folder, and the time until the next one.
    looked: Option<(Instant, Duration)>,
}

impl<'a> FollowedFrames<'a> {
    /// Follows the recording in `dir`, which need not exist yet, until no frame has arrived for `patience`.
    ///
    /// # Errors
    /// [`sms_core::InputError`] for a setting or an option out of its range.
    pub fn new(
        dir: &Path,
        read: &'a ReadOptions,
        settings: &'a LoadSettings,
        patience: Duration,
        cancel: &'a Cancel,
    ) -> Result<Self, FramesError> {
        settings.validate()?;
        check_options(read)?;
        Ok(Self {
            dir: dir.to_owned(),
            read,
            settings,
            patience,
            cancel,
            recording: None,
            keyframes: KeyframeFilter::new(settings.keyframe_views),
            done: BTreeSet::new(),
            unreadable: BTreeMap::new(),
            returned: 0,
            idle_since: None,
            looked: None,
        })
    }

    /// Reads the listing again, if it is time.
    fn look(&mut self) {
        if self.looked.is_some_and(|(at, pause)| at.elapsed() < pause) {
            return;
        }
        let (began, known) = (Instant::now(), self.recording.as_ref().map_or(0, |known| known.frames.len()));
        // A listing that is being written cannot be read.
        self.recording = Recording::open(&self.dir, self.read).ok().or(self.recording.take());
        let has_grown = self.recording.as_ref().is_some_and(|recording| recording.frames.len() > known);
        self.idle_since = if has_grown { None } else { self.idle_since.or(Some(began)) };
        self.looked = Some((began, POLL.max(LOOKING * began.elapsed())));
    }

    /// Returns whether no frame has arrived for long enough, as of the last look.
    fn is_over(&self) -> bool {
        let idle = self.looked.zip(self.idle_since).map(|((at, _), since)| at.duration_since(since));
        idle.is_some_and(|idle| idle >= self.patience)
    }

    /// Returns the next frame that is there and can be read.
    fn arrived(&mut self) -> Result<Option<Frame>, FramesError> {
        let Some(recording) = self.recording.as_ref().filter(|recording| recording.has_poses) else {
            return Ok(None);
        };
        let selected = selected_frames(recording, self.settings);
        let path = |i: usize| &recording.frames[i].color_path;
        let waits = |&i: &usize| {
            let is_readable =
                || self.unreadable.get(&i).is_none_or(|sizes| *sizes != file_sizes(&recording.frames[i]));
            !self.done.contains(path(i)) && is_readable()
        };
        let mut is_waiting: Vec<bool> = selected.iter().map(waits).collect();
        while let Some(slot) = next_waiting(&is_waiting) {
            self.cancel.check()?;
            let i = selected[slot];
            is_waiting[slot] = false;
            let sizes = file_sizes(&recording.frames[i]);
            let read = load_frame(recording, i, self.settings);
            let (Ok(frame), Ok(samples)) = (read, Samples::read(recording, i)) else {
                self.unreadable.insert(i, sizes);
                continue;
            };
            self.done.insert(path(i).clone());
            let Some(frame) = frame else { continue };
            if self.keyframes.keeps(&samples) {
                self.returned += 1;
                return Ok(Some(Frame { index: self.returned - 1, ..frame }));
            }
        }
        Ok(None)
    }
}

impl Iterator for FollowedFrames<'_> {
    type Item = Result<Frame, FramesError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            self.look();
            if self.is_over() {
                return None;
            }
            if let Some(frame) = self.cancel.check().and_then(|()| self.arrived()).transpose() {
                return Some(frame);
            }
            let (looked, pause) = self.looked?;
            std::thread::sleep(pause.saturating_sub(looked.elapsed()).min(POLL));
        }
    }
}

/// Returns the sizes of the colour and the depth file of a frame, bytes; 0 for one that is missing.
fn file_sizes(frame: &RecordedFrame) -> [u64; 2] {
    [&frame.color_path, &frame.depth_path].map(|path| path.metadata().map_or(0, |file| file.len()))
}

/// Returns the last frame if it waits, else the middle of the longest run of frames that wait.
fn next_waiting(is_waiting: &[bool]) -> Option<usize> {
    if *is_waiting.last()? {
        return Some(is_waiting.len() - 1);
    }
    let (mut longest, mut run) = (0..0, 0..0);
    for (slot, waits) in is_waiting.iter().enumerate() {
        run = if *waits { run.start..slot + 1 } else { slot + 1..slot + 1 };
        if run.len() > longest.len() {
            longest = run.clone();
        }
    }
    (!longest.is_empty()).then(|| longest.start + longest.len() / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_frame_comes_first_then_the_middle_of_the_longest_gap() {
        let (mut is_waiting, mut order) = (vec![true; 8], Vec::new());
        while let Some(slot) = next_waiting(&is_waiting) {
            order.push(slot);
            is_waiting[slot] = false;
        }
        assert_eq!(order, [7, 3, 1, 5, 0, 2, 4, 6]);
        assert_eq!(next_waiting(&[]), None);
    }
}
