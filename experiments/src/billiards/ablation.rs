//! Sources of the loss between predicted and realised: the planner's inputs are replaced by the truth, one at
//! a time, and it plans again. This module reads the truth.

use super::ablated::{Ablated, Ablation, Replaced};
use super::planner_view::{PlannerView, apply_to_matched, forget_material};
use super::realise::Realiser;
use super::rows::{RowPlanner, View};
use super::{BilliardsScene, Row, Shot};
use crate::material_prior::set_material;
use crate::{BenchError, MaterialPrior};
use glamx::DVec3;
use sms_core::{Aabb, Seed};
use sms_plan::PlanError;
use sms_scene::{Body, BodyShape, Scene};
use sms_sim::{RapierFactory, WorldFactory, WorldOptions};
use sms_synth::TruthScene;
use sms_target::{Target, TargetEngine, TargetError, match_bodies, scene_from_truth};
use sms_task::{Billiards, Selector, Task, TaskError};
use std::collections::BTreeMap;

/// Rows of the ablation.
pub(super) const ROWS: [Row; 2] = [Row::Ours, Row::Robust];
/// Displacement of all bodies in the test of a shot's stability, metres: the accuracy of positions in a scan.
const NUDGE_M: f64 = 1e-3;

/// The planner's engine at its own step.
struct PlannersOwn;

impl Target for PlannersOwn {
    fn factory(&self) -> &dyn WorldFactory {
        &RapierFactory
    }

    fn world_options(&self, planner: &WorldOptions) -> WorldOptions {
        *planner
    }
}

/// Runs the ablation of a planned scene against the judge, the first of the engines.
pub(super) fn ablate(
    planner: &RowPlanner<'_>,
    result: &BilliardsScene,
    known: &PlannerView,
    truth: &TruthScene,
) -> Result<Ablation, BenchError> {
    let &RowPlanner { bench, robot, progress, cancel, .. } = planner;
    let engine = bench.engines.first().copied().unwrap_or(TargetEngine::Rapier);
    let judge = engine.target()?;
    let starts = bench.ablation_starts.min(bench.starts);
    let table = |target| Realiser { target, truth, robot, idle_m: result.idle_m };
    let mut ablation =
        Ablation { judge: engine.key().to_owned(), starts, sensitivity_m: None, rows: BTreeMap::new() };
    let own = View { task: &known.task, scene: &known.scene };
    let first: BTreeMap<Row, Vec<Shot>> = ROWS
        .into_iter()
        .filter_map(|row| Some((row, result.plans.get(&row)?.iter().take(starts).cloned().collect())))
        .collect();
    let planner_can = result.problem.is_none();
    if let Some(shot) = first.get(&Row::Robust).and_then(|v| v.first()).filter(|_| planner_can) {
        ablation.sensitivity_m = table(&*judge).sensitivity_m(own, shot, NUDGE_M)?;
    }
    for what in Replaced::ALL {
        cancel.check()?;
        let replaced = replaced(known, truth, result.material_prior, what)?;
        let (scene, task) = replaced.as_ref().map_or((own.scene, own.task), |r| (&r.0, &r.1));
        let view = View { task, scene };
        let plans = match what {
            Replaced::None | Replaced::Engine => first.clone(),
            _ => {
                let mut plans = BTreeMap::new();
                for row in ROWS {
                    let shots = match planner.plan(view, row, starts) {
                        Ok(planned) => planned.shots,
                        Err(BenchError::Plan(PlanError::Task(TaskError::Input(_)))) => {
                            vec![Shot::nothing(result.idle_m); if row == Row::Ours { starts } else { 1 }]
                        }
                        Err(e) => return Err(e),
                    };
                    plans.insert(row, shots);
                }
                plans
            }
        };
        let target: &dyn Target =
            if matches!(what, Replaced::Engine | Replaced::All) { &PlannersOwn } else { &*judge };
        let mut realised = table(target).realise(&|_| view, &plans, progress, cancel)?;
        let mut ablated_row = |(row, shots): (Row, Vec<Shot>)| {
            let ablated = Ablated {
                predicted_m: shots.iter().map(|s| s.predicted_m).collect(),
                realised_m: realised.rows[&row].clone(),
                unfinished: realised.unfinished.remove(&row).unwrap_or_default(),
            };
            (row, ablated)
        };
        ablation.rows.insert(what, plans.into_iter().map(&mut ablated_row).collect());
    }
    Ok(ablation)
}

/// The planner's scene with something replaced, and the task in it; `None` where its own is to be taken.
fn replaced(
    known: &PlannerView,
    truth: &TruthScene,
    material_prior: MaterialPrior,
    what: Replaced,
) -> Result<Option<(Scene, Task)>, BenchError> {
    let mut real = scene_from_truth(truth).map_err(TargetError::from)?;
    for body in &mut real.bodies {
        body.x_wb = known.scene.x_world_recording * body.x_wb;
    }
    real.x_world_recording = known.scene.x_world_recording;
    // Bodies that did not rest were fixed; they still stand for objects.
    let pairs = match_bodies(&known.scene.loosened(), &real);
    let seed = known.prior_seed;
    Ok(match what {
        Replaced::None | Replaced::Engine => None,
        Replaced::Materials => {
            let mut scene = known.scene.clone();
            apply_to_matched(&mut scene, truth, MaterialPrior::Truth, seed)?;
            Some((scene, known.task.clone()))
        }
        Replaced::Poses => Some((at_true_places(&known.scene, &real, &pairs), known.task.clone())),
        Replaced::Geometry => {
            let scene = with_true_shapes(known, &real, truth, material_prior, seed, &pairs);
            let name = |called: &str| own_name(&pairs, called);
            Some((scene, billiards(&known.task, &name(&truth.cue), &name(&truth.target))))
        }
        Replaced::All => Some((real, billiards(&known.task, &truth.cue, &truth.target))),
    })
}

/// Returns the task with the balls selected by name.
fn billiards(task: &Task, cue: &str, target: &str) -> Task {
    match task {
        Task::Billiards(b) => Task::Billiards(Billiards {
            cue: Selector::by_name(cue),
            target: Selector::by_name(target),
            ..b.clone()
        }),
        other => other.clone(),
    }
}

/// The planner's name of a true object; a missing object gets a name that is not in its scene.
fn own_name(pairs: &[(String, String)], truth: &str) -> String {
    pairs.iter().find(|p| p.1 == truth).map_or_else(|| format!("unseen {truth}"), |p| p.0.clone())
}

/// Middle of the foot: where a body stands.
fn foot_w(body: &Body) -> DVec3 {
    let at = |p: DVec3| body.x_wb.transform_point(p);
    match &body.shape {
        BodyShape::Sphere { radius } => body.x_wb.translation - DVec3::Z * *radius,
        shape => {
            let corners = shape.meshes().into_iter().flat_map(|m| m.vertices).map(at);
            Aabb::of_points(corners)
                .map_or(body.x_wb.translation, |b| (0.5 * (b.min + b.max)).with_z(b.min.z))
        }
    }
}

/// Reconstructed shapes, each standing where its object stands, on the true floor.
fn at_true_places(own: &Scene, real: &Scene, pairs: &[(String, String)]) -> Scene {
    let mut scene = own.clone();
    let floor = real.bodies.iter().find(|b| matches!(b.shape, BodyShape::HalfSpace));
    for body in &mut scene.bodies {
        if let (BodyShape::HalfSpace, Some(floor)) = (&body.shape, floor) {
            body.x_wb = floor.x_wb;
        } else if let Some(there) = pairs.iter().find(|p| p.0 == body.name).and_then(|p| real.body(&p.1)) {
            body.x_wb.translation += foot_w(there) - foot_w(body);
        }
    }
    scene
}

/// The true bodies, each at the place of its reconstruction, with the material prior; missing ones at their
/// own place, and nothing that is not there.
fn with_true_shapes(
    known: &PlannerView,
    real: &Scene,
    truth: &TruthScene,
    material_prior: MaterialPrior,
    seed: Seed,
    pairs: &[(String, String)],
) -> Scene {
    let is_floor = |b: &&Body| matches!(b.shape, BodyShape::HalfSpace);
    let own_floor = known.scene.bodies.iter().find(is_floor);
    let floor = own_floor.or_else(|| real.bodies.iter().find(is_floor)).cloned();
    let objects = truth.objects.iter().filter_map(|object| {
        let mut body = real.body(&object.name)?.clone();
        forget_material(&mut body);
        let name = own_name(pairs, &object.name);
        if let Some(own) = known.scene.body(&name) {
            let material = match material_prior {
                MaterialPrior::Vlm => own.material.clone(),
                _ => material_prior.of_object(object, &body, seed),
            };
            set_material(&mut body, material);
            body.x_wb.translation += foot_w(own) - foot_w(&body);
            body.fit_se_m = own.fit_se_m;
        }
        body.name = name;
        Some(body)
    });
    Scene { bodies: floor.into_iter().chain(objects).collect(), ..known.scene.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BilliardsBench;
    use crate::BilliardsGeometry;
    use crate::billiards::planner_view::{is_object, planner_view};
    use sms_core::{Cancel, NoProgress};
    use sms_synth::FIXED_SCENES;

    /// The planner's view of scene 8 with every body displaced, its boxes enlarged, and one missing.
    fn shifted() -> (PlannerView, TruthScene) {
        let fixed = FIXED_SCENES[7];
        let truth = fixed.generate();
        let mut bench = BilliardsBench::new(vec![fixed], std::path::Path::new("keep"), "out");
        bench.geometry = BilliardsGeometry::Truth;
        let mut known =
            planner_view(&bench, &fixed, &truth, MaterialPrior::Class, &NoProgress, &Cancel::new()).unwrap();
        for body in known.scene.bodies.iter_mut().filter(|b| is_object(b)) {
            body.x_wb.translation += DVec3::new(0.003, -0.002, 0.0);
            if let BodyShape::Hulls { hulls } = &mut body.shape {
                for hull in hulls {
                    hull.vertices.iter_mut().for_each(|v| *v *= 1.02);
                }
            }
        }
        (known, truth)
    }

    fn farthest(a: &Scene, b: &Scene) -> f64 {
        let both = a.bodies.iter().filter_map(|x| Some((x, b.body(&x.name)?)));
        both.map(|(x, y)| foot_w(x).distance(foot_w(y))).fold(0.0, f64::max)
    }

    #[test]
    fn each_replacement_replaces_its_own_thing_and_nothing_else() {
        let (known, truth) = shifted();
        let get = |what| replaced(&known, &truth, MaterialPrior::Class, what).unwrap().unwrap();
        let real = scene_from_truth(&truth).unwrap();
        let (all, _) = get(Replaced::All);
        assert_eq!(all.bodies, real.bodies);

        let (poses, _) = get(Replaced::Poses);
        assert!(farthest(&poses, &real) < 1e-9);
        for (a, b) in poses.bodies.iter().zip(&known.scene.bodies) {
            assert_eq!((&a.shape, &a.material, &a.mass), (&b.shape, &b.material, &b.mass));
        }

        let (geometry, _) = get(Replaced::Geometry);
        assert!(farthest(&geometry, &known.scene) < 1e-9);
        for object in &truth.objects {
            let (a, b) = (geometry.body(&object.name).unwrap(), real.body(&object.name).unwrap());
            assert_eq!(a.shape, b.shape);
            assert_eq!(a.material, known.scene.body(&object.name).unwrap().material);
            let material_prior = a.material.effective_density() / object.material.effective_density();
            assert!((a.mass.unwrap().mass() / b.mass.unwrap().mass() / material_prior - 1.0).abs() < 1e-5);
        }

        let (materials, _) = get(Replaced::Materials);
        for (a, b) in materials.bodies.iter().zip(&known.scene.bodies) {
            assert_eq!((&a.shape, a.x_wb), (&b.shape, b.x_wb));
            if let Some(object) = truth.object(&a.name) {
                assert_eq!(a.material, object.material);
            }
        }
        assert!(replaced(&known, &truth, MaterialPrior::Class, Replaced::Engine).unwrap().is_none());
    }

    #[test]
    fn what_was_not_reconstructed_is_there_with_true_geometry_and_strays_are_not() {
        let (mut known, truth) = shifted();
        let lost = known.scene.bodies.len() - 1;
        known.scene.bodies[lost].x_wb.translation.x += 2.0;
        let (stray, name) = (known.scene.bodies[lost].name.clone(), truth.objects[lost - 1].name.clone());
        let (scene, _) = replaced(&known, &truth, MaterialPrior::Class, Replaced::Geometry).unwrap().unwrap();
        assert_eq!(scene.bodies.len(), truth.objects.len() + 1);
        assert!(scene.body(&stray).is_none() && scene.body(&format!("unseen {name}")).is_some());
    }
}
