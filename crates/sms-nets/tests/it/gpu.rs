//! The full-size networks with random weights on a GPU, compared with the CPU. Unlike the small fixtures, they use the
//! kernels for large attention, many windows and long rows.

use crate::random::random_weights;
use crate::support::{TOLERANCE, gpu};
use candle_core::{DType, Device, Tensor};
use sms_nets::TensorObserver;
use sms_nets::owlv2::{Owlv2, Owlv2Config, PixelBox, Tokens};
use sms_nets::sam2::{Sam2, Sam2Config, Tracker};
use std::collections::BTreeMap;

/// Observed tensors by name.
type Observed = BTreeMap<String, Vec<f32>>;

fn keep(observed: &mut Observed, name: &str, tensor: &Tensor) {
    let flat = tensor.to_dtype(DType::F32).unwrap().flatten_all().unwrap();
    observed.insert(name.to_owned(), flat.to_vec1().unwrap());
}

/// A picture of smooth stripes, (1, 3, side, side).
fn picture(side: usize, frame: usize, device: &Device) -> Tensor {
    let value = |i: usize| {
        let (channel, y, x) = (i / (side * side), i / side % side, i % side);
        ((x + 9 * frame) as f32 * 0.021 + channel as f32).sin() + (y as f32 * 0.034).cos()
    };
    let values: Vec<f32> = (0..3 * side * side).map(value).collect();
    Tensor::from_vec(values, (1, 3, side, side), device).unwrap()
}

/// Returns the difference of each tensor, relative to its largest value if that is above 1.
fn gaps(ours: &Observed, theirs: &Observed) -> BTreeMap<String, f32> {
    assert!(ours.keys().eq(theirs.keys()) && !ours.is_empty());
    let gap = |(name, theirs): (&String, &Vec<f32>)| {
        let largest = theirs.iter().fold(1f32, |m, v| m.max(v.abs()));
        // A NaN counts as a difference.
        let worst = |worst: f32, d: f32| if d <= worst { worst } else { d };
        let gap = ours[name].iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0f32, worst) / largest;
        println!("{gap:9.2e} of {largest:8.2} {name}");
        (name.clone(), gap)
    };
    theirs.iter().map(gap).collect()
}

fn check(ours: &Observed, theirs: &Observed) {
    for (name, gap) in gaps(ours, theirs) {
        assert!(gap <= TOLERANCE, "{name}: {gap}");
    }
}

#[test]
#[ignore = "needs a GPU and the feature `cuda` or `metal`"]
fn owlv2_in_full_size_is_the_same_on_a_gpu() {
    let (_, device) = gpu().unwrap();
    let of = |device: &Device| {
        let mut observed = Observed::new();
        let mut config = Owlv2Config::default();
        config.vision_config.image_size = 960;
        let model = Owlv2::new(&config, &random_weights(5, device)).unwrap();
        let ids = |i: u32| (0..16).map(|j| if j < 5 { 49_000 + 37 * i + j } else { 0 }).collect();
        let queries: Vec<Tokens> = (0..3).map(|i| Tokens { ids: ids(i), used: 5, is_cut: false }).collect();
        let text =
            model.text(&queries, &mut TensorObserver::new(|name, t| keep(&mut observed, name, t))).unwrap();
        let mut look = TensorObserver::new(|name, t| keep(&mut observed, name, t));
        let features = model.image(&picture(960, 0, device), &mut look).unwrap();
        drop(look);
        let heads = model.heads(&features, &text).unwrap();
        for (name, tensor) in [("logits", &heads.logits), ("boxes", &heads.boxes)] {
            keep(&mut observed, name, tensor);
        }
        observed
    };
    check(&of(&device), &of(&Device::Cpu));
}

#[test]
#[ignore = "needs a GPU and the feature `cuda` or `metal`"]
fn sam2_in_full_size_is_the_same_on_a_gpu() {
    let (_, device) = gpu().unwrap();
    let of = |device: &Device| {
        let mut observed = Observed::new();
        let model = Sam2::new(&Sam2Config::default(), &random_weights(5, device)).unwrap();
        let boxes = [PixelBox { x0: 100.0, y0: 80.0, x1: 260.0, y1: 200.0 }];
        let mut tracker = Tracker::new(&model, &boxes, (640, 400), 3);
        for frame in 0..2 {
            let mut look =
                TensorObserver::new(|name, t| keep(&mut observed, &format!("image{frame}.{name}"), t));
            let features = model.encode(&picture(1024, frame, device), &mut look).unwrap();
            drop(look);
            tracker
                .next(&features, &mut TensorObserver::new(|name, t| keep(&mut observed, name, t)))
                .unwrap();
        }
        observed
    };
    check(&of(&device), &of(&Device::Cpu));
}
