//! Camera poses from images alone, against the recorded or the true ones.

mod room;

use crate::BenchError;
use crate::orbits::{Orbit, OrbitKind, poses_of};
use glamx::{DPose3, DVec3};
use room::record_room;
use sms_core::metrics::Metrics;
use sms_core::{Seed, StageContext};
use sms_frames::{LoadSettings, ReadOptions, Recording, Sequence, load_frame};
use sms_poses::{PosesConfig, PosesMode, Trajectory, align_rigidly, refine_poses, track_cameras};
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

/// Kinds of generated recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TrackedKind {
    /// An orbit around objects on a desk ([`OrbitKind::Desk`]).
    Desk,
    /// A turn in a room.
    Room,
}

impl TrackedKind {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Desk, Self::Room];

    /// The word in tables and keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Desk => "desk",
            Self::Room => "room",
        }
    }
}

/// Estimated poses of one recording, against its own.
#[derive(Debug, Clone)]
pub struct TrackingRow {
    /// Name of the recording or of the kind of scene.
    pub name: String,
    /// Number of frames.
    pub frames: usize,
    /// Frames without an estimated pose.
    pub lost: usize,
    /// Keyframes, and motions between those that do not follow each other.
    pub keyframes: usize,
    /// See [`Self::keyframes`].
    pub loops: usize,
    /// Absolute trajectory error: root mean square distance of the camera centres after rigid alignment, metres.
    pub ate_m: f64,
    /// The same after refinement; `None` for recordings, which are refined when they are scanned.
    pub refined_ate_m: Option<f64>,
    /// Time of the estimate.
    pub seconds: f64,
}

/// Tracks the camera of a generated recording.
///
/// # Errors
/// [`BenchError::Core`] if interrupted or for invalid settings.
pub fn track_generated(
    kind: TrackedKind,
    seed: Seed,
    config: &PosesConfig,
    context: StageContext<'_>,
) -> Result<TrackingRow, BenchError> {
    let truth = match kind {
        TrackedKind::Desk => Orbit::record(OrbitKind::Desk, seed).sequence,
        TrackedKind::Room => record_room(seed),
    };
    let began = Instant::now();
    let found = track_cameras(truth.len(), &|i| Ok(Some(truth.frames[i].clone())), config, context)?;
    let seconds = began.elapsed().as_secs_f64();
    let mut row = TrackingRow::new(kind.as_str(), &found, &poses_of(&truth), seconds);
    let (mut given, mut true_poses) = (Vec::new(), Vec::new());
    for (frame, pose) in truth.frames.iter().zip(&found.poses) {
        if let Some(x_wc) = pose {
            true_poses.push(frame.camera.x_wc);
            let mut frame = frame.clone();
            frame.camera.x_wc = *x_wc;
            given.push(frame);
        }
    }
    let given = Sequence { frames: given, ..truth };
    let config = PosesConfig { mode: PosesMode::Auto, ..config.clone() };
    let refined = poses_of(&refine_poses(&given, &config, context)?.sequence);
    row.refined_ate_m = Some(trajectory_error_m(&refined, &true_poses));
    Ok(row)
}

/// Tracks the camera of a recording with poses, of which every `stride`-th frame is used.
///
/// # Errors
/// [`BenchError::Core`] if the recording cannot be read, or if interrupted.
pub fn track_recording(
    dir: &Path,
    stride: usize,
    config: &PosesConfig,
    context: StageContext<'_>,
) -> Result<TrackingRow, BenchError> {
    let recording = Recording::open(dir, &ReadOptions::default())?;
    let settings = LoadSettings { long_side: 320, ..LoadSettings::default() };
    let used: Vec<usize> = (0..recording.frames.len()).step_by(stride.max(1)).collect();
    let began = Instant::now();
    let found = track_cameras(used.len(), &|i| load_frame(&recording, used[i], &settings), config, context)?;
    let seconds = began.elapsed().as_secs_f64();
    let recorded: Vec<DPose3> = used.iter().map(|&i| recording.frames[i].x_rc).collect();
    let name = dir.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    Ok(TrackingRow::new(&name, &found, &recorded, seconds))
}

impl TrackingRow {
    fn new(name: &str, found: &Trajectory, truth: &[DPose3], seconds: f64) -> Self {
        let posed: Vec<(DPose3, DPose3)> =
            found.poses.iter().zip(truth).filter_map(|(found, x)| Some(((*found)?, *x))).collect();
        let (estimated, true_poses): (Vec<DPose3>, Vec<DPose3>) = posed.iter().copied().unzip();
        Self {
            name: name.to_owned(),
            frames: truth.len(),
            lost: truth.len() - posed.len(),
            keyframes: found.keyframes,
            loops: found.loops,
            ate_m: trajectory_error_m(&estimated, &true_poses),
            refined_ate_m: None,
            seconds,
        }
    }
}

/// Returns the absolute trajectory error (Sturm et al., IROS 2012), metres.
fn trajectory_error_m(estimated: &[DPose3], truth: &[DPose3]) -> f64 {
    let centers = |poses: &[DPose3]| -> Vec<DVec3> { poses.iter().map(|x| x.translation).collect() };
    let (from, to) = (centers(estimated), centers(truth));
    let fit = align_rigidly(&from, &to);
    let square = |(p, q): (&DVec3, &DVec3)| (fit.transform_point(*p) - *q).length_squared();
    (from.iter().zip(&to).map(square).sum::<f64>() / from.len() as f64).sqrt()
}

/// Returns the table of tracked recordings.
pub fn tracking_table(rows: &[TrackingRow]) -> String {
    let mut out =
        String::from("recording            frames  lost  keyframes  loops    ATE mm  refined mm       s\n");
    for row in rows {
        let refined = row.refined_ate_m.map_or_else(|| "–".to_owned(), |m| format!("{:.2}", 1e3 * m));
        let _ = writeln!(
            out,
            "{:<20} {:>6} {:>5} {:>10} {:>6} {:>9.2} {:>11} {:>7.1}",
            row.name,
            row.frames,
            row.lost,
            row.keyframes,
            row.loops,
            1e3 * row.ate_m,
            refined,
            row.seconds
        );
    }
    out
}

/// Returns the figures `bench.tracking.NAME.*`: means over the rows of a name, and the worst error.
pub fn tracking_metrics(rows: &[TrackingRow]) -> Metrics {
    let mut metrics = Metrics::new();
    let mut names: Vec<&str> = rows.iter().map(|r| r.name.as_str()).collect();
    names.dedup();
    for name in names {
        let of: Vec<&TrackingRow> = rows.iter().filter(|r| r.name == name).collect();
        let n = of.len() as f64;
        let mut set = |key: &str, value: f64| {
            metrics.set(format!("bench.tracking.{name}.{key}"), value);
        };
        set("n", n);
        set("ate_mean_m", of.iter().map(|r| r.ate_m).sum::<f64>() / n);
        set("ate_worst_m", of.iter().map(|r| r.ate_m).fold(0.0, f64::max));
        set("lost_frames", of.iter().map(|r| r.lost).sum::<usize>() as f64);
        set("seconds_per_frame", of.iter().map(|r| r.seconds / r.frames as f64).sum::<f64>() / n);
    }
    metrics
}
