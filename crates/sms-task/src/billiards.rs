//! The billiards task as a file (paper section "Billiards Scenario" and its appendix).

use crate::Selector;
use serde::{Deserialize, Serialize};
use sms_core::InputError;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// The value of `kind` in a billiards task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BilliardsKind {
    /// The only value.
    Billiards,
}

/// The parameters of an action.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionForm {
    /// Speed, angle and contact position: the paper's text.
    #[default]
    SpeedAngleContact,
    /// Speed and angle, contact at the centre of the cue ball: the paper's released form.
    SpeedAngle,
}

/// A range of a parameter, `[low, high]`.
pub type ParameterRange = [f64; 2];

/// Strike the cue ball so that the target ball passes over the goal. The objective is the smallest horizontal
/// distance of the target ball's centre to the goal over the horizon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Billiards {
    /// Always `billiards`.
    pub kind: BilliardsKind,
    /// The ball that is struck.
    pub cue: Selector,
    /// The ball that has to reach the goal.
    pub target: Selector,
    /// The goal on the floor, world x and y in metres.
    pub goal_w: [f64; 2],
    /// Simulated time, seconds from the start of the sweep.
    #[serde(default = "default_horizon_s")]
    pub horizon_s: f64,
    /// Largest objective that counts as success, metres.
    #[serde(default = "default_success_m")]
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
    /// Nominal time step in seconds (paper: 0.0025).
    #[serde(default = "default_dt")]
    pub dt: f64,
    /// The file that the task was read from, for messages.
    #[serde(skip)]
    pub source: PathBuf,
}

/// Ranges of an action's parameters.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ActionBounds {
    /// Speed of the finger at the contact position, m/s (paper's baseline: 0.2 to 0.85).
    pub speed: ParameterRange,
    /// Direction of the sweep relative to the direction from cue to target ball, radians, positive to the left. Shots
    /// that rebound off an obstacle before the target ball seldom start at more than 60° from this direction.
    pub angle: ParameterRange,
    /// Contact position along the sweep relative to the centre of the cue ball, metres.
    pub along: ParameterRange,
    /// Contact position across the sweep, metres, positive to the left.
    pub across: ParameterRange,
}

impl Default for ActionBounds {
    fn default() -> Self {
        Self {
            speed: [0.2, 0.85],
            angle: [-PI / 3.0, PI / 3.0],
            along: [-0.005, 0.005],
            across: [-0.004, 0.004],
        }
    }
}

/// Surface of the striker. The robot's materials come from its model instead of the scan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StrikerMaterial {
    /// Coulomb friction coefficient.
    pub friction: f64,
    /// Coefficient of restitution.
    pub restitution: f64,
}

impl Default for StrikerMaterial {
    fn default() -> Self {
        Self { friction: 0.65, restitution: 0.75 }
    }
}

pub(crate) fn default_horizon_s() -> f64 {
    4.0
}

pub(crate) fn default_success_m() -> f64 {
    0.05
}

pub(crate) fn default_dt() -> f64 {
    0.0025
}

impl Billiards {
    /// A task with the default settings.
    pub fn new(cue: Selector, target: Selector, goal_w: [f64; 2]) -> Self {
        Self {
            kind: BilliardsKind::Billiards,
            cue,
            target,
            goal_w,
            horizon_s: default_horizon_s(),
            success_m: default_success_m(),
            form: ActionForm::default(),
            bounds: ActionBounds::default(),
            striker: StrikerMaterial::default(),
            dt: default_dt(),
            source: PathBuf::new(),
        }
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`InputError`] that names the file, the key and the allowed range.
    pub fn validate(&self) -> Result<(), InputError> {
        for (key, selector) in [("cue", &self.cue), ("target", &self.target)] {
            if let Some(why) = selector.fault() {
                return fault(self.path(), key, &why);
            }
        }
        if self.goal_w.iter().any(|v| !v.is_finite()) {
            return fault(self.path(), "goal_w", "it must be two finite numbers, x and y in metres");
        }
        self.common().validate(self.path())
    }

    /// The file name for messages.
    pub(crate) fn path(&self) -> &Path {
        named(&self.source)
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

/// The file of a task, or a placeholder for tasks without one.
pub(crate) fn named(source: &Path) -> &Path {
    if source.as_os_str().is_empty() { Path::new("(task made by the program)") } else { source }
}

/// Refuses the value of a key.
pub(crate) fn fault(path: &Path, key: &str, why: &str) -> Result<(), InputError> {
    let what = format!("`{key}` in this task file cannot be used: {why}");
    Err(InputError::new(what, path, format!("correct `{key}`")))
}

/// Settings that all strike tasks share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StrikeSettings {
    pub(crate) horizon_s: f64,
    pub(crate) success_m: f64,
    pub(crate) form: ActionForm,
    pub(crate) bounds: ActionBounds,
    pub(crate) striker: StrikerMaterial,
    pub(crate) dt: f64,
}

impl StrikeSettings {
    pub(crate) fn validate(&self, path: &Path) -> Result<(), InputError> {
        let fault = |key: &str, why: String| fault(path, key, &why);
        for (key, value, largest) in
            [("horizon_s", self.horizon_s, 60.0), ("success_m", self.success_m, 10.0), ("dt", self.dt, 0.02)]
        {
            if !(value > 0.0 && value <= largest) {
                return fault(key, format!("it must be above 0 and at most {largest}, and is {value}"));
            }
        }
        if self.dt < 1e-5 {
            return fault("dt", format!("it must be at least 0.00001, and is {}", self.dt));
        }
        let b = &self.bounds;
        for (key, [low, high], [least, most]) in [
            ("bounds.speed", b.speed, [0.01, 5.0]),
            ("bounds.angle", b.angle, [-PI, PI]),
            ("bounds.along", b.along, [-0.05, 0.05]),
            ("bounds.across", b.across, [-0.05, 0.05]),
        ] {
            if !(least <= low && low <= high && high <= most) {
                return fault(
                    key,
                    format!("it must be [low, high] within [{least:.4}, {most:.4}], and is [{low}, {high}]"),
                );
            }
        }
        if !(0.0..=10.0).contains(&self.striker.friction) {
            return fault(
                "striker.friction",
                format!("it must be 0 to 10, and is {}", self.striker.friction),
            );
        }
        if !(0.0..=1.0).contains(&self.striker.restitution) {
            let value = self.striker.restitution;
            return fault("striker.restitution", format!("it must be 0 to 1, and is {value}"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Task;

    const GOOD: &str = r#"
        kind = "billiards"
        cue = { color = "white", sphere = true }
        target = { near = [0.5, 0.1, 0.03] }
        goal_w = [0.7, 0.2]
    "#;

    fn read(text: &str) -> Result<Task, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("shot.toml");
        std::fs::write(&path, text).unwrap();
        Task::read(&path).map_err(|e| e.to_string())
    }

    #[test]
    fn a_short_file_gets_the_papers_defaults() {
        let Task::Billiards(task) = read(GOOD).unwrap() else { panic!() };
        assert_eq!((task.horizon_s, task.success_m, task.dt), (4.0, 0.05, 0.0025));
        assert_eq!(task.bounds.speed, [0.2, 0.85]);
        assert_eq!((task.striker.friction, task.striker.restitution), (0.65, 0.75));
        assert_eq!(task.form, ActionForm::SpeedAngleContact);
    }

    #[test]
    fn a_written_task_reads_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("shot.toml");
        let mut task = Billiards::new(Selector::by_name("a"), Selector::sphere_of_color("blue"), [0.1, -0.2]);
        task.form = ActionForm::SpeedAngle;
        Task::Billiards(task.clone()).write(&path).unwrap();
        task.source = path.clone();
        assert_eq!(Task::read(&path).unwrap(), Task::Billiards(task));
    }

    #[test]
    fn errors_name_the_file_and_the_key() {
        for (text, key) in [
            (format!("{GOOD}\nhorizons = 3.0"), "horizons"),
            (format!("{GOOD}\nhorizon_s = -1.0"), "horizon_s"),
            (format!("{GOOD}\nhorizon_s = nan"), "horizon_s"),
            (format!("{GOOD}\ndt = 1e-12"), "dt"),
            (format!("{GOOD}\n[bounds]\nspeed = [0.8, 0.2]"), "bounds.speed"),
            (format!("{GOOD}\n[bounds]\nspede = [0.2, 0.8]"), "spede"),
            (format!("{GOOD}\n[striker]\nrestitution = 1.5"), "striker.restitution"),
            (GOOD.replace("goal_w = [0.7, 0.2]", ""), "goal_w"),
            (GOOD.replace("0.7", "inf"), "goal_w"),
            (GOOD.replace("\"white\"", "\"wite\""), "cue"),
            (GOOD.replace("sphere = true", "ball = true"), "ball"),
            (GOOD.replace("near = [0.5, 0.1, 0.03]", ""), "target"),
            (GOOD.replace("kind = \"billiards\"", ""), "kind"),
            (GOOD.replace("\"billiards\"", "\"golf\""), "golf"),
            (GOOD.replace("goal_w =", "goal_w"), "goal_w"),
        ] {
            let message = read(&text).unwrap_err();
            assert!(message.contains(key), "{key}: {message}");
            assert!(message.contains("shot.toml") && message.contains("cure"), "{message}");
        }
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = Task::read(Path::new("nowhere/shot.toml")).unwrap_err().to_string();
        assert!(message.contains("nowhere/shot.toml"), "{message}");
    }
}
