//! Running the experiment.

use super::result::{OURS, kept};
use super::sight::Recorded;
use super::stand::{Standing, standing};
use super::{LandingBench, LandingFlight, LandingPart, LandingPlanned, LandingSight};
use crate::billiards::planner_view::{apply_to_matched, forget_material, scanned};
use crate::cpu_time::cpu_seconds;
use crate::{BenchError, BilliardsGeometry, MaterialPrior, part_of};
use rayon::prelude::*;
use sms_core::{Cancel, NoProgress, Progress, Seed, StageContext, StageError, Warnings, atomic};
use sms_landing::{
    LandingAction, LandingError, LandingWorld, ResolvedLanding, RolloutOptions, Stuck, plan_landing,
};
use sms_scene::Scene;
use sms_sim::{RapierFactory, RestingDrift};
use sms_synth::TruthScene;
use sms_target::{LandingTargetOptions, Target, TargetError, execute_landing, scene_from_truth};
use sms_wash::{WashModel, WashSettings};
use std::time::Instant;

/// Objective beyond which a flight in the target need not be followed: success was out of reach long before.
const ENOUGH: f64 = 1.0;

/// The scene that the planner sees.
struct LandingView {
    scene: Scene,
    matched: usize,
    /// Reason for which no landing can be planned.
    refused: Option<String>,
}

/// Data shared by consecutive flights.
#[derive(Default)]
struct Shared {
    /// The geometry of a scene, with its number.
    geometry: Option<(usize, Scene)>,
    /// The scene of a flight's plan. It is the same from every start; its movable bodies are found by simulation.
    seen: Option<(LandingPart, LandingView)>,
}

/// Runs the flights that are not in the folder yet, each of ours and of every baseline, and calls `line` after each.
///
/// # Errors
/// [`BenchError`] of scans, files and engines. A scene in which nothing can be planned is a result.
pub fn run_landings(
    bench: &LandingBench<'_>,
    line: &dyn Fn(&LandingFlight),
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<(), BenchError> {
    let target = bench.engine.target()?;
    let mut shared = Shared::default();
    let mut recorded = None;
    for part in part_of(bench.flights(), bench.part) {
        cancel.check()?;
        let kept = recorded.take().filter(|of: &Recorded<'_>| of.number() == part.scene);
        let recorded = recorded.insert(kept.unwrap_or_else(|| {
            Recorded::new(&bench.scan.bench, bench.scene(part.scene), part.scene, progress, cancel)
        }));
        let (flight, is_new) = flown(bench, part, target.as_ref(), &mut shared, recorded)?;
        if is_new {
            line(&flight);
        }
    }
    Ok(())
}

/// Quality of a scan for the planner of landings.
#[derive(Debug, Clone, PartialEq)]
pub struct LandingScan {
    /// Number of the scene.
    pub scene: usize,
    /// Whether scanned models stand in it, as far as there are such.
    pub scanned: bool,
    /// Number of true objects that have a body in their place.
    pub matched: usize,
    /// True objects.
    pub objects: usize,
    /// Bodies that were fixed when the scene was made, and are freed for the plan (see [`sms_landing::LandingTask::freed`]).
    pub freed: Vec<String>,
    /// Bodies that have to stay fixed, with how far they come by themselves.
    pub held: Vec<RestingDrift>,
    /// Bodies that have to stay fixed for another one's sake.
    pub stuck: Option<Stuck>,
    /// Reason for which no landing is possible: the structure falls by itself.
    pub falling: Option<String>,
    /// Stability and tipping loads of the structure; `None` without a surface to land on.
    pub standing: Option<Standing>,
}

/// Only scans the structures and makes their bodies, where they are not kept, and calls `done` after each. Planning can go on from
/// there on another machine.
///
/// # Errors
/// [`BenchError`] of the scans and files.
pub fn scan_landings(
    bench: &LandingBench<'_>,
    done: &dyn Fn(&LandingScan),
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Vec<LandingScan>, BenchError> {
    let mut scans = Vec::new();
    for &number in &bench.scenes {
        cancel.check()?;
        let truth = bench.truth(number)?;
        let scene = geometry_of(bench, number, &truth, progress, cancel)?;
        let part = LandingPart { scene: number, start: 0, material_prior: MaterialPrior::Class, draw: 0 };
        let seen = landing_view(scene, &truth, part)?;
        let task = bench.task(&seen.scene, &truth, part);
        let freed = task.freed(&RapierFactory, &seen.scene, &bench.settings.disturbances, bench.seed);
        let (freed, falling) = match or_why(freed)? {
            Ok(freed) => (freed, None),
            Err(why) => (None, Some(why)),
        };
        let planned_in = freed.as_ref().map_or(&seen.scene, |f| &f.scene);
        let standing = match or_why(task.resolve(planned_in))? {
            Ok(landing) => Some(standing(planned_in, &truth, landing.structure(), &landing.surface().body)?),
            Err(_) => None,
        };
        let (freed, held, stuck) = freed.map_or_else(Default::default, |f| (f.bodies, f.held, f.stuck));
        let (matched, objects) = (seen.matched, truth.objects.len());
        let scanned = bench.scanned;
        let scan =
            LandingScan { scene: number, scanned, matched, objects, freed, held, stuck, falling, standing };
        done(&scan);
        scans.push(scan);
    }
    Ok(scans)
}

/// Runs one flight, whether or not it is among [`LandingBench::flights`], or reads its kept result.
///
/// # Errors
/// As [`run_landings`].
pub fn run_landing(
    bench: &LandingBench<'_>,
    part: LandingPart,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<LandingFlight, BenchError> {
    let target = bench.engine.target()?;
    let recorded = Recorded::new(&bench.scan.bench, bench.scene(part.scene), part.scene, progress, cancel);
    Ok(flown(bench, part, target.as_ref(), &mut Shared::default(), &recorded)?.0)
}

/// A flight, and whether anything of it was not in the folder yet.
fn flown(
    bench: &LandingBench<'_>,
    part: LandingPart,
    target: &dyn Target,
    shared: &mut Shared,
    recorded: &Recorded<'_>,
) -> Result<(LandingFlight, bool), BenchError> {
    let (progress, cancel) = (recorded.progress, recorded.cancel);
    let mut flight = match kept(bench, part)? {
        Some(flight) if is_done(bench, part, &flight) => return Ok((flight, false)),
        Some(flight) => flight,
        None => LandingFlight {
            key: bench.key(part)?,
            scene: part.scene,
            scanned: bench.scanned,
            engine: target.label().to_owned(),
            start: part.start,
            material_prior: part.material_prior,
            draw: part.draw,
            objects: 0,
            matched: 0,
            evaluation_s: None,
            planned: Default::default(),
        },
    };
    let truth = bench.truth(part.scene)?;
    let seen = shared.seen(bench, part, &truth, progress, cancel)?;
    let scene = &seen.scene;
    (flight.objects, flight.matched) = (truth.objects.len(), seen.matched);
    let task = bench.task(scene, &truth, part);
    let landing = match &seen.refused {
        Some(why) => Err(why.clone()),
        None => or_why(task.resolve(scene))?,
    };
    let mut failed = None;
    match landing {
        Ok(landing) => {
            let sight = LandingSight { landing: &landing, scene, seed: seed_of(bench, part), recorded };
            let mut chosen = Vec::new();
            for name in names(bench, part) {
                if is_kept(bench, &flight, &name) {
                    continue;
                }
                let planned = match choose(bench, &name, &sight, cancel) {
                    Ok(planned) => planned,
                    // Earlier choices are still flown and kept, unless the user interrupts.
                    Err(e) if cancel.check().is_ok() => {
                        failed = Some(e);
                        break;
                    }
                    Err(e) => return Err(e),
                };
                let ours = planned.action.filter(|_| name == OURS);
                if let Some(action) = ours {
                    flight.evaluation_s = Some(evaluate(bench, &landing, scene, &action)?);
                }
                chosen.push((name, planned));
            }
            fly(bench, &mut chosen, &landing, scene, &truth, target)?;
            flight.planned.extend(chosen);
        }
        Err(why) => {
            for name in names(bench, part) {
                if !is_kept(bench, &flight, &name) {
                    let nothing = LandingPlanned::nothing(why.clone());
                    let variant = variant(bench, &name).to_owned();
                    flight.planned.insert(name, LandingPlanned { variant, ..nothing });
                }
            }
        }
    }
    atomic::write_json(&bench.file(part), &flight)?;
    failed.map_or(Ok((flight, true)), Err)
}

impl Shared {
    /// The scene that a flight is planned in, with its movable bodies freed.
    fn seen(
        &mut self,
        bench: &LandingBench<'_>,
        part: LandingPart,
        truth: &TruthScene,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<&LandingView, BenchError> {
        let any_start = LandingPart { start: 0, ..part };
        let kept = self.seen.take().filter(|(of, _)| *of == any_start);
        let seen = match kept {
            Some((_, seen)) => seen,
            None => {
                let kept = self.geometry.take().filter(|(number, _)| *number == part.scene);
                let geometry = match kept {
                    Some((_, scene)) => scene,
                    None => geometry_of(bench, part.scene, truth, progress, cancel)?,
                };
                let LandingView { scene, matched, .. } = landing_view(geometry.clone(), truth, part)?;
                self.geometry = Some((part.scene, geometry));
                cancel.check()?;
                let task = bench.task(&scene, truth, any_start);
                let freed = task.freed(&RapierFactory, &scene, &bench.settings.disturbances, bench.seed);
                match or_why(freed)? {
                    Ok(freed) => {
                        LandingView { scene: freed.map_or(scene, |f| f.scene), matched, refused: None }
                    }
                    Err(why) => LandingView { scene, matched, refused: Some(why) },
                }
            }
        };
        Ok(&self.seen.insert((any_start, seen)).1)
    }
}

/// The plan, or why the scene cannot be landed in, which is a result.
fn or_why<T>(found: Result<T, LandingError>) -> Result<Result<T, String>, BenchError> {
    match found {
        Err(e) if e.input().is_some() => Ok(Err(e.to_string())),
        found => Ok(Ok(found?)),
    }
}

/// The planners of a flight.
fn names(bench: &LandingBench<'_>, part: LandingPart) -> Vec<String> {
    let others = bench.baselines.iter().filter(|_| part.material_prior == MaterialPrior::Class);
    std::iter::once(OURS.to_owned()).chain(others.map(|b| b.name.clone())).collect()
}

fn is_done(bench: &LandingBench<'_>, part: LandingPart, flight: &LandingFlight) -> bool {
    names(bench, part).iter().all(|n| is_kept(bench, flight, n))
}

/// Whether the landing of that name is there, chosen by the one who would choose now.
fn is_kept(bench: &LandingBench<'_>, flight: &LandingFlight, name: &str) -> bool {
    flight.planned.get(name).is_some_and(|p| p.variant == variant(bench, name))
}

/// Which of the choosers of that name would choose now.
fn variant<'a>(bench: &'a LandingBench<'_>, name: &str) -> &'a str {
    bench.baselines.iter().find(|b| b.name == name).map_or("", |b| b.variant.as_str())
}

/// Bodies with the prior's materials.
fn geometry_of(
    bench: &LandingBench<'_>,
    number: usize,
    truth: &TruthScene,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Scene, BenchError> {
    match bench.geometry {
        BilliardsGeometry::Truth => {
            let mut scene = scene_from_truth(truth).map_err(TargetError::from)?;
            scene.bodies.iter_mut().for_each(forget_material);
            Ok(scene)
        }
        BilliardsGeometry::Scan => {
            scanned(&bench.scan, &bench.scene(number), &bench.scan.bench.entities, progress, cancel)
        }
    }
}

/// The same with the material prior.
fn landing_view(mut scene: Scene, truth: &TruthScene, part: LandingPart) -> Result<LandingView, BenchError> {
    let seed = truth.seed.derive_index("landing materials", part.draw as u64);
    let matched = apply_to_matched(&mut scene, truth, part.material_prior, seed)?;
    Ok(LandingView { scene, matched, refused: None })
}

impl LandingPlanned {
    /// A landing that is still to be flown.
    fn chosen(action: LandingAction) -> Self {
        Self {
            action: Some(action),
            problem: None,
            variant: String::new(),
            predicted_share: None,
            predicted: None,
            success: false,
            failure: None,
            failure_kind: None,
            in_the_air: false,
            realised: None,
            jet_success: None,
            plan_cpu_s: 0.0,
            target_cpu_s: 0.0,
        }
    }

    /// Nothing to fly, which is a failure.
    fn nothing(why: String) -> Self {
        Self {
            action: None,
            problem: Some(why),
            failure: Some("nothing was planned".to_owned()),
            failure_kind: Some("no_plan".to_owned()),
            ..Self::chosen(LandingAction { landing_w: [0.0; 2], approach_radius: 0.0, approach_angle: 0.0 })
        }
    }
}

/// Seed of a flight's plans.
fn seed_of(bench: &LandingBench<'_>, part: LandingPart) -> Seed {
    let seed = bench.seed.derive_index("landing", part.scene as u64).derive_index("start", part.start as u64);
    seed.derive_index("draw", part.draw as u64)
}

/// CPU seconds of this process since a moment.
fn cpu_since(began: Option<f64>) -> f64 {
    cpu_seconds().zip(began).map_or(0.0, |(now, began)| now - began)
}

/// One planner's landing, not flown yet. That there is nothing to fly is a result.
fn choose(
    bench: &LandingBench<'_>,
    name: &str,
    sight: &LandingSight<'_>,
    cancel: &Cancel,
) -> Result<LandingPlanned, BenchError> {
    let began = cpu_seconds();
    let planned = match plan(bench, name, sight, cancel) {
        Ok(planned) => planned,
        Err(BenchError::Landing(e)) if e.input().is_some() || matches!(e, LandingError::Nothing { .. }) => {
            LandingPlanned::nothing(e.to_string())
        }
        Err(e) => return Err(e),
    };
    Ok(LandingPlanned { plan_cpu_s: cpu_since(began), variant: variant(bench, name).to_owned(), ..planned })
}

/// Flies the choices of several planners side by side: a flight alone leaves cores idle, since air and bodies take turns.
fn fly(
    bench: &LandingBench<'_>,
    chosen: &mut [(String, LandingPlanned)],
    landing: &ResolvedLanding,
    scene: &Scene,
    truth: &TruthScene,
    target: &dyn Target,
) -> Result<(), BenchError> {
    let options = LandingTargetOptions {
        planner_sph: bench.settings.sph,
        recording: None,
        enough: Some(ENOUGH),
        ..LandingTargetOptions::default()
    };
    let flights = chosen.iter().filter(|(_, planned)| planned.action.is_some()).count();
    let began = cpu_seconds();
    chosen.par_iter_mut().try_for_each(|(_, planned)| {
        let Some(action) = planned.action else { return Ok(()) };
        let done = execute_landing(target, landing, &action, scene, truth, &options)?;
        let o = &done.outcome;
        planned.success = o.is_success();
        planned.failure = o.failure.as_ref().map(ToString::to_string);
        planned.failure_kind = o.failure.as_ref().map(|f| f.as_str().to_owned());
        planned.in_the_air = o.is_toppled_by_wash();
        planned.realised = o.objective;
        planned.jet_success = done.second_opinion.map(|o| o.is_success());
        Ok::<(), TargetError>(())
    })?;
    // The time of each cannot be separated.
    let each = cpu_since(began) / flights.max(1) as f64;
    chosen.iter_mut().filter(|(_, p)| p.action.is_some()).for_each(|(_, p)| p.target_cpu_s = each);
    Ok(())
}

fn plan(
    bench: &LandingBench<'_>,
    name: &str,
    sight: &LandingSight<'_>,
    cancel: &Cancel,
) -> Result<LandingPlanned, BenchError> {
    if let Some(baseline) = bench.baselines.iter().find(|b| b.name == name) {
        let chosen = match (baseline.choose)(sight)? {
            Ok(action) => LandingPlanned::chosen(action),
            Err(why) => LandingPlanned::nothing(why),
        };
        return Ok(LandingPlanned { variant: baseline.variant.clone(), ..chosen });
    }
    let warnings = Warnings::new();
    let (settings, seed) = (&bench.settings, sight.seed);
    let (engine, quiet) = (&RapierFactory, &NoProgress);
    let plan = plan_landing(
        sight.landing,
        sight.scene,
        engine,
        settings,
        StageContext::new(quiet, cancel, &warnings).with_seed(seed),
    )?
    .plan;
    Ok(LandingPlanned {
        predicted_share: plan.predicted.map(|p| p.success_share),
        predicted: plan.nominal.objective,
        ..LandingPlanned::chosen(plan.action)
    })
}

/// Wall-clock seconds of one rollout with `sph` on all cores, the world being built.
fn evaluate(
    bench: &LandingBench<'_>,
    landing: &ResolvedLanding,
    scene: &Scene,
    action: &LandingAction,
) -> Result<f64, BenchError> {
    let wash = WashSettings { model: WashModel::Sph, stream: bench.settings.jet, sph: bench.settings.sph };
    let options = landing.world_options();
    let mut world = LandingWorld::new(&RapierFactory, &options, scene, landing, landing.structure(), &wash)?;
    let began = Instant::now();
    world.fly(action, &RolloutOptions::default())?;
    Ok(began.elapsed().as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LandingBaseline, landing_table, read_landings};
    use glamx::DVec2;
    use sms_landing::LandingSettings;
    use std::cell::RefCell;

    /// In the truth's geometry, which takes no scan: a start is planned and flown, kept, and neither planned nor flown again.
    #[test]
    fn flights_are_flown_once_and_kept() {
        let dir = tempfile::tempdir().unwrap();
        let mut bench = LandingBench::quick(dir.path(), dir.path());
        bench.geometry = BilliardsGeometry::Truth;
        bench.starts = 1;
        bench.settings = LandingSettings {
            screening: 24,
            draws: 8,
            candidates: 2,
            refine: 1,
            polish_starts: 0,
            worlds: 2,
            forecast_worlds: 0,
            ..bench.settings
        };
        bench.settings.sph.spacing = 0.05;
        // At the overhang's end, where nothing can stand, and one that finds nothing.
        let end = |sight: &LandingSight<'_>| {
            let landing = bench_truth(1);
            let end_w = sight.scene.x_world_recording.transform_point(DVec2::from(landing.end_w).extend(0.0));
            Ok(Ok(sight.landing.straight(end_w.truncate())))
        };
        let nothing = |_: &LandingSight<'_>| Ok(Err("there is no place".to_owned()));
        for (name, choose) in
            [("end", Box::new(end) as Box<dyn Fn(&LandingSight<'_>) -> _>), ("nothing", Box::new(nothing))]
        {
            bench.baselines.push(LandingBaseline { name: name.into(), variant: String::new(), choose });
        }
        let flown = RefCell::new(Vec::new());
        let run = || {
            run_landings(&bench, &|f| flown.borrow_mut().push(f.clone()), &NoProgress, &Cancel::new())
                .unwrap();
            flown.take()
        };
        let first = run();
        assert_eq!(first.len(), 1);
        let flight = &first[0];
        let of = |name: &str| &flight.planned[name];
        assert!(of(OURS).success && of(OURS).action.is_some(), "{:?}", of(OURS).failure);
        assert!(flight.evaluation_s.is_some() && (flight.matched, flight.objects) == (2, 2));
        assert!(!of("end").success && of("end").failure.is_some());
        assert_eq!(
            (of("nothing").action, of("nothing").problem.as_deref()),
            (None, Some("there is no place"))
        );
        assert_eq!(flight.engine, bench.engine.target().unwrap().label());
        assert_eq!(read_landings(&bench).unwrap(), first);
        let table = landing_table(&first);
        assert!(table.contains(&flight.engine) && table.contains("end (baseline)"), "{table}");
        assert_eq!(run(), [], "all of it is kept");
        // With other settings it is another flight.
        bench.settings.worlds = 1;
        assert_eq!(read_landings(&bench).unwrap(), []);
    }

    fn bench_truth(number: u64) -> sms_synth::LandingTruth {
        sms_synth::landing_scene(number).landing.unwrap()
    }
}
