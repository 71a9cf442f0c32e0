//! Pose refinement: dense RGB-D bundle adjustment over a loaded sequence.
//!
//! Camera poses from motion capture, a phone or a robot's arm are off by millimetres to centimetres, and every surface
//! that is fused from them is smeared by as much. [`refine_poses`] corrects all of them at once, before masks and scan:
//!
//! - each frame is compared with the frames that see most of what it sees, and with some from farther around;
//! - points of one frame are carried into the other, where their distance to the measured surface (point to plane) and
//!   their difference in brightness are residuals, each weighed by its noise; a plane such as a table top fixes three
//!   directions by depth and the others by its texture;
//! - all corrections are solved for together (Gauss-Newton with robust weights, coarse to fine; conjugate gradients over
//!   6 × 6 blocks), with a weak pull to the given poses. No single frame is held fixed: at the end all cameras together
//!   are moved so that the measured points lie, in the least-squares sense, where the given poses put them;
//! - gain and offset of the brightness are fitted to each pair, and one shift of the colour against the depth to all
//!   frames: without it, colour that is off by a few pixels would pull all poses to one side.
//!
//! [`PosesMode::Auto`] then judges: pairs of frames and points that had no part in the refinement must agree
//! significantly better than before, otherwise the given poses stay.
//!
//! The direct alignment follows Kerl, Sturm and Cremers, "Dense visual SLAM for RGB-D cameras" (IROS 2013), and Whelan
//! et al., "Robust real-time visual odometry for dense RGB-D mapping" (ICRA 2013); adjusting all poses at once with
//! eliminated pair terms is the pose-graph form of it. Results do not depend on the number of threads.
//!
//! ```
//! use sms_core::{Cancel, StageContext, Warnings};
//! use sms_poses::{PosesConfig, PosesMode, Verdict, refine_poses};
//! # let sequence = sms_frames::Sequence {
//! #     frames: Vec::new(), x_world_recording: glamx::DPose3::identity(), source: "here".into() };
//! let config = PosesConfig { mode: PosesMode::Auto, ..PosesConfig::default() };
//! let refined = refine_poses(&sequence, &config, StageContext::quiet(&Cancel::new(), &Warnings::new()))?;
//! // This sequence has no frames, so that there was nothing to refine.
//! assert_eq!(refined.report.verdict, Verdict::NotPossible);
//! # Ok::<(), sms_core::CoreError>(())
//! ```

mod align;
mod config;
mod graph;
mod judge;
mod linear;
mod luma;
mod refine;
mod report;
mod residual;
mod views;

pub use align::{PoseErrors, align_rigidly, compare_poses};
pub use config::{PosesConfig, PosesMode};
pub use judge::{Consistency, Gain, Judgement};
pub use report::{PoseCorrection, PoseReport, Verdict};

use glamx::DPose3;
use refine::Problem;
use sms_core::{CoreError, StageContext, Warnings};
use sms_frames::Sequence;

/// A sequence with the poses to use, and how they came about.
#[derive(Debug, Clone)]
pub struct PoseRefinement {
    /// The sequence; only `camera.x_wc` of its frames may differ from the given one's.
    pub sequence: Sequence,
    /// What was done.
    pub report: PoseReport,
}

/// Refines the poses `X_WC` of all frames of a sequence.
///
/// Where nothing can be refined (one frame, no overlap, no depth), where the result is not finite, or where `auto` sees
/// no improvement, the given poses are returned, and a warning says so (in `auto` without improvement: none, as nothing
/// is wrong).
///
/// # Errors
/// [`CoreError::Interrupted`] when cancelled; [`CoreError::Input`] for settings that are out of range.
pub fn refine_poses(
    sequence: &Sequence,
    config: &PosesConfig,
    context: StageContext<'_>,
) -> Result<PoseRefinement, CoreError> {
    let StageContext { progress, cancel, warnings, .. } = context;
    let keep = |report| Ok(PoseRefinement { sequence: sequence.clone(), report });
    if config.mode == PosesMode::Off {
        return keep(PoseReport::without_refinement(Verdict::Off));
    }
    config.validate()?;
    let given: Vec<DPose3> = sequence.frames.iter().map(|f| f.camera.x_wc).collect();
    let views = views::views(sequence, config);
    let problem = Problem::new(&views, &given, config);
    if problem.graph.pairs.is_empty() {
        warnings.add(
            "poses",
            "poses_not_refined",
            "the poses could not be refined: no two frames see enough of the same surfaces",
            "record with more overlap, or leave the poses as they are (--refine-poses off)",
        );
        return keep(PoseReport::without_refinement(Verdict::NotPossible));
    }
    let (poses, color_shift_px, iterations) = problem.run(progress, cancel)?;
    let judgement = judge::judge(&problem, &poses, color_shift_px);
    let corrections: Vec<PoseCorrection> = given
        .iter()
        .zip(&poses)
        .enumerate()
        .map(|(frame, (g, p))| PoseCorrection {
            frame,
            shift_m: (p.translation - g.translation).length(),
            turn_rad: g.rotation.angle_between(p.rotation),
        })
        .collect();
    let finite = corrections.iter().all(|c| c.shift_m.is_finite() && c.turn_rad.is_finite());
    let mut report = PoseReport {
        verdict: Verdict::Refined,
        pairs: problem.graph.pairs.len(),
        iterations,
        color_shift_px,
        corrections,
        judgement,
    };
    if !finite {
        report.verdict = Verdict::NotPossible;
        report.corrections.clear();
    } else if config.mode == PosesMode::Auto && !judgement.improved() {
        report.verdict = Verdict::GivenAreAsGood;
    }
    progress.end(&report.summary());
    warn(&report, config, &problem, warnings);
    let mut sequence = sequence.clone();
    if report.verdict == Verdict::Refined {
        for (frame, pose) in sequence.frames.iter_mut().zip(poses) {
            frame.camera.x_wc = pose;
        }
    }
    Ok(PoseRefinement { sequence, report })
}

fn warn(report: &PoseReport, config: &PosesConfig, problem: &Problem<'_>, warnings: &Warnings) {
    if report.verdict == Verdict::NotPossible {
        warnings.add(
            "poses",
            "poses_not_refined",
            "the poses could not be refined: the images do not determine them",
            "check the depth and the poses with `sms check`",
        );
    }
    if report.verdict != Verdict::Refined {
        return;
    }
    let judged = &report.judgement;
    if config.mode == PosesMode::On && !judged.improved() {
        warnings.add(
            "poses",
            "poses_no_better",
            format!(
                "refined poses are used although held-out frames agree no better with them (depth {:+.1} %, colour {:+.1} %)",
                -100.0 * judged.depth.share,
                -100.0 * judged.color.share
            ),
            "use --refine-poses auto",
        );
    }
    let [du, dv] = report.color_shift_px;
    if du.hypot(dv) > 0.0 {
        warnings.add(
            "poses",
            "color_shifted",
            format!("colour lies {du:+.1}, {dv:+.1} pixels (right, down) beside the depth"),
            "register the depth to the colour camera again; surfaces' colours and mask edges suffer",
        );
    }
    let lonely: Vec<String> =
        problem.frames_without_pairs().iter().take(8).map(ToString::to_string).collect();
    if !lonely.is_empty() {
        warnings.add(
            "poses",
            "poses_of_some_frames_kept",
            format!(
                "frames {} see too little of what others see; their poses are as given",
                lonely.join(", ")
            ),
            "",
        );
    }
    let far: Vec<String> = report
        .corrections
        .iter()
        .filter(|c| c.shift_m > 5.0 * config.prior_position_m || c.turn_rad > 5.0 * config.prior_rotation_rad)
        .map(|c| c.frame.to_string())
        .take(8)
        .collect();
    if !far.is_empty() {
        warnings.add(
            "poses",
            "poses_far_off",
            format!("the poses of frames {} were corrected by more than given poses are usually off", far.join(", ")),
            "look at these frames; raise prior_position_m and prior_rotation_rad in [poses] if the poses are that poor",
        );
    }
}
