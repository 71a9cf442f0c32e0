//! One exposure for all frames of a camera that sets exposure and white balance anew for each.
//!
//! Two frames that measure the same points tell the ratio of their gains, per channel: the median of the ratios of the points' colours.
//! Gains that explain all ratios are fitted by least squares. Stored colours are close to a power of light, so that exposure
//! multiplies them, too. Reflections differ between frames as well: gains that vary by no more than those are left alone.

use crate::Frame;
use rayon::prelude::*;
use sms_core::{Cancel, ColorImage, QuantileRule, quantile};
use std::ops::RangeInclusive;

/// Distance between the pixels that are compared.
const STRIDE: usize = 4;
/// Least number of points that two frames share.
const LEAST_SHARED: usize = 100;
/// Stored colours that are neither lost in noise nor cut off.
const RANGE: RangeInclusive<u8> = 16..=239;
/// Depths of one surface differ by at most this share, or by their noise.
const ALIKE: f64 = 0.01;
/// Standard deviation of the logarithm of the ratio of two colours of a point: texture and errors of poses.
const POINT_SIGMA: f64 = 0.1;
/// Standard deviation of the logarithm of the ratio of two frames that share many points: reflections and shadows.
const RATIO_SIGMA: f64 = 0.02;
/// Standard deviation of the logarithm of a gain before anything is seen.
const GAIN_SIGMA: f64 = 0.3;
/// Least standard deviation of the logarithms of gains over the frames that is a matter of exposure. Reflections alone have 0.03 in
/// generated scenes of fixed exposure, where a correction costs 0.3 dB; a real bin has 0.02, a shelf 0.13 and a kitchen 0.3
/// (experiments/studies/scan/fused.md).
const LEAST_SIGMA: f64 = 0.05;
/// Residual at which the gains are solved for, as a share of that of equal gains.
const RESIDUAL: f64 = 1e-9;

/// Logarithms of the gains of a frame, per channel.
type LogGain = [f64; 3];

/// Divides the colours of all frames by their gains if exposure or white balance varies, and returns the least and the greatest gain.
pub(crate) fn equalize(frames: &mut [Frame], cancel: &Cancel) -> Option<(f64, f64)> {
    let gains = log_gains(frames, cancel);
    if cancel.is_cancelled() || !varies(&gains) {
        return None;
    }
    frames.par_iter_mut().zip(&gains).for_each(|(frame, log)| {
        frame.gain = log.map(|log| log.exp() as f32);
        divide(&mut frame.color, &frame.gain);
    });
    let all = || gains.iter().flatten().copied();
    Some((all().fold(f64::INFINITY, f64::min).exp(), all().fold(f64::NEG_INFINITY, f64::max).exp()))
}

/// Divides colours by a gain per channel. What becomes brighter than 255 is cut off, and what the camera cut off remains so: divided, white
/// would have the colour of the gains.
pub(crate) fn divide(color: &mut ColorImage, gain: &[f32; 3]) {
    if *gain == [1.0; 3] {
        return;
    }
    let last = f32::from(*RANGE.end());
    let divided = |value: u8, gain: f32| {
        let value = f32::from(value);
        let cut_off = ((value - last) / (255.0 - last)).max(0.0);
        ((1.0 - cut_off) * value / gain + cut_off * 255.0).round() as u8
    };
    for color in &mut color.data {
        *color = std::array::from_fn(|c| divided(color[c], gain[c]));
    }
}

fn varies(gains: &[LogGain]) -> bool {
    let squares = |c: usize| {
        let mean = gains.iter().map(|g| g[c]).sum::<f64>() / gains.len().max(1) as f64;
        gains.iter().map(|g| (g[c] - mean).powi(2)).sum::<f64>()
    };
    let count = (3 * gains.len()).max(1) as f64;
    ((0..3).map(squares).sum::<f64>() / count).sqrt() >= LEAST_SIGMA
}

/// Ratio of the gains of two frames.
#[derive(Debug, Clone, Copy)]
struct Ratio {
    log: LogGain,
    weight: f64,
}

/// Returns the logarithms of the gains of all frames, which are near 0 on average.
fn log_gains(frames: &[Frame], cancel: &Cancel) -> Vec<LogGain> {
    let n = frames.len();
    // Frames 1, 2, 4, … apart: few ratios lie between every two.
    let distances = (0..usize::BITS).map(|k| 1usize << k).take_while(|d| *d < n);
    let pairs: Vec<(usize, usize)> = distances.flat_map(|d| (d..n).map(move |i| (i - d, i))).collect();
    let ratios: Vec<Option<Ratio>> = pairs
        .par_iter()
        .map(|&(i, j)| if cancel.is_cancelled() { None } else { ratio(&frames[i], &frames[j]) })
        .collect();
    let mut beside: Vec<Vec<(usize, Ratio)>> = vec![Vec::new(); n];
    for (&(i, j), ratio) in pairs.iter().zip(ratios) {
        let Some(ratio) = ratio else { continue };
        beside[j].push((i, ratio));
        beside[i].push((j, Ratio { log: ratio.log.map(|l| -l), ..ratio }));
    }
    let channels = [0, 1, 2].map(|c| solve(&beside, c));
    (0..n).map(|i| channels.each_ref().map(|gains| gains[i])).collect()
}

/// Solves the normal equations of one channel by conjugate gradients.
fn solve(beside: &[Vec<(usize, Ratio)>], channel: usize) -> Vec<f64> {
    let n = beside.len();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let multiplied = |x: &[f64]| -> Vec<f64> {
        let row = |i: usize| {
            let ratios = beside[i].iter().map(|(j, ratio)| ratio.weight * (x[i] - x[*j])).sum::<f64>();
            GAIN_SIGMA.powi(-2) * x[i] + ratios
        };
        (0..n).map(row).collect()
    };
    let said = |ratios: &Vec<(usize, Ratio)>| ratios.iter().map(|(_, r)| r.weight * r.log[channel]).sum();
    let mut x = vec![0.0; n];
    let mut residual: Vec<f64> = beside.iter().map(said).collect();
    let mut direction = residual.clone();
    let mut square = dot(&residual, &residual);
    let enough = RESIDUAL * RESIDUAL * square;
    // Without rounding, as many steps as unknowns would do.
    for _ in 0..2 * n {
        if square <= enough {
            break;
        }
        let image = multiplied(&direction);
        let step = square / dot(&direction, &image);
        x.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
        residual.iter_mut().zip(&image).for_each(|(r, i)| *r -= step * i);
        let before = std::mem::replace(&mut square, dot(&residual, &residual));
        direction.iter_mut().zip(&residual).for_each(|(d, r)| *d = r + square / before * *d);
    }
    x
}

/// Returns the ratio of the gain of the second frame to that of the first; `None` if they share too few points.
fn ratio(from: &Frame, to: &Frame) -> Option<Ratio> {
    let (width, height) = from.depth.size();
    let mut logs: [Vec<f64>; 3] = Default::default();
    for (x, y) in (0..height).step_by(STRIDE).flat_map(|y| (0..width).step_by(STRIDE).map(move |x| (x, y))) {
        let Some(pixel) = shared_point(from, to, (x, y)) else { continue };
        let (first, second) = (from.color[(x, y)], to.color[pixel]);
        if first.iter().chain(&second).all(|v| RANGE.contains(v)) {
            for c in 0..3 {
                logs[c].push((f64::from(second[c]) / f64::from(first[c])).ln());
            }
        }
    }
    let shared = logs[0].len();
    if shared < LEAST_SHARED {
        return None;
    }
    let log = logs.map(|mut logs| quantile(&mut logs, 0.5, QuantileRule::Nearest).unwrap_or_default());
    let variance = RATIO_SIGMA.powi(2) + POINT_SIGMA.powi(2) / shared as f64;
    Some(Ratio { log, weight: 1.0 / variance })
}

/// Returns the pixel of `to` that measures the point at a pixel of `from`.
fn shared_point(from: &Frame, to: &Frame, (x, y): (usize, usize)) -> Option<(usize, usize)> {
    let z = f64::from(from.depth[(x, y)]);
    if z <= 0.0 {
        return None;
    }
    let (u, v, z) = to.camera.project(from.camera.unproject_pixel(x, y, z))?;
    let pixel = to.camera.pixel_at(u, v)?;
    let seen = f64::from(to.depth[pixel]);
    let tolerance_m = to.depth_noise.tolerance_m(z, ALIKE);
    (seen > 0.0 && (seen - z).abs() <= tolerance_m).then_some(pixel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DVec3};
    use sms_core::{Camera, Image, Intrinsics};

    const SIZE: (usize, usize) = (96, 64);

    /// Frames along a wall of smooth colours, one metre away, with these gains.
    fn along_wall(gains: &[[f64; 3]]) -> Vec<Frame> {
        let k = Intrinsics::from_fov(SIZE.0, SIZE.1, 1.0);
        let frame = |(i, gain): (usize, &[f64; 3])| {
            let camera = Camera::new(k, DPose3::from_translation(DVec3::X * 0.05 * i as f64));
            let pixels = (0..SIZE.0 * SIZE.1).map(|i| {
                let p_w = camera.unproject_pixel(i % SIZE.0, i / SIZE.0, 1.0);
                let wave = |phase: f64| 90.0 + 30.0 * (6.0 * p_w.x + 4.0 * p_w.y + phase).sin();
                std::array::from_fn(|c| (gain[c] * wave(c as f64)).round() as u8)
            });
            let color = Image::from_vec(SIZE.0, SIZE.1, pixels.collect());
            let depth = Image::filled(SIZE.0, SIZE.1, 1.0);
            Frame {
                index: i,
                ..Frame::new(camera, color, depth, Image::filled(SIZE.0, SIZE.1, [0.0, 0.0, -1.0]))
            }
        };
        gains.iter().enumerate().map(frame).collect()
    }

    #[test]
    fn gains_are_found_but_for_a_common_factor_and_colors_divided_by_them() {
        let truth: Vec<[f64; 3]> =
            (0..12).map(|i| [0.8 + 0.05 * i as f64, 1.0, 1.3 - 0.04 * i as f64]).collect();
        let mut frames = along_wall(&truth);
        let even = along_wall(&[[1.0; 3]; 12]);
        let (least, greatest) = equalize(&mut frames, &Cancel::new()).unwrap();
        assert!(least < 0.85 && greatest > 1.15);
        for c in 0..3 {
            let factor = f64::from(frames[0].gain[c]) / truth[0][c];
            for (frame, truth) in frames.iter().zip(&truth) {
                assert!((f64::from(frame.gain[c]) / truth[c] / factor - 1.0).abs() < 0.01);
            }
            for (frame, even) in frames.iter().zip(&even) {
                for (found, even) in frame.color.data.iter().zip(&even.color.data) {
                    assert!((f64::from(found[c]) * factor - f64::from(even[c])).abs() < 3.0);
                }
            }
        }
    }

    #[test]
    fn gains_of_many_frames_that_overlap_with_near_ones_alone_solve_the_normal_equations() {
        let n = 300;
        let truth = |i: usize| 0.3 * (i as f64 * 0.02).sin();
        let mut beside: Vec<Vec<(usize, Ratio)>> = vec![Vec::new(); n];
        for (i, j) in [1, 2, 4, 8].into_iter().flat_map(|d| (d..n).map(move |j| (j - d, j))) {
            let log = truth(j) - truth(i);
            beside[j].push((i, Ratio { log: [log; 3], weight: 2000.0 }));
            beside[i].push((j, Ratio { log: [-log; 3], weight: 2000.0 }));
        }
        let found = solve(&beside, 0);
        for i in 0..n {
            let pull: f64 = beside[i].iter().map(|(j, r)| r.weight * (found[*j] + r.log[0] - found[i])).sum();
            assert!((pull - found[i] * GAIN_SIGMA.powi(-2)).abs() < 1e-4, "{i}: {pull}");
        }
    }

    #[test]
    fn what_was_cut_off_remains_white() {
        let mut colors = Image::from_vec(3, 1, vec![[255; 3], [120, 120, 240], [200, 239, 0]]);
        divide(&mut colors, &[1.25, 0.8, 1.2]);
        assert_eq!(colors.data, [[255; 3], [96, 150, 203], [160, 255, 0]]);
    }

    #[test]
    fn frames_of_one_exposure_keep_their_bytes() {
        let mut frames =
            along_wall(&(0..12).map(|i| [1.0 + 0.04 * (f64::from(i) * 2.0).sin(); 3]).collect::<Vec<_>>());
        let before = frames.clone();
        assert_eq!(equalize(&mut frames, &Cancel::new()), None);
        assert!(frames.iter().zip(&before).all(|(a, b)| a.color == b.color && a.gain == [1.0; 3]));
    }

    #[test]
    fn frames_that_share_no_point_are_left_alone() {
        let mut frames = along_wall(&[[0.5; 3], [1.0; 3]]);
        frames[1].camera.x_wc.translation.x = 50.0;
        assert_eq!(equalize(&mut frames, &Cancel::new()), None);
        assert_eq!(equalize(&mut [], &Cancel::new()), None);
    }
}
