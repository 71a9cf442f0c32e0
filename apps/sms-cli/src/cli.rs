//! Commands and arguments of `sms`.

mod masks;

pub(crate) use masks::{MasksArguments, MasksName, ModelsArguments, NetsArguments};

use clap::{Args, Parser, Subcommand, ValueEnum};
use sms_cli::front::{Common, EngineName, PathName, PosesName, PresetName, SensorName};
use sms_pipeline::stages::LandingChooser;
use sms_pipeline::{Device, Format, VlmMode};
use std::path::PathBuf;

/// Scan, materialize, simulate: from an RGB-D recording to a simulation-ready scene and a plan.
#[derive(Debug, Parser)]
#[command(name = "sms", version, about)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub command: Command,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run all stages on a recording, with one summary at the end.
    ///
    /// Scans, materializes, compares the scene with the recorded depth and simulates it; plans if a task is given, and
    /// executes the plan if the recording has a ground truth; then writes the report. Stages that are up to date are not run again, and an interrupted one is resumed.
    Run(RunArguments),
    /// List the stages of a run: complete, stale (and why) or absent; and the next commands.
    Status(StatusArguments),
    /// Rename objects of a run; without new names, list them.
    ///
    /// With --ask, a vision-language model names the objects that still have a number. Material values follow their objects. The scene has the new names after `sms materialize`.
    Name(NameArguments),
    /// Check sizes, poses, units and overlap of a recording, and suggest corrections.
    Check(CheckArguments),
    /// Reconstruct a recording as 3D Gaussians with object labels.
    Scan(ScanArguments),
    /// Turn a scan into a simulation-ready scene with meshes, exact solids and materials.
    Materialize(MaterializeArguments),
    /// List or change the materials of the objects.
    ///
    /// Every value has an interval and a source. `--set OBJECT.KEY=VALUE` or `OBJECT.KEY=BEST,LOW,HIGH` changes it.
    Materials(MaterialsArguments),
    /// Simulate the scene without any action, and measure its drift.
    Simulate(SimulateArguments),
    /// Search for the best action for a task.
    Plan(PlanArguments),
    /// Check the arm's motion for the planned strike, and write its joint program.
    Robot(RobotArguments),
    /// Execute the plan in an independent target world.
    Execute(ExecuteArguments),
    /// Compare the scene with the recorded depth, and with known models.
    Evaluate(EvaluateArguments),
    /// Write the report page.
    Report(ReportArguments),
    /// Write the scene for other simulators.
    Export(ExportArguments),
    /// Write the report and open it in a browser.
    View(ReportArguments),
    /// Run all stages on a generated scene.
    Demo(DemoArguments),
    /// Write a small generated recording for trying the commands.
    Sample(SampleArguments),
    /// Write a full-size generated recording.
    Synth(SynthArguments),
    /// List the devices that can compute a scan, and check them.
    Devices,
    /// List the objects of a run's masks, draw them, or try other detections.
    Masks(MasksArguments),
    /// List or fetch the weights of the networks.
    #[command(subcommand)]
    Models(ModelsArguments),
    /// Print all effective settings, in the format of `--settings`.
    Settings(SettingsArguments),
    /// Write shell completions and man pages into a folder.
    #[command(hide = true)]
    Manual(ManualArguments),
}

#[derive(Debug, Args)]
pub(crate) struct RunArguments {
    /// Folder of the recording.
    pub recording: PathBuf,
    /// Task file (TOML) to plan for.
    #[arg(long, value_name = "TASK.toml")]
    pub task: Option<PathBuf>,
    /// Folder of the run (default: runs/NAME, with the name of the recording).
    #[arg(long, value_name = "RUN")]
    pub out: Option<PathBuf>,
    /// Resolution and number of training steps.
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Source of the object masks.
    #[arg(long, value_enum, default_value = "geometry")]
    pub masks: MasksName,
    /// Objects to detect with --masks sam2: "mug, toy duck, cue ball".
    #[arg(long, value_name = "LIST")]
    pub objects: Option<String>,
    #[command(flatten)]
    pub poses: PosesArguments,
    /// Hold out every N-th frame to measure quality (0: none).
    #[arg(long, value_name = "N")]
    pub holdout: Option<usize>,
    /// TOML file with material values (`[object.NAME] class = "ceramic"`).
    #[arg(long, value_name = "FILE")]
    pub materials: Option<PathBuf>,
    /// Device for the scan.
    #[arg(long, value_name = "cpu|gpu[:N]|auto", default_value = "auto")]
    pub device: Device,
    /// Random seed.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
}

/// Options of the camera poses and of the check.
#[derive(Debug, Args, Clone, Default)]
pub(crate) struct PosesArguments {
    /// Camera poses of the scan; `auto` unless `[poses] mode` is set.
    #[arg(long, value_enum, value_name = "MODE")]
    pub poses: Option<PosesName>,
    /// Up direction in the recording's own world.
    ///
    /// Needed if it cannot be detected from surfaces; any length.
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    pub up: Option<Vec<f64>>,
    /// Scan even if the check finds errors in the recording.
    #[arg(long)]
    pub no_check: bool,
}

#[derive(Debug, Args)]
pub(crate) struct StatusArguments {
    /// Folder of the run.
    pub run: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct NameArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Present and new names: object_03=duck object_04=cup.
    #[arg(value_name = "OBJECT=NAME")]
    pub names: Vec<String>,
    /// Ask a vision-language model for names and descriptions of all other objects that still have a number (`object_NN`).
    ///
    /// Configured with `[vlm]`, SMS_VLM_URL, SMS_VLM_MODEL and OPENAI_API_KEY. One picture of each object is sent to that
    /// server.
    #[arg(long)]
    pub ask: bool,
}

#[derive(Debug, Args)]
pub(crate) struct CheckArguments {
    /// Folder of the recording (nerfstudio transforms.json with depth, or TUM RGB-D).
    pub recording: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct SettingsArguments {
    /// Preset to start from (default: standard).
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct ScanArguments {
    /// Folder of the recording.
    pub recording: PathBuf,
    /// Folder of the run (created if missing; resumed if interrupted).
    #[arg(long, value_name = "RUN")]
    pub out: PathBuf,
    /// Resolution and number of training steps.
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Source of the object masks.
    #[arg(long, value_enum, default_value = "geometry")]
    pub masks: MasksName,
    #[command(flatten)]
    pub nets: NetsArguments,
    #[command(flatten)]
    pub poses: PosesArguments,
    /// Hold out every N-th frame to measure quality (0: none).
    #[arg(long, value_name = "N")]
    pub holdout: Option<usize>,
    /// Device for the scan.
    ///
    /// `auto` uses a GPU if one is available; `gpu` or `gpu:N` selects one from `sms devices`. Builds with `cuda` or
    /// `metal` run the networks there, too.
    #[arg(long, value_name = "cpu|gpu[:N]|auto", default_value = "auto")]
    pub device: Device,
    /// Random seed.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Wait for frames while the recording is made, until none has arrived for SECONDS (10).
    ///
    /// A map grows from the frames as they arrive: progress shows how well it agrees with each, and --live shows the map. The scan of the
    /// complete recording follows and has the same result as without this option.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, default_missing_value = "10")]
    pub follow: Option<f64>,
    /// Show the scan in a Rerun viewer (feature `rerun`).
    ///
    /// In the viewer at ADDR (host:port or rerun+http://…), else one already open on this machine, else a new one.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, require_equals = true, default_missing_value = "auto")]
    pub live: Option<String>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct MaterializeArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// TOML file with material values (`[object.NAME] class = "ceramic"`).
    #[arg(long, value_name = "FILE")]
    pub materials: Option<PathBuf>,
    /// Use of a vision-language model to estimate materials.
    ///
    /// Configured with `[vlm]`, SMS_VLM_URL, SMS_VLM_MODEL and OPENAI_API_KEY.
    #[arg(long, value_enum, value_name = "MODE", default_value = "auto")]
    pub vlm: VlmName,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum VlmName {
    /// Use no model.
    Off,
    /// Use a model if a server is configured; continue without it if the server does not answer.
    #[default]
    Auto,
    /// Use a model; fail if the server cannot be used.
    On,
    /// Use stored replies and make no requests.
    CacheOnly,
}

impl VlmName {
    /// Returns the library's mode.
    pub(crate) fn mode(self) -> VlmMode {
        match self {
            Self::Off => VlmMode::Off,
            Self::Auto => VlmMode::Auto,
            Self::On => VlmMode::On,
            Self::CacheOnly => VlmMode::CacheOnly,
        }
    }
}

#[derive(Debug, Args, Clone)]
pub(crate) struct MaterialsArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Values to set with `--set`: OBJECT.KEY=VALUE or OBJECT.KEY=BEST,LOW,HIGH.
    #[arg(skip)]
    pub set: Vec<String>,
    /// Reset one value, or all values of an object (repeatable).
    #[arg(long, value_name = "OBJECT[.KEY]")]
    pub unset: Vec<String>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct SimulateArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Simulated time, seconds.
    #[arg(long, value_name = "S", default_value_t = 1.0)]
    pub seconds: f64,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct PlanArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Task file (TOML).
    #[arg(long, value_name = "TASK.toml")]
    pub task: PathBuf,
    /// Seed of the search (default: that of the run).
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Number of perturbed worlds in which actions are compared.
    ///
    /// 0 plans for the scanned world alone. The default is the setting `plan.disturbances.worlds`.
    #[arg(long, value_name = "N")]
    pub robust: Option<usize>,
    /// Method that chooses a landing (tasks of kind `landing` only).
    ///
    /// The search, or a baseline without a model of the wash.
    #[arg(long, value_enum, value_name = "WHO", default_value_t = ChooserName::Ours)]
    pub chooser: ChooserName,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ChooserName {
    /// Search in simulation.
    Ours,
    /// Centre of the top face with a straight approach.
    Geometric,
    /// Random choice among up to fifteen sites with nine approaches each.
    Random,
    /// Choice of a vision-language model that sees them on a frame (`[vlm]`, SMS_VLM_URL, SMS_VLM_MODEL, OPENAI_API_KEY).
    Visual,
}

impl ChooserName {
    /// Returns the library's chooser.
    pub(crate) fn chooser(self) -> LandingChooser {
        match self {
            Self::Ours => LandingChooser::Search,
            Self::Geometric => LandingChooser::Geometric,
            Self::Random => LandingChooser::Random,
            Self::Visual => LandingChooser::Visual,
        }
    }
}

#[derive(Debug, Args, Clone)]
pub(crate) struct ExecuteArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Engine of the target world.
    ///
    /// By default physx if it is built in, else rapier, the planner's own engine.
    #[arg(long, value_enum, value_name = "NAME")]
    pub engine: Option<EngineName>,
    /// Simulation of the arm's joints.
    #[arg(long, value_enum, default_value_t = ArmName::Shared)]
    pub arm: ArmName,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ArmName {
    /// The same joint simulation for every engine; the engine contains the tool only.
    Shared,
    /// The engine's own articulation with the same controller (physx and physx-stock).
    Articulation,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct EvaluateArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// `objects.json` with known models (default: a generated truth).
    #[arg(long, value_name = "FILE")]
    pub objects: Option<PathBuf>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct ReportArguments {
    /// Folder of the run.
    pub run: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum FormatName {
    /// MJCF for MuJoCo.
    Mjcf,
    /// One URDF per body, with a loader for PyBullet.
    Urdf,
    /// SDFormat world for Gazebo.
    Sdf,
    /// OpenUSD with physics schemas, for Isaac Sim and Omniverse.
    Usd,
    /// glTF 2.0 binary: the scene and each object.
    Glb,
    /// Wavefront OBJ: the scene, each object and its convex parts.
    Obj,
    /// Every format.
    All,
}

impl FormatName {
    /// Returns whether the name includes `format`.
    pub(crate) fn includes(self, format: Format) -> bool {
        self == Self::All || self.to_possible_value().is_some_and(|value| value.get_name() == format.name())
    }
}

#[derive(Debug, Args, Clone)]
pub(crate) struct RobotArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Pose of the base: x, y, z in metres and yaw in degrees.
    ///
    /// In the run's world, such as 0,0,0,0. By default that of the planned robot, or `robot.x_world_robot` or
    /// `robot.x_recording_robot` in the settings.
    #[arg(long, value_name = "X,Y,Z,YAW_DEG", allow_hyphen_values = true)]
    pub at: Option<String>,
    /// Also write a motion that fails a check, for inspection.
    ///
    /// As program.not-executable.json and .parquet.
    #[arg(long)]
    pub keep_failed: bool,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct ExportArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Formats, separated by commas (repeatable).
    #[arg(long, value_enum, required = true, value_delimiter = ',')]
    pub format: Vec<FormatName>,
    /// Output folder (default: RUN/export/FORMAT).
    ///
    /// With one subfolder per format if several are given. An earlier export is replaced.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum DemoName {
    /// Strike the cue ball so that the target ball passes over the goal.
    Billiards,
    /// Land a quadrotor on a structure that its wash could topple (seeds 1 to 4 are the fixed structures).
    Landing,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct DemoArguments {
    /// Name of the demo.
    #[arg(value_enum)]
    pub name: DemoName,
    /// Seed of the scene and of all stages.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Folder of the run (default: runs/NAME-SEED, with --quick runs/NAME-SEED-quick).
    #[arg(long, value_name = "RUN")]
    pub out: Option<PathBuf>,
    /// Use a smaller recording and less search: half a minute for billiards, a minute for landing.
    #[arg(long)]
    pub quick: bool,
    /// Sensor of the recording; `--set recording.sensor.…` changes its errors.
    #[arg(long, value_enum, value_name = "NAME", default_value = "gemini2")]
    pub sensor: SensorName,
    /// Resolution and number of training steps of the scan.
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Source of the object masks.
    #[arg(long, value_enum, default_value = "geometry")]
    pub masks: MasksName,
    /// Show the scan in a Rerun viewer while it runs (as `sms scan --live`).
    #[arg(long, value_name = "ADDR", num_args = 0..=1, require_equals = true, default_missing_value = "auto")]
    pub live: Option<String>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct SampleArguments {
    /// Folder to write (must be missing or empty).
    pub folder: PathBuf,
    /// Seed of the scene.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum FamilyName {
    /// Two balls, a goal within reach of a straight shot, and obstacles; any seed.
    Billiards,
    /// Layouts that need rebounds, alternating by seed; some seeds do not fit into the workspace.
    Challenge,
    /// The eighteen scenes of `sms-experiments billiards`; seeds 1 to 18.
    Fixed,
    /// Structures that a landing quadrotor could topple, recorded from a helix. Seeds 1 to 4 are fixed (box on step ladder, tote
    /// on stool, board on recycling bin, board on stool); other seeds draw random variants of them in turn.
    Landing,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct SynthArguments {
    /// Folder to write (missing, empty, or with the same recording unfinished).
    pub folder: PathBuf,
    /// Family of scenes.
    #[arg(long, value_enum, default_value = "billiards")]
    pub family: FamilyName,
    /// Seed of the scene and of the camera noise.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Obstacles besides the balls (families billiards and challenge).
    #[arg(long, value_name = "N")]
    pub objects: Option<usize>,
    /// Folder of scanned models (NAME/model.obj).
    ///
    /// They become obstacles (family billiards) or replace box, tote, bin and stool (family landing).
    #[arg(long, value_name = "DIR")]
    pub meshes: Option<PathBuf>,
    /// Sensor of the recording: its image size, field of view and errors.
    ///
    /// `--set recording.sensor.…` changes single errors, such as `--set recording.sensor.depth.missing_share=0.5`.
    #[arg(long, value_enum, value_name = "NAME", default_value = "gemini2")]
    pub sensor: SensorName,
    /// Number of frames (default: 60).
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Image width in pixels (default: the sensor's); the height follows from it.
    #[arg(long, value_name = "PX")]
    pub width: Option<usize>,
    /// Heights of the camera path (not for the family landing).
    #[arg(long, value_enum, default_value = "high")]
    pub path: PathName,
    /// Standard deviation of the camera position, millimetres.
    ///
    /// Of the recorded position, per axis.
    #[arg(long, value_name = "MM", default_value_t = 0.0)]
    pub pose_noise_mm: f64,
    /// Standard deviation of the camera rotation, degrees.
    ///
    /// Of the recorded rotation, per axis.
    #[arg(long, value_name = "DEG", default_value_t = 0.0)]
    pub pose_noise_deg: f64,
}

#[derive(Debug, Args)]
pub(crate) struct ManualArguments {
    /// Folder that receives `completions/` and `man/`; it is created.
    pub folder: PathBuf,
}
