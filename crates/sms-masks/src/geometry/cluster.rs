//! From what is not static to objects.

use super::GeometryConfig;
use super::fuse::{Neighbors, Surfel};
use super::planes::{StaticPlane, extents};
use crate::voxels::key_of;
use glamx::DVec3;
use rayon::prelude::*;
use sms_frames::Sequence;
use std::collections::BTreeMap;

/// The objects: sorted lists of surfels, the largest first.
pub(crate) fn clusters(
    surfels: &[Surfel],
    graph: &Neighbors,
    is_static: &[bool],
    planes: &[StaticPlane],
    sequence: &Sequence,
    config: &GeometryConfig,
) -> Vec<Vec<usize>> {
    let pieces = graph.components(|i| !is_static[i]);
    let smallest = (config.min_area_m2 / config.voxel_m.powi(2)) as usize;
    let mut objects: Vec<Vec<usize>> = pieces
        .into_iter()
        .filter(|p| p.len() >= smallest)
        .flat_map(|p| split(surfels, graph, p, config))
        .collect::<Vec<_>>()
        .into_par_iter()
        .filter(|object| is_plausible(surfels, object, planes, sequence, config))
        .collect();
    objects.sort_by_key(|o| (std::cmp::Reverse(o.len()), o[0]));
    objects.truncate(usize::from(u16::MAX) - 1);
    objects
}

/// Whether a piece has the size of an object, stands out from the planes around it, and is seen often enough.
fn is_plausible(
    surfels: &[Surfel],
    object: &[usize],
    planes: &[StaticPlane],
    sequence: &Sequence,
    config: &GeometryConfig,
) -> bool {
    let area = object.len() as f64 * config.voxel_m.powi(2);
    let [_, middle, long] = extents(surfels, object);
    if area < config.min_area_m2
        || long < config.min_object_m
        || middle < 0.9 * config.min_object_m
        // Ragged rims fill little of the rectangle around them.
        || area < 0.35 * middle * long
        || long > config.max_object_m * 1.2
    {
        return false;
    }
    // Not the ragged rim or the skin of a plane: of the heights over each plane, the 90th percentile counts.
    let stands_out = planes.iter().all(|plane| {
        let mut heights: Vec<f64> = object.iter().map(|&i| plane.height(surfels[i].p_w).abs()).collect();
        let at = heights.len() * 9 / 10;
        *heights.select_nth_unstable_by(at, f64::total_cmp).1 > 0.5 * config.min_object_m
    });
    let step = object.len().div_ceil(200);
    let seen = sequence.frames.iter().filter(|frame| {
        let (mut visible, mut all) = (0, 0);
        for &i in object.iter().step_by(step) {
            all += 1;
            let Some((u, v, z)) = frame.camera.project(surfels[i].p_w) else { continue };
            let Some((x, y)) = frame.camera.pixel_at(u, v) else { continue };
            let measured = f64::from(frame.depth[(x, y)]);
            visible += usize::from((measured - z).abs() < 0.012f64.max(0.015 * z));
        }
        visible * 10 >= all
    });
    stands_out && seen.count() as f64 >= (config.min_seen_share * sequence.len() as f64).max(1.0)
}

/// Surfels of one coarse cell that face about the same way.
#[derive(Debug, Clone)]
struct Patch {
    members: Vec<usize>,
    p_w: DVec3,
    n_w: DVec3,
    color: ColorMoments,
}

/// Count, sum and sum of squares of colours, to compare the distributions of two segments.
#[derive(Debug, Clone, Copy, Default)]
struct ColorMoments {
    count: f64,
    sum: DVec3,
    squares: DVec3,
}

impl ColorMoments {
    fn add(&mut self, color: [f32; 3]) {
        let c = DVec3::from_array(color.map(f64::from));
        self.count += 1.0;
        self.sum += c;
        self.squares += c * c;
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.squares += other.squares;
    }

    /// Distance of the means in units of the spreads. Shading alone spreads a colour by about 20 of 255.
    fn distance(&self, other: &Self) -> f64 {
        let (m, n) = (self.sum / self.count.max(1.0), other.sum / other.count.max(1.0));
        let variance =
            (self.squares / self.count.max(1.0) - m * m) + (other.squares / other.count.max(1.0) - n * n);
        let d = m - n;
        (d * d / (variance.max(DVec3::ZERO) + DVec3::splat(2.0 * 20.0 * 20.0))).element_sum().sqrt()
    }
}

/// What is known of the border between two segments.
#[derive(Debug, Clone, Copy, Default)]
struct Border {
    /// Number of pairs of neighbouring surfels across it.
    pairs: f64,
    /// The same, weighted by how sharply each bends inwards (0 to 1).
    crease: f64,
}

/// Splits a connected piece where two convex things meet.
///
/// After locally convex connected patches (Stein et al., "Object partitioning using local convexity", CVPR 2014), with
/// borders judged as a whole: patches merge in the order of how little their border bends inwards (and their colours
/// differ), until every border is a crease. Segments too small to be objects join the neighbour with which they share
/// the longest border. Not every crease separates: see [`are_distinct`].
fn split(
    surfels: &[Surfel],
    graph: &Neighbors,
    piece: Vec<usize>,
    config: &GeometryConfig,
) -> Vec<Vec<usize>> {
    let patches = patches(surfels, &piece, config);
    if patches.len() < 4 {
        return vec![piece];
    }
    let mut patch_of = BTreeMap::new();
    for (k, patch) in patches.iter().enumerate() {
        patch.members.iter().for_each(|&i| {
            patch_of.insert(i, k);
        });
    }
    let mut borders: Vec<BTreeMap<usize, Border>> = vec![BTreeMap::new(); patches.len()];
    for &i in &piece {
        let a = patch_of[&i];
        for j in graph.of(i) {
            let Some(&b) = patch_of.get(&j) else { continue };
            let near = surfels[i].p_w.distance_squared(surfels[j].p_w) < (1.6 * config.voxel_m).powi(2);
            if a < b && near {
                let border = borders[a].entry(b).or_default();
                border.pairs += 1.0;
            }
        }
    }
    for a in 0..patches.len() {
        for (&b, border) in &mut borders[a] {
            border.crease = border.pairs * inward_bend(&patches[a], &patches[b], config);
        }
    }
    let mut segments = Segments::new(&patches, borders);
    segments.merge_while(
        |s, a, b, border| 1.0 - border.crease / border.pairs - 0.1 * s.contrast(a, b).min(2.0),
        1.0 - config.crease_share,
    );
    let smallest = (config.min_area_m2 / config.voxel_m.powi(2)) as usize;
    segments.merge_small(|members| {
        let [_, middle, long] = extents(surfels, members);
        members.len() < smallest || middle < config.min_object_m || long < 1.5 * config.min_object_m
    });
    let is_clutter = extents(surfels, &piece)[2] > config.clutter_m;
    segments.merge_while(
        |s, a, b, border| {
            let (m, n) = (s.size(a) as f64, s.size(b) as f64);
            let contrast = s.contrast(a, b);
            if are_distinct(contrast, border, m.min(n), m.max(n), is_clutter) {
                0.0
            } else {
                1.0 / (1.0 + contrast)
            }
        },
        0.0,
    );
    segments.into_members()
}

fn patches(surfels: &[Surfel], piece: &[usize], config: &GeometryConfig) -> Vec<Patch> {
    let coarse = 3.0 * config.voxel_m;
    let mut cells: BTreeMap<(u64, u8), Vec<usize>> = BTreeMap::new();
    for &i in piece {
        let n = surfels[i].n_w;
        let axis = if n.x.abs() >= n.y.abs() && n.x.abs() >= n.z.abs() {
            0
        } else if n.y.abs() >= n.z.abs() {
            1
        } else {
            2
        };
        let facing = 2 * axis as u8 + u8::from(n[axis] < 0.0);
        if let Some(key) = key_of(surfels[i].p_w, coarse) {
            cells.entry((key, facing)).or_default().push(i);
        }
    }
    cells
        .into_values()
        .map(|members| {
            let mean = |f: &dyn Fn(&Surfel) -> DVec3| members.iter().map(|&i| f(&surfels[i])).sum::<DVec3>();
            let p_w = mean(&|s| s.p_w) / members.len() as f64;
            let n_w = mean(&|s| s.n_w).normalize_or(DVec3::Z);
            let mut color = ColorMoments::default();
            members.iter().for_each(|&i| color.add(surfels[i].color));
            Patch { members, p_w, n_w, color }
        })
        .collect()
}

/// 0 for borders that are flat or bend outwards, rising to 1 for inward bends of twice the crease angle.
fn inward_bend(a: &Patch, b: &Patch, config: &GeometryConfig) -> f64 {
    let d = (a.p_w - b.p_w).normalize_or(DVec3::X);
    let angle = a.n_w.angle_between(b.n_w);
    let inward = (a.n_w - b.n_w).dot(d) < 0.0;
    if inward { ((angle - 0.5 * config.crease_rad) / config.crease_rad).clamp(0.0, 1.0) } else { 0.0 }
}

/// Whether two segments with a crease between them are two things. In a piece too large to be one thing the colours or
/// the width of the border decide; a piece of an object's size is one thing (a toy's head, a bottle's cap) unless colours
/// differ clearly across a sharp crease and no side is a mere detail, or the two touch in little more than a point.
fn are_distinct(contrast: f64, border: &Border, smaller: f64, larger: f64, is_clutter: bool) -> bool {
    // Pairs grow with the border's length and surfels with the area: the ratio does not depend on size.
    let width = border.pairs / smaller.sqrt();
    let sharp = border.crease > 0.5 * border.pairs;
    if is_clutter {
        contrast > 1.2 || width < 12.0
    } else {
        sharp && smaller > 0.2 * larger && (contrast > 1.5 || width < 1.5)
    }
}

/// Segments that merge pairwise, and their borders.
struct Segments {
    members: Vec<Option<Vec<usize>>>,
    colors: Vec<ColorMoments>,
    /// Borders of each segment, under both of its sides' numbers.
    borders: Vec<BTreeMap<usize, Border>>,
}

impl Segments {
    fn new(patches: &[Patch], one_sided: Vec<BTreeMap<usize, Border>>) -> Self {
        let mut borders = one_sided.clone();
        for (a, list) in one_sided.into_iter().enumerate() {
            for (b, border) in list {
                borders[b].insert(a, border);
            }
        }
        let members = patches.iter().map(|p| Some(p.members.clone())).collect();
        Self { members, colors: patches.iter().map(|p| p.color).collect(), borders }
    }

    fn size(&self, a: usize) -> usize {
        self.members[a].as_ref().map_or(0, Vec::len)
    }

    /// Merges the pair whose border scores highest (the first of equals) until none scores above `least`.
    fn merge_while(&mut self, score: impl Fn(&Self, usize, usize, &Border) -> f64, least: f64) {
        loop {
            let mut best: Option<(f64, usize, usize)> = None;
            for a in 0..self.borders.len() {
                for (&b, border) in self.borders[a].range(a + 1..) {
                    let s = score(self, a, b, border);
                    if s > least && best.is_none_or(|(t, _, _)| s > t) {
                        best = Some((s, a, b));
                    }
                }
            }
            let Some((_, a, b)) = best else { break };
            self.merge(a, b);
        }
    }

    /// Merges segments that are too small into the neighbour with the longest border, smallest first.
    fn merge_small(&mut self, is_small: impl Fn(&[usize]) -> bool) {
        loop {
            let candidate = (0..self.members.len())
                .filter(|&a| !self.borders[a].is_empty())
                .filter(|&a| self.members[a].as_ref().is_some_and(|m| is_small(m)))
                .min_by_key(|&a| (self.size(a), a));
            let Some(a) = candidate else { break };
            let longest =
                self.borders[a].iter().max_by(|x, y| x.1.pairs.total_cmp(&y.1.pairs).then(y.0.cmp(x.0)));
            let Some((&b, _)) = longest else { break };
            self.merge(a.min(b), a.max(b));
        }
    }

    /// Merges `b` into `a`.
    fn merge(&mut self, a: usize, b: usize) {
        if let Some(moved) = self.members[b].take() {
            self.members[a].get_or_insert_default().extend(moved);
        }
        let color = self.colors[b];
        self.colors[a].merge(&color);
        for (c, border) in std::mem::take(&mut self.borders[b]) {
            self.borders[c].remove(&b);
            if c != a {
                for (x, y) in [(a, c), (c, a)] {
                    let sum = self.borders[x].entry(y).or_default();
                    sum.pairs += border.pairs;
                    sum.crease += border.crease;
                }
            }
        }
    }

    /// How different the colours of two segments are.
    fn contrast(&self, a: usize, b: usize) -> f64 {
        self.colors[a].distance(&self.colors[b])
    }

    fn into_members(self) -> Vec<Vec<usize>> {
        let mut all: Vec<Vec<usize>> = self.members.into_iter().flatten().collect();
        all.iter_mut().for_each(|m| m.sort_unstable());
        all
    }
}
