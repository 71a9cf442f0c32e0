//! The handbook table.

use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, Interval, Material, Property, PropertySource, atomic};
use std::collections::BTreeMap;
use std::path::Path;

const BUILTIN: &str = include_str!("handbook.toml");

/// `[best, low, high]`.
pub type Range = [f64; 3];

/// Properties of one material class, each `[best, low, high]` in SI units.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassEntry {
    /// Keys of the table's sources.
    pub sources: Vec<String>,
    /// Density of the material itself, kg/m³.
    pub density: Range,
    /// Share of the outer volume that objects of this class fill; 1 by default.
    #[serde(default = "solid")]
    pub fill_factor: Range,
    /// Coulomb friction coefficient.
    pub friction: Range,
    /// Coefficient of restitution.
    pub restitution: Range,
    /// Rolling lever arm, metres.
    pub rolling_m: Range,
    /// Young's modulus, Pa.
    pub youngs_modulus_pa: Range,
    /// Poisson's ratio.
    pub poissons_ratio: Range,
}

fn solid() -> Range {
    [1.0; 3]
}

/// Words of object names and the material of such objects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WordEntry {
    words: Vec<String>,
    class: String,
    density: Option<Range>,
    fill_factor: Option<Range>,
    /// Wall thickness (metres) if all material, and the usual contents, were spread evenly over the convex hull. With a known
    /// size it determines the fill factor.
    walls_m: Option<Range>,
    #[serde(default)]
    is_open: bool,
    /// Legs, rails and rungs.
    #[serde(default)]
    is_frame: bool,
}

/// The table's knowledge of an object.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KnownObjectMaterial {
    /// Its material; the fill factor of open objects and frames is over the convex hull.
    pub material: Material,
    /// Thickness of its walls if they determine its mass, metres: a fill factor of `walls × area / volume` of the convex hull.
    pub walls_m: Option<Property>,
    /// Its kind of cavity.
    pub form: CavityKind,
}

/// Kinds of cavities of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CavityKind {
    /// Unknown.
    Plain,
    /// The cavity is hidden (a bottle): concavities of the mesh are no evidence of it.
    Closed,
    /// The cavity is visible (a bowl).
    Open,
    /// Legs, rails and rungs: the enclosed volume of the mesh depends on how well thin parts were observed, the convex hull
    /// hardly does.
    Frame,
}

/// Handbook values by class, objects known by name, and priors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialTable {
    source: BTreeMap<String, String>,
    class: BTreeMap<String, ClassEntry>,
    /// Synonyms of classes.
    #[serde(default)]
    alias: BTreeMap<String, Vec<String>>,
    object: Vec<WordEntry>,
    prior: Priors,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Priors {
    object: ClassEntry,
    sphere: ClassEntry,
}

fn interval([best, low, high]: Range) -> Interval {
    Interval::new(best, low, high)
}

impl ClassEntry {
    /// Returns the class as a material with all values from `source`.
    pub fn material(&self, class: &str, source: PropertySource) -> Material {
        let property = |range: Range| Property::new(interval(range), source);
        Material {
            class: class.to_owned(),
            density: property(self.density),
            fill_factor: property(self.fill_factor),
            friction: property(self.friction),
            restitution: property(self.restitution),
            rolling_m: property(self.rolling_m),
            youngs_modulus_pa: property(self.youngs_modulus_pa),
            poissons_ratio: property(self.poissons_ratio),
        }
    }
}

impl MaterialTable {
    /// Returns the built-in table.
    ///
    /// # Panics
    /// Never: a test reads the table.
    pub fn builtin() -> Self {
        match toml::from_str(BUILTIN) {
            Ok(table) => table,
            Err(e) => unreachable!("the built-in table is tested: {e}"),
        }
    }

    /// Reads a table of the same form from a file.
    ///
    /// # Errors
    /// [`CoreError::Input`] naming the file and the invalid value.
    pub fn read(path: &Path) -> Result<Self, CoreError> {
        let table: Self = atomic::read_toml(path)?;
        let Some(what) = table.fault() else { return Ok(table) };
        let cure = "write [best, low, high] with low ≤ best ≤ high, in SI units";
        Err(InputError::new(what, path, cure).into())
    }

    /// Returns the names of the classes.
    pub fn classes(&self) -> impl Iterator<Item = &str> {
        self.class.keys().map(String::as_str)
    }

    /// Returns a class as a material.
    pub fn class(&self, name: &str) -> Option<Material> {
        self.class.get(name).map(|c| c.material(name, PropertySource::Table))
    }

    /// Returns the class that a text names, or names by a synonym; the longest word counts.
    pub fn class_of(&self, text: &str) -> Option<&str> {
        let text = normalised(text);
        let aliases = self.alias.iter().flat_map(|(c, words)| words.iter().map(move |w| (w.as_str(), c)));
        let names = self.class.keys().map(|c| (c.as_str(), c));
        aliases
            .chain(names)
            .filter(|(word, _)| text.contains(&normalised(&word.replace('_', " "))))
            .max_by_key(|(word, _)| word.len())
            .map(|(_, class)| class.as_str())
    }

    /// Looks up the words of a name or description: the entry with the longest matching word or phrase, else a named class
    /// ("ceramic mug" has both; the object entry has more detail). The fill factor is over the outer volume.
    pub(crate) fn known(&self, text: &str) -> Option<KnownObjectMaterial> {
        let words = normalised(text);
        let holds = |word: &str| words.contains(&normalised(word));
        let object = self
            .object
            .iter()
            .filter_map(|o| o.words.iter().filter(|w| holds(w)).map(String::len).max().map(|n| (n, o)))
            .max_by_key(|(n, _)| *n);
        let named_class = self.class_of(text);
        let Some((_, object)) = object else {
            let plain = |material| KnownObjectMaterial { material, walls_m: None, form: CavityKind::Plain };
            return self.class(named_class?).map(plain);
        };
        let class = named_class.unwrap_or(&object.class);
        let mut material = self.class(class)?;
        let is_usual = class == object.class;
        // The entry's own density applies to the usual material only.
        if let Some(density) = object.density.filter(|_| is_usual) {
            material.density = Property::new(interval(density), PropertySource::Table);
        }
        let of_this = |range: Range| {
            let usual = Property::new(interval(range), PropertySource::Table);
            match self.class(&object.class) {
                Some(class) if !is_usual => fill_of_another(&usual, &class, &material),
                _ => usual,
            }
        };
        let walls_m = object.walls_m.map(of_this);
        let fill = object.fill_factor.map(of_this);
        material.fill_factor = fill.unwrap_or(material.fill_factor);
        let form = match (fill, object.is_open) {
            _ if object.is_frame => CavityKind::Frame,
            (None, _) => CavityKind::Plain,
            (Some(_), true) => CavityKind::Open,
            (Some(_), false) => CavityKind::Closed,
        };
        Some(KnownObjectMaterial { material, walls_m, form })
    }

    /// Returns the stated prior for an undescribed object.
    pub fn prior(&self, is_sphere: bool) -> Material {
        let entry = if is_sphere { &self.prior.sphere } else { &self.prior.object };
        entry.material("unknown", PropertySource::Prior)
    }

    /// Returns the first value that is out of order or range.
    fn fault(&self) -> Option<String> {
        let entries = self
            .class
            .iter()
            .map(|(n, e)| (n.as_str(), e))
            .chain([("prior.object", &self.prior.object), ("prior.sphere", &self.prior.sphere)]);
        for (name, entry) in entries {
            if entry.sources.is_empty() {
                return Some(format!("`{name}` names no source"));
            }
            if let Some(unknown) = entry.sources.iter().find(|s| !self.source.contains_key(*s)) {
                return Some(format!("`{name}` names the unknown source `{unknown}`"));
            }
            for (key, [best, low, high], most) in [
                ("density", entry.density, 25_000.0),
                ("fill_factor", entry.fill_factor, 1.0),
                ("friction", entry.friction, 5.0),
                ("restitution", entry.restitution, 1.0),
                ("rolling_m", entry.rolling_m, f64::MAX),
                ("youngs_modulus_pa", entry.youngs_modulus_pa, f64::MAX),
                ("poissons_ratio", entry.poissons_ratio, 0.5),
            ] {
                // Density and fill factor determine the mass, so they must be positive.
                let may_be_zero = !matches!(key, "density" | "fill_factor");
                let ordered = low <= best && best <= high && (low > 0.0 || low == 0.0 && may_be_zero);
                if !(ordered && high <= most) {
                    return Some(format!("{key} of `{name}` cannot be [{best}, {low}, {high}]"));
                }
            }
        }
        for object in &self.object {
            if !self.class.contains_key(&object.class) {
                return Some(format!("{:?} has the unknown class `{}`", object.words, object.class));
            }
            if (object.is_frame || object.walls_m.is_some()) && object.fill_factor.is_none() {
                return Some(format!("{:?} needs a fill factor for things of unknown size", object.words));
            }
            for (key, range, most) in [
                ("density", object.density, 25_000.0),
                ("fill_factor", object.fill_factor, 1.0),
                ("walls_m", object.walls_m, 1.0),
            ] {
                let Some([best, low, high]) = range else { continue };
                if !(0.0 < low && low <= best && best <= high && high <= most) {
                    return Some(format!("{key} of {:?} cannot be [{best}, {low}, {high}]", object.words));
                }
            }
        }
        let missing = self.alias.keys().find(|c| !self.class.contains_key(*c))?;
        Some(format!("the words {:?} are for the unknown class `{missing}`", self.alias[missing]))
    }
}

/// Returns the fill factor of an object of an unusual material: with a lighter one its walls are as thick (a plastic mug), with
/// a heavier one they are thinner in proportion (a steel bottle). Its interval is wider than the usual one.
pub(crate) fn fill_of_another(fill: &Property, usual: &Material, other: &Material) -> Property {
    const WIDER: f64 = 1.5;
    let ratio = (usual.density.value.best / other.density.value.best).min(1.0);
    let i = fill.value;
    let scaled = Interval::new(
        i.best * ratio,
        (i.low * ratio / WIDER).min(i.best * ratio),
        (i.high * ratio * WIDER).min(1.0),
    );
    Property::new(scaled, fill.source)
}

/// Returns lower-case words with single spaces and a space at both ends, so that "candle" does not contain " can ".
fn normalised(text: &str) -> String {
    let words: String =
        text.chars().map(|c| if c.is_alphanumeric() { c.to_ascii_lowercase() } else { ' ' }).collect();
    words.split_whitespace().fold(" ".to_owned(), |out, word| out + word + " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_builtin_table_is_in_order() {
        let table = MaterialTable::builtin();
        assert_eq!(table.fault(), None);
        assert!(table.classes().count() >= 15);
    }

    #[test]
    fn words_find_the_most_specific_entry() {
        let table = MaterialTable::builtin();
        let by_words = |text: &str| table.known(text).map(|k| k.material);
        // Class, and mass per outer volume: density × fill factor.
        let class = |text: &str| {
            by_words(text).map(|m| (m.class.clone(), (m.effective_density() / 10.0).round() * 10.0))
        };
        assert_eq!(class("white cue_ball"), Some(("phenolic_resin".into(), 1700.0)));
        assert_eq!(class("Soccer Ball"), Some(("rubber".into(), 80.0)));
        assert_eq!(class("tennis ball"), Some(("rubber".into(), 380.0)));
        assert_eq!(class("elmers_washable_school_glue"), Some(("plastic".into(), 950.0)));
        assert_eq!(class("ceramic mug"), Some(("ceramic".into(), 900.0)));
        assert_eq!(class("cracker box"), Some(("cardboard".into(), 110.0)));
        assert_eq!(class("candle"), None, "`can` is no part of `candle`");
        assert_eq!(class("object_07"), None);
        let bottle = by_words("steel bottle").unwrap();
        assert_eq!(
            (bottle.class.as_str(), bottle.density.value.best),
            ("steel", 7850.0),
            "an outright class wins"
        );
        let effective = bottle.effective_density();
        assert!((300.0..900.0).contains(&effective), "a steel bottle is hollow all the same: {effective}");
        let plastic = by_words("plastic mug").unwrap();
        assert_eq!(plastic.fill_factor.value.best, 0.375, "a lighter mug has walls as thick");
        assert_eq!(class("porcelain plate").unwrap().0, "ceramic");
        assert_eq!(table.class_of("brushed stainless steel"), Some("steel"));
        assert_eq!(table.class_of("a petal"), None, "`pet` is no part of `petal`");
    }

    #[test]
    fn the_floor_has_the_papers_values_and_priors_are_wide() {
        let table = MaterialTable::builtin();
        let floor = table.known("floor").unwrap().material;
        assert_eq!((floor.friction.value.best, floor.restitution.value.best), (0.66, 0.6));
        for is_sphere in [false, true] {
            let prior = table.prior(is_sphere);
            assert_eq!(prior.density.source, PropertySource::Prior);
            let effective = |density: f64, fill: f64| density * fill;
            let (d, f) = (prior.density.value, prior.fill_factor.value);
            assert!(effective(d.high, f.high) > 5.0 * effective(d.low, f.low));
            let best = prior.effective_density();
            assert!((best - if is_sphere { 1500.0 } else { 800.0 }).abs() < 1.0, "{best}");
            assert!(prior.friction.value.high > 2.0 * prior.friction.value.low);
        }
    }

    #[test]
    fn an_invalid_table_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        for (valid, invalid) in [
            ("restitution = [0.92, 0.85, 0.97]", "restitution = [0.92, 0.85, 1.97]"),
            ("fill_factor = [0.57, 0.06, 1]", "fill_factor = [0.57, 0.06, 1.1]"),
            ("[\"alciatore\", \"ashby\"]", "[\"hearsay\"]"),
        ] {
            let text = BUILTIN.replace(valid, invalid);
            assert_ne!(text, BUILTIN);
            std::fs::write(&path, text).unwrap();
            let Err(CoreError::Input(error)) = MaterialTable::read(&path) else { panic!("{invalid}") };
            assert!(error.path.ends_with("mine.toml"), "{error}");
        }
    }
}
