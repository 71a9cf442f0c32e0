//! Convex outlines in the plane, counter-clockwise.

use crate::plane::Plane;
use glamx::{DVec2, DVec3};

/// Returns the convex outline of points, counter-clockwise. Fewer than three corners if the points are collinear.
pub fn convex_outline(points: &[DVec2]) -> Vec<DVec2> {
    let mut points = points.to_vec();
    sort(&mut points, |p| *p);
    points.dedup();
    monotone_chain(&points, |p| *p, 0.0)
}

/// Returns the convex outline of points, counter-clockwise. Omits points closer than `nearest` to the one before them,
/// and corners whose triangle with both neighbours has an area of at most half of `flat`.
pub fn convex_outline_of_noisy(mut points: Vec<DVec2>, nearest: f64, flat: f64) -> Vec<DVec2> {
    sort(&mut points, |p| *p);
    points.dedup_by(|a, b| a.distance_squared(*b) < nearest * nearest);
    monotone_chain(&points, |p| *p, flat)
}

/// Sorts points by x, then y, for [`monotone_chain`].
pub(crate) fn sort<T>(points: &mut [T], at: impl Fn(&T) -> DVec2) {
    points.sort_by(|a, b| at(a).x.total_cmp(&at(b).x).then(at(a).y.total_cmp(&at(b).y)));
}

/// Andrew's monotone chain (1979) on sorted points: corners that turn left by more than `flat` (twice the area of the
/// triangle with the two corners before).
pub(crate) fn monotone_chain<T: Copy>(sorted: &[T], at: impl Fn(&T) -> DVec2, flat: f64) -> Vec<T> {
    if sorted.len() < 3 {
        return sorted.to_vec();
    }
    let mut chain: Vec<T> = Vec::with_capacity(sorted.len());
    for pass in 0..2 {
        let base = chain.len();
        for i in 0..sorted.len() {
            let p = sorted[if pass == 0 { i } else { sorted.len() - 1 - i }];
            while chain.len() >= base + 2 {
                let (a, b) = (at(&chain[chain.len() - 2]), at(&chain[chain.len() - 1]));
                if (b - a).perp_dot(at(&p) - a) > flat {
                    break;
                }
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
    }
    chain
}

/// Returns the convex outline of points seen from above.
pub fn outline_of(points: impl Iterator<Item = DVec3>) -> Vec<DVec2> {
    convex_outline(&points.map(DVec3::truncate).collect::<Vec<_>>())
}

/// Returns the ends of each side of an outline.
pub fn sides<P: Copy>(outline: &[P]) -> impl Iterator<Item = (P, P)> {
    (0..outline.len()).map(move |i| (outline[i], outline[(i + 1) % outline.len()]))
}

/// Returns whether a point lies within an outline, or at most `margin` (metres) outside one of its sides.
pub fn is_within(outline: &[DVec2], p: DVec2, margin: f64) -> bool {
    let is_left = |(a, b): (DVec2, DVec2)| (b - a).perp_dot(p - a) >= -margin * (b - a).length();
    outline.len() >= 3 && sides(outline).all(is_left)
}

/// Returns the smallest width of a convex outline, metres; 0 if it has no area.
pub fn width(outline: &[DVec2]) -> f64 {
    if outline.len() < 3 {
        return 0.0;
    }
    let across = |(a, b): (DVec2, DVec2)| {
        outline.iter().map(|p| (b - a).perp_dot(p - a)).fold(0.0, f64::max) / (b - a).length()
    };
    sides(outline).map(across).fold(f64::INFINITY, f64::min)
}

/// Returns the area of a convex outline, square metres.
pub fn area(outline: &[DVec2]) -> f64 {
    sides(outline).map(|(a, b)| 0.5 * a.perp_dot(b)).sum()
}

/// Returns whether two convex outlines have a point in common. Outlines of one or two corners count as points and
/// lines.
pub fn meet(a: &[DVec2], b: &[DVec2]) -> bool {
    let parted_by = |p: &[DVec2], q: &[DVec2]| {
        sides(p).any(|(a, b)| b - a != DVec2::ZERO && q.iter().all(|v| (b - a).perp_dot(v - a) < 0.0))
    };
    !a.is_empty() && !b.is_empty() && !parted_by(a, b) && !parted_by(b, a)
}

/// Returns the corners of the intersection of two convex outlines; none if one has fewer than three corners.
pub fn common(a: &[DVec2], b: &[DVec2]) -> Vec<DVec2> {
    if a.len() < 3 || b.len() < 3 { Vec::new() } else { clipped(a, b) }
}

/// Returns the part of a convex outline, a line or a point within a convex `window` (Sutherland and Hodgman 1974).
pub fn clipped(subject: &[DVec2], window: &[DVec2]) -> Vec<DVec2> {
    let mut left = subject.to_vec();
    for (a, b) in sides(window) {
        let side = |p: DVec2| (b - a).perp_dot(p - a);
        let mut cut = Vec::with_capacity(left.len() + 1);
        for (p, q) in sides(&left) {
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

/// Returns the convex outline, grown by `margin`, of the points less than `band` above a plane. The outline lies on the
/// plane, counter-clockwise around its normal.
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

/// Returns whether `p` lies above the convex outline, seen along the plane's normal.
pub fn is_over(outline: &[DVec3], plane: &Plane, p: DVec3) -> bool {
    sides(outline).all(|(a, b)| (b - a).cross(p - a).dot(plane.normal) >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, y: f64, half: f64) -> [DVec2; 4] {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(s, t)| DVec2::new(x + half * s, y + half * t))
    }

    #[test]
    fn the_outline_of_a_grid_is_its_square_counter_clockwise() {
        let mut points: Vec<DVec2> =
            (0..5).flat_map(|i| (0..5).map(move |j| DVec2::new(f64::from(i), f64::from(j)))).collect();
        points.push(DVec2::new(2.0, 2.0));
        for outline in [convex_outline(&points), convex_outline_of_noisy(points, 1e-9, 1e-12)] {
            assert_eq!((outline.len(), area(&outline)), (4, 16.0));
        }
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
        // A line that passes the corner (1, 1), and one that cuts the corner off.
        let across = |reach: f64| [DVec2::new(reach, 0.0), DVec2::new(0.0, reach)];
        assert!(!meet(&unit, &across(2.1)) && meet(&unit, &across(1.9)));
        // Neither of two crossing strips has a corner inside the other.
        let strip = |x: f64, y: f64| unit.map(|p| p * DVec2::new(x, y));
        assert!(meet(&strip(3.0, 0.1), &strip(0.1, 3.0)));
    }
}
