//! Brightness images at several sizes.

use sms_core::{ColorImage, Image};

/// A brightness image, 8-bit levels.
pub(crate) type Luma = Image<f32>;

/// Computes the brightness (Rec. 601 weights of the stored sRGB values), smoothed by [1 2 1] / 4 both ways against noise
/// and aliasing.
pub(crate) fn luma(color: &ColorImage) -> Luma {
    smooth(&color.map(|&[r, g, b]| 0.299 * f32::from(r) + 0.587 * f32::from(g) + 0.114 * f32::from(b)))
}

/// Smooths by [1 2 1] / 4 both ways.
pub(crate) fn smooth(image: &Luma) -> Luma {
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

/// Returns the value at image-plane coordinates (u, v) with its exact derivatives with respect to u and v, by a quadratic
/// B-spline over 3 × 3 pixels; `None` within a pixel of the border and beyond.
///
/// A B-spline of this degree blurs by the same variance (¼ pixel²) at every sub-pixel position, and its derivatives are
/// continuous. Bilinear interpolation blurs by 0 at pixel centres and by ¼ between them: images then match best at
/// wrong shifts of some tenths of a pixel.
pub(crate) fn sample(image: &Luma, u: f64, v: f64) -> Option<(f64, f64, f64)> {
    let (x, y) = (u - 0.5, v - 0.5);
    if !(x >= 0.5 && y >= 0.5 && x < image.width as f64 - 1.5 && y < image.height as f64 - 1.5) {
        return None;
    }
    let (i, j) = ((x + 0.5) as usize, (y + 0.5) as usize);
    let ((wx, dx), (wy, dy)) = (spline(x - i as f64), spline(y - j as f64));
    let (mut value, mut by_u, mut by_v) = (0.0, 0.0, 0.0);
    for row in 0..3 {
        let at = (j + row - 1) * image.width + i - 1;
        let p: [f64; 3] = std::array::from_fn(|k| f64::from(image.data[at + k]));
        let along = wx[0] * p[0] + wx[1] * p[1] + wx[2] * p[2];
        value += wy[row] * along;
        by_u += wy[row] * (dx[0] * p[0] + dx[1] * p[1] + dx[2] * p[2]);
        by_v += dy[row] * along;
    }
    Some((value, by_u, by_v))
}

/// Returns the weights of three pixels and their derivatives at `t` from the middle one, −½ to ½.
fn spline(t: f64) -> ([f64; 3], [f64; 3]) {
    let (a, b) = (0.5 - t, 0.5 + t);
    ([0.5 * a * a, 0.75 - t * t, 0.5 * b * b], [-a, -2.0 * t, b])
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
    fn the_blur_does_not_depend_on_the_sub_pixel_position() {
        // The variance of the weights of a row, for every position between two pixels.
        for k in 0..=10 {
            let t = f64::from(k) / 10.0 - 0.5;
            let (w, _) = spline(t);
            let mean = w[2] - w[0];
            assert!((w.iter().sum::<f64>() - 1.0).abs() < 1e-12 && (mean - t).abs() < 1e-12);
            assert!((w[0] + w[2] - mean * mean - 0.25).abs() < 1e-12);
        }
    }

    #[test]
    fn smoothing_keeps_flat_images() {
        let gray = Image::filled(5, 4, [100u8, 100, 100]);
        assert!(luma(&gray).data.iter().all(|v| (v - 100.0).abs() < 1e-4));
    }

    proptest! {
        #[test]
        fn derivatives_are_those_of_the_interpolation(u in 1.1..5.9f64, v in 1.1..3.9f64) {
            let image = Image::from_vec(7, 5, (0..35).map(|i| ((i * 37) % 101) as f32).collect());
            // Within a cell the interpolation is quadratic, so that central differences are exact.
            let inside = |x: f64| x.fract() > 1e-3 && x.fract() < 1.0 - 1e-3;
            prop_assume!(inside(u) && inside(v));
            let (_, du, dv) = sample(&image, u, v).unwrap();
            let f = |u, v| sample(&image, u, v).unwrap().0;
            let e = 1e-4;
            prop_assert!((du - (f(u + e, v) - f(u - e, v)) / (2.0 * e)).abs() < 1e-6 * du.abs().max(1.0));
            prop_assert!((dv - (f(u, v + e) - f(u, v - e)) / (2.0 * e)).abs() < 1e-6 * dv.abs().max(1.0));
        }
    }
}
