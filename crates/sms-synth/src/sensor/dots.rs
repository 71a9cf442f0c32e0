//! Dense depth from few measured dots, as phones with a lidar give it.

use super::depth_camera::DepthView;
use super::depth_grid::sampled;
use rayon::prelude::*;
use sms_core::{ColorImage, DepthImage, Image};

/// Colour difference, 8-bit levels over all channels, at which a dot counts e^(−1/2) as much.
const COLOR_SIGMA: f64 = 30.0;
/// Spatial falloff of a dot's weight, spacings of dots.
const FALLOFF: f64 = 0.6;

/// Returns depth that is interpolated from about `count` dots on a regular grid, weighted by distance and by colour (joint
/// bilateral upsampling, Kopf et al. 2007). Apple's own method is not published; this one has its visible properties: depth is
/// smooth, its edges follow those of the colour, and things smaller than the spacing of the dots may be lost.
pub(super) fn from_dots(measured: &DepthImage, view: &DepthView<'_>, count: usize) -> DepthImage {
    let (width, height) = measured.size();
    let columns = ((count as f64 * width as f64 / height as f64).sqrt().round() as usize).clamp(1, width);
    let rows = ((count as f64 / columns as f64).round() as usize).clamp(1, height);
    let (spacing_x, spacing_y) = (width as f64 / columns as f64, height as f64 / rows as f64);
    let guide: Option<ColorImage> = view.guide.map(|color| sampled(color, (width, height)));
    let place = |i: usize, spacing: f64| ((i as f64 + 0.5) * spacing) as usize;
    let mut out = Image::filled(width, height, 0.0f32);
    out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let (near_i, near_j) = ((x as f64 / spacing_x) as i64, (y as f64 / spacing_y) as i64);
            // Inverse depth, which is linear over the image of a plane.
            let (mut sum, mut weights) = (0.0, 0.0);
            for (i, j) in (-2..=2).flat_map(|dj| (-2..=2).map(move |di| (near_i + di, near_j + dj))) {
                if i < 0 || j < 0 || i >= columns as i64 || j >= rows as i64 {
                    continue;
                }
                let (u, v) = (place(i as usize, spacing_x), place(j as usize, spacing_y));
                let z = f64::from(measured[(u, v)]);
                if z <= 0.0 {
                    continue;
                }
                let apart =
                    ((u as f64 - x as f64) / spacing_x).powi(2) + ((v as f64 - y as f64) / spacing_y).powi(2);
                let differs = guide.as_ref().map_or(0.0, |g| squared_difference(g[(x, y)], g[(u, v)]));
                let weight = (-0.5 * (apart / FALLOFF.powi(2) + differs / COLOR_SIGMA.powi(2))).exp();
                sum += weight / z;
                weights += weight;
            }
            // Far from every dot of a similar colour the nearest still count a little.
            if weights > 1e-30 {
                *pixel = (weights / sum) as f32;
            }
        }
    });
    out
}

fn squared_difference(a: [u8; 3], b: [u8; 3]) -> f64 {
    (0..3).map(|c| f64::from(a[c].abs_diff(b[c])).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Intrinsics;

    #[test]
    fn dots_give_a_plane_and_miss_what_lies_between_them() {
        let k = Intrinsics::from_fov(256, 192, 1.17);
        let white = Image::filled(256, 192, 1.0f32);
        let mut depth = Image::filled(256, 192, 1.0f32);
        let dense = |depth: &DepthImage, guide: Option<&ColorImage>| {
            let view = DepthView { depth, cos_incidence: &white, echo: &white, intrinsics: &k, guide };
            from_dots(depth, &view, 576)
        };
        assert!(dense(&depth, None).data.iter().all(|z| (z - 1.0).abs() < 1e-6));
        // A thing of 4 pixels between dots that are 9 pixels apart.
        (0..192).for_each(|y| (100..104).for_each(|x| depth[(x, y)] = 0.6));
        let hit = (0..192).any(|y| dense(&depth, None)[(102, y)] < 0.99);
        assert!(!hit, "no dot falls on the columns 100 to 103");
        // A wide step: without colour it is smooth, with colour it is as sharp as the colour.
        let depth: DepthImage = Image::from_vec(
            256,
            192,
            (0..256 * 192).map(|i| if i % 256 < 128 { 0.7 } else { 1.0 }).collect(),
        );
        let color: ColorImage = Image::from_vec(
            256,
            192,
            (0..256 * 192).map(|i| if i % 256 < 128 { [200; 3] } else { [40; 3] }).collect(),
        );
        let (blind, guided) = (dense(&depth, None), dense(&depth, Some(&color)));
        assert!(blind[(128, 90)] < 0.95 && blind[(127, 90)] > 0.75, "{}", blind[(128, 90)]);
        assert!((guided[(128, 90)] - 1.0).abs() < 1e-3 && (guided[(127, 90)] - 0.7).abs() < 1e-3);
    }
}
