//! Landing structures stand, and topple under the loads of statics.

use glamx::{DPose3, DVec2, DVec3};
use sms_core::{Hasher, Seed};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, floor_body};
use sms_sim::{RapierF64Factory, RapierFactory, Simulation, WorldOptions, resting_drift};
use sms_synth::{HelicalPath, LandingStructure, LandingTruth, TruthScene, generate_landing};

/// Weight of the paper's quadrotor, newtons.
const QUADROTOR_N: f64 = 1.182 * 9.81;

fn fixed() -> [TruthScene; 4] {
    LandingStructure::ALL.map(LandingStructure::fixed)
}

fn drawn() -> impl Iterator<Item = TruthScene> {
    (1001..1006).flat_map(|seed| LandingStructure::ALL.map(|s| generate_landing(s, Seed(seed))))
}

fn landing(scene: &TruthScene) -> &LandingTruth {
    scene.landing.as_ref().unwrap()
}

/// The truth as a world of the simulator: convex pieces, true masses and materials.
fn world(truth: &TruthScene) -> Scene {
    let mut bodies = vec![floor_body(0.0, truth.floor.material.clone())];
    bodies.extend(truth.objects.iter().enumerate().map(|(i, o)| Body {
        name: o.name.clone(),
        label: i as u16 + 1,
        description: o.class.clone(),
        kind: BodyKind::Dynamic,
        x_wb: o.x_wb,
        shape: BodyShape::Hulls { hulls: o.parts.clone() },
        visual: o.mesh.clone(),
        texture: None,
        mass: Some(o.mass),
        material: o.material.clone(),
        color: [128; 3],
        observed_share: 1.0,
        fit_se_m: 0.0,
    }));
    let gravity_w = DVec3::new(0.0, 0.0, -9.81);
    Scene {
        version: SCENE_VERSION,
        name: truth.name.clone(),
        gravity_w,
        size_sigma: 0.0,
        x_world_recording: DPose3::IDENTITY,
        bodies,
    }
}

/// Everything that a figure of the benchmark depends on, to a tenth of a millimetre or gram: platforms differ in the last bits
/// of sines.
fn digest(scenes: &[TruthScene]) -> String {
    let mut text = String::new();
    for scene in scenes {
        text += &format!("{}\n", scene.name);
        for o in &scene.objects {
            let (p, m) = (o.x_wb.translation, &o.material);
            text += &format!("{} {:.4} {:.4} {:.4} {:.4} ", o.name, p.x, p.y, p.z, o.mass.mass());
            text += &format!(
                "{:.4} {:.4} {}\n",
                m.friction.value.best,
                m.restitution.value.best,
                o.mesh.vertices.len()
            );
        }
        for s in &landing(scene).starts_w {
            text += &format!("{:.4} {:.4} {:.4}\n", s.x, s.y, s.z);
        }
    }
    let mut hasher = Hasher::new();
    hasher.bytes(text.as_bytes());
    hasher.finish().0
}

#[test]
fn the_four_structures_are_frozen() {
    assert_eq!(digest(&fixed()), "f9b1feaaa87d5a485b16731ef4471994");
}

#[test]
fn structures_stand_on_each_other_and_a_quarter_of_a_quadrotor_topples_them() {
    for scene in fixed().into_iter().chain(drawn()) {
        let truth = landing(&scene);
        assert!(truth.top_m >= 0.5, "{}: {}", scene.name, truth.top_m);
        assert_eq!(truth.supports.len(), scene.objects.len());
        for (object, support) in scene.objects.iter().zip(&truth.supports) {
            assert!(object.mesh.is_closed_oriented());
            assert!((object.aabb_w().min.z - support.height_m).abs() < 1e-9);
            assert!(support.footprint_w.len() >= 3, "{} of {} hangs in the air", object.name, scene.name);
            // It stands by itself, with a margin.
            let own: DVec2 = object.x_wb.translation.truncate();
            assert!(scene.support_load_n(support, own) > 0.0);
        }
        let load = scene.tipping_load_n(truth.end_w.into()).unwrap();
        let fixed = LandingStructure::ALL.into_iter().find(|s| s.fixed().name == scene.name);
        let designed = fixed.map_or(1.99..3.51, |s| s.fixed_end_load_n() - 0.01..s.fixed_end_load_n() + 0.01);
        assert!(designed.contains(&load), "{}: {load} N", scene.name);
        let json = serde_json::to_string(&scene).unwrap();
        assert_eq!(serde_json::from_str::<TruthScene>(&json).unwrap(), scene);
    }
}

/// Whether a quadrotor with feet 10 cm from its axes can land with its axis there: feet on the platform and clear of ballast,
/// and twice its weight does not topple the structure.
fn is_safe(scene: &TruthScene, p_w: DVec2) -> bool {
    let truth = landing(scene);
    let corners: Vec<DVec2> = truth.outline_w.iter().map(|&q| q.into()).collect();
    let depth = (0..corners.len())
        .map(|i| (corners[(i + 1) % corners.len()] - corners[i]).perp().normalize().dot(p_w - corners[i]))
        .fold(f64::MAX, f64::min);
    let clear = scene.objects[2..]
        .iter()
        .all(|o| o.mesh_w().vertices.iter().all(|v| v.truncate().distance(p_w) > 0.12));
    depth > 0.11 && clear && scene.tipping_load_n(p_w).unwrap() > 2.0 * QUADROTOR_N
}

#[test]
fn there_is_a_place_to_land_but_most_of_the_platform_is_none() {
    for scene in fixed().into_iter().chain(drawn()) {
        let truth = landing(&scene);
        let (end, along) = (DVec2::from(truth.end_w), DVec2::from(truth.overhang_w));
        let platform = scene.object(&truth.platform).unwrap();
        let length = 2.0 * (end - platform.aabb_w().center().truncate()).length();
        let safe =
            (0..=100).filter(|i| is_safe(&scene, end - along * length * f64::from(*i) / 100.0)).count();
        // Along the middle line: at least a hand's breadth is safe, and less than half of it.
        let safe_m = safe as f64 / 100.0 * length;
        assert!(safe_m > 0.06 && safe < 50, "{}: {safe_m} m of {length} m", scene.name);
    }
}

#[test]
fn structures_rest_in_the_simulator() {
    for scene in fixed() {
        for drift in resting_drift(&RapierFactory, &world(&scene), 2.0).unwrap() {
            assert!(drift.moved_m < 0.001, "{}: {drift:?}", scene.name);
            assert!(drift.turned_rad < 0.005, "{}: {drift:?}", scene.name);
        }
    }
}

/// Statics against the simulator: 5 % less than the load at the overhang's end does not topple a structure, 5 % more does. The
/// engine's contacts give way like springs: on the bin's narrow rim the end of the board sinks by 2.5 mm before it tips, by less
/// than 0.2 mm on the other bases.
#[test]
fn structures_topple_under_the_load_of_statics() {
    for scene in fixed() {
        let truth = landing(&scene);
        let end = DVec2::from(truth.end_w).extend(truth.top_m);
        let load = scene.tipping_load_n(end.truncate()).unwrap();
        let sinks = |force: f64| {
            let options = WorldOptions { sleep: false, ..WorldOptions::default() };
            let mut simulation = Simulation::new(&RapierF64Factory, &world(&scene), &options).unwrap();
            // Bodies follow the floor, in the scene's order: the platform is the third.
            let start = simulation.state(2).x_wb;
            let end_b = start.inverse() * end;
            for step in 0..600 {
                let now = simulation.state(2).x_wb;
                // Slowly, since a sudden load pushes twice as hard.
                let f = DVec3::Z * (-force * f64::from(step) / 300.0).max(-force);
                let arm = now * end_b - now.translation;
                simulation.apply_wrench(2, f, arm.cross(f));
                simulation.advance(options.dt).unwrap();
            }
            end.z - (simulation.state(2).x_wb * end_b).z
        };
        let (below, above) = (sinks(0.95 * load), sinks(1.05 * load));
        assert!(below < 0.004, "{}: {below} m at 95 %", scene.name);
        assert!(above > 0.02, "{}: {above} m at 105 %", scene.name);
    }
}

#[test]
fn the_camera_goes_around_three_times_and_starts_lie_on_a_circle() {
    for scene in fixed() {
        let poses = HelicalPath::default().poses(&scene, 60);
        assert_eq!(poses.len(), 60);
        let center = scene.workspace_center_w;
        let mut turned = 0.0;
        for w in poses.windows(2) {
            let flat = |p: &DPose3| (p.translation - center).truncate();
            assert!((flat(&w[0]).length() - 1.2).abs() < 1e-9);
            assert!(w[1].translation.z > w[0].translation.z);
            turned += flat(&w[0]).angle_to(flat(&w[1]));
        }
        assert!((turned - 3.0 * std::f64::consts::TAU).abs() < 1e-9, "{turned}");
        assert!(
            (poses[0].translation.z - 0.35).abs() < 1e-9 && (poses[59].translation.z - 1.35).abs() < 1e-9
        );
        // The optical axis points at the structure.
        for p in &poses {
            assert!((p.rotation * DVec3::Z).dot((center - p.translation).normalize()) > 1.0 - 1e-9);
        }
        let truth = landing(&scene);
        assert_eq!(truth.starts_w.len(), 10);
        for (a, b) in truth.starts_w.iter().zip(truth.starts_w.iter().cycle().skip(1)) {
            assert!(((*a - center).truncate().length() - 2.0).abs() < 1e-9);
            assert!((a.z - truth.top_m - 0.35).abs() < 1e-9);
            assert!((a.distance(*b) - 4.0 * (std::f64::consts::PI / 10.0).sin()).abs() < 1e-9);
        }
    }
}
