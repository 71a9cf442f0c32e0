//! Preprocessing of images for SAM 2.

use candle_core::{Device, Result, Tensor};
use rayon::prelude::*;
use sms_core::ColorImage;

/// ImageNet's mean colour, red, green, blue, of values in 0..1.
const MEAN: [f32; 3] = [0.485, 0.456, 0.406];
/// ImageNet's standard deviations.
const DEVIATION: [f32; 3] = [0.229, 0.224, 0.225];

/// Returns the image resized to `side` × `side` pixels, without preserving its aspect ratio, and normalized: (1, 3,
/// `side`, `side`).
///
/// Resizing is bilinear with antialiasing (a triangle filter as wide as the reduction factor), on bytes: rows first,
/// rounded to bytes, then columns, with weights of 15 bits. The result is bitwise equal to that of Pillow and PyTorch.
///
/// # Errors
/// If the device has too little memory.
pub fn pixel_values(image: &ColorImage, side: usize, device: &Device) -> Result<Tensor> {
    let planes: Vec<Vec<f32>> = (0..3)
        .into_par_iter()
        .map(|channel| {
            let plane: Vec<u8> = image.data.iter().map(|p| p[channel]).collect();
            let once = transposed_pass(&plane, image.width, side);
            let twice = transposed_pass(&once, image.height, side);
            let normal = |v: u8| (f32::from(v) / 255.0 - MEAN[channel]) / DEVIATION[channel];
            twice.into_iter().map(normal).collect()
        })
        .collect();
    Tensor::from_vec(planes.concat(), (1, 3, side, side), device)
}

/// Resizes rows of `width` to `side` values and transposes.
fn transposed_pass(plane: &[u8], width: usize, side: usize) -> Vec<u8> {
    let scale = width as f64 / side as f64;
    let support = scale.max(1.0);
    let taps: Vec<(usize, Vec<f64>)> = (0..side)
        .map(|i| {
            let center = (i as f64 + 0.5) * scale;
            let first = ((center - support + 0.5) as usize).min(width.saturating_sub(1));
            let last = ((center + support + 0.5) as usize).clamp(first + 1, width);
            let weight = |x: usize| (1.0 - ((x as f64 + 0.5 - center) / support).abs()).max(0.0);
            let weights: Vec<f64> = (first..last).map(weight).collect();
            let total: f64 = weights.iter().sum();
            (first, weights.into_iter().map(|w| w / total).collect())
        })
        .collect();
    // The number of binary digits that keeps the largest weight below 2¹⁵.
    let largest = taps.iter().flat_map(|(_, w)| w).copied().fold(0.0, f64::max);
    let digits = (0..22).take_while(|d| largest * f64::from(1 << (d + 1)) + 0.5 < f64::from(1 << 15)).count();
    let fixed = |w: &f64| (w * f64::from(1 << digits) + 0.5) as i32;
    let taps: Vec<(usize, Vec<i32>)> =
        taps.iter().map(|(first, weights)| (*first, weights.iter().map(fixed).collect())).collect();
    let rows = plane.len() / width.max(1);
    let mut out = vec![0; side * rows];
    for (row, values) in plane.chunks(width.max(1)).enumerate() {
        for (i, (first, weights)) in taps.iter().enumerate() {
            let half = (1 << digits) >> 1;
            let sum = weights.iter().zip(&values[*first..]).fold(half, |sum, (w, &v)| sum + w * i32::from(v));
            out[i * rows + row] = (sum >> digits).clamp(0, 255) as u8;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_takes_means_with_a_triangle_and_keeps_constants() {
        assert_eq!(transposed_pass(&[7; 12], 6, 3), vec![7; 6]);
        // Weights 1/8, 3/8, 3/8, 1/8 away from the border.
        let once = transposed_pass(&[0, 0, 0, 80, 0, 0, 0, 0], 8, 4);
        assert_eq!(once, [0, 30, 10, 0]);
    }

    #[test]
    fn the_aspect_ratio_is_not_kept() {
        let image = ColorImage::filled(30, 10, [0, 255, 128]);
        let pixels = pixel_values(&image, 16, &Device::Cpu).unwrap();
        assert_eq!(pixels.dims(), [1, 3, 16, 16]);
        let green = pixels.get(0).unwrap().get(1).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert!(green.iter().all(|v| (v - (1.0 - 0.456) / 0.224).abs() < 1e-5));
    }
}
