//! Stages that edits of `masks/labels.json` repeat, and the output of `sms masks --preview`.

use crate::common::{copy_materialized_run, done, recording, sms};
use std::fs;
use std::path::Path;

fn edit(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{from} in {text}");
    fs::write(path, text.replacen(from, to, 1)).unwrap();
}

#[test]
fn other_names_leave_the_gaussians_and_merged_objects_do_not() {
    let dir = tempfile::tempdir().unwrap();
    let run = dir.path().join("run");
    let scan = || {
        let paths = ["scan", recording().to_str().unwrap(), "--out", run.to_str().unwrap()];
        done(&[&paths[..], &["--preset", "draft", "--set", "scan.final_steps=2"]].concat())
    };
    copy_materialized_run(&run);
    let labels = run.join("masks/labels.json");
    let (name, entities) = ("\"name\": \"object_02\"", run.join("entities"));
    assert!(entities.join("object_02").is_dir());
    // A stage that is made again replaces its folder, and this with it.
    let mark = run.join("gaussians/mark");
    fs::write(&mark, "").unwrap();

    edit(&labels, name, "\"name\": \"tin\"");
    scan();
    assert!(mark.is_file(), "the Gaussians were made again");
    done(&["materialize", run.to_str().unwrap()]);
    assert!(entities.join("tin").is_dir() && !entities.join("object_02").exists());
    let scene = fs::read_to_string(run.join("scene/scene.json")).unwrap();
    assert!(scene.contains("\"tin\"") && !scene.contains("object_02"));

    // Objects that the Gaussians were not trained with are not made of them.
    edit(&labels, "\"merge_into\": null", "\"merge_into\": \"tin\"");
    let refused = sms(&["materialize", run.to_str().unwrap()]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2), "{message}");
    assert!(message.contains("labels.json") && message.contains("scan again"), "{message}");
    scan();
    assert!(!mark.is_file(), "the Gaussians know of the merge");
    done(&["materialize", run.to_str().unwrap()]);
    assert!(entities.join("tin").is_dir() && !entities.join("object_01").exists());
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
