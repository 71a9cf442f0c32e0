//! Material estimates of a vision-language model.

use serde::{Deserialize, Serialize};
use sms_core::Interval;

/// The validated estimate of a vision-language model for one object, in SI units and in range. Missing or unusable values are
/// `None` and come from the table or the prior.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Estimate {
    /// Whether the given label is right.
    pub label_is_right: Option<bool>,
    /// Name of the object, in a few words.
    pub label: String,
    /// Its appearance and purpose.
    pub description: String,
    /// Its main material; free text ("glazed ceramic").
    pub material: String,
    /// Density of that material, kg/m³.
    pub density: Option<Interval>,
    /// Share of the closed outer volume that material and contents fill.
    pub fill_factor: Option<Interval>,
    /// Coulomb friction coefficient.
    pub friction: Option<Interval>,
    /// Coefficient of restitution.
    pub restitution: Option<Interval>,
    /// Young's modulus, Pa.
    pub youngs_modulus_pa: Option<Interval>,
    /// Poisson's ratio.
    pub poissons_ratio: Option<Interval>,
}

impl Estimate {
    /// Returns the material as a short word or phrase, or `None` if it is missing.
    pub(crate) fn class(&self) -> Option<String> {
        let words: Vec<&str> = self.material.split_whitespace().take(4).collect();
        let class: String = words.join(" ").to_lowercase().chars().take(40).collect();
        (!class.is_empty()).then_some(class)
    }
}
