//! Toppling loads of stacks: closed forms of statics.

use crate::scene::{SupportLevel, TruthObject, TruthScene};
use glamx::DVec2;
use sms_core::Mesh;
use sms_mesh::outline::{clipped, convex_outline_of_noisy};

/// Acceleration of gravity, m/s².
const GRAVITY: f64 = 9.81;
/// Faces within this height of each other touch, metres.
const TOUCH_M: f64 = 1e-6;
/// As [`TOUCH_M`], for scanned models with less level faces.
const SCANNED_TOUCH_M: f64 = 1e-4;

impl SupportLevel {
    /// Returns the smallest vertical force at `p_w` (metres) that tips the load above, of the given mass (kg) and centre of
    /// mass, over an edge of the contact, newtons. Infinite if no force does, 0 if it tips without one.
    ///
    /// The load stays as long as the common centre of pressure of weight and force lies within the hull of the contact.
    /// With the inward normal `n` of an edge through `q`: `M g n·(c − q) + F n·(p − q) = 0`.
    pub fn tipping_load_n(&self, mass_kg: f64, com_w: DVec2, p_w: DVec2) -> f64 {
        let corners: Vec<DVec2> = self.footprint_w.iter().map(|&q| q.into()).collect();
        if corners.len() < 3 {
            return 0.0;
        }
        let mut least = f64::INFINITY;
        for (i, &q) in corners.iter().enumerate() {
            let inward = (corners[(i + 1) % corners.len()] - q).perp().normalize_or_zero();
            let (weight_arm, load_arm) = (inward.dot(com_w - q), inward.dot(p_w - q));
            if weight_arm <= 0.0 {
                return 0.0;
            }
            if load_arm < 0.0 {
                least = least.min(mass_kg * GRAVITY * weight_arm / -load_arm);
            }
        }
        least
    }
}

impl TruthScene {
    /// Returns the smallest vertical force at a point (world, metres) of the landing platform that topples the structure: the
    /// platform off its base, or the whole off its feet. Newtons; infinite if no force does, 0 if it topples by itself. `None`
    /// without a landing platform.
    pub fn tipping_load_n(&self, p_w: DVec2) -> Option<f64> {
        let landing = self.landing.as_ref()?;
        let carrying = landing.supports.iter().filter(|s| s.above.contains(&landing.platform));
        Some(carrying.map(|s| self.support_load_n(s, p_w)).fold(f64::INFINITY, f64::min))
    }

    /// As [`TruthScene::tipping_load_n`], for one level; the point may lie on any object above it.
    pub fn support_load_n(&self, support: &SupportLevel, p_w: DVec2) -> f64 {
        let above = || self.objects.iter().filter(|o| support.above.contains(&o.name));
        let mass: f64 = above().map(|o| o.mass.mass()).sum();
        let moment: DVec2 = above().map(|o| o.x_wb.translation.truncate() * o.mass.mass()).sum();
        support.tipping_load_n(mass, moment / mass, p_w)
    }
}

/// Computes the level at which `upper` stands on `lower` (`None`: the floor): the convex hull of the contact of its lowest faces
/// with upper faces.
pub(crate) fn support(
    upper: &TruthObject,
    lower: Option<&TruthObject>,
    carried: &[&TruthObject],
) -> SupportLevel {
    let height = upper.aabb_w().min.z;
    let feet = level(upper, height, false);
    let points: Vec<DVec2> = match lower {
        None => feet.concat(),
        Some(lower) => {
            let tops = level(lower, height, true);
            let pairs = feet.iter().flat_map(|foot| tops.iter().map(move |top| touching(foot, top)));
            pairs.flatten().collect()
        }
    };
    let names = std::iter::once(upper).chain(carried.iter().copied()).map(|o| o.name.clone());
    SupportLevel {
        above: names.collect(),
        below: lower.map(|o| o.name.clone()),
        height_m: height,
        footprint_w: convex_hull(points).into_iter().map(|p| p.to_array()).collect(),
    }
}

/// Returns the intersection of two level features, faces or single corners; empty for two corners.
fn touching(a: &[DVec2], b: &[DVec2]) -> Vec<DVec2> {
    match (a.len(), b.len()) {
        (_, 3..) => clipped(a, b),
        (3.., _) => clipped(b, a),
        _ => Vec::new(),
    }
}

/// Returns the level faces and corners of an object at a height.
fn level(object: &TruthObject, height: f64, upper: bool) -> Vec<Vec<DVec2>> {
    match object.parts.is_empty() {
        true => level_of_mesh(&object.mesh_w(), height, upper),
        false => level_faces(object, height, upper),
    }
}

/// Returns the faces of a mesh at a height that look up or down, counterclockwise, and single corners there: a rounded rim has
/// no level face.
fn level_of_mesh(mesh_w: &Mesh, height: f64, upper: bool) -> Vec<Vec<DVec2>> {
    let is_level = |v: u32| (mesh_w.vertices[v as usize].z - height).abs() <= SCANNED_TOUCH_M;
    let at = |v: u32| mesh_w.vertices[v as usize].truncate();
    let mut found = Vec::new();
    for &[a, b, c] in &mesh_w.triangles {
        let corners: Vec<DVec2> = [a, b, c].into_iter().filter(|v| is_level(*v)).map(at).collect();
        match corners[..] {
            [p, q, r] => {
                let area = (q - p).perp_dot(r - p);
                if (area > 0.0) == upper && area != 0.0 {
                    found.push(if upper { vec![p, q, r] } else { vec![p, r, q] });
                }
            }
            _ => found.extend(corners.into_iter().map(|p| vec![p])),
        }
    }
    found
}

/// The highest or lowest faces of an object's convex pieces at a height, each counterclockwise.
fn level_faces(object: &TruthObject, height: f64, upper: bool) -> Vec<Vec<DVec2>> {
    let face = |part: &Mesh| {
        let corners = || part.vertices.iter().map(|v| object.x_wb * *v);
        let end = match upper {
            true => corners().map(|p| p.z).fold(f64::MIN, f64::max),
            false => corners().map(|p| p.z).fold(f64::MAX, f64::min),
        };
        if (end - height).abs() > TOUCH_M {
            return None;
        }
        let level = corners().filter(|p| (p.z - end).abs() <= TOUCH_M).map(|p| p.truncate());
        Some(convex_hull(level.collect())).filter(|f| f.len() >= 3)
    };
    object.parts.iter().filter_map(face).collect()
}

/// Corners of the convex hull, counterclockwise.
pub(crate) fn convex_hull(points: Vec<DVec2>) -> Vec<DVec2> {
    convex_outline_of_noisy(points, 1e-9, 1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(half: f64) -> SupportLevel {
        let footprint_w = vec![[-half, -half], [half, -half], [half, half], [-half, half]];
        SupportLevel { above: vec![], below: None, height_m: 0.0, footprint_w }
    }

    #[test]
    fn a_beam_tips_by_the_law_of_the_lever() {
        let support = square(0.1);
        let load = |p: [f64; 2]| support.tipping_load_n(2.0, DVec2::new(0.06, 0.0), p.into());
        // The weight acts 4 cm within the edge at x = 0.1, the load 20 cm beyond it.
        assert!((load([0.3, 0.0]) - 2.0 * 9.81 * 0.04 / 0.2).abs() < 1e-12);
        assert!((load([-0.3, 0.0]) - 2.0 * 9.81 * 0.16 / 0.2).abs() < 1e-12);
        // Beyond a corner the weaker edge counts.
        assert!((load([0.3, 0.5]) - (2.0f64 * 9.81 * 0.04 / 0.2).min(2.0 * 9.81 * 0.1 / 0.4)).abs() < 1e-12);
        assert_eq!(load([0.09, -0.09]), f64::INFINITY);
        assert_eq!(support.tipping_load_n(2.0, DVec2::new(0.11, 0.0), DVec2::ZERO), 0.0);
    }

    #[test]
    fn hulls_and_common_parts_of_squares() {
        let at = |x: f64, y: f64| DVec2::new(x, y);
        let grid = (0..25).map(|i| at(f64::from(i % 5), f64::from(i / 5))).collect();
        assert_eq!(convex_hull(grid), [at(0.0, 0.0), at(4.0, 0.0), at(4.0, 4.0), at(0.0, 4.0)]);
        let unit = [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)];
        let moved = unit.map(|p| p + at(0.75, 0.5));
        let both = convex_hull(clipped(&unit, &moved));
        assert_eq!(both, [at(0.75, 0.5), at(1.0, 0.5), at(1.0, 1.0), at(0.75, 1.0)]);
        assert!(clipped(&unit, &unit.map(|p| p + at(2.0, 0.0))).is_empty());
        // A diamond within the square is all that they share.
        let diamond = [at(0.5, 0.1), at(0.9, 0.5), at(0.5, 0.9), at(0.1, 0.5)];
        assert_eq!(convex_hull(clipped(&diamond, &unit)).len(), 4);
    }
}
