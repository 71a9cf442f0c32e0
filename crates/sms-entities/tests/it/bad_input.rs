//! Defective scans: each gives a valid body or a warning that names the object, and never panics.

use crate::common::*;
use sms_core::glamx::{DVec3, Quat, Vec3};
use sms_core::{
    Cancel, Entity, EntityShape, LabelInfo, MaskSource, Mesh, Seed, StageContext, Warnings,
    polyhedron_mass_properties,
};
use sms_entities::{EntitiesConfig, EntitiesError, EntitySet, MeshRule, build_entities};
use sms_mesh::{ConvexConfig, convex_parts};

/// Returns whether a mesh is a solid of finite, positive volume with mass properties.
fn is_solid(mesh: &Mesh) -> bool {
    mesh.vertices.iter().all(|v| v.is_finite())
        && mesh.is_closed_oriented()
        && mesh.volume() > 0.0
        && polyhedron_mass_properties(mesh, 700.0).is_ok_and(|m| {
            m.mass() > 0.0 && m.com().is_finite() && m.inertia().to_cols_array().iter().all(|v| v.is_finite())
        })
}

fn check_body(entity: &Entity) {
    let name = &entity.name;
    assert!(is_solid(&entity.mesh), "`{name}` is no solid");
    assert!(entity.parts.iter().all(is_solid), "a part of `{name}` is no solid");
    assert!((0.0..=1.0).contains(&entity.observed_share), "{name}: {}", entity.observed_share);
    assert!(entity.residual_m.is_finite() && entity.residual_m >= 0.0, "{name}: {}", entity.residual_m);
    match &entity.shape {
        EntityShape::Convex => assert!(!entity.parts.is_empty(), "`{name}` has no parts"),
        EntityShape::Sphere { center_w, radius } => assert!(center_w.is_finite() && *radius > 0.0),
        EntityShape::Box { half_extents, .. } => assert!(half_extents.min_element() > 0.0, "{name}"),
        EntityShape::Cylinder { radius, half_length, .. } => {
            assert!(*radius > 0.0 && *half_length > 0.0, "{name}");
        }
        other => panic!("`{name}` is {other:?}"),
    }
}

/// Builds with `config`. Every label must become a valid body or be named in a warning. Returns the messages too.
fn build_with(fixture: &Fixture, config: &EntitiesConfig) -> (EntitySet, Vec<String>) {
    let warnings = Warnings::new();
    let (model, sequence, labels) = (&fixture.model, &fixture.sequence, &fixture.labels);
    let set = build_entities(
        model,
        sequence,
        labels,
        config,
        StageContext::quiet(&Cancel::new(), &warnings).with_seed(Seed(1)),
    )
    .unwrap();
    let messages: Vec<String> =
        warnings.snapshot().iter().map(|w| format!("{}: {}", w.code, w.message)).collect();
    for info in &labels.objects {
        match set.entities.iter().find(|e| e.label == info.id) {
            Some(entity) => {
                check_body(entity);
                println!("{}: {:?}, {:.2} cm³", info.name, entity.shape, 1e6 * entity.mesh.volume());
            }
            None => {
                println!("{}: left out", info.name);
                let quoted = format!("`{}`", info.name);
                assert!(messages.iter().any(|m| m.contains(&quoted)), "{quoted} vanished: {messages:?}");
            }
        }
    }
    messages.iter().for_each(|m| println!("  {m}"));
    (set, messages)
}

fn build(fixture: &Fixture) -> (EntitySet, Vec<String>) {
    build_with(fixture, &EntitiesConfig::default())
}

fn prune() -> EntitiesConfig {
    EntitiesConfig { mesh: MeshRule::Prune, ..Default::default() }
}

/// An observation with the usual resolution of a scan, for small and thin objects.
fn fine() -> Observation {
    Observation { frames: 8, width: 320, height: 240, pitch: 0.002, ..Observation::default() }
}

fn entity(set: &EntitySet, label: u16) -> &Entity {
    set.entities.iter().find(|e| e.label == label).expect("it was left out")
}

/// Returns the ratio of the volume to that of the shape. The volume of the parts, if any, must agree within `swell`.
fn volume_ratio(set: &EntitySet, label: u16, shape: &Shape, swell: f64) -> f64 {
    let entity = entity(set, label);
    let ratio = entity.mesh.volume() / shape.volume;
    let parts: f64 = entity.parts.iter().map(Mesh::volume).sum();
    println!("{}: volume × {ratio:.3}, parts × {:.3}", entity.name, parts / shape.volume);
    assert!(
        entity.parts.is_empty() || (1.0 / swell..swell).contains(&(parts / entity.mesh.volume())),
        "parts × {} of the mesh",
        parts / entity.mesh.volume()
    );
    ratio
}

fn is_within(part: &Mesh, p: DVec3) -> bool {
    (0..part.triangles.len()).all(|t| {
        let [a, b, c] = part.corners(t);
        (b - a).cross(c - a).dot(p - a) <= 0.0
    })
}

/// Gives label `id` the name `name`, `count` Gaussians and as many pixels of the first frame.
fn add_speck(fixture: &mut Fixture, id: u16, name: &str, count: usize) {
    let map = &mut fixture.labels.maps[0];
    for i in 0..count {
        // Side by side, on the floor in the image's corner.
        let (x, y) = (3 + i % 5, map.height - 4 - i / 5);
        map[(x, y)] = id;
        let frame = &fixture.sequence.frames[0];
        let p = frame.camera.unproject_pixel(x, y, f64::from(frame.depth[(x, y)]));
        let model = &mut fixture.model;
        model.positions_w.push(p.as_vec3());
        model.rotations_wg.push(Quat::IDENTITY);
        model.scales.push(Vec3::new(0.002, 0.002, 0.0002));
        model.opacities.push(0.8);
        model.colors.push([0.5; 3]);
        model.affinities.push([0.0; sms_gaussians::AFFINITY_DIM]);
        model.labels.push(id);
        model.label_confidence.push(0.95);
    }
    fixture.labels.objects.push(LabelInfo { id, name: name.into(), description: String::new() });
}

#[test]
fn three_points_and_few_pixels_are_refused_by_name() {
    let how = Observation { frames: 4, width: 120, height: 90, ..Observation::default() };
    let mut fixture = observe(&[cuboid(DVec3::ZERO, DVec3::splat(0.03), 0.3)], &[], &how, 1);
    for (id, count) in [(7, 0), (8, 1), (9, 3), (10, 4), (11, 25)] {
        add_speck(&mut fixture, id, &format!("speck_of_{count}"), count);
    }
    let (set, messages) = build(&fixture);
    assert!(set.entities.iter().any(|e| e.label == 1));
    assert_eq!(set.entities.iter().filter(|e| (7..=11).contains(&e.label)).count(), 0);
    assert_eq!(messages.iter().filter(|m| m.starts_with("object_not_seen")).count(), 5);
}

/// A ball of two pixels and a box of four.
#[test]
fn objects_smaller_than_the_scan_resolves_keep_their_volume_within_a_third() {
    let how = Observation { frames: 6, distance: 1.2, ..Observation::default() };
    let objects = [ball(DVec3::new(0.05, 0.0, 0.004), 0.004), cuboid(DVec3::ZERO, DVec3::splat(0.006), 0.2)];
    let (set, _) = build(&observe(&objects, &[], &how, 1));
    for (label, shape) in (1..).zip(&objects) {
        let ratio = volume_ratio(&set, label, shape, 1.7);
        assert!((0.67..1.5).contains(&ratio), "{}: {ratio}", shape.name);
    }
}

#[test]
fn gaussians_that_are_no_numbers_are_passed_over_and_such_depths_refused() {
    let how = Observation { frames: 8, ..Observation::default() };
    let objects = [cuboid(DVec3::ZERO, DVec3::new(0.04, 0.03, 0.03), 0.3)];
    let mut fixture = observe(&objects, &[], &how, 1);
    let model = &mut fixture.model;
    for i in (0..model.len()).step_by(7) {
        match i % 5 {
            0 => model.positions_w[i] = Vec3::new(f32::NAN, 0.0, 0.0),
            1 => model.scales[i] = Vec3::splat(f32::INFINITY),
            2 => model.rotations_wg[i] = Quat::from_xyzw(f32::NAN, 0.0, 0.0, 1.0),
            3 => model.opacities[i] = f32::NAN,
            _ => model.label_confidence[i] = f32::NAN,
        }
    }
    let (set, _) = build(&fixture);
    let ratio = volume_ratio(&set, 1, &objects[0], 1.1);
    assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
    // Without Gaussians, the surface comes from the depth pixels.
    fixture.model = sms_gaussians::GaussianModel::default();
    let (set, messages) = build(&fixture);
    assert!(messages.iter().any(|m| m.starts_with("few_gaussians")));
    let ratio = volume_ratio(&set, 1, &objects[0], 1.2);
    assert!((ratio - 1.0).abs() < 0.15, "{ratio}");
    for bad in [f32::NAN, f32::INFINITY, -1.0] {
        fixture.sequence.frames[3].depth.data[77] = bad;
        let refused = build_entities(
            &fixture.model,
            &fixture.sequence,
            &fixture.labels,
            &EntitiesConfig::default(),
            StageContext::quiet(&Cancel::new(), &Warnings::new()).with_seed(Seed(1)),
        );
        assert!(matches!(refused, Err(EntitiesError::InvalidDepth { frame: 3, .. })));
    }
}

#[test]
fn a_book_and_a_plate_are_thin_solids() {
    let objects = [
        cuboid(DVec3::new(0.0, -0.11, 0.0), DVec3::new(0.075, 0.1, 0.002), 0.3),
        cylinder(DVec3::new(0.0, 0.11, 0.0), 0.09, 0.003),
    ];
    let fixture = observe(&objects, &[], &Observation { distance: 0.7, ..fine() }, 2);
    let (set, _) = build(&fixture);
    for (label, shape) in (1..).zip(&objects) {
        let ratio = volume_ratio(&set, label, shape, 1.1);
        assert!((ratio - 1.0).abs() < 0.35, "{}: {ratio}", shape.name);
    }
}

#[test]
fn what_the_image_cuts_off_is_a_body_of_what_was_seen() {
    // At 0.55 m the images end 0.3 m to either side.
    let objects = [
        cuboid(DVec3::new(0.0, 0.3, 0.0), DVec3::new(0.05, 0.06, 0.05), 0.0),
        cylinder(DVec3::new(0.0, -0.3, 0.0), 0.05, 0.12),
    ];
    let how = Observation { frames: 6, arc: 0.5, elevation: Some(0.6), ..Observation::default() };
    // An arc of cameras, then all cameras at one place: they see a quarter of the wall of the half cylinder.
    for (seed, arc, least) in [(3, 0.5, 0.3), (4, 0.01, 0.1)] {
        let fixture = observe(&objects, &[], &Observation { arc, ..how }, seed);
        let (set, _) = build(&fixture);
        for (label, shape) in (1..).zip(&objects) {
            let ratio = volume_ratio(&set, label, shape, 1.3);
            assert!((least..1.35).contains(&ratio), "{}: {ratio}", shape.name);
        }
    }
}

#[test]
fn thin_rods_keep_their_volume_within_a_factor_of_two() {
    let lying = Shape {
        name: "lying",
        sdf: Box::new(|p| {
            let q = p - DVec3::new(0.0, 0.06, 0.003);
            let (a, b) = (q.y.hypot(q.z) - 0.003, q.x.abs() - 0.1);
            a.max(0.0).hypot(b.max(0.0)) + a.max(b).min(0.0)
        }),
        volume: std::f64::consts::PI * 0.003 * 0.003 * 0.2,
    };
    let objects = [cylinder(DVec3::new(0.0, -0.06, 0.0), 0.003, 0.2), lying];
    let fixture = observe(&objects, &[], &fine(), 4);
    let (set, _) = build(&fixture);
    for (label, shape) in (1..).zip(&objects) {
        let ratio = volume_ratio(&set, label, shape, 1.5);
        assert!((0.5..2.0).contains(&ratio), "{}: {ratio}", shape.name);
    }
    build_with(&fixture, &prune());
}

#[test]
fn a_box_inside_another_stays_a_body_and_the_hollow_stays_free() {
    let open_box = Shape {
        name: "open_box",
        sdf: Box::new(|p| {
            let cuboid = |q: DVec3, half: DVec3| {
                let q = q.abs() - half;
                q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
            };
            let outer = cuboid(p - DVec3::Z * 0.03, DVec3::new(0.08, 0.06, 0.03));
            let hollow = cuboid(p - DVec3::Z * 0.055, DVec3::new(0.074, 0.054, 0.05));
            outer.max(-hollow)
        }),
        volume: 8.0 * (0.08 * 0.06 * 0.03 - 0.074 * 0.054 * 0.0275),
    };
    let inner = cuboid(DVec3::new(0.01, 0.0, 0.005), DVec3::new(0.02, 0.015, 0.02), 0.4);
    stays_free([open_box, inner], DVec3::new(-0.04, 0.02, 0.03));
}

#[test]
fn a_ball_inside_a_bowl_stays_a_body_and_the_hollow_stays_free() {
    let bowl = [round_bowl(DVec3::ZERO, 0.07, 0.05, 0.006), ball(DVec3::Z * 0.022, 0.02)];
    stays_free(bowl, DVec3::new(0.04, 0.0, 0.04));
}

fn stays_free(objects: [Shape; 2], hollow: DVec3) {
    let mut fixture = observe(&objects, &[], &Observation { frames: 12, ..Default::default() }, 5);
    let (set, _) = build(&fixture);
    for (label, shape) in (1..).zip(&objects) {
        let ratio = volume_ratio(&set, label, shape, 1.7);
        assert!((0.7..1.45).contains(&ratio), "{}: {ratio}", shape.name);
    }
    for p in [hollow, middle(entity(&set, 2))] {
        let filled = entity(&set, 1).parts.iter().any(|part| is_within(part, p));
        assert!(!filled, "the hollow is filled at {p}");
    }
    // With masks from geometry, the two objects may be joined; a warning must then report it.
    fixture.labels.source = MaskSource::Geometry;
    build(&fixture);
}

fn middle(entity: &Entity) -> DVec3 {
    let bounds = entity.mesh.aabb().unwrap();
    0.5 * (bounds.min + bounds.max)
}

fn moved(mesh: &Mesh, by: DVec3) -> Mesh {
    Mesh::new(mesh.vertices.iter().map(|&v| v + by).collect(), mesh.triangles.clone())
}

fn both(a: &Mesh, b: &Mesh) -> Mesh {
    let n = a.vertices.len() as u32;
    Mesh::new(
        a.vertices.iter().chain(&b.vertices).copied().collect(),
        a.triangles.iter().copied().chain(b.triangles.iter().map(|t| t.map(|v| v + n))).collect(),
    )
}

#[test]
fn parts_of_tangled_inverted_and_flat_meshes_are_solids() {
    let ball = Mesh::icosphere(0.03, 2);
    let cube = Mesh::cuboid(DVec3::splat(0.03));
    let inside_out =
        |m: &Mesh| Mesh::new(m.vertices.clone(), m.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect());
    let half_flipped = Mesh::new(
        ball.vertices.clone(),
        ball.triangles
            .iter()
            .enumerate()
            .map(|(i, &[a, b, c])| if i % 2 == 0 { [a, b, c] } else { [a, c, b] })
            .collect(),
    );
    // Two corners are exchanged: faces intersect each other.
    let mut tangled = cube.clone();
    tangled.vertices.swap(0, 6);
    let sheet = Mesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::ONE], vec![[0, 1, 2]]);
    let flat = Mesh::new(
        cube.vertices.iter().map(|&v| v * DVec3::new(1.0, 1.0, 0.0)).collect(),
        cube.triangles.clone(),
    );
    // Volumes of the intended shapes, where known.
    let meshes = [
        ("interpenetrating", both(&cube, &moved(&cube, DVec3::splat(0.02))), Some(216e-6 * 2.0 - 64e-6)),
        (
            "one in another",
            both(&cube, &moved(&Mesh::cuboid(DVec3::splat(0.01)), DVec3::splat(0.001))),
            Some(216e-6),
        ),
        ("inside out", inside_out(&cube), Some(216e-6)),
        ("every second face flipped", half_flipped, Some(ball.volume())),
        ("tangled", tangled, None),
        ("every face twice", both(&cube, &cube), Some(216e-6)),
        ("one triangle", sheet, None),
        ("flat", flat, None),
        ("empty", Mesh::new(Vec::new(), Vec::new()), None),
    ];
    for (name, mesh, expected) in meshes {
        let parts = convex_parts(&mesh, &ConvexConfig::default());
        let volume: f64 = parts.iter().map(Mesh::volume).sum();
        println!("{name}: {} parts, {:.1} cm³", parts.len(), 1e6 * volume);
        assert!(parts.iter().all(is_solid), "{name}");
        if let Some(expected) = expected {
            let ratio = volume / expected;
            assert!((0.8..1.25).contains(&ratio), "{name}: {ratio}");
        }
    }
}
