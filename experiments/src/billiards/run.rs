//! Scene by scene.

use super::ablated::Ablation;
use super::ablation::ablate;
use super::drawing::{outlines, ways};
use super::planner_view::{PlannerView, planner_view};
use super::realise::Realiser;
use super::result::kept;
use super::rows::{RowPlanner, View};
use super::{BilliardsBench, BilliardsScene, Drawing, Row, Shot};
use crate::cpu_time::cpu_seconds;
use crate::{BenchError, MaterialPrior};
use glamx::DVec2;
use sms_core::{Cancel, InputError, Progress, atomic};
use sms_plan::PlanError;
use sms_synth::{FixedScene, TruthScene};
use sms_target::robot_of;
use sms_target::{TargetEngine, scene_from_truth};
use sms_task::TaskError;
use std::collections::BTreeMap;

/// Runs the scenes of `bench` that its folder does not hold yet, and the engines that they were not executed in.
/// `done` is called for every scene. Afterwards [`super::read_billiards`] reads them, those of other shards too.
///
/// If a vision-language model stops answering, the rest of its row is not run, but the other rows are; the result is the reason.
///
/// # Errors
/// [`BenchError`]. A scene in which the planner finds no cue or target ball is not an error: its shots do nothing.
pub fn run_billiards(
    bench: &BilliardsBench,
    done: &dyn Fn(&BilliardsScene),
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Option<InputError>, BenchError> {
    let mut unanswered = None;
    for &material_prior in &bench.material_prior {
        for scene in &bench.scenes {
            cancel.check()?;
            match run_scene(bench, scene, material_prior, progress, cancel) {
                Ok(scene) => done(&scene),
                Err(BenchError::Unanswered(why)) => {
                    unanswered = Some(why);
                    break;
                }
                Err(e) => return Err(e),
            }
        }
    }
    Ok(unanswered)
}

/// Only scans the scenes of `bench` and makes their bodies; [`run_billiards`] finds them in the folder where scans are
/// kept, on another machine too. `done` is called with the number of true objects of each scene that have a body.
///
/// # Errors
/// [`BenchError`].
pub fn scan_billiards(
    bench: &BilliardsBench,
    done: &dyn Fn(&FixedScene, usize, usize),
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<(), BenchError> {
    // The material prior is applied later.
    let material_prior = MaterialPrior::Prior;
    for scene in &bench.scenes {
        cancel.check()?;
        let truth = scene.generate();
        let known = planner_view(bench, scene, &truth, material_prior, progress, cancel)?;
        done(scene, known.matched, truth.objects.len());
    }
    Ok(())
}

fn run_scene(
    bench: &BilliardsBench,
    fixed: &FixedScene,
    material_prior: MaterialPrior,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<BilliardsScene, BenchError> {
    let path = bench.file(fixed, material_prior);
    let before = if bench.scan.rescan { None } else { kept(bench, fixed, material_prior)? };
    let missing = |r: &BilliardsScene| {
        let missing = |e: &&TargetEngine| !r.realised.contains_key(e.key());
        bench.engines.iter().filter(missing).copied().collect::<Vec<_>>()
    };
    let judge = bench.engines.first().map(|e| e.key());
    let is_as_asked =
        |a: &Ablation| a.starts == bench.ablation_starts.min(bench.starts) && Some(a.judge.as_str()) == judge;
    let ablated =
        |r: &BilliardsScene| bench.ablation_starts == 0 || r.ablation.as_ref().is_some_and(is_as_asked);
    if let Some(result) = before.as_ref().filter(|r| missing(r).is_empty() && ablated(r)) {
        return Ok(result.clone());
    }
    let truth = fixed.generate();
    let robot = robot_of(&truth);
    let clock = ProcessClock::start();
    let known = planner_view(bench, fixed, &truth, material_prior, progress, cancel)?;
    let see_s = clock.cpu_s();
    let seed = bench.seed.derive_index("billiards", fixed.number as u64);
    let planner = RowPlanner { bench, robot: &robot, seed, progress, cancel };
    let mut result = match before {
        Some(result) => result,
        None => {
            let mut result = plan_all(&planner, fixed, material_prior, &known, &truth)?;
            result.cpu_s.extend(see_s.map(|s| ("see".to_owned(), s)));
            atomic::write_json(&path, &result)?;
            result
        }
    };
    let view_of = |row: Row| View { task: &known.task, scene: known.scene_of(row) };
    for engine in missing(&result) {
        let target = match engine.target() {
            Ok(target) => target,
            Err(why) => {
                result.not_run.insert(engine.key().to_owned(), why.to_string());
                atomic::write_json(&path, &result)?;
                continue;
            }
        };
        result.not_run.remove(engine.key());
        let clock = ProcessClock::start();
        let table = Realiser { target: &*target, truth: &truth, robot: &robot, idle_m: result.idle_m };
        let realised = table.realise(&view_of, &result.plans, progress, cancel)?;
        result.realised.insert(engine.key().to_owned(), realised.rows);
        result.unfinished.insert(engine.key().to_owned(), realised.unfinished);
        if let Some(motion) = &realised.motion {
            result.drawing.realised.insert(engine.key().to_owned(), ways(motion));
        }
        result.cpu_s.extend(clock.cpu_s().map(|s| (engine.key().to_owned(), s)));
        atomic::write_json(&path, &result)?;
    }
    if !ablated(&result) {
        let clock = ProcessClock::start();
        let ablation = ablate(&planner, &result, &known, &truth)?;
        result.ablation = Some(ablation);
        result.cpu_s.extend(clock.cpu_s().map(|s| ("ablation".to_owned(), s)));
        atomic::write_json(&path, &result)?;
    }
    Ok(result)
}

/// All plans of a scene.
fn plan_all(
    planner: &RowPlanner<'_>,
    fixed: &FixedScene,
    material_prior: MaterialPrior,
    known: &PlannerView,
    truth: &TruthScene,
) -> Result<BilliardsScene, BenchError> {
    let bench = planner.bench;
    let mut result = BilliardsScene {
        key: bench.key(fixed, material_prior),
        number: fixed.number,
        layout: fixed.layout,
        material_prior,
        geometry: bench.geometry,
        idle_m: idle_m(truth),
        objects: truth.objects.len(),
        matched: known.matched,
        strays: known.strays,
        problem: None,
        paper_problem: None,
        plans: BTreeMap::new(),
        seconds: BTreeMap::new(),
        realised: BTreeMap::new(),
        unfinished: BTreeMap::new(),
        not_run: BTreeMap::new(),
        cpu_s: BTreeMap::new(),
        drawing: drawing(known, truth)?,
        ablation: None,
    };
    for row in Row::ALL.into_iter().rev().filter(|row| bench.rows.contains(row)) {
        let view = View { task: &known.task, scene: known.scene_of(row) };
        match planner.plan(view, row, bench.starts) {
            Ok(planned) => {
                result.plans.insert(row, planned.shots);
                result.seconds.insert(row, planned.seconds);
                result.cpu_s.extend(planned.cpu_s.map(|s| (format!("plan_{}", row.as_str()), s)));
                if let Some(motion) = planned.motion {
                    result.drawing.predicted = ways(&motion);
                }
            }
            // A ball that was not reconstructed, or not as a sphere: there is nothing to strike.
            Err(BenchError::Plan(PlanError::Task(TaskError::Input(e)))) => {
                let problem = if row == Row::Paper { &mut result.paper_problem } else { &mut result.problem };
                *problem = Some(e.to_string());
                let count = if matches!(row, Row::Paper | Row::Ours) { bench.starts } else { 1 };
                result.plans.insert(row, vec![Shot::nothing(result.idle_m); count]);
            }
            Err(e) => return Err(e),
        }
    }
    Ok(result)
}

/// Outlines of the scene, as planned and in truth.
fn drawing(known: &PlannerView, truth: &TruthScene) -> Result<Drawing, BenchError> {
    let mut real = scene_from_truth(truth).map_err(sms_target::TargetError::from)?;
    let x_wt = known.scene.x_world_recording;
    for body in &mut real.bodies {
        body.x_wb = x_wt * body.x_wb;
    }
    let resolved = known.task.resolve(&known.scene).ok();
    let goal = DVec2::from_array(truth.goal_w).extend(0.0);
    Ok(Drawing {
        goal_w: Some(x_wt.transform_point(goal).truncate().to_array()),
        balls: resolved.map(|t| [t.cue().name.clone(), t.target().name.clone()]),
        true_balls: [truth.cue.clone(), truth.target.clone()],
        planned: outlines(&known.scene),
        truth: outlines(&real),
        ..Drawing::default()
    })
}

/// CPU seconds of this process, where the system tells.
struct ProcessClock(Option<f64>);

impl ProcessClock {
    fn start() -> Self {
        Self(cpu_seconds())
    }

    fn cpu_s(&self) -> Option<f64> {
        Some(cpu_seconds()? - self.0?)
    }
}

fn idle_m(truth: &TruthScene) -> f64 {
    let ball = truth.object(&truth.target).map_or(DVec2::ZERO, |o| o.x_wb.translation.truncate());
    ball.distance(DVec2::from_array(truth.goal_w))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::redrawn::redraw_materials;
    use crate::{
        BilliardsGeometry, Replaced, billiards_metrics, billiards_table, read_billiards, write_pictures,
        write_shots,
    };
    use sms_core::table::read_table;
    use sms_core::{NoProgress, Seed};
    use sms_plan::PlanConfig;
    use sms_synth::FIXED_SCENES;
    use sms_target::SameEngineTarget;
    use sms_task::Action;
    use std::path::Path;
    use std::sync::Mutex;

    /// Two starts with next to no rollouts, on the truth's geometry.
    pub(in super::super) fn tiny(out: &Path, scenes: &[usize]) -> BilliardsBench {
        let scenes = scenes.iter().map(|n| FIXED_SCENES[n - 1]).collect();
        let mut bench = BilliardsBench::new(scenes, out, out);
        bench.geometry = BilliardsGeometry::Truth;
        bench.engines = vec![TargetEngine::Rapier];
        bench.starts = 2;
        bench.paper.nelder_mead.max_iterations = 4;
        bench.ours =
            PlanConfig { robust_evaluations: 24, restarts: 0, candidates: 2, finalists: 1, ..bench.ours };
        bench.ours.perturbation.worlds = 1;
        bench.robust = bench.ours.clone();
        bench
    }

    #[test]
    fn runs_go_on_where_they_were_and_shards_meet() {
        let dir = tempfile::tempdir().unwrap();
        let material_prior = Mutex::new(Vec::new());
        let run = |bench: &BilliardsBench| {
            let note = |s: &BilliardsScene| material_prior.lock().unwrap().push(s.clone());
            run_billiards(bench, &note, &NoProgress, &Cancel::new()).unwrap();
            material_prior.lock().unwrap().drain(..).collect::<Vec<_>>()
        };
        let (one, two) = (tiny(dir.path(), &[1]), tiny(dir.path(), &[3]));
        let first = run(&one);
        run(&two);
        assert_eq!(read_billiards(&one).unwrap().iter().map(|s| s.number).collect::<Vec<_>>(), [1, 3]);

        // A finished scene is not run again: the result is the file's.
        let path = one.file(&one.scenes[0], MaterialPrior::Class);
        let mut marked = first[0].clone();
        marked.seconds.insert(Row::Grid, 77.0);
        atomic::write_json(&path, &marked).unwrap();
        assert_eq!(run(&one)[0].seconds[&Row::Grid], 77.0);
        // Without its engine, it is executed again and not planned again.
        marked.realised.clear();
        atomic::write_json(&path, &marked).unwrap();
        let again = run(&one);
        assert_eq!((again[0].seconds[&Row::Grid], &again[0].realised), (77.0, &first[0].realised));
        // Other settings are another experiment.
        let other = BilliardsBench { seed: Seed(1), ..tiny(dir.path(), &[1]) };
        assert!(read_billiards(&other).unwrap().is_empty());

        let all = read_billiards(&one).unwrap();
        for s in &all {
            let count = |row| s.realised["rapier"][&row].len();
            assert_eq!(
                (count(Row::Paper), count(Row::Ours), count(Row::Robust), count(Row::Grid)),
                (2, 2, 1, 1)
            );
        }
        let metrics = billiards_metrics(&all);
        let get = |key: &str| metrics.number(&format!("bench.billiards.rapier.{key}")).unwrap();
        let single = [1, 3].map(|n| get(&format!("ours.class.scene_{n:02}.robust_single_m")));
        assert!((get("ours.class.robust_single_mean_m") - 0.5 * (single[0] + single[1])).abs() < 1e-12);
        assert_eq!(get("grid.class.realised_mean_m"), get("grid.class.realised_best_mean_m"));
        assert!(get("paper.class.predicted_best_mean_m") <= get("paper.class.predicted_mean_m"));
        let text = billiards_table(&all);
        assert!(
            text.contains("20.5 (17.9)") && text.contains("same engine") && text.contains("vlm: not run")
        );

        // Rows alone are another run with the same plans, and tables have nothing in the others' places.
        let few = BilliardsBench { rows: vec![Row::Ours], ..tiny(dir.path(), &[1]) };
        let alone = run(&few);
        assert_eq!(alone[0].plans.keys().collect::<Vec<_>>(), [&Row::Ours]);
        assert_eq!(alone[0].plans[&Row::Ours], first[0].plans[&Row::Ours]);
        let text = billiards_table(&alone);
        assert!(text.contains("2 starts") && !text.contains("NaN") && !text.contains("inf"), "{text}");
        assert!(billiards_metrics(&alone).number("bench.billiards.rapier.paper.class.scenes").is_none());
        write_pictures(dir.path(), &alone, &text).unwrap();

        let parquet = dir.path().join("shots.parquet");
        write_shots(&parquet, &all).unwrap();
        let rows = read_table(&parquet).unwrap();
        assert!(rows.iter().all(|(_, column)| column.len() == 2 * 6));
    }

    #[test]
    #[ignore = "long: plans several rows"]
    fn long_with_everything_true_plans_do_what_they_promise_and_pictures_are_complete() {
        let dir = tempfile::tempdir().unwrap();
        let bench = BilliardsBench { ablation_starts: 1, ..tiny(dir.path(), &[8]) };
        let run = || run_billiards(&bench, &|_| {}, &NoProgress, &Cancel::new()).unwrap();
        run();
        let all = read_billiards(&bench).unwrap();
        let ablation = all[0].ablation.as_ref().unwrap();
        assert_eq!((ablation.judge.as_str(), ablation.rows.len()), ("rapier", Replaced::ALL.len()));
        for row in [Row::Ours, Row::Robust] {
            // Nothing differs: neither the planner's knowledge, the engine, nor its step.
            let of = &ablation.rows[&Replaced::All][&row];
            let realised = of.realised_m[0].unwrap();
            assert!((realised - of.predicted_m[0]).abs() < 1e-5, "{realised} {:?}", of.predicted_m);
            // `None` repeats the plain run.
            let none = &ablation.rows[&Replaced::None][&row];
            assert_eq!(none.realised_m[0], all[0].realised["rapier"][&row][0]);
        }
        let metrics = billiards_metrics(&all);
        for what in Replaced::ALL {
            for name in ["realised_mean_m", "robust_single_mean_m"] {
                let key = format!("bench.billiards.ablation.{}.{name}", what.as_str());
                assert!(metrics.number(&key).is_some_and(f64::is_finite), "{key}");
            }
        }
        // A finished ablation is not made again.
        let before = std::fs::metadata(bench.file(&bench.scenes[0], MaterialPrior::Class)).unwrap();
        run();
        let after = std::fs::metadata(bench.file(&bench.scenes[0], MaterialPrior::Class)).unwrap();
        assert_eq!(before.modified().unwrap(), after.modified().unwrap());

        write_pictures(dir.path(), &all, "a < b").unwrap();
        let page = std::fs::read_to_string(dir.path().join("index.html")).unwrap();
        assert!(page.contains("a &lt; b") && page.contains("row ours") && page.contains("row paper"));
        // The picture of the realised shot draws each body of the true scene, and ghosts of the balls.
        let picture = dir.path().join("figures/scene_08_rapier_class.svg");
        let picture = std::fs::read_to_string(picture).unwrap();
        assert_eq!(picture.matches("aria-label=\"the scene from above\"").count(), 2);
        assert!(picture.matches("<circle").count() > 10 && picture.contains("realised"), "{picture}");
        assert!(page.len() > picture.len() && !page.contains("href"));
    }

    #[test]
    fn a_shot_that_is_not_finished_says_why() {
        let dir = tempfile::tempdir().unwrap();
        let bench = tiny(dir.path(), &[1]);
        let (fixed, material_prior) = (bench.scenes[0], MaterialPrior::Class);
        let truth = fixed.generate();
        let robot = robot_of(&truth);
        let known =
            planner_view(&bench, &fixed, &truth, material_prior, &NoProgress, &Cancel::new()).unwrap();
        let view = View { task: &known.task, scene: &known.scene };
        let table = Realiser { target: &SameEngineTarget, truth: &truth, robot: &robot, idle_m: 0.2 };
        // Faster than any arm.
        let fast = Shot { action: Some(Action(vec![60.0, 0.0, 0.0, 0.0])), ..Shot::nothing(0.01) };
        let plans =
            BTreeMap::from([(Row::Ours, vec![Shot::nothing(0.2), fast.clone()]), (Row::Robust, vec![fast])]);
        let realised = table.realise(&|_| view, &plans, &NoProgress, &Cancel::new()).unwrap();
        assert_eq!(realised.rows[&Row::Ours], [Some(0.2), None]);
        let why = &realised.unfinished[&Row::Ours];
        assert!(why.len() == 1 && why[&1].contains("the robot cannot execute this strike"), "{why:?}");
        let line = format!("not finished, scene  3: ours 2, robust 1: {}", why[&1]);

        let (rows, unfinished) = (realised.rows, realised.unfinished);
        let mut result = crate::billiards::result::tests::scene(0.01, None);
        result.plans = plans;
        result.paper_problem = Some("no ball is blue".into());
        result.realised = BTreeMap::from([("rapier".to_owned(), rows)]);
        result.unfinished = BTreeMap::from([("rapier".to_owned(), unfinished)]);
        let text = billiards_table(std::slice::from_ref(&result));
        assert!(text.contains(&line), "{text}");
        assert!(text.contains("not planned, scene  3: row paper: no ball is blue"), "{text}");
        let metrics = billiards_metrics(std::slice::from_ref(&result));
        for key in ["unfinished", "robust_single_unfinished"] {
            assert_eq!(metrics.number(&format!("bench.billiards.rapier.ours.class.{key}")), Some(1.0));
        }
    }

    #[test]
    #[ignore = "long: plans several rows"]
    fn long_plans_do_not_depend_on_true_materials_that_are_not_told() {
        let dir = tempfile::tempdir().unwrap();
        let bench = tiny(dir.path(), &[8]);
        let fixed = bench.scenes[0];
        let plans = |truth: &TruthScene, material_prior| {
            let known =
                planner_view(&bench, &fixed, truth, material_prior, &NoProgress, &Cancel::new()).unwrap();
            let robot = robot_of(truth);
            let cancel = Cancel::new();
            let planner = RowPlanner {
                bench: &bench,
                robot: &robot,
                seed: Seed(2),
                progress: &NoProgress,
                cancel: &cancel,
            };
            let make = |row| {
                let view = View { task: &known.task, scene: known.scene_of(row) };
                planner.plan(view, row, 2).unwrap().shots
            };
            Row::ALL.map(make)
        };
        let truth = fixed.generate();
        let other = redraw_materials(&truth, Seed(9));
        assert_eq!(plans(&truth, MaterialPrior::Class), plans(&other, MaterialPrior::Class));
        assert_ne!(plans(&truth, MaterialPrior::Truth), plans(&other, MaterialPrior::Truth));
    }
}
