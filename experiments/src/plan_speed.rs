//! `sms-experiments plan`: time of simulated shots and of plans, by part.

use crate::{BenchError, PlanScene};
use sms_core::metrics::Metrics;
use sms_core::{Cancel, Progress, Seed, StageContext, Warnings};
use sms_plan::{Halton, Method, Perturbation, PlanConfig, PlanError, plan};
use sms_sim::{RapierFactory, Simulation, Striker, StrikerMotion};
use sms_task::Action;
use std::time::Instant;

/// Timed shots of each scene, and the largest number of strikes tried to find feasible ones.
const SHOTS: usize = 64;
const MOST_SHOTS: usize = 512;

/// Times shots that are spread over the whole range of actions, one after another on this thread, and whole plans on all
/// threads of rayon's pool. Keys, means over the scenes:
/// `bench.plan.{evaluation_s, evaluations_per_s, finger_evaluation_s, sweep_plan_s, refusal_s, refused, shots, steps, splits,
/// engine_share, impacts_share, arm_share, sweep_plan_share, restore_share, other_share, prepare_s, paper_scene_s, scene_s,
/// robust_scene_s, threads}`. An evaluation is a feasible strike: its sweep is planned (`sweep_plan_s`), and
/// the world is simulated with the arm under torque control; `finger_evaluation_s` is the same strike with a kinematic
/// finger. `refused` is the share of strikes that the arm cannot make, `refusal_s` the time to refuse one. Plans
/// use the arm. `scene_s` is planning for the scanned world alone with
/// the default method, `robust_scene_s` with `config`'s perturbed worlds, `paper_scene_s` the paper's 30 searches of 30
/// iterations.
///
/// # Errors
/// [`BenchError`]: a scene that cannot be simulated, or interruption.
pub fn run_plan_speed(
    scenes: &[PlanScene],
    config: &PlanConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Metrics, BenchError> {
    let mut rows: Vec<Vec<(&str, f64)>> = Vec::new();
    progress.begin("bench plan", scenes.len() as u64);
    for (i, scene) in scenes.iter().enumerate() {
        let mut row = time_shots(scene, cancel)?;
        let nominal = Perturbation { worlds: 0, ..config.perturbation.clone() };
        let kinds = [
            ("paper_scene_s", PlanConfig { method: Method::MultiStart, ..PlanConfig::paper() }),
            ("scene_s", PlanConfig { perturbation: nominal, ..config.clone() }),
            ("robust_scene_s", config.clone()),
        ];
        let arm_task = scene.arm_task()?;
        for (key, config) in kinds {
            let (began, warnings) = (Instant::now(), Warnings::new());
            let seed = Seed(scene.seed);
            plan(
                &arm_task,
                &scene.scene,
                &RapierFactory,
                &config,
                StageContext::quiet(cancel, &warnings).with_seed(seed),
            )?;
            row.push((key, began.elapsed().as_secs_f64()));
        }
        rows.push(row);
        progress.update(i as u64 + 1, "scenes");
    }
    progress.end("");
    let mut metrics = Metrics::new();
    metrics.set("bench.plan.scenes", scenes.len());
    metrics.set("bench.plan.threads", rayon::current_num_threads());
    for k in 0..rows.first().map_or(0, Vec::len) {
        let mean = rows.iter().map(|r| r[k].1).sum::<f64>() / rows.len() as f64;
        metrics.set(format!("bench.plan.{}", rows[0][k].0), mean);
    }
    if let Some(seconds) = metrics.number("bench.plan.evaluation_s") {
        metrics.set("bench.plan.evaluations_per_s", 1.0 / seconds);
    }
    Ok(metrics)
}

fn time_shots(scene: &PlanScene, cancel: &Cancel) -> Result<Vec<(&'static str, f64)>, BenchError> {
    let task = scene.arm_task()?;
    let bodies = task.bodies_in(&scene.scene, &task.target().name).map_err(PlanError::from)?;
    let began = Instant::now();
    let mut simulation = task
        .prepare(&RapierFactory, &scene.scene, &task.world_options(), &bodies)
        .map_err(PlanError::from)?;
    let prepare_s = began.elapsed().as_secs_f64();
    let parameters = task.parameters();
    let points = Halton::new(parameters.len(), Seed(scene.seed));
    // Strikes that the arm cannot make are refused before any simulation, and are counted separately.
    let (mut planning_s, mut refusing_s, mut refused) = (0.0, 0.0, 0);
    let mut made: Vec<(StrikerMotion, Striker)> = Vec::new();
    for i in 0..MOST_SHOTS {
        cancel.check()?;
        let point = points.point(i as u64);
        let values = point.iter().zip(&parameters).map(|(t, p)| p.low + t * (p.high - p.low));
        let strike = task.strike(&Action(values.collect()));
        let began = Instant::now();
        match task.striker(&strike) {
            Ok(striker) => {
                planning_s += began.elapsed().as_secs_f64();
                made.push((strike, striker));
            }
            Err(e) if e.is_invalid_rollout() => {
                refusing_s += began.elapsed().as_secs_f64();
                refused += 1;
            }
            Err(e) => return Err(PlanError::from(e).into()),
        }
        if made.len() == SHOTS {
            break;
        }
    }
    let rollouts_s = |simulation: &mut Simulation, strikers: &[Striker]| {
        let began = Instant::now();
        for striker in strikers {
            cancel.check()?;
            simulation.restore();
            match task.rollout(simulation, striker, &bodies, None) {
                Err(e) if !e.is_invalid_rollout() => return Err(BenchError::from(PlanError::from(e))),
                _ => {}
            }
        }
        Ok(began.elapsed().as_secs_f64())
    };
    let (motions, arms): (Vec<StrikerMotion>, Vec<Striker>) = made.into_iter().unzip();
    let fingers: Vec<Striker> = motions.iter().map(Striker::from).collect();
    let finger_s = rollouts_s(&mut simulation, &fingers)?;
    simulation.begin_profile();
    let all_s = planning_s + rollouts_s(&mut simulation, &arms)?;
    let p = simulation.profile().unwrap_or_default();
    let count = arms.len().max(1) as f64;
    let each = |v: f64| v / count;
    let share = |v: f64| v / all_s;
    let known = p.engine_s + p.impacts_s + p.restore_s + p.striker_s + planning_s;
    Ok(vec![
        ("evaluation_s", each(all_s)),
        ("finger_evaluation_s", each(finger_s)),
        ("sweep_plan_s", each(planning_s)),
        ("refusal_s", refusing_s / f64::from(refused.max(1))),
        ("refused", f64::from(refused) / (f64::from(refused) + count)),
        ("shots", count),
        ("steps", each(p.steps as f64)),
        ("splits", each(p.splits as f64)),
        ("engine_share", share(p.engine_s)),
        ("impacts_share", share(p.impacts_s)),
        ("arm_share", share(p.striker_s)),
        ("sweep_plan_share", share(planning_s)),
        ("restore_share", share(p.restore_s)),
        ("other_share", share(all_s - known)),
        ("prepare_s", prepare_s),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SceneFamily;

    #[test]
    fn shares_add_up_and_every_figure_is_there() {
        let scene = PlanScene::new(SceneFamily::Open, 1001).unwrap();
        let row = time_shots(&scene, &Cancel::new()).unwrap();
        let shares: f64 = row.iter().filter(|(k, _)| k.ends_with("_share")).map(|(_, v)| v).sum();
        assert!((shares - 1.0).abs() < 1e-9, "{shares}");
        let get = |key: &str| row.iter().find(|(k, _)| *k == key).unwrap().1;
        assert!(get("steps") > 50.0 && get("splits") > 1.0 && get("engine_share") > 0.0);
        assert!(get("shots") > 2.0 && get("arm_share") > 0.0);
        println!("{row:?}");
    }
}
