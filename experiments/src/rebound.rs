//! The paper's Scene D in small: whether an object can be rebounded off depends on what it is made of.

use crate::BenchError;
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{
    Cancel, Interval, Material, Mesh, NoProgress, Property, PropertySource, Seed, Warnings,
    box_mass_properties, sphere_mass_properties,
};
use sms_plan::{Plan, PlanConfig, PlanError, plan};
use sms_scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene, floor_body};
use sms_sim::RapierFactory;
use sms_task::{Billiards, ResolvedTask, Selector, Task};

/// Radius of the balls, metres.
const RADIUS: f64 = 0.0286;

/// What the statue of the rebound scene is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StatueMaterial {
    /// Solid brass: 19 kg.
    Brass,
    /// An empty carton: 0.24 kg.
    Cardboard,
}

impl StatueMaterial {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Brass, Self::Cardboard];

    /// The word in tables and keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Brass => "brass",
            Self::Cardboard => "cardboard",
        }
    }

    /// Handbook values of the two classes.
    fn material(self) -> Material {
        match self {
            Self::Brass => material("brass", [8500.0, 8300.0, 8750.0], 1.0, [0.35, 0.28, 0.42], 0.5),
            Self::Cardboard => material("cardboard", [600.0, 500.0, 700.0], 0.18, [0.45, 0.36, 0.54], 0.3),
        }
    }
}

fn material(
    class: &str,
    density: [f64; 3],
    fill_factor: f64,
    friction: [f64; 3],
    restitution: f64,
) -> Material {
    let known =
        |[best, low, high]: [f64; 3]| Property::new(Interval::new(best, low, high), PropertySource::Table);
    let within = |best: f64, share: f64| known([best, (1.0 - share) * best, (1.0 + share) * best]);
    Material {
        class: class.into(),
        density: known(density),
        friction: known(friction),
        restitution: within(restitution, 0.05),
        rolling_m: within(2e-4, 0.3),
        youngs_modulus_pa: within(1e9, 0.1),
        fill_factor: within(fill_factor, 0.0),
        poissons_ratio: within(0.34, 0.1),
    }
}

fn body(name: &str, p_w: DVec3, shape: BodyShape, color: [u8; 3], material: Material) -> Body {
    let density = material.effective_density();
    let (mass, visual) = match &shape {
        BodyShape::Sphere { radius } => {
            (sphere_mass_properties(DVec3::ZERO, *radius, density).ok(), Mesh::icosphere(*radius, 3))
        }
        BodyShape::Box { half_extents } => {
            (box_mass_properties(*half_extents, density).ok(), Mesh::cuboid(*half_extents))
        }
        _ => (None, Mesh::default()),
    };
    Body {
        name: name.into(),
        description: name.into(),
        kind: BodyKind::Dynamic,
        x_wb: DPose3::from_translation(p_w),
        shape,
        visual,
        mass,
        color,
        ..floor_body(0.0, material)
    }
}

/// A post stands between the target ball and the goal, so that no direct shot comes nearer than a decimetre; a statue
/// beside the way sends the target ball there, if it is heavy enough to stay where it is.
///
/// # Errors
/// [`BenchError`] when the task cannot be resolved.
pub fn rebound_scene(statue: StatueMaterial) -> Result<(Scene, ResolvedTask), BenchError> {
    // Balls without friction: the target ball leaves along the line of centres.
    let resin = material("phenolic_resin", [1750.0, 1660.0, 1840.0], 1.0, [0.0, 0.0, 0.0], 0.92);
    let stuff = |friction: f64| material("wood", [700.0, 600.0, 800.0], 1.0, [friction; 3], 0.4);
    let sphere = || BodyShape::Sphere { radius: RADIUS };
    let post = BodyShape::Box { half_extents: DVec3::new(0.02, 0.035, 0.05) };
    let carved = BodyShape::Box { half_extents: DVec3::new(0.07, 0.05, 0.08) };
    let post = body("post", DVec3::new(0.77, 0.0, 0.05), post, [90, 90, 90], stuff(0.3));
    let scene = Scene {
        version: SCENE_VERSION,
        name: format!("rebound off {}", statue.as_str()),
        gravity_w: DVec3::new(0.0, 0.0, -9.81),
        x_world_recording: DPose3::identity(),
        bodies: vec![
            floor_body(0.0, stuff(0.4)),
            body("white", DVec3::new(0.3, 0.0, RADIUS), sphere(), [235, 232, 225], resin.clone()),
            body("blue", DVec3::new(0.6, 0.0, RADIUS), sphere(), [30, 60, 180], resin),
            Body { kind: BodyKind::Static, mass: None, ..post },
            body("statue", DVec3::new(0.76, 0.22, 0.08), carved, [181, 146, 58], statue.material()),
        ],
    };
    let (cue, target) = (Selector::by_name("white"), Selector::by_name("blue"));
    let task = Task::Billiards(Billiards::new(cue, target, [0.9, 0.0]));
    let task = task.resolve(&scene).map_err(PlanError::from)?;
    Ok((scene, task))
}

/// Plans the shot in both scenes.
///
/// # Errors
/// [`BenchError`]: bad settings, or interruption.
pub fn run_rebound(
    config: &PlanConfig,
    seed: Seed,
    cancel: &Cancel,
) -> Result<Vec<(StatueMaterial, Plan)>, BenchError> {
    let planned = |statue: StatueMaterial| {
        let (scene, task) = rebound_scene(statue)?;
        let warnings = Warnings::new();
        let outcome = plan(&task, &scene, &RapierFactory, config, seed, &NoProgress, cancel, &warnings)?;
        Ok((statue, outcome.plan))
    };
    StatueMaterial::ALL.into_iter().map(planned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_plan::{BodyProperty, Disturbances};

    #[test]
    fn cardboard_in_place_of_brass_changes_the_strategy_and_the_plan_says_why() {
        let config = PlanConfig {
            starts: 8,
            evaluations: 300,
            candidates: 8,
            finalists: 2,
            polish_starts: 1,
            polish: 4,
            forecast_worlds: 8,
            sensitivity_rollouts: 100,
            disturbances: Disturbances { worlds: 6, ..Disturbances::default() },
            ..PlanConfig::default()
        };
        let plans = run_rebound(&config, Seed(3), &Cancel::new()).unwrap();
        let [(_, brass), (_, cardboard)] = plans.as_slice() else { panic!("two plans") };
        for plan in [brass, cardboard] {
            for s in &plan.strategies {
                println!("{}: {:.4} {:?}", s.name, s.objective, s.prediction.map(|p| [p.mean, p.q90]));
            }
            plan.reasons.iter().for_each(|r| println!("  {}", r.text));
        }
        let name = |plan: &Plan| plan.strategies[0].name.clone();
        assert!(name(brass).contains("off `statue`"), "{}", name(brass));
        assert!(!name(cardboard).contains("statue"), "{}", name(cardboard));
        assert!(brass.predicted.unwrap().mean < 0.07 && cardboard.predicted.unwrap().mean > 0.09);

        let of_statue = |plan: &Plan| {
            let told =
                plan.reasons.iter().filter_map(|r| r.counterfactual.clone().map(|c| (c, r.text.clone())));
            told.into_iter().find(|(c, _)| (c.body.as_str(), c.property) == ("statue", BodyProperty::Mass))
        };
        // As it is, and as the other material would have it.
        let (c, text) = of_statue(brass).expect("brass relies on its mass");
        assert!(c.strategy == name(brass) && c.objectives[0] == brass.objective, "{c:?}");
        assert!(c.values[0] > 15.0 && c.values[1] < 0.3 && c.objectives[1] > 0.08, "{c:?}");
        // The carton takes the ball's motion on and slides some millimetres.
        assert!(c.moved_m[1] > c.moved_m[0] + 0.001, "{c:?}");
        assert!(text.contains("as light as a carton") && text.contains("pushed"), "{text}");
        let (c, text) = of_statue(cardboard).expect("cardboard does for its lack of mass");
        assert!(c.strategy.contains("statue") && c.objectives[1] < cardboard.objective, "{c:?}");
        assert!(c.values[0] < 0.3 && c.objectives[1] < 0.05, "{c:?}");
        assert!(text.contains("as heavy as solid brass"), "{text}");
    }

    #[test]
    fn what_the_reason_says_is_what_the_scene_with_that_mass_does() {
        let (mut scene, task) = rebound_scene(StatueMaterial::Brass).unwrap();
        let config =
            PlanConfig { evaluations: 200, starts: 6, sensitivity_rollouts: 40, ..PlanConfig::paper() };
        let config = PlanConfig { method: sms_plan::Method::Halving, ..config };
        let (warnings, cancel) = (Warnings::new(), Cancel::new());
        let plan = plan(&task, &scene, &RapierFactory, &config, Seed(3), &NoProgress, &cancel, &warnings)
            .unwrap()
            .plan;
        let c =
            plan.reasons.iter().filter_map(|r| r.counterfactual.clone()).next().expect("a counterfactual");
        assert_eq!((c.body.as_str(), c.property), ("statue", BodyProperty::Mass));
        let statue = scene.bodies.iter_mut().find(|b| b.name == "statue").unwrap();
        let half = DVec3::new(0.07, 0.05, 0.08);
        statue.mass = box_mass_properties(half, c.values[1] / (8.0 * half.element_product())).ok();
        let bodies = task.bodies_in(&scene, "blue").unwrap();
        let mut simulation = task.prepare(&RapierFactory, &scene, &task.world_options(), &bodies).unwrap();
        let rollout = task.rollout(&mut simulation, task.strike(&plan.action), &bodies, None).unwrap();
        assert!((rollout.objective - c.objectives[1]).abs() < 1e-6, "{} {c:?}", rollout.objective);
    }
}
