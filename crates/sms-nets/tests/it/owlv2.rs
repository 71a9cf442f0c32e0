//! OWLv2 against the reference implementation.

use crate::random::random_weights;
use crate::support::{Reference, data, devices, full_size, made_up, reference_folder, requested, weights};
use candle_core::{Device, Tensor};
use sms_nets::TensorObserver;
use sms_nets::owlv2::{ClipTokenizer, Owlv2, Owlv2Config, Tokens, detections, pixel_values};
use std::path::Path;

fn config(folder: &Path) -> Owlv2Config {
    serde_json::from_slice(&std::fs::read(folder.join("config.json")).unwrap()).unwrap()
}

/// Runs the model on the reference's image and queries, and compares all intermediate tensors and the detections.
fn run(model: &Owlv2, tokens: &[Tokens], pixels: &Tensor, reference: &mut Reference) {
    let text =
        model.text(&tokens[..4], &mut TensorObserver::new(|name, t| reference.compare(name, t))).unwrap();
    let features =
        model.image(pixels, &mut TensorObserver::new(|name, t| reference.compare(name, t))).unwrap();
    let heads = model.heads(&features, &text).unwrap();
    reference.compare("head.class_embeds", &heads.class_embeds);
    reference.compare("head.logits", &heads.logits);
    reference.compare("head.pred_boxes", &heads.boxes);
    reference.compare("head.objectness_logits", &heads.objectness);
    reference.compare("head.box_bias", model.box_bias());
    let found = detections(&heads.logits, &heads.boxes, (150, 100), 0.77).unwrap();
    let scores: Vec<f32> = found.iter().map(|d| d.score as f32).collect();
    let boxes: Vec<f32> =
        found.iter().flat_map(|d| [d.bbox.x0, d.bbox.y0, d.bbox.x1, d.bbox.y1].map(|v| v as f32)).collect();
    let labels: Vec<u32> = found.iter().map(|d| d.query as u32).collect();
    reference.compare("detections.scores", &Tensor::new(scores, &Device::Cpu).unwrap());
    reference.compare("detections.boxes", &Tensor::new(boxes, &Device::Cpu).unwrap());
    reference.compare("detections.labels", &Tensor::new(labels, &Device::Cpu).unwrap());
}

fn tokens(folder: &Path, reference: &mut Reference) -> Vec<Tokens> {
    let texts: Vec<String> =
        serde_json::from_slice(&std::fs::read(folder.join("texts.json")).unwrap()).unwrap();
    let tokenizer = ClipTokenizer::open(folder, 16).unwrap();
    let tokens: Vec<Tokens> = texts.iter().map(|t| tokenizer.encode(t).unwrap()).collect();
    let ids: Vec<u32> = tokens.iter().flat_map(|t| t.ids.clone()).collect();
    let mask: Vec<u32> = tokens.iter().flat_map(|t| (0..16).map(|i| u32::from(i < t.used))).collect();
    reference.compare("tokenizer.input_ids", &Tensor::new(ids.clone(), &Device::Cpu).unwrap());
    reference.compare("tokenizer.attention_mask", &Tensor::new(mask.clone(), &Device::Cpu).unwrap());
    reference.compare("input.input_ids", &Tensor::new(&ids[..64], &Device::Cpu).unwrap());
    reference.compare("input.attention_mask", &Tensor::new(&mask[..64], &Device::Cpu).unwrap());
    // The small vocabulary encodes Chinese byte by byte.
    let is_cut: Vec<bool> = tokens.iter().map(|t| t.is_cut).collect();
    assert_eq!(is_cut, [false, false, false, false, false, false, false, true, true]);
    tokens
}

#[test]
#[ignore = "needs the reference tensors of SMS_TEST_REFERENCE"]
fn every_seam_equals_the_reference() {
    let folder = reference_folder().join("owlv2");
    for (name, device) in devices() {
        let mut reference = Reference::open(&folder.join("reference.safetensors"), name);
        let model = Owlv2::new(&config(&folder), &weights(&folder, &device)).unwrap();
        let image = crate::support::frame(0);
        let bytes: Vec<u8> = image.data.iter().flatten().copied().collect();
        reference.compare("input.image", &Tensor::new(bytes, &Device::Cpu).unwrap());
        let pixels = pixel_values(&image, 96, &device).unwrap();
        reference.compare("input.pixel_values", &pixels);
        let tokens = tokens(&folder, &mut reference);
        run(&model, &tokens, &pixels, &mut reference);
        reference.finish(&[""], &[]);
    }
}

#[test]
fn results_equal_the_reference_with_synthetic_weights() {
    let folder = data("owlv2");
    let config = config(&folder);
    let shapes = requested(|weights| Owlv2::new(&config, weights));
    let made_up = made_up(&shapes, 20_250_515, |_, _| {});
    for (name, device) in devices() {
        let mut reference = Reference::open(&folder.join("reference.safetensors"), name);
        let model = Owlv2::new(&config, &weights(made_up.path(), &device)).unwrap();
        let pixels = pixel_values(&crate::support::frame(0), 96, &device).unwrap();
        let tokens = tokens(&folder, &mut reference);
        run(&model, &tokens, &pixels, &mut reference);
        reference.finish(&[""], &[]);
    }
}

#[test]
fn the_full_size_model_asks_for_exactly_the_released_parameters() {
    // The released configuration states little: the rest are the library's defaults.
    let config: Owlv2Config =
        serde_json::from_str(r#"{"model_type":"owlv2","vision_config":{"image_size":960}}"#).unwrap();
    let shapes = requested(|weights| Owlv2::new(&config, weights));
    assert_eq!(shapes, full_size("owlv2-base-patch16-ensemble"));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let folder = data("owlv2");
    let run = |threads: usize, device: &Device| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let model = Owlv2::new(&config(&folder), &random_weights(3, device)).unwrap();
            let pixels = pixel_values(&crate::support::frame(2), 96, device).unwrap();
            let features = model.image(&pixels, &mut TensorObserver::none()).unwrap();
            features
                .flatten_all()
                .unwrap()
                .to_vec1::<f32>()
                .unwrap()
                .iter()
                .map(|v| v.to_bits())
                .collect::<Vec<_>>()
        })
    };
    for (name, device) in devices() {
        assert_eq!(run(1, &device), run(2, &device), "{name}");
    }
}
