//! The whole path from a sequence to labels with small random models: the labels are meaningless, but well-formed and
//! reproducible. Also errors for bad input.

use crate::support::{data, devices, made_up, requested};
use glamx::{DPose3, DVec3};
use sms_core::{
    Camera, Cancel, ColorImage, DepthImage, Image, Intrinsics, Labels, MaskSource, NormalImage, StageContext,
    Warnings, write_png_color, write_png_gray16,
};
use sms_frames::{Frame, LoadSettings, ReadOptions, Recording, Sequence, load};
use sms_masks::{MasksError, Segmenter};
use sms_nets::owlv2::{Owlv2, Owlv2Config, PixelBox};
use sms_nets::sam2::{Sam2, Sam2Config};
use sms_nets::{Device, ModelFolders, NamedBox, NetsConfig, NetsMasks, Track};
use std::path::Path;

/// Returns a folder with a model in its repository's layout.
fn folder(model: &str) -> tempfile::TempDir {
    let json = std::fs::read(data(model).join("config.json")).unwrap();
    let shapes = if model == "owlv2" {
        requested(|names| Owlv2::new(&serde_json::from_slice::<Owlv2Config>(&json).unwrap(), names))
    } else {
        requested(|names| Sam2::new(&serde_json::from_slice::<Sam2Config>(&json).unwrap(), names))
    };
    // The weights make the model predict that objects are present.
    let folder = made_up(&shapes, 20_250_534, |name, values| {
        if name == "mask_decoder.pred_obj_score_head.proj_out.bias" {
            values.fill(2.0);
        }
    });
    for file in ["config.json", "vocab.json", "merges.txt"] {
        if data(model).join(file).is_file() {
            std::fs::copy(data(model).join(file), folder.path().join(file)).unwrap();
        }
    }
    folder
}

fn sequence(frames: usize) -> Sequence {
    let frame = |index: usize| Frame {
        index,
        ..Frame::new(
            Camera::new(Intrinsics::from_fov(150, 100, 1.0), DPose3::identity()),
            crate::support::frame(index as i64),
            DepthImage::filled(150, 100, 1.0),
            NormalImage::filled(150, 100, [0.0, 0.0, -1.0]),
        )
    };
    Sequence {
        frames: (0..frames).map(frame).collect(),
        x_world_recording: DPose3::identity(),
        source: "here".into(),
    }
}

fn named(name: &str, x0: f64, y0: f64, x1: f64, y1: f64) -> NamedBox {
    NamedBox { name: name.into(), bbox: PixelBox { x0, y0, x1, y1 } }
}

#[test]
fn boxes_and_queries_become_labels_with_either_method_of_tracking() {
    let (owl, sam) = (folder("owlv2"), folder("sam2"));
    for track in [Track::Memory, Track::Reprompt] {
        let mut first: Option<Labels> = None;
        for (name, device) in devices() {
            let masks = NetsMasks {
                config: NetsConfig {
                    objects: vec!["blue box".into(), "cue".into()],
                    threshold: 0.77,
                    track,
                    ..NetsConfig::default()
                },
                boxes: vec![named("ball", 22.0, 20.0, 59.0, 57.0)],
                models: ModelFolders { owlv2: Some(owl.path().into()), sam2: sam.path().into() },
                device,
                read: ReadOptions::default(),
            };
            let warnings = Warnings::new();
            let run = || masks.segment(&sequence(3), StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
            let labels = run();
            assert_eq!(labels.source, MaskSource::Foundation);
            assert_eq!(labels.maps.len(), 3);
            assert_eq!(labels.objects[0].name, "ball");
            assert!(labels.objects.iter().enumerate().all(|(i, o)| usize::from(o.id) == i + 1));
            assert!(labels.maps.iter().all(|m| m.size() == (150, 100)));
            let most = labels.objects.len() as u16;
            assert!(labels.maps.iter().flat_map(|m| &m.data).all(|&l| l <= most));
            assert!(labels.maps[0].data.iter().any(|&l| l > 0), "{track:?} on {name}");
            assert_eq!(labels, run(), "repeated on {name}");
            let cancel = Cancel::new();
            cancel.cancel();
            let stopped = masks.segment(&sequence(3), StageContext::quiet(&cancel, &warnings)).unwrap_err();
            assert!(matches!(stopped, MasksError::Interrupted), "{stopped}");
            // Other devices give the same objects and the same pixels, except for nearly equal logits.
            if let Some(first) = &first {
                assert_eq!(labels.objects, first.objects, "{track:?} on {name}");
                let pixels =
                    |labels: &Labels| labels.maps.iter().flat_map(|m| m.data.clone()).collect::<Vec<_>>();
                let (ours, theirs) = (pixels(&labels), pixels(first));
                let others = ours.iter().zip(&theirs).filter(|(a, b)| a != b).count();
                println!(
                    "{track:?} on {name}: {others} of {} pixels have another label than on the CPU",
                    ours.len()
                );
                assert!(others * 1000 <= ours.len(), "{track:?} on {name}: {others} of {}", ours.len());
            }
            first.get_or_insert(labels);
        }
    }
}

#[test]
fn an_object_that_leaves_the_view_is_reported_and_has_no_more_masks() {
    let sam = folder("sam2");
    let masks = NetsMasks {
        config: NetsConfig { objects: vec![], track: Track::Reprompt, ..NetsConfig::default() },
        boxes: vec![named("ball", 22.0, 20.0, 59.0, 57.0)],
        models: ModelFolders { owlv2: None, sam2: sam.path().into() },
        device: Device::Cpu,
        read: ReadOptions::default(),
    };
    let mut sequence = sequence(5);
    // The camera turns away after the second frame.
    for frame in &mut sequence.frames[2..] {
        frame.camera.x_wc = DPose3::rotation(DVec3::new(0.0, std::f64::consts::PI, 0.0));
    }
    let warnings = Warnings::new();
    let labels = masks.segment(&sequence, StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
    let seen: Vec<bool> = labels.maps.iter().map(|m| m.data.contains(&1)).collect();
    assert_eq!(seen, [true, true, false, false, false]);
    assert_eq!(labels.objects.len(), 1, "it keeps its id");
    assert!(warnings.snapshot().iter().any(|w| w.code == "object_lost"));
}

/// A recording of two frames of 300 × 200 pixels in `folder`, loaded at half that size.
fn recorded(folder: &Path) -> Sequence {
    let mut frames = Vec::new();
    for t in 0..2 {
        let small = crate::support::frame(t);
        let mut color = ColorImage::filled(300, 200, [0; 3]);
        for (i, pixel) in color.data.iter_mut().enumerate() {
            // Detail that disappears at half size.
            *pixel =
                if (i + i / 300).is_multiple_of(2) { small[(i % 300 / 2, i / 600)] } else { [0, 255, 0] };
        }
        write_png_color(&folder.join(format!("{t}.png")), &color).unwrap();
        write_png_gray16(&folder.join(format!("{t}d.png")), &Image::filled(300, 200, 1000)).unwrap();
        let pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
        frames.push(serde_json::json!({
            "file_path": format!("{t}.png"), "depth_file_path": format!("{t}d.png"), "transform_matrix": pose,
        }));
    }
    let json = serde_json::json!({
        "w": 300, "h": 200, "fl_x": 280.0, "fl_y": 280.0, "cx": 150.0, "cy": 100.0, "depth_unit_scale_factor": 0.001,
        "frames": frames,
    });
    std::fs::write(folder.join("transforms.json"), json.to_string()).unwrap();
    let recording = Recording::open(folder, &ReadOptions::default()).unwrap();
    let settings = LoadSettings { long_side: 150, ..LoadSettings::default() };
    load(&recording, &settings, StageContext::quiet(&Cancel::new(), &Warnings::new())).unwrap()
}

#[test]
fn the_networks_use_the_original_images() {
    let (owl, sam, recording) = (folder("owlv2"), folder("sam2"), tempfile::tempdir().unwrap());
    let sequence = recorded(recording.path());
    assert_eq!(sequence.frames[0].color.size(), (150, 100));
    let masks = NetsMasks {
        config: NetsConfig { objects: vec!["cue".into()], threshold: 0.3, ..NetsConfig::default() },
        boxes: vec![named("ball", 22.0, 20.0, 59.0, 57.0)],
        models: ModelFolders { owlv2: Some(owl.path().into()), sam2: sam.path().into() },
        device: Device::Cpu,
        read: ReadOptions::default(),
    };
    let run = |sequence: &Sequence| {
        masks.segment(sequence, StageContext::quiet(&Cancel::new(), &Warnings::new())).unwrap().maps
    };
    let with = run(&sequence);
    assert!(with.iter().all(|m| m.size() == (150, 100)));
    // Without the recording, the scan's resampled images are used.
    let without = run(&Sequence { source: "gone".into(), ..sequence.clone() });
    assert_eq!(without.len(), 2);
    assert_ne!(with, without);
}

#[test]
fn missing_detections_foreign_and_long_queries_cause_warnings() {
    let (owl, sam) = (folder("owlv2"), folder("sam2"));
    let long = "a very long query that has to be cut because it is longer than sixteen tokens";
    let masks = NetsMasks {
        config: NetsConfig {
            objects: vec!["кружка".into(), long.into()],
            threshold: 1.0,
            ..NetsConfig::default()
        },
        boxes: vec![],
        models: ModelFolders { owlv2: Some(owl.path().into()), sam2: sam.path().into() },
        device: Device::Cpu,
        read: ReadOptions::default(),
    };
    let warnings = Warnings::new();
    let labels = masks.segment(&sequence(2), StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
    assert!(labels.objects.is_empty() && labels.maps.len() == 2);
    // If other objects are found, missing ones are reported by name.
    let by_hand = vec![named("ball", 22.0, 20.0, 59.0, 57.0)];
    let some = NetsMasks { boxes: by_hand, ..masks.clone() };
    let others = Warnings::new();
    some.segment(&sequence(1), StageContext::quiet(&Cancel::new(), &others)).unwrap();
    let snapshot = others.snapshot();
    assert_eq!(snapshot.iter().filter(|w| w.code == "object_not_found").count(), 2, "{snapshot:?}");
    let codes: Vec<String> = warnings.snapshot().into_iter().map(|w| w.code).collect();
    for code in ["foreign_query", "long_query", "no_objects"] {
        assert!(codes.iter().any(|c| c == code), "{code} in {codes:?}");
    }
}

#[test]
fn bad_input_is_explained() {
    let (owl, sam) = (folder("owlv2"), folder("sam2"));
    let base = NetsMasks {
        config: NetsConfig { objects: vec![], ..NetsConfig::default() },
        boxes: vec![named("ball", 22.0, 20.0, 59.0, 57.0)],
        models: ModelFolders { owlv2: None, sam2: sam.path().into() },
        device: Device::Cpu,
        read: ReadOptions::default(),
    };
    let fault = |path: &str, change: &dyn Fn(&mut NetsMasks)| {
        let mut masks = base.clone();
        change(&mut masks);
        let (cancel, warnings) = (Cancel::new(), Warnings::new());
        match masks.segment(&sequence(1), StageContext::quiet(&cancel, &warnings)) {
            Err(MasksError::Input(e)) => assert!(e.path.ends_with(path), "{path}: {e}"),
            other => panic!("{path}: {other:?}"),
        }
    };
    fault("--box", &|m| m.boxes[0] = named("ball", 500.0, 0.0, 600.0, 50.0));
    fault("--weights", &|m| m.config.objects = vec!["cue".into()]);
    fault("threshold", &|m| m.config.threshold = 1.5);
    // The two models swapped, and a folder without a model.
    fault("config.json", &|m| m.models.sam2 = owl.path().into());
    fault("nowhere", &|m| m.models.sam2 = "nowhere".into());
    // A truncated weight file, and the weights of another model.
    let cut = folder("sam2");
    let weights = cut.path().join("model.safetensors");
    let bytes = std::fs::read(&weights).unwrap();
    std::fs::write(&weights, &bytes[..bytes.len() / 2]).unwrap();
    fault("model.safetensors", &|m| m.models.sam2 = cut.path().into());
    let mixed = folder("sam2");
    std::fs::copy(owl.path().join("model.safetensors"), mixed.path().join("model.safetensors")).unwrap();
    fault("model.safetensors", &|m| m.models.sam2 = mixed.path().into());
}

#[test]
fn an_invalid_detector_config_is_refused_with_file_and_field() {
    let (owl, sam) = (folder("owlv2"), folder("sam2"));
    let masks = NetsMasks {
        config: NetsConfig { objects: vec!["ball".into()], ..NetsConfig::default() },
        boxes: vec![],
        models: ModelFolders { owlv2: Some(owl.path().into()), sam2: sam.path().into() },
        device: Device::Cpu,
        read: ReadOptions::default(),
    };
    let path = owl.path().join("config.json");
    let text = std::fs::read_to_string(&path).unwrap();
    for (from, to, word) in [
        (r#""model_type": "owlv2","#, r#""model_type": "owlvit","#, "kind `owlvit`"),
        (r#""patch_size": 16"#, r#""patch_size": 20"#, "vision_config.patch_size, 20"),
        (r#""patch_size": 16"#, r#""patch_size": 0"#, "vision_config.patch_size is 0"),
        (r#""image_size": 96"#, r#""image_size": 1600000"#, "vision_config.image_size is 1600000"),
        (r#""num_attention_heads": 4"#, r#""num_attention_heads": 5"#, "text_config.num_attention_heads, 5"),
        (r#""vocab_size": 589"#, r#""vocab_size": 0"#, "text_config.vocab_size is 0"),
        (r#""projection_dim": 32"#, r#""projection_dim": 64"#, "projection_dim is 64"),
        // For values that are not numbers, the error has the line.
        (r#""projection_dim": 32"#, r#""projection_dim": -1"#, "line 9"),
        (r#""patch_size": 16"#, r#""patch_size": "#, "line 42"),
    ] {
        std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
        let run = masks.segment(&sequence(1), StageContext::quiet(&Cancel::new(), &Warnings::new()));
        let Err(MasksError::Input(error)) = run else { panic!("{to}: {run:?}") };
        assert!(error.path.ends_with("config.json") && error.to_string().contains(word), "{to}: {error}");
    }
}
