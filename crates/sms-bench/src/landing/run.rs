//! Running the experiment.

use super::result::{OURS, kept};
use super::sight::Recorded;
use super::stand::{Standing, standing};
use super::{LandingBench, LandingFlight, LandingPart, LandingPlanned, LandingSight};
use crate::billiards::seen::{forget_material, scanned, tell_matched};
use crate::{BenchError, BenchScene, BilliardsGeometry, MaterialsTold, cpu_seconds, part_of};
use glamx::DVec3;
use sms_core::{Cancel, NoProgress, Progress, Warnings, atomic};
use sms_landing::{
    LandingAction, LandingError, LandingTask, LandingWorld, ResolvedLanding, RolloutOptions, Stuck,
    plan_landing,
};
use sms_scene::Scene;
use sms_sim::{RapierFactory, RestingDrift};
use sms_synth::{TruthScene, landing_scene};
use sms_target::{LandingTargetOptions, Target, TargetError, execute_landing, scene_from_truth};
use sms_wash::{WashModel, WashSettings};
use std::time::Instant;

/// Objective beyond which a flight in the target need not be followed: success was out of reach long before.
const ENOUGH: f64 = 1.0;

/// The scene that the planner sees.
struct Seen {
    scene: Scene,
    matched: usize,
}

/// What flights that follow each other have in common.
#[derive(Default)]
struct Shared {
    /// The geometry of a scene, with its number.
    geometry: Option<(usize, Scene)>,
    /// What a flight was planned in: the same from every start, and what can move in it takes simulations to find out.
    seen: Option<(LandingPart, Seen)>,
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
        let recorded =
            recorded.insert(kept.unwrap_or_else(|| Recorded::new(bench, part.scene, progress, cancel)));
        let (flight, is_new) = flown(bench, part, target.as_ref(), &mut shared, recorded, progress, cancel)?;
        if is_new {
            line(&flight);
        }
    }
    Ok(())
}

/// What a scan gives a planner of landings.
#[derive(Debug, Clone, PartialEq)]
pub struct LandingScan {
    /// Number of the scene.
    pub scene: usize,
    /// True objects in whose place a body is.
    pub matched: usize,
    /// True objects.
    pub objects: usize,
    /// Bodies that were fixed when the scene was made, and are freed for the plan (see [`LandingTask::freed`]).
    pub freed: Vec<String>,
    /// Bodies that have to stay fixed, with how far they come by themselves.
    pub held: Vec<RestingDrift>,
    /// Bodies that have to stay fixed for another one's sake.
    pub stuck: Option<Stuck>,
    /// How the structure stands and when it tips; `None` where there is no surface to land on.
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
        let truth = landing_scene(number as u64);
        let scene = geometry_of(bench, number, &truth, progress, cancel)?;
        let part = LandingPart { scene: number, start: 0, told: MaterialsTold::Class, draw: 0 };
        let seen = see(scene, &truth, part)?;
        let task = task_of(&seen.scene, &truth, part);
        let freed = task.freed(&RapierFactory, &seen.scene, &bench.settings.disturbances, bench.seed)?;
        let planned_in = freed.as_ref().map_or(&seen.scene, |f| &f.scene);
        let standing = match task.resolve(planned_in) {
            Ok(landing) => Some(standing(planned_in, &truth, landing.structure(), &landing.surface().body)?),
            Err(e) if e.input().is_some() => None,
            Err(e) => return Err(e.into()),
        };
        let (freed, held, stuck) = freed.map_or_else(Default::default, |f| (f.bodies, f.held, f.stuck));
        let (matched, objects) = (seen.matched, truth.objects.len());
        let scan = LandingScan { scene: number, matched, objects, freed, held, stuck, standing };
        done(&scan);
        scans.push(scan);
    }
    Ok(scans)
}

/// Runs one flight, whether or not it is among [`LandingBench::flights`], or reads what is kept of it.
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
    let recorded = Recorded::new(bench, part.scene, progress, cancel);
    Ok(flown(bench, part, target.as_ref(), &mut Shared::default(), &recorded, progress, cancel)?.0)
}

/// A flight, and whether anything of it was not in the folder yet.
fn flown(
    bench: &LandingBench<'_>,
    part: LandingPart,
    target: &dyn Target,
    shared: &mut Shared,
    recorded: &Recorded<'_>,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<(LandingFlight, bool), BenchError> {
    let mut flight = match kept(bench, part)? {
        Some(flight) if is_done(bench, part, &flight) => return Ok((flight, false)),
        Some(flight) => flight,
        None => LandingFlight {
            key: bench.key(part),
            scene: part.scene,
            start: part.start,
            told: part.told,
            draw: part.draw,
            objects: 0,
            matched: 0,
            evaluation_s: None,
            planned: Default::default(),
        },
    };
    let truth = landing_scene(part.scene as u64);
    let seen = shared.seen(bench, part, &truth, progress, cancel)?;
    let scene = &seen.scene;
    (flight.objects, flight.matched) = (truth.objects.len(), seen.matched);
    let task = task_of(scene, &truth, part);
    match task.resolve(scene) {
        Ok(landing) => {
            for name in names(bench, part) {
                if is_kept(bench, &flight, &name) {
                    continue;
                }
                let planned =
                    carry_out(bench, part, &name, &landing, scene, recorded, &truth, target, cancel)?;
                if name == OURS {
                    let action = planned.action;
                    flight.evaluation_s = action.map(|a| evaluate(bench, &landing, scene, &a)).transpose()?;
                }
                flight.planned.insert(name, planned);
                atomic::write_json(&bench.file(part), &flight)?;
            }
        }
        Err(e) if e.input().is_some() => {
            for name in names(bench, part) {
                flight.planned.insert(name, LandingPlanned::nothing(e.to_string()));
            }
            atomic::write_json(&bench.file(part), &flight)?;
        }
        Err(e) => return Err(e.into()),
    }
    Ok((flight, true))
}

impl Shared {
    /// The scene that a flight is planned in, with what can move freed.
    fn seen(
        &mut self,
        bench: &LandingBench<'_>,
        part: LandingPart,
        truth: &TruthScene,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<&Seen, BenchError> {
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
                let Seen { scene, matched } = see(geometry.clone(), truth, part)?;
                self.geometry = Some((part.scene, geometry));
                cancel.check()?;
                let task = task_of(&scene, truth, any_start);
                let freed = task.freed(&RapierFactory, &scene, &bench.settings.disturbances, bench.seed)?;
                Seen { scene: freed.map_or(scene, |f| f.scene), matched }
            }
        };
        Ok(&self.seen.insert((any_start, seen)).1)
    }
}

/// The landing from a part's start.
fn task_of(scene: &Scene, truth: &TruthScene, part: LandingPart) -> LandingTask {
    let start_w = truth.landing.as_ref().map_or(DVec3::ZERO, |l| l.starts_w[part.start]);
    LandingTask::new(scene.x_world_recording.transform_point(start_w).truncate().to_array())
}

/// The planners of a flight.
fn names(bench: &LandingBench<'_>, part: LandingPart) -> Vec<String> {
    let others = bench.baselines.iter().filter(|_| part.told == MaterialsTold::Class);
    std::iter::once(OURS.to_owned()).chain(others.map(|b| b.name.clone())).collect()
}

fn is_done(bench: &LandingBench<'_>, part: LandingPart, flight: &LandingFlight) -> bool {
    names(bench, part).iter().all(|n| is_kept(bench, flight, n))
}

/// Whether the landing of that name is there, chosen by the one who would choose now.
fn is_kept(bench: &LandingBench<'_>, flight: &LandingFlight, name: &str) -> bool {
    let variant = bench.baselines.iter().find(|b| b.name == name).map_or("", |b| b.variant.as_str());
    flight.planned.get(name).is_some_and(|p| p.variant == variant)
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
            let which = BenchScene::Landing(number);
            scanned(&bench.scan, &which, &bench.scan.bench.entities, progress, cancel)
        }
    }
}

/// The same with what is told.
fn see(mut scene: Scene, truth: &TruthScene, part: LandingPart) -> Result<Seen, BenchError> {
    let seed = truth.seed.derive_index("landing materials", part.draw as u64);
    let matched = tell_matched(&mut scene, truth, part.told, seed)?;
    Ok(Seen { scene, matched })
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

/// Plans and flies one landing.
fn carry_out(
    bench: &LandingBench<'_>,
    part: LandingPart,
    name: &str,
    landing: &ResolvedLanding,
    scene: &Scene,
    recorded: &Recorded<'_>,
    truth: &TruthScene,
    target: &dyn Target,
    cancel: &Cancel,
) -> Result<LandingPlanned, BenchError> {
    let seed = bench.seed.derive_index("landing", part.scene as u64).derive_index("start", part.start as u64);
    let seed = seed.derive_index("draw", part.draw as u64);
    let began = cpu_seconds();
    let since = |from: Option<f64>| cpu_seconds().zip(from).map_or(0.0, |(now, from)| now - from);
    let sight = LandingSight { landing, scene, seed, recorded };
    let mut planned = match plan(bench, name, &sight, cancel) {
        Ok(planned) => planned,
        Err(BenchError::Landing(e)) if e.input().is_some() || matches!(e, LandingError::Nothing { .. }) => {
            LandingPlanned::nothing(e.to_string())
        }
        Err(e) => return Err(e),
    };
    planned.plan_cpu_s = since(began);
    let Some(action) = planned.action else { return Ok(planned) };
    let began = cpu_seconds();
    let options = LandingTargetOptions {
        planner_sph: bench.settings.sph,
        recording: None,
        enough: Some(ENOUGH),
        ..LandingTargetOptions::default()
    };
    let done = execute_landing(target, landing, &action, scene, truth, &options)?;
    planned.target_cpu_s = since(began);
    let o = &done.outcome;
    planned.success = o.is_success();
    planned.failure = o.failure.as_ref().map(ToString::to_string);
    planned.failure_kind = o.failure.as_ref().map(|f| f.as_str().to_owned());
    planned.in_the_air = o.is_toppled_by_wash();
    planned.realised = o.objective;
    planned.jet_success = done.second_opinion.map(|o| o.is_success());
    Ok(planned)
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
    let plan =
        plan_landing(sight.landing, sight.scene, engine, settings, seed, quiet, cancel, &warnings)?.plan;
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
