//! Pose refinement: dense RGB-D bundle adjustment over a loaded sequence.
//!
//! Camera poses from motion capture, a phone or a robot's arm are off by millimetres to centimetres, and every surface
//! fused from them is blurred by as much. [`refine_poses`] corrects all of them at once, before masks and scan:
//!
//! - each frame is compared with the frames of largest overlap, and with some from more different directions;
//! - points of one frame are projected into the other. The residuals are their distance to the measured surface (point
//!   to plane) and their difference in brightness, each weighted by its noise. A plane such as a table top constrains
//!   three directions by depth and the others by its texture;
//! - surface directions come from the planes that the points of all frames form: those of one noisy depth image resist
//!   motion that they know nothing about. Derivatives of colour have the same fault, and are used as instruments in the
//!   end: the noise of one image is independent of that of the other;
//! - the given poses are measurements: frame i is near `given_i · E`, with a correction E that all frames share (the
//!   camera on its hand or motion-capture body) and a time offset, up to noise, independent or drifting, whose size is estimated;
//! - all corrections are solved for together (Gauss-Newton with robust weights, coarse to fine; conjugate gradients
//!   over 6 × 6 blocks). No single frame is held fixed: at the end, all cameras are moved rigidly so that the measured
//!   points are closest, in the least-squares sense, to their positions under the given poses;
//! - gain and offset of the brightness are fitted to each pair, and one shift of the colour against the depth to all
//!   frames: without it, colour that is off by a few pixels would bias all poses to one side. So is a factor of the focal
//!   length, which is used where it is more than chance and held-out pairs agree better with it;
//! - the covariance of the result gives the uncertainty of the scene's size ([`SizeUncertainty`]): faces that can move
//!   against each other at no cost do not show in the residuals.
//!
//! [`PosesMode::Auto`] refines only if the residuals at the given poses promise a gain, and uses the result only if held-out
//! pairs of frames and points agree significantly better than before, and if no change that many frames share ([`CommonMode`])
//! exceeds the noise of the given poses; otherwise the given poses are kept.
//!
//! The direct alignment follows Kerl, Sturm and Cremers, "Dense visual SLAM for RGB-D cameras" (IROS 2013), and Whelan
//! et al., "Robust real-time visual odometry for dense RGB-D mapping" (ICRA 2013); adjusting all poses at once with
//! eliminated pair terms is its pose-graph form. Results do not depend on the number of threads.
//!
//! ```
//! use sms_core::{Cancel, StageContext, Warnings};
//! use sms_poses::{PosesConfig, PosesMode, PoseVerdict, refine_poses};
//! # let sequence = sms_frames::Sequence {
//! #     frames: Vec::new(), x_world_recording: glamx::DPose3::identity(), source: "here".into() };
//! let config = PosesConfig { mode: PosesMode::Auto, ..PosesConfig::default() };
//! let refined = refine_poses(&sequence, &config, StageContext::quiet(&Cancel::new(), &Warnings::new()))?;
//! // This sequence has no frames, so nothing can be refined.
//! assert_eq!(refined.report.verdict, PoseVerdict::NotPossible);
//! # Ok::<(), sms_core::CoreError>(())
//! ```

mod align;
mod config;
mod covariance;
mod floor;
mod given;
mod gram;
mod graph;
mod histogram;
mod judge;
mod linear;
mod luma;
mod modes;
mod noise;
mod odometry;
mod pair;
mod planes;
mod refine;
mod report;
mod residual;
mod size;
mod views;

pub use align::{align_cameras, align_rigidly};
pub use config::{PosesConfig, PosesMode};
pub use judge::{Consistency, Gain, Judgement};
pub use modes::{CommonMode, ModeKind};
pub use odometry::{Trajectory, track_cameras};
pub use report::{
    FocalChange, GivenSigma, HandEye, PoseCorrection, PoseOrigin, PoseReport, PoseVerdict, TimeOffset,
};
pub use size::{ExtentUncertainty, SizeUncertainty};

use glamx::DPose3;
use judge::Posed;
use refine::{BundleAdjustment, CameraValues, Refined};
use sms_core::{CoreError, StageContext, Warnings};
use sms_frames::Sequence;

/// A sequence with the poses to use, and the report on them.
#[derive(Debug, Clone)]
pub struct PoseRefinement {
    /// The sequence; only the poses and focal lengths of the cameras of its frames may differ from the given one's.
    pub sequence: Sequence,
    /// The report.
    pub report: PoseReport,
}

/// Refines the poses `X_WC` of all frames of a sequence, and their focal length where the images contradict it.
///
/// Returns the given poses if nothing can be refined (one frame, no overlap, no depth), if the result is not finite, or
/// if [`PosesMode::Auto`] finds no improvement. The first two cases add a warning.
///
/// # Errors
/// [`CoreError::Interrupted`] when cancelled; [`CoreError::Input`] for settings that are out of range.
pub fn refine_poses(
    sequence: &Sequence,
    config: &PosesConfig,
    context: StageContext<'_>,
) -> Result<PoseRefinement, CoreError> {
    let StageContext { progress, cancel, warnings, .. } = context;
    let keep = |verdict| {
        let report = PoseReport { verdict, ..PoseReport::default() };
        Ok(PoseRefinement { sequence: sequence.clone(), report })
    };
    if config.mode == PosesMode::Given {
        return keep(PoseVerdict::NotRequested);
    }
    config.validate()?;
    let given: Vec<DPose3> = sequence.frames.iter().map(|f| f.camera.x_wc).collect();
    let views = views::views(sequence, config);
    let times_s: Vec<Option<f64>> = sequence.frames.iter().map(|f| f.time_s).collect();
    let problem = BundleAdjustment::new(&views, &given, &times_s, config);
    if problem.graph.pairs.is_empty() {
        warnings.add(
            "poses",
            "poses_not_refined",
            "the poses could not be refined: no two frames overlap enough",
            "record with more overlap, or leave the poses as they are (--poses given)",
        );
        return keep(PoseVerdict::NotPossible);
    }
    let prospect = config.mode.is_judged().then(|| problem.prospect());
    if prospect.as_ref().is_some_and(|p| p.gain < LEAST_PROSPECT) {
        let report = PoseReport {
            verdict: PoseVerdict::GivenAreAsGood,
            prospect: prospect.as_ref().map(|p| p.gain),
            pairs: problem.graph.pairs.len(),
            depth_noise: prospect.and_then(|p| p.depth_noise),
            ..PoseReport::default()
        };
        return Ok(PoseRefinement { sequence: sequence.clone(), report });
    }
    let Refined {
        poses,
        camera,
        focal_sigma,
        shared,
        time_sigma_s,
        deviations,
        noise,
        floor,
        depth_noise,
        uncertainty,
        common_mode,
        iterations,
    } = problem.run(progress, cancel)?;
    let given_sigma = GivenSigma::of(&noise, given.len());
    // The shift of the colour is no part of the poses: it counts for both.
    let before = Posed { poses: &given, camera: CameraValues { focal: 0.0, ..camera } };
    let judgement = judge::judge(&problem, before, Posed { poses: &poses, camera });
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
    // A factor beyond two is no calibration error.
    let is_focal_possible = camera.focal.abs() < std::f64::consts::LN_2;
    let finite =
        is_focal_possible && corrections.iter().all(|c| c.shift_m.is_finite() && c.turn_rad.is_finite());
    let mut report = PoseReport {
        origin: PoseOrigin::Recorded,
        verdict: PoseVerdict::Refined,
        prospect: prospect.map(|p| p.gain),
        pairs: problem.graph.pairs.len(),
        iterations,
        color_shift_px: camera.color_shift_px,
        focal: focal_sigma.map(|sigma| FocalChange { share: camera.focal.exp_m1(), sigma }),
        hand_eye: Some(HandEye::of(&shared.hand_eye)),
        time_offset: time_sigma_s.map(|sigma_s| TimeOffset { value_s: shared.time_s, sigma_s }),
        given_sigma: Some(given_sigma),
        pair_floor_m: Some(floor.shift_m),
        depth_noise,
        size: uncertainty,
        common_mode,
        corrections,
        judgement,
    };
    if !finite {
        // Of figures that are not finite, none is kept.
        report = PoseReport {
            verdict: PoseVerdict::NotPossible,
            prospect: report.prospect,
            pairs: report.pairs,
            iterations,
            ..PoseReport::default()
        };
    } else if config.mode.is_judged() && !judgement.improved() {
        report.verdict = PoseVerdict::GivenAreAsGood;
    } else if config.mode.is_judged() && common_mode.is_some_and(|mode| !mode.is_allowed()) {
        report.verdict = PoseVerdict::CommonChange;
    }
    progress.end(&format!("{iterations} iterations"));
    let far = frames_far_off(&deviations, &given_sigma);
    warn(&report, config, &problem, &far, warnings);
    let mut sequence = sequence.clone();
    if report.verdict == PoseVerdict::Refined {
        for (frame, pose) in sequence.frames.iter_mut().zip(poses) {
            frame.camera.x_wc = pose;
            frame.camera.intrinsics.fx *= camera.focal.exp();
            frame.camera.intrinsics.fy *= camera.focal.exp();
        }
    }
    Ok(PoseRefinement { sequence, report })
}

/// Least share of the squared residuals that a refinement must promise to be tried: a sixth of the reduction that
/// [`Judgement::improved`] asks of depth or colour, as one of them may have a sixth of the residuals.
const LEAST_PROSPECT: f64 = 0.01;

/// Returns the frames whose deviation is more than five times what is usual.
fn frames_far_off(deviations: &[[f64; 2]], usual: &GivenSigma) -> Vec<usize> {
    // The lengths of vectors of three components.
    let most = [usual.position_m, usual.rotation_rad].map(|s| 5.0 * 3f64.sqrt() * s);
    let is_far = |i: &usize| (0..2).any(|kind| deviations[*i][kind] > most[kind]);
    (0..deviations.len()).filter(is_far).collect()
}

fn warn(
    report: &PoseReport,
    config: &PosesConfig,
    problem: &BundleAdjustment<'_>,
    far: &[usize],
    warnings: &Warnings,
) {
    if report.verdict == PoseVerdict::NotPossible {
        warnings.add(
            "poses",
            "poses_not_refined",
            "the poses could not be refined: the images do not determine them",
            "check the depth and the poses with `sms check`",
        );
    }
    let is_told = matches!(report.verdict, PoseVerdict::Refined | PoseVerdict::CommonChange);
    if let Some(mode) = report.common_mode.filter(|mode| is_told && !mode.is_allowed()) {
        let used = if report.verdict == PoseVerdict::Refined { "refined" } else { "unrefined" };
        warnings.add(
            "poses",
            "poses_common_change",
            format!(
                "a refinement would {}, which is more than the noise of the given poses explains; the {used} poses are used",
                mode.summary()
            ),
            "check the unit of the depth, the intrinsics, and whether colour and depth are registered; with --poses refine the \
             refined poses are used all the same",
        );
    }
    if report.verdict != PoseVerdict::Refined {
        return;
    }
    let judged = &report.judgement;
    if config.mode == PosesMode::Refine && !judged.improved() {
        warnings.add(
            "poses",
            "poses_no_better",
            format!(
                "refined poses are used although held-out frames do not agree better with them (depth {:+.1} %, colour {:+.1} %)",
                -100.0 * judged.depth.share,
                -100.0 * judged.color.share
            ),
            "use --poses auto",
        );
    }
    /// Shifts below half a pixel change no pixel of a mask.
    const LEAST_SHIFT_PX: f64 = 0.5;
    let [du, dv] = report.color_shift_px;
    if du.hypot(dv) >= LEAST_SHIFT_PX {
        warnings.add(
            "poses",
            "color_shifted",
            format!("the colour is shifted by {du:+.1}, {dv:+.1} pixels (right, down) against the depth"),
            "register the depth to the colour camera again: surface colours and mask edges are affected",
        );
    }
    if let Some(focal) = report.focal.filter(|focal| focal.share != 0.0) {
        warnings.add(
            "poses",
            "focal_length_corrected",
            format!(
                "the images agree with a focal length that is {:+.2} % from the recorded one (±{:.2} %); it is used",
                1e2 * focal.share,
                1e2 * focal.sigma
            ),
            "calibrate the camera; with `poses.prior_focal_share = 0`, the recorded focal length is used",
        );
    }
    let list =
        |frames: Vec<usize>| frames.iter().take(8).map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let lonely = list(problem.frames_without_pairs());
    if !lonely.is_empty() {
        warnings.add(
            "poses",
            "poses_of_some_frames_kept",
            format!("frames {lonely} overlap too little with the others; their poses follow from the given ones and from the correction that all frames share"),
            "",
        );
    }
    let far = list(far.to_vec());
    if !far.is_empty() {
        warnings.add(
            "poses",
            "poses_far_off",
            format!("the poses of frames {far} were corrected by more than five times what is usual in this recording"),
            "inspect these frames: their pose or their time stamp may be wrong",
        );
    }
}
