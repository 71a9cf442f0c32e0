//! Validation of scenes for physics engines.

use crate::{Body, BodyKind, BodyShape, Scene};
use glamx::DVec3;
use sms_core::Mesh;
use std::collections::BTreeSet;

/// Maximum number of vertices of a hull (GPU engines refuse more).
pub(crate) const MAX_HULL_VERTICES: usize = 64;
/// Minimum mean thickness of a hull in metres (twice its volume over its area). Flatter ones have no stable contact
/// normal, and engines refuse them.
pub(crate) const MIN_HULL_THICKNESS: f64 = 2e-5;
/// Largest uncertainty of a scene's sizes: perturbed scenes are up to √3 standard deviations smaller.
pub const MOST_SIZE_SIGMA: f64 = 0.5;

/// One problem of a scene.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// The body, or empty for the scene as a whole.
    pub body: String,
    /// The problem.
    pub what: String,
}

impl std::fmt::Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.body.is_empty() {
            write!(f, "{}", self.what)
        } else {
            write!(f, "`{}`: {}", self.body, self.what)
        }
    }
}

impl Scene {
    /// Returns all problems of the scene; empty if it is valid.
    pub fn validate(&self) -> Vec<Problem> {
        let mut problems = Vec::new();
        let mut names = BTreeSet::new();
        if !self.gravity_w.is_finite() {
            problems.push(Problem { body: String::new(), what: "gravity is not finite".into() });
        }
        if !(0.0..=MOST_SIZE_SIGMA).contains(&self.size_sigma) {
            let what = format!("size_sigma is {}, not a share up to {MOST_SIZE_SIGMA}", self.size_sigma);
            problems.push(Problem { body: String::new(), what });
        }
        for body in &self.bodies {
            let mut add = |what: String| problems.push(Problem { body: body.name.clone(), what });
            if !names.insert(body.name.as_str()) {
                add("another body has the same name".into());
            }
            if body.name.is_empty()
                || !body.name.chars().all(|c| c.is_ascii_alphanumeric() || "_-.".contains(c))
            {
                add("the name cannot be used as a file name".into());
            }
            check_body(body, &mut add);
        }
        problems
    }
}

fn check_body(body: &Body, add: &mut impl FnMut(String)) {
    if body.texture.as_ref().is_some_and(|t| t.corner_uv.len() != body.visual.triangles.len()) {
        add("its texture does not fit its visual mesh".into());
    }
    if !body.x_wb.is_finite() || (body.x_wb.rotation.length() - 1.0).abs() > 1e-6 {
        add("its pose is not a finite rigid transform".into());
    }
    match (body.kind, &body.mass) {
        (BodyKind::Dynamic, None) => add("it is dynamic but has no mass".into()),
        (BodyKind::Dynamic, Some(mass)) if mass.com().length() > 1e-6 => {
            add("its origin is not its centre of mass".into());
        }
        _ => {}
    }
    let m = &body.material;
    for (name, property, low, high) in [
        ("density", &m.density, 1.0, 30_000.0),
        ("fill factor", &m.fill_factor, 1e-3, 1.0),
        ("friction", &m.friction, 0.0, 5.0),
        ("restitution", &m.restitution, 0.0, 1.0),
        ("rolling", &m.rolling_m, 0.0, 0.1),
    ] {
        let v = property.value;
        if !(v.low <= v.best && v.best <= v.high) {
            add(format!("its {name} {} is not between its ends, low {} and high {}", v.best, v.low, v.high));
        } else if !(v.low >= low && v.high <= high) {
            add(format!("its {name} {} [{}, {}] is outside [{low}, {high}]", v.best, v.low, v.high));
        }
    }
    match &body.shape {
        BodyShape::Sphere { radius } if !(*radius > 0.0 && radius.is_finite()) => {
            add(format!("its radius {radius} m is not positive"));
        }
        BodyShape::Box { half_extents }
            if !(half_extents.is_finite() && half_extents.min_element() > 0.0) =>
        {
            add(format!("its half extents {half_extents} m are not positive"));
        }
        BodyShape::Cylinder { radius, half_length }
            if !(*radius > 0.0 && *half_length > 0.0 && radius.is_finite() && half_length.is_finite()) =>
        {
            add(format!("its radius {radius} m or half length {half_length} m is not positive"));
        }
        BodyShape::HalfSpace | BodyShape::TriMesh { .. } if body.kind == BodyKind::Dynamic => {
            add("its shape can only be static".into());
        }
        BodyShape::Hulls { hulls } if hulls.is_empty() => add("it has no hulls".into()),
        BodyShape::Hulls { hulls } => {
            for (i, hull) in hulls.iter().enumerate() {
                if let Some(what) = hull_problem(hull) {
                    add(format!("hull {i} {what}"));
                }
            }
        }
        BodyShape::TriMesh { mesh } if mesh.triangles.is_empty() => add("its mesh is empty".into()),
        _ => {}
    }
}

fn hull_problem(hull: &Mesh) -> Option<String> {
    if hull.vertices.iter().any(|v| !v.is_finite()) {
        return Some("has a vertex that is not finite".into());
    }
    if hull.vertices.len() > MAX_HULL_VERTICES {
        return Some(format!("has {} vertices, more than {MAX_HULL_VERTICES}", hull.vertices.len()));
    }
    if !hull.is_closed_oriented() {
        return Some("is not closed".into());
    }
    let thickness = 2.0 * hull.volume() / hull.area();
    if thickness.is_nan() || thickness < MIN_HULL_THICKNESS {
        return Some(format!("is too thin ({thickness:.1e} m)"));
    }
    (!is_convex(hull)).then(|| "is not convex".into())
}

/// Returns whether all vertices lie at most a small share of the size outside of every face.
fn is_convex(hull: &Mesh) -> bool {
    /// That share.
    const TOLERANCE: f64 = 1e-4;
    /// Files round coordinates to this, metres.
    const ROUNDING_M: f64 = 1e-9;
    let tolerance = TOLERANCE * hull.aabb().map_or(0.0, |b| b.extents().length());
    // Rounding turns the normal of a face by more than the tolerance allows if the face is narrower than this. Such faces are
    // skipped; their neighbours are tested.
    let narrow = tolerance.max(ROUNDING_M / TOLERANCE);
    (0..hull.triangles.len()).all(|t| {
        let [a, b, c] = hull.corners(t);
        let normal = (b - a).cross(c - a);
        let longest = (b - a).length().max((c - a).length()).max((c - b).length());
        normal.length() < longest * narrow
            || hull.vertices.iter().all(|&v| (v - a).dot(normal.normalize_or(DVec3::ZERO)) <= tolerance)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SCENE_VERSION, example_material, floor_body};
    use glamx::DPose3;
    use sms_core::{Interval, MassProperties};

    fn with_body(change: impl FnOnce(&mut Body)) -> Vec<Problem> {
        let mesh = Mesh::cuboid(DVec3::splat(0.05));
        let mass = sms_core::polyhedron_mass_properties(&mesh, 500.0).unwrap();
        let mut body = floor_body(0.0, example_material());
        body.name = "box".into();
        body.kind = BodyKind::Dynamic;
        body.mass = Some(MassProperties::new(mass.mass(), DVec3::ZERO, mass.inertia()).unwrap());
        body.shape = BodyShape::Hulls { hulls: vec![mesh] };
        change(&mut body);
        Scene {
            version: SCENE_VERSION,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z,
            size_sigma: 0.0,
            x_world_recording: DPose3::identity(),
            bodies: vec![body],
        }
        .validate()
    }

    /// An exact hull whose points were rounded to a nanometre: a corner cut off by a micrometre leaves faces whose
    /// normals are off by a thousandth.
    #[test]
    fn narrow_faces_of_rounded_hulls_are_not_dents() {
        let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        for (s, h, d) in [(0.1, 1e-6, 4e-10), (0.005, 1.4e-6, 1e-9)] {
            // A prism over a pentagon, one corner of which is cut off by h; the cut's one end is rounded by d.
            let outline = [(0.0, 0.0), (s, 0.0), (s, s - h), (s - h, s), (0.0, s)];
            let bottom = outline.map(|(x, y)| corner(x, y, 0.0));
            let mut top = outline.map(|(x, y)| corner(x, y, s));
            top[2].y -= d;
            top[3].x += d;
            let vertices = [bottom, top].concat();
            let mut triangles = Vec::new();
            for k in 1..4u32 {
                triangles.push([0, k + 1, k]);
                triangles.push([5, 5 + k, 6 + k]);
            }
            for k in 0..5u32 {
                let n = (k + 1) % 5;
                triangles.extend([[k, n, 5 + n], [k, 5 + n, 5 + k]]);
            }
            let prism = Mesh::new(vertices, triangles);
            assert!(prism.is_closed_oriented() && prism.volume() > 0.0);
            assert!(is_convex(&prism), "{s} m");
            let mut dented = prism;
            dented.vertices[5] *= 0.5;
            assert!(!is_convex(&dented), "{s} m");
        }
    }

    #[test]
    fn each_fault_is_named() {
        assert_eq!(with_body(|_| {}), Vec::new());
        let says = |problems: Vec<Problem>, word: &str| {
            assert!(problems.iter().any(|p| p.to_string().contains(word)), "{word}: {problems:?}");
        };
        says(with_body(|b| b.mass = None), "no mass");
        says(with_body(|b| b.name = "a/b".into()), "file name");
        says(with_body(|b| b.shape = BodyShape::HalfSpace), "only be static");
        says(with_body(|b| b.material.friction.value = Interval::new(9.0, 8.0, 10.0)), "friction");
        let shuffled = Interval { best: 0.4, low: 0.5, high: 0.6 };
        says(with_body(|b| b.material.friction.value = shuffled), "low 0.5 and high 0.6");
        says(with_body(|b| b.x_wb.translation.x = f64::NAN), "finite");
        says(
            with_body(|b| {
                let BodyShape::Hulls { hulls } = &mut b.shape else { return };
                hulls[0].triangles.pop();
            }),
            "not closed",
        );
        says(
            with_body(|b| {
                let BodyShape::Hulls { hulls } = &mut b.shape else { return };
                let dent = &mut hulls[0].vertices[7];
                *dent *= 0.1;
            }),
            "not convex",
        );
        says(
            with_body(|b| {
                let BodyShape::Hulls { hulls } = &mut b.shape else { return };
                hulls[0].vertices.iter_mut().for_each(|v| v.z *= 1e-6);
            }),
            "too thin",
        );
    }
}
