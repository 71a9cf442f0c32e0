//! `sms-experiments engines`: the same shots in every engine, and how far apart they end.

use crate::bootstrap::median;
use crate::{BenchError, PlanScene};
use sms_core::metrics::Metrics;
use sms_core::{Cancel, InputError, Progress};
use sms_eval::mean;
use sms_plan::PlanError;
use sms_scene::{BodyKind, BodyShape};
use sms_sim::{RapierF64Factory, RapierFactory, WorldFactory, WorldOptions};
use sms_target::{Target, TargetEngine, TargetOptions, disturbed};
use sms_task::Action;
use std::time::Instant;

/// The planner's engine, as a row among the targets.
struct PlannerEngine;

impl Target for PlannerEngine {
    fn factory(&self) -> &dyn WorldFactory {
        &RapierFactory
    }

    fn world_options(&self, planner: &WorldOptions) -> WorldOptions {
        *planner
    }
}

/// Rapier in double precision at a quarter of the planner's step.
struct DoublePrecision;

impl Target for DoublePrecision {
    fn factory(&self) -> &dyn WorldFactory {
        &RapierF64Factory
    }

    fn world_options(&self, planner: &WorldOptions) -> WorldOptions {
        WorldOptions { dt: 0.25 * planner.dt, ..*planner }
    }
}

/// Key of the row in which the reference runs again with start positions disturbed by up to a micrometre.
const CHAOS: &str = "reference_1um";

/// One shot in one engine.
struct EngineShot {
    objective: f64,
    /// Final places of balls and of other bodies, in the order of the scene.
    balls: Vec<glamx::DVec3>,
    others: Vec<glamx::DVec3>,
    seconds: f64,
}

/// Runs the `shots` shots of each scene that the planner's engine likes best, of those that billiards geometry suggests, in
/// every engine that can be used. Keys, over all shots: `bench.engines.{engine}.{objective_mean_m,
/// objective_difference_{mean,median,max}_m, ball_difference_{mean,median}_m, other_difference_{mean,median}_m, shot_s,
/// failed}`, where differences are to the shot in the reference engine (`bench.engines.reference`: PhysX precise, else
/// Rapier at a quarter of the planner's step), and `failed` counts shots that an engine could not finish.
///
/// # Errors
/// [`BenchError`]: a scene that cannot be simulated by the planner's engine, or interruption.
pub fn run_engines(
    scenes: &[PlanScene],
    shots: usize,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Metrics, BenchError> {
    let mut rows: Vec<(&str, Box<dyn Target>)> =
        vec![("rapier_f32", Box::new(PlannerEngine)), ("rapier_f64", Box::new(DoublePrecision))];
    let mut metrics = Metrics::new();
    for engine in TargetEngine::ALL.into_iter().filter(|e| e.is_built_in()) {
        match engine.target() {
            Ok(target) => rows.push((engine.key(), target)),
            Err(why) => {
                metrics.set(format!("bench.engines.{}.not_run", engine.key()), why.to_string());
            }
        }
    }
    let preferred = TargetEngine::preferred().key();
    let reference = rows.iter().position(|(key, _)| *key == preferred).unwrap_or(0);
    let mut results: Vec<Vec<Option<EngineShot>>> = (0..=rows.len()).map(|_| Vec::new()).collect();
    progress.begin("bench engines", (scenes.len() * shots) as u64);
    for (i, scene) in scenes.iter().enumerate() {
        for (k, action) in best_suggestions(scene, shots)?.iter().enumerate() {
            for (row, (_, target)) in rows.iter().enumerate() {
                cancel.check()?;
                results[row].push(shoot(&**target, scene, action)?);
            }
            let options = TargetOptions::default();
            let moved = PlanScene { scene: disturbed(&scene.scene, &options, k), ..scene.clone() };
            results[rows.len()].push(shoot(&*rows[reference].1, &moved, action)?);
            progress.update((i * shots + k) as u64 + 1, "shots");
        }
    }
    progress.end("");
    metrics.set("bench.engines.scenes", scenes.len());
    metrics.set("bench.engines.shots", results[reference].len());
    metrics.set("bench.engines.reference", rows[reference].0);
    let keys = rows.iter().map(|(key, _)| *key).chain([CHAOS]);
    for (key, result) in keys.zip(&results) {
        add_row(&mut metrics, key, result, &results[reference]);
    }
    Ok(metrics)
}

fn best_suggestions(scene: &PlanScene, count: usize) -> Result<Vec<Action>, BenchError> {
    let mut rated: Vec<(f64, Action)> = Vec::new();
    for action in scene.task.suggestions() {
        if let Some(shot) = shoot(&PlannerEngine, scene, &action)? {
            rated.push((shot.objective, action));
        }
    }
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(rated.into_iter().take(count).map(|r| r.1).collect())
}

/// A shot; `None` if the engine could not finish it.
fn shoot(target: &dyn Target, scene: &PlanScene, action: &Action) -> Result<Option<EngineShot>, BenchError> {
    let task = &scene.task;
    let bodies = task.bodies_in(&scene.scene, &task.target().name).map_err(PlanError::from)?;
    let mut simulation = target
        .simulation(&scene.scene, &task.world_options())
        .map_err(|e| InputError::new(e.to_string(), target.label(), "take another engine or seed"))?;
    let began = Instant::now();
    let rollout = match task.rollout(&mut simulation, task.strike(action), &bodies, None) {
        Ok(rollout) => rollout,
        Err(e) if e.is_invalid_rollout() => return Ok(None),
        Err(e) => return Err(PlanError::from(e).into()),
    };
    let seconds = began.elapsed().as_secs_f64();
    let places = |balls: bool| {
        let bodies = scene.scene.bodies.iter().enumerate();
        let wanted = bodies.filter(|(_, b)| {
            b.kind == BodyKind::Dynamic && matches!(b.shape, BodyShape::Sphere { .. }) == balls
        });
        wanted.map(|(id, _)| simulation.state(id).x_wb.translation).collect()
    };
    Ok(Some(EngineShot { objective: rollout.objective, balls: places(true), others: places(false), seconds }))
}

fn add_row(metrics: &mut Metrics, key: &str, row: &[Option<EngineShot>], reference: &[Option<EngineShot>]) {
    // A shot that an engine could not finish has no mean.
    let mut set = |name: &str, value: f64| {
        if value.is_finite() {
            metrics.set(format!("bench.engines.{key}.{name}"), value);
        }
    };
    let run: Vec<&EngineShot> = row.iter().flatten().collect();
    let of = |f: &dyn Fn(&EngineShot) -> f64| mean(&run.iter().map(|s| f(s)).collect::<Vec<_>>());
    set("failed", (row.len() - run.len()) as f64);
    set("objective_mean_m", of(&|s| s.objective));
    set("shot_s", of(&|s| s.seconds));
    let (mut objectives, mut balls, mut others) = (Vec::new(), Vec::new(), Vec::new());
    for (a, b) in row.iter().zip(reference).filter_map(|(a, b)| Some((a.as_ref()?, b.as_ref()?))) {
        objectives.push((a.objective - b.objective).abs());
        balls.extend(a.balls.iter().zip(&b.balls).map(|(p, q)| p.distance(*q)));
        others.extend(a.others.iter().zip(&b.others).map(|(p, q)| p.distance(*q)));
    }
    set("objective_difference_max_m", objectives.iter().copied().fold(0.0, f64::max));
    for (name, values) in
        [("objective_difference", objectives), ("ball_difference", balls), ("other_difference", others)]
    {
        set(&format!("{name}_mean_m"), mean(&values));
        set(&format!("{name}_median_m"), median(&values));
    }
}

/// The results as a table, distances in millimetres.
pub fn engines_table(metrics: &Metrics) -> String {
    let text = |key: &str| metrics.get(&format!("bench.engines.{key}")).and_then(|v| v.as_str());
    let mut out = format!(
        "{} shots; differences to {}, millimetres: mean / median\n\n\
         | engine | objective | its difference (max) | balls' final places | other bodies' | ms a shot | not finished |\n\
         | --- | --- | --- | --- | --- | --- | --- |\n",
        metrics.number("bench.engines.shots").unwrap_or(0.0),
        text("reference").unwrap_or("?"),
    );
    let keys = ["rapier_f32", "rapier", "rapier_f64", "physx_precise", "physx_stock", "mujoco", CHAOS];
    for key in keys {
        let get = |name: &str| metrics.number(&format!("bench.engines.{key}.{name}"));
        if let Some(why) = text(&format!("{key}.not_run")) {
            out += &format!("| {key} | not run: {} | | | | | |\n", why.lines().next().unwrap_or(why));
        }
        let Some(objective) = get("objective_mean_m") else { continue };
        let mm = |name: &str| 1e3 * get(name).unwrap_or(f64::NAN);
        let both = |name: &str| {
            format!("{:.2} / {:.2}", mm(&format!("{name}_mean_m")), mm(&format!("{name}_median_m")))
        };
        out += &format!(
            "| {key} | {:.1} | {} ({:.1}) | {} | {} | {:.0} | {:.0} |\n",
            1e3 * objective,
            both("objective_difference"),
            mm("objective_difference_max_m"),
            both("ball_difference"),
            both("other_difference"),
            mm("shot_s"),
            get("failed").unwrap_or(0.0),
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SceneFamily;
    use sms_core::NoProgress;

    #[test]
    fn the_reference_differs_from_itself_by_nothing_and_other_engines_by_little() {
        let scenes = [PlanScene::new(SceneFamily::Open, 1001).unwrap()];
        let metrics = run_engines(&scenes, 1, &NoProgress, &Cancel::new()).unwrap();
        let reference = metrics.get("bench.engines.reference").unwrap().as_str().unwrap();
        assert_eq!(metrics.number(&format!("bench.engines.{reference}.ball_difference_mean_m")), Some(0.0));
        let other = metrics.number("bench.engines.rapier_f32.objective_difference_mean_m").unwrap();
        assert!(other > 0.0 && other < 0.1, "{other}");
        assert!(engines_table(&metrics).contains("| rapier_f64 |"));
    }
}
