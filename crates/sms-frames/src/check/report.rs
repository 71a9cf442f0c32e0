//! The report of `check`.

use crate::{Axes, Lens, PoseDirection, RecordingFormat};
use serde::Serialize;
use sms_core::counted;
use sms_core::metrics::Metrics;
use std::path::PathBuf;

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// For information.
    Info,
    /// The result will suffer.
    Warning,
    /// The recording is misread; a scan would be useless.
    Fault,
}

/// One finding of a check, and its cure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Its severity.
    pub severity: Severity,
    /// Stable identifier, `snake_case`.
    pub code: &'static str,
    /// The finding, with its figures.
    pub what: String,
    /// The cure; may be empty.
    pub cure: String,
}

/// Overlap error of depth carried from frame i into frame i + n.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OverlapError {
    /// Median |Δdepth|, metres.
    pub median_m: f64,
    /// Share of the carried samples that met a valid depth.
    pub share: f64,
    /// Pairs of frames.
    pub pairs: usize,
}

/// Fit of one pose and axis convention.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReadingFit {
    /// Camera axes.
    pub axes: Axes,
    /// Direction of the matrices.
    pub poses: PoseDirection,
    /// Median |Δdepth| / depth; `None` where too few samples meet.
    pub relative_error: Option<f64>,
    /// Share of the carried samples that met a valid depth.
    pub share: f64,
}

/// Fit of one depth unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct UnitFit {
    /// Factor on the declared unit.
    pub factor: f64,
    /// Median |Δdepth| / depth; `None` where too few samples meet.
    pub relative_error: Option<f64>,
}

/// Centre of pixel (0, 0) according to the data.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PixelCenterFit {
    /// The better of 0 and 0.5.
    pub better: f64,
    /// Reduction of the overlap error, as a share.
    pub gain: f64,
    /// Mean over standard error of the difference between the two over pairs of frames.
    pub t: f64,
    /// Whether the difference is significant and large enough to matter.
    pub significant: bool,
}

/// The result of [`crate::check`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckReport {
    /// The recording's folder.
    pub source: PathBuf,
    /// Its format.
    pub format: RecordingFormat,
    /// Number of frames.
    pub frames: usize,
    /// Colour image size of the first frame.
    pub color_size: (usize, usize),
    /// Depth image size of the first frame.
    pub depth_size: (usize, usize),
    /// Colour lens of the first frame, pixel centres at +0.5.
    pub lens: Lens,
    /// Whether the lens differs between frames.
    pub lens_varies: bool,
    /// Axes as declared.
    pub axes: Axes,
    /// Direction as declared.
    pub poses: PoseDirection,
    /// Whether the recording has camera poses.
    pub has_poses: bool,
    /// Depth unit as declared, metres.
    pub depth_unit_m: f64,
    /// Pixel centre as declared.
    pub pixel_center: f64,
    /// Share of depth pixels with a measurement.
    pub valid_depth_share: f64,
    /// Length along its row of the gap that the median pixel without depth lies in, pixels; 0 without gaps.
    pub depth_gap_px: usize,
    /// 1st, 50th and 99th percentile of valid depth, metres.
    pub depth_range_m: [f64; 3],
    /// Largest rounding removed from a rotation, entry of |RᵀR − I|.
    pub pose_rounding: f64,
    /// Length of the camera's path, metres.
    pub camera_path_m: f64,
    /// Overlap error into the next frame.
    pub overlap_1: Option<OverlapError>,
    /// Overlap error into the fourth frame after.
    pub overlap_4: Option<OverlapError>,
    /// The four conventions, the declared one first.
    pub readings: Vec<ReadingFit>,
    /// The ladder of depth units.
    pub units: Vec<UnitFit>,
    /// The refined factor on the declared unit that fits best; `None` if the data does not determine it.
    pub best_unit_factor: Option<f64>,
    /// Pixel centre, where it could be compared.
    pub pixel_center_fit: Option<PixelCenterFit>,
    /// The findings, the worst first.
    pub findings: Vec<Finding>,
}

impl CheckReport {
    /// Returns whether there is no finding of [`Severity::Fault`].
    pub fn approved(&self) -> bool {
        self.findings.iter().all(|f| f.severity < Severity::Fault)
    }

    /// Returns the figures for `metrics.json`.
    pub fn metrics(&self) -> Metrics {
        let mut metrics = Metrics::new();
        metrics.set("check.frames", self.frames);
        metrics.set("check.valid_depth_share", self.valid_depth_share);
        metrics.set("check.depth_gap_px", self.depth_gap_px);
        metrics.set("check.overlap_1_m", self.overlap_1.map(|o| o.median_m));
        metrics.set("check.overlap_4_m", self.overlap_4.map(|o| o.median_m));
        metrics
    }
}

impl std::fmt::Display for CheckReport {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let k = &self.lens.intrinsics;
        writeln!(out, "{} ({})", self.source.display(), self.format.name())?;
        let (cw, ch) = self.color_size;
        let (dw, dh) = self.depth_size;
        writeln!(out, "  frames            {}, colour {cw} × {ch}, depth {dw} × {dh}", self.frames)?;
        writeln!(
            out,
            "  intrinsics        fx {:.2}  fy {:.2}  cx {:.2}  cy {:.2} (pixel centres at +0.5){}{}",
            k.fx,
            k.fy,
            k.cx,
            k.cy,
            if self.lens.distortion.is_none() { "" } else { ", distorted" },
            if self.lens_varies { ", varying between frames" } else { "" }
        )?;
        let [near, middle, far] = self.depth_range_m;
        writeln!(
            out,
            "  depth             {:.0} % filled, {near:.3} to {far:.3} m (median {middle:.3}), unit {} m",
            100.0 * self.valid_depth_share,
            short(self.depth_unit_m)
        )?;
        if self.depth_gap_px > 0 {
            writeln!(out, "  missing depth     in gaps of {} pixels (median)", self.depth_gap_px)?;
        }
        if !self.has_poses {
            writeln!(out, "  poses             none: a scan estimates them from the images")?;
        } else {
            writeln!(
                out,
                "  poses             rigid (rounding up to {:.0e}), path {:.2} m",
                self.pose_rounding, self.camera_path_m
            )?;
        }
        for (name, overlap) in [("i → i+1", self.overlap_1), ("i → i+4", self.overlap_4)] {
            match overlap {
                Some(o) => writeln!(
                    out,
                    "  overlap {name}   {:.2} mm median over {}, {:.0} % of samples met",
                    1e3 * o.median_m,
                    counted(o.pairs, "pair", "pairs"),
                    100.0 * o.share
                )?,
                None => writeln!(out, "  overlap {name}   not measurable")?,
            }
        }
        for (i, r) in self.readings.iter().enumerate() {
            writeln!(
                out,
                "  {}  {:<26} {}",
                if i == 0 { "conventions     " } else { "                " },
                reading_name(r.axes, r.poses),
                error_text(r.relative_error, if i == 0 { " (declared)" } else { "" })
            )?;
        }
        let units: Vec<String> = self
            .units
            .iter()
            .filter_map(|u| u.relative_error.map(|e| format!("×{} {:.1} %", short(u.factor), 100.0 * e)))
            .collect();
        writeln!(
            out,
            "  depth unit        {}",
            if units.is_empty() { "not measurable".to_owned() } else { units.join(", ") }
        )?;
        if let Some(fit) = &self.pixel_center_fit {
            writeln!(
                out,
                "  pixel centre      {} declared; {}",
                short(self.pixel_center),
                if fit.significant {
                    format!(
                        "{} fits better than {} by {:.1} %",
                        short(fit.better),
                        short(other_center(fit.better)),
                        100.0 * fit.gain
                    )
                } else {
                    format!("the data does not distinguish 0 from 0.5 (difference {:.2} %)", 100.0 * fit.gain)
                }
            )?;
        }
        for f in &self.findings {
            let word = match f.severity {
                Severity::Info => "note",
                Severity::Warning => "WARNING",
                Severity::Fault => "FAULT",
            };
            writeln!(out, "{word}: {}", f.what)?;
            if !f.cure.is_empty() {
                writeln!(out, "  cure: {}", f.cure)?;
            }
        }
        if self.approved() && self.has_poses {
            writeln!(out, "The declared conventions fit the data.")?;
        }
        Ok(())
    }
}

/// Returns the pixel centre that is compared with this one: 0 or 0.5.
pub(super) fn other_center(center: f64) -> f64 {
    if center < 0.25 { 0.5 } else { 0.0 }
}

fn error_text(error: Option<f64>, suffix: &str) -> String {
    match error {
        Some(e) => format!("{:.2} % of depth{suffix}", 100.0 * e),
        None => format!("hardly any overlap{suffix}"),
    }
}

/// Returns the names of a convention for messages.
pub(super) fn reading_name(axes: Axes, poses: PoseDirection) -> String {
    format!("{} {}", direction_name(poses), axes_name(axes))
}

pub(super) fn axes_name(axes: Axes) -> &'static str {
    match axes {
        Axes::Opencv => "OpenCV",
        Axes::Opengl => "OpenGL",
    }
}

pub(super) fn direction_name(poses: PoseDirection) -> &'static str {
    match poses {
        PoseDirection::CameraToWorld => "camera-to-world",
        PoseDirection::WorldToCamera => "world-to-camera",
    }
}

/// Formats a number without trailing zeros.
pub(super) fn short(v: f64) -> String {
    let text = format!("{v:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
