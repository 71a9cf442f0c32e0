//! Material properties, each with an interval and a source.

use serde::{Deserialize, Serialize};

/// A best estimate with its credible range (about 90 %).
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
    /// Creates an interval; its ends are widened to contain `best`.
    pub fn new(best: f64, low: f64, high: f64) -> Self {
        Self { best, low: low.min(best), high: high.max(best) }
    }

    /// Creates an exact value.
    pub fn exact(value: f64) -> Self {
        Self { best: value, low: value, high: value }
    }

    /// Returns the value at `t` in [−1, 1]: low at −1, best at 0, high at 1, linear in between.
    pub fn at(&self, t: f64) -> f64 {
        if t < 0.0 { self.best + t * (self.best - self.low) } else { self.best + t * (self.high - self.best) }
    }
}

/// Source of a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PropertySource {
    /// A vision-language model.
    Vlm,
    /// The handbook table, by material or label.
    Table,
    /// The user's own file.
    User,
    /// A stated prior, without other knowledge.
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
    /// The source.
    pub source: PropertySource,
}

impl Property {
    /// Creates a property.
    pub fn new(value: Interval, source: PropertySource) -> Self {
        Self { value, source }
    }
}

/// Material of a body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Material class ("ceramic", "phenolic resin"), or "unknown".
    pub class: String,
    /// Density of the substance, kg/m³.
    pub density: Property,
    /// Share of the enclosed volume that the material fills: 1 for solids and for meshes that include the inner walls, less
    /// for closed hollow objects (a bottle, a carton).
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
    /// Returns the best estimate of the mass per enclosed volume, kg/m³: density times fill factor.
    pub fn effective_density(&self) -> f64 {
        self.density.value.best * self.fill_factor.value.best
    }
}

/// The fill factor of a solid.
fn solid() -> Property {
    Property::new(Interval::exact(1.0), PropertySource::Prior)
}
