//! Hulls with a vertex budget.

use crate::hull::convex_hull;
use glamx::DVec3;
use sms_core::{Aabb, Mesh};

/// Returns the hull of `points` with at most `max_vertices` vertices and nearly the exact hull's volume.
///
/// A hull of fewer vertices lies inside the exact hull and would lose up to a tenth of the volume of a round part. It
/// is therefore scaled up about its centre until the volumes agree, but kept inside the bounding box of the exact hull,
/// so that parts still stand on the ground. Returns `None` when the points are coplanar.
///
/// ```
/// use sms_core::{Mesh, glamx::DVec3};
/// let ball = Mesh::icosphere(0.1, 4);
/// let hull = sms_mesh::limited_hull(&ball.vertices, 32).unwrap();
/// assert!(hull.vertices.len() <= 32 && hull.is_closed_oriented());
/// assert!((hull.volume() / ball.volume() - 1.0).abs() < 0.02);
/// ```
pub fn limited_hull(points: &[DVec3], max_vertices: usize) -> Option<Mesh> {
    let max_vertices = max_vertices.max(4);
    let slight = SLIGHT * Aabb::of_points(points.iter().copied())?.extents().max_element();
    let exact = convex_hull(points, usize::MAX, slight)?;
    if exact.vertices.len() <= max_vertices {
        return Some(exact);
    }
    let bounds = exact.aabb()?;
    let wanted = exact.volume();
    let mut hull = convex_hull(&exact.vertices, max_vertices, slight)?;
    for _ in 0..ROUNDS {
        let ratio = (wanted / hull.volume()).cbrt();
        if !(ratio - 1.0 > CLOSE && ratio.is_finite()) {
            break;
        }
        let middle = hull.vertices.iter().sum::<DVec3>() / hull.vertices.len() as f64;
        let grown: Vec<DVec3> = hull
            .vertices
            .iter()
            .map(|&v| (middle + (v - middle) * ratio.min(MOST)).clamp(bounds.min, bounds.max))
            .collect();
        let Some(next) = convex_hull(&grown, max_vertices, slight) else { break };
        if next.volume() <= hull.volume() {
            break;
        }
        hull = next;
    }
    Some(hull)
}

const ROUNDS: usize = 8;

/// Relative tolerance of lengths at which volumes count as equal.
const CLOSE: f64 = 5e-4;

/// Largest scale of one round.
const MOST: f64 = 1.05;

/// Smallest distance of a corner outside the hull, in longest sides. Closer points would only make faces without area.
const SLIGHT: f64 = 1e-6;
