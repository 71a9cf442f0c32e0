//! Comparison with the reference tensors.
//!
//! The complete reference lies beside the repository (environment variable `SMS_TEST_REFERENCE`, by default
//! `../shared/reference`); tests that need it are ignored by default. A small part is in `tests/data`, with weights
//! generated from their names, so that this comparison runs everywhere.
//!
//! Every comparison runs on the CPU and, in builds with the feature `cuda` or `metal`, on the GPU if there is one.
//! `SMS_TEST_DEVICE=cpu|gpu` selects one of them; with `gpu`, a missing GPU is a failure.

use candle_core::{DType, Device, Tensor};
use sms_nets::{NetsError, Weights, WeightsSource};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Greatest difference from the reference's tensors.
pub(crate) const TOLERANCE: f32 = 1e-4;

/// Returns the devices to compute on, by name.
pub(crate) fn devices() -> Vec<(&'static str, Device)> {
    let asked = std::env::var("SMS_TEST_DEVICE").unwrap_or_default();
    assert!(["", "cpu", "gpu"].contains(&asked.as_str()), "SMS_TEST_DEVICE={asked}: give cpu or gpu");
    let mut devices = Vec::new();
    if asked != "gpu" {
        devices.push(("cpu", Device::Cpu));
    }
    if asked != "cpu" {
        match gpu() {
            Ok(gpu) => devices.push(gpu),
            Err(why) if asked.is_empty() => println!("not on a GPU: {why}"),
            Err(why) => panic!("SMS_TEST_DEVICE=gpu: {why}"),
        }
    }
    devices
}

/// Returns the first GPU, if this build supports GPUs. Each caller gets its own handle, since CUDA orders work by
/// thread.
pub(crate) fn gpu() -> Result<(&'static str, Device), String> {
    let (name, device) = if cfg!(feature = "cuda") {
        ("cuda", Device::new_cuda(0))
    } else if cfg!(feature = "metal") {
        ("metal", Device::new_metal(0))
    } else {
        return Err("built without the features `cuda` and `metal`".into());
    };
    // Only the first line: a backtrace may follow.
    device
        .map(|device| (name, device))
        .map_err(|e| format!("{name} cannot be used: {}", e.to_string().lines().next().unwrap_or_default()))
}

/// Returns the folder of the small fixtures. Cargo sets the package's path when it runs a test; a test program on
/// another machine gets it from the same variable.
pub(crate) fn data(model: &str) -> PathBuf {
    let package = std::env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
    package.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into()).join("tests/data").join(model)
}

/// Returns the folder of the complete reference.
pub(crate) fn reference_folder() -> PathBuf {
    let folder = match std::env::var_os("SMS_TEST_REFERENCE") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference"),
    };
    folder.join("tiny")
}

/// Reference tensors in main memory, and the differences found.
pub(crate) struct Reference {
    pub(crate) tensors: BTreeMap<String, Tensor>,
    gaps: BTreeMap<String, f32>,
    /// Name of the device under test.
    device: &'static str,
}

impl Reference {
    pub(crate) fn open(path: &Path, device: &'static str) -> Self {
        let tensors = candle_core::safetensors::load(path, &Device::Cpu).unwrap().into_iter().collect();
        Self { tensors, gaps: BTreeMap::new(), device }
    }

    pub(crate) fn tensor(&self, name: &str) -> &Tensor {
        self.tensors.get(name).unwrap_or_else(|| panic!("the reference has no {name}"))
    }

    /// Compares `ours` with the tensor of that name, if the reference has one.
    pub(crate) fn compare(&mut self, name: &str, ours: &Tensor) {
        let Some(theirs) = self.tensors.get(name) else { return };
        assert_eq!(ours.elem_count(), theirs.elem_count(), "{name}: {:?} {:?}", ours.dims(), theirs.dims());
        let flat =
            |t: &Tensor| t.to_dtype(DType::F32).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let mut gap = 0f32;
        for (a, b) in flat(ours).into_iter().zip(flat(theirs)) {
            // A NaN counts as a difference.
            gap = if (a - b).abs() <= gap { gap } else { (a - b).abs() };
        }
        self.gaps.insert(name.to_owned(), gap);
    }

    /// Prints the largest difference of each group of tensors and checks that every tensor with one of the
    /// `prefixes` was compared and is within the tolerance, `except` those.
    pub(crate) fn finish(&self, prefixes: &[&str], except: &[&str]) {
        let mut by_kind: BTreeMap<String, f32> = BTreeMap::new();
        let device = self.device;
        for (name, gap) in &self.gaps {
            println!("{gap:9.2e} {device} {name}");
            let kind = name.split('.').next_back().unwrap_or(name);
            let largest = by_kind.entry(kind.to_owned()).or_default();
            *largest = if *gap <= *largest { *largest } else { *gap };
        }
        println!("largest difference by kind on {device}: {by_kind:?}");
        for (name, gap) in &self.gaps {
            assert!(*gap <= TOLERANCE, "{name} on {device}: {gap}");
        }
        let expected = self.tensors.keys().filter(|n| prefixes.iter().any(|p| n.starts_with(p)));
        let missed: Vec<&String> =
            expected.filter(|n| !self.gaps.contains_key(*n) && !except.contains(&n.as_str())).collect();
        assert!(missed.is_empty(), "never compared: {missed:?}");
    }
}

/// Names and shapes of parameters.
pub(crate) type Shapes = BTreeMap<String, Vec<usize>>;

/// Zeros for every name, with a record of the requests.
#[derive(Debug, Default)]
struct Zeros(Mutex<Shapes>);

impl WeightsSource for Zeros {
    fn holds(&self, _name: &str) -> bool {
        true
    }

    fn tensor(&self, name: &str, shape: &[usize], device: &Device) -> Result<Tensor, NetsError> {
        self.0.lock().unwrap().insert(name.to_owned(), shape.to_vec());
        Ok(Tensor::zeros(shape, DType::F32, device)?)
    }
}

/// Returns the parameters that a network requests when it is built.
pub(crate) fn requested<T>(build: impl FnOnce(&Weights) -> Result<T, NetsError>) -> Shapes {
    let zeros = Arc::new(Zeros::default());
    build(&Weights::new(zeros.clone(), &Device::Cpu)).unwrap();
    let shapes = zeros.0.lock().unwrap();
    shapes.clone()
}

#[test]
fn prefixes_join_and_requests_are_kept() {
    let shapes = requested(|weights| weights.at("a").at(3).at("fc").tensor("weight", &[5, 2]));
    assert_eq!(shapes, [("a.3.fc.weight".into(), vec![5, 2])].into_iter().collect());
}

/// Returns names and shapes of a full-size model, as in its repository on the hub.
pub(crate) fn full_size(model: &str) -> Shapes {
    let text = include_str!("../data/released_shapes.tsv");
    let rows = text.lines().filter_map(|line| {
        let [of, name, shape] = line.split('\t').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let shape: Vec<usize> = serde_json::from_str(shape).unwrap();
        (of == model).then(|| (name.to_owned(), shape))
    });
    rows.collect()
}

/// Generates the weights of the reference. Values depend only on a parameter's name, its shape and the seed; `patch`
/// changes them afterwards. Returns a folder with these weights as `model.safetensors`.
pub(crate) fn made_up(shapes: &Shapes, seed: u64, patch: impl Fn(&str, &mut [f64])) -> tempfile::TempDir {
    let mut tensors = HashMap::new();
    for (name, shape) in shapes {
        let mut values = values_of(name, shape, seed);
        patch(name, &mut values);
        let values: Vec<f32> = values.into_iter().map(|v| v as f32).collect();
        tensors.insert(name.clone(), Tensor::from_vec(values, shape.as_slice(), &Device::Cpu).unwrap());
    }
    let folder = tempfile::tempdir().unwrap();
    candle_core::safetensors::save(&tensors, folder.path().join("model.safetensors")).unwrap();
    folder
}

/// Opens the weights in a folder.
pub(crate) fn weights(folder: &Path, device: &Device) -> Weights {
    Weights::open(&folder.join("model.safetensors"), device).unwrap()
}

fn values_of(name: &str, shape: &[usize], seed: u64) -> Vec<f64> {
    let count: usize = shape.iter().product();
    let noise = noise((seed << 32) ^ u64::from(crc32(name.as_bytes())), count);
    let parts: Vec<&str> = name.rsplitn(3, '.').collect();
    let leaf = parts[0];
    let parent = if parts.len() > 1 { parts[1] } else { "" };
    let fan_in = |dims: &[usize]| dims.iter().product::<usize>() as f64;
    let scaled = |s: f64| noise.iter().map(|n| s * n).collect::<Vec<f64>>();
    let affine = |a: f64, s: f64| noise.iter().map(|n| a + s * n).collect::<Vec<f64>>();
    if name == "owlv2.logit_scale" {
        vec![2.6592; count]
    } else if parent.contains("layer_norm") || parent.contains("layernorm") {
        if leaf == "weight" { affine(1.0, 0.2) } else { scaled(0.1) }
    } else if leaf == "scale" {
        affine(0.5, 0.25)
    } else if leaf == "bias" {
        scaled(0.1)
    } else if leaf == "positional_embedding" {
        scaled(3f64.sqrt())
    } else if leaf == "weight" && shape.len() >= 2 && !parent.contains("embed") && !parent.contains("token") {
        let inputs = if parent.contains("upscale_conv") { shape[0] as f64 } else { fan_in(&shape[1..]) };
        let gain = (3.0 / inputs).sqrt();
        let sharper = if parent == "q_proj" || parent == "k_proj" { 1.5 } else { 1.0 };
        noise.iter().map(|n| sharper * (gain * n)).collect()
    } else if parent == "patch_embedding" {
        scaled((3.0 / fan_in(&shape[1..])).sqrt())
    } else {
        scaled(0.5)
    }
}

/// Returns values in −1..1 from the SplitMix64 sequence that starts at `key`.
fn noise(key: u64, count: usize) -> Vec<f64> {
    (1..=count as u64)
        .map(|i| {
            let mut z = key.wrapping_add(i.wrapping_mul(0x9e37_79b9_7f4a_7c15));
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 40) as f64 / f64::from(1u32 << 23) - 1.0
        })
        .collect()
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg()))
    })
}

/// Frame `t` of the reference: a moving disc and a moving square on a textured ground, 150 × 100.
pub(crate) fn frame(t: i64) -> sms_core::ColorImage {
    let mut image = sms_core::ColorImage::filled(150, 100, [0; 3]);
    for (i, pixel) in image.data.iter_mut().enumerate() {
        let (x, y) = (i as i64 % 150, i as i64 / 150);
        *pixel = [60 + x / 2 + 8 * ((x / 10 + y / 10) % 2), 90 + y / 2, 140 - (x + y) / 4].map(|v| v as u8);
        if (x - (40 + 7 * t)).pow(2) + (y - (38 + 2 * t)).pow(2) <= 17 * 17 {
            *pixel = [225, 60, 45];
        }
        let (left, top) = (96 - 5 * t, 56 - 3 * t);
        if (left..left + 30).contains(&x) && (top..top + 26).contains(&y) {
            *pixel = [35, 70, 215];
        }
    }
    image
}
