//! Selection of bodies in reconstructed scenes, where names are not known in advance.

use glamx::DVec3;
use serde::{Deserialize, Serialize};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use std::fmt;

/// Picks one dynamic body: by name, by place, or by colour; exactly one of the three.
///
/// In TOML: `{ name = "cue_ball" }`, `{ near = [0.3, 0.0, 0.03] }` or `{ color = "white", sphere = true }`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Selector {
    /// The body of this name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The body whose origin is nearest to this world point, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub near: Option<[f64; 3]>,
    /// The body whose mean colour is closest to this one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color: Option<ColorName>,
    /// Only spheres (`true`) or only other bodies (`false`); absent: both.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sphere: Option<bool>,
}

/// A colour in a task file: a word or sRGB components.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ColorName {
    /// A word, see [`COLOR_WORDS`].
    Word(String),
    /// sRGB, 0 to 255.
    Srgb([u8; 3]),
}

/// The colour words that a task file may use, with their sRGB values.
pub const COLOR_WORDS: [(&str, [u8; 3]); 11] = [
    ("white", [255, 255, 255]),
    ("black", [20, 20, 20]),
    ("gray", [128, 128, 128]),
    ("red", [200, 30, 30]),
    ("orange", [235, 125, 30]),
    ("yellow", [230, 200, 40]),
    ("green", [30, 140, 60]),
    ("blue", [30, 60, 190]),
    ("purple", [110, 40, 140]),
    ("pink", [235, 130, 170]),
    ("brown", [110, 65, 30]),
];

impl ColorName {
    /// The sRGB value; `None` for an unknown word.
    pub fn srgb(&self) -> Option<[u8; 3]> {
        match self {
            Self::Srgb(rgb) => Some(*rgb),
            Self::Word(word) => {
                COLOR_WORDS.iter().find(|(known, _)| known.eq_ignore_ascii_case(word)).map(|&(_, rgb)| rgb)
            }
        }
    }
}

impl Selector {
    /// Selects by name.
    pub fn by_name(name: impl Into<String>) -> Self {
        Self { name: Some(name.into()), ..Self::default() }
    }

    /// Selects the sphere of a colour.
    pub fn sphere_of_color(word: impl Into<String>) -> Self {
        Self { color: Some(ColorName::Word(word.into())), sphere: Some(true), ..Self::default() }
    }

    /// The fault of the selector itself, independent of a scene.
    pub(crate) fn fault(&self) -> Option<String> {
        let ways = [self.name.is_some(), self.near.is_some(), self.color.is_some()];
        if ways.iter().filter(|&&w| w).count() != 1 {
            return Some("give exactly one of `name`, `near` and `color`".to_owned());
        }
        if self.near.is_some_and(|p| p.iter().any(|v| !v.is_finite())) {
            return Some("`near` must be three finite numbers in metres".to_owned());
        }
        self.color.as_ref().is_some_and(|c| c.srgb().is_none()).then(|| {
            let words = COLOR_WORDS.map(|(word, _)| word).join(", ");
            format!("unknown colour; use [r, g, b] or one of: {words}")
        })
    }

    /// Returns the reason why the selected body may be another one than intended: another word is nearer to its colour
    /// than the selector's. `None` without such a reason.
    pub fn doubt(&self, scene: &Scene) -> Option<String> {
        let Some(ColorName::Word(word)) = &self.color else { return None };
        let body = &scene.bodies[self.select(scene)?];
        let [r, g, b] = body.color;
        (!is_called(body.color, word)).then(|| {
            let nearest = nearest_word(body.color);
            format!("`{self}` selects `{}`, whose colour [{r}, {g}, {b}] is nearer to {nearest}", body.name)
        })
    }

    /// Index of the selected body in the scene; `None` if no dynamic body matches. Ties go to the first body of the
    /// scene.
    pub fn select(&self, scene: &Scene) -> Option<usize> {
        let badness = |body: &Body| -> f64 {
            if let Some(p) = self.near {
                body.x_wb.translation.distance(DVec3::from_array(p))
            } else if let Some(rgb) = self.color.as_ref().and_then(ColorName::srgb) {
                color_distance(body.color, rgb)
            } else {
                0.0
            }
        };
        scene
            .bodies
            .iter()
            .enumerate()
            .filter(|(_, b)| b.kind == BodyKind::Dynamic)
            .filter(|(_, b)| self.name.as_ref().is_none_or(|n| *n == b.name))
            .filter(|(_, b)| self.sphere.is_none_or(|s| s == matches!(b.shape, BodyShape::Sphere { .. })))
            .min_by(|(_, a), (_, b)| badness(a).total_cmp(&badness(b)))
            .map(|(i, _)| i)
    }
}

/// Returns whether a colour word names the colour of a body: no other word is nearer. Shading turns white into gray, so
/// that words without hue count as one.
fn is_called(color: [u8; 3], word: &str) -> bool {
    let has_no_hue = |word: &str| ["white", "gray", "black"].iter().any(|w| w.eq_ignore_ascii_case(word));
    let nearest = nearest_word(color);
    nearest.eq_ignore_ascii_case(word) || (has_no_hue(nearest) && has_no_hue(word))
}

/// Returns the colour word that is nearest to a colour.
fn nearest_word(color: [u8; 3]) -> &'static str {
    let distance = |rgb: [u8; 3]| color_distance(color, rgb);
    let nearest = COLOR_WORDS.iter().min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
    nearest.map_or("", |(word, _)| word)
}

impl fmt::Display for Selector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        if let Some(name) = &self.name {
            parts.push(format!("name = \"{name}\""));
        }
        if let Some([x, y, z]) = self.near {
            parts.push(format!("near = [{x}, {y}, {z}]"));
        }
        match &self.color {
            Some(ColorName::Word(word)) => parts.push(format!("color = \"{word}\"")),
            Some(ColorName::Srgb([r, g, b])) => parts.push(format!("color = [{r}, {g}, {b}]")),
            None => {}
        }
        if let Some(sphere) = self.sphere {
            parts.push(format!("sphere = {sphere}"));
        }
        write!(f, "{{ {} }}", parts.join(", "))
    }
}

/// Distance of two sRGB colours in CIE L*a*b* with lightness at half weight: shading and shadow darken the mean
/// colour of an object, while its hue stays.
pub(crate) fn color_distance(a: [u8; 3], b: [u8; 3]) -> f64 {
    let (a, b) = (lab(a), lab(b));
    let (dl, da, db) = (0.5 * (a[0] - b[0]), a[1] - b[1], a[2] - b[2]);
    (dl * dl + da * da + db * db).sqrt()
}

/// CIE L*a*b* of an sRGB colour (IEC 61966-2-1, white point D65).
fn lab(rgb: [u8; 3]) -> [f64; 3] {
    let [r, g, b] = rgb.map(|c| {
        let c = f64::from(c) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    });
    let x = (0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505;
    let y = 0.2126 * r + 0.7152 * g + 0.0722 * b;
    let z = (0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089;
    let f = |t: f64| if t > 0.008856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 };
    let (fx, fy, fz) = (f(x), f(y), f(z));
    [116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lab_of_primaries_matches_published_values() {
        // CIE L*a*b* (D65) of the sRGB primaries, as tabulated by Bruce Lindbloom.
        for (rgb, expected) in [
            ([255, 255, 255], [100.0, 0.0, 0.0]),
            ([255, 0, 0], [53.24, 80.09, 67.20]),
            ([0, 255, 0], [87.73, -86.18, 83.18]),
            ([0, 0, 255], [32.30, 79.19, -107.86]),
        ] {
            for (got, want) in lab(rgb).iter().zip(expected) {
                assert!((got - want).abs() < 0.1, "{rgb:?}: {:?}", lab(rgb));
            }
        }
    }

    #[test]
    fn a_shaded_white_ball_is_still_white_and_not_yellow_or_gray() {
        let shaded_white = [168, 166, 160];
        let nearest = COLOR_WORDS
            .iter()
            .filter(|(word, _)| *word != "gray")
            .min_by(|a, b| color_distance(shaded_white, a.1).total_cmp(&color_distance(shaded_white, b.1)))
            .unwrap();
        assert_eq!(nearest.0, "white");
        let dim_yellow = [150, 125, 20];
        let white = [255, 255, 255];
        assert!(color_distance(shaded_white, white) < color_distance(dim_yellow, white));
    }

    #[test]
    fn faults_are_named() {
        let two = Selector { near: Some([0.0; 3]), ..Selector::by_name("a") };
        let faults = [Selector::default(), two, Selector::sphere_of_color("mauve")].map(|s| s.fault());
        assert!(faults[0].is_some() && faults[0] == faults[1] && faults[2].is_some(), "{faults:?}");
        assert_ne!(faults[1], faults[2]);
        assert_eq!(Selector::sphere_of_color("White").fault(), None);
    }

    #[test]
    fn a_color_is_called_by_its_nearest_word_in_light_and_shade() {
        for (color, words) in [
            ([168, 166, 160], vec!["white", "gray", "Black"]),
            ([20, 45, 150], vec!["blue"]),
            ([150, 25, 25], vec!["red"]),
            ([170, 148, 30], vec!["yellow"]),
        ] {
            let called = COLOR_WORDS.iter().map(|w| w.0).filter(|word| is_called(color, word)).count();
            assert_eq!(called, if words.len() > 1 { 3 } else { 1 }, "{color:?}");
            assert!(words.iter().all(|word| is_called(color, word)), "{color:?}");
        }
    }
}
