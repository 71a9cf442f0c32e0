//! Conversion of any mesh to a closed surface of few faces.

use crate::convex::occupancy::InsideVoxels;
use crate::convex::remesh::remesh;
use glamx::DVec3;
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
        let mut edges: Vec<(u32, u32, i8)> = self
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
            .map(|(a, b)| (a.min(b), a.max(b), if a < b { 1 } else { -1 }))
            .collect();
        edges.sort_unstable();
        let balanced = edges
            .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
            .all(|same| same.iter().map(|e| i32::from(e.2)).sum::<i32>() == 0);
        !self.triangles.is_empty() && balanced
    }

    pub(crate) fn volume(&self) -> f64 {
        let corner = |i: u32| self.points[i as usize];
        self.triangles.iter().map(|&[a, b, c]| corner(a).dot(corner(b).cross(corner(c)))).sum::<f64>() / 6.0
    }

    fn flip(&mut self) {
        for t in &mut self.triangles {
            t.swap(1, 2);
        }
    }

    /// Reduces the number of faces by quadric collapses (crate `meshopt`) that move the surface by at most `error`.
    /// Returns the surface unchanged if the result would be open.
    pub(crate) fn decimated(self, faces: usize, error: f64) -> Self {
        if self.triangles.len() <= faces {
            return self;
        }
        let positions: Vec<[f32; 3]> = self.points.iter().map(|p| p.as_vec3().to_array()).collect();
        let indices: Vec<u32> = self.triangles.iter().flatten().copied().collect();
        let kept = meshopt::simplify_decoder(
            &indices,
            &positions,
            faces * 3,
            error as f32,
            meshopt::SimplifyOptions::ErrorAbsolute,
            None,
        );
        let triangles = kept.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        let fewer = Self { points: self.points.clone(), triangles }.compacted();
        if fewer.is_closed() { fewer } else { self }
    }

    /// Reorients faces so that neighbours agree, where edges have two faces each. Sheets with a reoriented face then
    /// face outwards.
    fn agree(&mut self) {
        let mut edges: Vec<(u32, u32, usize, bool)> = Vec::with_capacity(3 * self.triangles.len());
        for (f, &[a, b, c]) in self.triangles.iter().enumerate() {
            edges.extend([(a, b), (b, c), (c, a)].map(|(a, b)| (a.min(b), a.max(b), f, a < b)));
        }
        edges.sort_unstable();
        // The face across, and whether it runs the other way along the edge, as a consistent neighbour does.
        let mut across: Vec<Vec<(usize, bool)>> = vec![Vec::new(); self.triangles.len()];
        for same in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            if let [a, b] = same {
                across[a.2].push((b.2, a.3 != b.3));
                across[b.2].push((a.2, a.3 != b.3));
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
            let corner = |i: u32| self.points[i as usize];
            let six_volume = |f: usize| {
                let [a, b, c] = self.triangles[f].map(corner);
                a.dot(b.cross(c)) * if turned[f] == Some(true) { -1.0 } else { 1.0 }
            };
            let inwards = sheet.iter().map(|&f| six_volume(f)).sum::<f64>() < 0.0;
            for &f in &sheet {
                if (turned[f] == Some(true)) != inwards {
                    self.triangles[f].swap(1, 2);
                }
            }
        }
    }

    /// Closes openings no wider than `width` by fans around their centres.
    fn fill_holes(&mut self, width: f64) {
        let mut edges: Vec<(u32, u32)> =
            self.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
        edges.sort_unstable_by_key(|&(a, b)| (a.min(b), a.max(b), a));
        // Edges without an opposite.
        let mut open: Vec<(u32, u32)> = Vec::new();
        for same in edges.chunk_by(|x, y| (x.0.min(x.1), x.0.max(x.1)) == (y.0.min(y.1), y.0.max(y.1))) {
            let forward = same.iter().filter(|e| e.0 < e.1).count();
            let (more, surplus) = if 2 * forward >= same.len() {
                (same.iter().find(|e| e.0 < e.1), 2 * forward - same.len())
            } else {
                (same.iter().find(|e| e.0 > e.1), same.len() - 2 * forward)
            };
            open.extend(more.into_iter().flat_map(|&e| std::iter::repeat_n(e, surplus)));
        }
        let mut parent: BTreeMap<u32, u32> = open.iter().flat_map(|&(a, b)| [(a, a), (b, b)]).collect();
        fn root(parent: &mut BTreeMap<u32, u32>, mut i: u32) -> u32 {
            while parent[&i] != i {
                let up = parent[&parent[&i]];
                parent.insert(i, up);
                i = up;
            }
            i
        }
        for &(a, b) in &open {
            let (a, b) = (root(&mut parent, a), root(&mut parent, b));
            parent.insert(a.max(b), a.min(b));
        }
        let mut holes: BTreeMap<u32, Vec<(u32, u32)>> = BTreeMap::new();
        for &(a, b) in &open {
            holes.entry(root(&mut parent, a)).or_default().push((a, b));
        }
        for hole in holes.values() {
            let rim = || hole.iter().map(|e| self.points[e.0 as usize]);
            let Some(bounds) = sms_core::Aabb::of_points(rim()) else { continue };
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
        let mut new = vec![u32::MAX; self.points.len()];
        let mut out = Self::default();
        for t in self.triangles {
            out.triangles.push(t.map(|i| {
                if new[i as usize] == u32::MAX {
                    new[i as usize] = out.points.len() as u32;
                    out.points.push(self.points[i as usize]);
                }
                new[i as usize]
            }));
        }
        out
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
        out.flip();
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
