//! CPU kernels for operations that are slow in candle.
//!
//! Measured on two cores at the full sizes: candle computes the error function in double precision on one thread, the
//! exponential of a softmax one value at a time, and a depthwise convolution as one matrix product per channel. The
//! tests contain a plain version of each kernel.

use candle_core::{CpuStorage, CustomOp3, Error, InplaceOp1, InplaceOp2, Layout, Result, Shape, Tensor};
use pulp::Arch;
use rayon::prelude::*;

/// Values per task: enough to outweigh the overhead of scheduling.
const CHUNK: usize = 1 << 14;

/// Returns `exp(x)` to a relative 2e-7, or 0 below −87; written so that loops over it vectorize.
#[inline(always)]
fn exp(x: f32) -> f32 {
    // Adding and subtracting 1.5·2²³ rounds to the nearest integer.
    const ROUND: f32 = 12_582_912.0;
    let clamped = x.clamp(-87.0, 88.0);
    let n = clamped * std::f32::consts::LOG2_E + ROUND - ROUND;
    // ln 2 in two parts, to preserve the digits of r.
    let r = clamped - n * 0.693_359_4 + n * 2.121_944_4e-4;
    let p = 1.987_569_1e-4;
    let p = p * r + 1.398_199_9e-3;
    let p = p * r + 8.333_452e-3;
    let p = p * r + 4.166_579_6e-2;
    let p = p * r + 1.666_666_5e-1;
    let p = p * r + 0.5;
    let p = p * r * r + r + 1.0;
    let power = f32::from_bits((((n as i32) + 127) << 23) as u32);
    if x < -87.0 { 0.0 } else { p * power }
}

/// Returns `x · Φ(x)`, by approximation 7.1.26 of the error function in Abramowitz and Stegun (absolute error
/// 1.5e-7).
#[inline(always)]
fn gelu(x: f32) -> f32 {
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let poly = ((((1.061_405_4 * t - 1.453_152) * t + 1.421_413_7) * t - 0.284_496_74) * t + 0.254_829_6) * t;
    let erf = 1.0 - poly * exp(-z * z);
    0.5 * x * (1.0 + if x < 0.0 { -erf } else { erf })
}

/// Returns `x · σ(1.702 x)`.
#[inline(always)]
fn quick_gelu(x: f32) -> f32 {
    x / (1.0 + exp(-1.702 * x))
}

/// Returns the values of a contiguous tensor of 32-bit floats.
pub(crate) fn values<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let (start, end) = layout
        .contiguous_offsets()
        .ok_or_else(|| Error::Msg("a CPU kernel requires a contiguous tensor".into()))?;
    Ok(&storage.as_slice::<f32>()?[start..end])
}

/// Returns the values of a contiguous tensor of 32-bit floats, mutably.
fn values_mut<'a>(storage: &'a mut CpuStorage, layout: &Layout) -> Result<&'a mut [f32]> {
    let (start, end) = layout
        .contiguous_offsets()
        .ok_or_else(|| Error::Msg("a CPU kernel requires a contiguous tensor".into()))?;
    match storage {
        CpuStorage::F32(all) => Ok(&mut all[start..end]),
        _ => Err(Error::Msg("a CPU kernel requires 32-bit floats".into())),
    }
}

/// Activation after a fully connected layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Activation {
    /// Nothing.
    Identity,
    /// `x · Φ(x)`.
    Gelu,
    /// CLIP's GELU, `x · σ(1.702 x)`.
    QuickGelu,
    /// `max(x, 0)`.
    Relu,
}

/// An activation in place.
impl InplaceOp1 for Activation {
    fn name(&self) -> &'static str {
        "activation"
    }

    fn cpu_fwd(&self, storage: &mut CpuStorage, layout: &Layout) -> Result<()> {
        let x = values_mut(storage, layout)?;
        x.par_chunks_mut(CHUNK).for_each(|x| Arch::new().dispatch(|| activate(*self, x)));
        Ok(())
    }
}

#[inline(always)]
fn activate(activation: Activation, x: &mut [f32]) {
    match activation {
        Activation::Identity => {}
        Activation::Gelu => x.iter_mut().for_each(|x| *x = gelu(*x)),
        Activation::QuickGelu => x.iter_mut().for_each(|x| *x = quick_gelu(*x)),
        Activation::Relu => x.iter_mut().for_each(|x| *x = x.max(0.0)),
    }
}

/// Adds a bias over the last dimension in place and applies an activation: one pass over a matrix product's output.
pub(crate) struct BiasActivation(pub(crate) Activation);

impl InplaceOp2 for BiasActivation {
    fn name(&self) -> &'static str {
        "bias-and-activation"
    }

    fn cpu_fwd(&self, s1: &mut CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<()> {
        let bias = values(s2, l2)?;
        let x = values_mut(s1, l1)?;
        let row = bias.len().max(1);
        x.par_chunks_mut((CHUNK / row).max(1) * row).for_each(|rows| {
            Arch::new().dispatch(|| {
                for row in rows.chunks_exact_mut(row) {
                    for (x, bias) in row.iter_mut().zip(bias) {
                        *x += bias;
                    }
                    activate(self.0, row);
                }
            });
        });
        Ok(())
    }
}

/// Softmax of `scale · x` over the last dimension, in place.
pub(crate) struct ScaledSoftmax {
    pub(crate) scale: f32,
}

impl InplaceOp1 for ScaledSoftmax {
    fn name(&self) -> &'static str {
        "scaled-softmax"
    }

    fn cpu_fwd(&self, storage: &mut CpuStorage, layout: &Layout) -> Result<()> {
        let row = layout.dims().last().copied().unwrap_or(1).max(1);
        let x = values_mut(storage, layout)?;
        x.par_chunks_mut((CHUNK / row).max(1) * row).for_each(|rows| {
            Arch::new().dispatch(|| {
                for row in rows.chunks_exact_mut(row) {
                    softmax(row, self.scale);
                }
            });
        });
        Ok(())
    }
}

/// Number of lanes of sums and maxima. The order of additions affects the result, so it must not depend on the machine.
const LANES: usize = 32;

#[inline(always)]
fn softmax(row: &mut [f32], scale: f32) {
    let mut lanes = [f32::NEG_INFINITY; LANES];
    let mut chunks = row.chunks_exact(LANES);
    for chunk in &mut chunks {
        for (lane, &x) in lanes.iter_mut().zip(chunk) {
            *lane = if x > *lane { x } else { *lane };
        }
    }
    let largest = chunks.remainder().iter().chain(&lanes).fold(f32::NEG_INFINITY, |a, &b| a.max(b));
    let mut sums = [0f32; LANES];
    let mut chunks = row.chunks_exact_mut(LANES);
    for chunk in &mut chunks {
        for (sum, x) in sums.iter_mut().zip(chunk) {
            *x = exp(scale * (*x - largest));
            *sum += *x;
        }
    }
    let mut total = 0.0;
    for x in chunks.into_remainder() {
        *x = exp(scale * (*x - largest));
        total += *x;
    }
    total += sums.iter().sum::<f32>();
    let inverse = 1.0 / total;
    for x in row {
        *x *= inverse;
    }
}

/// Depthwise convolution of odd kernel, stride 1 and full padding over channels-last maps: input (n, height, width,
/// channels), weight (kernel · kernel, channels), bias (channels).
pub(crate) struct Depthwise {
    pub(crate) kernel: usize,
}

impl CustomOp3 for Depthwise {
    fn name(&self) -> &'static str {
        "depthwise"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let (_, height, width, channels) = l1.shape().dims4()?;
        let (x, weight, bias) = (values(s1, l1)?, values(s2, l2)?, values(s3, l3)?);
        let (kernel, pad) = (self.kernel, self.kernel / 2);
        let mut out = vec![0f32; x.len()];
        out.par_chunks_mut(width * channels).enumerate().for_each(|(row, out)| {
            let (image, y) = (row / height, row % height);
            Arch::new().dispatch(|| {
                for (px, out) in out.chunks_exact_mut(channels).enumerate() {
                    out.copy_from_slice(bias);
                    for ky in 0..kernel {
                        let Some(sy) = (y + ky).checked_sub(pad).filter(|&sy| sy < height) else { continue };
                        for kx in 0..kernel {
                            let Some(sx) = (px + kx).checked_sub(pad).filter(|&sx| sx < width) else {
                                continue;
                            };
                            let from = ((image * height + sy) * width + sx) * channels;
                            let weight = &weight[(ky * kernel + kx) * channels..][..channels];
                            for ((out, x), w) in out.iter_mut().zip(&x[from..from + channels]).zip(weight) {
                                *out += x * w;
                            }
                        }
                    }
                }
            });
        });
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }
}

/// Resizes `x` bilinearly, corners not aligned, as PyTorch does without antialiasing: rows of `width` to rows of
/// `out_width`.
pub(crate) fn resize_bilinear(
    x: &[f32],
    (width, height): (usize, usize),
    (out_width, out_height): (usize, usize),
) -> Vec<f32> {
    let columns = taps(width, out_width);
    let rows = taps(height, out_height);
    let mut out = vec![0f32; out_width * out_height];
    out.par_chunks_mut(out_width.max(1)).zip(rows.par_iter()).for_each(|(out, &(y0, y1, fy))| {
        let (upper, lower) = (&x[y0 * width..][..width], &x[y1 * width..][..width]);
        for (out, &(x0, x1, fx)) in out.iter_mut().zip(&columns) {
            let top = upper[x0] * (1.0 - fx) + upper[x1] * fx;
            let bottom = lower[x0] * (1.0 - fx) + lower[x1] * fx;
            *out = top * (1.0 - fy) + bottom * fy;
        }
    });
    out
}

/// For each of `to` samples, returns the two neighbours among `from` samples and the distance from the first.
fn taps(from: usize, to: usize) -> Vec<(usize, usize, f32)> {
    let scale = from as f32 / to as f32;
    (0..to)
        .map(|i| {
            let at = ((i as f32 + 0.5) * scale - 0.5).max(0.0);
            let first = (at as usize).min(from - 1);
            (first, (first + 1).min(from - 1), at - first as f32)
        })
        .collect()
}

/// Whether the kernels of this module accept a tensor: 32-bit floats in main memory.
pub(crate) fn can_take(x: &Tensor) -> bool {
    x.device().is_cpu() && x.dtype() == candle_core::DType::F32
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{D, Device};

    #[test]
    fn the_exponential_is_good_to_rounding() {
        for i in -8600..8700 {
            let x = i as f32 * 0.01;
            let exact = f64::from(x).exp();
            assert!((f64::from(exp(x)) / exact - 1.0).abs() < 3e-7, "{x}");
        }
        assert_eq!(exp(-1e30), 0.0);
        assert_eq!(exp(f32::NEG_INFINITY), 0.0);
    }

    #[test]
    fn activations_equal_candles() {
        let x = Tensor::arange(-9f32, 9.0, &Device::Cpu).unwrap().affine(1.0, 0.013).unwrap();
        let x = Tensor::cat(&[&x, &(&x * 0.1).unwrap(), &(&x * 0.01).unwrap()], 0).unwrap();
        let gap = |a: Tensor, b: Tensor| {
            (a - b).unwrap().abs().unwrap().max(0).unwrap().to_scalar::<f32>().unwrap()
        };
        let of = |activation: Activation| {
            let y = x.copy().unwrap();
            y.inplace_op1(&activation).unwrap();
            y
        };
        assert!(gap(of(Activation::Gelu), x.gelu_erf().unwrap()) < 2e-6);
        assert_eq!(gap(of(Activation::Relu), x.relu().unwrap()), 0.0);
        let quick = (&x * candle_nn::ops::sigmoid(&(&x * 1.702).unwrap()).unwrap()).unwrap();
        assert!(gap(of(Activation::QuickGelu), quick) < 2e-6);
    }

    #[test]
    fn the_softmax_equals_candles() {
        for columns in [1, 7, 8, 203] {
            let x = Tensor::randn(0f32, 3.0, (5, columns), &Device::Cpu).unwrap();
            let expected = candle_nn::ops::softmax(&(&x * 0.3).unwrap(), D::Minus1).unwrap();
            x.inplace_op1(&ScaledSoftmax { scale: 0.3 }).unwrap();
            let gap = (x - expected).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f32>().unwrap();
            assert!(gap < 1e-6, "{columns}: {gap}");
        }
    }

    #[test]
    fn the_depthwise_convolution_equals_candles() {
        let (n, c, h, w) = (2, 5, 6, 9);
        let x = Tensor::randn(0f32, 1.0, (n, c, h, w), &Device::Cpu).unwrap();
        let weight = Tensor::randn(0f32, 1.0, (c, 1, 7, 7), &Device::Cpu).unwrap();
        let bias = Tensor::randn(0f32, 1.0, c, &Device::Cpu).unwrap();
        let expected = x
            .conv2d(&weight, 3, 1, 1, c)
            .unwrap()
            .broadcast_add(&bias.reshape((1, c, 1, 1)).unwrap())
            .unwrap();
        let last = x.permute((0, 2, 3, 1)).unwrap().contiguous().unwrap();
        let taps = weight.reshape((c, 49)).unwrap().t().unwrap().contiguous().unwrap();
        let ours = last.apply_op3_no_bwd(&taps, &bias, &Depthwise { kernel: 7 }).unwrap();
        let ours = ours.permute((0, 3, 1, 2)).unwrap();
        let gap = (ours - expected).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f32>().unwrap();
        assert!(gap < 1e-5, "{gap}");
    }

    #[test]
    fn resizing_keeps_planes_and_doubles_a_step() {
        let (w, h) = (6, 4);
        let plane: Vec<f32> = (0..w * h).map(|i| 2.0 * (i % w) as f32 - (i / w) as f32).collect();
        let large = resize_bilinear(&plane, (w, h), (18, 12));
        // Away from the border, a plane is preserved: sample (x, y) lies at ((x + 0.5) / 3 − 0.5, …).
        for (x, y) in [(5, 4), (9, 7)] {
            let at = |v: usize| (v as f32 + 0.5) / 3.0 - 0.5;
            assert!((large[y * 18 + x] - (2.0 * at(x) - at(y))).abs() < 1e-5);
        }
        assert_eq!(resize_bilinear(&[0.0, 1.0], (2, 1), (4, 1)), [0.0, 0.25, 0.75, 1.0]);
    }
}
