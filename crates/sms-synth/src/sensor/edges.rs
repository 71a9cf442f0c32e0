//! Pixels at the edges of surfaces: where they are, and what a pixel measures that sees both.

use super::depth_camera::DepthView;
use rayon::prelude::*;
use sms_core::{DepthImage, Image};

/// Depths that differ by more than this share belong to different surfaces.
pub(super) const RELATIVE_JUMP: f64 = 0.02;

/// Marks pixels within `band` of a depth discontinuity. Inverse depth is linear over the image of a plane, so its second
/// difference distinguishes an edge from a slanted surface at any resolution.
pub(super) fn edge_band(depth: &DepthImage, band: usize) -> Vec<bool> {
    let (width, height) = depth.size();
    let inverse = |x: usize, y: usize| {
        let z = depth.data[y * width + x];
        if z > 0.0 { 1.0 / z } else { 0.0 }
    };
    let jumps = |a: f32, b: f32, c: f32| (a - 2.0 * b + c).abs() > RELATIVE_JUMP as f32 * b.max(1e-3);
    let mut edge = vec![false; width * height];
    edge.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for x in 0..width {
            let b = inverse(x, y);
            row[x] = (x > 0 && x + 1 < width && jumps(inverse(x - 1, y), b, inverse(x + 1, y)))
                || (y > 0 && y + 1 < height && jumps(inverse(x, y - 1), b, inverse(x, y + 1)));
        }
    });
    if band <= 1 {
        return edge;
    }
    let reach = band - 1;
    let mut wide = vec![false; width * height];
    wide.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for x in 0..width {
            row[x] = (y.saturating_sub(reach)..=(y + reach).min(height - 1))
                .any(|v| (x.saturating_sub(reach)..=(x + reach).min(width - 1)).any(|u| edge[v * width + u]));
        }
    });
    wide
}

/// Returns a depth from the other side of the nearest edge along the row.
pub(super) fn across_edge(depth: &DepthImage, x: usize, y: usize, band: usize) -> Option<f32> {
    let z = depth[(x, y)];
    (1..=band + 1).find_map(|d| {
        [x.checked_sub(d), Some(x + d)].into_iter().flatten().filter(|&u| u < depth.width).find_map(|u| {
            let other = depth[(u, y)];
            (other > 0.0 && (other - z).abs() > RELATIVE_JUMP as f32 * z).then_some(other)
        })
    })
}

/// Returns the depth that a time-of-flight camera measures whose pixels see a spot of radius `radius_px`: at edges, the mean
/// over the spot, weighted by the returned light. Phases of both surfaces add as vectors, which is this mean as long as the
/// depths differ by much less than the wavelength of the modulation. Elsewhere depth is unchanged.
pub(super) fn mixed(view: &DepthView<'_>, radius_px: f64) -> DepthImage {
    let depth = view.depth;
    let (width, height) = depth.size();
    let reach = radius_px.ceil().max(1.0) as usize;
    let edges = edge_band(depth, reach);
    let falloff = 2.0 * (0.5 * radius_px).max(0.3).powi(2);
    let mut out = Image::filled(width, height, 0.0f32);
    out.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let own = depth.data[y * width + x];
            *pixel = own;
            if own <= 0.0 || !edges[y * width + x] {
                continue;
            }
            let (mut sum, mut weights) = (0.0f64, 0.0f64);
            for v in y.saturating_sub(reach)..=(y + reach).min(height - 1) {
                for u in x.saturating_sub(reach)..=(x + reach).min(width - 1) {
                    let at = v * width + u;
                    let z = f64::from(depth.data[at]);
                    if z > 0.0 {
                        let distance = u.abs_diff(x).pow(2) + v.abs_diff(y).pow(2);
                        let light = f64::from(view.echo.data[at] * view.cos_incidence.data[at]) / (z * z);
                        let weight = light.max(1e-6) * (-(distance as f64) / falloff).exp();
                        sum += weight * z;
                        weights += weight;
                    }
                }
            }
            *pixel = (sum / weights) as f32;
        }
    });
    out
}
