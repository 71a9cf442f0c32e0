//! Recordings on disk: layout, secrecy of the truth, resuming, repeatability.

use glamx::{DMat4, DVec4};
use sms_core::{Cancel, CoreError, NoProgress, Seed, read_png_color, read_png_gray16};
use sms_synth::{
    BilliardsSettings, ColorCamera, PoseErrors, RecordingSettings, Sensor, SensorModel, TruthScene,
    generate_billiards, read_truth, write_recording,
};
use std::collections::BTreeMap;
use std::path::Path;

fn scene() -> TruthScene {
    generate_billiards(Seed(3), &BilliardsSettings { objects: 2, ..BilliardsSettings::default() })
}

fn tiny() -> RecordingSettings {
    RecordingSettings { frames: 4, width: 96, height: 60, ..RecordingSettings::small() }
}

fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(dir).unwrap().display().to_string();
                found.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[test]
fn a_recording_has_its_files_and_keeps_the_truth_apart() {
    let scene = scene();
    let dir = tempfile::tempdir().unwrap();
    let summary = write_recording(&scene, &tiny(), dir.path(), &NoProgress, &Cancel::new()).unwrap();
    assert_eq!((summary.frames, summary.rendered), (4, 4));
    let files = files(dir.path());
    let outside: Vec<&String> = files.keys().filter(|n| !n.starts_with("truth/")).collect();
    assert_eq!(outside.len(), 9, "{outside:?}");
    // The planner's files name neither objects nor materials nor masks.
    let transforms = String::from_utf8(files["transforms.json"].clone()).unwrap();
    for secret in ["truth", "mask", "ball", "mug", "ceramic"] {
        assert!(!transforms.contains(secret), "transforms.json gives away `{secret}`");
    }
    assert_eq!(read_truth(dir.path()).unwrap(), scene);
    assert!(files.contains_key("truth/masks/000003.png") && files.contains_key("truth/objects.json"));
    let depth = read_png_gray16(&dir.path().join("depth/000000.png")).unwrap();
    assert_eq!(depth.size(), (96, 60));
    assert_eq!(read_png_color(&dir.path().join("color/000000.png")).unwrap().size(), (96, 60));
}

#[test]
fn transforms_put_the_cue_ball_where_the_masks_show_it() {
    let scene = scene();
    let dir = tempfile::tempdir().unwrap();
    let settings = RecordingSettings { expose_masks: true, ..tiny() };
    write_recording(&scene, &settings, dir.path(), &NoProgress, &Cancel::new()).unwrap();
    let text = std::fs::read_to_string(dir.path().join("transforms.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["world_up"], serde_json::json!([0.0, 0.0, 1.0]));
    assert_eq!(json["world_is_aligned"], true);
    assert_eq!(json["pixel_center"], 0.5);
    let number = |key: &str| json[key].as_f64().unwrap();
    let unit = number("depth_unit_scale_factor");
    let ball = scene.object(&scene.cue).unwrap();
    let mut seen = 0;
    for frame in json["frames"].as_array().unwrap() {
        let rows: Vec<Vec<f64>> = serde_json::from_value(frame["transform_matrix"].clone()).unwrap();
        let columns: [[f64; 4]; 4] = std::array::from_fn(|c| std::array::from_fn(|r| rows[r][c]));
        // OpenGL axes: x right, y up, z backward.
        let p = DMat4::from_cols_array_2d(&columns).inverse() * ball.x_wb.translation.extend(1.0);
        let z = -p.z;
        let (u, v) = (number("fl_x") * p.x / z + number("cx"), number("fl_y") * -p.y / z + number("cy"));
        let mask = read_png_gray16(&dir.path().join(frame["mask_path"].as_str().unwrap())).unwrap();
        let depth = read_png_gray16(&dir.path().join(frame["depth_file_path"].as_str().unwrap())).unwrap();
        if !(0.0..96.0).contains(&u) || !(0.0..60.0).contains(&v) || mask[(u as usize, v as usize)] != 1 {
            continue;
        }
        let measured = f64::from(depth[(u as usize, v as usize)]) * unit;
        if measured > 0.0 {
            // The ray to the centre meets the surface about one radius before it.
            let distance = DVec4::new(p.x, p.y, p.z, 0.0).length();
            let surface = measured * distance / z;
            assert!((distance - surface - ball.sphere_radius.unwrap()).abs() < 0.006, "{distance} {surface}");
            seen += 1;
        }
    }
    assert!(seen >= 2, "the cue ball's centre is visible in {seen} frames");
    let objects: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(dir.path().join("objects.json")).unwrap()).unwrap();
    assert_eq!(objects["objects"][0]["name"], "cue_ball");
    assert_eq!(objects["objects"][0]["mask_value"], 1);
}

#[test]
fn the_same_seed_gives_the_same_bytes_with_one_and_two_threads() {
    let record = |threads: usize, settings: RecordingSettings| {
        let dir = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| write_recording(&scene(), &settings, dir.path(), &NoProgress, &Cancel::new()))
            .unwrap();
        files(dir.path())
    };
    let one = record(1, tiny());
    assert_eq!(one, record(2, tiny()));
    let other = record(2, RecordingSettings { seed: Seed(1), ..tiny() });
    assert_ne!(one["depth/000000.png"], other["depth/000000.png"]);
    assert_eq!(one["truth/masks/000000.png"], other["truth/masks/000000.png"]);
}

#[test]
fn an_interrupted_recording_resumes_to_the_same_bytes() {
    let scene = scene();
    let dir = tempfile::tempdir().unwrap();
    let cancel = Cancel::new();
    cancel.cancel();
    let stopped = write_recording(&scene, &tiny(), dir.path(), &NoProgress, &cancel);
    assert!(matches!(stopped, Err(CoreError::Interrupted)));
    assert!(!dir.path().join("transforms.json").exists(), "an unfinished recording cannot be read");
    let summary = write_recording(&scene, &tiny(), dir.path(), &NoProgress, &Cancel::new()).unwrap();
    assert_eq!(summary.rendered, 4);
    let whole = files(dir.path());
    for lost in ["depth/000002.png", "transforms.json"] {
        std::fs::remove_file(dir.path().join(lost)).unwrap();
    }
    std::fs::write(dir.path().join("color/000001.png.77.tmp"), b"half").unwrap();
    let summary = write_recording(&scene, &tiny(), dir.path(), &NoProgress, &Cancel::new()).unwrap();
    assert_eq!(summary.rendered, 1);
    assert_eq!(files(dir.path()), whole);
}

#[test]
fn pose_noise_disturbs_the_recorded_poses_only() {
    let scene = scene();
    let record = |settings: &RecordingSettings| {
        let dir = tempfile::tempdir().unwrap();
        write_recording(&scene, settings, dir.path(), &NoProgress, &Cancel::new()).unwrap();
        files(dir.path())
    };
    let exact = record(&tiny());
    let poses = PoseErrors { jitter_m: 0.002, jitter_rad: 0.004, ..PoseErrors::default() };
    let sensor = SensorModel { poses, ..SensorModel::default() };
    let noisy = record(&RecordingSettings { sensor, ..tiny() });
    assert_eq!(exact["color/000001.png"], noisy["color/000001.png"]);
    let matrices = |files: &BTreeMap<String, Vec<u8>>| -> Vec<[[f64; 4]; 4]> {
        let json: serde_json::Value = serde_json::from_slice(&files["transforms.json"]).unwrap();
        let frames = json["frames"].as_array().unwrap();
        frames.iter().map(|f| serde_json::from_value(f["transform_matrix"].clone()).unwrap()).collect()
    };
    for (a, b) in matrices(&exact).iter().zip(matrices(&noisy)) {
        let shift = (0..3).map(|i| (a[i][3] - b[i][3]).powi(2)).sum::<f64>().sqrt();
        let cos = 0.5 * ((0..3).flat_map(|i| (0..3).map(move |j| a[i][j] * b[i][j])).sum::<f64>() - 1.0);
        assert!(shift > 1e-4 && shift < 0.012, "{shift}");
        assert!(cos < 1.0 - 1e-8 && cos > (0.02f64).cos(), "{cos}");
    }
}

#[test]
fn foreign_folders_and_impossible_settings_are_refused() {
    let scene = scene();
    let dir = tempfile::tempdir().unwrap();
    write_recording(&scene, &tiny(), dir.path(), &NoProgress, &Cancel::new()).unwrap();
    let before = files(dir.path());
    let refused = |settings: &RecordingSettings, dir: &Path| {
        let error = write_recording(&scene, settings, dir, &NoProgress, &Cancel::new()).unwrap_err();
        let CoreError::Input(error) = error else { panic!("{error:?}") };
        assert_eq!(error.path, dir.display().to_string());
    };
    refused(&RecordingSettings { seed: Seed(9), ..tiny() }, dir.path());
    assert_eq!(files(dir.path()), before, "the earlier recording stays whole");
    let foreign = tempfile::tempdir().unwrap();
    std::fs::write(foreign.path().join("transforms.json"), "{}").unwrap();
    refused(&tiny(), foreign.path());
    let empty = tempfile::tempdir().unwrap();
    let blurred = ColorCamera { exposure_s: -1.0, ..ColorCamera::default() };
    for settings in [
        RecordingSettings { frames: 0, ..tiny() },
        RecordingSettings { width: 0, ..tiny() },
        RecordingSettings { fov_x: f64::NAN, ..tiny() },
        RecordingSettings { depth_unit_m: 0.0, ..tiny() },
        RecordingSettings { frame_rate_hz: 0.0, ..tiny() },
        RecordingSettings { sensor: SensorModel { color: blurred, ..SensorModel::default() }, ..tiny() },
    ] {
        refused(&settings, empty.path());
    }
    assert!(files(empty.path()).is_empty());
    assert!(matches!(read_truth(empty.path()), Err(CoreError::Read { .. })));
}

/// Pixels and poses of the default recording as they were before sensors had models.
#[cfg(all(target_arch = "x86_64", target_os = "linux"))]
#[test]
fn the_default_recording_keeps_its_bytes() {
    let dir = tempfile::tempdir().unwrap();
    write_recording(&scene(), &tiny(), dir.path(), &NoProgress, &Cancel::new()).unwrap();
    let mut hasher = sms_core::Hasher::new();
    for index in 0..4 {
        let image = |folder: &str| dir.path().join(format!("{folder}/{index:06}.png"));
        hasher.bytes(read_png_color(&image("color")).unwrap().data.as_flattened());
        let depth: Vec<u8> =
            read_png_gray16(&image("depth")).unwrap().data.iter().flat_map(|z| z.to_le_bytes()).collect();
        hasher.bytes(&depth);
    }
    hasher.bytes(&std::fs::read(dir.path().join("transforms.json")).unwrap());
    assert_eq!(hasher.finish().0, "eb229b4e6677bd2e4c5237e54adbd729");
}

#[test]
fn every_sensor_records_and_a_phone_s_depth_has_its_own_size_and_confidence() {
    let scene = scene();
    for sensor in Sensor::ALL {
        let dir = tempfile::tempdir().unwrap();
        let settings = RecordingSettings { frames: 3, ..sensor.recording_at(320) };
        write_recording(&scene, &settings, dir.path(), &NoProgress, &Cancel::new()).unwrap();
        let text = std::fs::read_to_string(dir.path().join("transforms.json")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        let depth = read_png_gray16(&dir.path().join("depth/000001.png")).unwrap();
        let color = read_png_color(&dir.path().join("color/000001.png")).unwrap();
        assert_eq!(color.size(), (320, settings.height), "{sensor:?}");
        let measured = depth.data.iter().filter(|z| **z > 0).count() as f64 / depth.data.len() as f64;
        assert!(measured > 0.3, "{sensor:?} measures {measured}");
        let confidence = &json["frames"][1]["confidence_file_path"];
        if sensor != Sensor::PhoneLidar {
            assert_eq!(depth.size(), color.size(), "{sensor:?}");
            assert!(confidence.is_null() && json["depth_fl_x"].is_null());
            continue;
        }
        assert_eq!(depth.size(), (256, 192));
        let scaled = json["fl_x"].as_f64().unwrap() * 256.0 / 320.0;
        assert!((json["depth_fl_x"].as_f64().unwrap() - scaled).abs() < 1e-9);
        let confidence = read_png_gray16(&dir.path().join(confidence.as_str().unwrap())).unwrap();
        assert_eq!(confidence.size(), (256, 192));
        let with = |value: u16| confidence.data.iter().filter(|c| **c == value).count();
        assert!(with(2) > with(0) && with(0) > 0 && with(0) + with(1) + with(2) == 256 * 192);
        // Nothing is sure where nothing is measured.
        assert!(depth.data.iter().zip(&confidence.data).all(|(z, c)| *z > 0 || *c == 0));
    }
}
