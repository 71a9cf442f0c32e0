//! SAM 2.1 against the reference implementation.

use crate::support::{
    Reference, TOLERANCE, data, devices, full_size, made_up, reference_folder, requested, weights,
};
use candle_core::{DType, Device, Tensor};
use sms_nets::TensorObserver;
use sms_nets::owlv2::PixelBox;
use sms_nets::sam2::{Sam2, Sam2Config, Tracker, pixel_values};
use std::path::Path;

const SIZE: (usize, usize) = (150, 100);
const FRAMES: usize = 8;

fn config(folder: &Path) -> Sam2Config {
    serde_json::from_slice(&std::fs::read(folder.join("config.json")).unwrap()).unwrap()
}

fn boxes(reference: &Reference) -> Vec<PixelBox> {
    let rows = reference.tensor("input.boxes").to_vec2::<f32>().unwrap();
    let at = |r: &[f32], i: usize| f64::from(r[i]);
    rows.iter().map(|r| PixelBox { x0: at(r, 0), y0: at(r, 1), x1: at(r, 2), y1: at(r, 3) }).collect()
}

/// Tracks both objects through all frames and compares all intermediate tensors.
fn track(model: &Sam2, pixels: &[Tensor], reference: &mut Reference) {
    let mut tracker = Tracker::new(model, &boxes(reference), SIZE, FRAMES);
    let all = std::cell::RefCell::new(reference);
    for (t, pixels) in pixels.iter().enumerate() {
        // For the encoder, the reference has only the first frame.
        let mut observer = if t == 0 {
            TensorObserver::new(|n, x| all.borrow_mut().compare(n, x))
        } else {
            TensorObserver::none()
        };
        let features = model.encode(pixels, &mut observer).unwrap();
        drop(observer);
        let mut observer = TensorObserver::new(|name, tensor| {
            let mut reference = all.borrow_mut();
            reference.compare(name, tensor);
        });
        let masks = tracker.next(&features, &mut observer).unwrap();
        drop(observer);
        let full: Vec<f32> = masks.iter().flat_map(|m| m.resized(SIZE.0, SIZE.1)).collect();
        let full = Tensor::new(full, &Device::Cpu).unwrap();
        all.borrow_mut().compare(&format!("frame{t}.mask_logits_full"), &full);
    }
}

#[test]
#[ignore = "needs the reference tensors of SMS_TEST_REFERENCE"]
fn every_seam_of_all_frames_and_objects_equals_the_reference() {
    let folder = reference_folder().join("sam2");
    for (name, device) in devices() {
        let mut reference = Reference::open(&folder.join("reference.safetensors"), name);
        let model = Sam2::new(&config(&folder), &weights(&folder, &device)).unwrap();
        let pixels = reference.tensor("input.pixel_values").to_device(&device).unwrap();
        let pixels: Vec<Tensor> = (0..FRAMES).map(|t| pixels.narrow(0, t, 1).unwrap()).collect();
        track(&model, &pixels, &mut reference);
        reference.compare("memory.position", &model.memory_positions().clone());
        let here = Device::Cpu;
        for (i, corners) in boxes(&reference).iter().map(|b| model.box_prompt(b, SIZE)).enumerate() {
            reference.compare(&format!("input.obj{i}.point_coords"), &Tensor::new(&corners, &here).unwrap());
            reference
                .compare(&format!("input.obj{i}.point_labels"), &Tensor::new(&[2u32, 3], &here).unwrap());
        }
        let given = ["input.boxes", "input.frames", "input.pixel_values"];
        reference.finish(&[""], &given);
    }
}

#[test]
#[ignore = "needs the reference tensors of SMS_TEST_REFERENCE"]
fn images_are_prepared_as_the_reference_does() {
    let folder = reference_folder().join("sam2");
    let reference = Reference::open(&folder.join("reference.safetensors"), "cpu");
    let theirs = reference.tensor("input.pixel_values");
    let frames = reference.tensor("input.frames");
    for t in 0..FRAMES {
        let image = crate::support::frame(t as i64);
        let bytes: Vec<u8> = image.data.iter().flatten().copied().collect();
        assert_eq!(bytes, frames.get(t).unwrap().flatten_all().unwrap().to_vec1::<u8>().unwrap());
        let ours = pixel_values(&image, 128, &Device::Cpu).unwrap().squeeze(0).unwrap();
        let gap = (ours - theirs.get(t).unwrap()).unwrap().abs().unwrap();
        let largest = gap.max_all().unwrap().to_scalar::<f32>().unwrap();
        // All bytes are equal; only normalization causes rounding.
        assert!(largest < 1e-6, "frame {t}: {largest}");
    }
}

#[test]
fn tracking_equals_the_reference_with_weights_made_up_here() {
    let folder = data("sam2");
    let config = config(&folder);
    let mut shapes = requested(|weights| Sam2::new(&config, weights));
    // Tied to the image's embedding.
    shapes.remove("prompt_encoder.shared_embedding.positional_embedding");
    let made_up = made_up(&shapes, 20_250_534, |name, values| match name {
        "mask_decoder.pred_obj_score_head.proj_out.weight" => {
            values.iter_mut().for_each(|v| *v = f64::from(*v as f32 * 5.0))
        }
        "mask_decoder.pred_obj_score_head.proj_out.bias" => values.fill(-1.5),
        _ => {}
    });
    for (name, device) in devices() {
        let mut reference = Reference::open(&folder.join("reference.safetensors"), name);
        let model = Sam2::new(&config, &weights(made_up.path(), &device)).unwrap();
        let pixels = |t: usize| pixel_values(&crate::support::frame(t as i64), 128, &device).unwrap();
        let pixels: Vec<Tensor> = (0..FRAMES).map(pixels).collect();
        track(&model, &pixels, &mut reference);
        reference.finish(&[""], &["input.boxes"]);
    }
}

#[test]
#[ignore = "needs the reference tensors of SMS_TEST_REFERENCE"]
fn memories_in_f32_differ_from_the_librarys_rounded_ones_as_the_reference_says() {
    let folder = reference_folder().join("sam2");
    let exact = Reference::open(&folder.join("reference.safetensors"), "cpu");
    let rounded = Reference::open(&folder.join("reference_bf16_memory.safetensors"), "cpu");
    let mut largest = 0f32;
    for t in 0..FRAMES {
        let name = format!("frame{t}.pred_masks");
        let gap = (exact.tensor(&name) - rounded.tensor(&name)).unwrap().abs().unwrap();
        largest = largest.max(gap.to_dtype(DType::F32).unwrap().max_all().unwrap().to_scalar().unwrap());
    }
    // The effect of rounding is visible, so the comparison above uses the exact tensors.
    assert!(largest > 10.0 * TOLERANCE && largest < 1e-2, "{largest}");
}

#[test]
fn the_full_size_model_asks_for_exactly_the_released_parameters() {
    let shapes = requested(|weights| Sam2::new(&Sam2Config::default(), weights));
    assert_eq!(shapes, full_size("sam2.1-hiera-tiny"));
}

/// The larger models differ only in the sizes of their encoders. Their configurations come from the conversion script
/// of transformers, and their parameter counts from the README of the SAM 2 repository.
#[test]
fn the_larger_models_have_as_many_parameters_as_published() {
    let small = r#"{"blocks_per_stage": [1, 2, 11, 2], "global_attention_blocks": [7, 10, 13]}"#;
    let base_plus = r#"{"embed_dim_per_stage": [112, 224, 448, 896], "num_attention_heads_per_stage": [2, 4, 8, 16],
        "blocks_per_stage": [2, 3, 16, 3], "global_attention_blocks": [12, 16, 20],
        "window_positional_embedding_background_size": [14, 14]}"#;
    let large = r#"{"embed_dim_per_stage": [144, 288, 576, 1152], "num_attention_heads_per_stage": [2, 4, 8, 16],
        "blocks_per_stage": [2, 6, 36, 4], "global_attention_blocks": [23, 33, 43],
        "window_size_per_stage": [8, 4, 16, 8]}"#;
    for (backbone, published_millions) in [("{}", 38.9), (small, 46.0), (base_plus, 80.8), (large, 224.4)] {
        let json = format!(r#"{{"vision_config": {{"backbone_config": {backbone}}}}}"#);
        let config: Sam2Config = serde_json::from_str(&json).unwrap();
        assert_eq!(config.fault(), None);
        let shapes = requested(|weights| Sam2::new(&config, weights));
        let count: usize = shapes.values().map(|s| s.iter().product::<usize>()).sum();
        let millions = count as f64 / 1e6;
        println!("{millions:.2} million parameters, published {published_millions}");
        assert!((millions - published_millions).abs() < 0.1, "{millions} {published_millions}");
    }
}
