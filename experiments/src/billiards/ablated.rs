//! Results of the ablation.

use super::row::{Row, Unfinished};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The input that is replaced by the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Replaced {
    /// Nothing: the same starts as the others, for comparison.
    None,
    /// The set of bodies and their shapes, including orientation (a reconstruction has none of its own), at the reconstructed
    /// places; masses by the material prior.
    Geometry,
    /// Places of reconstructed objects, and the floor's height and slope.
    Poses,
    /// Materials of reconstructed objects; masses follow with the reconstructed volumes.
    Materials,
    /// No input of the planner: its plans are executed in its own engine at its own step.
    Engine,
    /// All of them.
    All,
}

impl Replaced {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 6] =
        [Self::None, Self::Geometry, Self::Poses, Self::Materials, Self::Engine, Self::All];

    /// The word in tables and keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Geometry => "geometry",
            Self::Poses => "poses",
            Self::Materials => "materials",
            Self::Engine => "engine",
            Self::All => "all",
        }
    }
}

/// Objectives of one row's plans with one input replaced.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Ablated {
    /// Objectives in the world that the planner was given, metres.
    pub predicted_m: Vec<f64>,
    /// Realised objectives, metres; `None` if the engine could not finish the shot.
    pub realised_m: Vec<Option<f64>>,
    /// Reasons of unfinished shots.
    #[serde(default)]
    pub unfinished: Unfinished,
}

impl Ablated {
    /// Number of shots that the engine could not finish.
    pub fn unfinished(&self) -> usize {
        self.realised_m.iter().filter(|v| v.is_none()).count()
    }
}

/// A scene's ablation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// The judge's name in metrics.
    pub judge: String,
    /// Starts of row `ours`: the first ones.
    pub starts: usize,
    /// Largest change of the robust plan's objective in the judging engine when all bodies move by up to a millimetre, metres.
    pub sensitivity_m: Option<f64>,
    /// By replaced input and by row.
    pub rows: BTreeMap<Replaced, BTreeMap<Row, Ablated>>,
}

impl Ablation {
    /// Mean realised objective of a row, metres; an unfinished shot counts as `idle_m`.
    pub fn realised_m(&self, what: Replaced, row: Row, idle_m: f64) -> Option<f64> {
        let values = &self.rows.get(&what)?.get(&row)?.realised_m;
        let sum: f64 = values.iter().map(|v| v.unwrap_or(idle_m)).sum();
        (!values.is_empty()).then(|| sum / values.len() as f64)
    }
}
