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
    /// Density, kg/m³.
    pub density: Range,
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

/// Words that tell what an object is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ObjectEntry {
    words: Vec<String>,
    class: String,
    density: Option<Range>,
}

/// Handbook values by class, objects known by name, and priors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialTable {
    source: BTreeMap<String, String>,
    class: BTreeMap<String, ClassEntry>,
    object: Vec<ObjectEntry>,
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
    /// The class as a material, every value from `source`.
    pub fn material(&self, class: &str, source: PropertySource) -> Material {
        let property = |range: Range| Property::new(interval(range), source);
        Material {
            class: class.to_owned(),
            density: property(self.density),
            friction: property(self.friction),
            restitution: property(self.restitution),
            rolling_m: property(self.rolling_m),
            youngs_modulus_pa: property(self.youngs_modulus_pa),
            poissons_ratio: property(self.poissons_ratio),
        }
    }

    fn ranges(&self) -> [(&'static str, Range); 6] {
        [
            ("density", self.density),
            ("friction", self.friction),
            ("restitution", self.restitution),
            ("rolling_m", self.rolling_m),
            ("youngs_modulus_pa", self.youngs_modulus_pa),
            ("poissons_ratio", self.poissons_ratio),
        ]
    }
}

impl MaterialTable {
    /// The table that comes with the program.
    ///
    /// # Panics
    /// Never with the table as committed: a test reads it.
    pub fn builtin() -> Self {
        match toml::from_str(BUILTIN) {
            Ok(table) => table,
            Err(e) => unreachable!("the built-in table is tested: {e}"),
        }
    }

    /// Reads a table of the same form from a file.
    ///
    /// # Errors
    /// [`CoreError::Input`] naming the file and the value that is wrong.
    pub fn read(path: &Path) -> Result<Self, CoreError> {
        let table: Self = atomic::read_toml(path)?;
        match table.fault() {
            None => Ok(table),
            Some(what) => Err(InputError::new(
                what,
                path,
                "write [best, low, high] with low ≤ best ≤ high, in SI units",
            )
            .into()),
        }
    }

    /// The classes there are.
    pub fn classes(&self) -> impl Iterator<Item = &str> {
        self.class.keys().map(String::as_str)
    }

    /// A class as a material.
    pub fn class(&self, name: &str) -> Option<Material> {
        self.class.get(name).map(|c| c.material(name, PropertySource::Table))
    }

    /// The publications that the values of a class are from.
    pub fn sources(&self, class: &str) -> Vec<&str> {
        let keys = self.class.get(class).map_or(&[][..], |c| &c.sources);
        keys.iter().filter_map(|k| self.source.get(k)).map(String::as_str).collect()
    }

    /// What the words of a name or description say: the entry with the longest matching word or phrase, else a class
    /// that is named outright ("ceramic mug" knows both; the object entry knows more).
    pub fn by_words(&self, text: &str) -> Option<Material> {
        let text = normalised(text);
        let holds = |word: &str| text.contains(&normalised(word));
        let named_class =
            self.class.keys().filter(|c| holds(&c.replace('_', " "))).max_by_key(|c| c.len()).cloned();
        let object = self
            .object
            .iter()
            .filter_map(|o| o.words.iter().filter(|w| holds(w)).map(String::len).max().map(|n| (n, o)))
            .max_by_key(|(n, _)| *n)
            .map(|(_, o)| o);
        let Some(object) = object else { return self.class(&named_class?) };
        let class = named_class.unwrap_or_else(|| object.class.clone());
        let mut material = self.class(&class)?;
        // An effective density belongs to the shape of the thing and the wall it was weighed with.
        if let Some(density) = object.density.filter(|_| class == object.class) {
            material.density = Property::new(interval(density), PropertySource::Table);
        }
        Some(material)
    }

    /// The stated prior for an object that nobody described.
    pub fn prior(&self, is_sphere: bool) -> Material {
        let entry = if is_sphere { &self.prior.sphere } else { &self.prior.object };
        entry.material("unknown", PropertySource::Prior)
    }

    /// The first value that is out of order or range.
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
            for (key, [best, low, high]) in entry.ranges() {
                let ordered = low <= best && best <= high && low >= 0.0 && high.is_finite();
                let in_range = match key {
                    "restitution" => high <= 1.0,
                    "poissons_ratio" => high <= 0.5,
                    "friction" => high <= 5.0,
                    "density" => low > 0.0 && high <= 25_000.0,
                    _ => true,
                };
                if !(ordered && in_range) {
                    return Some(format!("{key} of `{name}` cannot be [{best}, {low}, {high}]"));
                }
            }
        }
        let missing = self.object.iter().find(|o| !self.class.contains_key(&o.class))?;
        Some(format!("{:?} has the unknown class `{}`", missing.words, missing.class))
    }
}

/// Lower-case words with single spaces and a space at both ends, so that "can" is not found in "candle".
fn normalised(text: &str) -> String {
    let words: String =
        text.chars().map(|c| if c.is_alphanumeric() { c.to_ascii_lowercase() } else { ' ' }).collect();
    let mut out = String::from(" ");
    for word in words.split_whitespace() {
        out.push_str(word);
        out.push(' ');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_builtin_table_is_in_order() {
        let table = MaterialTable::builtin();
        assert_eq!(table.fault(), None);
        assert!(table.classes().count() >= 15);
        assert!(table.sources("phenolic_resin")[0].contains("Alciatore"));
        assert!(table.sources("no such class").is_empty());
    }

    #[test]
    fn words_find_the_most_specific_entry() {
        let table = MaterialTable::builtin();
        let class = |text: &str| table.by_words(text).map(|m| (m.class, m.density.value.best));
        assert_eq!(class("white cue_ball"), Some(("phenolic_resin".into(), 1700.0)));
        assert_eq!(class("Soccer Ball"), Some(("rubber".into(), 80.0)));
        assert_eq!(class("elmers_washable_school_glue"), Some(("plastic".into(), 950.0)));
        assert_eq!(class("steel bottle"), Some(("steel".into(), 7850.0)), "an outright class wins");
        assert_eq!(class("ceramic mug"), Some(("ceramic".into(), 900.0)));
        assert_eq!(class("candle"), None, "`can` is no part of `candle`");
        assert_eq!(class("object_07"), None);
    }

    #[test]
    fn the_floor_has_the_papers_values_and_priors_are_wide() {
        let table = MaterialTable::builtin();
        let floor = table.by_words("floor").unwrap();
        assert_eq!((floor.friction.value.best, floor.restitution.value.best), (0.66, 0.6));
        for is_sphere in [false, true] {
            let prior = table.prior(is_sphere);
            assert_eq!(prior.density.source, PropertySource::Prior);
            assert!(prior.density.value.high > 5.0 * prior.density.value.low);
            assert!(prior.friction.value.high > 2.0 * prior.friction.value.low);
        }
    }

    #[test]
    fn a_table_out_of_order_is_refused_by_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        std::fs::write(
            &path,
            BUILTIN.replace("restitution = [0.92, 0.85, 0.97]", "restitution = [0.92, 0.85, 1.97]"),
        )
        .unwrap();
        let message = MaterialTable::read(&path).unwrap_err().to_string();
        assert!(message.contains("phenolic_resin") && message.contains("mine.toml"), "{message}");
        std::fs::write(&path, BUILTIN.replace("[\"alciatore\", \"ashby\"]", "[\"hearsay\"]")).unwrap();
        let message = MaterialTable::read(&path).unwrap_err().to_string();
        assert!(message.contains("phenolic_resin") && message.contains("hearsay"), "{message}");
    }
}
