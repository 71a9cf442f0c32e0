//! Interface of local optimisers.

/// Improves on given points of the unit box [0, 1]ⁿ; shared by threads.
///
/// Implementations are deterministic: their requests depend only on the given points and the returned values.
pub trait Optimiser: Sync {
    /// Name for the trial log ("nelder_mead").
    fn name(&self) -> &'static str;

    /// Searches near `start` inside the unit box. `steps` are the initial steps per coordinate. If `start` holds more
    /// than one point, the first is the best known and the others may be used (a simplex of n + 1 points).
    ///
    /// `objective` returns `None` when the search has to stop (budget used up, interrupted). The result is then the
    /// best point so far.
    fn minimise(
        &self,
        start: &[Vec<f64>],
        steps: &[f64],
        objective: &mut dyn FnMut(&[f64]) -> Option<f64>,
    ) -> Minimum;
}

/// The result of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// The best point.
    pub x: Vec<f64>,
    /// Its objective; infinite if nothing could be evaluated.
    pub objective: f64,
    /// Points evaluated.
    pub evaluations: usize,
    /// Iterations of the method.
    pub iterations: usize,
}
