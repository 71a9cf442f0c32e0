//! Objects before they are meshed.

use crate::config::EntitiesConfig;
use crate::support::{RestingPlane, Surroundings};
use crate::views::Views;
use sms_core::{LabelInfo, PointCloud};
use sms_mesh::SphereFit;

/// Name of the stage in warnings.
pub(crate) const STAGE: &str = "materialize";

/// An object before it is meshed.
pub(crate) struct Draft {
    pub(crate) info: LabelInfo,
    pub(crate) cloud: PointCloud,
    /// Points with the object's label below its supporting face.
    pub(crate) below: PointCloud,
    /// Distance between neighbouring points of the cloud, metres.
    pub(crate) spacing: f64,
    pub(crate) rest: RestingPlane,
    pub(crate) sphere: Option<SphereFit>,
    /// Whether the object is static: it only seems to float, and would fall in a simulation.
    pub(crate) fixed: bool,
}

/// Inputs that all objects of a scene share.
#[derive(Clone, Copy)]
pub(crate) struct SceneInputs<'a> {
    pub(crate) views: &'a Views<'a>,
    pub(crate) around: &'a Surroundings,
    /// Height of the level plane that carries the scene, metres.
    pub(crate) support_height: Option<f64>,
    pub(crate) config: &'a EntitiesConfig,
}
