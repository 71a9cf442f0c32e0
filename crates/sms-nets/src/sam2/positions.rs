//! Position encodings: sines, random Fourier features, rotations.

use crate::kernels::{can_take, values};
use candle_core::{CpuStorage, CustomOp3, Device, Layout, Result, Shape, Tensor};
use candle_nn::rotary_emb::rope_i;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Returns sines and cosines of the row, then of the column, of each cell of a square grid: (side · side,
/// `channels`). Rows and columns count from 1 to `side` and are scaled to 0..2π.
pub(crate) fn sine_2d(side: usize, channels: usize, device: &Device) -> Result<Tensor> {
    let half = channels / 2;
    let wave = |at: usize, i: usize| {
        let angle = (at + 1) as f32 / (side as f32 + 1e-6) * TAU;
        let phase = angle / 10_000f32.powf(2.0 * (i / 2) as f32 / half as f32);
        if i.is_multiple_of(2) { phase.sin() } else { phase.cos() }
    };
    let mut values = Vec::with_capacity(side * side * channels);
    for cell in 0..side * side {
        values.extend((0..half).map(|i| wave(cell / side, i)));
        values.extend((0..half).map(|i| wave(cell % side, i)));
    }
    Tensor::from_vec(values, (side * side, channels), device)
}

/// Returns sines, then cosines, of each of `at`: (n, `channels`).
pub(crate) fn sine_1d(at: &[f32], channels: usize, device: &Device) -> Result<Tensor> {
    let half = channels / 2;
    let phase = |at: f32, i: usize| at / 10_000f32.powf(2.0 * (i / 2) as f32 / half as f32);
    let mut values = Vec::with_capacity(at.len() * channels);
    for &at in at {
        values.extend((0..half).map(|i| phase(at, i).sin()));
        values.extend((0..half).map(|i| phase(at, i).cos()));
    }
    Tensor::from_vec(values, (at.len(), channels), device)
}

/// Returns random Fourier features of points (n, 2), x and y in 0..1, by `frequencies` (2, c / 2): (n, c).
pub(crate) fn fourier(points: &Tensor, frequencies: &Tensor) -> Result<Tensor> {
    let phase = (points.affine(2.0, -1.0)?.matmul(frequencies)? * f64::from(TAU))?;
    Tensor::cat(&[phase.sin()?, phase.cos()?], 1)
}

/// The rotary encoding of a square grid of tokens: pairs of channels are rotated by angles that grow with the
/// column (first half of the pairs) or the row (second half).
#[derive(Debug)]
pub(crate) struct Rotary {
    cos: Tensor,
    sin: Tensor,
}

impl Rotary {
    /// The encoding of `side` · `side` tokens of `channels` channels.
    pub(crate) fn new(side: usize, channels: usize, theta: f32, device: &Device) -> Result<Self> {
        let quarter = channels / 4;
        let angles: Vec<f32> = (0..side * side)
            .flat_map(|cell| {
                (0..2 * quarter).map(move |pair| {
                    let at = if pair < quarter { cell % side } else { cell / side };
                    let power = (4 * (pair % quarter)) as f32 / channels as f32;
                    at as f32 * (1.0 / theta.powf(power))
                })
            })
            .collect();
        let angles = Tensor::from_vec(angles, (side * side, 2 * quarter), device)?;
        Ok(Self { cos: angles.cos()?, sin: angles.sin()? })
    }

    /// Rotates tokens (n, c). If there are more tokens than cells, the grid repeats. The last `unturned` tokens remain
    /// unchanged.
    pub(crate) fn turn(&self, x: &Tensor, unturned: usize) -> Result<Tensor> {
        let (n, c) = x.dims2()?;
        if can_take(x) {
            return x.contiguous()?.apply_op3_no_bwd(&self.cos, &self.sin, &Turn { unturned });
        }
        let (cells, turned) = (self.cos.dim(0)?, n - unturned);
        let grids = x.narrow(0, 0, turned)?.reshape((turned / cells, 1, cells, c))?;
        let grids = rope_i(&grids.contiguous()?, &self.cos, &self.sin)?.reshape((turned, c))?;
        if unturned == 0 {
            return Ok(grids);
        }
        Tensor::cat(&[&grids, &x.narrow(0, turned, unturned)?], 0)
    }
}

/// CPU kernel of the rotation.
struct Turn {
    unturned: usize,
}

impl CustomOp3 for Turn {
    fn name(&self) -> &'static str {
        "rotary"
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
        let (n, c) = l1.shape().dims2()?;
        let cells = l2.dims()[0];
        let (mut out, cos, sin) = (values(s1, l1)?.to_vec(), values(s2, l2)?, values(s3, l3)?);
        let turned = n - self.unturned;
        out[..turned * c].par_chunks_mut(c).enumerate().for_each(|(token, x)| {
            let at = (token % cells) * (c / 2);
            let angles = cos[at..].iter().zip(&sin[at..]);
            for (pair, (cos, sin)) in x.chunks_exact_mut(2).zip(angles) {
                let (a, b) = (pair[0], pair[1]);
                pair[0] = a * cos - b * sin;
                pair[1] = b * cos + a * sin;
            }
        });
        Ok((CpuStorage::F32(out), l1.shape().clone()))
    }
}

/// Resizes `x` (channels, `from`, `from`) bicubically (a = −0.75, corners not aligned) to (`to`, `to`, channels),
/// as PyTorch does.
pub(crate) fn resize_bicubic(
    x: &[f32],
    channels: usize,
    [from_h, from_w]: [usize; 2],
    to: usize,
) -> Vec<f32> {
    let weights = |from: usize| -> Vec<[(usize, f32); 4]> {
        let scale = from as f32 / to as f32;
        (0..to)
            .map(|i| {
                let at = (i as f32 + 0.5) * scale - 0.5;
                let t = at - at.floor();
                let near = |d: f32| ((-0.75 + 2.0) * d - (-0.75 + 3.0)) * d * d + 1.0;
                let far = |d: f32| ((-0.75 * d + 5.0 * 0.75) * d - 8.0 * 0.75) * d + 4.0 * 0.75;
                let tap = |k: i64| (at.floor() as i64 + k).clamp(0, from as i64 - 1) as usize;
                [(tap(-1), far(t + 1.0)), (tap(0), near(t)), (tap(1), near(1.0 - t)), (tap(2), far(2.0 - t))]
            })
            .collect()
    };
    let (rows, columns) = (weights(from_h), weights(from_w));
    let mut out = Vec::with_capacity(to * to * channels);
    for row in &rows {
        for column in &columns {
            for channel in 0..channels {
                let plane = &x[channel * from_h * from_w..];
                let mut sum = 0.0;
                for &(y, wy) in row {
                    sum += wy * column.iter().map(|&(x, wx)| wx * plane[y * from_w + x]).sum::<f32>();
                }
                out.push(sum);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::DType;

    #[test]
    fn a_rotation_keeps_lengths_and_leaves_the_last_tokens() {
        let rotary = Rotary::new(3, 8, 10_000.0, &Device::Cpu).unwrap();
        let x = Tensor::randn(0f32, 1.0, (2 * 9 + 2, 8), &Device::Cpu).unwrap();
        let y = rotary.turn(&x, 2).unwrap();
        let (x, y) = (x.to_vec2::<f32>().unwrap(), y.to_vec2::<f32>().unwrap());
        let norm = |v: &[f32]| v.iter().map(|a| a * a).sum::<f32>();
        for (a, b) in x.iter().zip(&y) {
            assert!((norm(a) - norm(b)).abs() < 1e-5 * norm(a).max(1.0));
        }
        assert_eq!(x[18..], y[18..]);
        // The first cell is not rotated, and the grid repeats.
        assert_eq!((&x[0], &x[9]), (&y[0], &y[9]));
        assert_ne!(x[1], y[1]);
    }

    /// The code path for GPUs, in double precision, which the CPU kernel does not accept.
    #[test]
    fn without_our_kernel_the_rotation_is_the_same() {
        let rotary = Rotary::new(3, 8, 10_000.0, &Device::Cpu).unwrap();
        let double = |x: &Tensor| x.to_dtype(DType::F64).unwrap();
        let exact = Rotary { cos: double(&rotary.cos), sin: double(&rotary.sin) };
        let x = Tensor::randn(0f32, 1.0, (2 * 9 + 2, 16), &Device::Cpu).unwrap();
        // Channels of the second of two heads, first as memories without pointers, then with pointers.
        let x = x.narrow(1, 8, 8).unwrap();
        for (n, unturned) in [(20, 2), (18, 0)] {
            let x = x.narrow(0, 0, n).unwrap();
            let ours = double(&rotary.turn(&x, unturned).unwrap());
            let gap = (ours - exact.turn(&double(&x), unturned).unwrap()).unwrap().abs().unwrap();
            assert!(gap.max_all().unwrap().to_scalar::<f64>().unwrap() < 1e-6);
        }
    }

    #[test]
    fn bicubic_resizing_keeps_a_constant_and_reproduces_the_grid() {
        let flat = resize_bicubic(&[2.5; 2 * 9], 2, [3, 3], 7);
        assert!(flat.iter().all(|v| (v - 2.5).abs() < 1e-5));
        let x: Vec<f32> = (0..16).map(|i| (i * i) as f32).collect();
        assert_eq!(resize_bicubic(&x, 1, [4, 4], 4), x);
    }
}
