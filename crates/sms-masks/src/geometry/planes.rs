//! Floor, desk, walls: planar pieces that are too large to belong to an object.

use super::GeometryConfig;
use super::assembly::free_standing;
use super::extents::{extents, length, quantile};
use super::fuse::{Neighbors, Surfel, coarsen};
use super::linalg::{mean_and_covariance, symmetric_eigen};
use glamx::DVec3;
use rand::RngExt;
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, QuantileRule};
use sms_frames::Sequence;
use std::collections::{BTreeMap, BTreeSet};

/// A large planar piece of the static surroundings.
#[derive(Debug, Clone)]
pub(crate) struct StaticPlane {
    /// A point of it.
    pub(crate) p_w: DVec3,
    /// Its unit normal towards the cameras.
    pub(crate) n_w: DVec3,
    /// A surfel that faces the same way belongs to the plane within this distance: three times the spread of the
    /// plane's own surfels.
    pub(crate) band_m: f64,
    /// Length of a plane that faces up and is free-standing like a table top or a plank. Only its size makes it static.
    pub(crate) free_length_m: Option<f64>,
}

impl StaticPlane {
    /// Returns the height of a point above the plane.
    pub(crate) fn height(&self, p_w: DVec3) -> f64 {
        self.n_w.dot(p_w - self.p_w)
    }
}

/// Largest length of an oversize structure, as a multiple of the largest structure.
const OVERSIZE: f64 = 2.0;
/// Largest number of candidate pieces before fitting stops.
const MAX_FITS: usize = 60;
/// Number of planes drawn for one fit.
const DRAWS: usize = 160;
/// Smallest cosine between the normals of a plane and of its coarse surfels.
const ALIGNED: f64 = 0.92;
/// The same for fine surfels, whose normals are noisier.
pub(crate) const ROUGHLY_ALIGNED: f64 = 0.75;
/// Size of the coarse cells for the plane search, in fine cells.
const COARSE: f64 = 3.0;
/// Largest bend of real floors, walls and sensors from the plane.
const BEND_M: f64 = 0.015;

/// Returns which surfels are static, the free-standing assembly of each surfel, and the static planes.
///
/// Planes are found on coarse surfels by one-point RANSAC (a surfel and its normal define a plane), one after the
/// other. Each is split into connected pieces; the large ones are static and grow over their smooth continuation. Fine
/// surfels above these pieces are then classified by their distance.
pub(crate) fn static_surfels(
    surfels: &[Surfel],
    graph: &Neighbors,
    sequence: &Sequence,
    config: &GeometryConfig,
    cancel: &Cancel,
) -> Result<(Vec<bool>, Vec<Option<usize>>, Vec<StaticPlane>), CoreError> {
    let cell_m = COARSE * config.voxel_m;
    let (coarse, coarse_graph, parent) = coarsen(surfels, cell_m);
    let mut children: Vec<Vec<u32>> = vec![vec![]; coarse.len()];
    parent.iter().enumerate().for_each(|(i, &c)| children[c as usize].push(i as u32));
    let mut pieces = large_pieces(&coarse, &coarse_graph, cell_m, sequence, config, cancel)?;
    if pieces.iter().all(|(_, n_w)| n_w.z < 0.9)
        && let Some((members, n_w)) = scattered_ground(surfels, graph, config)
    {
        let mut cells: Vec<usize> = members.iter().map(|&i| parent[i] as usize).collect();
        cells.sort_unstable();
        cells.dedup();
        pieces.push((cells, n_w));
    }
    let assemblies = assemblies(&coarse, &coarse_graph, cell_m, &pieces, config);
    let mut assembly_of = vec![None; coarse.len()];
    for (k, members) in assemblies.iter().enumerate() {
        members.iter().for_each(|&c| assembly_of[c] = Some(k));
    }
    pieces.retain(|(m, _)| 2 * m.iter().filter(|&&c| assembly_of[c].is_some()).count() < m.len());
    let mut is_static = vec![false; surfels.len()];
    let mut planes = Vec::with_capacity(pieces.len());
    for (members, n_w) in pieces {
        let fine: Vec<usize> = members.iter().flat_map(|&c| &children[c]).map(|&i| i as usize).collect();
        let mut plane = fit(surfels, &fine, n_w);
        let long = length(&coarse, &members);
        if n_w.z > 0.9
            && (config.max_structure_m..OVERSIZE * config.max_structure_m).contains(&long)
            && stands_free(&coarse, &members, plane.p_w, plane.n_w, cell_m, sequence)
        {
            plane.free_length_m = Some(long);
        }
        let members = extend(&plane, members, &coarse, &coarse_graph);
        // The cells above, below and beside the piece contain its outliers.
        let mut over: Vec<usize> =
            members.iter().flat_map(|&c| coarse_graph.of(c).chain(std::iter::once(c))).collect();
        over.sort_unstable();
        over.dedup();
        for &c in &over {
            let own = members.binary_search(&c).is_ok();
            for &i in &children[c] {
                is_static[i as usize] |= plane.holds(&surfels[i as usize], &coarse[c], own);
            }
        }
        planes.push(plane);
    }
    for _ in 0..2 {
        follow_majority(&mut is_static, surfels, graph, &planes);
    }
    let assembly_of = parent.iter().map(|&c| assembly_of[c as usize]).collect();
    Ok((is_static, assembly_of, planes))
}

/// Returns the free-standing assemblies among the coarse surfels; see [`free_standing`].
fn assemblies(
    coarse: &[Surfel],
    graph: &Neighbors,
    cell_m: f64,
    pieces: &[(Vec<usize>, DVec3)],
    config: &GeometryConfig,
) -> Vec<Vec<usize>> {
    let height = |m: &[usize]| m.iter().map(|&i| coarse[i].p_w.z).sum::<f64>() / m.len().max(1) as f64;
    let level = || pieces.iter().filter(|(_, n_w)| n_w.z > 0.9);
    let lowest = level().map(|(m, _)| height(m)).fold(f64::INFINITY, f64::min);
    let mut is_ground = vec![false; coarse.len()];
    let mut is_static = vec![false; coarse.len()];
    let mut heights = vec![f64::INFINITY; coarse.len()];
    pieces.iter().flat_map(|(m, _)| m).for_each(|&c| is_static[c] = true);
    for (members, n_w) in
        level().filter(|(m, _)| height(m) <= lowest || length(coarse, m) > config.max_structure_m)
    {
        let plane = fit(coarse, members, *n_w);
        extend(&plane, members.clone(), coarse, graph).iter().for_each(|&c| is_ground[c] = true);
        let u = plane.n_w.any_orthonormal_vector();
        let v = plane.n_w.cross(u);
        let wide = 4.0 * cell_m;
        let at = |p: DVec3| ((u.dot(p) / wide).floor() as i64, (v.dot(p) / wide).floor() as i64);
        let over: BTreeSet<(i64, i64)> = members
            .iter()
            .map(|&c| at(coarse[c].p_w))
            .flat_map(|(x, y)| (-2..=2).flat_map(move |i| (-2..=2).map(move |j| (x + i, y + j))))
            .collect();
        for (c, s) in coarse.iter().enumerate().filter(|(_, s)| over.contains(&at(s.p_w))) {
            let h = plane.height(s.p_w);
            heights[c] = heights[c].min(if h < -BEND_M { f64::INFINITY } else { h });
            // Surfels that noise lifts off the ground do not connect pieces.
            is_ground[c] |= (-BEND_M..BEND_M).contains(&h);
        }
    }
    free_standing(coarse, graph, &heights, &is_ground, &is_static, config)
}

/// Returns the large planar pieces of the coarse surfels: members (sorted) and normal.
fn large_pieces(
    coarse: &[Surfel],
    graph: &Neighbors,
    cell_m: f64,
    sequence: &Sequence,
    config: &GeometryConfig,
    cancel: &Cancel,
) -> Result<Vec<(Vec<usize>, DVec3)>, CoreError> {
    let mut rng = config.seed.derive("planes").rng();
    let mut open: Vec<usize> = (0..coarse.len()).collect();
    let mut large = Vec::new();
    // Smallest area of a piece that is long enough to be static.
    let smallest = (STRIP * config.max_face_m2 / cell_m.powi(2)) as usize;
    let band = (3.0 * median(coarse.iter().map(|s| s.sigma_m).collect())).clamp(0.004, 0.01);
    // Objects need a support. If no large piece faces up, the support is the lowest piece that faces up, has some area,
    // and does not stand on a lower surface.
    let mut support: Option<(Vec<usize>, DVec3, f64)> = None;
    for _ in 0..MAX_FITS {
        cancel.check()?;
        if open.len() < smallest.max(3) {
            break;
        }
        let step = open.len().div_ceil(4000);
        let draws: Vec<usize> = (0..DRAWS).map(|_| open[rng.random_range(0..open.len())]).collect();
        let score = |&i: &usize| {
            let s = &coarse[i];
            open.iter().step_by(step).filter(|&&j| fits(&coarse[j], s.p_w, s.n_w, 1.5 * band)).count()
        };
        let scores: Vec<usize> = draws.par_iter().map(score).collect();
        let best =
            (0..DRAWS).max_by_key(|&k| (scores[k], std::cmp::Reverse(draws[k]))).map_or(0, |k| draws[k]);
        let (mut p_w, mut n_w) = (coarse[best].p_w, coarse[best].n_w);
        for _ in 0..4 {
            let on = open.iter().map(|&j| &coarse[j]).filter(|s| fits(s, p_w, n_w, band));
            let Some((mean, covariance, _)) = mean_and_covariance(on.map(|s| (s.p_w, 1.0))) else { break };
            let n = symmetric_eigen(covariance).1[0];
            (p_w, n_w) = (mean, if n.dot(n_w) < 0.0 { -n } else { n });
        }
        let mut on = vec![false; coarse.len()];
        open.iter().for_each(|&j| on[j] = fits(&coarse[j], p_w, n_w, band));
        let pieces = graph.components(|i| on[i]);
        // Each surfel is examined once, whether or not its piece is large.
        open.retain(|&j| !on[j] && j != best);
        if pieces.iter().map(Vec::len).sum::<usize>() < smallest {
            continue;
        }
        if n_w.z > 0.9 {
            for m in &pieces {
                let height = m.iter().map(|&i| coarse[i].p_w.z).sum::<f64>() / m.len() as f64;
                let lower = support.as_ref().is_none_or(|s| height < s.2);
                let wide = m.len() as f64 * cell_m * cell_m > SUPPORT * config.max_face_m2;
                if lower && wide && is_ground(coarse, m, p_w, n_w, cell_m) {
                    support = Some((m.clone(), n_w, height));
                }
            }
        }
        let is_static = |m: &Vec<usize>| {
            is_large(coarse, graph, m, n_w, cell_m, config)
                && (length(coarse, m) > config.max_structure_m
                    // Walls and lips are also free-standing, but are not objects.
                    || n_w.z < UPWARD
                    || !stands_free(coarse, m, p_w, n_w, cell_m, sequence))
        };
        large.extend(pieces.into_iter().filter(is_static).map(|m| (m, n_w)));
    }
    if large.iter().all(|(_, n)| n.z < 0.9) {
        large.extend(support.map(|(members, n_w, _)| (members, n_w)));
    }
    Ok(large)
}

fn fits(s: &Surfel, p_w: DVec3, n_w: DVec3, band: f64) -> bool {
    n_w.dot(s.p_w - p_w).abs() < band && s.n_w.dot(n_w) > ALIGNED
}

fn median(mut values: Vec<f64>) -> f64 {
    sms_core::quantile(&mut values, 0.5, QuantileRule::Nearest).unwrap_or(0.0)
}

/// Smallest area of a piece that may carry something, as a share of the largest face's area.
const SUPPORT: f64 = 0.15;

/// Smallest area of a static piece that is longer than any object (a bin's lip, a rail), as a share of the largest
/// face's area.
const STRIP: f64 = 0.2;

/// Smallest area of a static piece that encloses objects, as a share of the largest face's area: in general, and if it
/// faces up and may carry objects.
const WALL: [f64; 2] = [0.3, 0.15];

/// Returns whether a planar piece is longer or has more area than a face of an object, or has some area and encloses
/// objects.
fn is_large(
    coarse: &[Surfel],
    graph: &Neighbors,
    members: &[usize],
    n_w: DVec3,
    cell_m: f64,
    config: &GeometryConfig,
) -> bool {
    let u = n_w.any_orthonormal_vector();
    let v = n_w.cross(u);
    // Cells across the plane: the thickness of the skin must not count as area.
    let cells: BTreeSet<(i64, i64)> = members
        .iter()
        .map(|&i| {
            let p = coarse[i].p_w;
            ((u.dot(p) / cell_m).floor() as i64, (v.dot(p) / cell_m).floor() as i64)
        })
        .collect();
    let area = cells.len() as f64 * cell_m * cell_m;
    let wall = WALL[usize::from(n_w.z > 0.9)];
    area > config.max_face_m2
        || (area > STRIP * config.max_face_m2 && length(coarse, members) > config.max_object_m)
        || (area > wall * config.max_face_m2 && walls_in(coarse, graph, members, n_w))
}

/// Smallest upward part of the normals of a table top and its edges; walls have less.
const UPWARD: f64 = 0.15;

/// Finds the lowest level plane shared by patches that face up, if together they span more than a face of an object. On
/// metal, on glass and at grazing angles, depth cameras measure only scattered patches. Returns sorted surfels and the
/// normal.
fn scattered_ground(
    surfels: &[Surfel],
    graph: &Neighbors,
    config: &GeometryConfig,
) -> Option<(Vec<usize>, DVec3)> {
    /// Smallest surface of one patch (m²), and of all patches together.
    const PATCH_M2: f64 = 2.25e-4;
    const SHOWN_M2: f64 = 3.6e-3;
    /// Mean normals of a level plane deviate from the vertical by less than 6°; single surfels by more.
    const LEVEL: f64 = 0.995;
    let band = (3.0 * median(surfels.iter().map(|s| s.sigma_m).collect())).clamp(0.004, 0.01);
    let least = PATCH_M2 / config.voxel_m.powi(2);
    let patches = |p_w: DVec3, n_w: DVec3| -> Vec<usize> {
        let on = |s: &Surfel| n_w.dot(s.p_w - p_w).abs() < band && s.n_w.dot(n_w) > ROUGHLY_ALIGNED;
        let mut pieces = graph.components(|i| on(&surfels[i]));
        pieces.retain(|m| m.len() as f64 >= least);
        let mut members = pieces.concat();
        members.sort_unstable();
        members
    };
    let mut heights: Vec<f64> =
        surfels.iter().filter(|s| s.n_w.z > ROUGHLY_ALIGNED).map(|s| s.p_w.z).collect();
    heights.sort_by(f64::total_cmp);
    let mut next = f64::NEG_INFINITY;
    for z in heights {
        if z < next {
            continue;
        }
        next = z + 0.5 * band;
        let (mut p_w, mut n_w) = (DVec3::Z * z, DVec3::Z);
        let mut members = patches(p_w, n_w);
        for _ in 0..6 {
            let points = members.iter().map(|&i| (surfels[i].p_w, 1.0));
            let Some((mean, covariance, _)) = mean_and_covariance(points) else { break };
            let n = aligned(symmetric_eigen(covariance).1[0], DVec3::Z);
            // Patches along a line do not determine the tilt across it.
            (p_w, n_w) = (mean, if n.z > LEVEL { n } else { DVec3::Z });
            members = patches(p_w, n_w);
        }
        let [_, middle, long] = extents(surfels, &members);
        let area = members.len() as f64 * config.voxel_m.powi(2);
        if area > SHOWN_M2 && middle * long > config.max_face_m2 {
            return Some((members, n_w));
        }
    }
    None
}

/// Returns whether nothing beside a piece that faces up reaches below it: neither objects on the same ground nor the
/// walls around both.
fn is_ground(coarse: &[Surfel], members: &[usize], p_w: DVec3, n_w: DVec3, cell_m: f64) -> bool {
    /// Largest sideways distance, in cells.
    const ASIDE: i64 = 3;
    /// Surface below more than this share of the piece's cells is not just noise or mirror images.
    const BELOW: f64 = 0.1;
    let u = n_w.any_orthonormal_vector();
    let v = n_w.cross(u);
    let cell = |s: &Surfel| {
        let d = s.p_w - p_w;
        ((u.dot(d) / cell_m).floor() as i64, (v.dot(d) / cell_m).floor() as i64)
    };
    let own: BTreeSet<(i64, i64)> = members.iter().map(|&i| cell(&coarse[i])).collect();
    let beside: BTreeSet<(i64, i64)> = own
        .iter()
        .flat_map(|&(x, y)| (-ASIDE..=ASIDE).flat_map(move |i| (-ASIDE..=ASIDE).map(move |j| (x + i, y + j))))
        .collect();
    let below = coarse
        .iter()
        .filter(|s| (-4.0 * BEND_M..-BEND_M).contains(&n_w.dot(s.p_w - p_w)) && beside.contains(&cell(s)));
    (below.count() as f64) < BELOW * members.len() as f64
}

/// Smallest share of a rim beyond which the surroundings must be visible: for pieces that face up, and for others.
/// Objects on a table interrupt the rim of its top.
const FREE_RIM: [f64; 2] = [0.35, 0.5];

/// Returns whether a planar piece visibly ends: beyond most of its rim, cameras see through its plane. Floors, walls
/// and desks end at the edge of the view, or at other large surfaces.
fn stands_free(
    coarse: &[Surfel],
    members: &[usize],
    p_w: DVec3,
    n_w: DVec3,
    cell_m: f64,
    sequence: &Sequence,
) -> bool {
    /// Distance beyond the rim, in cells.
    const PAST: i64 = 2;
    let u = n_w.any_orthonormal_vector();
    let v = n_w.cross(u);
    let over = |s: &&Surfel| (0.008..0.1).contains(&n_w.dot(s.p_w - p_w));
    let project = |s: &Surfel| {
        let d = s.p_w - p_w;
        ((u.dot(d) / cell_m).floor() as i64, (v.dot(d) / cell_m).floor() as i64)
    };
    // Around objects on a piece that faces up, its rim says nothing about its end.
    let occupied: BTreeSet<(i64, i64)> = match n_w.z > 0.9 {
        true => coarse.iter().filter(over).map(project).collect(),
        false => BTreeSet::new(),
    };
    let cells: BTreeSet<(i64, i64)> = members.iter().map(|&i| project(&coarse[i])).collect();
    let (mut rim, mut free, mut covered) = (0usize, 0usize, 0usize);
    for &(x, y) in &cells {
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            // A hole of one or two cells has no rim.
            if (1..=PAST + 1).any(|k| cells.contains(&(x + k * dx, y + k * dy))) {
                continue;
            }
            let at = |i: i64, d: i64| (i as f64 + 0.5 + (d * PAST) as f64) * cell_m;
            let past = p_w + u * at(x, dx) + v * at(y, dy);
            rim += 1;
            if is_seen_through(past, sequence) {
                free += 1;
            } else if (1..=PAST).any(|k| occupied.contains(&(x + k * dx, y + k * dy))) {
                covered += 1;
            }
        }
    }
    let needed = FREE_RIM[usize::from(n_w.z <= 0.9)];
    4 * free > rim && free as f64 >= needed * (rim - covered) as f64
}

/// Returns whether at least two frames see through a point, and more than see a surface at it.
pub(crate) fn is_seen_through(p_w: DVec3, sequence: &Sequence) -> bool {
    let (mut seen, mut through) = (0usize, 0usize);
    let step = sequence.len().div_ceil(40).max(1);
    for frame in sequence.frames.iter().step_by(step) {
        let Some((u, v, z)) = frame.camera.project(p_w) else { continue };
        let Some((x, y)) = frame.camera.pixel_at(u, v) else { continue };
        let measured = f64::from(frame.depth[(x, y)]);
        let tolerance = 0.012f64.max(0.015 * z);
        through += usize::from(measured > z + tolerance);
        seen += usize::from(measured > 0.0 && (measured - z).abs() <= tolerance);
    }
    through >= 2 && through > seen
}

/// Returns whether the surfaces beside a planar piece lie in front of it, as inside a bin. The face of an object has
/// the object's other faces, or its support, behind it.
fn walls_in(coarse: &[Surfel], graph: &Neighbors, members: &[usize], n_w: DVec3) -> bool {
    const CLEAR_M: f64 = 0.008;
    let inside: BTreeSet<usize> = members.iter().copied().collect();
    let ring: BTreeSet<usize> =
        members.iter().flat_map(|&i| graph.of(i)).filter(|j| !inside.contains(j)).collect();
    let mean = members.iter().map(|&i| coarse[i].p_w).sum::<DVec3>() / members.len().max(1) as f64;
    let heights = || ring.iter().map(|&j| n_w.dot(coarse[j].p_w - mean));
    let front = heights().filter(|h| *h > CLEAR_M).count();
    let behind = heights().filter(|h| *h < -CLEAR_M).count();
    // A piece that faces up and carries objects may end in an edge towards the camera (a shelf).
    let few = if n_w.z > 0.9 { 1 } else { 4 };
    10 * front > 3 * ring.len() && few * behind < front
}

/// Fits the plane of a piece's fine surfels, with their spread.
fn fit(surfels: &[Surfel], members: &[usize], n_w: DVec3) -> StaticPlane {
    let points = members.iter().map(|&i| (surfels[i].p_w, 1.0));
    let (mut p_w, mut n_w) = match mean_and_covariance(points) {
        Some((mean, covariance, _)) => (mean, aligned(symmetric_eigen(covariance).1[0], n_w)),
        None => (DVec3::ZERO, n_w),
    };
    let spread = |p_w: DVec3, n_w: DVec3| {
        1.4826 * median(members.iter().map(|&i| n_w.dot(surfels[i].p_w - p_w).abs()).collect())
    };
    // Objects on the plane pull the fit up. Only surfels within the spread are used.
    for _ in 0..3 {
        let within = 3.0 * spread(p_w, n_w).max(5e-4);
        let near = members.iter().map(|&i| surfels[i].p_w).filter(|&p| n_w.dot(p - p_w).abs() < within);
        if let Some((mean, covariance, _)) = mean_and_covariance(near.map(|p| (p, 1.0))) {
            (p_w, n_w) = (mean, aligned(symmetric_eigen(covariance).1[0], n_w));
        }
    }
    StaticPlane { p_w, n_w, band_m: (3.0 * spread(p_w, n_w)).clamp(0.0015, 0.008), free_length_m: None }
}

fn aligned(n: DVec3, with: DVec3) -> DVec3 {
    if n.dot(with) < 0.0 { -n } else { n }
}

/// Largest thickness of the cloud around a cell that continues a plane. The limit is higher where noise nearby is:
/// twice the thickness it causes. The edge of a book is thicker, although its slope is only 1:8.
const FLAT_M: f64 = 0.001;
/// Radius of the neighbourhood: noise grows with the square of the depth.
const NEARBY_M: f64 = 0.2;

/// Returns the largest thickness of the cloud around cells that continue a piece, as a function of position.
fn flatness(members: &[usize], coarse: &[Surfel]) -> impl Fn(DVec3) -> f64 + use<> {
    let block = |p: DVec3| (p / NEARBY_M).floor().as_i64vec3().to_array();
    let mut sigmas: BTreeMap<[i64; 3], Vec<f64>> = BTreeMap::new();
    members.iter().for_each(|&i| sigmas.entry(block(coarse[i].p_w)).or_default().push(coarse[i].sigma_m));
    // The lower quartile ignores rims and objects on the piece, which also thicken the cloud.
    let limit = |values: Vec<f64>| (2.0 * quantile(values.into_iter(), 0.25)).max(FLAT_M);
    let all = limit(sigmas.values().flatten().copied().collect());
    let nearby: BTreeMap<[i64; 3], f64> = sigmas.into_iter().map(|(at, own)| (at, limit(own))).collect();
    move |p| nearby.get(&block(p)).copied().unwrap_or(all)
}

/// Grows a piece over coarse surfels that continue it: they face the same way, are as flat as the piece, and rise from
/// a neighbour with a slope below about 1:8.
fn extend(plane: &StaticPlane, mut members: Vec<usize>, coarse: &[Surfel], graph: &Neighbors) -> Vec<usize> {
    let flat_m = flatness(&members, coarse);
    let mut taken = vec![false; coarse.len()];
    members.iter().for_each(|&i| taken[i] = true);
    let mut next = 0;
    while next < members.len() {
        let i = members[next];
        next += 1;
        for j in graph.of(i) {
            let d = coarse[j].p_w - coarse[i].p_w;
            let continues = coarse[j].n_w.dot(plane.n_w) > ALIGNED
                && coarse[j].sigma_m < flat_m(coarse[j].p_w)
                && plane.n_w.dot(d).abs() < 0.001 + 0.12 * d.length()
                && plane.height(coarse[j].p_w).abs() < BEND_M;
            if !taken[j] && continues {
                taken[j] = true;
                members.push(j);
            }
        }
    }
    members.sort_unstable();
    members
}

impl StaticPlane {
    /// Returns whether a fine surfel above one of the plane's cells belongs to the plane. It does within the band if it
    /// faces the same way. It does within a third of the band regardless of its normal: where a wall meets the floor,
    /// normals are mixed and only height decides. Where the plane bends, it does near the coarse surface around it.
    /// `own` is true for a cell of the plane itself: the bottom of a vessel is close to the floor without continuing
    /// it.
    fn holds(&self, s: &Surfel, coarse: &Surfel, own: bool) -> bool {
        let height = self.height(s.p_w);
        let faces = s.n_w.dot(self.n_w) > ROUGHLY_ALIGNED;
        let bends = own
            && coarse.n_w.dot(self.n_w) > 0.97
            && coarse.n_w.dot(s.p_w - coarse.p_w).abs() < self.band_m
            && height.abs() < BEND_M;
        (faces && (height.abs() < self.band_m || bends)) || (height < self.band_m / 3.0 && height > -BEND_M)
    }
}

/// Makes a surfel near a plane static if most of its neighbours are: noise tilts single normals.
fn follow_majority(is_static: &mut [bool], surfels: &[Surfel], graph: &Neighbors, planes: &[StaticPlane]) {
    let joins: Vec<bool> = (0..surfels.len())
        .into_par_iter()
        .map(|i| {
            let (mut all, mut own) = (0, 0);
            for j in graph.of(i) {
                all += 1;
                own += usize::from(is_static[j]);
            }
            let near = |p: &StaticPlane| p.height(surfels[i].p_w).abs() < 1.5 * p.band_m;
            !is_static[i] && 10 * own > 6 * all && planes.iter().any(near)
        })
        .collect();
    is_static.iter_mut().zip(joins).for_each(|(s, j)| *s |= j);
}
