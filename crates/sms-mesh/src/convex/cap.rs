//! Caps: the flat regions that close a cut.
//!
//! Only the signed boundary of the region is kept, as edges with integer weights. A fan from any point of the plane to
//! these edges has the region's signed area, even if the outline intersects itself. Cutting the region again clips the
//! edges and closes them along the line where the two planes meet. On a line the chain with given ends is unique. So
//! nothing is triangulated, and a cap has about as many edges as its outlines. (Fans clipped triangle by triangle would
//! double with every cut near their apex: fifteen levels of a tangled mesh made half a million.)

use crate::convex::piece::six_volume;
use crate::plane::Plane;
use glamx::DVec3;

/// A directed edge of a cap's boundary.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    pub(crate) ends: [DVec3; 2],
    /// Number of times the edge is passed in this direction.
    pub(crate) weight: i32,
    /// Whether the edge lies where two cuts meet, instead of on the surface.
    pub(crate) is_inner: bool,
}

impl Edge {
    pub(crate) fn of_surface(ends: [DVec3; 2]) -> Self {
        Self { ends, weight: 1, is_inner: false }
    }
}

/// A cap of a piece.
#[derive(Debug, Clone)]
pub(crate) struct Cap {
    /// Outward normal of the cap's plane.
    pub(crate) normal: DVec3,
    pub(crate) edges: Vec<Edge>,
}

impl Cap {
    /// Six times the signed volume between the cap and the origin.
    pub(crate) fn six_volume(&self) -> f64 {
        let Some(first) = self.edges.first() else { return 0.0 };
        let apex = first.ends[0];
        self.edges.iter().map(|e| f64::from(e.weight) * six_volume([apex, e.ends[0], e.ends[1]])).sum()
    }

    /// Splits the cap by a plane. The parts below and above are added to `sides`, and the edges that the lower side
    /// gains in the plane to `outline`.
    pub(crate) fn split(&self, plane: Plane, sides: [&mut Vec<Cap>; 2], outline: &mut Vec<Edge>) {
        let mut halves = [(); 2].map(|()| Half::default());
        for e in &self.edges {
            let [sa, sb] = e.ends.map(|p| side_of(plane, p));
            if sa * sb < 0 {
                let cut = between(e.ends[0], e.ends[1], plane);
                let first = usize::from(sa > 0);
                halves[first].push(Edge { ends: [e.ends[0], cut], ..*e }, false, true);
                halves[1 - first].push(Edge { ends: [cut, e.ends[1]], ..*e }, true, false);
            } else if sa != 0 || sb != 0 {
                halves[usize::from(sa + sb > 0)].push(*e, sa == 0, sb == 0);
            }
        }
        if halves.iter().all(|h| h.edges.is_empty()) {
            // The whole cap lies in the plane and belongs to the side of its material.
            let is_low = self.normal.dot(plane.normal) > 0.0;
            if is_low {
                outline.extend(&self.edges);
            }
            sides[usize::from(!is_low)].push(self.clone());
            return;
        }
        for (k, (half, side)) in halves.into_iter().zip(sides).enumerate() {
            let Half { mut edges, ends } = half;
            if edges.is_empty() {
                continue;
            }
            let closing = chain(ends);
            if k == 0 {
                outline.extend(&closing);
            }
            edges.extend(closing);
            side.push(Cap { normal: self.normal, edges });
        }
    }
}

/// The edges on one side of a plane, and their ends in the plane. The count of an end is positive where the boundary
/// enters.
#[derive(Default)]
struct Half {
    edges: Vec<Edge>,
    ends: Vec<(DVec3, i32)>,
}

impl Half {
    fn push(&mut self, edge: Edge, starts_in_plane: bool, ends_in_plane: bool) {
        self.edges.push(edge);
        if starts_in_plane {
            self.ends.push((edge.ends[0], -edge.weight));
        }
        if ends_in_plane {
            self.ends.push((edge.ends[1], edge.weight));
        }
    }
}

/// Returns edges along a line that connect `ends`: points of the line with the weight that arrives there.
fn chain(mut ends: Vec<(DVec3, i32)>) -> Vec<Edge> {
    let Some(bounds) = sms_core::Aabb::of_points(ends.iter().map(|e| e.0)) else { return Vec::new() };
    let axis = bounds.extents().max_position();
    ends.sort_by(|a, b| a.0[axis].total_cmp(&b.0[axis]));
    let mut weight = 0;
    let mut out = Vec::new();
    for pair in ends.windows(2) {
        weight += pair[0].1;
        if weight != 0 && pair[0].0 != pair[1].0 {
            out.push(Edge { ends: [pair[0].0, pair[1].0], weight, is_inner: true });
        }
    }
    out
}

/// Returns the same boundary with each edge once. Edges passed in both directions cancel.
pub(crate) fn tidy(mut edges: Vec<Edge>) -> Vec<Edge> {
    for e in &mut edges {
        if e.ends[1].to_array() < e.ends[0].to_array() {
            e.ends.swap(0, 1);
            e.weight = -e.weight;
        }
    }
    let bits = |e: &Edge| e.ends.map(|p| p.to_array().map(f64::to_bits));
    edges.sort_by_cached_key(bits);
    let mut out: Vec<Edge> = Vec::with_capacity(edges.len());
    for e in edges {
        match out.last_mut() {
            Some(last) if last.ends == e.ends => {
                last.weight += e.weight;
                last.is_inner |= e.is_inner;
            }
            _ => out.push(e),
        }
    }
    out.retain(|e| e.weight != 0);
    out
}

/// Returns −1 for a point below a plane, 1 for a point above it, and 0 within a hair of it.
pub(crate) fn side_of(plane: Plane, p: DVec3) -> i8 {
    const HAIR: f64 = 1e-9;
    let h = plane.height(p);
    i8::from(h > HAIR) - i8::from(h < -HAIR)
}

/// Returns the point where an edge crosses a plane; bitwise equal for both orders of its ends.
pub(crate) fn between(a: DVec3, b: DVec3, plane: Plane) -> DVec3 {
    let (a, b) = if a.to_array() < b.to_array() { (a, b) } else { (b, a) };
    let (ha, hb) = (plane.height(a), plane.height(b));
    a + (b - a) * (ha / (ha - hb))
}
