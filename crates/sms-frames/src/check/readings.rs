//! Comparison of readings of the recording: pose and axis convention, depth unit, pixel centre.

use super::overlap::{DepthSamples, Hypothesis, PairErrors, median};
use super::report::{axes_name, direction_name, other_center, reading_name, short};
use super::{CheckReport, Finding, OverlapError, PixelCenterFit, ReadingFit, Severity, UnitFit};
use crate::formats::to_opencv;
use crate::{Axes, PoseDirection, Recording, RecordingFormat};
use glamx::DPose3;
use rayon::prelude::*;

/// Candidate depth units, as factors on the declared one. 0.2 and 5: TUM's 1/5000 against millimetres.
const FACTORS: [f64; 15] =
    [1e-3, 1e-2, 0.0254, 0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 4.0, 5.0, 10.0, 39.37, 100.0, 1000.0];
/// Another reading is better if its error is below this share of the declared one's.
const BETTER: f64 = 0.6;
/// Readings with errors within this factor are indistinguishable.
const ALIKE: f64 = 1.4;
/// Minimum share of samples that must meet a depth, relative to the best reading.
const LEAST_SHARE: f64 = 0.1;

/// Readings are compared on every fourth sample: their errors differ by far more than chance.
const EVERY: usize = 4;

/// Depth images and the pairs between them.
pub(super) struct CheckData<'a> {
    recording: &'a Recording,
    probes: Vec<DepthSamples>,
    bases: Vec<usize>,
}

/// Error of one hypothesis over all pairs.
#[derive(Debug, Clone, Copy)]
struct Fit {
    relative: f64,
    share: f64,
}

impl<'a> CheckData<'a> {
    pub(super) fn new(recording: &'a Recording, probes: Vec<DepthSamples>, bases: &[usize]) -> Self {
        Self { recording, probes, bases: bases.to_vec() }
    }

    fn declared(&self) -> Hypothesis {
        Hypothesis { unit_m: self.recording.depth_unit_m, center_shift: 0.0, every: 1 }
    }

    fn probe(&self, index: usize) -> Option<&DepthSamples> {
        self.probes.binary_search_by_key(&index, |p| p.index).ok().map(|i| &self.probes[i])
    }

    /// Returns the pairs of frames that can be compared: none without poses.
    fn pairs(&self, gap: usize) -> Vec<(&DepthSamples, &DepthSamples)> {
        let bases = if self.recording.has_poses { self.bases.as_slice() } else { &[] };
        bases.iter().filter_map(|&i| Some((self.probe(i)?, self.probe(i + gap)?))).collect()
    }

    fn errors(&self, gap: usize, poses: &[DPose3], hypothesis: &Hypothesis) -> Vec<PairErrors> {
        self.pairs(gap)
            .par_iter()
            .map(|(a, b)| a.carry_into(b, &poses[b.index].inv_mul(&poses[a.index]), hypothesis))
            .collect()
    }

    fn declared_poses(&self) -> Vec<DPose3> {
        self.recording.frames.iter().map(|f| f.x_rc).collect()
    }

    /// Returns the poses under another convention.
    fn poses_read_as(&self, axes: Axes, direction: PoseDirection) -> Vec<DPose3> {
        let (own_axes, own_direction) = (self.recording.axes, self.recording.poses);
        let written = |x_rc: DPose3| {
            // Turning the axes is its own inverse; undo it before the direction.
            let turned = to_opencv(x_rc, own_axes, PoseDirection::CameraToWorld);
            match own_direction {
                PoseDirection::CameraToWorld => turned,
                PoseDirection::WorldToCamera => turned.inverse(),
            }
        };
        self.recording.frames.iter().map(|f| to_opencv(written(f.x_rc), axes, direction)).collect()
    }

    /// Computes the median |Δdepth| over all pairs `gap` frames apart, as declared.
    pub(super) fn overlap(&self, gap: usize) -> Option<OverlapError> {
        let errors = self.errors(gap, &self.declared_poses(), &self.declared());
        let tried: usize = errors.iter().map(|e| e.tried).sum();
        let pairs = errors.iter().filter(|e| !e.absolute.is_empty()).count();
        let mut all: Vec<f64> = errors.into_iter().flat_map(|e| e.absolute).collect();
        let share = all.len() as f64 / tried.max(1) as f64;
        Some(OverlapError { median_m: median(&mut all)?, share, pairs })
    }

    /// Returns the index of the first frame and the median |Δdepth| of each pair, as declared.
    pub(super) fn pair_medians(&self, gap: usize) -> Vec<(usize, f64)> {
        let errors = self.errors(gap, &self.declared_poses(), &self.declared());
        let medians =
            errors.into_iter().map(|mut e| (e.absolute.len() >= 30).then(|| median(&mut e.absolute))?);
        self.pairs(gap).iter().map(|(a, _)| a.index).zip(medians).filter_map(|(i, m)| Some((i, m?))).collect()
    }

    /// Returns the gap at which readings are compared: the wider one if the recording is long enough.
    fn gap(&self) -> usize {
        if self.pairs(4).is_empty() { 1 } else { 4 }
    }

    fn fit(&self, poses: &[DPose3], hypothesis: &Hypothesis) -> Fit {
        let errors = self.errors(self.gap(), poses, hypothesis);
        let tried: usize = errors.iter().map(|e| e.tried).sum();
        let mut all: Vec<f64> = errors.into_iter().flat_map(|e| e.relative).collect();
        let share = all.len() as f64 / tried.max(1) as f64;
        Fit { relative: median(&mut all).unwrap_or(f64::INFINITY), share }
    }
}

/// Fills the report's comparisons and adds the findings that follow from them.
pub(super) fn judge(data: &CheckData<'_>, report: &mut CheckReport) {
    if data.pairs(data.gap()).is_empty() {
        let lack = if report.has_poses { "on a single frame" } else { "without camera poses" };
        report.findings.push(Finding {
            severity: Severity::Info,
            code: if report.has_poses { "cannot_compare" } else { "no_poses" },
            what: format!("conventions and units cannot be checked {lack}"),
            cure: String::new(),
        });
        return;
    }
    let (axes, poses) = (report.axes, report.poses);
    let mut readings = vec![(axes, poses)];
    for d in [PoseDirection::CameraToWorld, PoseDirection::WorldToCamera] {
        for a in [Axes::Opencv, Axes::Opengl] {
            if (a, d) != (axes, poses) {
                readings.push((a, d));
            }
        }
    }
    let table: Vec<Vec<Fit>> = readings
        .iter()
        .map(|&(a, d)| {
            let poses = data.poses_read_as(a, d);
            let unit = data.recording.depth_unit_m;
            FACTORS
                .iter()
                .map(|f| data.fit(&poses, &Hypothesis { unit_m: unit * f, center_shift: 0.0, every: EVERY }))
                .collect()
        })
        .collect();
    let most = table.iter().flatten().fold(0.0f64, |m, f| m.max(f.share));
    let error = |r: usize, f: usize| {
        let fit = table[r][f];
        if fit.share >= LEAST_SHARE * most { fit.relative } else { f64::INFINITY }
    };
    let one = FACTORS.iter().position(|&f| f == 1.0).unwrap_or(0);
    let finite = |e: f64| e.is_finite().then_some(e);
    report.readings = readings
        .iter()
        .enumerate()
        .map(|(r, &(axes, poses))| ReadingFit {
            axes,
            poses,
            relative_error: finite(error(r, one)),
            share: table[r][one].share,
        })
        .collect();
    report.units = FACTORS
        .iter()
        .enumerate()
        .map(|(f, &factor)| UnitFit { factor, relative_error: finite(error(0, f)) })
        .collect();

    // Chooses the fewest faults that explain the data: none, a convention or a unit, both.
    let better = |candidate: f64, present: f64| candidate < BETTER * present && present - candidate > 5e-4;
    let (mut reading, mut factor, mut least) = (0, one, error(0, one));
    let single = (0..readings.len()).map(|r| (r, one)).chain((0..FACTORS.len()).map(|f| (0, f)));
    let both = (0..readings.len()).flat_map(|r| (0..FACTORS.len()).map(move |f| (r, f)));
    for candidates in [single.collect::<Vec<_>>(), both.collect::<Vec<_>>()] {
        let best = candidates.into_iter().min_by(|a, b| error(a.0, a.1).total_cmp(&error(b.0, b.1)));
        if let Some((r, f)) = best
            && better(error(r, f), least)
        {
            (reading, factor, least) = (r, f, error(r, f));
        }
    }
    if !least.is_finite() {
        report.findings.push(Finding {
            severity: Severity::Warning,
            code: "no_overlap",
            what: "frames four apart do not overlap, so conventions and units cannot be checked".to_owned(),
            cure: "record with more overlap between frames".to_owned(),
        });
        return;
    }
    let format = data.recording.format;
    if reading != 0 {
        let (a, d) = readings[reading];
        report.findings.push(convention_fault((axes, poses), (a, d), [error(0, factor), least], format));
    } else {
        let rivals: Vec<String> = (1..readings.len())
            .filter(|&r| error(r, factor) < ALIKE * least)
            .map(|r| reading_name(readings[r].0, readings[r].1))
            .collect();
        if !rivals.is_empty() {
            report.findings.push(Finding {
                severity: Severity::Info,
                code: "convention_not_told",
                what: format!(
                    "the poses may be {} as declared or {}: the camera moves too little to decide",
                    reading_name(axes, poses),
                    rivals.join(" or ")
                ),
                cure: "trust the declaration, or record with more movement".to_owned(),
            });
        }
    }
    judge_unit(data, report, readings[reading], FACTORS[factor], least, |f| error(reading, f));
    judge_pixel_center(data, report);
}

fn convention_fault(
    declared: (Axes, PoseDirection),
    best: (Axes, PoseDirection),
    errors: [f64; 2],
    format: RecordingFormat,
) -> Finding {
    let [was, is] =
        errors.map(|e| if e.is_finite() { format!("{:.1} %", 100.0 * e) } else { "no overlap".to_owned() });
    let mut what = Vec::new();
    let mut cure = Vec::new();
    let in_file = format == RecordingFormat::Nerfstudio;
    if best.0 != declared.0 {
        let name = axes_name(best.0);
        what.push(format!("declared axes are {} but the data fits {name}", axes_name(declared.0)));
        let value = name.to_lowercase();
        cure.push(if in_file {
            format!(
                "set \"camera_convention\": \"{value}\" in transforms.json (or `--set read.axes={value}`)"
            )
        } else {
            format!("use `--set read.axes={value}`")
        });
    }
    if best.1 != declared.1 {
        let name = direction_name(best.1);
        what.push(format!("poses are declared {} but the data fits {name}", direction_name(declared.1)));
        let value = name.replace('-', "_");
        cure.push(if in_file {
            format!("invert the poses, or set \"pose_convention\": \"{value}\" in transforms.json")
        } else {
            format!("invert the poses, or use `--set read.poses={value}`")
        });
    }
    Finding {
        severity: Severity::Fault,
        code: if best.0 != declared.0 { "wrong_axes" } else { "wrong_pose_direction" },
        what: format!("{} (overlap error {is} of depth instead of {was})", what.join(", and ")),
        cure: cure.join("; "),
    }
}

fn judge_unit(
    data: &CheckData<'_>,
    report: &mut CheckReport,
    reading: (Axes, PoseDirection),
    factor: f64,
    least: f64,
    error: impl Fn(usize) -> f64,
) {
    // If the camera hardly moves, any larger unit fits as well: its motion vanishes beside the depth.
    let far = error(FACTORS.len() - 1);
    if far < ALIKE * least {
        report.findings.push(Finding {
            severity: Severity::Info,
            code: "unit_not_told",
            what: "the depth unit cannot be checked: the camera moves too little against the depth noise"
                .to_owned(),
            cure: "trust the declaration, or record with more movement".to_owned(),
        });
        return;
    }
    let poses = data.poses_read_as(reading.0, reading.1);
    let unit = data.recording.depth_unit_m;
    let at = |log: f64| {
        data.fit(&poses, &Hypothesis { unit_m: unit * log.exp(), center_shift: 0.0, every: EVERY }).relative
    };
    let refined = golden_minimum(at, factor.ln() - 0.5, factor.ln() + 0.5).exp();
    report.best_unit_factor = Some(refined);
    if factor == 1.0 {
        if (refined - 1.0).abs() > 0.1 {
            report.findings.push(Finding {
                severity: Severity::Warning,
                code: "depth_scale",
                what: format!("depth fits the poses best when multiplied by {refined:.2}"),
                cure: "check the depth unit and that the poses are metric".to_owned(),
            });
        }
        return;
    }
    let right = nice_unit(unit * refined);
    let times = if factor < 1.0 { 1.0 / refined } else { refined };
    let (too, opposite) = if factor < 1.0 { ("large", "small") } else { ("small", "large") };
    let times = times_word(times);
    let middle = report.depth_range_m[1] * factor;
    let cure = if (0.08..15.0).contains(&middle) {
        format!(
            "set depth_unit_scale_factor to {} (it is {}); if the depth is right, the poses' translations are {times} \
             too {opposite}",
            short(right),
            short(unit)
        )
    } else {
        format!(
            "the depth itself is plausible, so the poses' translations are {times} too {opposite}: write them in metres"
        )
    };
    report.findings.push(Finding {
        severity: Severity::Fault,
        code: "wrong_depth_unit",
        what: format!(
            "the depth unit is {times} too {too} for the poses (overlap error {:.1} % of depth instead of {})",
            100.0 * least,
            report.units.iter().find(|u| u.factor == 1.0).and_then(|u| u.relative_error).map_or_else(
                || "no overlap".to_owned(),
                |e| format!("{:.1} %", 100.0 * e)
            )
        ),
        cure,
    });
}

fn times_word(times: f64) -> String {
    for (n, word) in [
        (2.0, "two"),
        (4.0, "four"),
        (5.0, "five"),
        (10.0, "ten"),
        (100.0, "a hundred"),
        (1000.0, "a thousand"),
    ] {
        if (times / n - 1.0f64).abs() < 0.12 {
            return format!("{word} times");
        }
    }
    format!("{times:.1} times")
}

/// Rounds to a unit that depth cameras use if one is within 12 %.
fn nice_unit(unit: f64) -> f64 {
    [1.0, 0.01, 0.001, 0.0005, 0.000_25, 0.0002, 0.000_125, 0.0001, 1e-5, 1e-6]
        .into_iter()
        .find(|n| (unit / n - 1.0).abs() < 0.12)
        .unwrap_or(unit)
}

/// Golden-section search: over the log of the factor, the error has a single minimum near the best candidate.
fn golden_minimum(f: impl Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    let ratio = 0.5 * (5.0f64.sqrt() - 1.0);
    let (mut c, mut d) = (b - ratio * (b - a), a + ratio * (b - a));
    let (mut fc, mut fd) = (f(c), f(d));
    for _ in 0..14 {
        if fc < fd {
            (b, d, fd) = (d, c, fc);
            c = b - ratio * (b - a);
            fc = f(c);
        } else {
            (a, c, fc) = (c, d, fd);
            d = a + ratio * (b - a);
            fd = f(d);
        }
    }
    0.5 * (a + b)
}

/// Compares pixel centres at 0 and 0.5 pair by pair, so that differences between pairs do not hide the effect.
fn judge_pixel_center(data: &CheckData<'_>, report: &mut CheckReport) {
    if report.findings.iter().any(|f| f.severity == Severity::Fault) {
        return;
    }
    let declared = report.pixel_center;
    let other = other_center(declared);
    let poses = data.declared_poses();
    let gap = data.gap();
    let as_declared = data.errors(gap, &poses, &data.declared());
    let shifted = Hypothesis { center_shift: declared - other, ..data.declared() };
    let as_other = data.errors(gap, &poses, &shifted);
    let mut all: Vec<f64> = as_declared.iter().flat_map(|e| e.absolute.iter().copied()).collect();
    let Some(middle) = median(&mut all) else { return };
    let cost = |e: &PairErrors| {
        // Differences beyond four medians come from another surface.
        let limit = 4.0 * middle.max(1e-9);
        e.absolute.iter().map(|v| v.min(limit)).sum::<f64>() / e.absolute.len() as f64
    };
    let pairs: Vec<(f64, f64)> = as_declared
        .iter()
        .zip(&as_other)
        .filter(|(a, b)| a.absolute.len() >= 100 && b.absolute.len() >= 100)
        .map(|(a, b)| (cost(a), cost(b)))
        .collect();
    let n = pairs.len() as f64;
    if pairs.len() < 6 {
        return;
    }
    let mean_cost = pairs.iter().map(|p| p.0).sum::<f64>() / n;
    let mean = pairs.iter().map(|p| p.1 - p.0).sum::<f64>() / n;
    let variance = pairs.iter().map(|p| (p.1 - p.0 - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let t = mean / (variance / n).sqrt().max(1e-15);
    let fit = PixelCenterFit {
        better: if mean >= 0.0 { declared } else { other },
        gain: mean.abs() / mean_cost.max(1e-15),
        t,
        significant: t.abs() > 4.0 && mean.abs() > 0.01 * mean_cost,
    };
    report.pixel_center_fit = Some(fit);
    if fit.significant && fit.better == other {
        report.findings.push(Finding {
            severity: Severity::Warning,
            code: "pixel_center",
            what: format!(
                "pixel centres at {} fit better than at {} as declared (overlap error {:.1} % smaller)",
                short(other),
                short(declared),
                100.0 * fit.gain
            ),
            cure: format!(
                "set \"pixel_center\": {0} in transforms.json, or use `--set read.pixel_center={0}`",
                short(other)
            ),
        });
    }
}
