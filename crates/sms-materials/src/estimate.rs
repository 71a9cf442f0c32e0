//! What someone who looked at an object says of it.

use serde::{Deserialize, Serialize};
use sms_core::Interval;

/// What a vision-language model says of one object, validated: every value is in SI units and in range. What it did not
/// say, or said in a way that could not be used, is `None` and comes from the table or the prior.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Estimate {
    /// Whether the label that it was given is right.
    pub label_is_right: Option<bool>,
    /// What the object is, in a few words.
    pub label: String,
    /// What it looks like and what it is for.
    pub description: String,
    /// What it is made of, mostly; free text ("glazed ceramic").
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
    /// The words to look it up by: material first, then what it is.
    pub(crate) fn words(&self) -> String {
        format!("{} {}", self.material, self.label)
    }

    /// The material in one short word or phrase, or `None` when it said nothing.
    pub(crate) fn class(&self) -> Option<String> {
        let words: Vec<&str> = self.material.split_whitespace().take(4).collect();
        let class: String = words.join(" ").to_lowercase().chars().take(40).collect();
        (!class.is_empty()).then_some(class)
    }
}
