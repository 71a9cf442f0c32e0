//! Operations shared by both networks.

use crate::kernels::{Activation, BiasActivation, Depthwise, ScaledSoftmax, can_take};
use candle_core::{D, Result, Tensor};
use candle_nn::ops;

/// Observer of intermediate tensors by name, for the parity tests. Tensors that are needed only by an observer are
/// computed only if there is one.
#[derive(Default)]
pub struct TensorObserver<'a> {
    look: Option<Box<dyn FnMut(&str, &Tensor) + 'a>>,
    /// Prefix of every name.
    pub prefix: String,
}

impl std::fmt::Debug for TensorObserver<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TensorObserver").field("looks", &self.look.is_some()).finish_non_exhaustive()
    }
}

impl<'a> TensorObserver<'a> {
    /// No observer.
    pub fn none() -> Self {
        Self::default()
    }

    /// Calls `look` with each tensor.
    pub fn new(look: impl FnMut(&str, &Tensor) + 'a) -> Self {
        Self { look: Some(Box::new(look)), prefix: String::new() }
    }

    pub(crate) fn show(&mut self, name: &str, tensor: impl FnOnce() -> Result<Tensor>) -> Result<()> {
        if let Some(look) = &mut self.look {
            look(&format!("{}{name}", self.prefix), &tensor()?);
        }
        Ok(())
    }
}

/// Queries per block of the attention. The scores of a block, 128 × 4096 floats, fit in a core's cache. On two cores
/// this is twice as fast as computing all scores at once.
const QUERY_BLOCK: usize = 128;
/// Largest number of scores (queries · keys) for which whole windows use one batched product.
const SMALL_ATTENTION: usize = 256 * 256;

/// A fully connected layer over the last dimension.
#[derive(Debug, Clone)]
pub(crate) struct Linear {
    /// (outputs, inputs).
    weight: Tensor,
    bias: Option<Tensor>,
}

impl Linear {
    pub(crate) fn new(weight: Tensor, bias: Option<Tensor>) -> Self {
        Self { weight, bias }
    }

    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.then(x, Activation::Identity)
    }

    /// Applies the layer and an activation.
    pub(crate) fn then(&self, x: &Tensor, activation: Activation) -> Result<Tensor> {
        let (outputs, inputs) = self.weight.dims2()?;
        let mut shape = x.dims().to_vec();
        shape.pop();
        shape.push(outputs);
        let y = x.reshape(((), inputs))?.matmul(&self.weight.t()?)?;
        // `y` is a fresh tensor, so it may be changed in place.
        let y = match &self.bias {
            Some(bias) if can_take(&y) => {
                y.inplace_op2(bias, &BiasActivation(activation))?;
                y
            }
            Some(bias) => activated(y.broadcast_add(bias)?, activation)?,
            None => activated(y, activation)?,
        };
        y.reshape(shape)
    }
}

/// Applies an activation to a fresh tensor, which it may overwrite.
pub(crate) fn activated(x: Tensor, activation: Activation) -> Result<Tensor> {
    if can_take(&x) && x.is_contiguous() {
        x.inplace_op1(&activation)?;
        return Ok(x);
    }
    match activation {
        Activation::Identity => Ok(x),
        Activation::Gelu => x.gelu_erf(),
        Activation::QuickGelu => &x * ops::sigmoid(&(&x * 1.702)?)?,
        Activation::Relu => x.relu(),
    }
}

/// Returns the softmax of `scale · scores` over the last dimension; `scores` must be fresh, contiguous and accepted
/// by the CPU kernels, and is overwritten.
fn softmax(scores: Tensor, scale: f64) -> Result<Tensor> {
    scores.inplace_op1(&ScaledSoftmax { scale: scale as f32 })?;
    Ok(scores)
}

/// Returns `softmax(q kᵀ · scale) v` for each of `heads` equal parts of the channels: `q` (b, n, c), `k` (b, m, c),
/// `v` (b, m, e) give (b, n, e).
pub(crate) fn attention(q: &Tensor, k: &Tensor, v: &Tensor, heads: usize, scale: f64) -> Result<Tensor> {
    let (b, n, c) = q.dims3()?;
    let (_, m, e) = v.dims3()?;
    if n * m <= SMALL_ATTENTION || !can_take(q) {
        let split = |x: &Tensor, n: usize, c: usize| {
            x.reshape((b, n, heads, c / heads))?.transpose(1, 2)?.contiguous()
        };
        let (q, k, v) = (split(q, n, c)?, split(k, m, c)?, split(v, m, e)?);
        let shares = if can_take(&q) {
            softmax(q.matmul(&k.transpose(2, 3)?)?, scale)?
        } else {
            // Scaling the queries, which have fewer values than the scores, saves a pass.
            ops::softmax_last_dim(&(q * scale)?.matmul(&k.transpose(2, 3)?)?)?
        };
        return shares.matmul(&v)?.transpose(1, 2)?.reshape((b, n, e));
    }
    let mut images = Vec::with_capacity(b);
    for i in 0..b {
        let (q, k, v) = (q.get(i)?, k.get(i)?, v.get(i)?);
        let mut parts = Vec::with_capacity(heads);
        for head in 0..heads {
            let part = |x: &Tensor, c: usize| x.narrow(1, head * (c / heads), c / heads)?.contiguous();
            let (q, k, v) = (part(&q, c)?, part(&k, c)?.t()?, part(&v, e)?);
            let mut blocks = Vec::with_capacity(n.div_ceil(QUERY_BLOCK));
            for start in (0..n).step_by(QUERY_BLOCK) {
                let block = q.narrow(0, start, QUERY_BLOCK.min(n - start))?;
                blocks.push(softmax(block.matmul(&k)?, scale)?.matmul(&v)?);
            }
            parts.push(Tensor::cat(&blocks, 0)?);
        }
        images.push(Tensor::cat(&parts, 1)?);
    }
    Tensor::stack(&images, 0)
}

/// Like [`attention`], with `mask` (b, n, m) added to the scores; for short sequences.
pub(crate) fn masked_attention(
    q: &Tensor,
    k: &Tensor,
    v: &Tensor,
    heads: usize,
    scale: f64,
    mask: &Tensor,
) -> Result<Tensor> {
    let (b, n, c) = q.dims3()?;
    let split = |x: &Tensor| x.reshape((b, (), heads, c / heads))?.transpose(1, 2)?.contiguous();
    let (q, k, v) = (split(q)?, split(k)?, split(v)?);
    let scores = (q.matmul(&k.transpose(2, 3)?)? * scale)?.broadcast_add(&mask.unsqueeze(1)?)?;
    ops::softmax_last_dim(&scores)?.matmul(&v)?.transpose(1, 2)?.reshape((b, n, c))
}

/// Depthwise convolution over channels-last maps `x` (n, h, w, c); `taps` (kernel · kernel, c), `bias` (c).
pub(crate) fn depthwise(x: &Tensor, taps: &Tensor, bias: &Tensor, kernel: usize) -> Result<Tensor> {
    if can_take(x) {
        return x.contiguous()?.apply_op3_no_bwd(taps, bias, &Depthwise { kernel });
    }
    // candle convolves each of 256 groups separately. A sum over the 49 taps needs only 49 passes over all channels.
    let (_, h, w, _) = x.dims4()?;
    let pad = kernel / 2;
    let padded = x.pad_with_zeros(1, pad, pad)?.pad_with_zeros(2, pad, pad)?;
    let mut sum = bias.broadcast_as(x.shape())?;
    for (at, tap) in (0..kernel * kernel).map(|i| (i, taps.get(i))) {
        let seen = padded.narrow(1, at / kernel, h)?.narrow(2, at % kernel, w)?;
        sum = (sum + seen.broadcast_mul(&tap?)?)?;
    }
    Ok(sum)
}

/// Applies several fully connected layers with `activation` between them.
pub(crate) fn mlp(x: &Tensor, layers: &[Linear], activation: Activation) -> Result<Tensor> {
    let mut x = x.clone();
    for (i, layer) in layers.iter().enumerate() {
        let is_last = i + 1 == layers.len();
        x = layer.then(&x, if is_last { Activation::Identity } else { activation })?;
    }
    Ok(x)
}

/// Normalizes the last dimension to length 1; `eps` is added to its norm.
pub(crate) fn normalized(x: &Tensor, eps: f64) -> Result<Tensor> {
    x.broadcast_div(&(x.sqr()?.sum_keepdim(D::Minus1)?.sqrt()? + eps)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device};

    #[test]
    fn attention_by_blocks_equals_attention_at_once() {
        let at = |n, c| Tensor::randn(0f32, 1.0, (2, n, c), &Device::Cpu).unwrap();
        // 300 · 257 scores exceed the limit, and neither number is a multiple of the block.
        let (q, k, v) = (at(300, 12), at(257, 12), at(257, 6));
        let blocked = attention(&q, &k, &v, 3, 0.7).unwrap();
        let split = |x: &Tensor| {
            let (b, n, c) = x.dims3().unwrap();
            x.reshape((b, n, 3, c / 3)).unwrap().transpose(1, 2).unwrap().contiguous().unwrap()
        };
        let scores = (split(&q).matmul(&split(&k).transpose(2, 3).unwrap()).unwrap() * 0.7).unwrap();
        let plain = ops::softmax_last_dim(&scores).unwrap().matmul(&split(&v)).unwrap();
        let plain = plain.transpose(1, 2).unwrap().reshape((2, 300, 6)).unwrap();
        let gap = (blocked - plain).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f32>().unwrap();
        assert!(gap < 1e-5, "{gap}");
    }

    /// candle's own operations, which GPUs use, run here on the CPU in double precision, which the CPU kernels do not
    /// accept.
    #[test]
    fn without_our_kernels_the_same_comes_out() {
        let at = |shape: &[usize]| Tensor::randn(0f32, 1.0, shape, &Device::Cpu).unwrap();
        let double = |x: &Tensor| x.to_dtype(DType::F64).unwrap();
        let gap = |ours: &Tensor, plain: &Tensor| {
            let gap = (double(ours) - plain).unwrap().abs().unwrap();
            gap.max_all().unwrap().to_scalar::<f64>().unwrap()
        };
        let (x, taps, bias) = (at(&[2, 6, 9, 5]), at(&[49, 5]), at(&[5]));
        let ours = depthwise(&x, &taps, &bias, 7).unwrap();
        let plain = depthwise(&double(&x), &double(&taps), &double(&bias), 7).unwrap();
        assert!(gap(&ours, &plain) < 1e-5);
        let (q, k, v) = (at(&[2, 300, 12]), at(&[2, 257, 12]), at(&[2, 257, 6]));
        let ours = attention(&q, &k, &v, 3, 0.7).unwrap();
        let plain = attention(&double(&q), &double(&k), &double(&v), 3, 0.7).unwrap();
        assert!(gap(&ours, &plain) < 1e-5);
        let layer = Linear::new(at(&[7, 12]), Some(at(&[7])));
        let exact = Linear::new(double(&layer.weight), layer.bias.as_ref().map(double));
        for activation in [Activation::Identity, Activation::Gelu, Activation::QuickGelu, Activation::Relu] {
            let plain = exact.then(&double(&q), activation).unwrap();
            assert!(gap(&layer.then(&q, activation).unwrap(), &plain) < 1e-5, "{activation:?}");
        }
    }
}
