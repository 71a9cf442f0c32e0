//! The user's own values.

use crate::MaterialTable;
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, Interval, Material, Property, PropertySource, atomic};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A value with or without its interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum OverrideValue {
    /// Taken as exact.
    Exact(f64),
    /// With its interval.
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
    fn interval(self) -> Interval {
        match self {
            Self::Exact(value) => Interval::exact(value),
            Self::Interval(i) => Interval { best: i.best, low: i.low, high: i.high },
        }
    }
}

/// What the user says of one object; what is not said comes from the class or the table.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObjectOverride {
    /// Material class of the table.
    pub class: Option<String>,
    /// Effective density over the closed outer volume, kg/m³.
    pub density: Option<OverrideValue>,
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

/// A file of overrides: `[object.NAME]` tables.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Overrides {
    /// By object name.
    #[serde(default)]
    pub object: BTreeMap<String, ObjectOverride>,
    #[serde(skip)]
    path: PathBuf,
}

impl Overrides {
    /// Reads the file and checks its values.
    ///
    /// # Errors
    /// [`CoreError::Input`] naming the file, the object and the value.
    pub fn read(path: &Path) -> Result<Self, CoreError> {
        let mut overrides: Self = atomic::read_toml(path)?;
        overrides.path = path.to_owned();
        for (name, o) in &overrides.object {
            for (key, value, most) in [
                ("density", o.density, 25_000.0),
                ("friction", o.friction, 5.0),
                ("restitution", o.restitution, 1.0),
                ("rolling_m", o.rolling_m, 0.1),
                ("youngs_modulus_pa", o.youngs_modulus_pa, 2e12),
                ("poissons_ratio", o.poissons_ratio, 0.5),
            ] {
                let Some(i) = value.map(OverrideValue::interval) else { continue };
                if !(0.0 <= i.low && i.low <= i.best && i.best <= i.high && i.high <= most) {
                    return Err(InputError::new(
                        format!("{key} of `{name}` cannot be {} [{}, {}]", i.best, i.low, i.high),
                        path,
                        format!("give 0 ≤ low ≤ best ≤ high ≤ {most}, in SI units"),
                    )
                    .into());
                }
            }
        }
        Ok(overrides)
    }

    /// Every named object must be one of `known`, every class one of the table's.
    pub(crate) fn check(&self, known: &[&str], table: &MaterialTable) -> Result<(), InputError> {
        for (name, o) in &self.object {
            if !known.contains(&name.as_str()) {
                return Err(InputError::new(
                    format!("there is no object `{name}` in this scene"),
                    &self.path,
                    format!("name one of: {}", known.join(", ")),
                ));
            }
            if let Some(class) = o.class.as_deref().filter(|c| table.class(c).is_none()) {
                let classes: Vec<&str> = table.classes().collect();
                return Err(InputError::new(
                    format!("`{name}` has the unknown class `{class}`"),
                    &self.path,
                    format!("use one of: {}", classes.join(", ")),
                ));
            }
        }
        Ok(())
    }

    /// `base` with what the user says of an object in place of its own.
    pub(crate) fn apply(&self, name: &str, base: Material, table: &MaterialTable) -> Material {
        let Some(o) = self.object.get(name) else { return base };
        let mut material = match o.class.as_deref().and_then(|c| table.class(c)) {
            Some(mut of_class) => {
                // The class is the user's word, its values are the table's.
                of_class.class = o.class.clone().unwrap_or_default();
                of_class
            }
            None => base,
        };
        for (slot, value) in [
            (&mut material.density, o.density),
            (&mut material.friction, o.friction),
            (&mut material.restitution, o.restitution),
            (&mut material.rolling_m, o.rolling_m),
            (&mut material.youngs_modulus_pa, o.youngs_modulus_pa),
            (&mut material.poissons_ratio, o.poissons_ratio),
        ] {
            if let Some(value) = value {
                *slot = Property::new(value.interval(), PropertySource::User);
            }
        }
        material
    }
}
