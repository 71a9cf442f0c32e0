//! Ranges of the scan's settings.

use super::config::ScanConfig;
use crate::{LearningRates, TrainConfig};
use sms_core::{InputError, Ranges};

impl ScanConfig {
    /// Validates all values.
    ///
    /// # Errors
    /// [`InputError`] with the key of the first invalid value, the value and its range.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("scan");
        let (seeding, pruning, stop) = (&self.seeding, &self.pruning, &self.stop);
        for (key, value, low, high) in [
            ("fused.steps", self.fused.steps, 0, 100_000_000),
            ("steps_first", self.steps_first, 0, 10_000_000),
            ("steps_frame", self.steps_frame, 0, 10_000_000),
            ("final_steps", self.final_steps, 0, 100_000_000),
            ("batch_steps", self.batch_steps, 1, 10_000),
            ("max_gaussians", self.max_gaussians, 1, 20_000_000),
            ("holdout", self.holdout, 0, 1_000_000),
            ("stop.window", stop.window, 1, 1_000_000),
        ] {
            r.count(key, value, low, high)?;
        }
        if self.holdout == 1 {
            return Err(InputError::new(
                "`scan.holdout` is 1: holding out every frame leaves none to train on",
                "[scan]",
                "give 0 (none) or at least 2, such as 8",
            )
            .at_key("scan.holdout"));
        }
        for (key, value, low, high) in [
            ("current_share", self.current_share, 0.0, 1.0),
            ("seeding.spacing_px", seeding.spacing_px, 0.5, 1000.0),
            ("seeding.edge_spacing", seeding.edge_spacing, 0.05, 10.0),
            ("seeding.coarsest", f64::from(seeding.coarsest), 1.0, 16.0),
            ("seeding.color_step", f64::from(seeding.color_step), 0.0, 1.0),
            ("seeding.min_tolerance_m", seeding.min_tolerance_m, 0.0, 1.0),
            ("seeding.tolerance_sigmas", seeding.tolerance_sigmas, 0.0, 1000.0),
            ("seeding.radius_m", seeding.radius_m, 0.0, 1.0),
            ("seeding.sigma_of_spacing", seeding.sigma_of_spacing, 0.01, 100.0),
            ("seeding.thickness", seeding.thickness, 1e-4, 10.0),
            ("seeding.min_cosine", seeding.min_cosine, 0.0, 1.0),
            ("checkpoint_seconds", self.checkpoint_seconds, 0.0, 1e12),
        ] {
            r.within(key, value, low, high)?;
        }
        for (key, value, low, high) in [
            ("seeding.edge_threshold", seeding.edge_threshold, 0.0, 100.0),
            ("seeding.alpha_below", seeding.alpha_below, 0.0, 1.0),
            // At 0 and 1 the logit is infinite.
            ("seeding.opacity", seeding.opacity, 0.001, 0.999),
            ("pruning.opacity_below", pruning.opacity_below, 0.0, 1.0),
            ("fused.min_gain", self.fused.min_gain, 0.0, 1.0),
            ("stop.min_gain", stop.min_gain, -1.0, 1.0),
            ("final_decay", self.final_decay, 1e-6, 1.0),
        ] {
            r.within(key, value, low, high)?;
        }
        self.fused.rates.validate("scan", "fused.rates.")?;
        self.train.validate("scan", "train.")
    }
}

impl TrainConfig {
    /// Validates all values, as part of `section`, under `prefix` (as in `train.`).
    ///
    /// # Errors
    /// [`InputError`] with the key of the first invalid value, the value and its range.
    pub fn validate(&self, section: &str, prefix: &str) -> Result<(), InputError> {
        let r = Ranges::of(section);
        let w = &self.weights;
        for (key, value) in [
            ("color", w.color),
            ("isotropic", w.isotropic),
            ("depth", w.depth),
            ("normal", w.normal),
            ("flat", w.flat),
            ("segmentation", w.segmentation),
        ] {
            r.within(&format!("{prefix}weights.{key}"), value, 0.0, 1e6)?;
        }
        r.within(&format!("{prefix}weights.ssim"), w.ssim, 0.0, 1.0)?;
        self.rates.validate(section, &format!("{prefix}rates."))?;
        r.within(&format!("{prefix}segmentation_share"), self.segmentation_share, 0.01, 1.0)?;
        Ok(())
    }
}

impl LearningRates {
    /// Validates all values, as part of `section`, under `prefix` (as in `train.rates.`).
    fn validate(&self, section: &str, prefix: &str) -> Result<(), InputError> {
        let r = Ranges::of(section);
        for (key, value) in [
            ("position", self.position),
            ("log_scale", self.log_scale),
            ("rotation", self.rotation),
            ("off_plane", self.off_plane),
            ("opacity", self.opacity),
            ("color", self.color),
            ("harmonics", self.harmonics),
            ("affinity", self.affinity),
            ("classifier", self.classifier),
        ] {
            r.within(&format!("{prefix}{key}"), value, 0.0, 1.0)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Preset;

    #[test]
    fn presets_are_valid_and_every_number_has_a_range() {
        for preset in [Preset::Draft, Preset::Standard, Preset::Fine] {
            ScanConfig::preset(preset).validate().unwrap();
        }
        let base = serde_json::to_value(ScanConfig::default()).unwrap();
        let mut checked = 0;
        for path in numbers(&base, "") {
            for absurd in [-1e9, 1e18] {
                let mut changed = base.clone();
                let slot = changed.pointer_mut(&path).unwrap();
                let whole = slot.is_u64();
                *slot = if whole { serde_json::json!(10u64.pow(18)) } else { serde_json::json!(absurd) };
                let config: ScanConfig = serde_json::from_value(changed).unwrap();
                let key = path[1..].replace('/', ".");
                let message = config.validate().expect_err(&key).to_string();
                assert!(message.contains(&format!("`scan.{key}` is ")), "{key}: {message}");
                checked += 1;
            }
        }
        assert!(checked > 60, "{checked}");
    }

    /// Returns JSON pointers of all numbers in a value.
    fn numbers(value: &serde_json::Value, at: &str) -> Vec<String> {
        match value {
            serde_json::Value::Object(map) => {
                map.iter().flat_map(|(key, v)| numbers(v, &format!("{at}/{key}"))).collect()
            }
            serde_json::Value::Number(_) => vec![at.to_owned()],
            _ => Vec::new(),
        }
    }

    #[test]
    fn not_a_number_and_a_share_beyond_one_are_refused() {
        let mut config = ScanConfig::default();
        config.seeding.spacing_px = f64::NAN;
        let key = |config: &ScanConfig| config.validate().unwrap_err().key().map(str::to_owned);
        assert_eq!(key(&config).as_deref(), Some("scan.seeding.spacing_px"));
        let mut config = ScanConfig::default();
        config.train.rates.position = f32::INFINITY;
        assert!(config.validate().is_err());
        let config = ScanConfig { holdout: 1, ..ScanConfig::default() };
        assert_eq!(key(&config).as_deref(), Some("scan.holdout"));
    }
}
