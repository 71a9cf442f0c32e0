//! Placement errors of entities, in metres and in units of the standard errors estimated from their residuals. They
//! determine the widths of the planner's perturbations (experiments/studies/plan.md).

use crate::truth::TrueSurface;
use glamx::DPose3;
use sms_core::{Entity, EntityShape, polyhedron_mass_properties};
use sms_scene::{Body, build_scene, example_material};

/// Returns key and value of each placement metric of an entity: the horizontal distance of its centre of volume from
/// the true one and, for a ball, the excess of its radius. Each is given in metres and in standard errors (`fit_se_m`
/// of the body). For a radius, the standard error is smaller by √3: every point of the surface constrains the radius,
/// but only a third constrain a coordinate of the centre. `x_tw` maps the entity's world to the truth's.
pub fn placed_figures(entity: &Entity, x_tw: &DPose3, truth: &TrueSurface) -> Vec<(&'static str, f64)> {
    let Some(body) = body_of(entity) else { return Vec::new() };
    let se_m = body.fit_se_m;
    let true_center = match truth.sphere {
        Some((center, _)) => Some(center),
        None => polyhedron_mass_properties(&truth.mesh, 1.0).ok().map(|m| m.com()),
    };
    let Some(true_center) = true_center.filter(|_| se_m > 0.0) else { return Vec::new() };
    let off_m = (x_tw.transform_point(body.x_wb.translation) - true_center).truncate().length();
    let mut figures = vec![("place_m", off_m), ("place_ratio", off_m / se_m)];
    if let (EntityShape::Sphere { radius, .. }, Some((_, true_radius))) = (&entity.shape, truth.sphere) {
        let swell_m = radius - true_radius;
        figures.extend([("radius_m", swell_m), ("radius_ratio", swell_m.abs() * 3f64.sqrt() / se_m)]);
    }
    figures
}

/// Builds the body of a single entity. Its origin is its centre of mass.
fn body_of(entity: &Entity) -> Option<Body> {
    let alone = std::slice::from_ref(entity);
    let scene = build_scene("", alone, &[example_material()], None, DPose3::IDENTITY).ok()?;
    scene.bodies.into_iter().next()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec3;
    use sms_core::{EntityKind, Mesh, PointCloud};

    fn entity(shape: EntityShape, mesh: Mesh) -> Entity {
        Entity {
            label: 1,
            name: "e".into(),
            description: String::new(),
            kind: EntityKind::Dynamic,
            parts: vec![mesh.clone()],
            mesh,
            shape,
            cloud: PointCloud::default(),
            texture: None,
            residual_m: 1e-4,
            observed_share: 1.0,
            mean_color: [128; 3],
        }
    }

    #[test]
    fn errors_are_horizontal_and_measured_by_the_residuals() {
        let x_tw = DPose3::from_translation(DVec3::new(0.5, 0.0, 0.1));
        let (center, radius) = (DVec3::new(0.2, 0.1, 0.03), 0.03);
        let ball = Mesh::icosphere(radius, 3);
        let truth = TrueSurface::new("ball", ball.clone(), Some((center, radius))).unwrap();
        let found = center + DVec3::new(3e-4, -4e-4, 0.02) - x_tw.translation;
        let e = entity(EntityShape::Sphere { center_w: found, radius: 0.0297 }, ball);
        let figures = placed_figures(&e, &x_tw, &truth);
        let get = |key: &str| figures.iter().find(|f| f.0 == key).unwrap().1;
        let se_m = body_of(&e).unwrap().fit_se_m;
        assert!((get("place_m") - 5e-4).abs() < 1e-12 && (get("radius_m") + 3e-4).abs() < 1e-12);
        assert!((get("place_ratio") - 5e-4 / se_m).abs() < 1e-6);
        assert!((get("radius_ratio") - 3e-4 * 3f64.sqrt() / se_m).abs() < 1e-6);

        let cube = Mesh::cuboid(DVec3::splat(0.03));
        let at = |x: f64| cube.transformed(&DPose3::from_translation(DVec3::X * x));
        let truth = TrueSurface::new("cube", at(0.502), None).unwrap();
        let figures = placed_figures(&entity(EntityShape::Convex, at(0.0)), &x_tw, &truth);
        assert_eq!(figures.len(), 2);
        assert!((figures[0].1 - 0.002).abs() < 1e-9);
    }
}
