//! Procedural scenes with their truth, and the simulated RGB-D camera that scans them.
//!
//! - [`generate_billiards`]: a seeded scene of two pool balls, a goal and household obstacles, each with its exact
//!   surface, convex pieces, true material and mass properties.
//! - [`LandingStructure`] and [`generate_landing`]: structures for a quadrotor to land on, with the loads that topple them
//!   ([`TruthScene::tipping_load_n`]); [`HelicalPath`] records them. [`landing_scene_among`] builds them with scanned models.
//! - [`CameraPath`] and [`Renderer`]: the paper's camera path, and colour, depth and labels along it; [`Sensor`] has presets of real sensors,
//!   whose errors [`DepthCamera`], [`ColorCamera`] and [`PoseErrors`] simulate.
//! - [`read_model`] and [`standing`]: a scanned, textured model on a floor; [`record_views`] records it from any camera poses.
//!   [`generate_billiards_among`] places such models among a billiards scene's obstacles.
//! - [`make_asset`], [`make_pool_ball`], [`AssetBlueprint`], [`draw_floor`] and [`TruthScene::of_objects`]: parts of other scenes.
//! - [`write_recording`]: the scan on disk, in nerfstudio's layout, with the truth beside it in `truth/`. The planner's
//!   stages read the recording only; `execute`, `evaluate` and benchmarks call [`read_truth`].
//!
//! ```
//! use sms_core::{Cancel, NoProgress, Seed};
//! use sms_synth::{BilliardsSettings, RecordingSettings, generate_billiards, read_truth, write_recording};
//!
//! let scene = generate_billiards(Seed(1), &BilliardsSettings { objects: 2, ..Default::default() });
//! let settings = RecordingSettings { frames: 2, width: 80, height: 50, ..RecordingSettings::small() };
//! let dir = tempfile::tempdir()?;
//! write_recording(&scene, &settings, dir.path(), &NoProgress, &Cancel::new())?;
//! assert_eq!(read_truth(dir.path())?, scene);
//! assert!(dir.path().join("transforms.json").exists());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod ambient;
mod assets;
mod billiards;
mod brdf;
mod bvh;
mod challenge;
mod eighteen;
mod floor;
mod floor_light;
mod landing;
mod landing_models;
mod materials;
mod model;
mod path;
mod random;
mod ray_scene;
mod recording;
mod render;
mod scanned;
mod scene;
mod sensor;
mod shading;
mod shapes;
mod skin;
mod texture;
mod tipping;

pub use assets::{AssetBlueprint, AssetKind, BALL_RADIUS_M, HollowKind, make_asset, make_pool_ball};
pub use billiards::{BilliardsSettings, generate_billiards};
pub use challenge::{Layout, generate_challenge};
pub use eighteen::{FIRST_DRAWN, FIXED_SCENES, FixedScene, billiards_scene};
pub use floor::draw_floor;
pub use landing::{LandingStructure, generate_landing, landing_scene, landing_structure};
pub use landing_models::landing_scene_among;
pub use materials::draw_material_named;
pub use model::{ModelScene, ScannedModel, read_model, standing};
pub use path::{CameraPath, HelicalPath};
pub use recording::{RecordingSettings, RecordingSummary, SceneViews, record_views, write_recording};
pub use render::{CameraModel, RenderedFrame, Renderer};
pub use scanned::{NamedModel, generate_billiards_among, read_models};
pub use scene::{
    Hollow, LandingTruth, SupportLevel, TruthFloor, TruthObject, TruthScene, bounds_w, name_uniquely, on_top,
    read_truth,
};
pub use sensor::{
    ColorCamera, DepthCamera, DepthView, FrameState, Measured, PoseErrors, Sensor, SensorModel,
};
pub use shapes::{PartedSolid, cuboid_union};
pub use skin::Skin;
pub use texture::{Pattern, Spot, Texture};
