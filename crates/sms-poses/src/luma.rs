//! Brightness images at several sizes.

use sms_core::{ColorImage, Image};

/// A brightness image, 8-bit levels.
pub(crate) type Luma = Image<f32>;

/// Computes the brightness (Rec. 601 weights of the stored sRGB values), smoothed by [1 2 1] / 4 both ways. Without
/// smoothing, the sharpness of a bilinearly interpolated image would depend on the sub-pixel position, which attracts
/// matches to pixel centres.
pub(crate) fn luma(color: &ColorImage) -> Luma {
    smooth(&color.map(|&[r, g, b]| 0.299 * f32::from(r) + 0.587 * f32::from(g) + 0.114 * f32::from(b)))
}

fn smooth(image: &Luma) -> Luma {
    let (w, h) = image.size();
    let mut rows = image.clone();
    for y in 0..h {
        for x in 0..w {
            let (l, r) = (image[(x.saturating_sub(1), y)], image[((x + 1).min(w - 1), y)]);
            rows[(x, y)] = 0.25 * (l + r) + 0.5 * image[(x, y)];
        }
    }
    let mut out = rows.clone();
    for y in 0..h {
        for x in 0..w {
            let (u, d) = (rows[(x, y.saturating_sub(1))], rows[(x, (y + 1).min(h - 1))]);
            out[(x, y)] = 0.25 * (u + d) + 0.5 * rows[(x, y)];
        }
    }
    out
}

/// Halves the size by means of 2 × 2 blocks, so that image-plane coordinates halve exactly.
pub(crate) fn half(image: &Luma) -> Luma {
    let (w, h) = (image.width / 2, image.height / 2);
    let mut out = Image::filled(w, h, 0.0);
    for y in 0..h {
        for x in 0..w {
            let (x2, y2) = (2 * x, 2 * y);
            out[(x, y)] = 0.25
                * (image[(x2, y2)] + image[(x2 + 1, y2)] + image[(x2, y2 + 1)] + image[(x2 + 1, y2 + 1)]);
        }
    }
    out
}

/// Returns the bilinear value at image-plane coordinates (u, v) with its exact derivatives with respect to u and v;
/// `None` within half a pixel of the border and beyond.
pub(crate) fn sample(image: &Luma, u: f64, v: f64) -> Option<(f64, f64, f64)> {
    let (x, y) = (u - 0.5, v - 0.5);
    if !(x >= 0.0 && y >= 0.0 && x < (image.width - 1) as f64 && y < (image.height - 1) as f64) {
        return None;
    }
    let (i, j) = (x as usize, y as usize);
    let (a, b) = (x - i as f64, y - j as f64);
    let at = j * image.width + i;
    let (p00, p10) = (f64::from(image.data[at]), f64::from(image.data[at + 1]));
    let (p01, p11) = (f64::from(image.data[at + image.width]), f64::from(image.data[at + image.width + 1]));
    let (top, bottom) = (p00 + a * (p10 - p00), p01 + a * (p11 - p01));
    Some((top + b * (bottom - top), (1.0 - b) * (p10 - p00) + b * (p11 - p01), bottom - top))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn halving_keeps_a_slope_and_its_place() {
        let mut image = Image::filled(16, 12, 0.0f32);
        for y in 0..12 {
            for x in 0..16 {
                image[(x, y)] = 3.0 * (x as f32 + 0.5) - 2.0 * (y as f32 + 0.5);
            }
        }
        let small = half(&image);
        let (value, du, dv) = sample(&small, 3.3, 2.9).unwrap();
        assert!((value - (3.0 * 6.6 - 2.0 * 5.8)).abs() < 1e-5, "{value}");
        assert!((du - 6.0).abs() < 1e-5 && (dv + 4.0).abs() < 1e-5);
    }

    #[test]
    fn smoothing_keeps_flat_images() {
        let gray = Image::filled(5, 4, [100u8, 100, 100]);
        assert!(luma(&gray).data.iter().all(|v| (v - 100.0).abs() < 1e-4));
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_the_interpolation(u in 0.6..6.4f64, v in 0.6..4.4f64) {
            let image = Image::from_vec(7, 5, (0..35).map(|i| ((i * 37) % 101) as f32).collect());
            // Within a cell the interpolation is bilinear, so that central differences are exact.
            let inside = |x: f64| (x - 0.5).fract() > 1e-3 && (x - 0.5).fract() < 1.0 - 1e-3;
            prop_assume!(inside(u) && inside(v));
            let (_, du, dv) = sample(&image, u, v).unwrap();
            let f = |u, v| sample(&image, u, v).unwrap().0;
            let e = 1e-4;
            prop_assert!((du - (f(u + e, v) - f(u - e, v)) / (2.0 * e)).abs() < 1e-6 * du.abs().max(1.0));
            prop_assert!((dv - (f(u, v + e) - f(u, v - e)) / (2.0 * e)).abs() < 1e-6 * dv.abs().max(1.0));
        }
    }
}
