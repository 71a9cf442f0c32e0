//! Material properties, each with an interval and a source.

use serde::{Deserialize, Serialize};

/// A best estimate with the range that is believed to hold it (about 90 %).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Best estimate.
    pub best: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    /// An interval; the ends are widened to hold `best` where they do not.
    pub fn new(best: f64, low: f64, high: f64) -> Self {
        Self { best, low: low.min(best), high: high.max(best) }
    }

    /// Exactly known.
    pub fn exact(value: f64) -> Self {
        Self { best: value, low: value, high: value }
    }

    /// The value at `t` in [−1, 1]: low at −1, best at 0, high at 1, linear in between.
    pub fn at(&self, t: f64) -> f64 {
        if t < 0.0 { self.best + t * (self.best - self.low) } else { self.best + t * (self.high - self.best) }
    }
}

/// Who said it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PropertySource {
    /// A vision-language model.
    Vlm,
    /// The handbook table, by material or label.
    Table,
    /// The user's own file.
    User,
    /// Nothing was known: a stated prior.
    Prior,
    /// The truth of a generated scene (targets and ablations only).
    Truth,
}

/// One property with its interval and source.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Property {
    /// The value.
    #[serde(flatten)]
    pub value: Interval,
    /// Who said it.
    pub source: PropertySource,
}

impl Property {
    /// A property.
    pub fn new(value: Interval, source: PropertySource) -> Self {
        Self { value, source }
    }
}

/// What a body is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Material class ("ceramic", "phenolic resin"), or "unknown".
    pub class: String,
    /// Density in kg/m³ of what the object is made of.
    pub density: Property,
    /// Share of the volume that the mesh encloses which the material fills: 1 for solid things and where the mesh has
    /// the walls itself, less for closed hollow ones (a bottle, a carton).
    #[serde(default = "solid")]
    pub fill_factor: Property,
    /// Coulomb friction coefficient of this surface; a pair uses the mean of both.
    pub friction: Property,
    /// Coefficient of restitution of this surface; a pair uses the mean of both.
    pub restitution: Property,
    /// Rolling resistance: lever arm in metres (0 for ideal rolling).
    pub rolling_m: Property,
    /// Young's modulus in Pa.
    pub youngs_modulus_pa: Property,
    /// Poisson's ratio.
    pub poissons_ratio: Property,
}

impl Material {
    /// Best estimate of the mass per volume that the mesh encloses, kg/m³: density times fill factor.
    pub fn effective_density(&self) -> f64 {
        self.density.value.best * self.fill_factor.value.best
    }
}

/// Solid all through.
fn solid() -> Property {
    Property::new(Interval::exact(1.0), PropertySource::Prior)
}
