//! Bands and sectors of round objects: bowls, cups, vases.
//!
//! A search that repeatedly cuts in two leaves patches of all shapes on a round wall, and the worst of them determine
//! the result. Equal patches around the axis follow the wall with half the surplus.

use crate::convex::piece::Piece;
use crate::convex::search::{extent, flat_heights};
use crate::convex::solid::Solid;
use crate::convex::sweep::GrowingHull;
use crate::convex::work::Work;
use crate::plane::Plane;
use glamx::DVec3;

/// Smallest share of the surface with normals that meet the axis. Handles and spouts may be the rest.
const ROUND_SHARE: f64 = 0.4;

/// Distance from the axis, in half sizes of the object, at which a normal still meets it.
const ASIDE: f64 = 0.04;

/// Largest number of bands along the axis.
const MOST_BANDS: usize = 8;

/// Candidate numbers of sectors of a band. They are even, since a cut through the axis makes two.
const SECTORS: [usize; 13] = [1, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24];

/// Planes around an axis.
#[derive(Debug, Clone)]
pub(crate) struct Rounds {
    axis: RoundAxis,
    /// Heights along the axis between the bands, ascending, then the sectors of each band.
    heights: Vec<f64>,
    sectors: Vec<usize>,
}

#[derive(Debug, Clone, Copy)]
struct RoundAxis {
    center: DVec3,
    along: DVec3,
    /// Two directions across.
    across: [DVec3; 2],
}

impl RoundAxis {
    fn new(center: DVec3, along: DVec3) -> Self {
        let u = along.any_orthonormal_vector();
        Self { center, along, across: [u, along.cross(u)] }
    }

    /// Returns the plane through the axis with its upper side at an angle.
    fn plane(&self, angle: f64) -> Plane {
        let (sin, cos) = angle.sin_cos();
        let normal = self.across[1] * cos - self.across[0] * sin;
        Plane { normal, offset: normal.dot(self.center) }
    }

    fn level(&self, height: f64) -> Plane {
        Plane { normal: self.along, offset: height }
    }

    fn radius(&self, p: DVec3) -> f64 {
        (p - self.center).reject_from_normalized(self.along).length()
    }
}

/// Returns the axis that the normals of most of the surface meet.
fn axis_of(piece: &Piece) -> Option<RoundAxis> {
    let faces: Vec<(DVec3, DVec3)> = piece.faces().collect();
    let total: f64 = faces.iter().map(|f| f.1.length()).sum();
    let axes = piece.axes();
    let mut best: Option<(f64, RoundAxis)> = None;
    for along in [DVec3::X, DVec3::Y, DVec3::Z, axes[0], axes[1], axes[2]] {
        // The point nearest to all normal lines; each line leaves its own direction across the axis free.
        let u = along.any_orthonormal_vector();
        let v = along.cross(u);
        let mut center = DVec3::ZERO;
        for _ in 0..3 {
            let (mut m, mut r) = ([0.0f64; 3], [0.0f64; 2]);
            for &(p, n) in &faces {
                let side = along.cross(n);
                let Some(unit) = side.try_normalize() else { continue };
                let off = unit.dot(p - center).abs();
                // Later rounds give handles little weight.
                let w = side.length() / (1.0 + (off / ASIDE).powi(2));
                let (a, b, d) = (unit.dot(u), unit.dot(v), unit.dot(p));
                m[0] += w * a * a;
                m[1] += w * a * b;
                m[2] += w * b * b;
                r[0] += w * a * d;
                r[1] += w * b * d;
            }
            let det = m[0] * m[2] - m[1] * m[1];
            if det <= 1e-3 * (m[0] + m[2]).powi(2) {
                break;
            }
            center = u * ((m[2] * r[0] - m[1] * r[1]) / det) + v * ((m[0] * r[1] - m[1] * r[0]) / det);
        }
        let meets = |&(p, n): &(DVec3, DVec3)| {
            let side = along.cross(n);
            // Faces across the axis (a floor) carry no information.
            side.length() < 0.05 * n.length() || side.normalize().dot(p - center).abs() < ASIDE
        };
        let round: f64 = faces.iter().filter(|f| meets(f)).map(|f| f.1.length()).sum();
        let across = faces.iter().filter(|f| along.cross(f.1).length() < 0.05 * f.1.length());
        let flat: f64 = across.map(|f| f.1.length()).sum();
        // The floor of a box is flat, too.
        let share = (round - flat) / (total - flat).max(0.2 * total);
        if share > ROUND_SHARE && best.is_none_or(|b| share > b.0) {
            best = Some((share, RoundAxis::new(center, along)));
        }
    }
    best.map(|b| b.1)
}

/// Returns heights that divide the wall into `count` bands of equal length along its outline.
fn equal_bands(piece: &Piece, axis: RoundAxis, count: usize) -> Vec<f64> {
    // Length of each face along the outline, with the face's height.
    let length = |(p, cross): (DVec3, DVec3)| (p.dot(axis.along), cross.length() / axis.radius(p).max(0.02));
    let mut lengths: Vec<(f64, f64)> = piece.faces().map(length).collect();
    lengths.sort_by(|a, b| a.0.total_cmp(&b.0));
    let total: f64 = lengths.iter().map(|l| l.1).sum();
    let mut out = Vec::new();
    let mut sum = 0.0;
    for (height, length) in lengths {
        sum += length;
        if sum >= total * (out.len() + 1) as f64 / count as f64 && out.len() + 1 < count {
            out.push(height);
        }
    }
    out
}

impl Rounds {
    /// Returns the bands and sectors with the least hull volume, if each part costs `part_cost`. Returns `None` without
    /// an axis, and if more than `most` parts are needed: too few bands would level the floor of a bowl, while merging
    /// pieces keeps most of it.
    pub(crate) fn plan(
        piece: &Piece,
        solid: &Solid,
        part_cost: f64,
        most: usize,
        work: &Work,
    ) -> Option<Self> {
        let axis = axis_of(piece)?;
        let floors = flat_heights(piece, axis.along);
        let mut hull = GrowingHull::default();
        // Volumes by plan, band and number of sectors.
        let mut plans: Vec<(Vec<f64>, Vec<Vec<f64>>)> = Vec::new();
        for count in 1..=MOST_BANDS {
            for with_floors in [false, true] {
                let mut heights = equal_bands(piece, axis, count);
                if with_floors {
                    heights.retain(|h| floors.iter().all(|f| (f - h).abs() > 0.02));
                    heights.extend(&floors);
                    heights.sort_by(f64::total_cmp);
                }
                let (low, high) = extent(piece, axis.along);
                heights.retain(|h| *h > low + 2e-3 && *h < high - 2e-3);
                heights.dedup_by(|a, b| *a - *b < 5e-3);
                if plans.iter().any(|p| p.0 == heights) {
                    continue;
                }
                let bands = bands(piece, axis, &heights, solid, work);
                let volumes = bands.iter().map(|band| volumes(band, axis, solid, &mut hull, work)).collect();
                plans.push((heights, volumes));
            }
        }
        let price = |v: &[f64], k: usize| v[k] + part_cost * SECTORS[k] as f64;
        let cheapest = |v: &Vec<f64>| {
            (0..SECTORS.len()).min_by(|&a, &b| price(v, a).total_cmp(&price(v, b))).unwrap_or(0)
        };
        let best = plans
            .iter()
            .map(|(heights, volumes)| {
                let chosen: Vec<usize> = volumes.iter().map(cheapest).collect();
                let sum: f64 = chosen.iter().zip(volumes).map(|(&k, v)| price(v, k)).sum();
                (sum, heights, chosen)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        let sectors: Vec<usize> = best.2.iter().map(|&k| SECTORS[k]).collect();
        let fits = sectors.iter().sum::<usize>() <= most;
        fits.then(|| Self { axis, heights: best.1.clone(), sectors })
    }

    /// Returns the pieces of bands and sectors.
    pub(crate) fn cut(&self, piece: &Piece, with_caps: bool, solid: &Solid, work: &Work) -> Vec<Piece> {
        let inside = |p| solid.contains(p, work);
        let mut rest = piece.clone();
        let mut out = Vec::new();
        for (k, &count) in self.sectors.iter().enumerate() {
            let band = match self.heights.get(k) {
                Some(&height) => {
                    let [below, above] = rest.split(self.axis.level(height), with_caps, &inside);
                    rest = above;
                    below
                }
                None => std::mem::take(&mut rest),
            };
            if count < 2 {
                out.push(band);
                continue;
            }
            // Two halves, then one sector after another from each half.
            let step = std::f64::consts::TAU / count as f64;
            let [second, first] = band.split(self.axis.plane(0.0), with_caps, &inside);
            for (mut half, start) in [(first, 0.0), (second, std::f64::consts::PI)] {
                for i in 1..count / 2 {
                    let [below, above] =
                        half.split(self.axis.plane(start + step * i as f64), with_caps, &inside);
                    out.push(below);
                    half = above;
                }
                out.push(half);
            }
        }
        out
    }
}

/// Returns the bands between ascending heights.
fn bands(piece: &Piece, axis: RoundAxis, heights: &[f64], solid: &Solid, work: &Work) -> Vec<Piece> {
    let mut rest = piece.clone();
    let mut out = Vec::new();
    for &height in heights {
        work.add(2 * rest.size());
        let [below, above] = rest.split(axis.level(height), false, &|p| solid.contains(p, work));
        out.push(below);
        rest = above;
    }
    out.push(rest);
    out
}

/// Returns the hull volume of all sectors of a band for each number of sectors, estimated from the middle one of three.
fn volumes(band: &Piece, axis: RoundAxis, solid: &Solid, hull: &mut GrowingHull, work: &Work) -> Vec<f64> {
    let inside = |p| solid.contains(p, work);
    let out = SECTORS
        .iter()
        .map(|&count| {
            if count == 1 {
                return band.hull_volume(hull);
            }
            let step = std::f64::consts::TAU / count as f64;
            let mut three: Vec<f64> = [0.3, 2.4, 4.5]
                .iter()
                .map(|&start| {
                    work.add(4 * band.size());
                    let [_, mut sector] = band.split(axis.plane(start), false, &inside);
                    if count > 2 {
                        [sector, _] = sector.split(axis.plane(start + step), false, &inside);
                    }
                    sector.hull_volume(hull)
                })
                .collect();
            three.sort_by(f64::total_cmp);
            three[1] * count as f64
        })
        .collect();
    work.add(hull.take_steps());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::convex::repair::clean;
    use glamx::DQuat;
    use sms_core::Mesh;

    fn piece_of(mesh: &Mesh) -> Piece {
        Piece { points: mesh.vertices.clone(), triangles: mesh.triangles.clone(), ..Piece::default() }
    }

    /// A ball with a spherical hollow. It is shifted and rotated so that its axis is not parallel to an axis of the
    /// frame.
    fn shell() -> Mesh {
        let mut mesh = Mesh::icosphere(0.8, 3);
        let hole = Mesh::icosphere(0.7, 3);
        let n = mesh.vertices.len() as u32;
        mesh.vertices.extend(&hole.vertices);
        mesh.triangles.extend(hole.triangles.iter().map(|&[a, b, c]| [a + n, c + n, b + n]));
        let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.5, -0.2));
        for v in &mut mesh.vertices {
            *v = turn * (*v * DVec3::new(0.6, 0.6, 1.1)) + DVec3::new(0.1, -0.05, 0.08);
        }
        mesh
    }

    #[test]
    fn equal_patches_fill_a_round_shell_and_follow_it() {
        let mesh = shell();
        let solid = Solid::new(&clean(&mesh.vertices, &mesh.triangles)).unwrap();
        let piece = piece_of(&mesh);
        let axis = axis_of(&piece).unwrap();
        let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.5, -0.2));
        assert!(axis.along.dot(turn * DVec3::Z).abs() > 0.999);
        assert!(axis.radius(DVec3::new(0.1, -0.05, 0.08)) < 0.01);
        let work = Work::default();
        let rounds = Rounds::plan(&piece, &solid, 1e-3, 1000, &work).unwrap();
        let pieces = rounds.cut(&piece, true, &solid, &work);
        let count = rounds.sectors.iter().sum::<usize>();
        assert!(pieces.len() == count && count > 15, "{count}");
        let sum: f64 = pieces.iter().map(Piece::volume).sum();
        assert!((sum - mesh.volume()).abs() < 1e-7, "{sum} {}", mesh.volume());
        assert!(Rounds::plan(&piece, &solid, 1e-3, count - 1, &work).is_none());
    }

    #[test]
    fn boxes_are_not_round() {
        assert!(axis_of(&piece_of(&Mesh::cuboid(DVec3::new(1.0, 0.7, 0.4)))).is_none());
    }
}
