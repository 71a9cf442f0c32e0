//! The general task as a file: strike one body to minimise a weighted sum of terms.

use crate::billiards::{self, StrikeSettings, fault};
use crate::{ActionBounds, ActionForm, Selector, StrikerMaterial, Term};
use serde::{Deserialize, Serialize};
use sms_core::InputError;
use std::path::{Path, PathBuf};

/// The value of `kind` in a strike task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StrikeKind {
    /// The only value.
    Strike,
}

/// Strike a body so that the weighted sum of terms is smallest: "push the box off the table without moving the mug".
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Strike {
    /// Always `strike`.
    pub kind: StrikeKind,
    /// The body that the finger strikes.
    pub strike: Selector,
    /// Point on the floor that the angle 0 of the sweep points to, world x and y in metres. Default: the first other
    /// body of a `reach` or `topple` term, or else the first place to reach.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub towards_w: Option<[f64; 2]>,
    /// Simulated time, seconds from the start of the sweep.
    #[serde(default = "billiards::default_horizon_s")]
    pub horizon_s: f64,
    /// Largest sum that counts as success, metres.
    #[serde(default = "billiards::default_success_m")]
    pub success_m: f64,
    /// The parameters of an action.
    #[serde(default)]
    pub form: ActionForm,
    /// Ranges of these parameters.
    #[serde(default)]
    pub bounds: ActionBounds,
    /// The robot's finger.
    #[serde(default)]
    pub striker: StrikerMaterial,
    /// Nominal time step in seconds.
    #[serde(default = "billiards::default_dt")]
    pub dt: f64,
    /// The terms of the objective.
    pub terms: Vec<Term>,
    /// The file that the task was read from, for messages.
    #[serde(skip)]
    pub source: PathBuf,
}

impl Strike {
    /// A task with the defaults of the paper's billiards.
    pub fn new(strike: Selector, terms: Vec<Term>) -> Self {
        Self {
            kind: StrikeKind::Strike,
            strike,
            towards_w: None,
            horizon_s: billiards::default_horizon_s(),
            success_m: billiards::default_success_m(),
            form: ActionForm::default(),
            bounds: ActionBounds::default(),
            striker: StrikerMaterial::default(),
            dt: billiards::default_dt(),
            terms,
            source: PathBuf::new(),
        }
    }

    /// Checks the values without a scene.
    ///
    /// # Errors
    /// [`InputError`] that names the file and the key.
    pub fn validate(&self) -> Result<(), InputError> {
        let path = self.path();
        if let Some(why) = self.strike.fault() {
            return fault(path, "strike", &why);
        }
        if self.towards_w.is_some_and(|p| p.iter().any(|v| !v.is_finite())) {
            return fault(path, "towards_w", "it must be two finite numbers, x and y in metres");
        }
        self.common().validate(path)?;
        if self.terms.is_empty() {
            return fault(path, "terms", "it is empty; write at least one [[terms]] with a `term`");
        }
        self.terms.iter().enumerate().try_for_each(|(i, t)| t.validate(i, self.horizon_s, self.dt, path))
    }

    pub(crate) fn path(&self) -> &Path {
        billiards::named(&self.source)
    }

    pub(crate) fn common(&self) -> StrikeSettings {
        StrikeSettings {
            horizon_s: self.horizon_s,
            success_m: self.success_m,
            form: self.form,
            bounds: self.bounds,
            striker: self.striker,
            dt: self.dt,
        }
    }
}
