//! Convex outlines in a plane, counter-clockwise: of what stands on what, seen from above.

use crate::plane::Plane;
use glamx::{DVec2, DVec3};

/// Convex outline, counter-clockwise (Andrew's monotone chain). Fewer than three corners where points lie on a line.
pub fn convex_outline(points: &[DVec2]) -> Vec<DVec2> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    sorted.dedup();
    if sorted.len() < 3 {
        return sorted;
    }
    let turn = |o: DVec2, a: DVec2, b: DVec2| (a - o).perp_dot(b - o);
    let mut chain: Vec<DVec2> = Vec::new();
    for pass in 0..2 {
        let base = chain.len();
        let ordered: Box<dyn Iterator<Item = &DVec2>> =
            if pass == 0 { Box::new(sorted.iter()) } else { Box::new(sorted.iter().rev()) };
        for &p in ordered {
            while chain.len() >= base + 2 && turn(chain[chain.len() - 2], chain[chain.len() - 1], p) <= 0.0 {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
    }
    chain
}

/// The convex outline of points from above.
pub fn outline_of(points: impl Iterator<Item = DVec3>) -> Vec<DVec2> {
    convex_outline(&points.map(DVec3::truncate).collect::<Vec<_>>())
}

/// Whether a point lies within an outline, or at most `margin` (metres) outside of one of its sides.
pub fn is_within(outline: &[DVec2], p: DVec2, margin: f64) -> bool {
    let is_left = |i: usize| {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        (b - a).perp_dot(p - a) >= -margin * (b - a).length()
    };
    outline.len() >= 3 && (0..outline.len()).all(is_left)
}

/// How wide a convex outline is where it is narrowest, metres; nothing where it has no area.
pub fn width(outline: &[DVec2]) -> f64 {
    if outline.len() < 3 {
        return 0.0;
    }
    let across = |i: usize| {
        let (start, edge) = (outline[i], outline[(i + 1) % outline.len()] - outline[i]);
        let far = outline.iter().map(|p| edge.perp_dot(p - start)).fold(0.0, f64::max);
        far / edge.length()
    };
    (0..outline.len()).map(across).fold(f64::INFINITY, f64::min)
}

/// Area of a convex outline, square metres.
pub fn area(outline: &[DVec2]) -> f64 {
    (0..outline.len()).map(|i| 0.5 * outline[i].perp_dot(outline[(i + 1) % outline.len()])).sum()
}

/// Whether two convex outlines have a point in common; one of fewer than three corners as the points or the line it has.
pub fn meet(a: &[DVec2], b: &[DVec2]) -> bool {
    let parted_by = |p: &[DVec2], q: &[DVec2]| {
        (0..p.len()).any(|i| {
            let (start, edge) = (p[i], p[(i + 1) % p.len()] - p[i]);
            edge != DVec2::ZERO && q.iter().all(|v| edge.perp_dot(v - start) < 0.0)
        })
    };
    !a.is_empty() && !b.is_empty() && !parted_by(a, b) && !parted_by(b, a)
}

/// Corners of what two convex outlines have in common.
pub fn common(a: &[DVec2], b: &[DVec2]) -> Vec<DVec2> {
    if a.len() < 3 || b.len() < 3 {
        return Vec::new();
    }
    let mut left = a.to_vec();
    for i in 0..b.len() {
        let (start, edge) = (b[i], b[(i + 1) % b.len()] - b[i]);
        let side = |p: DVec2| edge.perp_dot(p - start);
        let mut cut = Vec::with_capacity(left.len() + 1);
        for j in 0..left.len() {
            let (p, q) = (left[j], left[(j + 1) % left.len()]);
            let (sp, sq) = (side(p), side(q));
            if sp >= 0.0 {
                cut.push(p);
            }
            if sp * sq < 0.0 {
                cut.push(p.lerp(q, sp / (sp - sq)));
            }
        }
        left = cut;
    }
    left
}

/// The convex outline, grown by `margin`, of the points less than `band` above a plane: on the plane, counter-clockwise
/// seen from its normal.
pub fn outline_on_plane(points: &[DVec3], plane: &Plane, band: f64, margin: f64) -> Vec<DVec3> {
    let u = plane.normal.any_orthonormal_vector();
    let v = plane.normal.cross(u);
    let near = points.iter().filter(|&&p| plane.height(p) < band);
    let grown: Vec<DVec2> = near
        .flat_map(|p| {
            (0..8).map(move |k| {
                let (sin, cos) = (std::f64::consts::FRAC_PI_4 * f64::from(k)).sin_cos();
                DVec2::new(p.dot(u), p.dot(v)) + margin * DVec2::new(cos, sin)
            })
        })
        .collect();
    convex_outline(&grown).iter().map(|p| u * p.x + v * p.y + plane.normal * plane.offset).collect()
}

/// Whether `p` lies over the convex outline, seen along the plane's normal.
pub fn is_over(outline: &[DVec3], plane: &Plane, p: DVec3) -> bool {
    (0..outline.len()).all(|i| {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        (b - a).cross(p - a).dot(plane.normal) >= 0.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, half: f64) -> [DVec2; 4] {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(s, t)| DVec2::new(x + half * s, y + half * t))
    }

    #[test]
    fn the_outline_holds_its_points() {
        let point = |i: i32| DVec2::new(f64::from(i * 37 % 100) / 100.0, f64::from(i * 61 % 100) / 50.0);
        let points: Vec<DVec2> = (0..100).map(point).collect();
        let outline = convex_outline(&points);
        assert!(outline.len() >= 4);
        assert!(!is_within(&outline, DVec2::new(-0.1, 0.5), 0.0));
        assert!(is_within(&outline, DVec2::new(-0.1, 0.5), 0.2));
        for p in points {
            assert!(is_within(&outline, p.lerp(DVec2::new(0.5, 1.0), 1e-6), 0.0));
        }
    }

    #[test]
    fn what_two_outlines_have_in_common() {
        assert!((width(&square(0.3, 0.0, 0.2)) - 0.4).abs() < 1e-12);
        assert_eq!(width(&[DVec2::ZERO, DVec2::X]), 0.0);
        let both = common(&square(0.0, 0.0, 1.0), &square(1.5, 0.5, 1.0));
        assert!((area(&both) - 0.5 * 1.5).abs() < 1e-12, "{both:?}");
        assert!((area(&common(&square(0.0, 0.0, 1.0), &square(0.1, 0.0, 0.2))) - 0.16).abs() < 1e-12);
        assert!(common(&square(0.0, 0.0, 1.0), &square(3.0, 0.0, 1.0)).is_empty());
    }

    #[test]
    fn outlines_meet_where_they_have_a_point_in_common() {
        let (unit, far) = (square(0.0, 0.0, 1.0), DVec2::new(3.0, 0.0));
        assert!(meet(&unit, &square(1.5, 0.0, 1.0)));
        assert!(meet(&unit, &square(0.1, 0.0, 0.1)) && meet(&square(0.1, 0.0, 0.1), &unit));
        assert!(!meet(&unit, &square(2.5, 0.0, 1.0)));
        assert!(!meet(&unit, &[]));
        assert!(meet(&unit, &[DVec2::ZERO]) && !meet(&unit, &[far]));
        // A line that passes the corner (1, 1), and one that cuts it off.
        let across = |reach: f64| [DVec2::new(reach, 0.0), DVec2::new(0.0, reach)];
        assert!(!meet(&unit, &across(2.1)) && meet(&unit, &across(1.9)));
        // Neither of two crossing strips has a corner in the other one.
        let strip = |x: f64, y: f64| unit.map(|p| p * DVec2::new(x, y));
        assert!(meet(&strip(3.0, 0.1), &strip(0.1, 3.0)));
    }
}
