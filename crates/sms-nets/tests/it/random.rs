//! Pseudo-random weights, for tests and for the example `speed`.

use candle_core::{Device, Tensor};
use sms_nets::{NetsError, Weights, WeightsSource};
use std::sync::Arc;

#[derive(Debug)]
struct Random(u64);

impl WeightsSource for Random {
    fn holds(&self, _name: &str) -> bool {
        true
    }

    fn tensor(&self, name: &str, shape: &[usize], device: &Device) -> Result<Tensor, NetsError> {
        Ok(Tensor::from_vec(random_values(name, shape, self.0), shape, device)?)
    }
}

/// Returns pseudo-random values for every name, with a variance of one over the number of inputs, so that activations
/// stay in the normal range. The same seed gives the same values.
pub(crate) fn random_weights(seed: u64, device: &Device) -> Weights {
    Weights::new(Arc::new(Random(seed)), device)
}

/// Returns uniform values of variance one over the number of inputs, from the SplitMix64 sequence seeded by the
/// name.
fn random_values(name: &str, shape: &[usize], seed: u64) -> Vec<f32> {
    let start = name.bytes().fold(seed ^ 0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    let inputs: usize = shape.iter().skip(1).product();
    let scale = (3.0 / inputs.max(1) as f32).sqrt();
    let count: usize = shape.iter().product();
    let is_gain = name.contains("norm") && name.ends_with("weight");
    (1..=count as u64)
        .map(|i| {
            let mut z = start.wrapping_add(i.wrapping_mul(0x9e37_79b9_7f4a_7c15));
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            let uniform = ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 23) as f32 - 1.0;
            if is_gain {
                1.0 + 0.1 * uniform
            } else if shape.len() > 1 {
                scale * uniform
            } else {
                0.1 * uniform
            }
        })
        .collect()
}

#[test]
fn random_weights_depend_on_name_and_seed_and_have_unit_gain() {
    let of = |name, seed| random_values(name, &[64, 256], seed);
    let a = of("a.weight", 1);
    assert_eq!(a, of("a.weight", 1));
    assert_ne!(a, of("b.weight", 1));
    assert_ne!(a, of("a.weight", 2));
    let variance = a.iter().map(|v| v * v).sum::<f32>() / a.len() as f32;
    assert!((variance * 256.0 - 1.0).abs() < 0.05, "{variance}");
}
