//! Robust statistics of residuals.

/// Bins of [`Histogram`] and their width.
const BINS: usize = 160;
const BIN: f64 = 0.1;

/// Counts of absolute values up to 16. Their medians do not depend on the order of threads.
#[derive(Debug, Clone)]
pub(crate) struct Histogram {
    counts: Vec<u32>,
    total: u32,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: vec![0; BINS], total: 0 }
    }
}

impl Histogram {
    pub(crate) fn add(&mut self, e: f64) {
        self.counts[((e / BIN) as usize).min(BINS - 1)] += 1;
        self.total += 1;
    }

    pub(crate) fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(a, b)| *a += b);
        self.total += other.total;
    }

    pub(crate) fn total(&self) -> u32 {
        self.total
    }

    /// Returns the median, interpolated within its bin; `None` without values.
    pub(crate) fn median(&self) -> Option<f64> {
        let mut before = 0u32;
        let half = 0.5 * f64::from(self.total);
        self.counts.iter().enumerate().find_map(|(i, &c)| {
            let reached = f64::from(before + c) >= half && c > 0;
            let at = (i as f64 + (half - f64::from(before)) / f64::from(c.max(1))) * BIN;
            before += c;
            reached.then_some(at)
        })
    }

    /// Returns the mean of min(value, `most`); `None` without values.
    pub(crate) fn mean_up_to(&self, most: f64) -> Option<f64> {
        let sum: f64 = self
            .counts
            .iter()
            .enumerate()
            .map(|(i, &c)| f64::from(c) * ((i as f64 + 0.5) * BIN).min(most))
            .sum();
        (self.total > 0).then(|| sum / f64::from(self.total))
    }
}

/// Residuals of a pair.
#[derive(Debug, Clone, Default)]
pub(crate) struct ResidualStats {
    /// Depth residuals in standard deviations of the noise.
    pub(crate) depth: Histogram,
    /// Depth residuals in millimetres.
    pub(crate) depth_mm: Histogram,
    /// Colour residuals in their standard deviations.
    pub(crate) color: Histogram,
    /// Colour residuals in levels.
    pub(crate) color_levels: Histogram,
}

impl ResidualStats {
    pub(crate) fn merge(&mut self, other: &Self) {
        self.depth.merge(&other.depth);
        self.depth_mm.merge(&other.depth_mm);
        self.color.merge(&other.color);
        self.color_levels.merge(&other.color_levels);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_of_histograms() {
        let mut h = Histogram::default();
        assert_eq!(h.median(), None);
        (0..1000).for_each(|i| h.add(f64::from(i) * 0.004));
        assert!((h.median().unwrap() - 2.0).abs() < 0.02);
        assert!((h.mean_up_to(100.0).unwrap() - 2.0).abs() < 0.02);
        assert!(h.mean_up_to(1.0).unwrap() < 1.0);
    }
}
