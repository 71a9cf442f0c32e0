//! The extent of names in pictures.

/// Mean width of a character, as a share of its height.
const CHARACTER: f64 = 0.58;
/// Part of a character below its base line, as a share of its height.
const BELOW: f64 = 0.4;

/// Returns half the width of a name with characters `size` high.
pub(crate) fn half_width(name: &str, size: f64) -> f64 {
    0.5 * CHARACTER * size * name.chars().count() as f64
}

/// Moves the middle of the base line of a name so that the whole name lies in a picture of this width and height. A name
/// that is too large for the picture is centred in its width.
pub(crate) fn inside(name: &str, size: f64, (x, y): (f64, f64), (width, height): (f64, f64)) -> (f64, f64) {
    let half = half_width(name, size).min(0.5 * width);
    let top = size.min(height);
    (x.clamp(half, width - half), y.clamp(top, lowest(size, height).max(top)))
}

/// Returns the lowest base line of characters `size` high in a picture of this height.
pub(crate) fn lowest(size: f64, height: f64) -> f64 {
    height - BELOW * size
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_moved_as_little_as_needed() {
        let (size, half) = (10.0, half_width("cup", 10.0));
        assert!((half - 8.7).abs() < 1e-12);
        let at = |x: f64, y: f64| inside("cup", size, (x, y), (100.0, 50.0));
        assert_eq!(at(40.0, 30.0), (40.0, 30.0));
        assert_eq!(at(1.0, 2.0), (half, 10.0));
        assert_eq!(at(99.0, 49.0), (100.0 - half, 46.0));
        // There is no room for the name.
        assert_eq!(inside("cup", size, (3.0, 3.0), (12.0, 6.0)), (6.0, 6.0));
    }
}
