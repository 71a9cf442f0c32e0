//! Entities and materials → a scene that can be simulated.

use crate::Error;
use glamx::DPose3;
use sms_core::{StageContext, length_text};
use sms_entities::EntitySet;
use sms_materials::{MaterialTable, ObjectQuery, Overrides, assign};
use sms_scene::{Scene, build_scene};
use sms_sim::{RapierFactory, RestLimits, RestingDrift, fix_restless};

/// Inputs of [`scene`] in addition to the entities.
#[derive(Debug, Clone, Copy)]
pub struct SceneRequest<'a> {
    /// Name of the scene.
    pub name: &'a str,
    /// Material queries of the entities, followed by the floor.
    pub queries: &'a [ObjectQuery],
    /// Material values of the user.
    pub overrides: Option<&'a Overrides>,
    /// Standard deviation of sizes and distances, as a share; 0 if unknown.
    pub size_sigma: f64,
    /// Maps the recording's world to the scene's.
    pub x_world_recording: DPose3,
    /// Whether to fix bodies that do not stay at rest. Masks from geometry may cut an object into pieces that do not
    /// stand alone; other masks are assumed to be correct.
    pub fix_restless: bool,
}

/// Assigns materials and builds the scene.
///
/// # Errors
/// [`Error::Build`] for impossible bodies, [`Error::Sim`] if the scene cannot be simulated.
pub fn scene(set: &EntitySet, request: &SceneRequest<'_>, context: StageContext<'_>) -> Result<Scene, Error> {
    let SceneRequest { name, queries, overrides, x_world_recording, .. } = *request;
    let mut materials = assign(queries, &MaterialTable::builtin(), overrides, context.warnings)?;
    let floor = materials.pop();
    let support = set.support_height.zip(floor);
    let mut scene = build_scene(name, &set.entities, &materials, support, x_world_recording)?;
    scene.size_sigma = request.size_sigma;
    if request.fix_restless {
        for drift in fix_restless(&RapierFactory, &mut scene, &RestLimits::default())? {
            let message = format!("{}: it becomes a fixed collider", drift_text(&drift));
            let cure = "correct the masks, or scan it from more sides";
            context.warnings.add("materialize", "kept_fixed", message, cure);
        }
    }
    Ok(scene)
}

/// Describes the drift of a body at rest.
pub fn drift_text(drift: &RestingDrift) -> String {
    let (moved, degrees) = (length_text(drift.moved_m), drift.turned_rad.to_degrees());
    format!("`{}` moved {moved} and turned {degrees:.1}° in a simulation at rest", drift.body)
}
