//! Colours of labels in images.

/// Returns the colour of a label id, sRGB: dark grey for the background, then hues a golden ratio apart, so that
/// successive ids always differ; brightness and saturation alternate in a cycle of four.
pub fn label_color(id: u16) -> [u8; 3] {
    if id == sms_core::BACKGROUND {
        return [48, 48, 48];
    }
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let hue = (0.02 + GOLDEN * f64::from(id - 1)).fract();
    let (saturation, value) =
        [(0.80, 0.95), (0.50, 1.0), (0.90, 0.68), (0.60, 0.82)][usize::from((id - 1) % 4)];
    hsv(hue, saturation, value)
}

/// Converts hue, saturation and value in [0, 1] to sRGB bytes.
fn hsv(hue: f64, saturation: f64, value: f64) -> [u8; 3] {
    let channel = |offset: f64| {
        let k = (offset + hue * 6.0) % 6.0;
        let v = value * (1.0 - saturation * k.min(4.0 - k).clamp(0.0, 1.0));
        (v * 255.0).round() as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_thirty_colours_differ_from_each_other_and_from_the_background() {
        for a in 0..=30u16 {
            for b in 0..a {
                let (ca, cb) = (label_color(a), label_color(b));
                let distance: i32 = (0..3).map(|c| (i32::from(ca[c]) - i32::from(cb[c])).pow(2)).sum();
                assert!(distance > 18 * 18, "{a} {ca:?} and {b} {cb:?}");
            }
        }
        assert_eq!(hsv(0.0, 1.0, 1.0), [255, 0, 0]);
        assert_eq!(hsv(1.0 / 3.0, 1.0, 1.0), [0, 255, 0]);
        assert_eq!(hsv(2.0 / 3.0, 1.0, 0.5), [0, 0, 128]);
    }
}
