//! Outcomes of single rollouts.

/// The outcome of one rollout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum RolloutOutcome {
    /// Valid, with its objective.
    Done(f64),
    /// The simulation failed.
    Invalid,
    /// The robot cannot carry out the strike; nothing was simulated.
    Refused,
}

impl RolloutOutcome {
    /// The value that searches minimise: infinite without an objective.
    pub(crate) fn objective(self) -> f64 {
        match self {
            Self::Done(objective) => objective,
            Self::Invalid | Self::Refused => f64::INFINITY,
        }
    }
}
