//! How far entities are from where they should be, beside what their own residuals show: what the widths of the planner's
//! disturbances are set by (docs/plan-study.md).

use crate::truth::TrueSurface;
use glamx::DPose3;
use sms_core::metrics::Metrics;
use sms_core::{Entity, EntityShape, polyhedron_mass_properties};
use sms_scene::{Body, build_scene, example_material};
use std::fmt::Write;

/// The figures of an entity: horizontal distance of its centre of volume from the truth's and, of a
/// ball, what its radius is too large by, each in metres and over its standard error by the residuals (`fit_se_m` of the body;
/// of a radius √3 less, because all points of the surface tell it and a third of them a coordinate of the centre). `x_tw`
/// carries the entity's world into the truth's.
pub(super) fn placed_figures(
    entity: &Entity,
    x_tw: &DPose3,
    truth: &TrueSurface,
) -> Vec<(&'static str, f64)> {
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

/// The body that is made of an entity alone. Its origin is its centre of mass.
fn body_of(entity: &Entity) -> Option<Body> {
    let alone = std::slice::from_ref(entity);
    let scene = build_scene("", alone, &[example_material()], None, DPose3::IDENTITY).ok()?;
    scene.bodies.into_iter().next()
}

/// The largest ratios of all objects, in a line each; empty where there are none.
pub(super) fn largest_ratios(metrics: &Metrics, prefix: &str) -> String {
    // Keys are `{scene}.{object}.{figure}`, of models `{model}.{figure}`; means are `{scene}.{figure}` and `mean.{figure}`.
    let of_object = |key: &str, figure: &str| {
        let object = key.strip_prefix(prefix)?.strip_suffix(figure)?;
        let is_mean = !object.contains('.') && (object.starts_with("scene_") || object == "mean");
        (!is_mean).then(|| key.strip_suffix(figure)).flatten().map(str::to_owned)
    };
    let mut largest = [("places of balls", 0.0f64, 0usize), ("radii", 0.0, 0), ("places of others", 0.0, 0)];
    for (key, value) in metrics.iter() {
        let Some(ratio) = value.as_f64() else { continue };
        let row = if of_object(key, ".radius_ratio").is_some() {
            1
        } else if let Some(object) = of_object(key, ".place_ratio") {
            if metrics.number(&format!("{object}.radius_ratio")).is_some() { 0 } else { 2 }
        } else {
            continue;
        };
        largest[row] = (largest[row].0, largest[row].1.max(ratio), largest[row].2 + 1);
    }
    let mut text = String::new();
    for (name, ratio, count) in largest.into_iter().filter(|l| l.2 > 0) {
        let _ = writeln!(
            text,
            "largest error over its standard error by the residuals: {name} ({count}) {ratio:.1}"
        );
    }
    text
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

    #[test]
    fn the_largest_are_of_objects_and_not_of_means() {
        let mut m = Metrics::new();
        for (key, value) in [
            ("scene_1.cue.place_ratio", 1.5),
            ("scene_1.cue.radius_ratio", 4.0),
            ("scene_1.mug.place_ratio", 11.0),
            ("mug_model.place_ratio", 12.0),
            ("scene_1.place_ratio", 90.0),
            ("scene_1.radius_ratio", 90.0),
            ("mean.place_ratio", 90.0),
        ] {
            m.set(format!("p.{key}"), value);
        }
        let text = largest_ratios(&m, "p.");
        assert_eq!(text.lines().count(), 3);
        assert!(
            text.contains("balls (1) 1.5")
                && text.contains("radii (1) 4.0")
                && text.contains("others (2) 12.0")
        );
        assert_eq!(largest_ratios(&Metrics::new(), "p."), "");
    }
}
