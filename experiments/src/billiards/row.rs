//! Rows of the table: the planners that are compared.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A planner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Row {
    /// The paper's: plain Nelder-Mead from random starts, each its own plan, in bodies made of the scan the paper's way.
    Paper,
    /// Ours: a small plan from each start's seed.
    Ours,
    /// Ours: one plan with the planner's default settings, which a user would carry out.
    Robust,
    /// The grid baseline.
    Grid,
}

impl Row {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 4] = [Self::Paper, Self::Ours, Self::Robust, Self::Grid];

    /// The word in tables and keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Ours => "ours",
            Self::Robust => "robust",
            Self::Grid => "grid",
        }
    }
}

/// Reasons for unfinished shots of a row, by their index in it.
pub type Unfinished = BTreeMap<usize, String>;
