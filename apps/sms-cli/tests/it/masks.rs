//! Stages that edits of `masks/labels.json` repeat, and the output of `sms masks --preview`.

#[cfg(feature = "nets")]
use crate::common::sms;
use crate::common::{CopiedRun, done, recording, said};
use std::fs;
use std::process::Output;

/// A copied run whose `labels.json` a test edits. A stage that is made again replaces its folder, and with it the mark in
/// the folder of the Gaussians.
fn marked_run() -> CopiedRun {
    let run = CopiedRun::new();
    assert!(run.path("entities/object_01").is_dir() && run.path("entities/object_02").is_dir());
    fs::write(run.path("gaussians/mark"), "").unwrap();
    run
}

impl CopiedRun {
    fn scan(&self) {
        let paths = ["scan", recording().to_str().unwrap(), "--out", &self.folder()];
        done(&[&paths[..], &["--preset", "draft", "--set", "scan.fused.steps=100"]].concat());
    }

    fn materialize(&self) -> Output {
        let coarse = ["--set", "entities.point_budget=2000", "--set", "entities.texture.enabled=false"];
        self.run("materialize", &coarse)
    }
}

#[test]
fn other_names_leave_the_gaussians() {
    let run = marked_run();
    run.edit_labels("\"name\": \"object_02\"", "\"name\": \"tin\"");
    run.scan();
    assert!(run.path("gaussians/mark").is_file(), "the Gaussians were made again");
    assert!(run.materialize().status.success());
    assert!(run.path("entities/tin").is_dir() && !run.path("entities/object_02").exists());
    let scene = fs::read_to_string(run.path("scene/scene.json")).unwrap();
    assert!(scene.contains("\"tin\"") && !scene.contains("object_02"));
}

#[test]
fn merged_objects_need_other_gaussians() {
    let run = marked_run();
    run.edit_labels("\"merge_into\": null", "\"merge_into\": \"object_02\"");
    let refused = run.materialize();
    let message = said(&refused);
    assert_eq!(refused.status.code(), Some(2), "{message}");
    assert!(message.contains("labels.json") && message.contains("scan again"), "{message}");
    run.scan();
    assert!(!run.path("gaussians/mark").is_file(), "the Gaussians know of the merge");
    assert!(run.materialize().status.success());
    assert!(run.path("entities/object_02").is_dir() && !run.path("entities/object_01").exists());
}

/// Manual boxes need no detector and thus no weights: the test covers the time and content of the drawing.
#[cfg(feature = "nets")]
#[test]
fn what_was_found_is_drawn_before_it_is_followed() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let weights = dir.path().join("weights");
    fs::create_dir_all(weights.join("sam2-tiny")).unwrap();
    fs::write(weights.join("sam2-tiny/config.json"), "{\"model_type\": \"sam2_video\"}").unwrap();
    fs::write(weights.join("sam2-tiny/model.safetensors"), "no weights").unwrap();
    let paths = ["scan", recording().to_str().unwrap(), "--out", run.to_str().unwrap(), "--preset", "draft"];
    let nets = ["--masks", "sam2", "--weights", weights.to_str().unwrap(), "--box", "mug=20,30,60,70"];
    let refused = sms(&[&paths[..], &nets].concat());
    assert_eq!(refused.status.code(), Some(2), "{}", String::from_utf8_lossy(&refused.stderr));
    let told = String::from_utf8_lossy(&refused.stdout).into_owned();
    assert!(told.contains("1.00 mug") && told.contains("--box \"mug=20,30,60,70\""), "{told}");
    assert!(!run.join("masks").exists(), "the tracker could not be built");
    let preview = run.join("preview.png");
    let before = sms_core::read_png_color(&preview).unwrap();

    // Another box: only the first frame is looked at, with no tracker at all.
    fs::remove_file(&preview).unwrap();
    let masks = ["masks", run.to_str().unwrap(), "--preview"];
    let told = done(&[&masks[..], &["--box", "mug=20,30,90,100"]].concat());
    assert!(told.contains("1 found in the first frame"), "{told}");
    let after = sms_core::read_png_color(&preview).unwrap();
    assert!(after.size() == before.size() && after.width >= 800);
    // The right edge of each box, in pixels of the enlarged frame.
    let factor = after.width / 200;
    let edge = |image: &sms_core::ColorImage, x: usize| image[(factor * x - 1, factor * 50)];
    assert_eq!(edge(&before, 60), edge(&after, 90));
    assert!(edge(&before, 90) != edge(&after, 90) && edge(&after, 60) != edge(&before, 60));
    // Without a question there are no masks to show.
    let refused = sms(&masks);
    assert_eq!(refused.status.code(), Some(2));
}
