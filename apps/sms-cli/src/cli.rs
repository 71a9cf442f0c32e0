//! The command line's shape.

use clap::{Args, Parser, Subcommand, ValueEnum};
use sms_cli::front::{Common, EngineName, PathName, PresetName, RefinePoses};
use sms_pipeline::stages::LandingChooser;
use sms_pipeline::{Device, Format, MasksSource, NetworksRequest, TrackMode, VlmMode};
use std::path::PathBuf;

/// Scan, materialize, simulate: from an RGB-D recording to a simulation-ready scene and a plan.
#[derive(Debug, Parser)]
#[command(name = "sms", version, about, propagate_version = true)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub command: Command,
    #[command(flatten)]
    pub common: Common,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Check a recording: sizes, poses, units, overlap; says what to change when another reading fits better.
    Check(CheckArguments),
    /// Reconstruct a recording as 3D Gaussians with object labels.
    Scan(ScanArguments),
    /// Turn a scan into closed meshes, spheres, convex parts and materials: a simulation-ready scene.
    Materialize(MaterializeArguments),
    /// List what the objects are made of, with intervals and sources, and change it.
    Materials(MaterialsArguments),
    /// Put the scene into the physics engine and see whether it rests.
    Simulate(SimulateArguments),
    /// Search the best action for a task.
    Plan(PlanArguments),
    /// Plan the arm's motion for the planned strike, check it, and write it for the robot.
    Robot(RobotArguments),
    /// Carry the plan out in an independent target world.
    Execute(ExecuteArguments),
    /// Measure the reconstruction against known models.
    Evaluate(EvaluateArguments),
    /// Write the report page.
    Report(ReportArguments),
    /// Write the scene for another simulator.
    Export(ExportArguments),
    /// Open the report in a browser.
    View(ViewArguments),
    /// The whole flow on a generated scene.
    Demo(DemoArguments),
    /// Write a small generated recording to try the commands on.
    Sample(SampleArguments),
    /// Write a full-size generated recording: any scene of a family, as the simulated camera sees it.
    Synth(SynthArguments),
    /// List what can compute a scan, with the result of each one's self-check.
    Devices,
    /// Look at a run's masks: its objects, and with --preview the annotated first frame; or at what the networks would find.
    Masks(MasksArguments),
    /// List or fetch the weights of the networks.
    #[command(subcommand)]
    Models(ModelsArguments),
    /// Print every setting that would be in force, as a file for `--settings`.
    Settings(SettingsArguments),
}

#[derive(Debug, Args)]
pub(crate) struct MasksArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Write preview.png into the run's folder: the first frame with its masks, and the boxes and scores of what the networks
    /// found. With --objects, --box or --threshold: what they would find so, for which no masks are needed and none are changed.
    #[arg(long)]
    pub preview: bool,
    #[command(flatten)]
    pub nets: NetsArguments,
}

#[derive(Debug, Subcommand)]
pub(crate) enum ModelsArguments {
    /// The models there are, and where those that were fetched lie.
    List,
    /// Fetch models into the Hugging Face cache.
    Fetch {
        /// Names of `sms models list` (default: the two that `--masks sam2` uses).
        models: Vec<String>,
    },
}

#[derive(Debug, Args)]
pub(crate) struct CheckArguments {
    /// Folder of the recording (nerfstudio transforms.json with depth, or TUM RGB-D).
    pub recording: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum MasksName {
    /// Clusters of the fused depth; needs nothing else.
    Geometry,
    /// Label images that came with the recording.
    Files,
    /// The truth of a generated recording (ablations only).
    Truth,
    /// OWLv2 finds what --objects names in the first frame, SAM 2.1 tracks it. Needs a build with the feature `nets`.
    Sam2,
}

impl MasksName {
    /// The library's source; `nets` are the choices for networks.
    pub(crate) fn source(self, nets: &NetsArguments) -> MasksSource {
        match self {
            Self::Geometry => MasksSource::Geometry,
            Self::Files => MasksSource::Files,
            Self::Truth => MasksSource::Truth,
            Self::Sam2 => MasksSource::Networks(nets.request()),
        }
    }
}

/// How SAM 2 follows objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum TrackName {
    /// By its memory, as in the paper.
    Memory,
    /// In each image anew, with boxes carried by pose and depth: several times cheaper.
    Reprompt,
}

/// For `--masks sam2`.
#[derive(Debug, Args, Clone, Default)]
pub(crate) struct NetsArguments {
    /// What to look for, in English: --objects "mug, toy duck, cue ball" (default: things that stand on tables).
    #[arg(long, value_name = "LIST")]
    pub objects: Option<String>,
    /// A box in the first frame: --box "mug=x0,y0,x1,y1" (repeatable). Without --objects nothing else is looked for.
    #[arg(long = "box", value_name = "NAME=X0,Y0,X1,Y1")]
    pub boxes: Vec<String>,
    /// Score above which a detection counts, 0 to 1 (default: 0.2).
    #[arg(long, value_name = "SCORE")]
    pub threshold: Option<f64>,
    /// Overlap from which the lesser of two detections is dropped, 0 to 1 (default: 0.5).
    #[arg(long, value_name = "SHARE")]
    pub max_overlap: Option<f64>,
    /// How SAM 2 follows objects (default: memory on a GPU, reprompt on a CPU).
    #[arg(long, value_enum)]
    pub track: Option<TrackName>,
    /// Which SAM 2.1 (`sms models list`).
    #[arg(long, value_name = "MODEL")]
    pub sam2: Option<String>,
    /// A folder with the models' files, instead of the Hugging Face cache.
    #[arg(long, value_name = "DIR")]
    pub weights: Option<PathBuf>,
}

impl NetsArguments {
    /// The library's choices.
    pub(crate) fn request(&self) -> NetworksRequest {
        let a = self.clone();
        NetworksRequest {
            objects: a.objects,
            boxes: a.boxes,
            threshold: a.threshold,
            max_overlap: a.max_overlap,
            tracking: a.track.map(|track| match track {
                TrackName::Memory => TrackMode::Memory,
                TrackName::Reprompt => TrackMode::Reprompt,
            }),
            sam2: a.sam2,
            weights: a.weights,
        }
    }
}

#[derive(Debug, Args)]
pub(crate) struct SettingsArguments {
    /// The preset to start from (default: standard).
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct ScanArguments {
    /// Folder of the recording.
    pub recording: PathBuf,
    /// Folder of the run (made where it is missing; an interrupted run is resumed).
    #[arg(long, value_name = "RUN")]
    pub out: PathBuf,
    /// How much work to spend.
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Where object masks come from.
    #[arg(long, value_enum, default_value = "geometry")]
    pub masks: MasksName,
    #[command(flatten)]
    pub nets: NetsArguments,
    /// Correct the camera poses before the scan; `auto` keeps them where that is no improvement.
    #[arg(long, value_enum, value_name = "MODE", num_args = 0..=1, default_missing_value = "on")]
    pub refine_poses: Option<RefinePoses>,
    /// Keep every N-th frame out of training, to measure quality on it (0: none).
    #[arg(long, value_name = "N")]
    pub holdout: Option<usize>,
    /// What computes: `auto` takes a GPU where there is one, `gpu` or `gpu:N` that of `sms devices`. Networks compute there too in
    /// builds with `cuda` or `metal`.
    #[arg(long, value_name = "cpu|gpu[:N]|auto", default_value = "auto")]
    pub device: Device,
    /// Seed of everything random.
    #[arg(long)]
    pub seed: Option<u64>,
    /// The recording's up direction in its own world, where the surfaces do not tell it (any length).
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    pub up: Option<Vec<f64>>,
    /// Scan even when the check finds that the recording is wrong.
    #[arg(long)]
    pub no_check: bool,
    /// Show the scan in a Rerun viewer while it runs: in the one that listens at ADDR (host:port or rerun+http://…), else
    /// in one already open on this machine, else in a new one. Needs a build with the feature `rerun`.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, require_equals = true, default_missing_value = "auto")]
    pub live: Option<String>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct MaterializeArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// A TOML file with your own material values (`[object.NAME] class = "ceramic"`).
    #[arg(long, value_name = "FILE")]
    pub materials: Option<PathBuf>,
    /// Whether a vision-language model is asked about the objects (`[vlm]`, SMS_VLM_URL, SMS_VLM_MODEL, OPENAI_API_KEY).
    #[arg(long, value_enum, value_name = "MODE", default_value = "auto")]
    pub vlm: VlmName,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum VlmName {
    /// Ask no model.
    Off,
    /// Ask where a server is named; go on without where it does not answer.
    #[default]
    Auto,
    /// Ask, and stop where the server cannot be used.
    On,
    /// Use the replies of earlier runs of this command and make no requests.
    CacheOnly,
}

impl VlmName {
    /// The library's mode.
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
    /// Values to set, OBJECT.KEY=VALUE or OBJECT.KEY=BEST,LOW,HIGH: here `--set` means these.
    #[arg(skip)]
    pub set: Vec<String>,
    /// Take back one value that was set, or all of an object's (repeatable).
    #[arg(long, value_name = "OBJECT[.KEY]")]
    pub unset: Vec<String>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct SimulateArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Seconds to simulate.
    #[arg(long, default_value_t = 1.0)]
    pub seconds: f64,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct PlanArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// The task (TOML).
    #[arg(long, value_name = "TASK.toml")]
    pub task: PathBuf,
    /// Seed of the search (default: the run's).
    #[arg(long)]
    pub seed: Option<u64>,
    /// Worlds that differ within what is not known, in which shots are compared; 0 plans for the scanned world alone
    /// (default: the setting `plan.disturbances.worlds`).
    #[arg(long, value_name = "N")]
    pub robust: Option<usize>,
    /// Who chooses a landing: the search, or a baseline that knows nothing of wash (tasks of the kind `landing` only).
    #[arg(long, value_enum, value_name = "WHO", default_value_t = ChooserName::Ours)]
    pub chooser: ChooserName,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ChooserName {
    /// The search in simulation.
    Ours,
    /// The centre of the top face, straight there.
    Geometric,
    /// Any of fifteen sites and nine approaches.
    Random,
    /// A vision-language model that sees these on a frame (`[vlm]`, SMS_VLM_URL, SMS_VLM_MODEL, OPENAI_API_KEY).
    Visual,
}

impl ChooserName {
    /// The library's chooser.
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
    /// The world to execute in (default: physx where it is built in, else rapier, which is the planner's own engine).
    #[arg(long, value_enum)]
    pub engine: Option<EngineName>,
    /// Whose the joints of the robot's arm are.
    #[arg(long, value_enum, default_value_t = ArmName::Shared)]
    pub arm: ArmName,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ArmName {
    /// Ours, the same in every engine, which sees the tool alone.
    Shared,
    /// The engine's own articulation under the same controller (physx and physx-stock).
    Articulation,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct EvaluateArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// `objects.json` of known models; by default the truth of a generated recording.
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
    /// MuJoCo.
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
    /// Whether the name includes a format.
    pub(crate) fn includes(self, format: Format) -> bool {
        match self {
            Self::Mjcf => format == Format::Mjcf,
            Self::Urdf => format == Format::Urdf,
            Self::Sdf => format == Format::Sdf,
            Self::Usd => format == Format::Usd,
            Self::Glb => format == Format::Glb,
            Self::Obj => format == Format::Obj,
            Self::All => true,
        }
    }
}

#[derive(Debug, Args, Clone)]
pub(crate) struct RobotArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Where the base stands in the run's world: x, y, z in metres and the yaw in degrees, such as 0,0,0,0. Without it
    /// the robot that was planned for, or `robot.x_world_robot` or `robot.x_recording_robot` of the settings.
    #[arg(long, value_name = "X,Y,Z,YAW_DEG", allow_hyphen_values = true)]
    pub at: Option<String>,
    /// Writes a motion that did not pass every check, too, as program.not-executable.json and .parquet, for looking at.
    #[arg(long)]
    pub keep_failed: bool,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct ExportArguments {
    /// Folder of the run.
    pub run: PathBuf,
    /// Formats, separated by commas or given again.
    #[arg(long, value_enum, required = true, value_delimiter = ',')]
    pub format: Vec<FormatName>,
    /// Folder to write to, with one below it for each of several formats (default: RUN/export/FORMAT). It is replaced
    /// when it holds an earlier export.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct ViewArguments {
    /// Folder of the run.
    pub run: PathBuf,
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
    /// Which demo.
    #[arg(value_enum)]
    pub name: DemoName,
    /// Seed of the scene and of everything else.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Folder of the run (default: runs/NAME-SEED).
    #[arg(long, value_name = "RUN")]
    pub out: Option<PathBuf>,
    /// A smaller recording and less search: about half a minute.
    #[arg(long)]
    pub quick: bool,
    /// How much work to spend on the scan.
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Where object masks come from.
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
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum FamilyName {
    /// Two balls, a goal that a straight shot reaches, and obstacles around; endless.
    Billiards,
    /// Layouts that take rebounds, in turns by seed; endless, though some seeds do not fit into the workspace.
    Challenge,
    /// The eighteen scenes of `sms-experiments billiards`: seeds 1 to 18.
    Fixed,
    /// Structures that a quadrotor could topple by landing on them: seeds 1 to 4 are the four fixed ones (box on step ladder,
    /// tote on stool, board on recycling bin, board on stool), others are drawn, in turns; filmed from a helix.
    Landing,
}

#[derive(Debug, Args, Clone)]
pub(crate) struct SynthArguments {
    /// Folder to write (must be missing or empty, or hold the same recording unfinished).
    pub folder: PathBuf,
    /// Family of scenes.
    #[arg(long, value_enum, default_value = "billiards")]
    pub family: FamilyName,
    /// Seed of the scene and of the camera's noise.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Obstacles besides the balls (families billiards and challenge).
    #[arg(long)]
    pub objects: Option<usize>,
    /// Folder of scanned models (NAME/model.obj) to stand among the obstacles (family billiards), or in the place of box, tote,
    /// bin and stool (family landing).
    #[arg(long, value_name = "DIR")]
    pub meshes: Option<PathBuf>,
    /// Frames.
    #[arg(long, default_value_t = 60)]
    pub frames: usize,
    /// Image width in pixels; the height is 5/8 of it.
    #[arg(long, default_value_t = 1280)]
    pub width: usize,
    /// Heights of the camera's path (not of the family landing).
    #[arg(long, value_enum, default_value = "high")]
    pub path: PathName,
    /// Standard deviation of the recorded camera position per axis, millimetres.
    #[arg(long, default_value_t = 0.0)]
    pub pose_noise_mm: f64,
    /// Standard deviation of the recorded camera rotation per axis, degrees.
    #[arg(long, default_value_t = 0.0)]
    pub pose_noise_deg: f64,
}
