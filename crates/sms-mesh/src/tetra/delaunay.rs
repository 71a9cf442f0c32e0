//! Delaunay tetrahedralisation by incremental insertion (Bowyer 1981, Watson 1981) on exact predicates.
//!
//! The outside of the convex hull is filled with *ghost* tetrahedra that join each hull face to a vertex at infinity,
//! so that points outside and inside are inserted in the same way. Exact predicates with strict conflicts make every
//! cavity star-shaped, even in degenerate cases: grids, cospherical sets and duplicates need no special case and no
//! perturbation.

use crate::predicates::{FACES, collinear, in_sphere, orient};
use crate::tetra::hilbert::insertion_order;
use glamx::DVec3;

/// Marks a missing neighbour beyond a hull face.
pub const NONE: u32 = u32::MAX;
/// The vertex at infinity.
const GHOST: u32 = u32::MAX;
/// A freed slot.
const FREE: [u32; 4] = [u32::MAX; 4];

/// Tetrahedra that fill the convex hull of points, each with an empty circumsphere.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tetrahedralization {
    /// Input points in their order.
    pub points: Vec<DVec3>,
    /// Corner indices; every tetrahedron has positive volume.
    pub tetrahedra: Vec<[u32; 4]>,
    /// The tetrahedron across the face opposite each corner, or [`NONE`] at the hull.
    pub neighbors: Vec<[u32; 4]>,
    /// Number of points that coincide exactly with an earlier one and belong to no tetrahedron.
    pub duplicates: usize,
}

impl Tetrahedralization {
    /// Returns the corners of tetrahedron `t`.
    pub fn corners(&self, t: usize) -> [DVec3; 4] {
        self.tetrahedra[t].map(|i| self.points[i as usize])
    }

    /// Returns the volume of tetrahedron `t`.
    pub fn volume(&self, t: usize) -> f64 {
        let [a, b, c, d] = self.corners(t);
        (d - a).dot((b - a).cross(c - a)) / 6.0
    }

    /// Returns the circumcentre of tetrahedron `t`; `None` if the tetrahedron is too flat for floating-point precision.
    pub fn circumcenter(&self, t: usize) -> Option<DVec3> {
        let corners = self.corners(t);
        to_circumcenter(corners).map(|offset| corners[0] + offset)
    }
}

/// Returns the vector from the first of four points to the centre of their sphere; `None` if they are nearly coplanar.
pub(crate) fn to_circumcenter([a, b, c, d]: [DVec3; 4]) -> Option<DVec3> {
    let (u, v, w) = (b - a, c - a, d - a);
    let (uv, vw, wu) = (u.cross(v), v.cross(w), w.cross(u));
    let offset =
        (u.length_squared() * vw + v.length_squared() * wu + w.length_squared() * uv) / (2.0 * u.dot(vw));
    offset.is_finite().then_some(offset)
}

/// Returns the Delaunay tetrahedralisation of `points`; it has no tetrahedra when all points are coplanar.
///
/// ```
/// use sms_core::glamx::DVec3;
/// let corners: Vec<DVec3> =
///     (0..8).map(|i| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64)).collect();
/// let mesh = sms_mesh::tetra::delaunay(&corners);
/// let volume: f64 = (0..mesh.tetrahedra.len()).map(|t| mesh.volume(t)).sum();
/// assert!((volume - 1.0).abs() < 1e-12);
/// ```
///
/// # Panics
/// If a coordinate is not finite.
pub fn delaunay(points: &[DVec3]) -> Tetrahedralization {
    assert!(points.iter().all(|p| p.is_finite()), "Delaunay needs finite coordinates");
    let order = insertion_order(points);
    let Some(seed) = first_simplex(points, &order) else {
        return Tetrahedralization { points: points.to_vec(), ..Default::default() };
    };
    let mut builder = DelaunayBuilder::new(points, seed);
    for &i in &order {
        if !seed.contains(&i) {
            builder.insert(i);
        }
    }
    builder.finish()
}

/// Returns four points that are not coplanar.
fn first_simplex(points: &[DVec3], order: &[u32]) -> Option<[u32; 4]> {
    let at = |i: u32| points[i as usize];
    let a = *order.first()?;
    let b = *order.iter().find(|&&i| at(i) != at(a))?;
    let c = *order.iter().find(|&&i| !collinear(at(a), at(b), at(i)))?;
    let d = *order.iter().find(|&&i| orient(at(a), at(b), at(c), at(i)) != 0.0)?;
    Some(if orient(at(a), at(b), at(c), at(d)) > 0.0 { [a, b, c, d] } else { [b, a, c, d] })
}

#[derive(Default)]
struct DelaunayBuilder<'a> {
    points: &'a [DVec3],
    tets: Vec<[u32; 4]>,
    neighbors: Vec<[u32; 4]>,
    free: Vec<u32>,
    /// Per tetrahedron: `2 · stamp` if the current insertion found a conflict, `2 · stamp + 1` if it found none.
    mark: Vec<u32>,
    stamp: u32,
    last: u32,
    duplicates: usize,
    cavity: Vec<u32>,
    stack: Vec<u32>,
    rim: Vec<(u32, u8)>,
    edges: EdgeTable,
}

impl<'a> DelaunayBuilder<'a> {
    fn new(points: &'a [DVec3], seed: [u32; 4]) -> Self {
        let mut builder = Self {
            points,
            tets: Vec::with_capacity(points.len() * 8),
            neighbors: Vec::with_capacity(points.len() * 8),
            mark: vec![0; 5],
            ..Self::default()
        };
        builder.tets.push(seed);
        builder.neighbors.push([1, 2, 3, 4]);
        for i in 0..4 {
            // Seen from the ghost, the face has the opposite orientation, hence the swap.
            let mut ghost = seed;
            ghost[i] = GHOST;
            let (x, y) = ((i + 1) % 4, (i + 2) % 4);
            ghost.swap(x, y);
            let mut across = [1, 2, 3, 4];
            across[i] = 0;
            across.swap(x, y);
            builder.tets.push(ghost);
            builder.neighbors.push(across);
        }
        builder
    }

    fn at(&self, i: u32) -> DVec3 {
        self.points[i as usize]
    }

    fn face_orient(&self, tet: [u32; 4], face: usize, q: DVec3) -> f64 {
        let [a, b, c] = FACES[face].map(|k| self.at(tet[k]));
        orient(a, b, c, q)
    }

    fn in_conflict(&self, t: u32, q: DVec3) -> bool {
        let tet = self.tets[t as usize];
        match tet.iter().position(|&v| v == GHOST) {
            None => in_sphere(self.at(tet[0]), self.at(tet[1]), self.at(tet[2]), self.at(tet[3]), q) > 0.0,
            Some(ghost) => {
                // The sphere of a ghost is the half space beyond its hull face. In the plane of the face it is the
                // circumcircle of the face, where the sphere of the solid neighbour intersects the plane.
                let side = self.face_orient(tet, ghost, q);
                side < 0.0 || (side == 0.0 && self.in_conflict(self.neighbors[t as usize][ghost], q))
            }
        }
    }

    /// Returns a tetrahedron that contains `q`, or a ghost whose hull face sees `q`.
    fn locate(&self, q: DVec3) -> u32 {
        let mut t = self.last;
        if let Some(ghost) = self.tets[t as usize].iter().position(|&v| v == GHOST) {
            t = self.neighbors[t as usize][ghost];
        }
        let mut previous = NONE;
        let mut random = self.stamp.wrapping_mul(0x9E37_79B9) | 1;
        'walk: loop {
            let tet = self.tets[t as usize];
            if tet.contains(&GHOST) {
                return t;
            }
            // A random first face keeps the walk from circling (Devillers et al. 2002).
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let start = (random >> 30) as usize;
            for k in 0..4 {
                let face = (k + start) & 3;
                let next = self.neighbors[t as usize][face];
                if next != previous && self.face_orient(tet, face, q) > 0.0 {
                    previous = t;
                    t = next;
                    continue 'walk;
                }
            }
            return t;
        }
    }

    fn insert(&mut self, point: u32) {
        let q = self.at(point);
        let first = self.locate(q);
        if self.tets[first as usize].iter().any(|&v| v != GHOST && self.at(v) == q) {
            self.duplicates += 1;
            return;
        }
        self.stamp += 1;
        let (inside, outside) = (self.stamp * 2, self.stamp * 2 + 1);
        let mut cavity = std::mem::take(&mut self.cavity);
        let mut stack = std::mem::take(&mut self.stack);
        let mut rim = std::mem::take(&mut self.rim);
        cavity.clear();
        rim.clear();
        cavity.push(first);
        stack.push(first);
        self.mark[first as usize] = inside;
        while let Some(t) = stack.pop() {
            for face in 0..4 {
                let next = self.neighbors[t as usize][face];
                let mark = self.mark[next as usize];
                if mark == inside {
                    continue;
                }
                if mark != outside {
                    if self.in_conflict(next, q) {
                        self.mark[next as usize] = inside;
                        cavity.push(next);
                        stack.push(next);
                        continue;
                    }
                    self.mark[next as usize] = outside;
                }
                rim.push((t, face as u8));
            }
        }
        self.edges.reset(rim.len() * 3);
        for &(t, face) in &rim {
            self.join(point, t, face as usize);
        }
        for &t in &cavity {
            self.tets[t as usize] = FREE;
            self.mark[t as usize] = 0;
            self.free.push(t);
        }
        self.cavity = cavity;
        self.stack = stack;
        self.rim = rim;
    }

    /// Joins the new point to the rim face `face` of cavity tetrahedron `t`.
    fn join(&mut self, point: u32, t: u32, face: usize) {
        let mut tet = self.tets[t as usize];
        tet[face] = point;
        let across = self.neighbors[t as usize][face];
        let id = match self.free.pop() {
            Some(slot) => {
                self.tets[slot as usize] = tet;
                slot
            }
            None => {
                self.tets.push(tet);
                self.neighbors.push(FREE);
                self.mark.push(0);
                (self.tets.len() - 1) as u32
            }
        };
        let mut links = FREE;
        links[face] = across;
        if let Some(back) = self.neighbors[across as usize].iter().position(|&n| n == t) {
            self.neighbors[across as usize][back] = id;
        }
        for side in 0..4 {
            if side == face {
                continue;
            }
            // The face opposite `side` has the new point and the two remaining corners.
            let mut edge = (0..4).filter(|&k| k != face && k != side).map(|k| tet[k]);
            let (a, b) = (edge.next().unwrap_or(GHOST), edge.next().unwrap_or(GHOST));
            if let Some((other, other_side)) = self.edges.pair((a.min(b), a.max(b)), (id, side as u8)) {
                links[side] = other;
                self.neighbors[other as usize][other_side as usize] = id;
            }
        }
        self.neighbors[id as usize] = links;
        self.last = id;
    }

    fn finish(self) -> Tetrahedralization {
        let mut id = vec![NONE; self.tets.len()];
        let mut tetrahedra = Vec::with_capacity(self.tets.len());
        for (t, tet) in self.tets.iter().enumerate() {
            if !tet.contains(&GHOST) {
                id[t] = tetrahedra.len() as u32;
                tetrahedra.push(*tet);
            }
        }
        let neighbors = (0..self.tets.len())
            .filter(|&t| id[t] != NONE)
            .map(|t| self.neighbors[t].map(|n| id[n as usize]))
            .collect();
        let (points, duplicates) = (self.points.to_vec(), self.duplicates);
        Tetrahedralization { points, tetrahedra, neighbors, duplicates }
    }
}

/// Matches the two new tetrahedra that share an edge of the cavity's rim. Open addressing; reused between insertions.
#[derive(Default)]
struct EdgeTable {
    slots: Vec<(u32, u32, u32, u8, u32)>,
    mask: usize,
    epoch: u32,
}

impl EdgeTable {
    fn reset(&mut self, entries: usize) {
        let capacity = (entries * 2).next_power_of_two().max(16);
        if self.slots.len() < capacity {
            self.slots = vec![(0, 0, 0, 0, 0); capacity];
            self.epoch = 0;
        }
        self.mask = self.slots.len() - 1;
        self.epoch += 1;
    }

    /// Returns the tetrahedron that registered this edge before, or registers this one.
    fn pair(&mut self, edge: (u32, u32), offer: (u32, u8)) -> Option<(u32, u8)> {
        let mut h = (edge.0.wrapping_mul(0x9E37_79B1) ^ edge.1.wrapping_mul(0x85EB_CA6B)) as usize;
        h ^= h >> 15;
        loop {
            let slot = &mut self.slots[h & self.mask];
            if slot.4 != self.epoch {
                *slot = (edge.0, edge.1, offer.0, offer.1, self.epoch);
                return None;
            }
            if (slot.0, slot.1) == edge {
                return Some((slot.2, slot.3));
            }
            h += 1;
        }
    }
}
