//! The report of a refinement.

use crate::given::GivenNoise;
use crate::{CommonMode, Judgement, ModeKind, SizeUncertainty};
use glamx::DPose3;
use serde::{Deserialize, Serialize};
use sms_core::metrics::Metrics;
use sms_frames::DepthNoise;

/// Correction of one frame, relative to the given pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseCorrection {
    /// Position in the sequence.
    pub frame: usize,
    /// Distance by which the camera was moved, metres.
    pub shift_m: f64,
    /// Angle by which it was turned, radians.
    pub turn_rad: f64,
}

/// The correction that all frames share, as of the pose of the camera on the body whose poses were given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct HandEye {
    /// Shift of the camera in its own axes, metres.
    pub shift_m: [f64; 3],
    /// Rotation vector in its own axes, radians.
    pub turn_rad: [f64; 3],
}

impl HandEye {
    pub(crate) fn of(pose: &DPose3) -> Self {
        Self { shift_m: pose.translation.to_array(), turn_rad: pose.rotation.to_scaled_axis().to_array() }
    }
}

/// The time offset between the given poses and the images: the pose of an image is that given so much later.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimeOffset {
    /// Its value, seconds.
    pub value_s: f64,
    /// Its standard deviation, seconds.
    pub sigma_s: f64,
}

impl TimeOffset {
    /// Returns whether it is more than chance.
    pub fn is_significant(&self) -> bool {
        self.value_s.abs() > 3.0 * self.sigma_s
    }
}

/// The focal length of the cameras against the recorded one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocalChange {
    /// Its difference as a share; 0 if that is not more than chance, or if held-out pairs do not agree better with it.
    pub share: f64,
    /// The standard deviation of the share.
    pub sigma: f64,
}

/// Estimated standard deviations of the given poses per axis, after the correction that they share.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct GivenSigma {
    /// Of a position, in the mean over the frames, metres.
    pub position_m: f64,
    /// Of a rotation, radians.
    pub rotation_rad: f64,
    /// Of the change of the position between consecutive frames, metres; `None` unless consecutive frames share most of
    /// their error, as with a drift.
    pub step_m: Option<f64>,
    /// Of the change of the rotation between consecutive frames, radians.
    pub step_rad: Option<f64>,
}

impl GivenSigma {
    pub(crate) fn of(noise: &GivenNoise, frames: usize) -> Self {
        let [rotation_rad, position_m] = noise.sigma(frames);
        let [step_rad, step_m] = noise.step_sigma(frames);
        Self { position_m, rotation_rad, step_m, step_rad }
    }
}

/// Origin of the poses that a refinement begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseOrigin {
    /// They are those of the recording.
    #[default]
    Recorded,
    /// They were estimated from the images, and moved rigidly to those of the recording.
    Estimated,
    /// They were estimated from the images of a recording without poses: their world is that of the first camera.
    EstimatedAlone,
}

impl PoseOrigin {
    fn word(self) -> &'static str {
        match self {
            Self::Recorded => "given",
            Self::Estimated | Self::EstimatedAlone => "estimated",
        }
    }
}

/// The decision on the poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseVerdict {
    /// Refinement was not requested.
    #[default]
    NotRequested,
    /// The refined poses are used.
    Refined,
    /// Refined poses promised to be no better, or were not significantly better (`auto`), so the given poses are used.
    GivenAreAsGood,
    /// The refined poses agree better, but differ from the given ones by a change that many frames share and that the noise of the
    /// given poses does not explain (`auto`), so the given poses are used.
    CommonChange,
    /// Nothing could be refined: too few frames, or no overlap.
    NotPossible,
}

/// Report of a refinement. Corrections and judgement are present even if the given poses were kept.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PoseReport {
    /// Origin of the given poses.
    #[serde(default)]
    pub origin: PoseOrigin,
    /// The decision on the poses.
    pub verdict: PoseVerdict,
    /// Share by which a refinement promises to reduce the squares of all residuals, to first order; `None` unless `auto`
    /// asked. Less than 1 % is not tried.
    #[serde(default)]
    pub prospect: Option<f64>,
    /// Pairs of frames that were compared.
    pub pairs: usize,
    /// Iterations of all levels.
    pub iterations: usize,
    /// Estimated shift of the colour against the depth, pixels at loaded size (right, down).
    pub color_shift_px: [f64; 2],
    /// Focal length of the cameras; `None` without a refinement, or if it is not estimated.
    #[serde(default)]
    pub focal: Option<FocalChange>,
    /// The correction that all frames share; like all that follows, `None` without a refinement.
    #[serde(default)]
    pub hand_eye: Option<HandEye>,
    /// Time offset of the given poses; also `None` if the times of the frames are not known, or if it is not estimated.
    #[serde(default)]
    pub time_offset: Option<TimeOffset>,
    /// Noise of the given poses.
    #[serde(default)]
    pub given_sigma: Option<GivenSigma>,
    /// Standard deviation of the registration of two frames beyond the noise of their points, metres.
    #[serde(default)]
    pub pair_floor_m: Option<f64>,
    /// Depth noise that the differences between frames show.
    #[serde(default)]
    pub depth_noise: Option<DepthNoise>,
    /// Uncertainty of the scene's size; also `None` if it cannot be computed.
    #[serde(default)]
    pub size: Option<SizeUncertainty>,
    /// The change that many frames share and that is least like the noise of the given poses.
    #[serde(default)]
    pub common_mode: Option<CommonMode>,
    /// Correction of each frame.
    pub corrections: Vec<PoseCorrection>,
    /// Comparison of given and refined poses on held-out pairs.
    pub judgement: Judgement,
}

impl PoseReport {
    /// Returns the standard deviation of sizes and distances under the poses that are used, as a share; `None` if it is not known.
    pub fn relative_size_sigma(&self) -> Option<f64> {
        let estimated = self.size.as_ref().map(SizeUncertainty::relative_sigma);
        match (self.verdict, self.common_mode) {
            (PoseVerdict::Refined, _) => estimated,
            // The images contradict the poses that are used by this much.
            (PoseVerdict::CommonChange, mode) => {
                let size = |mode: CommonMode| match mode.kind {
                    ModeKind::Scale | ModeKind::Shear => mode.value.abs(),
                    ModeKind::SideShift => 0.0,
                };
                let of_images = [mode.map(size), self.focal.map(|focal| focal.share.abs()), estimated];
                of_images.into_iter().flatten().reduce(f64::max)
            }
            _ => None,
        }
    }

    /// Returns the median over frames of the corrections' lengths (metres) and angles (radians).
    pub fn median_correction(&self) -> Option<(f64, f64)> {
        let median = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        let shift = median(self.corrections.iter().map(|c| c.shift_m).collect())?;
        let turn = median(self.corrections.iter().map(|c| c.turn_rad).collect())?;
        Some((shift, turn))
    }

    /// Returns the largest correction: metres and radians.
    pub fn largest_correction(&self) -> (f64, f64) {
        self.corrections
            .iter()
            .fold((0.0, 0.0), |(s, t), c| (f64::max(s, c.shift_m), f64::max(t, c.turn_rad)))
    }

    /// Returns the figures for `metrics.json`.
    pub fn metrics(&self) -> Metrics {
        let mut m = Metrics::new();
        if self.verdict == PoseVerdict::NotRequested {
            return m;
        }
        let j = &self.judgement;
        m.set("poses.refined", self.verdict == PoseVerdict::Refined);
        if let Some(prospect) = self.prospect {
            m.set("poses.prospect", prospect);
        }
        if let Some(noise) = &self.depth_noise {
            m.set("poses.depth_noise_a_m", noise.a_m).set("poses.depth_noise_b_per_m", noise.b_per_m);
        }
        m.set("poses.pairs", self.pairs).set("poses.held_out_pairs", j.pairs);
        m.set("poses.iterations", self.iterations);
        if let Some((shift, turn)) = self.median_correction() {
            let (most_shift, most_turn) = self.largest_correction();
            m.set("poses.shift_median_m", shift).set("poses.shift_max_m", most_shift);
            m.set("poses.turn_median_rad", turn).set("poses.turn_max_rad", most_turn);
            m.set("poses.depth_before_m", j.before.depth_median_m)
                .set("poses.depth_after_m", j.after.depth_median_m);
            m.set("poses.color_before", j.before.color_median).set("poses.color_after", j.after.color_median);
            m.set("poses.color_shift_x_px", self.color_shift_px[0]);
            m.set("poses.color_shift_y_px", self.color_shift_px[1]);
            if let Some(focal) = &self.focal {
                m.set("poses.focal_share", focal.share).set("poses.focal_sigma", focal.sigma);
            }
            if let Some(time) = &self.time_offset {
                m.set("poses.time_offset_s", time.value_s).set("poses.time_offset_sigma_s", time.sigma_s);
            }
            if let Some(size) = &self.size {
                m.set("poses.scale_sigma", size.scale_sigma);
                m.set("poses.size_sigma_m", size.weakest().map(|e| e.sigma_m));
            }
            m.set("poses.common_mode_sigmas", self.common_mode.map(|mode| mode.ratio()));
            m.set("poses.depth_gain", j.depth.share).set("poses.depth_gain_t", j.depth.t);
            m.set("poses.color_gain", j.color.share).set("poses.color_gain_t", j.color.t);
        }
        m
    }

    /// Returns the errors of depth, colour and recorded poses as figures `check.*`.
    pub fn sensor_metrics(&self) -> Metrics {
        let mut m = Metrics::new();
        if let Some(noise) = &self.depth_noise {
            m.set("check.depth_noise_a_m", noise.a_m).set("check.depth_noise_b_per_m", noise.b_per_m);
        }
        m.set("check.color_shift_x_px", self.color_shift_px[0]);
        m.set("check.color_shift_y_px", self.color_shift_px[1]);
        if let Some(focal) = self.focal {
            m.set("check.focal_share", focal.share).set("check.focal_sigma", focal.sigma);
        }
        if let Some(time) = self.time_offset.filter(|_| self.origin == PoseOrigin::Recorded) {
            m.set("check.time_offset_s", time.value_s).set("check.time_offset_sigma_s", time.sigma_s);
        }
        if let Some(sigma) = self.given_sigma.filter(|_| self.origin == PoseOrigin::Recorded) {
            m.set("check.pose_sigma_m", sigma.position_m).set("check.pose_sigma_rad", sigma.rotation_rad);
        }
        m
    }

    /// Returns the errors of depth, colour and poses for people, a line each; empty if no frames could be compared. The depth noise
    /// is told for the given depths, metres, and the shift of the colour in pixels of which `pixel_scale` are one loaded pixel.
    pub fn sensor_lines(&self, depths_m: [f64; 2], pixel_scale: f64) -> Vec<String> {
        if self.pairs == 0 || self.verdict == PoseVerdict::NotPossible {
            return Vec::new();
        }
        let mut lines = Vec::new();
        if let Some(noise) = &self.depth_noise {
            let at = |z: f64| format!("{:.1} mm at {z:.2} m", 1e3 * noise.sigma_m(z));
            let [near, far] = depths_m.map(at);
            lines.push(format!("depth noise       {near}, {far}"));
        }
        let [du, dv] = self.color_shift_px.map(|v| pixel_scale * v);
        // A shift that the images do not show is held near zero.
        lines.push(if du.hypot(dv) < 0.05 {
            "colour            no shift against the depth is seen".to_owned()
        } else {
            format!("colour            {du:+.1}, {dv:+.1} pixels (right, down) beside the depth")
        });
        if let Some(focal) = self.focal {
            let (share, sigma) = (1e2 * focal.share, 1e2 * focal.sigma);
            lines.push(if focal.share == 0.0 {
                format!("focal length      as recorded (±{sigma:.2} %)")
            } else {
                format!("focal length      {share:+.2} % from the recorded one (±{sigma:.2} %)")
            });
        }
        let are_recorded = self.origin == PoseOrigin::Recorded;
        if let Some(time) = self.time_offset.filter(|_| are_recorded) {
            let (value, sigma) = (1e3 * time.value_s, 1e3 * time.sigma_s);
            lines.push(if time.is_significant() {
                let side = if value > 0.0 { "later" } else { "earlier" };
                format!(
                    "time offset       an image has the pose that is given {:.0} ms {side} (±{sigma:.0} ms)",
                    value.abs()
                )
            } else {
                format!("time offset       none between poses and images is seen (±{sigma:.0} ms)")
            });
        }
        if let (Some(sigma), Some(common), true) = (&self.given_sigma, &self.hand_eye, are_recorded) {
            let length = |v: [f64; 3]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
            lines.push(format!(
                "pose noise        ±{:.1} mm, ±{:.2}° each; a correction that all share: {:.1} mm, {:.2}°",
                1e3 * sigma.position_m,
                sigma.rotation_rad.to_degrees(),
                1e3 * length(common.shift_m),
                length(common.turn_rad).to_degrees()
            ));
        }
        lines
    }

    /// Returns a summary in one line.
    pub fn summary(&self) -> String {
        let noise = self.depth_noise.map(|n| format!("; depth noise {:.1} mm at 1 m", 1e3 * n.sigma_m(1.0)));
        let noise = noise.unwrap_or_default();
        let origin = self.origin.word();
        let Some((shift, turn)) = self.median_correction() else {
            return match self.verdict {
                PoseVerdict::NotRequested => format!("poses as {origin}"),
                PoseVerdict::GivenAreAsGood => {
                    format!("poses as {origin}: the frames agree within their noise{noise}")
                }
                _ => format!("poses as {origin}: the frames overlap too little to refine them"),
            };
        };
        let (j, mm) =
            (&self.judgement, |v: Option<f64>| v.map_or("–".to_owned(), |v| format!("{:.2}", 1e3 * v)));
        let residuals = format!(
            "held-out depth residual {} → {} mm, colour {:.1} → {:.1} levels",
            mm(j.before.depth_median_m),
            mm(j.after.depth_median_m),
            j.before.color_median.unwrap_or(0.0),
            j.after.color_median.unwrap_or(0.0)
        );
        let by = format!("{:.1} mm and {:.2}° (median)", 1e3 * shift, turn.to_degrees());
        match self.verdict {
            PoseVerdict::Refined => {
                let size = self.size.as_ref().map(|s| format!("; {}", s.summary())).unwrap_or_default();
                format!("poses refined by {by}: {residuals}{size}{noise}")
            }
            PoseVerdict::CommonChange => {
                let change = self.common_mode.map(|mode| mode.summary()).unwrap_or_default();
                format!("poses kept as {origin}: a refinement by {by} would {change}")
            }
            _ => format!("poses kept as {origin}: a refinement by {by} was no improvement ({residuals})"),
        }
    }
}
