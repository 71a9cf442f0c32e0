//! Conversion of the device's output to rendered maps.

use rayon::prelude::*;
use sms_gaussians::RenderedMaps;

/// Converts nine values per pixel, row by row, as written by the kernel `maps`. The memory of `maps` is reused,
/// since fresh memory costs more than filling it.
pub(crate) fn maps_of(values: &[f32], width: usize, mut maps: RenderedMaps) -> RenderedMaps {
    maps.resize(width, values.len() / 9 / width);
    let scalars = maps.alpha.par_iter_mut().zip(&mut maps.depth).zip(&mut maps.label);
    let vectors = maps.color.par_iter_mut().zip(&mut maps.normal_w);
    values.par_chunks_exact(9).zip(scalars).zip(vectors).with_min_len(4096).for_each(
        |((pixel, ((alpha, depth), label)), (color, normal_w))| {
            *color = [pixel[0], pixel[1], pixel[2]];
            *alpha = pixel[3];
            *depth = pixel[4];
            *normal_w = [pixel[5], pixel[6], pixel[7]];
            *label = pixel[8] as u16;
        },
    );
    maps
}
