//! The landing task's file (paper section "Quadrotor Landing Scenario" and its appendix).

use crate::LandingError;
use serde::{Deserialize, Serialize};
use sms_core::{CoreError, InputError, Ranges, atomic};
use sms_robots::{FlightSettings, Quadrotor};
use std::path::{Path, PathBuf};

/// Value that leaves a choice to the program.
const AUTO: &str = "auto";

/// The value of `kind` in a landing task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LandingKind {
    /// The only value.
    #[default]
    Landing,
}

/// The task of landing a quadrotor on a structure without toppling it. The objective sums the displacements and
/// rotations of the structure's bodies and the vehicle's distance from the landing point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LandingTask {
    /// Always `landing`.
    pub kind: LandingKind,
    /// Start of the flight, world x and y, metres; [`FlightSettings::height`] sets its height.
    pub start_w: [f64; 2],
    /// The body to land on; `auto` chooses the body with the largest level surface that is high enough.
    #[serde(default = "auto")]
    pub platform: String,
    /// The bodies that must stay in place; `["auto"]` chooses every dynamic body that touches the platform, directly or
    /// through others.
    #[serde(default = "auto_list")]
    pub structure: Vec<String>,
    /// Whether to free the parts of the structure that the scan fixed because they did not rest (see
    /// [`LandingTask::freed`]).
    #[serde(default = "yes")]
    pub free: bool,
    /// A vehicle file (TOML, see [`Quadrotor`]), relative to the task file; without it, the paper's vehicle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vehicle: Option<PathBuf>,
    /// Settings of the flight.
    #[serde(default)]
    pub flight: FlightSettings,
    /// Ranges of the approach.
    #[serde(default)]
    pub bounds: LandingBounds,
    /// Requirements on the landing surface.
    #[serde(default)]
    pub surface: SurfaceLimits,
    /// Conditions of success.
    #[serde(default)]
    pub success: LandingSuccess,
    /// Surface of the vehicle's feet.
    #[serde(default)]
    pub feet: FootMaterial,
    /// Nominal time step in seconds.
    #[serde(default = "default_dt")]
    pub dt: f64,
    /// The file this was read from, for messages and for the vehicle's file.
    #[serde(skip)]
    pub source: PathBuf,
}

/// Ranges of an approach's parameters (paper: 0.5 to 2.5 m, 0 to 2π).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandingBounds {
    /// Distance of the approach point from the landing point, metres.
    pub approach_radius: [f64; 2],
    /// Direction of the approach point from the landing point, about z from x, radians.
    pub approach_angle: [f64; 2],
}

impl Default for LandingBounds {
    fn default() -> Self {
        Self { approach_radius: [0.5, 2.5], approach_angle: [0.0, std::f64::consts::TAU] }
    }
}

/// Requirements on a landing surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceLimits {
    /// Smallest height above the floor, metres.
    pub height_m: f64,
    /// Largest angle to the horizontal, radians.
    pub slope_rad: f64,
}

impl Default for SurfaceLimits {
    fn default() -> Self {
        Self { height_m: 0.5, slope_rad: 8f64.to_radians() }
    }
}

/// Conditions of a successful landing, and the time of the judgement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LandingSuccess {
    /// Time from motor cut to the judgement, seconds.
    pub after_s: f64,
    /// Largest displacement of a body of the structure, metres.
    pub moved_m: f64,
    /// Largest rotation of a body of the structure, radians.
    pub turned_rad: f64,
    /// Largest distance of the resting vehicle from the landing point, metres.
    pub landing_m: f64,
    /// Largest angle of the vehicle's axis to the vertical, radians.
    pub tilt_rad: f64,
    /// Largest speed of a vehicle at rest, m/s.
    pub rest_speed: f64,
}

impl Default for LandingSuccess {
    fn default() -> Self {
        Self {
            after_s: 3.0,
            moved_m: 0.05,
            turned_rad: 10f64.to_radians(),
            landing_m: 0.2,
            tilt_rad: 15f64.to_radians(),
            rest_speed: 0.02,
        }
    }
}

/// Surface of the vehicle's feet: rubber pads. A contact pair uses the mean of both surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FootMaterial {
    /// Coulomb friction coefficient.
    pub friction: f64,
    /// Coefficient of restitution.
    pub restitution: f64,
}

impl Default for FootMaterial {
    fn default() -> Self {
        Self { friction: 0.7, restitution: 0.2 }
    }
}

fn auto() -> String {
    AUTO.to_owned()
}

fn auto_list() -> Vec<String> {
    vec![auto()]
}

fn yes() -> bool {
    true
}

fn default_dt() -> f64 {
    0.0025
}

impl LandingTask {
    /// Returns a task with default settings that starts at this point (world x and y, metres).
    pub fn new(start_w: [f64; 2]) -> Self {
        Self {
            kind: LandingKind::Landing,
            start_w,
            platform: auto(),
            structure: auto_list(),
            free: true,
            vehicle: None,
            flight: FlightSettings::default(),
            bounds: LandingBounds::default(),
            surface: SurfaceLimits::default(),
            success: LandingSuccess::default(),
            feet: FootMaterial::default(),
            dt: default_dt(),
            source: PathBuf::new(),
        }
    }

    /// Returns whether the `kind` of a task file is `landing`; `false` for files that are not TOML.
    pub fn is_landing(path: &Path) -> bool {
        atomic::read_toml::<toml::Table>(path)
            .is_ok_and(|table| table.get("kind").and_then(toml::Value::as_str) == Some("landing"))
    }

    /// Reads and checks a task file (TOML).
    ///
    /// # Errors
    /// [`CoreError::Input`] that names the file and the key.
    pub fn read(path: &Path) -> Result<Self, CoreError> {
        let mut task: Self = atomic::read_toml_as(path, "task file")?;
        task.source = path.to_owned();
        task.validate()?;
        Ok(task)
    }

    /// Writes the task as TOML with all its settings, defaults included.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn write(&self, path: &Path) -> Result<(), CoreError> {
        let text = toml::to_string(self)
            .map_err(|e| CoreError::Write { path: path.to_owned(), source: std::io::Error::other(e) })?;
        atomic::write_bytes(path, text.as_bytes())
    }

    /// Returns the path for messages.
    pub fn path(&self) -> &Path {
        if self.source.as_os_str().is_empty() {
            Path::new("(task made by the program)")
        } else {
            &self.source
        }
    }

    /// Whether the program chooses the platform.
    pub(crate) fn chooses_platform(&self) -> bool {
        self.platform == AUTO
    }

    /// Whether the program chooses the structure.
    pub(crate) fn chooses_structure(&self) -> bool {
        self.structure == [AUTO]
    }

    /// Reads the vehicle.
    ///
    /// # Errors
    /// [`LandingError::Input`] if its file cannot be read or does not describe a vehicle.
    pub fn quadrotor(&self) -> Result<Quadrotor, LandingError> {
        let Some(name) = &self.vehicle else { return Ok(Quadrotor::default()) };
        let path = self.source.parent().unwrap_or(Path::new("")).join(name);
        let text = std::fs::read_to_string(&path).map_err(|e| {
            InputError::new("this vehicle file cannot be read", &path, "correct `vehicle`, or leave it out")
                .because(e)
        })?;
        Quadrotor::from_toml(&text).map_err(|e| {
            InputError::new(
                "this vehicle file cannot be used",
                &path,
                "correct the file, or leave `vehicle` out",
            )
            .because(e)
            .into()
        })
    }

    /// Checks the values.
    ///
    /// # Errors
    /// [`InputError`] that names the file, the key and the allowed range.
    pub fn validate(&self) -> Result<(), InputError> {
        let named = |e: InputError| e.at_path(self.path());
        let (f, b, s) = (&self.flight, &self.bounds, &self.success);
        let pi = std::f64::consts::PI;
        for (section, key, value, low, high) in [
            ("task", "start_w[0]", self.start_w[0], -1e3, 1e3),
            ("task", "start_w[1]", self.start_w[1], -1e3, 1e3),
            ("task", "dt", self.dt, 1e-5, 0.01),
            ("flight", "speed", f.speed, 0.05, 5.0),
            ("flight", "descent_speed", f.descent_speed, 0.02, 2.0),
            ("flight", "height", f.height, 0.05, 3.0),
            ("flight", "cut_height", f.cut_height, 0.0, f.height),
            ("bounds", "approach_radius[0]", b.approach_radius[0], 0.0, 100.0),
            ("bounds", "approach_radius[1]", b.approach_radius[1], b.approach_radius[0], 100.0),
            ("bounds", "approach_angle[0]", b.approach_angle[0], -4.0 * pi, 4.0 * pi),
            ("bounds", "approach_angle[1]", b.approach_angle[1], b.approach_angle[0], 4.0 * pi),
            ("surface", "height_m", self.surface.height_m, 0.0, 100.0),
            ("surface", "slope_rad", self.surface.slope_rad, 0.0, 0.5 * pi),
            ("success", "after_s", s.after_s, 0.1, 60.0),
            ("success", "moved_m", s.moved_m, 1e-4, 10.0),
            ("success", "turned_rad", s.turned_rad, 1e-4, pi),
            ("success", "landing_m", s.landing_m, 1e-4, 10.0),
            ("success", "tilt_rad", s.tilt_rad, 1e-4, pi),
            ("success", "rest_speed", s.rest_speed, 1e-5, 10.0),
            ("feet", "friction", self.feet.friction, 0.0, 10.0),
            ("feet", "restitution", self.feet.restitution, 0.0, 1.0),
        ] {
            Ranges::of(section).within(key, value, low, high).map_err(named)?;
        }
        if self.structure.is_empty() {
            return Err(InputError::new(
                "`structure` in this task file is empty",
                self.path(),
                "name the bodies that must stay in place, or write structure = [\"auto\"]",
            ));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<LandingTask, String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("land.toml");
        std::fs::write(&path, text).unwrap();
        LandingTask::read(&path).map_err(|e| e.to_string())
    }

    const GOOD: &str = "kind = \"landing\"\nstart_w = [2.0, 0.0]\n";

    #[test]
    fn a_short_file_gets_the_defaults_and_reads_back() {
        let task = read(GOOD).unwrap();
        assert_eq!((task.flight.height, task.success.after_s, task.dt), (0.35, 3.0, 0.0025));
        assert!(task.chooses_platform() && task.chooses_structure());
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("land.toml");
        task.write(&path).unwrap();
        assert!(LandingTask::is_landing(&path));
        let again = LandingTask::read(&path).unwrap();
        assert_eq!(again, LandingTask { source: path, ..task });
    }

    #[test]
    fn the_kind_is_one_of_those_that_errors_list() {
        let kind = toml::Value::try_from(LandingKind::Landing).unwrap();
        assert!(sms_task::TASK_KINDS.contains(&kind.as_str().unwrap()));
    }

    #[test]
    fn faults_name_the_file_and_the_key() {
        for (text, key) in [
            (GOOD.replace("2.0", "nan"), "start_w[0]"),
            (format!("{GOOD}heigth = 1.0"), "heigth"),
            (format!("{GOOD}structure = []"), "structure"),
            (format!("{GOOD}[flight]\ncut_height = 0.5"), "flight.cut_height"),
            (format!("{GOOD}[bounds]\napproach_radius = [2.0, 1.0]"), "approach_radius[1]"),
            (format!("{GOOD}[success]\nmoved_m = -1.0"), "success.moved_m"),
            (GOOD.replace("landing", "golf"), "golf"),
            (GOOD.replace("start_w = [2.0, 0.0]", ""), "start_w"),
        ] {
            let message = read(&text).unwrap_err();
            assert!(message.contains(key) && message.contains("land.toml"), "{key}: {message}");
        }
    }

    #[test]
    fn a_vehicle_file_is_read_beside_the_task_and_its_faults_are_told() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("land.toml");
        std::fs::write(&path, format!("{GOOD}vehicle = \"v.toml\"")).unwrap();
        let task = LandingTask::read(&path).unwrap();
        assert!(task.quadrotor().unwrap_err().to_string().contains("v.toml"));
        std::fs::write(dir.path().join("v.toml"), "mass = 1.0").unwrap();
        let message = task.quadrotor().unwrap_err().to_string();
        assert!(message.contains("v.toml") && message.contains("missing field"), "{message}");
    }
}
