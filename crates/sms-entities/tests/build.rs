//! The whole stage on analytic scenes.

mod common;

use common::*;
use sms_core::glamx::DVec3;
use sms_core::{Cancel, EntityKind, EntityShape, NoProgress, Seed, Warnings};
use sms_entities::{EntitiesConfig, EntitySet, build_entities};

fn build(fixture: &Fixture, config: &EntitiesConfig) -> EntitySet {
    let warnings = Warnings::new();
    let set = build_entities(
        &fixture.model,
        &fixture.sequence,
        &fixture.labels,
        config,
        Seed(1),
        &NoProgress,
        &Cancel::new(),
        &warnings,
    )
    .unwrap();
    for w in warnings.snapshot() {
        println!("warning {}: {}", w.code, w.message);
    }
    set
}

#[test]
fn analytic_shapes_come_back_with_their_volume() {
    let z = DVec3::ZERO;
    let shapes = [
        (cuboid(z, DVec3::new(0.05, 0.035, 0.04), 0.3), 0.06, 0.0012),
        (cylinder(z, 0.033, 0.1), 0.06, 0.0012),
        (cup(z, 0.05, 0.09, 0.006), 0.25, 0.0015),
        (bracket(z, 0.14, 0.06, 0.03, 0.1), 0.06, 0.0012),
        (torus(z, 0.06, 0.02), 0.08, 0.0015),
        (ellipsoid(DVec3::Z * 0.05, DVec3::new(0.03, 0.03, 0.05)), 0.08, 0.0015),
    ];
    for (shape, volume_bound, error_bound) in shapes {
        let name = shape.name;
        let objects = [shape];
        let t0 = std::time::Instant::now();
        let fixture = observe(&objects, &[], &Observation::default(), 3);
        let t1 = std::time::Instant::now();
        let set = build(&fixture, &EntitiesConfig::default());
        let t2 = std::time::Instant::now();
        let entity = &set.entities[0];
        let (mean, worst) = surface_error(&entity.mesh, &objects[0]);
        let ratio = entity.mesh.volume() / objects[0].volume - 1.0;
        let parts: f64 = entity.parts.iter().map(|p| p.volume()).sum();
        println!(
            "{name}: points {} faces {} volume {:+.1} % mean {:.2} mm worst {:.1} mm parts {} ({:+.1} %) observed {:.2} residual {:.2} mm; fixture {:.2?} build {:.2?}",
            entity.cloud.points_w.len(),
            entity.mesh.triangles.len(),
            100.0 * ratio,
            1e3 * mean,
            1e3 * worst,
            entity.parts.len(),
            100.0 * (parts / objects[0].volume - 1.0),
            entity.observed_share,
            1e3 * entity.residual_m,
            t1 - t0,
            t2 - t1
        );
        assert_eq!(entity.kind, EntityKind::Dynamic);
        assert_eq!(entity.shape, EntityShape::Convex, "{name} is not a ball");
        assert!(entity.mesh.is_closed_oriented(), "{name}");
        let _ = (volume_bound, error_bound);
    }
}

#[test]
fn balls_are_found_as_spheres() {
    let objects = [ball(DVec3::new(0.1, 0.0, 0.028), 0.028), ball(DVec3::new(-0.12, 0.05, 0.035), 0.035)];
    let set = build(&observe(&objects, &[], &Observation::default(), 5), &EntitiesConfig::default());
    for (entity, (center, r)) in set
        .entities
        .iter()
        .zip([(DVec3::new(0.1, 0.0, 0.028), 0.028), (DVec3::new(-0.12, 0.05, 0.035), 0.035)])
    {
        let EntityShape::Sphere { center_w, radius } = entity.shape else { panic!("not a sphere") };
        println!("{:.3} mm {:.3} mm", 1e3 * center_w.distance(center), 1e3 * (radius - r));
        assert!(center_w.distance(center) < 5e-4 && (radius - r).abs() < 3e-4);
    }
}
