//! Conversion of any mesh to a closed surface of few faces.

use crate::convex::occupancy::InsideVoxels;
use crate::convex::piece::six_volume;
use crate::convex::remesh::remesh;
use crate::smooth::collapsed;
use crate::union_find::{find, unite};
use glamx::DVec3;
use sms_core::{Aabb, Mesh};
use std::collections::BTreeMap;

/// Openings up to this width, in half sizes of the object, are holes of a scan instead of mouths of vessels.
const WIDEST_HOLE: f64 = 0.2;

/// Number of faces of surfaces to cut, in smooth places.
const FACES: usize = 2000;

/// Largest number of faces in rough places: tangles of needles would take forever.
pub(crate) const MOST_FACES: usize = 6000;

/// Voxels along the longest side for remeshing: the first resolution with few enough faces is used.
const RESOLUTIONS: [usize; 4] = [80, 40, 24, 12];

/// A surface in unit coordinates: centred, with the longest side of length 2.
#[derive(Debug, Clone, Default)]
pub(crate) struct TriangleSurface {
    pub(crate) points: Vec<DVec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl TriangleSurface {
    /// Returns whether every directed edge occurs as often as its opposite. The winding number is then an integer
    /// everywhere, even where more than two faces share an edge.
    pub(crate) fn is_closed(&self) -> bool {
        let is_balanced = |same: &[FaceEdge]| 2 * same.iter().filter(|e| e.forward).count() == same.len();
        !self.triangles.is_empty() && self.sorted_edges().chunk_by(FaceEdge::is_same).all(is_balanced)
    }

    fn sorted_edges(&self) -> Vec<FaceEdge> {
        let of_face = |(face, &[a, b, c]): (usize, &[u32; 3])| {
            [(a, b), (b, c), (c, a)].map(|(a, b)| FaceEdge {
                ends: [a.min(b), a.max(b)],
                face,
                forward: a < b,
            })
        };
        let mut edges: Vec<FaceEdge> = self.triangles.iter().enumerate().flat_map(of_face).collect();
        edges.sort_unstable();
        edges
    }

    pub(crate) fn volume(&self) -> f64 {
        self.triangles.iter().map(|t| six_volume(t.map(|i| self.points[i as usize]))).sum::<f64>() / 6.0
    }

    /// Reduces the number of faces by collapses that move the surface by at most `error`. Returns the surface unchanged
    /// if the result would be open.
    pub(crate) fn decimated(self, faces: usize, error: f64) -> Self {
        if self.triangles.len() <= faces {
            return self;
        }
        let positions: Vec<[f32; 3]> = self.points.iter().map(|p| p.as_vec3().to_array()).collect();
        let triangles = collapsed(&self.triangles, &positions, faces, error);
        let fewer = Self { points: self.points.clone(), triangles }.compacted();
        if fewer.is_closed() { fewer } else { self }
    }

    /// Reorients faces so that neighbours agree, where edges have two faces each. Sheets with a reoriented face then
    /// face outwards.
    fn agree(&mut self) {
        // The face across, and whether it runs the other way along the edge, as a consistent neighbour does.
        let mut across: Vec<Vec<(usize, bool)>> = vec![Vec::new(); self.triangles.len()];
        for same in self.sorted_edges().chunk_by(FaceEdge::is_same) {
            if let [a, b] = same {
                across[a.face].push((b.face, a.forward != b.forward));
                across[b.face].push((a.face, a.forward != b.forward));
            }
        }
        let mut turned: Vec<Option<bool>> = vec![None; self.triangles.len()];
        for first in 0..self.triangles.len() {
            if turned[first].is_some() {
                continue;
            }
            turned[first] = Some(false);
            let mut sheet = vec![first];
            let mut at = 0;
            while at < sheet.len() {
                let f = sheet[at];
                at += 1;
                for &(g, agrees) in &across[f] {
                    if turned[g].is_none() {
                        turned[g] = turned[f].map(|t| t == agrees);
                        sheet.push(g);
                    }
                }
            }
            if !sheet.iter().any(|&f| turned[f] == Some(true)) {
                continue;
            }
            let volume = |&f: &usize| {
                let corners = self.triangles[f].map(|i| self.points[i as usize]);
                six_volume(corners) * if turned[f] == Some(true) { -1.0 } else { 1.0 }
            };
            let inwards = sheet.iter().map(volume).sum::<f64>() < 0.0;
            for &f in &sheet {
                if (turned[f] == Some(true)) != inwards {
                    self.triangles[f].swap(1, 2);
                }
            }
        }
    }

    /// Closes openings no wider than `width` by fans around their centres.
    fn fill_holes(&mut self, width: f64) {
        // Edges without an opposite.
        let mut open: Vec<(u32, u32)> = Vec::new();
        for same in self.sorted_edges().chunk_by(FaceEdge::is_same) {
            let [a, b] = same[0].ends;
            let forward = same.iter().filter(|e| e.forward).count();
            let backward = same.len() - forward;
            let edge = if forward > backward { (a, b) } else { (b, a) };
            open.extend(std::iter::repeat_n(edge, forward.abs_diff(backward)));
        }
        let mut parent: Vec<u32> = (0..self.points.len() as u32).collect();
        for &(a, b) in &open {
            unite(&mut parent, a, b);
        }
        let mut holes: BTreeMap<u32, Vec<(u32, u32)>> = BTreeMap::new();
        for &(a, b) in &open {
            holes.entry(find(&mut parent, a)).or_default().push((a, b));
        }
        for hole in holes.values() {
            let rim = || hole.iter().map(|e| self.points[e.0 as usize]);
            let Some(bounds) = Aabb::of_points(rim()) else { continue };
            if bounds.extents().max_element() > width {
                continue;
            }
            let center = rim().sum::<DVec3>() / hole.len() as f64;
            let apex = self.points.len() as u32;
            self.points.push(center);
            self.triangles.extend(hole.iter().map(|&(a, b)| [b, a, apex]));
        }
    }

    fn compacted(self) -> Self {
        let Mesh { vertices, triangles, .. } = Mesh::new(self.points, self.triangles).compacted();
        Self { points: vertices, triangles }
    }
}

#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct FaceEdge {
    /// The ends, ascending.
    ends: [u32; 2],
    face: usize,
    /// Whether the face passes the edge from the smaller end to the greater one.
    forward: bool,
}

impl FaceEdge {
    fn is_same(&self, other: &Self) -> bool {
        self.ends == other.ends
    }
}

/// Returns the surface without non-finite vertices, with equal vertices merged and degenerate triangles dropped. An
/// inverted surface is turned outwards.
pub(crate) fn clean(points: &[DVec3], triangles: &[[u32; 3]]) -> TriangleSurface {
    let mut ids: BTreeMap<[u64; 3], u32> = BTreeMap::new();
    let mut out = TriangleSurface::default();
    let mut id_of = vec![u32::MAX; points.len()];
    for (i, &p) in points.iter().enumerate() {
        if !p.is_finite() {
            continue;
        }
        // Adding zero turns −0 into 0.
        let key = (p + DVec3::ZERO).to_array().map(f64::to_bits);
        id_of[i] = *ids.entry(key).or_insert_with(|| {
            out.points.push(p);
            out.points.len() as u32 - 1
        });
    }
    for t in triangles {
        let t = t.map(|i| id_of.get(i as usize).copied().unwrap_or(u32::MAX));
        if !t.contains(&u32::MAX) && t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
            out.triangles.push(t);
        }
    }
    let mut out = out.compacted();
    if !out.is_closed() {
        out.agree();
    }
    if !out.is_closed() {
        out.fill_holes(WIDEST_HOLE);
    }
    if out.is_closed() && out.volume() < 0.0 {
        out.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    out
}

/// Returns a closed surface of the solid that triangles bound, with few faces for its roughness and at most
/// [`MOST_FACES`]. Closed triangles with consistent winding are kept; others are remeshed on a grid that is coarse
/// enough. Returns `None` when they enclose no volume. `threshold` is the allowed concavity of parts.
pub(crate) fn closed_surface(
    points: &[DVec3],
    triangles: &[[u32; 3]],
    threshold: f64,
) -> Option<TriangleSurface> {
    let surface = clean(points, triangles);
    if surface.triangles.is_empty() {
        return None;
    }
    let few = |s: TriangleSurface| {
        let s = s.decimated(FACES, 0.06 * threshold);
        [0.2, 0.4].iter().fold(s, |s, share| s.decimated(MOST_FACES, share * threshold))
    };
    if surface.is_closed() && surface.volume() > 1e-9 && !InsideVoxels::new(&surface, 64).is_tangled() {
        let few = few(surface.clone());
        if few.triangles.len() <= MOST_FACES {
            return Some(few);
        }
    }
    RESOLUTIONS
        .iter()
        .filter_map(|&resolution| Some(few(remesh(&surface, resolution)?)))
        .find(|s| s.triangles.len() <= MOST_FACES)
}
