//! Pose refinement on generated orbits with exact truth: bias of scale and of the distances between opposite faces.

mod disturbed;
mod measures;
mod scene;
mod table;

pub use disturbed::PoseFault;
pub use measures::{BoxErrors, box_errors, center_scale};
pub use scene::{Orbit, OrbitKind};
pub use table::{OrbitRow, orbit_metrics, orbit_table};

use crate::BenchError;
use sms_core::{Seed, StageContext};
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
    let refined = refine_poses(&given, &PosesConfig { mode: PosesMode::On, ..config.clone() }, context)?;
    let seconds = began.elapsed().as_secs_f64();
    let errors = |sequence: &Sequence| {
        let poses = sequence.frames.iter().map(|f| f.camera.x_wc).collect::<Vec<_>>();
        (center_scale(&poses, &orbit.poses()), box_errors(orbit, &poses))
    };
    let (scale_before, faces_before) = errors(&given);
    let (scale, faces) = errors(&refined.sequence);
    Ok(OrbitRow {
        orbit: orbit.kind,
        fault,
        scale_before,
        scale,
        faces_before,
        faces,
        is_improved: refined.report.verdict == PoseVerdict::Refined && refined.report.judgement.improved(),
        residual_m: refined.report.judgement.after.depth_median_m,
        color_shift_px: refined.report.color_shift_px,
        seconds,
    })
}
