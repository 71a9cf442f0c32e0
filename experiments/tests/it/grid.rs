//! The paper's grid baseline in cases with a known geometric solution.

use crate::common::{RADIUS, two_balls};
use sms_core::Mesh;
use sms_core::glamx::{DPose3, DVec2, DVec3};
use sms_experiments::GridBaseline;
use sms_scene::{BodyKind, BodyShape, Scene};
use sms_task::{ActionForm, Billiards, ResolvedTask, Selector, Task};

fn task(scene: &Scene, goal_w: DVec2) -> ResolvedTask {
    let (cue, target) = (Selector::sphere_of_color("white"), Selector::by_name("blue"));
    let mut task = Billiards::new(cue, target, goal_w.to_array());
    task.form = ActionForm::SpeedAngleContact;
    Task::Billiards(task).resolve(scene).unwrap()
}

#[test]
fn the_best_angle_of_the_grid_is_the_ghost_balls() {
    let scene = two_balls();
    let target = DVec2::new(0.6, 0.0);
    for cut in [0.0, 20f64.to_radians(), -30f64.to_radians()] {
        let goal_w = target + DVec2::from_angle(cut) * 0.25;
        let found = GridBaseline::default().plan(&task(&scene, goal_w), &scene).unwrap();
        let ghost = target - DVec2::from_angle(cut) * 2.0 * RADIUS;
        let expected = (ghost - DVec2::new(0.3, 0.0)).to_angle();
        let spacing = 20f64.to_radians() / 59.0;
        assert!((found.action.0[1] - expected).abs() <= 0.5 * spacing + 1e-9, "{found:?}, {expected}");
        // An error in the angle is amplified by about 0.3 / 0.06 in the direction of the target ball.
        assert!(found.predicted_m < 0.25 * 0.5 * spacing * 6.5, "{found:?}");
        assert_eq!((found.action.0.len(), &found.action.0[2..]), (4, &[0.0, 0.0][..]));
    }
}

#[test]
fn obstacles_are_mapped_and_flat_things_are_not() {
    let target = DVec2::new(0.6, 0.0);
    let goal_w = target + DVec2::new(0.25, 0.0);
    for (height, blocks) in [(0.1, true), (0.004, false)] {
        let mut scene = two_balls();
        let half = DVec3::new(0.01, 0.3, 0.5 * height);
        let mut wall = scene.bodies[1].clone();
        wall.name = "wall".into();
        wall.kind = BodyKind::Static;
        wall.mass = None;
        wall.x_wb = DPose3::from_translation(DVec3::new(0.72, 0.0, half.z));
        wall.shape = BodyShape::Box { half_extents: half };
        wall.visual = Mesh::cuboid(half);
        scene.bodies.push(wall);
        let found = GridBaseline::default().plan(&task(&scene, goal_w), &scene).unwrap();
        if blocks {
            // The ball is reflected one radius before the wall, and no path along the borders is short enough.
            let nearest = 0.85 - (0.71 - RADIUS);
            assert!((found.predicted_m - nearest).abs() < 0.006, "{found:?}");
        } else {
            assert!(found.predicted_m < 0.01, "{found:?}");
        }
    }
}

#[test]
fn an_empty_grid_is_refused() {
    let scene = two_balls();
    let none = GridBaseline { speeds: 0, ..GridBaseline::default() };
    assert!(none.plan(&task(&scene, DVec2::new(0.8, 0.0)), &scene).is_err());
}
