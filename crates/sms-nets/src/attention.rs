//! Attention with its projections, as both networks store it.

use crate::ops::{Linear, attention, masked_attention};
use crate::weights::{Loaded, Weights};
use candle_core::{D, Result, Tensor};

/// An attention layer with its projections.
#[derive(Debug)]
pub(crate) struct Attention {
    query: Linear,
    key: Linear,
    value: Linear,
    output: Linear,
    pub(crate) heads: usize,
}

impl Attention {
    /// Reads the layer: queries of `size` and keys of `keys` channels are projected to `inner` channels, and these back
    /// to `size` by the layer named `output`.
    pub(crate) fn new(
        at: &Weights,
        [size, keys, inner]: [usize; 3],
        heads: usize,
        output: &str,
    ) -> Loaded<Self> {
        Ok(Self {
            query: at.linear("q_proj", size, inner)?,
            key: at.linear("k_proj", keys, inner)?,
            value: at.linear("v_proj", keys, inner)?,
            output: at.linear(output, inner, size)?,
            heads: heads.max(1),
        })
    }

    /// Returns the projected queries (…, size), keys and values (…, keys).
    pub(crate) fn projected(&self, q: &Tensor, k: &Tensor, v: &Tensor) -> Result<(Tensor, Tensor, Tensor)> {
        Ok((self.query.forward(q)?, self.key.forward(k)?, self.value.forward(v)?))
    }

    /// Attends with projected `q` (b, n, inner), `k` and `v` (b, m, inner); `mask` (b, n, m) is added to the scores.
    pub(crate) fn attend(&self, q: &Tensor, k: &Tensor, v: &Tensor, mask: Option<&Tensor>) -> Result<Tensor> {
        let scale = ((q.dim(D::Minus1)? / self.heads) as f64).powf(-0.5);
        let attended = match mask {
            Some(mask) => masked_attention(q, k, v, self.heads, scale, mask)?,
            None => attention(q, k, v, self.heads, scale)?,
        };
        self.output.forward(&attended)
    }

    /// `q` (b, n, size), `k` and `v` (b, m, keys) give (b, n, size).
    pub(crate) fn forward(&self, q: &Tensor, k: &Tensor, v: &Tensor) -> Result<Tensor> {
        let (q, k, v) = self.projected(q, k, v)?;
        self.attend(&q, &k, &v, None)
    }
}
