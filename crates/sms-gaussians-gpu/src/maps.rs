//! Rendered maps from what the device returns.

use rayon::prelude::*;
use sms_gaussians::RenderedMaps;

/// Nine values per pixel, row by row, as the kernel `maps` leaves them.
pub(crate) fn maps_of(values: &[f32], width: usize) -> RenderedMaps {
    let pixels = values.len() / 9;
    let mut maps = RenderedMaps {
        width,
        height: pixels / width,
        color: vec![[0.0; 3]; pixels],
        alpha: vec![0.0; pixels],
        depth: vec![0.0; pixels],
        normal_w: vec![[0.0; 3]; pixels],
        label: vec![0; pixels],
    };
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
