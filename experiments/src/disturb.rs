//! Disturbances of a loaded sequence, as by worse sensors and trackers.

use glamx::{DPose3, DQuat, DVec3};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sms_core::{ColorImage, Image, InputError, Seed, StageRng};
use sms_frames::{LoadSettings, Sequence, normals_from_depth};

/// Disturbance of the frames after loading and before masks; none by default. Each frame is disturbed independently.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Disturbance {
    /// Root mean square of the length of the shift of a camera, metres: each component is normal with this over √3.
    pub pose_shift_m: f64,
    /// Root mean square of the angle by which a camera is turned, radians: the components of the rotation vector are
    /// normal with this over √3.
    pub pose_turn_rad: f64,
    /// Additional white depth noise: standard deviation at 1 m, growing with the square of depth, metres.
    pub depth_noise_m: f64,
    /// Share of the pixels with depth that lose it, at random.
    pub missing: f64,
    /// Shift of colour to the right against depth, pixels of the loaded frames.
    pub color_shift_px: i64,
}

impl Disturbance {
    /// Whether poses are disturbed, so that a result must be aligned before it is measured.
    pub fn disturbs_poses(&self) -> bool {
        self.pose_shift_m > 0.0 || self.pose_turn_rad > 0.0
    }

    /// Whether nothing is disturbed.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Disturbs every frame; normals are computed again where depth was changed.
    pub fn apply(&self, sequence: &mut Sequence, load: &LoadSettings, seed: Seed) {
        for frame in &mut sequence.frames {
            let seed = seed.derive_index("disturbance", frame.index as u64);
            if self.disturbs_poses() {
                let mut rng = seed.derive("pose").rng();
                let x_wc = &mut frame.camera.x_wc;
                *x_wc = disturbed_pose(x_wc, self.pose_shift_m, self.pose_turn_rad, &mut rng);
            }
            if self.depth_noise_m > 0.0 || self.missing > 0.0 {
                let mut rng = seed.derive("depth").rng();
                for z in frame.depth.data.iter_mut().filter(|z| **z > 0.0) {
                    let noise = normal(&mut rng) * self.depth_noise_m * f64::from(*z).powi(2);
                    let lost = rng.random::<f64>() < self.missing;
                    *z = if lost { 0.0 } else { (f64::from(*z) + noise).max(0.0) as f32 };
                }
                let k = &frame.camera.intrinsics;
                frame.normal_c = normals_from_depth(&frame.depth, k, &load.noise, load.normal_radius);
            }
            if self.color_shift_px != 0 {
                frame.color = shifted(&frame.color, self.color_shift_px);
            }
        }
    }
}

/// Shifts and turns a camera at random, with these root mean squares of the length and of the angle.
pub(crate) fn disturbed_pose(x_wc: &DPose3, shift_m: f64, turn_rad: f64, rng: &mut StageRng) -> DPose3 {
    let third = 1.0 / 3f64.sqrt();
    let (shift, turn) = (normals(rng) * shift_m * third, normals(rng) * turn_rad * third);
    DPose3::from_parts(x_wc.translation + shift, (x_wc.rotation * DQuat::from_scaled_axis(turn)).normalize())
}

/// Returns an image whose content lies `by_px` pixels further to the right; its border is repeated.
pub(crate) fn shifted(source: &ColorImage, by_px: i64) -> ColorImage {
    let pixels = (0..source.data.len())
        .map(|i| {
            let (x, y) = ((i % source.width) as i64, i / source.width);
            let from = (x - by_px).clamp(0, source.width as i64 - 1);
            source[(from as usize, y)]
        })
        .collect();
    Image::from_vec(source.width, source.height, pixels)
}

/// Three standard normal numbers.
fn normals(rng: &mut StageRng) -> DVec3 {
    DVec3::from_array([(); 3].map(|()| normal(rng)))
}

/// A standard normal number: the sum of twelve uniform ones, which is near normal with unit variance.
fn normal(rng: &mut StageRng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

/// A length with its unit (`10mm`, `1cm`, `0.01m`) in metres; a plain number is metres.
///
/// # Errors
/// [`InputError`] naming the option.
pub fn parse_length_m(text: &str, option: &str) -> Result<f64, InputError> {
    parse(text, &[("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("", 1.0)], option, "a length such as 2mm")
}

/// `10mm,0.5deg`: a length and an angle (`deg` or `rad`), either alone or both.
///
/// # Errors
/// [`InputError`] naming the option.
pub fn parse_pose_noise(text: &str) -> Result<(f64, f64), InputError> {
    let (mut shift, mut turn) = (0.0, 0.0);
    for part in text.split(',').map(str::trim) {
        if part.ends_with("deg") || part.ends_with("rad") {
            let units = [("deg", 1f64.to_radians()), ("rad", 1.0)];
            turn = parse(part, &units, "--pose-noise", "10mm,0.5deg")?;
        } else {
            shift = parse(part, &[("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)], "--pose-noise", "10mm,0.5deg")?;
        }
    }
    Ok((shift, turn))
}

fn parse(text: &str, units: &[(&str, f64)], option: &str, example: &str) -> Result<f64, InputError> {
    units
        .iter()
        .find_map(|(unit, factor)| Some(text.strip_suffix(unit)?.trim().parse::<f64>().ok()? * factor))
        .filter(|v| v.is_finite() && *v >= 0.0)
        .ok_or_else(|| {
            InputError::new(format!("`{text}` is not understood"), option, format!("give {example}"))
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::{Camera, Intrinsics};
    use sms_frames::Frame;

    fn sequence(frames: usize) -> Sequence {
        let k = Intrinsics::from_fov(16, 8, 1.0);
        let frame = |index| Frame {
            index,
            ..Frame::new(
                Camera::new(k, DPose3::identity()),
                Image::from_vec(16, 8, (0..128).map(|i| [(i % 16) as u8; 3]).collect()),
                Image::filled(16, 8, 0.5),
                Image::filled(16, 8, [0.0, 0.0, -1.0]),
            )
        };
        Sequence {
            frames: (0..frames).map(frame).collect(),
            x_world_recording: DPose3::identity(),
            source: "test".into(),
        }
    }

    #[test]
    fn noise_has_the_size_that_was_asked_for() {
        let mut s = sequence(2000);
        let asked = Disturbance {
            pose_shift_m: 0.01,
            pose_turn_rad: 0.01,
            depth_noise_m: 0.004,
            missing: 0.66,
            color_shift_px: 3,
        };
        asked.apply(&mut s, &LoadSettings::default(), Seed(1));
        let rms = |f: &dyn Fn(&Frame) -> f64| {
            (s.frames.iter().map(|x| f(x).powi(2)).sum::<f64>() / s.len() as f64).sqrt()
        };
        assert!((rms(&|f| f.camera.x_wc.translation.length()) / 0.01 - 1.0).abs() < 0.04);
        assert!((rms(&|f| f.camera.x_wc.rotation.to_scaled_axis().length()) / 0.01 - 1.0).abs() < 0.04);
        let depths: Vec<f64> = s.frames.iter().flat_map(|f| &f.depth.data).map(|&z| f64::from(z)).collect();
        let kept: Vec<f64> = depths.iter().copied().filter(|z| *z > 0.0).collect();
        assert!((kept.len() as f64 / depths.len() as f64 - 0.34).abs() < 0.01);
        let sigma = (kept.iter().map(|z| (z - 0.5).powi(2)).sum::<f64>() / kept.len() as f64).sqrt();
        assert!((sigma / 0.001 - 1.0).abs() < 0.02, "{sigma}");
        assert_eq!(s.frames[0].color[(10, 2)], [7; 3]);
        assert_eq!(s.frames[0].color[(1, 2)], [0; 3]);
    }

    #[test]
    fn units_are_read() {
        assert_eq!(parse_pose_noise("10mm,0.5deg").unwrap(), (0.01, 0.5f64.to_radians()));
        assert_eq!(parse_pose_noise("1cm").unwrap(), (0.01, 0.0));
        assert_eq!(parse_length_m("2mm", "--depth-noise").unwrap(), 0.002);
        assert!(parse_pose_noise("ten").is_err() && parse_length_m("-1mm", "x").is_err());
    }
}
