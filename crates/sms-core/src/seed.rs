//! Seeds of random generators.

use rand::{Rng, RngExt, SeedableRng};
use serde::{Deserialize, Serialize};

/// The generator used everywhere: small, fast, and serialisable into checkpoints.
pub type StageRng = rand_pcg::Pcg64;

/// A seed from which independent generators are derived by name, so that adding a draw in one place does not
/// change another.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Seed(pub u64);

impl Seed {
    /// Derives the seed of a named part.
    pub fn derive(self, name: &str) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.0.to_le_bytes());
        hasher.update(name.as_bytes());
        let bytes = hasher.finalize();
        let mut first = [0u8; 8];
        first.copy_from_slice(&bytes.as_bytes()[..8]);
        Self(u64::from_le_bytes(first))
    }

    /// Derives the seed of the `index`-th item of a named part.
    pub fn derive_index(self, name: &str, index: u64) -> Self {
        Self(self.derive(name).0 ^ index.wrapping_mul(0x9E37_79B9_7F4A_7C15)).derive("index")
    }

    /// Creates a generator from this seed.
    pub fn rng(self) -> StageRng {
        StageRng::seed_from_u64(self.0)
    }
}

/// Draws a standard normal number (Box and Muller 1958, the cosine half): every number takes two draws.
pub fn standard_normal(rng: &mut impl Rng) -> f64 {
    let u: f64 = 1.0 - rng.random::<f64>();
    let v: f64 = rng.random();
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_normal_numbers_have_the_moments_of_the_distribution() {
        let mut rng = Seed(3).rng();
        let draws: Vec<f64> = (0..40_000).map(|_| standard_normal(&mut rng)).collect();
        let mean = |power: i32| draws.iter().map(|v| v.powi(power)).sum::<f64>() / draws.len() as f64;
        // Five standard errors of each moment.
        for (power, expected, variance) in [(1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)] {
            let error = 5.0 * f64::sqrt(variance / draws.len() as f64);
            assert!((mean(power) - expected).abs() < error, "moment {power}: {}", mean(power));
        }
        let within = draws.iter().filter(|v| v.abs() < 1.0).count() as f64 / draws.len() as f64;
        assert!((within - 0.682_69).abs() < 0.012, "{within}");
    }

    #[test]
    fn derived_seeds_differ_and_keep_their_values() {
        let seed = Seed(7);
        assert_eq!(seed.derive("a"), Seed(1_191_587_852_179_999_980));
        assert_eq!(seed.derive_index("a", 1), Seed(2_238_684_405_088_550_310));
        assert_ne!(seed.derive("a"), seed.derive("b"));
        assert_ne!(seed.derive_index("a", 0), seed.derive_index("a", 1));
        assert_eq!(seed.rng().next_u64(), 9_351_779_398_707_215);
    }
}
