//! The choice of a model.

use crate::{BodySurface, SphSettings, SphWash, StreamSettings, StreamWash, Wash, WashError};
use serde::{Deserialize, Serialize};

/// A model of wash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WashModel {
    /// No wash at all.
    None,
    /// Uniform momentum tubes.
    Disk,
    /// Turbulent round jets that merge.
    #[default]
    Jet,
    /// Smoothed-particle hydrodynamics.
    Sph,
}

/// The selected model, and the settings of all models.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WashSettings {
    /// The selected model.
    pub model: WashModel,
    /// Settings of `disk` and `jet`.
    pub stream: StreamSettings,
    /// Settings of `sph`.
    pub sph: SphSettings,
}

impl WashSettings {
    /// Creates the model for bodies of these surfaces; `None` for no wash.
    ///
    /// # Errors
    /// [`WashError::Setting`] when a setting of the model is out of range.
    pub fn build(&self, surfaces: Vec<BodySurface>) -> Result<Option<Box<dyn Wash>>, WashError> {
        Ok(match self.model {
            WashModel::None => None,
            WashModel::Disk => Some(Box::new(StreamWash::disk(surfaces, self.stream)?)),
            WashModel::Jet => Some(Box::new(StreamWash::jet(surfaces, self.stream)?)),
            WashModel::Sph => Some(Box::new(SphWash::new(surfaces, self.sph)?)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_read_from_text_and_name_their_model() {
        let built = |text: &str| {
            let settings: WashSettings = toml::from_str(text).unwrap();
            settings.build(vec![BodySurface::half_space()]).unwrap().map(|w| w.name())
        };
        assert_eq!(built(""), Some("jet"));
        assert_eq!(built("model = \"none\""), None);
        assert_eq!(built("model = \"disk\"\n[stream]\nemission = \"paper\""), Some("disk"));
        assert_eq!(built("model = \"sph\"\n[sph]\nkernel = \"cubic_spline\"\nspacing = 0.02"), Some("sph"));
        assert!(toml::from_str::<WashSettings>("[sph]\nspaceing = 0.02").is_err());
        let bad: WashSettings = toml::from_str("model = \"sph\"\n[sph]\nspacing = -1.0").unwrap();
        assert!(bad.build(Vec::new()).is_err());
    }
}
