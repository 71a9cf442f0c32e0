//! Scene and task → the plan of a landing, by the search.

use super::drift_text;
use crate::Error;
use sms_core::{Seed, StageContext, Warnings};
use sms_landing::{
    Freed, LandingPlanOutcome, LandingSettings, LandingTask, ResolvedLanding, Stuck, plan_landing,
};
use sms_scene::Scene;
use sms_sim::RapierFactory;

/// A landing task resolved in a scene in which the structure can topple.
#[derive(Debug, Clone)]
pub struct LandingProblem {
    /// The scene, with the bodies of the structure free to move.
    pub scene: Scene,
    /// The task in it.
    pub task: ResolvedLanding,
    /// The bodies that were freed, where there are any.
    pub freed: Option<Freed>,
}

impl LandingProblem {
    /// Frees the structure and resolves the task.
    ///
    /// # Errors
    /// [`Error::Landing`] when the scene has no place to land or the structure does not stand.
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

    /// Searches the best landing.
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

    /// Warns about bodies that can move in the plan but not in the scene, and about those that still cannot.
    pub(crate) fn warn(&self, warnings: &Warnings) {
        let Some(freed) = &self.freed else { return };
        let others = if freed.other_masses {
            ", with masses within their intervals, because the structure would fall with the most likely ones"
        } else {
            ""
        };
        for body in &freed.bodies {
            let message = format!("`{body}` is fixed in the scene; here it can move, and topple{others}");
            let cure = "if it is fixed in truth, write `free = false` in the task";
            warnings.add("plan", "freed", message, cure);
        }
        if let Some(stuck) = &freed.stuck {
            let cure = "see what it touches in `sms report`: perhaps a body that was not separated from it, or a wrong contact";
            warnings.add("plan", "held", stuck_text(stuck), cure);
        }
        for drift in &freed.held {
            let message = format!("{}: it stays fixed, and cannot topple", drift_text(drift));
            let cure = "scan it from more sides, or correct its material (`sms materials`)";
            warnings.add("plan", "held", message, cure);
        }
    }
}

/// Returns in words which bodies stay fixed, and why.
pub fn stuck_text(stuck: &Stuck) -> String {
    let names = stuck.bodies.iter().map(|b| format!("`{b}`")).collect::<Vec<_>>().join(", ");
    let leaves = drift_text(&stuck.leaves);
    format!(
        "{names} cannot topple in this plan: fixed, because the structure does not stand otherwise ({leaves})"
    )
}
