//! Colours for depth, errors and labels.

use sms_core::{BACKGROUND, ColorImage, DepthImage, Image, LabelMap};

/// Evaluates the Turbo colour map at `t` in [0, 1] (polynomial fit by A. Mikhailov, Google AI blog 2019).
pub fn turbo(t: f32) -> [u8; 3] {
    let x = t.clamp(0.0, 1.0);
    let powers = [1.0, x, x * x, x.powi(3), x.powi(4), x.powi(5)];
    let dot = |c: [f32; 6]| {
        let sum: f32 = c.iter().zip(powers).map(|(a, b)| a * b).sum();
        (sum.clamp(0.0, 1.0) * 255.0).round() as u8
    };
    [
        dot([0.1357, 4.6154, -42.6603, 132.131, -152.942, 59.2864]),
        dot([0.0914, 2.1942, 4.8430, -14.1850, 4.2773, 2.8296]),
        dot([0.1067, 12.6419, -60.5820, 110.3628, -89.9031, 27.3482]),
    ]
}

/// Colours a depth map between `near` and `far` metres; missing depth is dark grey.
pub fn depth_picture(depth: &DepthImage, near: f32, far: f32) -> ColorImage {
    let span = (far - near).max(1e-6);
    depth.map(|&z| if z > 0.0 { turbo((z - near) / span) } else { [40, 40, 44] })
}

/// Colours |a − b| of two depth maps from 0 to `full_scale` metres; missing depth in either is dark grey.
pub fn error_picture(a: &DepthImage, b: &DepthImage, full_scale: f32) -> ColorImage {
    let pixels = a
        .data
        .iter()
        .zip(&b.data)
        .map(|(&x, &y)| if x > 0.0 && y > 0.0 { turbo((x - y).abs() / full_scale) } else { [40, 40, 44] })
        .collect();
    Image::from_vec(a.width, a.height, pixels)
}

/// Tints a grey version of the frame by label; the background stays grey.
pub fn label_picture(color: &ColorImage, labels: &LabelMap) -> ColorImage {
    let pixels = color
        .data
        .iter()
        .zip(&labels.data)
        .map(|(&[r, g, b], &label)| {
            let grey = (u16::from(r) * 3 + u16::from(g) * 6 + u16::from(b)) / 10;
            if label == BACKGROUND {
                return [(grey * 6 / 10) as u8; 3];
            }
            let tint = sms_masks::label_color(label);
            tint.map(|c| ((u16::from(c) * 7 + grey * 3) / 10) as u8)
        })
        .collect();
    Image::from_vec(color.width, color.height, pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turbo_runs_from_blue_through_green_to_red() {
        let [low, mid, high] = [turbo(0.1), turbo(0.5), turbo(0.9)];
        assert!(low[2] > low[0] && mid[1] > mid[0].max(mid[2]) && high[0] > high[2]);
    }

    #[test]
    fn missing_depth_is_not_an_error() {
        let a = Image::from_vec(2, 1, vec![0.0, 1.0]);
        let b = Image::from_vec(2, 1, vec![1.0, 1.0]);
        let picture = error_picture(&a, &b, 0.01);
        assert_eq!(picture.data[0], [40, 40, 44]);
        assert_eq!(picture.data[1], turbo(0.0));
    }
}
