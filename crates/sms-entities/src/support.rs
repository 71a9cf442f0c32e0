//! Supports: the surfaces that objects rest on.

use crate::cloud::SurfaceDisc;
use crate::relabel::host_of;
use crate::views::Views;
use glamx::{DMat4, DVec3, DVec4};
use rand::RngExt;
use sms_core::Seed;
use sms_mesh::{
    Plane, PointGrid, median,
    outline::{area, is_within, outline_of},
    principal_axes, quantile, scatter,
};
use std::collections::BTreeMap;

/// Thinned surface points of the whole scene with normals and labels.
#[derive(Debug, Clone, Default)]
pub(crate) struct Surroundings {
    pub(crate) points: Vec<DVec3>,
    pub(crate) normals: Vec<DVec3>,
    pub(crate) labels: Vec<u16>,
    pub(crate) colors: Vec<[u8; 3]>,
    /// Unlabelled sides with their normals. Masks lose a strip between two objects, or a whole rim in the shade.
    pub(crate) lost_sides: Vec<(DVec3, DVec3)>,
    /// Sides of the reconstruction with their labels. The reconstruction contains thin rims completely.
    pub(crate) own_sides: Vec<(DVec3, u16)>,
}

impl Surroundings {
    /// Relabels the points of joined pieces with the label of their host.
    pub(crate) fn relabel(&mut self, joined: &[(u16, u16)]) {
        self.labels.iter_mut().for_each(|label| *label = host_of(*label, joined));
    }

    /// Collects the sides of an object from its discs.
    pub(crate) fn collect_own_sides(&mut self, label: u16, discs: &[SurfaceDisc]) {
        let sides = discs.iter().filter(|d| d.normal.z.abs() < UPRIGHT);
        self.own_sides.extend(sides.map(|d| (d.center, label)));
    }

    /// Collects unlabelled sides: measured points, and discs of the reconstruction.
    pub(crate) fn collect_lost_sides(&mut self, unlabelled: &[SurfaceDisc]) {
        let measured = (0..self.points.len()).filter(|&i| self.labels[i] == sms_core::BACKGROUND);
        let measured = measured.map(|i| (self.points[i], self.normals[i]));
        let all = measured.chain(unlabelled.iter().map(|d| (d.center, d.normal)));
        self.lost_sides = all.filter(|(_, normal)| normal.z.abs() < UPRIGHT).collect();
    }
}

/// Carrier of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Carrier {
    /// The dominant plane, a half space in the scene.
    Floor,
    /// Surface without a label.
    Environment,
    /// Another object.
    Object(u16),
    /// No surface was seen below: a horizontal plane under the lowest point is assumed.
    Unseen,
}

/// The plane an object rests on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RestingPlane {
    pub(crate) plane: Plane,
    pub(crate) carrier: Carrier,
    /// Scatter (robust standard deviation) of the carrying surface about the plane, metres.
    pub(crate) noise_m: f64,
}

/// Assumed scatter if little of the carrying surface was seen.
const UNSEEN_NOISE_M: f64 = 0.001;

/// Sums over the measurements in one cell.
#[derive(Default)]
struct Cell {
    point: DVec3,
    normal: DVec3,
    color: [u32; 3],
    count: u32,
}

/// Number of measurements used: enough for several in each cell of a desk.
const SAMPLES: usize = 1_000_000;

/// Returns surface points of all frames about `spacing` apart. Each is the mean of several measurements and has the
/// normal of the depth. Both sides of a wall are kept apart.
pub(crate) fn surroundings(views: &Views, spacing: f64) -> Surroundings {
    let mut cells: BTreeMap<([i32; 3], u16, u8), Cell> = BTreeMap::new();
    let pixels: usize = views.labels.maps.iter().map(|m| m.data.len()).sum();
    let stride = ((pixels as f64 / SAMPLES as f64).sqrt().round() as usize).max(1);
    for (f, frame) in views.sequence.frames.iter().enumerate() {
        let map = &views.labels.maps[f];
        for y in (f % stride..map.height).step_by(stride) {
            for x in (f % stride..map.width).step_by(stride) {
                let depth = f64::from(frame.depth[(x, y)]);
                let n = frame.normal_c[(x, y)].map(f64::from);
                if depth <= 0.0 || n == [0.0; 3] {
                    continue;
                }
                let p = frame.camera.unproject_pixel(x, y, depth);
                let normal = frame.camera.x_wc.rotation * DVec3::from_array(n);
                let at = (p / spacing).floor().to_array().map(|v| v as i32);
                let a = normal.abs();
                let axis = if a.z >= a.x && a.z >= a.y { 2 } else { usize::from(a.y >= a.x) };
                let side = 2 * axis as u8 + u8::from(normal[axis] > 0.0);
                let cell = cells.entry((at, map[(x, y)], side)).or_default();
                cell.point += p;
                cell.normal += normal;
                for (sum, c) in cell.color.iter_mut().zip(frame.color[(x, y)]) {
                    *sum += u32::from(c);
                }
                cell.count += 1;
            }
        }
    }
    // A cell with a single measurement is more often a flying pixel than a surface.
    let least = if views.sequence.frames.len() > 5 { 3 } else { 1 };
    let mut out = Surroundings::default();
    for ((_, label, _), cell) in cells {
        if cell.count >= least {
            out.points.push(cell.point / f64::from(cell.count));
            out.normals.push(cell.normal.normalize_or(DVec3::Z));
            out.labels.push(label);
            out.colors.push(cell.color.map(|c| (c / cell.count) as u8));
        }
    }
    out
}

/// Returns the height of the dominant plane near the world's z = 0, or `None` if no level unlabelled surface is seen
/// there.
pub(crate) fn support_height(around: &Surroundings) -> Option<f64> {
    let level: Vec<f64> = (0..around.points.len())
        .filter(|&i| {
            around.labels[i] == sms_core::BACKGROUND
                && around.normals[i].z > 0.95
                && around.points[i].z.abs() < 0.03
        })
        .map(|i| around.points[i].z)
        .collect();
    let background = around.labels.iter().filter(|&&l| l == sms_core::BACKGROUND).count();
    if level.len() < 100 || level.len() * 20 < background {
        return None;
    }
    let mut center = median(level.clone());
    for band in [0.01, 0.006] {
        center = median(level.iter().copied().filter(|z| (z - center).abs() < band).collect());
    }
    Some(center)
}

/// Finds the plane that carries the object with these surface points: the best nearly level plane through the surface
/// around and below the lowest part of the object.
pub(crate) fn find_rest(
    points: &[DVec3],
    label: u16,
    around: &Surroundings,
    support: Option<f64>,
    seed: Seed,
) -> RestingPlane {
    let lowest = quantile(points.iter().map(|p| p.z).collect(), 0.02);
    let highest = quantile(points.iter().map(|p| p.z).collect(), 0.98);
    let height = (highest - lowest).max(0.01);
    let foot: Vec<DVec3> =
        points.iter().filter(|p| p.z < lowest + (0.3 * height).max(0.01)).map(|p| p.with_z(0.0)).collect();
    let center = foot.iter().sum::<DVec3>() / foot.len().max(1) as f64;
    let flat = PointGrid::new(&foot, 0.02);
    let mut candidates: Vec<usize> = (0..around.points.len())
        .filter(|&i| {
            let p = around.points[i];
            around.labels[i] != label
                && around.normals[i].z > 0.75
                && p.z > lowest - 0.04
                && p.z < lowest + (0.25 * height).clamp(0.008, 0.02)
                && flat.is_near(p.with_z(0.0), 0.04)
        })
        .collect();
    // Beyond the rim of a dish, more of the floor may be seen than of the dish around its content.
    let next_to_foot: Vec<usize> = candidates
        .iter()
        .copied()
        .filter(|&i| flat.is_near(around.points[i].with_z(0.0), NEXT_TO_FOOT_M))
        .collect();
    if let Some(carrier) = surrounding_object(&next_to_foot, around, center) {
        candidates.retain(|&i| around.labels[i] == carrier);
    }
    let scatter = |plane: &Plane, members: &[usize]| {
        median(members.iter().map(|&i| plane.height(around.points[i]).abs()).collect())
    };
    let rest = |plane: Plane, carrier: Carrier, members: &[usize]| {
        let noise_m = if members.len() < 12 { UNSEEN_NOISE_M } else { 1.4826 * scatter(&plane, members) };
        RestingPlane { plane, carrier, noise_m }
    };
    let Some((plane, members)) = fit_level_plane(&candidates, around, points, seed) else {
        return match support {
            Some(h) if lowest - h < 0.04 => rest(Plane::horizontal(h), Carrier::Floor, &[]),
            _ => match carrier_by_its_sides(points, label, around) {
                Some((carrier, end)) => rest(Plane::horizontal(end), Carrier::Object(carrier), &[]),
                None => rest(Plane::horizontal(lowest), Carrier::Unseen, &[]),
            },
        };
    };
    let mut votes: BTreeMap<u16, usize> = BTreeMap::new();
    for &i in &members {
        *votes.entry(around.labels[i]).or_default() += 1;
    }
    let most = votes.iter().max_by_key(|v| (*v.1, std::cmp::Reverse(*v.0))).map_or(0, |v| *v.0);
    // The floor of a thin dish lies only millimetres above the plane, but its content rests on the dish.
    if most == sms_core::BACKGROUND
        && let Some(h) = support
    {
        let level = plane.normal.z > 4f64.to_radians().cos();
        if level && height_at(&plane, center).is_some_and(|here| (here - h).abs() < 0.005) {
            return rest(Plane::horizontal(h), Carrier::Floor, &members);
        }
    }
    if most == sms_core::BACKGROUND {
        return rest(plane, Carrier::Environment, &members);
    }
    // The seen part of a top beside its load is often a strip, which says little about its tilt. A tilt seen on all
    // sides is real.
    let level = Plane::horizontal(median(members.iter().map(|&i| around.points[i].z).collect()));
    let off = scatter(&level, &members);
    let mut seen = [false; SECTORS];
    members.iter().for_each(|&i| seen[sector(around.points[i] - center)] = true);
    let is_strip = seen.iter().filter(|s| **s).count() < ALL_ROUND;
    let noise = scatter(&plane, &members);
    let leans = plane.normal.z.min(1.0).acos();
    let is_unclear =
        if is_strip { leans < STRIP_LEANS } else { leans < LEANS && off < CLEARER * noise.max(NOISE_M) };
    let is_level = off < LEVEL_M && is_unclear;
    rest(if is_level { level } else { plane }, Carrier::Object(most), &members)
}

/// Largest median height of the points of a level top above or below their middle, metres.
const LEVEL_M: f64 = 0.002;
/// Largest tilt of a level top seen on all sides, radians.
const LEANS: f64 = 0.09;
/// Smallest number of directions in which a top is seen on all sides.
const ALL_ROUND: usize = 6;
/// A top seen on all sides is tilted if its points scatter this many times more about the level plane.
const CLEARER: f64 = 1.5;
/// Smallest scatter for this comparison, metres.
const NOISE_M: f64 = 5e-4;
/// Largest tilt of a level top seen as a strip on few sides, radians.
const STRIP_LEANS: f64 = 0.2;

/// Returns the object below a foot if cameras see only the sides of that object (an open bin under a board), and the
/// height of the foot.
fn carrier_by_its_sides(points: &[DVec3], label: u16, around: &Surroundings) -> Option<(u16, f64)> {
    /// Smallest number of points of sides, and of those with a label.
    const LEAST: usize = 50;
    const LEAST_LABELLED: usize = 25;
    let end = lower_end(points);
    let high = quantile(points.iter().map(|p| p.z).collect(), 0.98);
    let is_foot = |p: &DVec3| p.z > end - ENDS_M && p.z < end + (0.3 * (high - end)).max(0.01);
    let outline = outline_of(points.iter().copied().filter(is_foot));
    if outline.len() < 3 {
        return None;
    }
    let is_there = |p: &DVec3| p.z > end - SIDES_M && is_within(&outline, p.truncate(), 0.0);
    let mut below: BTreeMap<u16, Vec<DVec3>> = BTreeMap::new();
    for (p, &l) in around.points.iter().zip(&around.labels) {
        if l != sms_core::BACKGROUND && l != label && is_there(p) {
            below.entry(l).or_default().push(*p);
        }
    }
    let may_carry = |p: &DVec3| p.z < end + ENDS_M && is_there(p);
    let lost: Vec<DVec3> = around.lost_sides.iter().map(|(p, _)| *p).filter(may_carry).collect();
    // A load on the object is also above its foot. An object as wide as the foot may be a lower part of the same
    // object.
    let ends = |(carrier, labelled): (u16, Vec<DVec3>)| {
        let high = |of: &[DVec3]| quantile(of.iter().map(|p| p.z).collect(), 0.95);
        if labelled.len() < LEAST_LABELLED || high(&labelled) > end + ENDS_M {
            return None;
        }
        let grid = PointGrid::new(&labelled, CONTINUES_M);
        let is_beside = |p: &DVec3| grid.is_near(*p, CONTINUES_M);
        let carries = |sides: &[DVec3]| {
            let is_narrow = area(&outline) > WIDER * area(&outline_of(sides.iter().copied()));
            sides.len() >= LEAST && high(sides) > end - STRIP_M && is_narrow
        };
        let unlabelled = lost.iter().copied().filter(is_beside);
        let mut sides: Vec<DVec3> = labelled.iter().copied().chain(unlabelled).collect();
        let is_measured = carries(&sides);
        let own = around.own_sides.iter().filter(|(p, l)| *l == carrier && may_carry(p) && is_beside(p));
        sides.extend(own.map(|(p, _)| *p));
        (is_measured || carries(&sides)).then_some((labelled.len(), carrier))
    };
    let most = below
        .into_iter()
        .filter_map(ends)
        .max_by_key(|&(count, carrier)| (count, std::cmp::Reverse(carrier)))?;
    Some((most.1, end))
}

/// Returns the lower end of an object: the height from which on there are as many points as usual for its lower half.
/// Stray points with its label lie up to centimetres lower.
fn lower_end(points: &[DVec3]) -> f64 {
    const BIN_M: f64 = 0.002;
    const MOST_BINS: usize = 5000;
    let heights: Vec<f64> = points.iter().map(|p| p.z).collect();
    let (low, middle) = (quantile(heights.clone(), 0.005), median(heights.clone()));
    let bin = |z: f64| ((z - low) / BIN_M).floor();
    let mut counts = vec![0usize; (bin(middle) as usize).min(MOST_BINS) + 1];
    for &z in heights.iter().filter(|&&z| z >= low) {
        if let Some(count) = counts.get_mut(bin(z) as usize) {
            *count += 1;
        }
    }
    let usual = counts.iter().sum::<usize>().div_ceil(counts.len());
    let first = counts.iter().position(|&n| 3 * n >= usual).unwrap_or(0);
    median(heights.into_iter().filter(|&z| bin(z) == first as f64).collect())
}

/// Depth below an object's lower end to which sides of a carrier are searched, metres.
const SIDES_M: f64 = 0.04;
/// Largest distance of the carrier's upper end below the object's lower end, metres.
const STRIP_M: f64 = 0.012;
/// Largest distance of the carrier's upper end above the object's lower end, metres.
const ENDS_M: f64 = 0.005;
/// Smallest ratio of the area of the object's foot to that of the outline of the sides.
const WIDER: f64 = 1.5;
/// Surface that faces up or down by less than this may be a side (cosine of the angle to the vertical). A more level
/// surface is the table beside an object, or the underside of its load.
pub(crate) const UPRIGHT: f64 = 0.7;
/// Sides face up or down by less than this (cosine of the angle to the vertical).
pub(crate) const SIDE: f64 = 0.5;
/// Unlabelled sides this close to those of an object belong to it, metres.
const CONTINUES_M: f64 = 0.03;

/// Horizontal radius of the surroundings of the foot, metres.
const NEXT_TO_FOOT_M: f64 = 0.015;

/// Number of sectors about the vertical.
pub(crate) const SECTORS: usize = 8;

/// Returns which of the [`SECTORS`] contains a horizontal direction.
pub(crate) fn sector(out: DVec3) -> usize {
    let turn = (out.y.atan2(out.x) / std::f64::consts::TAU).rem_euclid(1.0);
    ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// Returns the label that most directions around a foot see as level surface, if it is the label of an object.
fn surrounding_object(next_to_foot: &[usize], around: &Surroundings, center: DVec3) -> Option<u16> {
    /// Directions that must agree.
    const MOST: usize = 5;
    let mut sectors: [BTreeMap<u16, usize>; SECTORS] = Default::default();
    for &i in next_to_foot {
        *sectors[sector(around.points[i] - center)].entry(around.labels[i]).or_default() += 1;
    }
    let mut votes: BTreeMap<u16, usize> = BTreeMap::new();
    for sector in &sectors {
        if let Some(most) = sector.iter().max_by_key(|v| (*v.1, std::cmp::Reverse(*v.0))) {
            *votes.entry(*most.0).or_default() += 1;
        }
    }
    votes.into_iter().find(|&(label, n)| n >= MOST && label != sms_core::BACKGROUND).map(|(label, _)| label)
}

/// Returns the height of an object's surface right below a ball on it or in its hollow. The ball hides this place: the
/// height is that of a paraboloid through the seen level parts around the ball's foot. Returns `None` if too little was
/// seen.
pub(crate) fn height_below_ball(
    around: &Surroundings,
    carrier: u16,
    center: DVec3,
    radius: f64,
) -> Option<f64> {
    const LEAST: usize = 20;
    let (mut normal, mut right, mut count) = (DMat4::ZERO, DVec4::ZERO, 0);
    for (i, p) in around.points.iter().enumerate() {
        let from = p - center;
        let out = from.truncate().length() / radius;
        if around.labels[i] == carrier && around.normals[i].z > 0.75 && from.z < 0.0 && out < 1.5 {
            let x = from / radius;
            let row = DVec4::new(1.0, x.x, x.y, x.x * x.x + x.y * x.y);
            normal += DMat4::from_cols(row * row.x, row * row.y, row * row.z, row * row.w);
            right += row * from.z;
            count += 1;
        }
    }
    // A damping of one millionth regularizes a ring of points, for which height and curvature are not separable.
    let damped = normal + DMat4::from_diagonal(DVec4::splat(1e-6 * f64::from(count)));
    (count as usize >= LEAST).then(|| center.z + (damped.inverse() * right).x)
}

/// Returns the height of the plane at the horizontal position of `p`; `None` for a vertical plane.
pub(crate) fn height_at(plane: &Plane, p: DVec3) -> Option<f64> {
    (plane.normal.z.abs() > 1e-6)
        .then(|| (plane.offset - plane.normal.x * p.x - plane.normal.y * p.y) / plane.normal.z)
}

/// Fits a plane within 40° of level to the surface seen around the object's foot. Planes that would cut through the
/// object score lower. If several planes fit (a foot amid clutter), the object's own upright axis decides, because
/// objects stand along it.
fn fit_level_plane(
    candidates: &[usize],
    around: &Surroundings,
    object: &[DVec3],
    seed: Seed,
) -> Option<(Plane, Vec<usize>)> {
    const REACH: f64 = 0.003;
    const TRIALS: usize = 400;
    if candidates.len() < 12 {
        return None;
    }
    let mut rng = seed.derive("rest").rng();
    let at = |i: usize| around.points[i];
    let stride = object.len().div_ceil(500).max(1);
    let upright = upright_axis(object);
    let mut best: Option<(f64, f64, Plane)> = None;
    for trial in 0..TRIALS {
        let [a, b, c]: [usize; 3] =
            std::array::from_fn(|_| candidates[rng.random_range(0..candidates.len())]);
        let normal = match upright {
            Some(axis) if trial % 2 == 1 => axis,
            _ => (at(b) - at(a)).cross(at(c) - at(a)).normalize_or_zero(),
        };
        let normal = if normal.z < 0.0 { -normal } else { normal };
        if normal.z < 0.766 {
            continue;
        }
        let plane = Plane { normal, offset: normal.dot(at(a)) };
        let near = candidates.iter().filter(|&&i| plane.height(at(i)).abs() < REACH).count() as f64;
        let below = object.iter().step_by(stride).filter(|&&p| plane.height(p) < -0.004).count() as f64
            / object.len().div_ceil(stride) as f64;
        let along = upright.map_or(1.0, |axis| {
            let angle = axis.dot(normal).clamp(-1.0, 1.0).acos().to_degrees();
            0.5 + 0.5 * (-(angle / 8.0).powi(2)).exp()
        });
        let score = near * (1.0 - 5.0 * below).max(0.0) * along;
        if best.is_none_or(|b| score > b.0) {
            best = Some((score, near, plane));
        }
    }
    let (_, near, mut plane) = best.filter(|b| b.0 >= 6.0)?;
    let members = |plane: &Plane| -> Vec<usize> {
        candidates.iter().copied().filter(|&i| plane.height(at(i)).abs() < REACH).collect()
    };
    // Refining a plane with only a minority of inliers would turn it towards the clutter.
    if near > 0.5 * candidates.len() as f64 {
        for _ in 0..2 {
            let points: Vec<DVec3> = members(&plane).iter().map(|&i| at(i)).collect();
            plane = Plane::least_squares(&points).unwrap_or(plane);
        }
    }
    let members = members(&plane);
    Some((plane, members))
}

/// Returns the principal axis of an object if it is within 30° of the vertical and clearly longer or shorter than the
/// others.
fn upright_axis(object: &[DVec3]) -> Option<DVec3> {
    let (moments, _) = scatter(object.iter().map(|&p| (p, 1.0)))?;
    let (values, vectors) = principal_axes(moments)?;
    let k = (0..3).max_by(|&a, &b| vectors[a].z.abs().total_cmp(&vectors[b].z.abs()))?;
    let distinct = (0..3).filter(|&o| o != k).all(|o| {
        let ratio = (values[k] / values[o].max(1e-12)).sqrt();
        !(0.7..=1.4).contains(&ratio)
    });
    (distinct && vectors[k].z.abs() > 30f64.to_radians().cos()).then(|| vectors[k] * vectors[k].z.signum())
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: u16 = 1;
    const STOOL: u16 = 2;

    /// Sides of a box of 20 cm that ends at 0.45 m.
    fn sides_of_box() -> Vec<DVec3> {
        let at = |i: u32, z: u32| {
            let (s, side) = (0.01 * f64::from(i % 20) - 0.1, i / 20);
            let z = 0.452 + 0.01 * f64::from(z);
            match side {
                0 => DVec3::new(s, -0.1, z),
                1 => DVec3::new(0.1, s, z),
                2 => DVec3::new(-s, 0.1, z),
                _ => DVec3::new(-0.1, -s, z),
            }
        };
        (0..15).flat_map(|z| (0..80).map(move |i| at(i, z))).collect()
    }

    fn seen(points: impl Iterator<Item = DVec3>, normal: DVec3) -> Surroundings {
        let points: Vec<DVec3> = points.collect();
        let count = points.len();
        Surroundings {
            points,
            normals: vec![normal; count],
            labels: vec![STOOL; count],
            colors: vec![[0; 3]; count],
            ..Surroundings::default()
        }
    }

    fn grid(x: [f64; 2], y: [f64; 2]) -> impl Iterator<Item = DVec3> {
        let step = |range: [f64; 2], k: u32| range[0] + (range[1] - range[0]) * f64::from(k) / 19.0;
        (0..400).map(move |k| DVec3::new(step(x, k / 20), step(y, k % 20), 0.45))
    }

    fn rest_of_box(around: &Surroundings) -> RestingPlane {
        find_rest(&sides_of_box(), BOX, around, Some(0.0), Seed(3))
    }

    #[test]
    fn a_strip_of_a_top_says_nothing_of_how_it_leans() {
        // 3 cm beside the box, with a tilt of 4°, as grazing depth produces.
        let lean = |p: DVec3| p.with_z(0.45 + 0.07 * (p.x - 0.12));
        let rest = rest_of_box(&seen(grid([0.105, 0.135], [-0.1, 0.1]).map(lean), DVec3::Z));
        assert_eq!((rest.carrier, rest.plane.normal), (Carrier::Object(STOOL), DVec3::Z));
        assert!((rest.plane.offset - 0.45).abs() < 1e-3, "{}", rest.plane.offset);
        let steeper = |p: DVec3| p.with_z(0.45 + 0.15 * (p.x - 0.12));
        let rest = rest_of_box(&seen(grid([0.105, 0.135], [-0.1, 0.1]).map(steeper), DVec3::Z));
        assert_eq!((rest.carrier, rest.plane.normal), (Carrier::Object(STOOL), DVec3::Z));
        // A small board that was seen on all sides may also be tilted.
        let small: Vec<DVec3> = sides_of_box()
            .iter()
            .map(|p| p.with_z(0.45 + 0.25 * (p.z - 0.45)) * DVec3::new(0.25, 0.25, 1.0))
            .collect();
        let noise = |p: DVec3| 3e-4 * (900.0 * p.x + 1700.0 * p.y).sin();
        let all_round = |slope: f64| {
            grid([-0.05, 0.05], [-0.05, 0.05]).map(move |p| p.with_z(0.45 + slope * p.x + noise(p)))
        };
        let rest = find_rest(&small, BOX, &seen(all_round(0.07), DVec3::Z), Some(0.0), Seed(3));
        assert!((rest.plane.normal.x + 0.07).abs() < 0.01, "{}", rest.plane.normal);
        let rest = find_rest(&small, BOX, &seen(all_round(0.003), DVec3::Z), Some(0.0), Seed(3));
        assert_eq!(rest.plane.normal, DVec3::Z);
        // A board with the same tilt was seen on all sides.
        let sloping = grid([-0.13, 0.13], [-0.13, 0.13]).map(|p| p.with_z(0.45 + 0.07 * p.x));
        let rest = rest_of_box(&seen(sloping, DVec3::Z));
        assert!((rest.plane.normal.x + 0.07).abs() < 0.01, "{}", rest.plane.normal);
    }

    #[test]
    fn a_carrier_of_which_only_sides_were_seen_ends_where_they_end() {
        let wall = |x: f64, high: f64| {
            let at =
                move |k: u32| DVec3::new(x, 0.02 * f64::from(k % 8) - 0.07, high - 0.002 * f64::from(k / 8));
            (0..80).map(at)
        };
        let bin = || wall(-0.08, 0.451).chain(wall(0.08, 0.451));
        let rest = rest_of_box(&seen(bin(), DVec3::X));
        assert_eq!(rest.carrier, Carrier::Object(STOOL));
        assert!((rest.plane.offset - 0.452).abs() < 1e-9, "{}", rest.plane.offset);
        // Stray points below the box are ignored.
        let strays = (0..40).map(|k| DVec3::new(0.0, 0.0, 0.43 + 5e-4 * f64::from(k)));
        let strayed: Vec<DVec3> = sides_of_box().into_iter().chain(strays).collect();
        assert!((lower_end(&strayed) - 0.452).abs() < 1e-3, "{}", lower_end(&strayed));
        // An unlabelled rim above walls that end too low; too few labels are not enough, regardless of the surface
        // beside them.
        let dark = |labelled: usize| {
            let mut around = seen(wall(-0.08, 0.43).chain(wall(0.08, 0.43)).take(labelled), DVec3::X);
            around.lost_sides = wall(-0.08, 0.451).chain(wall(0.08, 0.451)).map(|p| (p, DVec3::X)).collect();
            rest_of_box(&around).carrier
        };
        assert_eq!((dark(160), dark(20)), (Carrier::Object(STOOL), Carrier::Unseen));
        // A rim that only the reconstruction contains. A rim of another object does not count.
        let thin = |label: u16| {
            let mut around = seen(wall(-0.08, 0.43).chain(wall(0.08, 0.43)), DVec3::X);
            around.own_sides = wall(-0.08, 0.451).chain(wall(0.08, 0.451)).map(|p| (p, label)).collect();
            rest_of_box(&around).carrier
        };
        assert_eq!((thin(STOOL), thin(7)), (Carrier::Object(STOOL), Carrier::Unseen));
        // An object as wide as the box may be its lower part.
        let whole = || wall(-0.1, 0.451).chain(wall(0.1, 0.451)).map(|p| p * DVec3::new(1.0, 1.4, 1.0));
        assert_eq!(rest_of_box(&seen(whole(), DVec3::X)).carrier, Carrier::Unseen);
        // An object that extends up into the box (with the box's mask), or stands beside it, carries nothing.
        for other in [wall(0.0, 0.5), wall(0.0, 0.468), wall(0.14, 0.451)] {
            assert_eq!(rest_of_box(&seen(other, DVec3::X)).carrier, Carrier::Unseen);
        }
    }
}
