//! Timing of the parts of a step.

/// CPU seconds spent in each part of a step, over all threads.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StepTimes {
    /// Projection of all Gaussians.
    pub project: f64,
    /// Sorting and lists.
    pub bin: f64,
    /// Blending.
    pub blend: f64,
    /// SSIM and its gradient.
    pub ssim: f64,
    /// Colour, depth and normal terms.
    pub pixels: f64,
    /// Classifier and cross-entropy.
    pub segmentation: f64,
    /// Gradient of blending.
    pub unblend: f64,
    /// Sums over bands, gradient of projection, regularisers.
    pub unproject: f64,
    /// Optimiser.
    pub adam: f64,
}

impl StepTimes {
    /// Number of parts.
    pub const PARTS: usize = 9;
    /// Short names of the parts, in the order of [`Self::parts`].
    pub const NAMES: [&str; Self::PARTS] =
        ["project", "bin", "blend", "ssim", "pixels", "segmentation", "unblend", "unproject", "adam"];

    /// The parts in the order in which they run.
    pub fn parts(&self) -> [f64; Self::PARTS] {
        [
            self.project,
            self.bin,
            self.blend,
            self.ssim,
            self.pixels,
            self.segmentation,
            self.unblend,
            self.unproject,
            self.adam,
        ]
    }

    /// From parts in the order in which they run.
    pub fn from_parts(parts: [f64; Self::PARTS]) -> Self {
        let [project, bin, blend, ssim, pixels, segmentation, unblend, unproject, adam] = parts;
        Self { project, bin, blend, ssim, pixels, segmentation, unblend, unproject, adam }
    }

    /// Returns `f` of each part of both.
    #[must_use]
    pub fn combined(&self, other: &Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let (a, b) = (self.parts(), other.parts());
        Self::from_parts(std::array::from_fn(|i| f(a[i], b[i])))
    }

    /// Adds another.
    pub fn add(&mut self, other: &Self) {
        *self = self.combined(other, |a, b| a + b);
    }

    /// All parts.
    pub fn total(&self) -> f64 {
        self.parts().iter().sum()
    }
}
