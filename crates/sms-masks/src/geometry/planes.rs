//! Floor, desk, walls: planar pieces that are too large to belong to an object.

use super::GeometryConfig;
use super::fuse::{Neighbors, Surfel};
use super::linalg::{mean_and_covariance, symmetric_eigen};
use glamx::DVec3;
use rand::RngExt;
use sms_core::{Cancel, CoreError};
use std::collections::BTreeSet;

/// A large planar piece of the static surroundings.
#[derive(Debug, Clone)]
pub(crate) struct StaticPlane {
    /// A point of it.
    pub(crate) p_w: DVec3,
    /// Its unit normal towards the cameras.
    pub(crate) n_w: DVec3,
    /// Distance from the plane within which a surfel that faces the same way belongs to it: three times the spread of
    /// its own surfels.
    pub(crate) band_m: f64,
    /// Its surfels, sorted.
    pub(crate) members: Vec<usize>,
}

impl StaticPlane {
    /// Height of a point over the plane.
    pub(crate) fn height(&self, p_w: DVec3) -> f64 {
        self.n_w.dot(p_w - self.p_w)
    }
}

/// Most pieces that are looked at before fitting stops.
const MAX_FITS: usize = 60;
/// Planes drawn for one fit.
const DRAWS: usize = 160;
/// Cosine of the angle between the normals of a plane and of its surfels.
const ALIGNED: f64 = 0.9;

/// Which surfels are static, and the planes they lie on.
pub(crate) fn static_surfels(
    surfels: &[Surfel],
    graph: &Neighbors,
    config: &GeometryConfig,
    cancel: &Cancel,
) -> Result<(Vec<bool>, Vec<StaticPlane>), CoreError> {
    let mut rng = config.seed.derive("planes").rng();
    let mut open: Vec<usize> = (0..surfels.len()).collect();
    let mut planes = Vec::new();
    let smallest = (0.4 * config.max_face_m2 / config.voxel_m.powi(2)) as usize;
    let noise = median(surfels.iter().map(|s| s.sigma_m).collect());
    let band = (3.0 * noise).clamp(0.003, 0.008);
    for _ in 0..MAX_FITS {
        cancel.check()?;
        if open.len() < smallest.max(3) {
            break;
        }
        // Plane through one surfel along its normal; scored on a sample of the open surfels.
        let step = open.len().div_ceil(4000);
        let draws: Vec<usize> = (0..DRAWS).map(|_| open[rng.random_range(0..open.len())]).collect();
        let score = |&i: &usize| {
            let s = &surfels[i];
            open.iter().step_by(step).filter(|&&j| fits(&surfels[j], s.p_w, s.n_w, 1.5 * band)).count()
        };
        let Some(best) = draws.iter().max_by_key(|i| (score(i), std::cmp::Reverse(**i))) else { break };
        let (mut p_w, mut n_w) = (surfels[*best].p_w, surfels[*best].n_w);
        for _ in 0..4 {
            let on = open.iter().map(|&j| &surfels[j]).filter(|s| fits(s, p_w, n_w, band));
            let Some((mean, covariance, _)) = mean_and_covariance(on.map(|s| (s.p_w, s.weight.min(50.0))))
            else {
                break;
            };
            let n = symmetric_eigen(covariance).1[0];
            (p_w, n_w) = (mean, if n.dot(n_w) < 0.0 { -n } else { n });
        }
        let mut on = vec![false; surfels.len()];
        open.iter().for_each(|&j| on[j] = fits(&surfels[j], p_w, n_w, band));
        let pieces = graph.components(|i| on[i]);
        let found: usize = pieces.iter().map(Vec::len).sum();
        // What was looked at is not looked at again, large or not.
        open.retain(|&j| !on[j]);
        if found < smallest {
            break;
        }
        for members in pieces.into_iter().filter(|m| is_large(surfels, m, n_w, config)) {
            planes.push(finish(surfels, members, n_w));
        }
    }
    let mut is_static = vec![false; surfels.len()];
    for plane in &mut planes {
        extend(plane, surfels, graph);
        plane.members.iter().for_each(|&i| is_static[i] = true);
    }
    Ok((is_static, planes))
}

fn fits(s: &Surfel, p_w: DVec3, n_w: DVec3, band: f64) -> bool {
    n_w.dot(s.p_w - p_w).abs() < band && s.n_w.dot(n_w) > ALIGNED
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// Whether a planar piece is longer or has more area than a face of an object.
fn is_large(surfels: &[Surfel], members: &[usize], n_w: DVec3, config: &GeometryConfig) -> bool {
    let u = n_w.any_orthonormal_vector();
    let v = n_w.cross(u);
    // Cells across the plane: the skin's thickness must not count as area.
    let cell = 1.5 * config.voxel_m;
    let cells: BTreeSet<(i64, i64)> = members
        .iter()
        .map(|&i| {
            let p = surfels[i].p_w;
            ((u.dot(p) / cell).floor() as i64, (v.dot(p) / cell).floor() as i64)
        })
        .collect();
    let area = cells.len() as f64 * cell * cell;
    area > config.max_face_m2
        || (area > 0.2 * config.max_face_m2 && length(surfels, members) > config.max_object_m)
}

/// Extent of a piece along its longest principal axis.
pub(crate) fn length(surfels: &[Surfel], members: &[usize]) -> f64 {
    extents(surfels, members)[2]
}

/// Extents along the principal axes, increasing.
pub(crate) fn extents(surfels: &[Surfel], members: &[usize]) -> [f64; 3] {
    let points = members.iter().map(|&i| (surfels[i].p_w, 1.0));
    let Some((_, covariance, _)) = mean_and_covariance(points) else { return [0.0; 3] };
    let axes = symmetric_eigen(covariance).1;
    axes.map(|axis| {
        let along = members.iter().map(|&i| axis.dot(surfels[i].p_w));
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        high - low
    })
}

/// The plane of a piece, fitted again to its own surfels, with its own spread.
fn finish(surfels: &[Surfel], members: Vec<usize>, n_w: DVec3) -> StaticPlane {
    let points = members.iter().map(|&i| (surfels[i].p_w, surfels[i].weight.min(50.0)));
    let (p_w, n_w) = match mean_and_covariance(points) {
        Some((mean, covariance, _)) => {
            let n = symmetric_eigen(covariance).1[0];
            (mean, if n.dot(n_w) < 0.0 { -n } else { n })
        }
        None => (surfels[members[0]].p_w, n_w),
    };
    let spread = 1.4826 * median(members.iter().map(|&i| n_w.dot(surfels[i].p_w - p_w).abs()).collect());
    StaticPlane { p_w, n_w, band_m: (3.0 * spread).clamp(0.0015, 0.006), members }
}

/// Grows a plane over what continues it: surfels that face the same way and rise from a neighbour by less than a slope
/// of about 1:8 (real floors and sensors bend by several millimetres), and, whichever way they face, those within a
/// third of its band (where a wall meets the floor, normals are mixed and only height decides).
fn extend(plane: &mut StaticPlane, surfels: &[Surfel], graph: &Neighbors) {
    const BEND_M: f64 = 0.012;
    let mut taken = vec![false; surfels.len()];
    plane.members.iter().for_each(|&i| taken[i] = true);
    let mut next = 0;
    while next < plane.members.len() {
        let i = plane.members[next];
        next += 1;
        let from = &surfels[i];
        for j in graph.of(i) {
            let to = &surfels[j];
            let d = to.p_w - from.p_w;
            let continues = to.n_w.dot(plane.n_w) > ALIGNED
                && from.n_w.dot(plane.n_w) > ALIGNED
                && plane.n_w.dot(d).abs() < 0.0008 + 0.12 * d.length()
                && plane.height(to.p_w).abs() < BEND_M;
            let touches = plane.height(to.p_w) < plane.band_m / 3.0 && plane.height(to.p_w) > -BEND_M;
            if !taken[j] && (continues || touches) {
                taken[j] = true;
                plane.members.push(j);
            }
        }
    }
    plane.members.sort_unstable();
}
