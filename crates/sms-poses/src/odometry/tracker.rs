//! Frame after frame, each registered to the latest keyframe.

use super::matching::{LEAST_INLIERS, likeness, motion_by_features};
use super::pose_graph::Edge;
use super::registration::{Registration, TrackedView, register};
use crate::PosesConfig;
use glamx::DPose3;
use rayon::prelude::*;
use sms_core::Seed;

/// A frame is a new keyframe if less than this share of it is seen in the latest one …
const LEAST_KEYFRAME_OVERLAP: f64 = 0.6;
/// … or if it looks from a direction that differs by more than this, radians.
const MOST_KEYFRAME_TURN_RAD: f64 = 0.3;
/// Points within this share of their depth may be on the measured surface before the motion is known.
pub(super) const GATE_SHARE: f64 = 0.06;
/// Keyframes that are tried for a frame that has lost its track.
const TRIED_KEYFRAMES: usize = 3;

/// A frame that others are registered to.
pub(super) struct Keyframe {
    /// Keyframes of one piece follow from each other by registration.
    pub(super) piece: usize,
    pub(super) x_wc: DPose3,
    pub(super) view: TrackedView,
}

/// Place of a frame relative to a keyframe.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placed {
    pub(super) keyframe: usize,
    pub(super) x_kc: DPose3,
}

/// The latest frame, while it is not a keyframe.
struct Latest {
    frame: usize,
    view: TrackedView,
    motion: Registration,
}

/// Registers frames in their order.
pub(super) struct Tracker<'a> {
    config: &'a PosesConfig,
    pub(super) keyframes: Vec<Keyframe>,
    pub(super) edges: Vec<Edge>,
    /// Place of each frame so far; `None` without depth.
    pub(super) frames: Vec<Option<Placed>>,
    latest: Option<Latest>,
    /// Place where the track was last lost.
    before: Option<Placed>,
    /// Keyframe that frames are registered to.
    current: usize,
    pieces: usize,
    /// Pose of the latest frame relative to that keyframe, and its motion since the frame before.
    x_kc: DPose3,
    x_step: DPose3,
}

impl<'a> Tracker<'a> {
    pub(super) fn new(config: &'a PosesConfig) -> Self {
        Self {
            config,
            keyframes: Vec::new(),
            edges: Vec::new(),
            frames: Vec::new(),
            latest: None,
            before: None,
            current: 0,
            pieces: 0,
            x_kc: DPose3::identity(),
            x_step: DPose3::identity(),
        }
    }

    /// Adds the next frame; `None` is one without depth.
    pub(super) fn push(&mut self, view: Option<TrackedView>) {
        let frame = self.frames.len();
        let Some(view) = view.filter(TrackedView::has_depth) else {
            self.frames.push(None);
            return;
        };
        if self.keyframes.is_empty() {
            self.begin_piece(frame, view);
            return;
        }
        let motion = self
            .by_current(&view)
            .or_else(|| self.promote_latest().then(|| self.by_current(&view)).flatten());
        match motion.or_else(|| self.by_lost_track(&view)).or_else(|| self.by_any(&view)) {
            Some(motion) => self.place(frame, view, motion),
            None => self.begin_piece(frame, view),
        }
    }

    /// Registers a frame to the current keyframe: from its expected motion, from rest, or from matched corners.
    fn by_current(&self, view: &TrackedView) -> Option<Registration> {
        let expected = [self.x_kc * self.x_step, self.x_kc];
        let dense = expected.iter().find_map(|start| self.trusted(self.current, view, start));
        dense.or_else(|| self.by_corners(self.current, view))
    }

    fn trusted(&self, keyframe: usize, view: &TrackedView, start: &DPose3) -> Option<Registration> {
        trusted_registration(&self.keyframes[keyframe].view, view, start, self.config)
    }

    fn by_corners(&self, keyframe: usize, view: &TrackedView) -> Option<Registration> {
        let seed = Seed(0).derive_index("tracking", self.frames.len() as u64);
        let motion = motion_by_features(&self.keyframes[keyframe].view.features, &view.features, seed)?;
        self.trusted(keyframe, view, &motion)
    }

    /// Makes the latest frame the current keyframe; returns whether there was one.
    fn promote_latest(&mut self) -> bool {
        let Some(Latest { frame, view, motion }) = self.latest.take() else { return false };
        self.add_keyframe(frame, view, &motion);
        true
    }

    /// Registers a frame to the keyframes that look most like it, and makes the one that fits the current one.
    fn by_any(&mut self, view: &TrackedView) -> Option<Registration> {
        let mut alike: Vec<(usize, usize)> = (0..self.keyframes.len())
            .into_par_iter()
            .filter(|&k| k != self.current)
            .map(|k| (likeness(&self.keyframes[k].view.features, &view.features), k))
            .filter(|(count, _)| *count >= LEAST_INLIERS)
            .collect();
        alike.sort_by_key(|(count, k)| (std::cmp::Reverse(*count), *k));
        let (k, motion) = alike
            .into_iter()
            .take(TRIED_KEYFRAMES)
            .find_map(|(_, k)| Some((k, self.by_corners(k, view)?)))?;
        // The frame is taken to be at rest: its place before is known relative to another keyframe only.
        (self.current, self.x_kc) = (k, motion.x_ab);
        Some(motion)
    }

    /// Registers a frame to the keyframe that was current before the track was lost, from the last known pose: one bad frame does
    /// not end a piece.
    fn by_lost_track(&mut self, view: &TrackedView) -> Option<Registration> {
        let Placed { keyframe, x_kc } = self.before?;
        let motion = self.trusted(keyframe, view, &x_kc)?;
        (self.current, self.x_kc) = (keyframe, motion.x_ab);
        Some(motion)
    }

    /// Places a frame by its motion against the current keyframe.
    fn place(&mut self, frame: usize, view: TrackedView, motion: Registration) {
        self.x_step = self.x_kc.inverse() * motion.x_ab;
        self.x_kc = motion.x_ab;
        self.frames.push(Some(Placed { keyframe: self.current, x_kc: motion.x_ab }));
        let turn = motion.x_ab.rotation.to_scaled_axis().length();
        if motion.overlap < LEAST_KEYFRAME_OVERLAP || turn > MOST_KEYFRAME_TURN_RAD {
            self.add_keyframe(frame, view, &motion);
        } else {
            self.latest = Some(Latest { frame, view, motion });
        }
    }

    fn add_keyframe(&mut self, frame: usize, view: TrackedView, motion: &Registration) {
        let (from, to) = (self.current, self.keyframes.len());
        let Keyframe { piece, x_wc, .. } = self.keyframes[from];
        self.keyframes.push(Keyframe { piece, x_wc: x_wc * motion.x_ab, view });
        self.edges.push(Edge { from, to, motion: *motion, is_tracked: true });
        self.become_current(frame, to);
    }

    /// Begins a new piece of the trajectory with a frame that could not be registered.
    fn begin_piece(&mut self, frame: usize, view: TrackedView) {
        // A piece of one frame is no track.
        let had_track = self.latest.is_some() || self.edges.last().is_some_and(|e| e.to == self.current);
        if !self.keyframes.is_empty() && (had_track || self.before.is_none()) {
            self.before = Some(Placed { keyframe: self.current, x_kc: self.x_kc });
        }
        self.keyframes.push(Keyframe { piece: self.pieces, x_wc: DPose3::identity(), view });
        self.pieces += 1;
        self.x_step = DPose3::identity();
        if self.frames.len() == frame {
            self.frames.push(None);
        }
        self.become_current(frame, self.keyframes.len() - 1);
    }

    fn become_current(&mut self, frame: usize, keyframe: usize) {
        self.frames[frame] = Some(Placed { keyframe, x_kc: DPose3::identity() });
        self.current = keyframe;
        self.x_kc = DPose3::identity();
        self.latest = None;
    }
}

/// Registers two views from a first motion; `None` if the result is not trusted.
pub(super) fn trusted_registration(
    a: &TrackedView,
    b: &TrackedView,
    start: &DPose3,
    config: &PosesConfig,
) -> Option<Registration> {
    let gate_m = GATE_SHARE * a.mean_depth_m().max(b.mean_depth_m());
    register(a, b, start, gate_m, config).filter(Registration::is_trusted)
}
