//! Choosers and their choices.

use crate::{Approach, ApproachSettings, LandingSite, Sites, approaches};
use glamx::DVec3;
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sms_core::Seed;

/// A method of choosing among the candidates. Its name is a key in tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Chooser {
    /// A vision-language model that is shown the candidates on a picture.
    VisualPrompting,
    /// The centre of the top face, and a straight approach.
    Geometric,
    /// Any site and any approach, with equal probability.
    Random,
}

impl Chooser {
    /// Returns the name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::VisualPrompting => "visual prompting",
            Self::Geometric => "geometric",
            Self::Random => "random",
        }
    }
}

/// A site and an approach to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// The method of the choice.
    pub chooser: Chooser,
    /// The landing site.
    pub site: LandingSite,
    /// The approach to it.
    pub approach: Approach,
    /// Reasons for the site and for the approach; may be empty.
    pub reasons: [String; 2],
}

/// Returns the site nearest to the centre of the platform's top face, and the straight approach.
///
/// # Panics
/// If there is no site, which [`crate::landing_sites`] never returns.
pub fn geometric(sites: &Sites, start_w: DVec3, settings: &ApproachSettings) -> Choice {
    let off = |s: &LandingSite| s.p_w.distance(sites.center_w);
    let site =
        sites.sites.iter().min_by(|a, b| off(a).total_cmp(&off(b))).expect("at least one site").clone();
    let mut all = approaches(start_w, site.p_w, settings);
    let straight = (0..all.len()).min_by(|&a, &b| all[a].path.length().total_cmp(&all[b].path.length()));
    let approach = all.swap_remove(straight.expect("at least one approach"));
    let reasons = ["nearest to the centre of the top face".to_owned(), "straight".to_owned()];
    Choice { chooser: Chooser::Geometric, site, approach, reasons }
}

/// Returns a random site and approach. The same seed gives the same choice.
///
/// # Panics
/// If there is no site, which [`crate::landing_sites`] never returns.
pub fn random(sites: &Sites, start_w: DVec3, settings: &ApproachSettings, seed: Seed) -> Choice {
    let mut rng = seed.derive("random chooser").rng();
    let site = sites.sites[rng.random_range(0..sites.sites.len())].clone();
    let mut all = approaches(start_w, site.p_w, settings);
    let approach = all.swap_remove(rng.random_range(0..all.len()));
    Choice { chooser: Chooser::Random, site, approach, reasons: Default::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sites() -> Sites {
        let at = |id: u32, x: f64| LandingSite { id, p_w: DVec3::new(x, 0.0, 0.7), surface: "box".into() };
        let sites = vec![at(1, -0.2), at(2, 0.03), at(3, 0.2)];
        Sites { sites, platform: "box".into(), center_w: DVec3::Z * 0.7, spacing: 0.1 }
    }

    #[test]
    fn geometry_takes_the_centre_and_the_straight_way() {
        let choice = geometric(&sites(), DVec3::new(0.0, 2.0, 1.1), &ApproachSettings::default());
        assert_eq!((choice.site.id, choice.approach.id, choice.chooser.name()), (2, 5, "geometric"));
    }

    #[test]
    fn chance_takes_every_candidate_about_as_often() {
        let start = DVec3::new(0.0, 2.0, 1.1);
        let settings = ApproachSettings::default();
        let mut counts = [[0; 9]; 3];
        for seed in 0..2700 {
            let c = random(&sites(), start, &settings, Seed(seed));
            assert_eq!(c, random(&sites(), start, &settings, Seed(seed)));
            counts[c.site.id as usize - 1][c.approach.id as usize - 1] += 1;
        }
        // 100 each on average; five standard deviations.
        assert!(counts.iter().flatten().all(|n| (50..150).contains(n)), "{counts:?}");
    }
}
