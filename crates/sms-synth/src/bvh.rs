//! A bounding volume hierarchy over triangles, in `f32`: nearest hit and any hit.

use glamx::{Vec3, Vec3A, Vec4};

/// A triangle prepared for intersection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Triangle {
    corner: Vec3A,
    edge1: Vec3A,
    edge2: Vec3A,
}

impl Triangle {
    pub(crate) fn new(a: Vec3, b: Vec3, c: Vec3) -> Self {
        Self { corner: a.into(), edge1: (b - a).into(), edge2: (c - a).into() }
    }

    /// Distance and barycentric coordinates (of the second and third corner) along the ray (Möller & Trumbore 1997).
    fn hit(&self, ray: &Ray, t_max: f32) -> Option<(f32, f32, f32)> {
        // Slightly inclusive edges, so that no ray passes between two triangles.
        const SLACK: f32 = 2e-6;
        let p = ray.direction.cross(self.edge2);
        let det = self.edge1.dot(p);
        if det.abs() < 1e-20 {
            return None;
        }
        let inverse = 1.0 / det;
        let s = ray.origin - self.corner;
        let u = s.dot(p) * inverse;
        if !(-SLACK..=1.0 + SLACK).contains(&u) {
            return None;
        }
        let q = s.cross(self.edge1);
        let v = ray.direction.dot(q) * inverse;
        if v < -SLACK || u + v > 1.0 + SLACK {
            return None;
        }
        let t = self.edge2.dot(q) * inverse;
        (t > ray.t_min && t < t_max).then_some((t, u, v))
    }
}

/// A ray. `direction` need not be a unit vector; distances are in its units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ray {
    pub(crate) origin: Vec3A,
    pub(crate) direction: Vec3A,
    inverse: Vec3A,
    pub(crate) t_min: f32,
}

impl Ray {
    pub(crate) fn new(origin: Vec3, direction: Vec3, t_min: f32) -> Self {
        // A component of exactly zero would make 0 · ∞ in the slab test.
        let safe = |d: f32| if d.abs() < 1e-12 { 1e-12f32.copysign(d) } else { d };
        let direction = Vec3A::new(safe(direction.x), safe(direction.y), safe(direction.z));
        Self { origin: origin.into(), direction, inverse: direction.recip(), t_min }
    }
}

/// The nearest triangle along a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TriangleHit {
    pub(crate) t: f32,
    pub(crate) u: f32,
    pub(crate) v: f32,
    /// Index in the order in which the triangles were given.
    pub(crate) triangle: u32,
}

/// A box and, in the fourth lanes, the bits of (first child or triangle, number of triangles; 0 for inner nodes).
#[derive(Debug, Clone, Copy)]
struct BvhNode {
    low: Vec4,
    high: Vec4,
}

impl BvhNode {
    fn first(&self) -> usize {
        self.low.w.to_bits() as usize
    }

    fn count(&self) -> usize {
        self.high.w.to_bits() as usize
    }

    fn enter(&self, ray: &Ray, t_max: f32) -> Option<f32> {
        let a = (Vec3A::from_vec4(self.low) - ray.origin) * ray.inverse;
        let b = (Vec3A::from_vec4(self.high) - ray.origin) * ray.inverse;
        let near = a.min(b).max_element().max(ray.t_min);
        let far = a.max(b).min_element().min(t_max);
        // Rounding of the slabs must not lose a box that the ray grazes.
        (near <= far * 1.000_001).then_some(near)
    }
}

/// The hierarchy.
#[derive(Debug, Clone)]
pub(crate) struct Bvh {
    nodes: Vec<BvhNode>,
    triangles: Vec<Triangle>,
    order: Vec<u32>,
}

const LEAF: usize = 4;
const BINS: usize = 16;
const DEPTH: usize = 64;

#[derive(Clone, Copy)]
struct BvhBounds {
    low: Vec3,
    high: Vec3,
}

impl BvhBounds {
    const EMPTY: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    fn join(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    fn half_area(self) -> f32 {
        let e = (self.high - self.low).max(Vec3::ZERO);
        e.x * e.y + e.y * e.z + e.z * e.x
    }
}

impl Bvh {
    /// Builds the hierarchy by binned surface-area splits (Wald 2007).
    pub(crate) fn build(corners: &[[Vec3; 3]]) -> Self {
        let bounds: Vec<BvhBounds> = corners
            .iter()
            .map(|[a, b, c]| BvhBounds { low: a.min(*b).min(*c), high: a.max(*b).max(*c) })
            .collect();
        let mut order: Vec<u32> = (0..corners.len() as u32).collect();
        let mut nodes = Vec::with_capacity(corners.len());
        if !corners.is_empty() {
            nodes.push(BvhNode { low: Vec4::ZERO, high: Vec4::ZERO });
            split(&mut nodes, 0, &bounds, &mut order, 0, 0);
        }
        let triangles =
            order.iter().map(|&i| corners[i as usize]).map(|[a, b, c]| Triangle::new(a, b, c)).collect();
        Self { nodes, triangles, order }
    }

    /// Returns the nearest hit closer than `t_max`.
    pub(crate) fn nearest(&self, ray: &Ray, t_max: f32) -> Option<TriangleHit> {
        let mut best: Option<TriangleHit> = None;
        let mut limit = t_max;
        let mut stack = [(0usize, 0.0f32); DEPTH];
        let mut top = 0;
        if let Some(near) = self.nodes.first().and_then(|n| n.enter(ray, limit)) {
            stack[0] = (0, near);
            top = 1;
        }
        while top > 0 {
            top -= 1;
            let (index, near) = stack[top];
            if near > limit {
                continue;
            }
            let node = &self.nodes[index];
            let (first, count) = (node.first(), node.count());
            if count > 0 {
                for i in first..first + count {
                    if let Some((t, u, v)) = self.triangles[i].hit(ray, limit) {
                        limit = t;
                        best = Some(TriangleHit { t, u, v, triangle: self.order[i] });
                    }
                }
                continue;
            }
            let mut children = [first, first + 1].map(|child| (child, self.nodes[child].enter(ray, limit)));
            // The nearer child is popped first.
            if let (Some(left), Some(right)) = (children[0].1, children[1].1)
                && left <= right
            {
                children.swap(0, 1);
            }
            for (child, near) in children {
                if let Some(near) = near {
                    stack[top] = (child, near);
                    top += 1;
                }
            }
        }
        best
    }

    /// Returns whether any triangle is hit closer than `t_max`.
    pub(crate) fn any(&self, ray: &Ray, t_max: f32) -> bool {
        let mut stack = [0usize; DEPTH];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let node = &self.nodes[stack[top]];
            if node.enter(ray, t_max).is_none() {
                continue;
            }
            let (first, count) = (node.first(), node.count());
            if count > 0 {
                if self.triangles[first..first + count].iter().any(|t| t.hit(ray, t_max).is_some()) {
                    return true;
                }
            } else {
                stack[top] = first;
                stack[top + 1] = first + 1;
                top += 2;
            }
        }
        false
    }
}

fn split(
    nodes: &mut Vec<BvhNode>,
    at: usize,
    bounds: &[BvhBounds],
    order: &mut [u32],
    offset: usize,
    depth: usize,
) {
    let of = |i: &u32| bounds[*i as usize];
    let center = |i: &u32| 0.5 * (of(i).low + of(i).high);
    let whole = order.iter().fold(BvhBounds::EMPTY, |b, i| b.join(of(i)));
    let leaf = |nodes: &mut Vec<BvhNode>, first: usize, count: usize| {
        nodes[at] = BvhNode {
            low: whole.low.extend(f32::from_bits(first as u32)),
            high: whole.high.extend(f32::from_bits(count as u32)),
        };
    };
    // The traversal's stack bounds the depth; a pathological set ends in larger leaves.
    if order.len() <= LEAF || depth + 2 >= DEPTH {
        leaf(nodes, offset, order.len());
        return;
    }
    let centers =
        order.iter().map(center).fold(BvhBounds::EMPTY, |b, c| b.join(BvhBounds { low: c, high: c }));
    let extent = centers.high - centers.low;
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in 0..3 {
        if extent[axis] <= 1e-9 {
            continue;
        }
        let scale = BINS as f32 / extent[axis];
        let mut bins = [(BvhBounds::EMPTY, 0usize); BINS];
        for i in order.iter() {
            let b = (((center(i)[axis] - centers.low[axis]) * scale) as usize).min(BINS - 1);
            bins[b] = (bins[b].0.join(of(i)), bins[b].1 + 1);
        }
        let mut right_cost = [0.0f32; BINS];
        let mut right = (BvhBounds::EMPTY, 0usize);
        for b in (1..BINS).rev() {
            right = (right.0.join(bins[b].0), right.1 + bins[b].1);
            right_cost[b] = right.0.half_area() * right.1 as f32;
        }
        let mut left = (BvhBounds::EMPTY, 0usize);
        for b in 1..BINS {
            left = (left.0.join(bins[b - 1].0), left.1 + bins[b - 1].1);
            let cost = left.0.half_area() * left.1 as f32 + right_cost[b];
            if left.1 > 0 && left.1 < order.len() && best.is_none_or(|(c, _, _)| cost < c) {
                best = Some((cost, axis, b));
            }
        }
    }
    let middle = match best {
        Some((_, axis, bin)) => {
            let scale = BINS as f32 / extent[axis];
            let is_left =
                |i: &u32| (((center(i)[axis] - centers.low[axis]) * scale) as usize).min(BINS - 1) < bin;
            order.sort_by_key(|i| !is_left(i));
            order.iter().filter(|i| is_left(i)).count()
        }
        None => order.len() / 2,
    };
    let first = nodes.len();
    leaf(nodes, first, 0);
    nodes.extend([BvhNode { low: Vec4::ZERO, high: Vec4::ZERO }; 2]);
    let (left, right) = order.split_at_mut(middle);
    split(nodes, first, bounds, left, offset, depth + 1);
    split(nodes, first + 1, bounds, right, offset + middle, depth + 1);
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn soup(seed: u64, n: usize) -> Vec<[Vec3; 3]> {
        use rand::RngExt;
        let mut rng = sms_core::Seed(seed).rng();
        let mut p = |s: f32| Vec3::from_array(std::array::from_fn(|_| (rng.random::<f32>() - 0.5) * s));
        (0..n)
            .map(|_| {
                let c = p(2.0);
                [c + p(0.3), c + p(0.3), c + p(0.3)]
            })
            .collect()
    }

    proptest! {
        #[test]
        fn agrees_with_testing_every_triangle(seed in 0u64..500, n in 1usize..200,
            d in prop::array::uniform3(-1.0f32..1.0), o in prop::array::uniform3(-2.0f32..2.0)) {
            let corners = soup(seed, n);
            let bvh = Bvh::build(&corners);
            let direction = Vec3::from(d);
            prop_assume!(direction.length() > 0.1);
            let ray = Ray::new(Vec3::from(o), direction, 0.0);
            let mut expected: Option<f32> = None;
            for [a, b, c] in &corners {
                if let Some((t, _, _)) = Triangle::new(*a, *b, *c).hit(&ray, expected.unwrap_or(f32::INFINITY)) {
                    expected = Some(t);
                }
            }
            let found = bvh.nearest(&ray, f32::INFINITY);
            prop_assert_eq!(found.map(|h| h.t), expected);
            prop_assert_eq!(bvh.any(&ray, f32::INFINITY), expected.is_some());
            if let Some(hit) = found {
                let [a, b, c] = corners[hit.triangle as usize];
                let p = a + (b - a) * hit.u + (c - a) * hit.v;
                prop_assert!((p - (Vec3::from(o) + direction * hit.t)).length() < 1e-4);
                prop_assert!(!bvh.any(&ray, 0.5 * hit.t) || corners.len() > 1);
            }
        }
    }

    #[test]
    fn an_empty_scene_is_never_hit() {
        let bvh = Bvh::build(&[]);
        let ray = Ray::new(Vec3::ZERO, Vec3::X, 0.0);
        assert!(bvh.nearest(&ray, 1.0).is_none() && !bvh.any(&ray, 1.0));
    }
}
