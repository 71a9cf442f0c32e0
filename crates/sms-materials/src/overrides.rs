//! The user's own values.

use crate::assign::mapped;
use crate::table::fill_of_another;
use crate::{MaterialTable, ObjectQuery};
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, Interval, Material, Property, PropertySource, atomic};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A value with or without its interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum OverrideValue {
    /// An exact value.
    Exact(f64),
    /// A value with its interval.
    Interval(OverrideInterval),
}

/// `{ best = …, low = …, high = … }`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OverrideInterval {
    /// Best estimate.
    pub best: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl OverrideValue {
    /// Returns the value as an interval, of zero width if it is exact.
    pub fn interval(self) -> Interval {
        match self {
            Self::Exact(value) => Interval::exact(value),
            Self::Interval(i) => Interval { best: i.best, low: i.low, high: i.high },
        }
    }
}

/// The user's values for one object; missing ones come from the class, the model, the table or the prior.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectOverride {
    /// Label of the object in the run's masks. It identifies the object when its name changes; without it, the name does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub label: Option<u16>,
    /// Material class of the table.
    pub class: Option<String>,
    /// Density of the material itself, kg/m³.
    pub density: Option<OverrideValue>,
    /// Share of the enclosed volume that the material fills, 0 to 1.
    pub fill_factor: Option<OverrideValue>,
    /// Measured mass of the whole object, kg. Takes precedence over density and fill factor.
    pub mass_kg: Option<OverrideValue>,
    /// Coulomb friction coefficient.
    pub friction: Option<OverrideValue>,
    /// Coefficient of restitution.
    pub restitution: Option<OverrideValue>,
    /// Rolling lever arm, metres.
    pub rolling_m: Option<OverrideValue>,
    /// Young's modulus, Pa.
    pub youngs_modulus_pa: Option<OverrideValue>,
    /// Poisson's ratio.
    pub poissons_ratio: Option<OverrideValue>,
}

/// The numeric keys with the largest allowed value of each. All may be zero but those that determine the mass.
const NUMBERS: [(&str, f64); 8] = [
    ("density", 25_000.0),
    ("fill_factor", 1.0),
    ("mass_kg", 10_000.0),
    ("friction", 5.0),
    ("restitution", 1.0),
    ("rolling_m", 0.1),
    ("youngs_modulus_pa", 2e12),
    ("poissons_ratio", 0.5),
];

/// First lines of a saved file.
const HEADER: &str = "# Material values of the user. `sms` rewrites this file when a value is set or an object\n\
                      # with values is renamed: it keeps values, but no comments.\n\n";

/// Limits of the mass per enclosed volume, kg/m³: from a foil balloon to osmium.
const LEAST_EFFECTIVE: f64 = 1.0;
const MOST_EFFECTIVE: f64 = 25_000.0;

impl ObjectOverride {
    fn slot(&mut self, key: &str) -> Option<&mut Option<OverrideValue>> {
        Some(match key {
            "density" => &mut self.density,
            "fill_factor" => &mut self.fill_factor,
            "mass_kg" => &mut self.mass_kg,
            "friction" => &mut self.friction,
            "restitution" => &mut self.restitution,
            "rolling_m" => &mut self.rolling_m,
            "youngs_modulus_pa" => &mut self.youngs_modulus_pa,
            "poissons_ratio" => &mut self.poissons_ratio,
            _ => return None,
        })
    }
}

/// A file of overrides: `[object.NAME]` tables.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Overrides {
    /// Values by object name.
    #[serde(default)]
    pub object: BTreeMap<String, ObjectOverride>,
    #[serde(skip)]
    path: PathBuf,
}

impl Overrides {
    /// Returns the keys that an object can have.
    pub fn keys() -> impl Iterator<Item = &'static str> {
        std::iter::once("class").chain(NUMBERS.iter().map(|n| n.0))
    }

    /// Reads the file and checks its values.
    ///
    /// # Errors
    /// [`CoreError::Input`] naming the file, the object and the value.
    pub fn read(path: &Path) -> Result<Self, CoreError> {
        let mut overrides: Self = atomic::read_toml_as(path, "materials file")?;
        overrides.path = path.to_owned();
        for (name, o) in &mut overrides.object {
            for (key, most) in NUMBERS {
                if let Some(value) = o.slot(key).copied().flatten() {
                    checked(name, key, value, most).map_err(|e| e.at_path(path))?;
                }
            }
        }
        Ok(overrides)
    }

    /// Reads the file if it exists; returns no overrides otherwise.
    ///
    /// # Errors
    /// As [`Overrides::read`].
    pub fn read_optional(path: &Path) -> Result<Self, CoreError> {
        if path.exists() { Self::read(path) } else { Ok(Self { path: path.to_owned(), ..Self::default() }) }
    }

    /// Writes the file atomically, in the form that [`Overrides::read`] reads. Comments of an earlier file are lost, which
    /// the first lines of the new one say.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn save(&self, path: &Path) -> Result<(), CoreError> {
        let text = toml::to_string(self)
            .map_err(|e| CoreError::Write { path: path.to_owned(), source: std::io::Error::other(e) })?;
        atomic::write_bytes(path, format!("{HEADER}{text}").as_bytes())
    }

    /// Sets one value from text: `2400`, or `0.4,0.3,0.5` for best, low and high; a word for `class`. Setting the mass removes
    /// density and fill factor, and vice versa: the later value counts.
    ///
    /// # Errors
    /// [`InputError`] for an unknown key or an invalid value. [`Overrides::check`] checks that object and class exist.
    pub fn set(&mut self, name: &str, key: &str, text: &str) -> Result<(), InputError> {
        let given = format!("--set {name}.{key}={text}");
        if key == "class" {
            self.object.entry(name.to_owned()).or_default().class = Some(text.trim().to_owned());
            return Ok(());
        }
        let Some((key, most)) = NUMBERS.into_iter().find(|n| n.0 == key) else {
            return Err(unknown_key(key, given));
        };
        let numbers: Option<Vec<f64>> = text.split(',').map(|t| t.trim().parse().ok()).collect();
        let value = match numbers.as_deref() {
            Some(&[value]) => OverrideValue::Exact(value),
            Some(&[best, low, high]) => OverrideValue::Interval(OverrideInterval { best, low, high }),
            _ => {
                let what = format!("`{text}` is not a value for {key}");
                return Err(InputError::new(
                    what,
                    given,
                    "give a number in SI units, or three: best,low,high",
                ));
            }
        };
        checked(name, key, value, most).map_err(|e| e.at_path(given))?;
        let object = self.object.entry(name.to_owned()).or_default();
        match key {
            "mass_kg" => (object.density, object.fill_factor) = (None, None),
            "density" | "fill_factor" => object.mass_kg = None,
            _ => {}
        }
        if let Some(slot) = object.slot(key) {
            *slot = Some(value);
        }
        Ok(())
    }

    /// Removes one value, or without a key all values of an object. Returns whether there was any.
    ///
    /// # Errors
    /// [`InputError`] for an unknown key.
    pub fn unset(&mut self, name: &str, key: Option<&str>) -> Result<bool, InputError> {
        let Some(key) = key else { return Ok(self.object.remove(name).is_some()) };
        if !Self::keys().any(|k| k == key) {
            return Err(unknown_key(key, format!("--unset {name}.{key}")));
        }
        let Some(object) = self.object.get_mut(name) else { return Ok(false) };
        let had = match object.slot(key) {
            Some(slot) => slot.take().is_some(),
            None => object.class.take().is_some(),
        };
        if *object == (ObjectOverride { label: object.label, ..ObjectOverride::default() }) {
            self.object.remove(name);
        }
        Ok(had)
    }

    /// Merges `stronger` into these values; it takes precedence. Errors then name the file of `stronger`.
    pub fn under(mut self, stronger: Self) -> Self {
        for (name, mut over) in stronger.object {
            let under = self.object.entry(name).or_default();
            if over.mass_kg.is_some() {
                (under.density, under.fill_factor) = (None, None);
            } else if over.density.is_some() || over.fill_factor.is_some() {
                under.mass_kg = None;
            }
            under.class = over.class.take().or(under.class.take());
            under.label = over.label.or(under.label);
            for (key, _) in NUMBERS {
                if let (Some(slot), Some(Some(value))) = (under.slot(key), over.slot(key).copied()) {
                    *slot = Some(value);
                }
            }
        }
        self.path = stronger.path;
        self
    }

    /// Checks that every named object is one of `objects`, every class one of the table's, and that objects with a mass have a
    /// volume.
    ///
    /// # Errors
    /// [`InputError`] naming the file, the invalid entry and the valid ones.
    pub fn check(&self, objects: &[ObjectQuery], table: &MaterialTable) -> Result<(), InputError> {
        let fault = |what: String, cure: String| Err(InputError::new(what, &self.path, cure));
        for (name, o) in &self.object {
            let Some(object) = objects.iter().find(|q| q.name == *name) else {
                let known: Vec<&str> = objects.iter().map(|q| q.name.as_str()).collect();
                let what = format!("there is no object `{name}` in this scene");
                return fault(what, format!("name one of: {}", known.join(", ")));
            };
            if let Some(class) = o.class.as_deref().filter(|c| table.class(c).is_none()) {
                let classes: Vec<&str> = table.classes().collect();
                let what = format!("`{name}` has the unknown class `{class}`");
                return fault(what, format!("use one of: {}", classes.join(", ")));
            }
            let Some(mass) = o.mass_kg.map(OverrideValue::interval) else { continue };
            let volume_m3 = object.volume_m3;
            if volume_m3 <= 0.0 {
                let what = format!("mass_kg cannot be given for `{name}`, which encloses no volume");
                return fault(what, "remove it: fixed bodies have no mass".to_owned());
            }
            let (low, high) = (mass.low / volume_m3, mass.high / volume_m3);
            if low < LEAST_EFFECTIVE || high > MOST_EFFECTIVE {
                let volume_cm3 = 1e6 * volume_m3;
                let what = format!(
                    "mass_kg of `{name}` is {low:.3} to {high:.3} kg/m³ over its {volume_cm3:.1} cm³"
                );
                let cure = format!("give kilograms, between {LEAST_EFFECTIVE} and {MOST_EFFECTIVE} kg/m³");
                return fault(what, cure);
            }
        }
        Ok(())
    }

    /// Replaces the values of `base` by the user's.
    pub(crate) fn apply(&self, object: &ObjectQuery, base: Material, table: &MaterialTable) -> Material {
        let Some(o) = self.object.get(&object.name) else { return base };
        let mut material = match o.class.as_deref().and_then(|c| table.class(c)) {
            Some(mut of_class) => {
                // The user gives the class, the table its values; the form is kept.
                of_class.class = o.class.clone().unwrap_or_default();
                let fill = &base.fill_factor;
                let is_kept = of_class.class == base.class || fill.value.low >= 1.0;
                of_class.fill_factor = if is_kept { *fill } else { fill_of_another(fill, &base, &of_class) };
                of_class
            }
            None => base,
        };
        for (slot, value) in [
            (&mut material.density, o.density),
            (&mut material.fill_factor, o.fill_factor),
            (&mut material.friction, o.friction),
            (&mut material.restitution, o.restitution),
            (&mut material.rolling_m, o.rolling_m),
            (&mut material.youngs_modulus_pa, o.youngs_modulus_pa),
            (&mut material.poissons_ratio, o.poissons_ratio),
        ] {
            *slot = value.map_or(*slot, |v| Property::new(v.interval(), PropertySource::User));
        }
        if let Some(mass) = o.mass_kg.filter(|_| object.volume_m3 > 0.0) {
            weigh(&mut material, mapped(mass.interval(), |kg| kg / object.volume_m3));
        }
        material
    }
}

/// Makes density × fill factor equal to a known mass per volume, kg/m³. Only the product is known: the density is kept if
/// possible, and the fill factor gets the interval of the mass.
fn weigh(material: &mut Material, effective: Interval) {
    let user = |value| Property::new(value, PropertySource::User);
    let density = material.density.value.best;
    if density >= effective.high {
        material.fill_factor = user(mapped(effective, |x| x / density));
        material.density.value = Interval::exact(density);
    } else {
        material.density = user(effective);
        material.fill_factor = user(Interval::exact(1.0));
    }
}

fn unknown_key(key: &str, given: String) -> InputError {
    let keys: Vec<&str> = Overrides::keys().collect();
    let cure = format!("use one of: {}", keys.join(", "));
    InputError::new(format!("there is no property `{key}`"), given, cure)
}

fn checked(name: &str, key: &str, value: OverrideValue, most: f64) -> Result<(), InputError> {
    let i = value.interval();
    let least = match key {
        "density" => 1.0,
        "fill_factor" => 1e-3,
        "mass_kg" => 1e-6,
        _ => 0.0,
    };
    if least <= i.low && i.low <= i.best && i.best <= i.high && i.high <= most {
        return Ok(());
    }
    let mut sorted = [i.low, i.best, i.high];
    sorted.sort_by(f64::total_cmp);
    let [low, best, high] = sorted;
    let in_order = if least <= low && high <= most && sorted != [i.low, i.best, i.high] {
        format!(": here best {best}, low {low}, high {high}")
    } else {
        String::new()
    };
    Err(InputError::new(
        format!("{key} of `{name}` cannot be {} [{}, {}]", i.best, i.low, i.high),
        "",
        format!(
            "give best, low, high in this order, with {least} ≤ low ≤ best ≤ high ≤ {most} in SI units{in_order}"
        ),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assign;
    use sms_core::Warnings;

    #[test]
    fn edits_are_kept_and_taken_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("materials.toml");
        let mut o = Overrides::read_optional(&path).unwrap();
        assert!(o.object.is_empty());
        o.set("mug", "density", "2400").unwrap();
        o.set("mug", "class", "ceramic").unwrap();
        o.set("mug", "friction", " 0.4, 0.3,0.5").unwrap();
        o.set("ball", "restitution", "0.9").unwrap();
        o.save(&path).unwrap();
        let read = Overrides::read(&path).unwrap();
        assert_eq!(read.object, o.object);
        assert!(std::fs::read_to_string(&path).unwrap().starts_with(HEADER));
        assert_eq!(read.object["mug"].friction.unwrap().interval(), Interval::new(0.4, 0.3, 0.5));
        assert!(o.unset("mug", Some("friction")).unwrap());
        assert!(!o.unset("mug", Some("friction")).unwrap(), "it is gone");
        assert!(o.unset("ball", Some("restitution")).unwrap());
        assert!(!o.object.contains_key("ball"), "an object without values is not listed");
        assert!(o.unset("mug", None).unwrap());
        assert!(o.object.is_empty());
    }

    #[test]
    fn invalid_edits_are_refused() {
        let mut o = Overrides::default();
        for (key, text) in [
            ("weight", "1"),
            ("density", "heavy"),
            ("density", "0"),
            ("density", "0.5"),
            ("mass_kg", "1e-7"),
            ("density", "1,2"),
            ("friction", "0.4,0.5,0.6"),
            ("friction", "nan"),
            ("restitution", "-0.1"),
            ("youngs_modulus_pa", "1e400"),
        ] {
            assert_eq!(o.set("mug", key, text).unwrap_err().path, format!("--set mug.{key}={text}"));
        }
        assert!(o.unset("mug", Some("weight")).is_err());
        assert!(o.object.is_empty(), "refused values are not kept");
    }

    /// The order of the numbers of `--set` is best, low, high.
    #[test]
    fn numbers_out_of_order_are_refused_with_their_order() {
        let mut o = Overrides::default();
        for text in ["0.4,0.5,0.6", "0.6,0.4,0.5", "0.4,0.6,0.5", "0.5,0.6,0.4"] {
            let error = o.set("mug", "friction", text).unwrap_err();
            assert!(error.cure.ends_with("best 0.5, low 0.4, high 0.6"), "{text}: {error}");
        }
        let beyond = o.set("mug", "friction", "7,6,8").unwrap_err();
        assert!(!beyond.cure.contains("best 7"), "no order makes them valid: {beyond}");
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        std::fs::write(&path, "[object.mug]\nfriction = { best = 0.4, low = 0.5, high = 0.6 }\n").unwrap();
        let error = Overrides::read(&path).unwrap_err().to_string();
        assert!(error.contains("best 0.5, low 0.4, high 0.6") && error.contains("mine.toml"), "{error}");
        assert!(o.object.is_empty());
        o.set("mug", "friction", "0.5,0.4,0.6").unwrap();
    }

    #[test]
    fn a_weighed_object_has_its_mass_whatever_its_density() {
        let table = MaterialTable::builtin();
        let mug = |mass: &str| {
            let query = ObjectQuery {
                name: "mug".into(),
                description: "ceramic mug".into(),
                volume_m3: 4e-4,
                ..Default::default()
            };
            let mut o = Overrides::default();
            o.set("mug", "density", "2000").unwrap();
            o.set("mug", "mass_kg", mass).unwrap();
            assign(&[query], &table, Some(&o), &Warnings::new()).unwrap().remove(0)
        };
        let light = mug("0.35,0.34,0.36");
        assert!((light.effective_density() * 4e-4 - 0.35).abs() < 1e-12);
        assert_eq!(light.density.value, Interval::exact(2400.0), "the later word counts");
        let high = light.fill_factor.value.high * light.density.value.high * 4e-4;
        assert!((high - 0.36).abs() < 1e-12);
        let heavy = mug("1.6");
        assert!((heavy.effective_density() * 4e-4 - 1.6).abs() < 1e-12);
        assert_eq!(heavy.fill_factor.value, Interval::exact(1.0), "no more than full");
    }

    #[test]
    fn the_stronger_file_wins_key_by_key() {
        let mut weaker = Overrides::default();
        weaker.set("mug", "friction", "0.4").unwrap();
        weaker.set("mug", "mass_kg", "0.4").unwrap();
        weaker.set("ball", "friction", "0.1").unwrap();
        let mut stronger = Overrides::default();
        stronger.set("mug", "density", "2000").unwrap();
        stronger.set("mug", "class", "glass").unwrap();
        let both = weaker.under(stronger);
        let mug = &both.object["mug"];
        assert_eq!((mug.mass_kg, mug.class.as_deref()), (None, Some("glass")));
        assert_eq!(mug.density, Some(OverrideValue::Exact(2000.0)));
        assert_eq!(mug.friction, Some(OverrideValue::Exact(0.4)));
        assert_eq!(both.object["ball"].friction, Some(OverrideValue::Exact(0.1)));
    }
}
