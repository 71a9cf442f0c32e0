//! `sms materials`: lists the materials of objects, keeps edits in the run, refuses invalid ones with exit code 2.

use serde_json::Value;
use sms_core::glamx::{DPose3, DVec3};
use sms_core::{Entity, EntityKind, EntityShape, Hash, Mesh, PointCloud, RunFolder, StageState, Warnings};
use sms_materials::{MaterialTable, ObjectQuery, Overrides, assign};
use std::path::Path;
use std::process::Output;

fn materials(run: &Path, arguments: &[&str]) -> Output {
    crate::common::sms(&[&["materials", run.to_str().unwrap()], arguments].concat())
}

fn text(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn json(run: &Path, arguments: &[&str]) -> Value {
    let output = materials(run, &[arguments, &["--json"]].concat());
    serde_json::from_str(&text(&output)).unwrap()
}

fn empty_run(dir: &Path) -> RunFolder {
    let run = RunFolder::create(dir).unwrap();
    run.record_settings("test", &serde_json::json!({})).unwrap();
    run
}

/// A run with a scene of one mug, a cube of one litre, on the floor.
fn run_with_a_mug() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let mesh = Mesh::cuboid(DVec3::splat(0.05)).transformed(&DPose3::translation(0.0, 0.0, 0.05));
    let mug = Entity {
        label: 1,
        name: "object_01".into(),
        description: "mug".into(),
        kind: EntityKind::Dynamic,
        shape: EntityShape::Convex,
        cloud: PointCloud::default(),
        parts: vec![mesh.clone()],
        mesh,
        texture: None,
        observed_share: 0.9,
        residual_m: 0.0,
        mean_color: [200; 3],
    };
    let query = |name: &str, description: &str, volume_m3: f64| ObjectQuery {
        name: name.into(),
        description: description.into(),
        volume_m3,
        ..Default::default()
    };
    let queries = [query("object_01", "mug", 1e-3), query("floor", "floor", 0.0)];
    let mut materials = assign(&queries, &MaterialTable::builtin(), None, &Warnings::new()).unwrap();
    let support = materials.pop().map(|floor| (0.0, floor));
    let scene = sms_scene::build_scene("test", &[mug], &materials, support, DPose3::identity()).unwrap();
    let run = empty_run(dir.path());
    let StageState::Todo(stage) = run.begin("scene", &Hash("test".into()), false).unwrap() else { panic!() };
    sms_scene::save_scene(stage.dir(), &scene).unwrap();
    sms_core::atomic::write_json(&stage.dir().join("materials.json"), &queries).unwrap();
    stage.commit().unwrap();
    dir
}

#[test]
fn values_are_listed_changed_and_taken_back() {
    let dir = run_with_a_mug();
    let run = dir.path();
    let list = text(&materials(run, &[]));
    for words in
        ["object_01 (mug): ceramic", "floor: floor", "2400", "[2000 – 2700]", "fill_factor", "table", "0.9"]
    {
        assert!(list.contains(words), "{words}: {list}");
    }
    assert!(!list.contains("sms materialize"), "the scene has these values: {list}");
    assert!(!run.join("materials.toml").exists(), "to look at it writes nothing");

    let list =
        text(&materials(run, &["--set", "object_01.friction=0.3,0.2,0.4", "--set", "object_01.mass_kg=0.5"]));
    assert!(list.contains("[0.2 – 0.4]") && list.contains("user"), "{list}");
    assert!(!list.contains("floor"), "only the changed object is listed: {list}");
    assert!(list.contains("other values for object_01: run `sms materialize"), "{list}");
    let m = json(run, &[]);
    assert!((m["materials.object_01.mass_kg"].as_f64().unwrap() - 0.5).abs() < 1e-12);
    assert_eq!(m["materials.object_01.friction_low"], 0.2);
    assert_eq!(m["materials.object_01.friction_source"], "user");
    assert_eq!(m["materials.object_01.restitution_source"], "table");
    // The same form as --materials FILE.
    let edits = Overrides::read(&run.join("materials.toml")).unwrap();
    assert_eq!(edits.object["object_01"].friction.unwrap().interval().high, 0.4);

    let m = json(run, &["--unset", "object_01.mass_kg", "--set", "object_01.class=steel"]);
    assert_eq!(
        (m["materials.object_01.class"].as_str(), m["materials.object_01.density"].as_f64()),
        (Some("steel"), Some(7850.0))
    );
    let list = text(&materials(run, &["--unset", "object_01"]));
    assert!(
        list.contains("ceramic") && !list.contains("user") && !list.contains("sms materialize"),
        "{list}"
    );
}

/// `2,1,3` is an interval in order, but no material has a friction of 2.
#[test]
fn a_value_beyond_every_material_is_a_warning() {
    let dir = run_with_a_mug();
    let warned = |value: &str| {
        let output = materials(dir.path(), &["--set", &format!("object_01.friction={value}")]);
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stderr).contains("friction of `object_01`")
    };
    assert_eq!((warned("2,1,3"), warned("0.3,0.2,0.4")), (true, false));
}

#[test]
fn mistakes_are_named_and_change_nothing() {
    let dir = run_with_a_mug();
    let run = dir.path();
    text(&materials(run, &["--set", "object_01.friction=0.3"]));
    let before = std::fs::read(run.join("materials.toml")).unwrap();
    for (arguments, words) in [
        (&["--set", "object_7.friction=0.3"][..], ["object_7", "object_01, floor"]),
        (&["--set", "object_01.colour=red"], ["colour", "youngs_modulus_pa"]),
        (&["--set", "object_01.density=heavy"], ["heavy", "best,low,high"]),
        (&["--set", "object_01.restitution=1.2"], ["restitution", "≤ 1"]),
        (&["--set", "object_01.friction=1,2,3"], ["friction", "best 2, low 1, high 3"]),
        (&["--set", "object_01.class=stone"], ["stone", "marble"]),
        (&["--set", "floor.mass_kg=2"], ["floor", "no mass"]),
        (&["--set", "object_01.density=2000", "--set", "object_01"], ["--set object_01", "OBJECT.KEY=VALUE"]),
        (&["--unset", "object_01.density"], ["density is not set", "user"]),
        (&["--unset", "object_7"], ["object_7", "object_01, floor"]),
    ] {
        let output = materials(run, arguments);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("cure:") && words.iter().all(|w| message.contains(w)), "{message}");
        assert_eq!(std::fs::read(run.join("materials.toml")).unwrap(), before, "{arguments:?}");
    }
    std::fs::write(run.join("materials.toml"), "[object.object_01]\nfrition = 1\n").unwrap();
    let output = materials(run, &[]);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && message.contains("materials.toml"), "{message}");
    let empty = tempfile::tempdir().unwrap();
    drop(empty_run(empty.path()));
    let output = materials(empty.path(), &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("sms materialize"));
}
