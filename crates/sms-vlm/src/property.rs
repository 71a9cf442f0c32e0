//! The requested properties: names, ranges, and uncertainty of an answer.

use sms_core::Interval;

/// One property.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum EstimatedProperty {
    Density,
    FillFactor,
    Friction,
    Restitution,
    YoungsModulus,
    PoissonsRatio,
}

impl EstimatedProperty {
    pub(crate) const ALL: [Self; 6] = [
        Self::Density,
        Self::FillFactor,
        Self::Friction,
        Self::Restitution,
        Self::YoungsModulus,
        Self::PoissonsRatio,
    ];

    /// Returns the key used in replies.
    pub(crate) fn key(self) -> &'static str {
        match self {
            Self::Density => "density_kg_m3",
            Self::FillFactor => "fill_factor",
            Self::Friction => "friction",
            Self::Restitution => "restitution",
            Self::YoungsModulus => "youngs_modulus_pa",
            Self::PoissonsRatio => "poissons_ratio",
        }
    }

    /// Returns the name used in messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Density => "density",
            Self::FillFactor => "fill factor",
            Self::Friction => "friction",
            Self::Restitution => "restitution",
            Self::YoungsModulus => "Young's modulus",
            Self::PoissonsRatio => "Poisson's ratio",
        }
    }

    /// Returns the beginnings of keys of the property, without case and signs; the rest is a unit or an end of its
    /// range.
    pub(crate) fn stems(self) -> &'static [&'static str] {
        match self {
            Self::Density => &["materialdensity", "massdensity", "density"],
            Self::FillFactor => &["fillfactor", "fillfraction", "fill", "solidfraction", "volumefraction"],
            Self::Friction => {
                &["coefficientoffriction", "frictioncoefficient", "coulombfriction", "friction"]
            }
            Self::Restitution => {
                &["coefficientofrestitution", "restitutioncoefficient", "restitution", "bounciness"]
            }
            Self::YoungsModulus => {
                &["youngsmodulus", "youngmodulus", "elasticmodulus", "modulusofelasticity", "young"]
            }
            Self::PoissonsRatio => &["poissonsratio", "poissonratio", "poisson"],
        }
    }

    /// Returns the possible range, SI units. Density from light foam to the heaviest metals; Young's modulus from
    /// gel to diamond.
    pub(crate) fn range(self) -> (f64, f64) {
        match self {
            Self::Density => (10.0, 23_000.0),
            Self::FillFactor => (1e-3, 1.0),
            Self::Friction => (0.005, 3.0),
            Self::Restitution => (0.0, 1.0),
            Self::YoungsModulus => (1e4, 1.3e12),
            Self::PoissonsRatio => (0.0, 0.5),
        }
    }

    /// Whether a percentage is a usual notation.
    pub(crate) fn takes_percent(self) -> bool {
        matches!(self, Self::Restitution | Self::FillFactor)
    }

    /// Checks that `value` is possible. A density below 30 kg/m³ without a unit is refused: such foams exist, but
    /// in replies it is a number in g/cm³.
    pub(crate) fn check(self, value: f64, has_unit: bool) -> Result<(), String> {
        const LIKELY_G_CM3_BELOW: f64 = 30.0;
        let (least, most) = self.range();
        if self == Self::Density && value < LIKELY_G_CM3_BELOW && !has_unit {
            return Err(format!("{value} kg/m³ is hardly a density; give it in kg/m³, with the unit"));
        }
        if (least..=most).contains(&value) {
            Ok(())
        } else {
            Err(format!("{value} is outside of what is possible, {least} to {most}{}", self.unit()))
        }
    }

    fn unit(self) -> &'static str {
        match self {
            Self::Density => " kg/m³",
            Self::YoungsModulus => " Pa",
            _ => "",
        }
    }

    /// Returns the interval of an answer without a usable one.
    ///
    /// A published test of models that estimate mass from pictures finds errors of a factor of two; a part of it is
    /// due to the density (the wrong material of the right family: ×/÷ 1.5) and a part to hollowness (×/÷ 2).
    /// Friction and restitution depend on both surfaces and are known to a third at best; a modulus within a
    /// material family spreads by a factor of three; Poisson's ratio by a few hundredths.
    pub(crate) fn widened(self, best: f64) -> Interval {
        let by_factor = |f: f64| (best / f, best * f);
        let by_sum = |d: f64| (best - d, best + d);
        let (low, high) = match self {
            Self::Density => by_factor(1.5),
            // A solid-looking object may have a hollow core, but rarely has.
            Self::FillFactor if best >= 0.95 => (0.7, 1.0),
            Self::FillFactor => by_factor(2.0),
            Self::Friction => by_factor(1.5),
            Self::Restitution => by_sum(0.15),
            Self::YoungsModulus => by_factor(3.0),
            Self::PoissonsRatio => by_sum(0.05),
        };
        let (least, most) = self.range();
        Interval::new(best, low.max(least), high.min(most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widened_intervals_hold_the_value_and_are_possible() {
        for p in EstimatedProperty::ALL {
            let (least, most) = p.range();
            for t in 0..=20 {
                let best = least + (most - least) * f64::from(t) / 20.0;
                let i = p.widened(best);
                assert!(least <= i.low && i.low <= best && best <= i.high && i.high <= most, "{p:?} {i:?}");
                assert!(i.high > i.low, "{p:?} {i:?}");
            }
        }
    }

    #[test]
    fn a_bare_density_in_g_cm3_is_not_taken_for_foam() {
        assert!(EstimatedProperty::Density.check(19.3, false).is_err());
        assert!(EstimatedProperty::Density.check(19.3, true).is_ok(), "with its unit it is a light foam");
        assert!(EstimatedProperty::Density.check(7.85, true).is_err());
        assert!(EstimatedProperty::Density.check(7850.0, false).is_ok());
    }
}
