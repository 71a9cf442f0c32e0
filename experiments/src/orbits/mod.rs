//! Pose refinement on generated orbits with exact truth: bias of scale and of the distances between opposite faces.

mod disturbed;
mod measures;
mod scene;
mod table;

pub use disturbed::PoseFault;
use measures::surface_error_m;
pub use measures::{BoxErrors, box_errors, center_scale};
pub(crate) use scene::Rendered;
pub use scene::{Orbit, OrbitKind};
pub use table::{OrbitRow, Sigmas, orbit_metrics, orbit_table};

use crate::BenchError;
use glamx::DPose3;
use sms_core::{Camera, Seed, StageContext};
use sms_frames::Sequence;
use sms_poses::{PoseVerdict, PosesConfig, PosesMode, refine_poses};
use std::time::Instant;

/// Refines an orbit with a fault, and compares the result with the truth. The poses are those that the refinement
/// proposes, whether or not it judges them better; the judgement is part of the result.
///
/// # Errors
/// [`BenchError::Core`] if interrupted or for invalid settings.
pub fn refine_orbit(
    orbit: &Orbit,
    fault: PoseFault,
    config: &PosesConfig,
    seed: Seed,
    context: StageContext<'_>,
) -> Result<OrbitRow, BenchError> {
    let given = fault.applied(&orbit.sequence, seed);
    let began = Instant::now();
    let refined = refine_poses(&given, &PosesConfig { mode: PosesMode::Refine, ..config.clone() }, context)?;
    let seconds = began.elapsed().as_secs_f64();
    let (refined_poses, refined_cameras) = (poses_of(&refined.sequence), cameras_of(&refined.sequence));
    Ok(OrbitRow {
        orbit: orbit.kind,
        fault,
        scale: center_scale(&refined_poses, &poses_of(&orbit.sequence)),
        faces_before: box_errors(orbit, &cameras_of(&given)),
        faces: box_errors(orbit, &refined_cameras),
        surface_m: surface_error_m(orbit, &refined_cameras),
        surface_true_m: surface_error_m(orbit, &cameras_of(&orbit.sequence)),
        is_improved: refined.report.verdict == PoseVerdict::Refined && refined.report.judgement.improved(),
        is_refused: refined.report.common_mode.is_some_and(|mode| !mode.is_allowed()),
        sigmas: refined.report.size.as_ref().map(Sigmas::of).unwrap_or_default(),
        seconds,
    })
}

/// Returns the cameras of the frames.
pub(crate) fn cameras_of(sequence: &Sequence) -> Vec<Camera> {
    sequence.frames.iter().map(|f| f.camera).collect()
}

/// Returns the poses `X_WC` of the frames.
pub(crate) fn poses_of(sequence: &Sequence) -> Vec<DPose3> {
    sequence.frames.iter().map(|f| f.camera.x_wc).collect()
}
