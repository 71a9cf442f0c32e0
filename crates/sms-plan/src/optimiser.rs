//! The seam to local optimisers.

/// Improves on given points of the unit box [0, 1]ⁿ; shared by threads.
///
/// Implementations are deterministic: the points they ask for depend on the given points and on the returned
/// values alone.
pub trait Optimiser: Sync {
    /// Name for the trial log ("nelder_mead").
    fn name(&self) -> &'static str;

    /// Searches near `start`, which is in the unit box; `steps` says how far apart first trials are per
    /// coordinate. Where `start` holds more than one point, the first is the best known and the others may be used
    /// (a simplex of n + 1 points). Asks only for points inside the unit box.
    ///
    /// `objective` returns `None` when the search has to stop (budget used up, interrupted); the best so far is
    /// then the result.
    fn minimise(
        &self,
        start: &[Vec<f64>],
        steps: &[f64],
        objective: &mut dyn FnMut(&[f64]) -> Option<f64>,
    ) -> Minimum;
}

/// What a search found.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// The best point.
    pub x: Vec<f64>,
    /// Its objective; infinite when nothing could be evaluated.
    pub objective: f64,
    /// Points evaluated.
    pub evaluations: usize,
    /// Iterations of the method.
    pub iterations: usize,
}
