//! The stages as functions from typed inputs to a typed result, without folders or caches.

mod chooser;
mod entities;
mod evaluate;
mod frames;
mod gaussians;
mod grow;
mod landing;
mod masks;
mod scene;
mod sensor;
mod strike;
mod tracking;

pub use chooser::{ChoiceRecord, ChosenLanding, LandingChooser, action_of, choose_landing, observation};
pub use entities::{Entities, entities, entity_metrics};
pub use evaluate::{Comparison, KnownBody, MetricNames, evaluate, known_models, known_truth};
pub use frames::{Frames, FramesRequest, frames, refined};
pub use gaussians::{GaussiansRequest, gaussians, trained_only};
pub use grow::grow;
pub use landing::{LandingProblem, stuck_text};
pub use masks::{ObjectMasks, masks};
pub use scene::{SceneRequest, drift_text, scene};
pub use sensor::{SensorErrors, sensor};
pub use strike::StrikeProblem;
pub use tracking::{EstimatedPoses, with_estimated_poses};

pub(crate) use chooser::recording;
pub(crate) use evaluate::add_drifts;
pub(crate) use tracking::recorded_poses;
