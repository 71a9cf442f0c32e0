//! Checks of the declared conventions against the data: the depth of one frame, carried into another, must agree with the
//! depth measured there.

mod overlap;
mod readings;
mod report;

pub use report::{CheckReport, Finding, OverlapError, PixelCenterFit, ReadingFit, Severity, UnitFit};

use crate::attached::{DepthView, MOST_VIEWS, attached};
use crate::depth_file::read_depth;
use crate::load::{load_depth, selected_frames};
use crate::{FramesError, LoadSettings, Notice, Recording, evenly_spread, target_intrinsics};
use overlap::{DepthSamples, median};
use rayon::prelude::*;
use readings::CheckData;
use sms_core::{Camera, Cancel, DepthImage, Image, Progress, read_color};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};

/// Depth pixels held in memory at once.
const PIXEL_BUDGET: usize = 120_000_000;
/// Maximum number of frames from which depth is carried over.
const MOST_BASES: usize = 100;
/// Reported distances between frames, in frames.
const GAPS: [usize; 2] = [1, 4];

/// Result of one pass over a frame's files.
struct Scanned {
    valid: usize,
    pixels: usize,
    /// Number of pixels in gaps along its rows, by the length of the gap.
    gap_pixels: BTreeMap<usize, usize>,
    /// A sample of the valid depths, metres.
    depths: Vec<f64>,
    raw: Option<Image<u16>>,
}

/// Checks a recording: reads every image, measures the overlap error, and compares the declared conventions, depth
/// unit and pixel centre with the common alternatives.
///
/// # Errors
/// [`FramesError::Input`] naming the file that is missing, damaged or empty; [`FramesError::Interrupted`] when cancelled.
/// Conventions that do not fit are reported as [`Finding`]s, not as errors.
pub fn check(
    recording: &Recording,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<CheckReport, FramesError> {
    let n = recording.frames.len();
    let bases = bases(recording);
    let needed: BTreeSet<usize> =
        bases.iter().flat_map(|&i| [i, i + GAPS[0], i + GAPS[1]]).filter(|&i| i < n).collect();
    progress.begin("check", n as u64);
    let done = AtomicU64::new(0);
    let scanned: Vec<Result<Scanned, FramesError>> = (0..n)
        .into_par_iter()
        .map(|i| {
            cancel.check()?;
            let frame = scan_frame(recording, i, needed.contains(&i));
            progress.update(done.fetch_add(1, Ordering::Relaxed) + 1, &format!("frame {i}"));
            frame
        })
        .collect();
    let mut scanned = scanned.into_iter().collect::<Result<Vec<_>, _>>()?;
    if scanned.iter().all(|s| s.valid == 0) {
        return Err(recording.without_depth().into());
    }
    let probes: Vec<DepthSamples> = scanned
        .iter_mut()
        .enumerate()
        .filter_map(|(i, s)| s.raw.take().map(|raw| (i, raw)))
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|(i, raw)| DepthSamples::new(recording, i, raw))
        .collect();
    let data = CheckData::new(recording, probes, &bases);

    let mut depths: Vec<f64> = scanned.iter().flat_map(|s| s.depths.iter().copied()).collect();
    depths.sort_by(f64::total_cmp);
    let quantile = |q: f64| depths[((depths.len() - 1) as f64 * q).round() as usize];
    let pixels: usize = scanned.iter().map(|s| s.pixels).sum();
    let valid: usize = scanned.iter().map(|s| s.valid).sum();
    let first = &recording.frames[0];
    let depth_k = first.depth_lens.intrinsics;
    let finding = |notice: &Notice| Finding {
        severity: Severity::Warning,
        code: notice.code,
        what: notice.message.clone(),
        cure: notice.cure.clone(),
    };
    let mut report = CheckReport {
        source: recording.root.clone(),
        format: recording.format,
        frames: n,
        color_size: (first.color_lens.intrinsics.width, first.color_lens.intrinsics.height),
        depth_size: (depth_k.width, depth_k.height),
        lens: first.color_lens,
        lens_varies: recording.frames.iter().any(|f| f.color_lens != first.color_lens),
        axes: recording.axes,
        poses: recording.poses,
        has_poses: recording.has_poses,
        depth_unit_m: recording.depth_unit_m,
        pixel_center: recording.pixel_center,
        valid_depth_share: valid as f64 / pixels.max(1) as f64,
        depth_gap_px: middle_gap(scanned.iter().map(|s| &s.gap_pixels)),
        depth_range_m: [quantile(0.01), quantile(0.5), quantile(0.99)],
        pose_rounding: recording.frames.iter().fold(0.0, |m, f| m.max(f.pose_rounding)),
        camera_path_m: recording
            .frames
            .windows(2)
            .map(|w| (w[1].x_rc.translation - w[0].x_rc.translation).length())
            .sum(),
        overlap_1: data.overlap(GAPS[0]),
        overlap_4: data.overlap(GAPS[1]),
        readings: Vec::new(),
        units: Vec::new(),
        best_unit_factor: None,
        pixel_center_fit: None,
        findings: recording.notices.iter().map(finding).collect(),
    };
    readings::judge(&data, &mut report);
    judge_quality(&data, &mut report);
    if recording.has_poses && report.approved() {
        report.findings.extend(attached_finding(recording, cancel)?);
    }
    report.findings.sort_by_key(|f| std::cmp::Reverse(f.severity));
    progress.end(match (report.approved(), report.has_poses) {
        (true, true) => "the declared conventions fit the data",
        (true, false) => "every image can be read",
        (false, _) => "faults were found",
    });
    Ok(report)
}

/// Reports pixels that show something attached to the camera.
fn attached_finding(recording: &Recording, cancel: &Cancel) -> Result<Option<Finding>, FramesError> {
    let settings = LoadSettings::default();
    let views: Vec<Result<Option<(Camera, DepthImage)>, FramesError>> =
        evenly_spread(recording.frames.len(), MOST_VIEWS)
            .into_par_iter()
            .map(|i| {
                cancel.check()?;
                let frame = &recording.frames[i];
                let intrinsics = target_intrinsics(&frame.color_lens, settings.long_side);
                // An empty image was reported or accepted before.
                let depth = load_depth(recording, i, &intrinsics, &settings.noise).ok();
                Ok(depth.map(|depth| (Camera::new(intrinsics, frame.x_rc), depth)))
            })
            .collect();
    let views: Vec<(Camera, DepthImage)> =
        views.into_iter().filter_map(Result::transpose).collect::<Result<_, _>>()?;
    let views: Vec<DepthView<'_>> = views
        .iter()
        .map(|(camera, depth)| DepthView { camera, depth, noise: settings.noise, color: None })
        .collect();
    Ok(attached(&views, cancel).map(|found| Finding {
        severity: Severity::Info,
        code: "attached_to_camera",
        what: found.message(),
        cure: String::new(),
    }))
}

/// Returns the frames from which depth is carried over, evenly spread, within the memory budget.
fn bases(recording: &Recording) -> Vec<usize> {
    let k = recording.frames[0].depth_lens.intrinsics;
    // Each base may need three images; neighbours share theirs.
    let affordable = PIXEL_BUDGET / (k.width * k.height).max(1);
    let n = recording.frames.len();
    let most = if n <= affordable { MOST_BASES } else { (affordable / 3).clamp(4, MOST_BASES) };
    let stride = n.div_ceil(most.min(n));
    selected_frames(recording, &crate::LoadSettings { stride, ..crate::LoadSettings::default() })
}

/// Returns the length of the gap that the median pixel without depth lies in; 0 without such pixels.
fn middle_gap<'a>(frames: impl Iterator<Item = &'a BTreeMap<usize, usize>>) -> usize {
    let mut pixels: BTreeMap<usize, usize> = BTreeMap::new();
    frames.flatten().for_each(|(length, count)| *pixels.entry(*length).or_default() += count);
    let all: usize = pixels.values().sum();
    let mut below = 0;
    for (length, count) in pixels {
        below += count;
        if 2 * below >= all {
            return length;
        }
    }
    0
}

fn scan_frame(recording: &Recording, index: usize, keep: bool) -> Result<Scanned, FramesError> {
    let frame = &recording.frames[index];
    read_color(&frame.color_path)?;
    let raw = read_depth(&frame.depth_path)?;
    let valid = raw.data.iter().filter(|&&v| v > 0).count();
    if valid == 0 && !recording.options.skip_empty_depth {
        // The reader's message names the file and the cure.
        recording.read_depth_m(index)?;
    }
    let mut gap_pixels = BTreeMap::new();
    for row in raw.data.chunks_exact(raw.width.max(1)) {
        for length in row.split(|&v| v > 0).map(<[u16]>::len).filter(|&length| length > 0) {
            *gap_pixels.entry(length).or_default() += length;
        }
    }
    let stride = (valid / 500).max(1);
    let unit = recording.depth_unit_m;
    let depths = raw.data.iter().filter(|&&v| v > 0).step_by(stride).map(|&v| f64::from(v) * unit).collect();
    Ok(Scanned { valid, pixels: raw.data.len(), gap_pixels, depths, raw: keep.then_some(raw) })
}

/// Adds findings on the recording's quality, which other conventions would not cure.
fn judge_quality(data: &CheckData<'_>, report: &mut CheckReport) {
    let faulty = !report.approved();
    let middle = report.depth_range_m[1];
    let mut add = |code, what: String, cure: &str| {
        report.findings.push(Finding { severity: Severity::Warning, code, what, cure: cure.to_owned() });
    };
    if report.valid_depth_share < 0.15 {
        add(
            "sparse_depth",
            format!("only {:.0} % of the depth pixels hold a measurement", 100.0 * report.valid_depth_share),
            "record from nearer, avoid shiny and dark surfaces, or register depth to colour with hole filling off",
        );
    }
    if report.frames < 5 {
        add(
            "few_frames",
            format!("there are only {} frames", report.frames),
            "record 20 frames or more from around the scene",
        );
    }
    if faulty {
        // The other findings would only repeat the fault.
        return;
    }
    if !(0.08..15.0).contains(&middle) {
        add(
            "implausible_depth",
            format!("the median depth is {middle:.3} m, outside the range of most depth cameras"),
            "check depth_unit_scale_factor: 0.001 if the images hold millimetres",
        );
    }
    let mut by_pair = data.pair_medians(GAPS[0]);
    let mut medians: Vec<f64> = by_pair.iter().map(|p| p.1).collect();
    if let Some(typical) = median(&mut medians) {
        by_pair.retain(|p| p.1 > (8.0 * typical).max(0.01));
        if !by_pair.is_empty() {
            let list: Vec<String> =
                by_pair.iter().take(8).map(|p| format!("{} → {}", p.0, p.0 + 1)).collect();
            add(
                "pose_jumps",
                format!(
                    "{} of the checked pairs of neighbouring frames disagree: {}",
                    by_pair.len(),
                    list.join(", ")
                ),
                "the poses of these frames are off; remove the frames or track the camera again",
            );
        }
        if typical > 0.02 * middle {
            add(
                "loose_overlap",
                format!("neighbouring frames differ by {:.1} mm (median) at {middle:.2} m", 1e3 * typical),
                "the scan corrects poses by default if that helps; or register depth to the colour camera",
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_gap_counts_pixels_and_not_gaps() {
        assert_eq!(middle_gap([].into_iter()), 0);
        // 30 single pixels, and 70 pixels in gaps of 20 to 30.
        let frames = [BTreeMap::from([(1, 20), (20, 40)]), BTreeMap::from([(1, 10), (30, 30)])];
        assert_eq!(middle_gap(frames.iter()), 20);
    }
}
