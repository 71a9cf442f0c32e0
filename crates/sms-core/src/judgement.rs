//! Judgements of figures: good, fair or poor, with the reason.
//!
//! The limits come from measurements on generated recordings (`experiments/studies`) and from the program's own
//! assumptions; each function states its sources.

use crate::length_text;
use crate::metrics::Metrics;

/// A grade, best first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Grade {
    /// As good as the figures of sound inputs.
    Good,
    /// Usable, with larger errors than of sound inputs.
    Fair,
    /// Results that depend on it are not reliable.
    Poor,
}

impl Grade {
    /// Returns the name ("good").
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Poor => "poor",
        }
    }

    /// Returns the grade of a value of which less is better.
    fn at_most(value: f64, good: f64, fair: f64) -> Self {
        match value {
            v if v <= good => Self::Good,
            v if v <= fair => Self::Fair,
            // NaN is poor, too.
            _ => Self::Poor,
        }
    }
}

impl std::fmt::Display for Grade {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// The grade of a figure, with the reason in one clause.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Judgement {
    /// The grade.
    pub grade: Grade,
    /// The reason.
    pub reason: String,
}

impl std::fmt::Display for Judgement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({})", self.grade, self.reason)
    }
}

/// PSNR in dB above which a scan is good: scans of generated recordings have 29.1 to 33.9; those with poses off by 10 mm
/// or colour shifted by 3 px have 26.3 and less (`experiments/studies/scan.md` and `scan/poses.md`).
const GOOD_PSNR_DB: f64 = 28.0;
/// PSNR in dB at which the root mean square error is a tenth of full brightness: edges are visibly misplaced below it.
const FAIR_PSNR_DB: f64 = 20.0;

/// Judges the PSNR of rendered colour.
pub fn judge_psnr(db: f64) -> Judgement {
    let grade = Grade::at_most(-db, -GOOD_PSNR_DB, -FAIR_PSNR_DB);
    let error = 100.0 * 10f64.powf(-db / 20.0);
    let why = match grade {
        Grade::Good => "as scans with exact poses have",
        Grade::Fair => "less than scans with exact poses have; check poses and sharpness",
        Grade::Poor => "poses or sharpness differ between the frames; surfaces may still be right",
    };
    Judgement { grade, reason: format!("colour error {error:.1} %; {why}") }
}

/// Depth error in metres up to which a scan is good: the error of objects that planning assumes
/// (`plan.disturbances.object_m`). Scans of generated recordings have 1.3 to 1.9 mm.
const GOOD_DEPTH_M: f64 = 0.002;
/// Depth error in metres above which surfaces count as different ones (`scan.seeding.min_tolerance_m`).
const FAIR_DEPTH_M: f64 = 0.005;

/// Judges the mean absolute error of rendered depth, metres.
pub fn judge_depth_error(metres: f64) -> Judgement {
    let grade = Grade::at_most(metres, GOOD_DEPTH_M, FAIR_DEPTH_M);
    let reason = match grade {
        Grade::Good => format!("within the {} that planning assumes", length_text(GOOD_DEPTH_M)),
        Grade::Fair => format!("more than the {} that planning assumes", length_text(GOOD_DEPTH_M)),
        Grade::Poor => format!("more than {}, at which two surfaces are separate", length_text(FAIR_DEPTH_M)),
    };
    Judgement { grade, reason }
}

/// Judges the distance within which nine tenths of a body's surface lie from the known one, metres. The limits are those
/// of depth, because surfaces come from it.
pub fn judge_surface_error(p90_m: f64) -> Judgement {
    let grade = Grade::at_most(p90_m, GOOD_DEPTH_M, FAIR_DEPTH_M);
    Judgement { grade, reason: format!("90 % of the surface is within {}", length_text(p90_m)) }
}

/// Share of worlds in which a good plan succeeds: then the stated 90 % quantile is a success.
const GOOD_SUCCESS: f64 = 0.9;
/// Share of worlds from which a plan does not fail more often than it succeeds.
const FAIR_SUCCESS: f64 = 0.5;

/// Judges the share of perturbed worlds in which a plan succeeds, 0 to 1.
pub fn judge_success(share: f64) -> Judgement {
    let grade = Grade::at_most(-share, -GOOD_SUCCESS, -FAIR_SUCCESS);
    let reason = match grade {
        Grade::Good => "succeeds in 90 % of worlds or more",
        Grade::Fair => "succeeds in half of the worlds or more",
        Grade::Poor => "fails in more than half of the worlds",
    };
    Judgement { grade, reason: reason.to_owned() }
}

/// Largest motion of a body at rest, metres and radians: twice the limits for which `materialize` makes a body static
/// (`sms_sim::RestLimits`), so that a body that passed there is not reported for a difference between engines or
/// durations.
const REST: (f64, f64) = (0.002, std::f64::consts::PI / 180.0);

/// Returns whether a body that moved and turned this much in a simulation without action counts as resting: at most 2 mm
/// and 1°.
pub fn is_at_rest(moved_m: f64, turned_rad: f64) -> bool {
    moved_m <= REST.0 && turned_rad <= REST.1
}

/// Share of the recorded depth up to which a scene that does not explain it is good: single frames of a real recording (Azure
/// Kinect, refined poses) disagree with most other frames at this share of their pixels, which no scene can explain.
const GOOD_UNEXPLAINED: f64 = 0.10;
/// Share of the recorded depth above which a scene that does not explain it is poor: TSDFs of four real recordings leave 0.17 to
/// 0.59, so that a scene above this is worse than a plain fusion of a good recording.
const FAIR_UNEXPLAINED: f64 = 0.25;
/// Share of the recorded depth behind a false surface up to which a scene is good: the aim for real recordings.
const GOOD_FALSE: f64 = 0.02;
/// Share of the recorded depth behind a false surface above which a scene is poor: today's scenes of real recordings have 0.01 to
/// 0.05.
const FAIR_FALSE: f64 = 0.05;

/// Judges the agreement of the surfaces of a scene with recorded depth: the share of measured pixels that lies on them, and the
/// share that lies behind a false surface.
pub fn judge_depth_agreement(agrees: f64, false_surface: f64) -> Judgement {
    let unexplained = Grade::at_most(1.0 - agrees, GOOD_UNEXPLAINED, FAIR_UNEXPLAINED);
    let obstructed = Grade::at_most(false_surface, GOOD_FALSE, FAIR_FALSE);
    let reason = match (obstructed.max(unexplained), obstructed >= unexplained) {
        (Grade::Good, _) => "as well as frames of a recording agree with each other",
        (_, true) => "bodies reach into space that the camera looked through",
        (_, false) => "surfaces that the camera measured are missing from the scene",
    };
    Judgement { grade: obstructed.max(unexplained), reason: reason.into() }
}

/// Agreement of a scene with the recorded depth of a run: that of its held-out frames if there are any.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthAgreement {
    /// Share of the measured pixels on a surface of the scene.
    pub agrees: f64,
    /// Share of the measured pixels behind a false surface.
    pub false_surface: f64,
    /// Whether it is that of held-out frames.
    pub held_out: bool,
}

impl DepthAgreement {
    /// Reads `evaluate.*`; `None` where no comparison was made.
    pub fn of_run(metrics: &Metrics) -> Option<Self> {
        let of = |frames: &str, held_out: bool| {
            let share = |figure: &str| metrics.number(&format!("evaluate.{frames}depth_{figure}"));
            Some(Self { agrees: share("agrees")?, false_surface: share("false_surface")?, held_out })
        };
        of("holdout_", true).or_else(|| of("", false))
    }

    /// Judges it.
    pub fn judge(&self) -> Judgement {
        judge_depth_agreement(self.agrees, self.false_surface)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grades_change_at_their_limits() {
        use Grade::{Fair, Good, Poor};
        let grades = |judge: fn(f64) -> Judgement, values: [f64; 4]| values.map(|v| judge(v).grade);
        assert_eq!(grades(judge_psnr, [29.14, 26.28, 20.0, 18.7]), [Good, Fair, Fair, Poor]);
        assert_eq!(grades(judge_depth_error, [0.0013, 0.002, 0.005, 0.0051]), [Good, Good, Fair, Poor]);
        assert_eq!(grades(judge_success, [1.0, 0.9, 0.51, 0.4]), [Good, Good, Fair, Poor]);
        assert_eq!(grades(judge_surface_error, [0.0, 0.002, 0.005, 0.0051]), [Good, Good, Fair, Poor]);
        let agreement = [(0.95, 0.01), (0.9, 0.02), (0.84, 0.02), (0.95, 0.06), (0.6, 0.0), (f64::NAN, 0.0)];
        assert_ne!(judge_depth_agreement(0.84, 0.02).reason, judge_depth_agreement(0.95, 0.06).reason);
        let graded = agreement.map(|(agrees, wrong)| judge_depth_agreement(agrees, wrong).grade);
        assert_eq!(graded, [Good, Good, Fair, Poor, Poor, Poor]);
        for judge in [judge_psnr, judge_depth_error, judge_surface_error, judge_success] {
            assert_eq!(judge(f64::NAN).grade, Poor);
        }
        assert!(judge_psnr(20.0).to_string().starts_with("fair (colour error 10.0 %"));
    }

    #[test]
    fn held_out_frames_count_where_there_are_any() {
        let mut metrics = Metrics::new();
        assert_eq!(DepthAgreement::of_run(&metrics), None);
        metrics.set("evaluate.depth_agrees", 0.9).set("evaluate.depth_false_surface", 0.02);
        let all = DepthAgreement { agrees: 0.9, false_surface: 0.02, held_out: false };
        assert_eq!(DepthAgreement::of_run(&metrics), Some(all));
        metrics.set("evaluate.holdout_depth_agrees", 0.8).set("evaluate.holdout_depth_false_surface", 0.1);
        let held_out = DepthAgreement { agrees: 0.8, false_surface: 0.1, held_out: true };
        assert_eq!(DepthAgreement::of_run(&metrics), Some(held_out));
        assert_eq!(held_out.judge(), judge_depth_agreement(0.8, 0.1));
    }
}
