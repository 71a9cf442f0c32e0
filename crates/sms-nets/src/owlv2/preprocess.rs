//! Preprocessing of images for OWLv2.

use candle_core::{Device, Result, Tensor};
use rayon::prelude::*;
use sms_core::ColorImage;

/// CLIP's mean colour, red, green, blue, of values in 0..1.
const MEAN: [f64; 3] = [0.48145466, 0.4578275, 0.40821073];
/// CLIP's standard deviations.
const DEVIATION: [f64; 3] = [0.26862954, 0.26130258, 0.27577711];

/// Returns the image padded with black at the bottom and right to a square, blurred before reduction, resized
/// bilinearly to `side` pixels and normalized: (1, 3, `side`, `side`).
///
/// This follows the official OWLv2 code and scikit-image's `resize`. The blur is a Gaussian with σ = (factor − 1) / 2
/// pixels, truncated at 4σ. Borders are mirrored at the centres of the outermost pixels, and the result is clipped to
/// the input's range. Older versions of the transformers library padded with grey.
///
/// # Errors
/// If the device has too little memory.
pub fn pixel_values(image: &ColorImage, side: usize, device: &Device) -> Result<Tensor> {
    let size = image.width.max(image.height).max(1);
    let factor = size as f64 / side as f64;
    let blur = gaussian((factor - 1.0) / 2.0);
    let planes: Vec<Vec<f32>> = (0..3)
        .into_par_iter()
        .map(|channel| {
            let mut plane = vec![0f64; size * size];
            for (to, from) in plane.chunks_mut(size).zip(image.data.chunks(image.width.max(1))) {
                for (to, from) in to.iter_mut().zip(from) {
                    *to = f64::from(from[channel]) / 255.0;
                }
            }
            let low = plane.iter().copied().fold(f64::INFINITY, f64::min);
            let high = plane.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            // Each pass transposes the square, so that two restore it.
            let once = transposed_pass(&plane, size, size, side, &blur);
            let twice = transposed_pass(&once, size, side, side, &blur);
            let normal = |v: f64| ((v.clamp(low, high) - MEAN[channel]) / DEVIATION[channel]) as f32;
            twice.into_iter().map(normal).collect()
        })
        .collect();
    Tensor::from_vec(planes.concat(), (1, 3, side, side), device)
}

/// Returns the weights of a Gaussian blur from the middle outwards; `[1]` for none.
fn gaussian(sigma: f64) -> Vec<f64> {
    if sigma <= 0.0 {
        return vec![1.0];
    }
    let radius = (4.0 * sigma + 0.5) as usize;
    let half: Vec<f64> = (0..=radius).map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp()).collect();
    let total = half[0] + 2.0 * half[1..].iter().sum::<f64>();
    half.into_iter().map(|w| w / total).collect()
}

/// Blurs and resizes the rows of `plane` (`rows` rows of `width`) to `side` values each and transposes: `side` rows
/// of `rows`.
fn transposed_pass(plane: &[f64], width: usize, rows: usize, side: usize, blur: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; side * rows];
    let mut smooth = vec![0.0; width];
    let factor = width as f64 / side as f64;
    for (row, values) in plane.chunks(width).enumerate() {
        let mirrored = |i: i64| values[mirror(i, width)];
        for (x, smooth) in smooth.iter_mut().enumerate() {
            let x = x as i64;
            *smooth = (1..blur.len() as i64).fold(blur[0] * mirrored(x), |sum, d| {
                sum + blur[d as usize] * (mirrored(x - d) + mirrored(x + d))
            });
        }
        for i in 0..side {
            let at = (i as f64 + 0.5) * factor - 0.5;
            let first = at.floor();
            let (a, b) = (mirror(first as i64, width), mirror(first as i64 + 1, width));
            let t = at - first;
            out[i * rows + row] = smooth[a] * (1.0 - t) + smooth[b] * t;
        }
    }
    out
}

/// Mirrors index `i` at the first and last sample into 0..`n`.
fn mirror(i: i64, n: usize) -> usize {
    let last = n as i64 - 1;
    if last <= 0 {
        return 0;
    }
    let folded = i.rem_euclid(2 * last);
    (if folded > last { 2 * last - folded } else { folded }) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_are_mirrored_without_repeating_the_edge() {
        let at: Vec<usize> = (-3..8).map(|i| mirror(i, 4)).collect();
        assert_eq!(at, [3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1]);
        assert_eq!(mirror(5, 1), 0);
    }

    #[test]
    fn an_even_image_stays_even_at_any_size_and_the_padding_is_black() {
        for side in [20, 40, 90] {
            let image = ColorImage::filled(40, 20, [255, 128, 0]);
            let pixels = pixel_values(&image, side, &Device::Cpu).unwrap();
            let red = pixels.get(0).unwrap().get(0).unwrap().to_vec2::<f32>().unwrap();
            let value = |v: f64| ((v - MEAN[0]) / DEVIATION[0]) as f32;
            assert!((red[side / 5][side / 2] - value(1.0)).abs() < 1e-4, "{side}");
            assert!((red[side - 1][side / 2] - value(0.0)).abs() < 1e-4, "{side}");
        }
    }
}
