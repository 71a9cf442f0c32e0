//! Overlap of a solid with its convex parts.

use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{Entity, EntityShape, Mesh};

/// Lines across the box of the solid, each way.
const LINES: usize = 256;

/// Returns the collision solids of an entity in the world: its parts, or its sphere, box or cylinder as a fine
/// polyhedron.
pub fn collision_solids(entity: &Entity) -> Vec<Mesh> {
    match &entity.shape {
        EntityShape::Sphere { center_w, radius } => {
            let mut ball = Mesh::icosphere(*radius, 4);
            ball.vertices.iter_mut().for_each(|v| *v += *center_w);
            vec![ball]
        }
        EntityShape::Box { x_ws, half_extents } => vec![Mesh::cuboid(*half_extents).transformed(x_ws)],
        EntityShape::Cylinder { x_ws, radius, half_length } => {
            vec![Mesh::cylinder(*radius, *half_length, 128).transformed(x_ws)]
        }
        EntityShape::Convex => entity.parts.clone(),
        EntityShape::TriMesh if !entity.mesh.is_closed_oriented() => Vec::new(),
        EntityShape::TriMesh => vec![entity.mesh.clone()],
    }
}

/// Intersection over union of a closed solid and the union of closed parts, all in one frame. 65 536 lines along x
/// through the box around everything are cut with the surfaces; along each line the measure is exact. Where a surface
/// intersects itself, points with a positive winding number are inside. `None` if there is no volume.
pub(crate) fn parts_overlap(solid: &Mesh, parts: &[Mesh]) -> Option<f64> {
    let boxes = std::iter::once(solid).chain(parts).filter_map(Mesh::aabb);
    let bounds = boxes.reduce(|a, b| sms_core::Aabb { min: a.min.min(b.min), max: a.max.max(b.max) })?;
    let lines = Lines::new(bounds.min, bounds.extents());
    let inside = lines.spans(solid);
    let mut covered: Vec<Vec<[f64; 2]>> = vec![Vec::new(); LINES * LINES];
    for part in parts {
        for (all, own) in covered.iter_mut().zip(lines.spans(part)) {
            all.extend(own);
        }
    }
    let (mut both, mut either) = (0.0, 0.0);
    for (inside, covered) in inside.iter().zip(covered) {
        let covered = merged(covered);
        let common = common_length(inside, &covered);
        both += common;
        either += length(inside) + length(&covered) - common;
    }
    (either > 0.0).then(|| both / either)
}

/// A grid of lines along x.
struct Lines {
    low: DVec3,
    step: [f64; 2],
}

impl Lines {
    fn new(low: DVec3, size: DVec3) -> Self {
        Self { low, step: [size.y, size.z].map(|s| (s / LINES as f64).max(1e-12)) }
    }

    /// Returns y or z of a line. The odd offset keeps lines off the vertices and edges of synthetic shapes.
    fn at(&self, axis: usize, index: usize) -> f64 {
        self.low[axis + 1] + (index as f64 + 0.487_213_9) * self.step[axis]
    }

    /// Indices of the lines within a range of y or z.
    fn range(&self, axis: usize, low: f64, high: f64) -> std::ops::Range<usize> {
        let index =
            |v: f64| ((v - self.low[axis + 1]) / self.step[axis] - 0.487_213_9).clamp(0.0, LINES as f64);
        index(low).floor() as usize..((index(high).ceil() as usize) + 1).min(LINES)
    }

    /// Returns ranges of x in which each line is inside a closed, outward-oriented mesh, in order.
    fn spans(&self, mesh: &Mesh) -> Vec<Vec<[f64; 2]>> {
        // x of each crossing and the change of the winding number.
        let mut cuts: Vec<Vec<(f64, i32)>> = vec![Vec::new(); LINES * LINES];
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t);
            let twice = (b.y - a.y) * (c.z - a.z) - (b.z - a.z) * (c.y - a.y);
            if twice == 0.0 {
                continue;
            }
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            for j in self.range(1, low.z, high.z) {
                for i in self.range(0, low.y, high.y) {
                    let (y, z) = (self.at(0, i), self.at(1, j));
                    let edge = |p: DVec3, q: DVec3| (q.y - p.y) * (z - p.z) - (q.z - p.z) * (y - p.y);
                    let w = [edge(b, c), edge(c, a), edge(a, b)].map(|w| w / twice);
                    if w.iter().all(|w| *w >= 0.0) {
                        let x = a.x * w[0] + b.x * w[1] + c.x * w[2];
                        // A line enters through a face that points to −x.
                        cuts[j * LINES + i].push((x, if twice > 0.0 { -1 } else { 1 }));
                    }
                }
            }
        }
        cuts.into_par_iter()
            .map(|mut cuts| {
                cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
                let (mut winding, mut start, mut spans) = (0, 0.0, Vec::new());
                for (x, change) in cuts {
                    let before = winding;
                    winding += change;
                    if before <= 0 && winding > 0 {
                        start = x;
                    } else if before > 0 && winding <= 0 {
                        spans.push([start, x]);
                    }
                }
                spans
            })
            .collect()
    }
}

fn length(spans: &[[f64; 2]]) -> f64 {
    spans.iter().map(|[a, b]| b - a).sum()
}

/// The union of ranges, in order.
fn merged(mut spans: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    spans.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut out: Vec<[f64; 2]> = Vec::new();
    for [a, b] in spans {
        match out.last_mut() {
            Some(last) if a <= last[1] => last[1] = last[1].max(b),
            _ => out.push([a, b]),
        }
    }
    out
}

fn common_length(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    let overlap = |p: &[f64; 2], q: &[f64; 2]| (p[1].min(q[1]) - p[0].max(q[0])).max(0.0);
    a.iter().map(|p| b.iter().map(|q| overlap(p, q)).sum::<f64>()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DQuat};

    fn cube(x: f64) -> Mesh {
        Mesh::cuboid(DVec3::splat(0.05)).transformed(&DPose3::from_translation(DVec3::X * x))
    }

    #[test]
    fn closed_forms() {
        // Two cubes that tile a bar cover all of it, with or without overlap; half of the bar is half of it.
        let bar = Mesh::cuboid(DVec3::new(0.1, 0.05, 0.05));
        assert!((parts_overlap(&bar, &[cube(-0.05), cube(0.05)]).unwrap() - 1.0).abs() < 1e-12);
        let overlapping = [cube(-0.05), cube(0.0), cube(0.05)];
        assert!((parts_overlap(&bar, &overlapping).unwrap() - 1.0).abs() < 1e-12);
        assert!((parts_overlap(&bar, &[cube(0.05)]).unwrap() - 0.5).abs() < 1e-12);
        // Separate cubes do not overlap; a shift by half a cube gives a third of the union.
        assert!(parts_overlap(&cube(0.0), &[cube(0.2)]).unwrap().abs() < 1e-12);
        assert!((parts_overlap(&cube(0.0), &[cube(0.05)]).unwrap() - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(parts_overlap(&cube(0.0), &[]), Some(0.0));
        assert_eq!(parts_overlap(&Mesh::default(), &[]), None);
    }

    #[test]
    fn a_turned_ball_in_a_box_is_its_share_of_it() {
        let turn = DPose3::from_parts(DVec3::new(0.3, 0.2, 0.1), DQuat::from_rotation_y(0.7));
        let ball = Mesh::icosphere(0.05, 4);
        let half = Mesh::cuboid(DVec3::splat(0.05));
        let expected = ball.volume() / half.volume();
        let found = parts_overlap(&half.transformed(&turn), &[ball.transformed(&turn)]).unwrap();
        assert!((found / expected - 1.0).abs() < 2e-3, "{found} {expected}");
        // A hollow box: the ball is a void, which the part fills.
        let mut hollow = half.clone();
        let first = hollow.vertices.len() as u32;
        hollow.vertices.extend(&ball.vertices);
        hollow.triangles.extend(ball.triangles.iter().map(|t| [t[0], t[2], t[1]].map(|i| i + first)));
        let found = parts_overlap(&hollow.transformed(&turn), &[half.transformed(&turn)]).unwrap();
        assert!((found - (1.0 - expected)).abs() < 2e-3, "{found}");
    }
}
