//! The uncertainty of a scene's size under the covariance of its poses.
//!
//! Faces that no frame sees together can move against each other at no cost for the residuals. The distance between
//! opposite faces is a linear function of the poses, and its variance follows from their covariance.

use crate::align::lever;
use crate::covariance::Covariance;
use crate::linear::{COMMON, FOCAL, Row};
use crate::views::{Point, by_focal_of};
use glamx::{DPose3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::NORMAL_90;

/// Number of horizontal directions in which the distance between faces is examined.
const DIRECTIONS: usize = 12;
/// Smallest cosine between a direction and the normals of the faces across it.
const LEAST_COSINE: f64 = 0.95;
/// Smallest share of the points on each of two opposite faces.
const LEAST_SHARE: f64 = 0.005;

/// Uncertainty of the distance between the faces that look along a direction and those that look against it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ExtentUncertainty {
    /// Unit vector in the world.
    pub direction_w: [f64; 3],
    /// Standard deviation of the distance, metres.
    pub sigma_m: f64,
    /// Distance between the centroids of the faces along the direction, metres.
    pub distance_m: f64,
}

/// Uncertainty of a scene's size.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SizeUncertainty {
    /// Standard deviation of the scale of the camera centres.
    pub scale_sigma: f64,
    /// Distances between opposite upright faces, where the recording has such faces.
    pub extents: Vec<ExtentUncertainty>,
}

impl SizeUncertainty {
    /// Returns the least certain distance.
    pub fn weakest(&self) -> Option<&ExtentUncertainty> {
        self.extents.iter().max_by(|a, b| a.sigma_m.total_cmp(&b.sigma_m))
    }

    /// Returns the standard deviation of sizes and distances, as a share: that of the scale of the camera centres, or of the least
    /// certain distance between opposite faces.
    pub fn relative_sigma(&self) -> f64 {
        let of = |e: &ExtentUncertainty| if e.distance_m > 0.0 { e.sigma_m / e.distance_m } else { 0.0 };
        self.extents.iter().map(of).fold(self.scale_sigma, f64::max)
    }

    /// Returns a statement for people: 90 % intervals.
    pub(crate) fn summary(&self) -> String {
        let scale = format!("scale known to ±{:.2} %", 1e2 * NORMAL_90 * self.scale_sigma);
        self.weakest().map_or(scale.clone(), |e| {
            let (most_mm, size_mm) = (1e3 * NORMAL_90 * e.sigma_m, 1e3 * e.distance_m);
            format!("{scale}, and a distance of {size_mm:.0} mm between opposite faces to ±{most_mm:.1} mm")
        })
    }

    /// Computes it from the covariance of the poses and the points of each frame; `None` if the covariance does not
    /// determine it.
    pub(crate) fn of(
        covariance: &Covariance<'_>,
        poses: &[DPose3],
        points: &[Vec<Point>],
        center_w: DVec3,
    ) -> Option<Self> {
        let scale_sigma = covariance.sigma(&scale_row(poses, center_w))?;
        let extent = |k: usize| {
            let angle = std::f64::consts::PI * k as f64 / DIRECTIONS as f64;
            let direction_w = DVec3::new(angle.cos(), angle.sin(), 0.0);
            let (row, distance_m) = extent_row(direction_w, poses, points, center_w)?;
            let sigma_m = covariance.sigma(&row)?;
            Some(ExtentUncertainty { direction_w: direction_w.to_array(), sigma_m, distance_m })
        };
        let extents = (0..DIRECTIONS).into_par_iter().filter_map(extent).collect();
        Some(Self { scale_sigma, extents })
    }
}

/// The scale of the camera centres about their mean, as a function of the corrections.
fn scale_row(poses: &[DPose3], center_w: DVec3) -> Row {
    let mean = poses.iter().map(|x| x.translation).sum::<DVec3>() / poses.len().max(1) as f64;
    let square: f64 = poses.iter().map(|x| (x.translation - mean).length_squared()).sum();
    let of = |(i, x): (usize, &DPose3)| {
        let along = (x.translation - mean) / square.max(1e-12);
        (i, lever(x.translation - center_w, along))
    };
    Row { frames: poses.iter().enumerate().map(of).collect(), common: [0.0; COMMON] }
}

/// The distance between the faces across a direction, as a function of the corrections and of the focal length, and its value; `None` unless both
/// sides were seen.
fn extent_row(
    direction_w: DVec3,
    poses: &[DPose3],
    points: &[Vec<Point>],
    center_w: DVec3,
) -> Option<(Row, f64)> {
    // Points on each side: their number, and the sum of their positions along the direction.
    let (mut counts, mut sums) = ([0usize; 2], [0.0; 2]);
    let mut sides: Vec<[[f64; 6]; 2]> = vec![[[0.0; 6]; 2]; poses.len()];
    let mut by_focal = [0.0; 2];
    for ((x, points), own) in poses.iter().zip(points).zip(&mut sides) {
        for point in points {
            let cosine = (x.rotation * point.n_c).dot(direction_w);
            if cosine.abs() < LEAST_COSINE {
                continue;
            }
            let side = usize::from(cosine > 0.0);
            let p_w = x.transform_point(point.p_c);
            let by = lever(p_w - center_w, direction_w);
            (0..6).for_each(|a| own[side][a] += by[a]);
            by_focal[side] += (x.rotation * by_focal_of(point.p_c)).dot(direction_w);
            counts[side] += 1;
            sums[side] += p_w.dot(direction_w);
        }
    }
    let all: usize = points.iter().map(Vec::len).sum();
    if (counts[0].min(counts[1]) as f64) < LEAST_SHARE * all as f64 || counts.contains(&0) {
        return None;
    }
    let [low, high] = counts.map(|n| n as f64);
    let frames = sides
        .iter()
        .enumerate()
        .map(|(i, own)| (i, std::array::from_fn(|a| own[1][a] / high - own[0][a] / low)));
    let distance_m = (sums[1] / high - sums[0] / low).abs();
    let mut common = [0.0; COMMON];
    common[FOCAL] = by_focal[1] / high - by_focal[0] / low;
    Some((Row { frames: frames.collect(), common }, distance_m))
}
