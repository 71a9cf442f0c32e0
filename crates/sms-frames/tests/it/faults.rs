//! Every kind of corrupt recording is refused with the name of the file.

use crate::common::{Written, save, write};
use serde_json::{Value, json};
use sms_core::{
    Cancel, CoreError, Image, NoProgress, StageContext, Warnings, write_png_color, write_png_gray16,
};
use sms_frames::{FramesError, LoadSettings, ReadOptions, Recording, Sequence, check, load};
use std::path::Path;

fn small() -> Written {
    Written { frames: 3, arc: 0.3, ..Written::default() }
}

fn scan(dir: &Path, options: &ReadOptions) -> Result<Sequence, FramesError> {
    let recording = Recording::open(dir, options)?;
    let settings = LoadSettings { long_side: 80, ..LoadSettings::default() };
    load(&recording, &settings, StageContext::quiet(&Cancel::new(), &Warnings::new()))
}

/// The file that an input error names, relative to `dir`.
fn faulty(error: FramesError, dir: &Path) -> String {
    let CoreError::Input(error) = error else { panic!("{error:?}") };
    assert!(!error.cure.is_empty(), "{error}");
    let path = Path::new(&error.path);
    path.strip_prefix(dir).unwrap_or(path).display().to_string()
}

/// Writes a recording, corrupts it, and tests that a scan (and a check, if the recording opens) refuses `file`.
fn expect(file: &str, corrupt: impl FnOnce(&Path, &mut Value)) {
    let dir = tempfile::tempdir().unwrap();
    let mut json = write(dir.path(), &small());
    scan(dir.path(), &ReadOptions::default()).expect("the recording is intact before");
    corrupt(dir.path(), &mut json);
    let error = scan(dir.path(), &ReadOptions::default()).expect_err(file);
    assert_eq!(faulty(error, dir.path()), file);
    if let Ok(recording) = Recording::open(dir.path(), &ReadOptions::default()) {
        let checked = check(&recording, &NoProgress, &Cancel::new()).expect_err("check refuses it too");
        assert_eq!(faulty(checked, dir.path()), file);
    }
}

#[test]
fn missing_folder_and_folder_without_a_recording() {
    let dir = tempfile::tempdir().unwrap();
    let error = scan(&dir.path().join("nowhere"), &ReadOptions::default()).unwrap_err();
    assert_eq!(faulty(error, dir.path()), "nowhere");
    let error = scan(dir.path(), &ReadOptions::default()).unwrap_err();
    assert_eq!(faulty(error, dir.path()), "");
}

#[test]
fn missing_files() {
    expect("depth/000001.png", |dir, _| {
        std::fs::remove_file(dir.join("depth/000001.png")).unwrap();
    });
    expect("color/000002.png", |dir, _| {
        std::fs::remove_file(dir.join("color/000002.png")).unwrap();
    });
}

#[test]
fn truncated_images() {
    for file in ["depth/000001.png", "color/000001.png"] {
        expect(file, |dir, _| {
            let bytes = std::fs::read(dir.join(file)).unwrap();
            std::fs::write(dir.join(file), &bytes[..bytes.len() / 2]).unwrap();
        });
        expect(file, |dir, _| std::fs::write(dir.join(file), b"").unwrap());
    }
}

#[test]
fn depth_of_eight_bits() {
    expect("depth/000000.png", |dir, _| {
        write_png_color(&dir.join("depth/000000.png"), &Image::filled(160, 120, [9, 9, 9])).unwrap();
    });
}

#[test]
fn sizes_that_differ_need_an_explanation() {
    let shrink = |dir: &Path, _: &mut Value| {
        for i in 0..3 {
            let path = dir.join(format!("depth/{i:06}.png"));
            let raw = sms_core::read_png_gray16(&path).unwrap();
            let half =
                Image::from_vec(80, 60, (0..4800).map(|p| raw[(2 * (p % 80), 2 * (p / 80))]).collect());
            write_png_gray16(&path, &half).unwrap();
        }
    };
    expect("depth/000000.png", shrink);

    // With either key the same recording is read.
    for (key, value) in [("depth_same_field_of_view", json!(true)), ("depth_fl_x", json!(75.0))] {
        let dir = tempfile::tempdir().unwrap();
        let mut json = write(dir.path(), &small());
        shrink(dir.path(), &mut json);
        json[key] = value;
        (json["depth_cx"], json["depth_cy"]) = (json!(39.65), json!(30.6));
        save(dir.path(), &json);
        let sequence = scan(dir.path(), &ReadOptions::default()).unwrap();
        assert_eq!(sequence.frames[0].depth.size(), (80, 60));
    }
}

#[test]
fn colour_of_another_size_than_its_intrinsics() {
    expect("color/000000.png", |dir, json| {
        (json["w"], json["h"]) = (json!(320), json!(240));
        save(dir, json);
    });
}

#[test]
fn poses_that_are_not_rigid() {
    expect("transforms.json", |dir, json| {
        for row in 0..3 {
            for column in 0..3 {
                let v = &mut json["frames"][1]["transform_matrix"][row][column];
                *v = json!(v.as_f64().unwrap() * 1.05);
            }
        }
        save(dir, json);
    });
    expect("transforms.json", |dir, json| {
        json["frames"][2]["transform_matrix"][0][1] = json!(0.9);
        save(dir, json);
    });
    expect("transforms.json", |dir, json| {
        json["frames"][0]["transform_matrix"] = json!([[1.0, 0.0], [0.0, 1.0]]);
        save(dir, json);
    });
}

#[test]
fn json_with_nan_or_nonsense() {
    for nan in ["NaN", "Infinity", "-Infinity", "1e999"] {
        expect("transforms.json", |dir, json| {
            json["frames"][1]["transform_matrix"][0][3] = json!("HERE");
            let text = serde_json::to_string_pretty(json).unwrap().replace("\"HERE\"", nan);
            std::fs::write(dir.join("transforms.json"), text).unwrap();
        });
    }
    expect("transforms.json", |dir, _| {
        std::fs::write(dir.join("transforms.json"), "{\"frames\": [").unwrap();
    });
    expect("transforms.json", |dir, json| {
        json.as_object_mut().unwrap().remove("fl_x");
        save(dir, json);
    });
    expect("transforms.json", |dir, json| {
        json["camera_convention"] = json!("left-handed");
        save(dir, json);
    });
    expect("transforms.json", |dir, json| {
        json["frames"][1].as_object_mut().unwrap().remove("depth_file_path");
        save(dir, json);
    });
    expect("transforms.json", |dir, json| {
        json["depth_unit_scale_factor"] = json!(0.0);
        save(dir, json);
    });
    expect("transforms.json", |dir, json| {
        json["camera_model"] = json!("OPENCV_FISHEYE");
        save(dir, json);
    });
}

#[test]
fn zero_frames() {
    expect("transforms.json", |dir, json| {
        json["frames"] = json!([]);
        save(dir, json);
    });
}

#[test]
fn depth_that_is_all_zero() {
    let blank = |dir: &Path, i: usize| {
        write_png_gray16(&dir.join(format!("depth/{i:06}.png")), &Image::filled(160, 120, 0)).unwrap();
    };
    expect("depth/000001.png", |dir, _| blank(dir, 1));

    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &small());
    blank(dir.path(), 1);
    let options = ReadOptions { skip_empty_depth: true, ..ReadOptions::default() };
    let sequence = scan(dir.path(), &options).unwrap();
    assert_eq!(sequence.frames.iter().map(|f| f.index).collect::<Vec<_>>(), [0, 1]);
    assert!(sequence.frames[1].color_path.ends_with("color/000002.png"));
    (0..3).for_each(|i| blank(dir.path(), i));
    assert_eq!(faulty(scan(dir.path(), &options).unwrap_err(), dir.path()), "");
}

#[test]
fn depth_out_of_range_names_the_image() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &small());
    let options = ReadOptions { depth_unit_m: Some(1.0), ..ReadOptions::default() };
    assert_eq!(faulty(scan(dir.path(), &options).unwrap_err(), dir.path()), "depth/000000.png");
}

#[test]
fn options_out_of_range_and_cancelled_work() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &small());
    for options in [
        ReadOptions { depth_unit_m: Some(-1.0), ..ReadOptions::default() },
        ReadOptions { pixel_center: Some(f64::NAN), ..ReadOptions::default() },
        ReadOptions { max_depth_m: 0.0, ..ReadOptions::default() },
    ] {
        assert!(matches!(Recording::open(dir.path(), &options), Err(CoreError::Input(_))));
    }
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    let cancel = Cancel::new();
    cancel.cancel();
    let cancelled =
        load(&recording, &LoadSettings::default(), StageContext::quiet(&cancel, &Warnings::new()));
    assert!(matches!(cancelled, Err(CoreError::Interrupted)));
    let late = LoadSettings { first: 3, ..LoadSettings::default() };
    let error = load(&recording, &late, StageContext::quiet(&Cancel::new(), &Warnings::new())).unwrap_err();
    assert!(matches!(error, CoreError::Input(_)), "{error}");
}
