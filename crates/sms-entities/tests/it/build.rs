//! The whole entities stage on analytic scenes.

use crate::common::*;
use proptest::prelude::*;
use sms_core::glamx::DVec3;
use sms_core::{
    Cancel, CoreError, EntityKind, EntityShape, MaskSource, Mesh, NoProgress, Seed, StageContext, Warnings,
};
use sms_entities::{
    EntitiesConfig, EntitiesError, EntitySet, MeshRule, build_entities, load_entities, save_entities,
};
use sms_mesh::{ConvexConfig, convex_parts};

fn run(fixture: &Fixture, config: &EntitiesConfig, warnings: &Warnings) -> Result<EntitySet, EntitiesError> {
    let (progress, cancel) = (NoProgress, Cancel::new());
    build_entities(
        &fixture.model,
        &fixture.sequence,
        &fixture.labels,
        config,
        StageContext::new(&progress, &cancel, warnings).with_seed(Seed(1)),
    )
}

fn build(fixture: &Fixture) -> EntitySet {
    run(fixture, &EntitiesConfig::default(), &Warnings::new()).unwrap()
}

/// Returns whether a point lies in a convex part.
fn is_within(part: &Mesh, p: DVec3) -> bool {
    (0..part.triangles.len()).all(|t| {
        let [a, b, c] = part.corners(t);
        (b - a).cross(c - a).dot(p - a) <= 0.0
    })
}

#[test]
fn boxes_and_cylinders_come_back_with_their_volume() {
    let z = DVec3::ZERO;
    // Limits of the volume error and the mean surface error (mm): about 1.5 times the measured ones.
    come_back([
        (cuboid(z, DVec3::new(0.05, 0.035, 0.04), 0.3), 0.005, 0.1),
        (cylinder(z, 0.033, 0.1), 0.005, 0.1),
        (ellipsoid(DVec3::Z * 0.05, DVec3::new(0.03, 0.03, 0.05)), 0.035, 0.5),
    ]);
}

#[test]
fn hollow_and_bent_shapes_come_back_with_their_volume() {
    let z = DVec3::ZERO;
    come_back([
        (cup(z, 0.05, 0.09, 0.006), 0.04, 0.45),
        (bracket(z, 0.14, 0.06, 0.03, 0.1), 0.02, 0.55),
        (torus(z, 0.06, 0.02), 0.035, 0.5),
    ]);
}

fn come_back(shapes: [(Shape, f64, f64); 3]) {
    for (shape, volume_bound, error_bound) in shapes {
        let name = shape.name;
        let objects = [shape];
        let set = build(&observe(&objects, &[], &Observation::default(), 3));
        assert_eq!(set.entities.len(), 1, "the floor is no environment");
        assert!(set.support_height.unwrap().abs() < 3e-4);
        let entity = &set.entities[0];
        let (mean, worst) = surface_error(&entity.mesh, &objects[0]);
        let ratio = entity.mesh.volume() / objects[0].volume - 1.0;
        let parts: f64 = entity.parts.iter().map(Mesh::volume).sum();
        println!(
            "{name}: {} points, {} faces, volume {:+.1} %, surface {:.2} mm mean {:.1} mm worst, {} parts {:+.1} %, \
             observed {:.2}, residual {:.2} mm",
            entity.cloud.points_w.len(),
            entity.mesh.triangles.len(),
            100.0 * ratio,
            1e3 * mean,
            1e3 * worst,
            entity.parts.len(),
            100.0 * (parts / objects[0].volume - 1.0),
            entity.observed_share,
            1e3 * entity.residual_m,
        );
        assert_eq!(entity.kind, EntityKind::Dynamic);
        let exact = match &entity.shape {
            EntityShape::Box { half_extents, .. } => {
                let mut edges = half_extents.to_array();
                edges.sort_by(f64::total_cmp);
                assert!(
                    (DVec3::from_array(edges) - DVec3::new(0.035, 0.04, 0.05)).abs().max_element() < 3e-4
                );
                "box"
            }
            EntityShape::Cylinder { radius, half_length, .. } => {
                assert!((radius - 0.033).abs() < 2e-4 && (half_length - 0.05).abs() < 2e-4);
                "cylinder"
            }
            EntityShape::Convex => "",
            other => panic!("{name} is {other:?}"),
        };
        assert_eq!(exact == name, ["box", "cylinder"].contains(&name), "{name}: {:?}", entity.shape);
        assert!(entity.mesh.is_closed_oriented(), "{name}");
        assert!(ratio.abs() < volume_bound, "{name}: {ratio}");
        assert!(1e3 * mean < error_bound, "{name}: {mean}");
        assert!((0.6..=1.0).contains(&entity.observed_share), "{name}: {}", entity.observed_share);
        assert!(entity.residual_m < 6e-4, "{name}");
        let lowest = entity.mesh.vertices.iter().map(|v| v.z).fold(f64::MAX, f64::min);
        assert!((lowest - set.support_height.unwrap()).abs() < 1e-9, "{name} rests on the floor");
        assert!(entity.parts.iter().all(|p| p.is_closed_oriented() && p.vertices.len() <= 64));
    }
}

/// No camera sees the floor of a deep mug. The hollow is continued to a floor as thick as the wall instead of being
/// filled.
#[test]
fn a_deep_mug_is_hollow_to_its_floor() {
    let objects = [cup(DVec3::ZERO, 0.035, 0.11, 0.005)];
    let low = Observation { elevation: Some(0.62), frames: 24, ..Observation::default() };
    let set = build(&observe(&objects, &[], &low, 3));
    let entity = &set.entities[0];
    let ratio = entity.mesh.volume() / objects[0].volume;
    println!("volume × {ratio:.3}, observed {:.2}", entity.observed_share);
    assert!((0.85..1.25).contains(&ratio), "{ratio}");
    for z in [0.015, 0.03, 0.06, 0.1] {
        assert!(!entity.parts.iter().any(|p| is_within(p, DVec3::new(0.0, 0.0, z))), "filled at {z}");
    }
    assert!(entity.mesh.is_closed_oriented());
}

#[test]
fn a_cup_keeps_its_hollow() {
    let objects = [cup(DVec3::ZERO, 0.05, 0.09, 0.006)];
    let set = build(&observe(&objects, &[], &Observation::default(), 3));
    let parts = &set.entities[0].parts;
    assert!((4..=16).contains(&parts.len()));
    for z in [0.02, 0.05, 0.08] {
        for (x, y) in [(0.0, 0.0), (0.03, 0.0), (0.0, -0.03), (-0.022, 0.022)] {
            let p = DVec3::new(x, y, z);
            assert!(!parts.iter().any(|part| is_within(part, p)), "a part fills the hollow at {p}");
        }
    }
    let sum: f64 = parts.iter().map(Mesh::volume).sum();
    assert!(
        sum < 1.5 * objects[0].volume,
        "parts swell the cup to {:.2} of its volume",
        sum / objects[0].volume
    );
    // The wall itself is covered.
    let on_wall = (0..64).filter(|&k| {
        let (sin, cos) = (std::f64::consts::TAU / 64.0 * f64::from(k)).sin_cos();
        parts.iter().any(|part| is_within(part, DVec3::new(0.047 * cos, 0.047 * sin, 0.04)))
    });
    assert!(on_wall.count() >= 60);
}

#[test]
fn a_round_bowl_is_no_ball() {
    // The wall and more than half of the cloud lie on a sphere, but cameras see through its upper half.
    let objects = [round_bowl(DVec3::ZERO, 0.07, 0.06, 0.005)];
    let entity = &build(&observe(&objects, &[], &Observation::default(), 5)).entities[0];
    assert!(matches!(entity.shape, EntityShape::Convex), "{:?}", entity.shape);
    let ratio = entity.mesh.volume() / objects[0].volume;
    assert!((0.85..1.3).contains(&ratio), "the hollow is kept: volume × {ratio:.2}");
}

#[test]
fn balls_are_found_as_spheres_whatever_they_are_called() {
    let truth = [(DVec3::new(0.1, 0.0, 0.028), 0.028), (DVec3::new(-0.12, 0.05, 0.035), 0.035)];
    let objects = truth.map(|(center, r)| ball(center, r));
    let set = build(&observe(&objects, &[], &Observation::default(), 5));
    for (entity, (center, r)) in set.entities.iter().zip(truth) {
        let EntityShape::Sphere { center_w, radius } = entity.shape else { panic!("not a sphere") };
        println!("centre {:.3} mm, radius {:+.3} mm", 1e3 * center_w.distance(center), 1e3 * (radius - r));
        assert!(center_w.distance(center) < 3e-4 && (radius - r).abs() < 1.5e-4);
        assert!(entity.mesh.is_closed_oriented());
    }
}

#[test]
fn with_masks_from_geometry_scraps_are_joined_and_balls_stay_free() {
    // The tower of the bracket carries a cap that is a separate object in the masks; a large ball hides the tower's
    // foot.
    let tower = DVec3::new(-0.06, 0.0, 0.0);
    let objects = [
        cuboid(tower, DVec3::new(0.03, 0.03, 0.05), 0.0),
        ball(tower + DVec3::Z * 0.112, 0.018),
        ball(DVec3::new(0.1, 0.0, 0.06), 0.06),
    ];
    let mut fixture = observe(&objects, &[], &Observation { distance: 0.7, ..Default::default() }, 13);
    assert_eq!(build(&fixture).entities.len(), 3, "masks that are told mean what they say");
    fixture.labels.source = sms_core::MaskSource::Geometry;
    let warnings = Warnings::new();
    let set = run(&fixture, &EntitiesConfig::default(), &warnings).unwrap();
    assert_eq!(set.entities.iter().map(|e| e.label).collect::<Vec<_>>(), [1, 3]);
    assert!(set.entities.iter().all(|e| e.kind == EntityKind::Dynamic));
    assert!(warnings.snapshot().iter().any(|w| w.code == "pieces_joined"));
    let top = set.entities[0].mesh.vertices.iter().map(|v| v.z).fold(0.0, f64::max);
    assert!((top - 0.13).abs() < 0.003, "{top}");
    assert!(
        matches!(set.entities[1].shape, EntityShape::Sphere { radius, .. } if (radius - 0.06).abs() < 3e-4)
    );
}

/// The floor of a dish may be thinner than the scatter of the floor below it.
#[test]
fn a_ball_in_a_dish_rests_in_it() {
    let (thick, r) = (0.0025, 0.025);
    let center_w = DVec3::new(0.02, 0.01, thick + r);
    rests_in([cup(DVec3::ZERO, 0.09, 0.03, thick), ball(center_w, r)], center_w.z, r);
}

#[test]
fn a_ball_in_a_bowl_rests_in_it() {
    let r = 0.025;
    let center_w = DVec3::new(0.0, 0.0, 0.002 + r);
    rests_in([round_bowl(DVec3::ZERO, 0.08, 0.05, 0.006), ball(center_w, r)], center_w.z, r);
}

fn rests_in(objects: [Shape; 2], center_z: f64, r: f64) {
    let mut fixture = observe(&objects, &[], &Observation { frames: 16, ..Default::default() }, 7);
    for source in [MaskSource::Files, MaskSource::Geometry] {
        fixture.labels.source = source;
        let warnings = Warnings::new();
        let set = run(&fixture, &EntitiesConfig::default(), &warnings).unwrap();
        let said = warnings.snapshot();
        let name = objects[0].name;
        assert_eq!(set.entities.len(), 2, "{name}, {source:?}: {said:?}");
        assert!(set.entities.iter().all(|e| e.kind == EntityKind::Dynamic), "{name}: {said:?}");
        let EntityShape::Sphere { center_w, radius } = set.entities[1].shape else {
            panic!("{name}: the ball is {:?}", set.entities[1].shape)
        };
        assert!((radius - r).abs() < 3e-4 && (center_w.z - center_z).abs() < 5e-4);
        let ratio = set.entities[0].mesh.volume() / objects[0].volume;
        println!("{name}, {source:?}: volume × {ratio:.3}; {said:?}");
        assert!((0.9..1.1).contains(&ratio), "{name}: {ratio}");
        // The parts of the dish support the ball from right below, and none of them is inside it.
        let parts = &set.entities[0].parts;
        let below = center_w - DVec3::Z * (radius + 0.0015);
        assert!(parts.iter().any(|p| is_within(p, below)), "{name}: nothing bears the ball");
        for direction in Mesh::icosphere(radius - 0.001, 2).vertices {
            let inside = center_w + direction;
            assert!(!parts.iter().any(|p| is_within(p, inside)), "{name}: a part is in the ball at {inside}");
        }
    }
}

#[test]
fn unlabelled_walls_become_a_static_mesh_and_a_raised_box_stands_on_it() {
    // A shelf 6 cm high (unlabelled) carries a box; a wall stands behind.
    let clutter = [
        cuboid(DVec3::ZERO, DVec3::new(0.12, 0.1, 0.03), 0.0),
        cuboid(DVec3::new(0.0, 0.2, 0.0), DVec3::new(0.15, 0.01, 0.08), 0.0),
    ];
    let objects = [cuboid(DVec3::new(0.0, 0.0, 0.06), DVec3::new(0.03, 0.025, 0.035), 0.4)];
    let fixture = observe(&objects, &clutter, &Observation { distance: 0.7, ..Default::default() }, 7);
    let set = build(&fixture);
    assert_eq!(set.entities.len(), 2);
    let (object, environment) = (&set.entities[0], &set.entities[1]);
    assert_eq!((environment.kind, &environment.shape), (EntityKind::Static, &EntityShape::TriMesh));
    assert_eq!(environment.name, "environment");
    let lowest = object.mesh.vertices.iter().map(|v| v.z).fold(f64::MAX, f64::min);
    println!("foot at {:.2} mm, environment {} faces", 1e3 * lowest, environment.mesh.triangles.len());
    assert!((lowest - 0.06).abs() < 1.5e-3, "{lowest}");
    assert!((object.mesh.volume() / objects[0].volume - 1.0).abs() < 0.05);
    // The environment lies on the clutter, faces outwards, and has no hole under the box.
    let both = Shape {
        name: "clutter",
        volume: 0.0,
        sdf: Box::new(|p| {
            let shelf = (cuboid(DVec3::ZERO, DVec3::new(0.12, 0.1, 0.03), 0.0).sdf)(p);
            shelf.min((cuboid(DVec3::new(0.0, 0.2, 0.0), DVec3::new(0.15, 0.01, 0.08), 0.0).sdf)(p))
        }),
    };
    let (mean, worst) = surface_error(&environment.mesh, &both);
    println!("environment surface error {:.2} mm mean, {:.1} mm worst", 1e3 * mean, 1e3 * worst);
    assert!(mean < 0.0015 && worst < 0.012);
    let mut outwards = 0.0;
    for t in 0..environment.mesh.triangles.len() {
        let [a, b, c] = environment.mesh.corners(t);
        let (normal, center) = ((b - a).cross(c - a), (a + b + c) / 3.0);
        let step = normal.normalize_or_zero() * 0.004;
        outwards += normal.length() * ((both.sdf)(center + step) - (both.sdf)(center - step)).signum();
    }
    assert!(outwards > 0.9 * 2.0 * environment.mesh.area());
    for (x, y) in [(0.0, 0.0), (0.02, 0.01), (-0.02, -0.015), (0.05, 0.05), (-0.08, 0.0)] {
        let covered = (0..environment.mesh.triangles.len()).any(|t| {
            let corners = environment.mesh.corners(t);
            let side = |p: DVec3, q: DVec3| (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x);
            let [a, b, c] = corners;
            let over = side(a, b) >= 0.0 && side(b, c) >= 0.0 && side(c, a) >= 0.0;
            over && corners.iter().all(|p| (p.z - 0.06).abs() < 0.004)
        });
        assert!(covered, "a hole in the shelf at {x}, {y}");
    }
}

#[test]
fn objects_side_by_side_do_not_overlap() {
    let objects = [
        cuboid(DVec3::ZERO, DVec3::new(0.03, 0.03, 0.04), 0.0),
        cylinder(DVec3::new(0.0585, 0.0, 0.0), 0.028, 0.07),
    ];
    let set = build(&observe(&objects, &[], &Observation::default(), 9));
    assert_eq!(set.entities.len(), 2);
    for p in &set.entities[0].parts {
        for q in &set.entities[1].parts {
            for (a, b) in [(p, q), (q, p)] {
                for &v in &a.vertices {
                    let depth = (0..b.triangles.len())
                        .map(|t| {
                            let [x, y, z] = b.corners(t);
                            (y - x).cross(z - x).normalize_or_zero().dot(v - x)
                        })
                        .fold(f64::MIN, f64::max);
                    assert!(depth > -1e-4, "a corner is {depth} m inside the other object");
                }
            }
        }
    }
}

#[test]
fn results_do_not_depend_on_threads_and_survive_the_disk() {
    let objects = [
        ball(DVec3::new(0.08, 0.0, 0.03), 0.03),
        bracket(DVec3::new(-0.08, 0.0, 0.0), 0.1, 0.05, 0.025, 0.08),
    ];
    let clutter = [cuboid(DVec3::new(0.0, 0.18, 0.0), DVec3::new(0.1, 0.02, 0.05), 0.0)];
    let fixture = observe(&objects, &clutter, &Observation::default(), 11);
    let two = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap().install(|| build(&fixture));
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(|| build(&fixture));
    assert!(one == two, "same seed, same result");
    let dir = tempfile::tempdir().unwrap();
    save_entities(dir.path(), &one).unwrap();
    let back = load_entities(dir.path()).unwrap();
    assert_eq!(back.support_height, one.support_height);
    assert_eq!(back.entities.len(), 3);
    for (a, b) in back.entities.iter().zip(&one.entities) {
        assert_eq!((&a.name, a.label, &a.shape, a.parts.len()), (&b.name, b.label, &b.shape, b.parts.len()));
        assert_eq!(a.mesh.triangles, b.mesh.triangles);
        assert!(a.mesh.vertices.iter().zip(&b.mesh.vertices).all(|(p, q)| p.distance(*q) < 2e-9));
        assert!(a.kind == EntityKind::Static || a.mesh.is_closed_oriented());
    }
    std::fs::remove_file(dir.path().join("ball_1/mesh.obj")).unwrap();
    let EntitiesError::Core(error) = load_entities(dir.path()).unwrap_err() else {
        panic!("a file is missing")
    };
    assert!(matches!(error, CoreError::Read { path, .. } if path.ends_with("ball_1/mesh.obj")));
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    for (key, config) in [
        ("density_per_m2", EntitiesConfig { density_per_m2: 0.0, ..Default::default() }),
        ("disc_sigmas", EntitiesConfig { disc_sigmas: f64::NAN, ..Default::default() }),
        ("prune_length", EntitiesConfig { prune_length: Some(-1.0), ..Default::default() }),
        ("min_opacity", EntitiesConfig { min_opacity: 1.5, ..Default::default() }),
    ] {
        let message = config.validate().unwrap_err().to_string();
        assert!(message.contains(key), "{message}");
    }
    EntitiesConfig::default().validate().unwrap();
}

#[test]
fn what_cannot_be_built_is_said() {
    let objects = [cuboid(DVec3::ZERO, DVec3::splat(0.03), 0.0)];
    let small = Observation { frames: 4, width: 80, height: 60, ..Default::default() };
    let mut fixture = observe(&objects, &[], &small, 1);
    fixture.labels.objects.push(sms_core::LabelInfo {
        id: 9,
        name: "ghost".into(),
        description: String::new(),
    });
    let warnings = Warnings::new();
    let set = run(&fixture, &EntitiesConfig::default(), &warnings).unwrap();
    assert_eq!(set.entities.len(), 1);
    assert_eq!(warnings.snapshot().iter().map(|w| &*w.code).collect::<Vec<_>>(), ["object_not_seen"]);
    fixture.labels.maps.pop();
    let refused = run(&fixture, &EntitiesConfig::default(), &warnings);
    assert!(matches!(refused, Err(EntitiesError::LabelMapCount { maps: 3, frames: 4 })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3))]
    // The mesh must be a solid even with few frames, a narrow arc (no back, no underside) and strong noise.
    #[test]
    fn meshes_are_closed_whatever_was_seen(kind in 0usize..5, seed in 0u64..1000, arc in 0.5f64..6.3, prune in any::<bool>()) {
        let z = DVec3::ZERO;
        let objects = [match kind {
            0 => cuboid(z, DVec3::new(0.04, 0.03, 0.05), 0.5),
            1 => cup(z, 0.045, 0.08, 0.006),
            2 => torus(z, 0.05, 0.018),
            3 => bracket(z, 0.12, 0.05, 0.025, 0.09),
            _ => cylinder(z, 0.03, 0.12),
        }];
        let how = Observation {
            frames: 6, width: 120, height: 90, arc, noise: 0.004, position_noise: 0.002, normal_noise: 0.35,
            pitch: 0.006, ..Default::default()
        };
        let mesh = if prune { MeshRule::Prune } else { MeshRule::Vote };
        let config = EntitiesConfig { mesh, ..Default::default() };
        let set = run(&observe(&objects, &[], &how, seed), &config, &Warnings::new()).unwrap();
        let entity = &set.entities[0];
        prop_assert!(entity.mesh.is_closed_oriented());
        prop_assert!(entity.mesh.volume() > 0.0 && !entity.parts.is_empty());
        prop_assert!(sms_core::polyhedron_mass_properties(&entity.mesh, 700.0).is_ok());
        let lowest = entity.mesh.vertices.iter().map(|v| v.z).fold(f64::MAX, f64::min);
        prop_assert!(lowest > set.support_height.unwrap_or(0.0) - 1e-9);
    }
}

#[test]
fn convex_parts_of_a_bracket_are_its_two_arms() {
    // An L as a closed mesh: the union of two boxes, extruded along y.
    let outline = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.02], [0.02, 0.02], [0.02, 0.08], [0.0, 0.08]];
    let n = outline.len() as u32;
    let mut vertices: Vec<DVec3> = outline.iter().map(|p| DVec3::new(p[0], 0.0, p[1])).collect();
    vertices.extend(outline.iter().map(|p| DVec3::new(p[0], 0.05, p[1])));
    let caps = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]];
    let mut triangles: Vec<[u32; 3]> = caps.to_vec();
    triangles.extend(caps.map(|[a, b, c]| [a + n, c + n, b + n]));
    for i in 0..n {
        let j = (i + 1) % n;
        triangles.extend([[i, i + n, j], [j, i + n, j + n]]);
    }
    let mesh = Mesh::new(vertices, triangles);
    assert!(mesh.is_closed_oriented());
    let exact = 0.05 * (0.1 * 0.02 + 0.02 * 0.06);
    assert!((mesh.volume() - exact).abs() < 1e-12);
    let parts = convex_parts(&mesh, &ConvexConfig::default());
    assert_eq!(parts.len(), 2);
    let sum: f64 = parts.iter().map(Mesh::volume).sum();
    assert!((sum / exact - 1.0).abs() < 0.02, "{sum} {exact}");
}
