//! The FR3's fitted capsules, compared with the collision meshes.
//!
//! The meshes are in `robots/fr3_collision` of the test data (`SMS_TEST_DATA`, by default `../shared/data` beside the
//! workspace).

use glamx::DVec3;
use sms_robots::{LinkShape, RobotModel, Workspace};
use std::path::PathBuf;

fn meshes() -> PathBuf {
    let data = std::env::var_os("SMS_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    data.join("robots/fr3_collision")
}

/// Points of a binary STL: corners and middles of edges.
fn surface_points(bytes: &[u8]) -> Vec<DVec3> {
    let float = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
    let mut points = Vec::new();
    for t in 0..(bytes.len() - 84) / 50 {
        let corner = |k: usize| {
            let at = 84 + 50 * t + 12 + 12 * k;
            DVec3::new(float(at), float(at + 4), float(at + 8))
        };
        for k in 0..3 {
            let (a, b) = (corner(k), corner((k + 1) % 3));
            points.extend([a, 0.75 * a + 0.25 * b, 0.5 * (a + b), 0.25 * a + 0.75 * b]);
        }
    }
    points
}

#[test]
#[ignore = "needs the FR3's collision meshes (SMS_TEST_DATA)"]
fn every_link_lies_inside_its_capsules_and_they_are_not_much_fatter() {
    let folder = meshes();
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    model.forward_kinematics(model.home(), &mut ws);
    for k in 0..8 {
        let link = format!("fr3_link{k}");
        let points = surface_points(&std::fs::read(folder.join(format!("link{k}.stl"))).unwrap());
        let frame = model.frame(&link).unwrap();
        let x_lw = model.frame_pose(frame, &ws).inverse();
        let capsules: Vec<_> = model
            .collisions()
            .iter()
            .filter(|c| c.link == link)
            .map(|c| {
                let LinkShape::Capsule { half_length, radius } = c.shape else {
                    panic!("{link} has a {:?}", c.shape)
                };
                (x_lw * model.body_pose(c.joint, &ws) * c.x_js, half_length, radius)
            })
            .collect();
        // Distance beyond the nearest capsule: negative inside.
        let beyond = |p: DVec3| {
            capsules
                .iter()
                .map(|(x_lc, half, radius)| {
                    let q = x_lc.inverse().transform_point(p);
                    (q - DVec3::new(0.0, 0.0, q.z.clamp(-half, *half))).length() - radius
                })
                .fold(f64::INFINITY, f64::min)
        };
        let worst = points.iter().map(|&p| beyond(p)).fold(f64::NEG_INFINITY, f64::max);
        assert!(worst < 1e-4, "{link}: a point lies {worst} m outside");
        // Along the axes the capsules reach little farther than the mesh.
        let mut fattest = 0.0f64;
        for axis in [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z] {
            // Parts below the foot, inside the table, cannot touch anything.
            if k == 0 && axis == -DVec3::Z {
                continue;
            }
            let mesh = points.iter().map(|p| p.dot(axis)).fold(f64::NEG_INFINITY, f64::max);
            let ours = capsules
                .iter()
                .map(|(x, half, radius)| {
                    x.translation.dot(axis)
                        + (x.rotation * DVec3::new(0.0, 0.0, *half)).dot(axis).abs()
                        + radius
                })
                .fold(f64::NEG_INFINITY, f64::max);
            fattest = fattest.max(ours - mesh);
        }
        println!("{link}: {} capsules, {:.1} mm beyond the mesh at most", capsules.len(), 1e3 * fattest);
        assert!(fattest < 0.04, "{link}: {fattest} m too fat");
    }
}

#[test]
fn the_robot_is_clear_of_itself_at_home_and_not_when_folded() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let mut poses = Vec::new();
    let mut clearance = |q: &[f64]| {
        model.forward_kinematics(q, &mut ws);
        model.shape_poses(&ws, &mut poses);
        model.self_clearance(&poses, 0.5).unwrap()
    };
    let home = clearance(model.home());
    assert!(home.distance_m > 0.0, "{home:?}");
    // Elbow and wrist folded so that the hand points into the forearm's base.
    let folded = clearance(&[0.0, -1.2, 0.0, -3.0, 0.0, 0.6, 0.0]);
    assert!(folded.distance_m < 0.0, "{folded:?}");
}
