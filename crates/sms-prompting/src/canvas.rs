//! Marks on a picture: discs, lines and numbers, with smooth edges.

use glamx::DVec2;
use sms_core::ColorImage;

/// Digits, 5 × 7, one row per number, the leftmost pixel in bit 4.
const DIGITS: [[u8; 7]; 10] = [
    [0x0e, 0x11, 0x13, 0x15, 0x19, 0x11, 0x0e],
    [0x04, 0x0c, 0x04, 0x04, 0x04, 0x04, 0x0e],
    [0x0e, 0x11, 0x01, 0x06, 0x08, 0x10, 0x1f],
    [0x1f, 0x02, 0x04, 0x02, 0x01, 0x11, 0x0e],
    [0x02, 0x06, 0x0a, 0x12, 0x1f, 0x02, 0x02],
    [0x1f, 0x10, 0x1e, 0x01, 0x01, 0x11, 0x0e],
    [0x06, 0x08, 0x10, 0x1e, 0x11, 0x11, 0x0e],
    [0x1f, 0x01, 0x02, 0x04, 0x08, 0x08, 0x08],
    [0x0e, 0x11, 0x11, 0x0e, 0x11, 0x11, 0x0e],
    [0x0e, 0x11, 0x11, 0x0f, 0x01, 0x02, 0x0c],
];
/// Columns from one digit to the next.
const ADVANCE: usize = 6;

/// A picture to draw on, in coordinates of the image plane: pixel (i, j) has its centre at (i + 0.5, j + 0.5).
pub(crate) struct Canvas {
    pub(crate) image: ColorImage,
}

impl Canvas {
    /// Mixes `color` into the pixels with non-zero `coverage` (a function of the centre's position, 0 to 1) within
    /// a box.
    fn paint(&mut self, low: DVec2, high: DVec2, color: [u8; 3], coverage: impl Fn(DVec2) -> f64) {
        let size = DVec2::new(self.image.width as f64, self.image.height as f64);
        let (low, high) = (low.floor().max(DVec2::ZERO), high.ceil().min(size));
        for y in low.y as usize..high.y.max(0.0) as usize {
            for x in low.x as usize..high.x.max(0.0) as usize {
                let a = coverage(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)).clamp(0.0, 1.0);
                let pixel = &mut self.image[(x, y)];
                for (p, c) in pixel.iter_mut().zip(color) {
                    *p = (f64::from(*p) * (1.0 - a) + f64::from(c) * a).round() as u8;
                }
            }
        }
    }

    /// Draws a filled disc.
    pub(crate) fn disc(&mut self, center: DVec2, radius: f64, color: [u8; 3]) {
        let reach = DVec2::splat(radius + 1.0);
        self.paint(center - reach, center + reach, color, |p| {
            (radius + 0.5 - p.distance(center)).clamp(0.0, 1.0)
        });
    }

    /// Draws a filled convex polygon of either orientation.
    pub(crate) fn polygon(&mut self, corners: &[DVec2], color: [u8; 3], opacity: f64) {
        let area: f64 =
            (0..corners.len()).map(|i| corners[i].perp_dot(corners[(i + 1) % corners.len()])).sum();
        let (low, high) = corners.iter().fold((DVec2::MAX, DVec2::MIN), |(l, h), &p| (l.min(p), h.max(p)));
        if corners.len() < 3 {
            return;
        }
        self.paint(low - 1.0, high + 1.0, color, |p| {
            let inside = (0..corners.len()).map(|i| {
                let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                let edge = b - a;
                area.signum() * edge.perp_dot(p - a) / edge.length().max(1e-9)
            });
            opacity * (inside.fold(f64::INFINITY, f64::min) + 0.5).clamp(0.0, 1.0)
        });
    }

    /// Draws a line through points; `None` interrupts it.
    pub(crate) fn line(&mut self, points: &[Option<DVec2>], width: f64, color: [u8; 3]) {
        for pair in points.windows(2) {
            let [Some(a), Some(b)] = *pair else { continue };
            // Points far outside are invisible, and long pieces are slow.
            let size = DVec2::new(self.image.width as f64, self.image.height as f64);
            if a.max(b).min_element() < -width || (a.min(b) - size).max_element() > width {
                continue;
            }
            let half = 0.5 * width;
            let reach = DVec2::splat(half + 1.0);
            let along = b - a;
            self.paint(a.min(b) - reach, a.max(b) + reach, color, |p| {
                let t = ((p - a).dot(along) / along.length_squared().max(1e-12)).clamp(0.0, 1.0);
                (half + 0.5 - p.distance(a + t * along)).clamp(0.0, 1.0)
            });
        }
    }

    /// Draws a white number centred at a point, its digits `height` pixels high, with a coloured outline.
    pub(crate) fn number(&mut self, number: u32, center: DVec2, height: f64, outline: [u8; 3]) {
        let scale = (height / 7.0).round().max(1.0);
        let digits: Vec<usize> = number.to_string().bytes().map(|b| usize::from(b - b'0')).collect();
        let width = scale * (digits.len() * ADVANCE - 1) as f64;
        let corner = (center - 0.5 * DVec2::new(width, 7.0 * scale)).round();
        for (grow, color) in [(0.5 * scale.max(2.0), outline), (0.0, [255; 3])] {
            for (k, digit) in digits.iter().enumerate() {
                for (row, bits) in DIGITS[*digit].iter().enumerate() {
                    for column in (0..5).filter(|c| bits >> (4 - c) & 1 == 1) {
                        let low =
                            corner + scale * DVec2::new((k * ADVANCE + column) as f64, row as f64) - grow;
                        let high = low + scale + 2.0 * grow;
                        self.paint(low, high, color, |p| {
                            f64::from(u8::from(p.cmpge(low).all() && p.cmple(high).all()))
                        });
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn canvas() -> Canvas {
        Canvas { image: ColorImage::filled(60, 40, [0; 3]) }
    }

    fn area(canvas: &Canvas) -> f64 {
        canvas.image.data.iter().map(|p| f64::from(p[0]) / 255.0).sum()
    }

    #[test]
    fn shapes_have_their_areas_and_places() {
        let mut c = canvas();
        c.disc(DVec2::new(20.3, 17.8), 9.0, [255; 3]);
        assert!((area(&c) / (std::f64::consts::PI * 81.0) - 1.0).abs() < 0.01, "{}", area(&c));
        let mut c = canvas();
        let square = [[10.0, 10.0], [30.0, 10.0], [30.0, 25.0], [10.0, 25.0]].map(DVec2::from_array);
        c.polygon(&square, [255; 3], 1.0);
        assert!((area(&c) - 300.0).abs() < 1.0, "{}", area(&c));
        let reversed: Vec<DVec2> = square.iter().rev().copied().collect();
        let mut d = canvas();
        d.polygon(&reversed, [255; 3], 1.0);
        assert_eq!(c.image, d.image);
        let mut c = canvas();
        c.line(
            &[Some(DVec2::new(10.0, 20.0)), Some(DVec2::new(40.0, 20.0)), None, Some(DVec2::ZERO)],
            4.0,
            [255; 3],
        );
        assert!((area(&c) - (120.0 + std::f64::consts::PI * 4.0)).abs() < 2.0, "{}", area(&c));
    }

    #[test]
    fn numbers_are_told_apart_and_drawing_beyond_the_picture_is_cut() {
        let drawn: Vec<ColorImage> = (0..=15)
            .map(|n| {
                let mut c = canvas();
                c.number(n, DVec2::new(30.0, 20.0), 14.0, [0, 0, 255]);
                c.image
            })
            .collect();
        for (i, a) in drawn.iter().enumerate() {
            assert!(drawn[..i].iter().all(|b| a != b), "{i}");
        }
        let mut c = canvas();
        c.number(8, DVec2::new(0.0, 40.0), 14.0, [0, 0, 255]);
        c.disc(DVec2::new(-100.0, 500.0), 30.0, [255; 3]);
        c.line(&[Some(DVec2::new(-1e9, 3.0)), Some(DVec2::new(-1e3, 3.0))], 3.0, [255; 3]);
        assert!(c.image.data.contains(&[255; 3]));
    }
}
