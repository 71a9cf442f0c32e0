//! Comparing with the reference tensors.
//!
//! The whole reference lies beside the repository (environment variable `SMS_TEST_REFERENCE`, `../shared/reference` by
//! default); the tests that need it are skipped where it is absent. A small part of it is in `tests/data`, and the weights
//! that belong to it are made up again from their names, so that the networks are compared anywhere.
//!
//! Every comparison is made on the CPU and, in builds with the feature `cuda` or `metal`, on the GPU that is there.
//! `SMS_TEST_DEVICE=cpu|gpu` chooses one of them; with `gpu` it is a failure that there is none.
#![allow(dead_code, reason = "each test binary uses a part")]

use candle_core::{DType, Device, Tensor};
use sms_nets::{SafetensorsFile, Shapes, Weights};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// The largest difference allowed between a tensor of ours and the reference's.
pub(crate) const TOLERANCE: f32 = 1e-4;

/// What to compute on, by name.
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
            Err(why) if asked.is_empty() => println!("skipped on a GPU: {why}"),
            Err(why) => panic!("SMS_TEST_DEVICE=gpu: {why}"),
        }
    }
    devices
}

/// The first GPU, where this build knows of GPUs. Each caller gets a handle of its own, since CUDA orders work by thread.
pub(crate) fn gpu() -> Result<(&'static str, Device), String> {
    let (name, device) = if cfg!(feature = "cuda") {
        ("cuda", Device::new_cuda(0))
    } else if cfg!(feature = "metal") {
        ("metal", Device::new_metal(0))
    } else {
        return Err("built without the features `cuda` and `metal`".into());
    };
    // The first line: a backtrace may follow.
    device
        .map(|device| (name, device))
        .map_err(|e| format!("{name} cannot be used: {}", e.to_string().lines().next().unwrap_or_default()))
}

/// The folder of the small fixtures. Cargo tells where the package lies when it runs a test; a test program that was
/// carried elsewhere is told by the same variable.
pub(crate) fn data(model: &str) -> PathBuf {
    let package = std::env::var_os("CARGO_MANIFEST_DIR").map(PathBuf::from);
    package.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into()).join("tests/data").join(model)
}

/// The folder of the whole reference, if it is here.
pub(crate) fn reference_folder() -> Option<PathBuf> {
    let folder = match std::env::var_os("SMS_TEST_REFERENCE") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/reference"),
    };
    let tiny = folder.join("tiny");
    if !tiny.is_dir() {
        println!("skipped: no reference tensors in {} (SMS_TEST_REFERENCE)", folder.display());
        return None;
    }
    Some(tiny)
}

/// Reference tensors, which lie in main memory, and what was compared with them.
pub(crate) struct Reference {
    pub(crate) tensors: BTreeMap<String, Tensor>,
    gaps: BTreeMap<String, f32>,
    /// What computes the tensors compared.
    device: &'static str,
}

impl Reference {
    pub(crate) fn open(path: &Path, device: &'static str) -> Self {
        let tensors = SafetensorsFile::open(path).unwrap().all(&Device::Cpu).unwrap();
        Self { tensors, gaps: BTreeMap::new(), device }
    }

    pub(crate) fn tensor(&self, name: &str) -> &Tensor {
        self.tensors.get(name).unwrap_or_else(|| panic!("the reference has no {name}"))
    }

    /// Compares `ours` with the tensor of that name, if the reference has one.
    pub(crate) fn see(&mut self, name: &str, ours: &Tensor) {
        let Some(theirs) = self.tensors.get(name) else { return };
        assert_eq!(ours.elem_count(), theirs.elem_count(), "{name}: {:?} {:?}", ours.dims(), theirs.dims());
        let flat =
            |t: &Tensor| t.to_dtype(DType::F32).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        let mut gap = 0f32;
        for (a, b) in flat(ours).into_iter().zip(flat(theirs)) {
            // A NaN is a difference.
            gap = if (a - b).abs() <= gap { gap } else { (a - b).abs() };
        }
        self.gaps.insert(name.to_owned(), gap);
    }

    /// Prints the largest difference of each seam and checks that every tensor whose name starts with one of
    /// `prefixes` was compared and is within the tolerance, `except` those.
    pub(crate) fn finish(&self, prefixes: &[&str], except: &[&str]) {
        let mut by_seam: BTreeMap<String, f32> = BTreeMap::new();
        let device = self.device;
        for (name, gap) in &self.gaps {
            println!("{gap:9.2e} {device} {name}");
            let seam = name.split('.').next_back().unwrap_or(name);
            let largest = by_seam.entry(seam.to_owned()).or_default();
            *largest = if *gap <= *largest { *largest } else { *gap };
        }
        println!("largest difference of each seam on {device}: {by_seam:?}");
        for (name, gap) in &self.gaps {
            assert!(*gap <= TOLERANCE, "{name} on {device}: {gap}");
        }
        let expected = self.tensors.keys().filter(|n| prefixes.iter().any(|p| n.starts_with(p)));
        let missed: Vec<&String> =
            expected.filter(|n| !self.gaps.contains_key(*n) && !except.contains(&n.as_str())).collect();
        assert!(missed.is_empty(), "never compared: {missed:?}");
    }
}

/// Names and shapes of a full-size model, as its repository on the hub has them.
pub(crate) fn full_size(model: &str) -> Shapes {
    let text = include_str!("../data/released_shapes.tsv");
    let rows = text.lines().filter_map(|line| {
        let [of, name, shape] = line.split('\t').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let shape: Vec<usize> = serde_json::from_str(shape).unwrap();
        (of == model).then(|| (name.to_owned(), shape))
    });
    rows.collect()
}

/// The reference's weights made up again: values depend on a parameter's name, its shape and the seed alone.
/// `patch` changes them afterwards. A folder with them as `model.safetensors`.
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

/// The weights in a folder.
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

/// Values in −1..1 from the SplitMix64 sequence that starts at `key`.
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
