//! Scene and task → the plan of a landing, by search.

use super::drift_text;
use crate::Error;
use sms_core::{Seed, StageContext, Warnings};
use sms_landing::{
    Freed, LandingPlanOutcome, LandingSettings, LandingTask, ResolvedLanding, Stuck, plan_landing,
};
use sms_scene::Scene;
use sms_sim::RapierFactory;

/// A landing task resolved in a scene with a movable structure.
#[derive(Debug, Clone)]
pub struct LandingProblem {
    /// The scene with the bodies of the structure freed.
    pub scene: Scene,
    /// The task, resolved in this scene.
    pub task: ResolvedLanding,
    /// The freed bodies, if any.
    pub freed: Option<Freed>,
}

impl LandingProblem {
    /// Frees the structure and resolves the task.
    ///
    /// # Errors
    /// [`Error::Landing`] if the scene has no landing surface or the structure does not stand.
    pub fn new(
        task: &LandingTask,
        scene: Scene,
        settings: &LandingSettings,
        seed: Seed,
    ) -> Result<Self, Error> {
        let freed = task.freed(&RapierFactory, &scene, &settings.disturbances, seed)?;
        let scene = freed.as_ref().map_or(scene, |freed| freed.scene.clone());
        Ok(Self { task: task.resolve(&scene)?, scene, freed })
    }

    /// Searches for the best landing.
    ///
    /// # Errors
    /// As [`plan_landing`].
    pub fn plan(
        &self,
        settings: &LandingSettings,
        context: StageContext<'_>,
    ) -> Result<LandingPlanOutcome, Error> {
        Ok(plan_landing(&self.task, &self.scene, &RapierFactory, settings, context)?)
    }

    /// Warns about bodies that the plan freed, and about those that stay fixed.
    pub(crate) fn warn(&self, warnings: &Warnings) {
        let Some(freed) = &self.freed else { return };
        let others = if freed.other_masses {
            ", with other masses, because the structure would fall with the most likely ones"
        } else {
            ""
        };
        for body in &freed.bodies {
            let message = format!("`{body}` is fixed in the scene, but can move in this plan{others}");
            let cure = "if the real one is fixed, write `free = false` in the task";
            warnings.add("plan", "freed", message, cure);
        }
        if let Some(stuck) = &freed.stuck {
            let cure = "check its contacts in `sms report`: one is wrong, or a body is not separated";
            warnings.add("plan", "held", stuck_text(stuck), cure);
        }
        for drift in &freed.held {
            let message = format!("{}: it stays fixed and cannot topple", drift_text(drift));
            let cure = "scan it from more sides, or correct its material (`sms materials`)";
            warnings.add("plan", "held", message, cure);
        }
    }
}

/// Describes the bodies that stay fixed, and the reason.
pub fn stuck_text(stuck: &Stuck) -> String {
    let names = stuck.bodies.iter().map(|b| format!("`{b}`")).collect::<Vec<_>>().join(", ");
    let leaves = drift_text(&stuck.leaves);
    format!(
        "{names} cannot topple in this plan: fixed, because otherwise the structure does not stand ({leaves})"
    )
}
