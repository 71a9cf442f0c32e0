//! Tasks with terms, on a table with an edge.

use crate::common::{RADIUS, ball, material, two_balls};
use sms_core::glamx::{DPose3, DVec3};
use sms_core::{Mesh, box_mass_properties, cylinder_mass_properties};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, floor_body};
use sms_sim::RapierFactory;
use sms_task::{Action, MotionRecording, ResolvedTask, Rollout, Task, TaskError};

const TOP: f64 = 0.3;

fn body(name: &str, p_w: DVec3, shape: BodyShape, friction: f64) -> Body {
    let mass = match &shape {
        BodyShape::Box { half_extents } => box_mass_properties(*half_extents, 600.0),
        BodyShape::Cylinder { radius, half_length } => cylinder_mass_properties(*radius, *half_length, 900.0),
        _ => unreachable!("the table's bodies are boxes and cylinders"),
    };
    Body {
        name: name.into(),
        x_wb: DPose3::from_translation(p_w),
        kind: BodyKind::Dynamic,
        shape,
        mass: Some(mass.unwrap()),
        visual: Mesh::default(),
        ..floor_body(0.0, material(friction, 0.2))
    }
}

/// A table 0.6 × 0.4 m, 0.3 m high; a box of 6 cm near its +x edge and a mug beside the box.
fn table() -> Scene {
    let slab = body(
        "table",
        DVec3::Z * 0.5 * TOP,
        BodyShape::Box { half_extents: DVec3::new(0.3, 0.2, 0.5 * TOP) },
        0.4,
    );
    let table = Body { kind: BodyKind::Static, mass: None, ..slab };
    let carton = BodyShape::Box { half_extents: DVec3::splat(0.03) };
    let mug = BodyShape::Cylinder { radius: 0.035, half_length: 0.05 };
    Scene {
        version: SCENE_VERSION,
        name: "table".into(),
        gravity_w: DVec3::new(0.0, 0.0, -9.81),
        size_sigma: 0.0,
        x_world_recording: DPose3::identity(),
        bodies: vec![
            floor_body(0.0, material(0.4, 0.3)),
            table,
            body("box", DVec3::new(0.18, 0.0, TOP + 0.03), carton, 0.4),
            body("mug", DVec3::new(0.22, 0.09, TOP + 0.05), mug, 0.4),
        ],
    }
}

fn read(text: &str) -> Task {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("task.toml");
    std::fs::write(&path, text).unwrap();
    Task::read(&path).unwrap()
}

fn roll(task: &ResolvedTask, scene: &Scene, action: &[f64], recording: Option<MotionRecording>) -> Rollout {
    let bodies = task.bodies_in(scene, &task.target().name).unwrap();
    let mut simulation = task.prepare(&RapierFactory, scene, &task.world_options(), &bodies).unwrap();
    task.rollout(&mut simulation, task.strike(&Action(action.to_vec())), &bodies, recording).unwrap()
}

const PUSH_OFF: &str = r#"
    kind = "strike"
    strike = { name = "box" }
    form = "speed_angle"
    success_m = 0.01

    [[terms]]
    term = "reach"
    body = { name = "box" }
    place = { min_w = [0.3, -0.4, 0.0], max_w = [1.5, 0.4, 0.1] }
    when = "end"

    [[terms]]
    term = "keep-still"
    body = { name = "mug" }
    weight = 2.0
"#;

#[test]
fn the_box_is_pushed_off_the_table_and_the_mug_stays() {
    let scene = table();
    let task = read(PUSH_OFF).resolve(&scene).unwrap();
    assert!(task.initial_objective() > 0.2, "{}", task.initial_objective());
    let objective = |speed: f64, angle: f64| roll(&task, &scene, &[speed, angle], None).objective;
    let straight = objective(0.8, 0.0);
    assert!(straight < 1e-6 && task.is_success(straight), "{straight}");
    // Too slow: the box stays on the table. Rotated towards the mug: the mug moves.
    assert!(objective(0.2, 0.0) > 0.2);
    let towards_mug = objective(0.8, 0.6);
    assert!(towards_mug > 0.01, "{towards_mug}");
    // The recorded motion gives the same objective.
    let recorded = roll(&task, &scene, &[0.8, 0.6], Some(MotionRecording { every_s: 0.0 }));
    assert_eq!(recorded.objective, towards_mug);
    let mug = recorded.trajectory.unwrap();
    let mug = &mug.body("mug").expect("it moved").states;
    let moved = mug.iter().map(|s| s.x_wb.translation.distance(mug[0].x_wb.translation)).fold(0.0, f64::max);
    assert!(towards_mug >= 2.0 * moved, "{towards_mug} {moved}");
}

#[test]
fn the_finger_starts_clear_of_a_body_that_is_no_ball() {
    let scene = table();
    let task = read(PUSH_OFF).resolve(&scene).unwrap();
    for angle in [-0.9, -0.4, 0.0, 0.7] {
        let motion = task.strike(&Action(vec![0.5, angle]));
        let forward = motion.direction_w();
        let half = DVec3::splat(0.03);
        let reach = forward.abs().dot(half.with_z(0.0));
        assert!((motion.ball_radius - reach).abs() < 1e-12, "{angle}: {} {reach}", motion.ball_radius);
    }
}

#[test]
fn a_mug_is_toppled_and_what_keeps_out_of_a_place_costs_nothing() {
    let scene = table();
    let topple = read(
        r#"
        kind = "strike"
        strike = { name = "box" }
        form = "speed_angle"
        bounds = { speed = [0.2, 2.0] }
        [[terms]]
        term = "topple"
        body = { name = "mug" }
        [[terms]]
        term = "avoid"
        body = "others"
        place = { center_w = [0.0, 0.0], radius_m = 0.05 }
    "#,
    )
    .resolve(&scene)
    .unwrap();
    assert_eq!(topple.target().name, "mug");
    assert!((topple.initial_objective() - 0.1).abs() < 1e-12);
    // The angle 0 points to the mug. A slow push moves the mug without toppling it.
    let slow = roll(&topple, &scene, &[0.25, 0.0], None).objective;
    let fast = roll(&topple, &scene, &[2.0, 0.0], None).objective;
    println!("slow {slow:.4}, fast {fast:.4}");
    assert!(slow > 0.08 && fast < 0.02, "{slow} {fast}");
}

/// A ball task expressed by terms equals billiards.
#[test]
fn reaching_with_a_ball_is_the_billiards_objective() {
    let scene = two_balls();
    let terms = read(
        r#"
        kind = "strike"
        strike = { name = "cue" }
        form = "speed_angle"
        [[terms]]
        term = "reach"
        body = { name = "blue" }
        place = { at_w = [0.8, 0.03] }
    "#,
    );
    let billiards = read(
        r#"
        kind = "billiards"
        cue = { name = "cue" }
        target = { name = "blue" }
        goal_w = [0.8, 0.03]
        form = "speed_angle"
    "#,
    );
    let (terms, billiards) = (terms.resolve(&scene).unwrap(), billiards.resolve(&scene).unwrap());
    assert_eq!(terms.parameters(), billiards.parameters());
    assert_eq!(terms.suggestions(), billiards.suggestions());
    assert_eq!(terms.direct_box(), billiards.direct_box());
    assert!((terms.initial_objective() - billiards.initial_objective()).abs() < 1e-12);
    for action in [[0.6, 0.0], [0.5, 0.05], [0.8, -0.1]] {
        let (a, b) = (roll(&terms, &scene, &action, None), roll(&billiards, &scene, &action, None));
        assert!((a.objective - b.objective).abs() < 1e-6, "{action:?}: {} {}", a.objective, b.objective);
    }
}

#[test]
fn errors_name_the_file_and_the_term() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("task.toml");
    let attempt = |text: &str| -> String {
        std::fs::write(&path, text).unwrap();
        match Task::read(&path) {
            Err(e) => e.to_string(),
            Ok(task) => match task.resolve(&table()) {
                Err(TaskError::Input(e)) => e.to_string(),
                other => panic!("{text}\nwas taken: {other:?}"),
            },
        }
    };
    for (from, to, words) in [
        ("{ name = \"mug\" }", "{ name = \"cup\" }", "terms[1].body"),
        ("{ name = \"mug\" }", "{ name = \"cup\" }", "mug"),
        ("keep-still", "keep-quiet", "keep-quiet"),
        ("weight = 2.0", "weight = -2.0", "weight"),
        ("weight = 2.0", "wieght = 2.0", "wieght"),
        ("max_w = [1.5, 0.4, 0.1]", "max_w = [0.2, 0.4, 0.1]", "min_w"),
        ("min_w = [0.3, -0.4, 0.0], max_w = [1.5, 0.4, 0.1]", "at_w = [300.0, 0.0]", "300.000"),
        ("when = \"end\"", "when = \"end\"\nbetween_s = [5.0, 6.0]", "between_s"),
        ("body = { name = \"box\" }", "body = \"others\"", "terms[0]"),
        ("max_w = [1.5, 0.4, 0.1]", "max_w = [1.5, 0.4, 0.1], radius_m = 0.1", "place"),
        ("strike = { name = \"box\" }", "", "strike"),
        ("horizon_s", "horizon_s", "task.toml"),
    ] {
        let text = PUSH_OFF.replacen(from, to, 1);
        let text = if from == to { format!("horizon_s = -1.0\n{PUSH_OFF}") } else { text };
        let message = attempt(&text);
        assert!(message.contains(words) && message.contains("task.toml"), "{to}: {message}");
    }
    assert!(attempt("kind = \"strike\"\nstrike = { name = \"box\" }\nterms = []").contains("terms"));
    // The far ball is selected by its colour.
    let mut scene = two_balls();
    scene.bodies.push(ball("far", 0.9, 0.2 + RADIUS, [200, 30, 30], material(0.1, 0.9)));
    let task = read(&PUSH_OFF.replace("{ name = \"box\" }", "{ color = \"red\" }").replace("mug", "blue"));
    assert_eq!(task.resolve(&scene).unwrap().cue().name, "far");
}

/// The examples of the book's page on tasks are valid task files whose objective is not met at the start.
#[test]
fn the_examples_can_be_read() {
    let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/tasks");
    let mut count = 0;
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let task = Task::read(&path).unwrap();
        assert_eq!(task.kind(), "strike", "{}", path.display());
        count += 1;
    }
    assert!(count >= 4);
}
