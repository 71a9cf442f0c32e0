//! From a task and a scene to a plan (paper section "Simulate").

use crate::config::SOLVED;
use crate::reason::Explaining;
use crate::robust::{Candidate, Choice, key};
use crate::screening::Feasible;
use crate::search::{Found, search, search_by};
use crate::sensitivity::Sensing;
use crate::space::Space;
use crate::strategy::{strategy_of, touched};
use crate::worlds::{Counter, DisturbedWorlds, Shot, Worlds};
use crate::{
    BatchOptimiser, Phase, Plan, PlanConfig, PlanOutcome, Prediction, Refusal, StartSummary, Strategy, Trial,
    Unknown,
};
use sms_core::{Cancel, CoreError, InputError, NoProgress, Progress, Seed, Warnings};
use sms_scene::Scene;
use sms_sim::{BodyId, SimError, WorldFactory};
use sms_task::{Action, Recording, ResolvedTask, Rollout, TaskError};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Mutex;

/// Time between recorded states of the plan's trajectory, seconds.
const RECORD_EVERY_S: f64 = 1.0 / 120.0;

/// Errors of planning.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// Bad settings.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Interrupted, or a file could not be written.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// The task does not fit the scene.
    #[error(transparent)]
    Task(#[from] TaskError),
    /// The scene cannot be simulated.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// The robot can make none of the strikes.
    #[error(transparent)]
    OutOfReach(InputError),
    /// No rollout reached its end.
    #[error(
        "none of the {evaluations} simulated shots could be carried out ({engine} blew up in each); check the \
         scene's masses and shapes with `sms simulate`"
    )]
    Nothing {
        /// Engine.
        engine: String,
        /// Rollouts.
        evaluations: usize,
    },
}

/// Plans: searches the actions in the nominal world, then chooses by how they fare in disturbed worlds (materials
/// sampled within their intervals, objects, radii and strike a little off; the same worlds for every candidate).
///
/// Choice: distinct actions that do better than nothing, from the nominal search and from a scan in the disturbed worlds,
/// are tried in a few of these; simplex searches go on over them from the best, the better half is tried in twice as many
/// worlds, and so on. The best few are tried in as many worlds again, and the one with the smallest [`PlanConfig::objective`] over
/// both wins. What it is predicted to do is measured in other worlds. The plan is the same for any number of threads; rayon's current pool is used. Only `scene`, which the
/// scan made, is looked at.
///
/// # Errors
/// [`PlanError`]: bad settings, a scene that cannot be simulated, or interruption.
pub fn plan(
    task: &ResolvedTask,
    scene: &Scene,
    factory: &dyn WorldFactory,
    config: &PlanConfig,
    seed: Seed,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<PlanOutcome, PlanError> {
    config.validate(Path::new("(settings of the planner)"))?;
    let space = Space::new(task);
    let nominal = Worlds::new(task, Cow::Borrowed(scene), factory)?;
    let counter = Counter::new(progress, cancel);

    counter.begin("plan: search", config.budget());
    // What each shot touches, by its point: the order in which threads note it does not matter.
    let notes: Mutex<BTreeMap<Vec<u64>, String>> = Mutex::default();
    let settings = PlanConfig { evaluations: config.nominal_evaluations(), ..config.clone() };
    let feasible = |x: &[f64]| counter.draw(task, &space.action(x));
    let objective = |x: &[f64]| {
        let mut seen = None;
        let objective = counter.count(|| {
            let rollout = nominal.rollout(&task.strike(&space.action(x)), None)?;
            seen = Some(strategy_of(&rollout, scene, task));
            Ok(rollout.objective)
        })?;
        if let (Some(strategy), Ok(mut notes)) = (seen, notes.lock()) {
            notes.insert(key(x), strategy);
        }
        Ok(objective)
    };
    let mut found = Found::default();
    for round in 0..config.searches() {
        if round > 0 {
            counter.begin("plan: search anew", config.budget());
        }
        let seed = match round {
            0 => seed.derive("search"),
            _ => seed.derive_index("search anew", round as u64),
        };
        found.append(search(&space, &settings, seed, config.budget(), &feasible, &objective)?);
        if found.best() <= SOLVED * task.success_m() {
            break;
        }
    }
    let known = notes.into_inner().unwrap_or_default();
    let evaluations = counter.done();
    let best = found.best();
    let struck = counter.refused();
    if !best.is_finite() {
        let refused = counter.refusals(&struck);
        let looked_at = evaluations + total(&refused) - struck.values().sum::<usize>();
        if total(&refused) == looked_at {
            return Err(PlanError::OutOfReach(out_of_reach(task, &refused, looked_at)));
        }
        return Err(PlanError::Nothing { engine: factory.engine().to_owned(), evaluations });
    }
    progress.end(&format!("best of {evaluations} shots: {:.1} mm", 1e3 * best));

    let d = &config.disturbances;
    let (chosen, forecast) = {
        counter.begin("plan: disturbed worlds", config.disturbed_rollouts());
        let everything = |_: &Unknown| true;
        let family = |range| {
            DisturbedWorlds::new(task, scene, factory, d, seed.derive("disturbed"), range, &everything)
        };
        let choice = Choice {
            task,
            scene,
            config,
            space: &space,
            nominal: &nominal,
            counter: &counter,
            known: &known,
        };
        let chosen = choice.choose(&mut found, &family(0..2 * d.worlds)?, seed.derive("robust scan"))?;
        if chosen.is_empty() {
            let refused = counter.refusals(&struck);
            return Err(PlanError::OutOfReach(out_of_reach(task, &refused, total(&refused))));
        }
        // Worlds that played no part in the choice: in those that did, the winner looks better than it is.
        let fresh = if d.worlds == 0 { 0 } else { config.forecast_worlds };
        let fresh = family(2 * d.worlds..2 * d.worlds + fresh)?;
        let see = |rollout: &Rollout| (strategy_of(rollout, scene, task), touched(rollout, scene));
        let forecast = forecast(&chosen, &fresh, &counter, &see, &mut found.trials)?;
        (chosen, forecast)
    };
    // Points of the scan, and what was refused, are looked at, too.
    let is_scan = |t: &&Trial| t.phase == Phase::Disturbed && t.start == -1;
    let scanned = found.trials.iter().filter(is_scan).count();
    let refused = counter.refusals(&struck);
    let searched = evaluations + scanned + total(&refused) - struck.values().sum::<usize>();
    let predictions: Vec<Option<Prediction>> =
        forecast.iter().map(|row| Prediction::of(&shots(row), |v| task.is_success(v))).collect();
    let winner = &chosen[0];
    let predicted = predictions[0];
    if let Some(p) = predicted {
        progress.end(&format!("chosen shot: {:.1} mm on average", 1e3 * p.mean));
    }
    let action = winner.action.clone();
    // A world for nothing but the strike's errors may have none that is valid.
    let objective_q90 = predicted.map_or(winner.objective, |p| p.q90);
    for start in &mut found.starts {
        if start.action == action {
            start.objective_q90 = Some(objective_q90);
        }
    }
    // Recorded until the end, it may turn out invalid after what counts has happened; there is nothing to show then.
    let rollout = match nominal.rollout(&task.strike(&action), Some(Recording { every_s: RECORD_EVERY_S })) {
        Err(e) if !e.is_invalid_rollout() => return Err(e.into()),
        other => other.ok(),
    };
    let sensitivities = match &rollout {
        Some(rollout) if predicted.is_some() && config.sensitivity_rollouts > 0 => {
            let disturbed = forecast[0].iter().filter_map(|shot| shot.1.as_ref()).flat_map(|s| s.1.clone());
            let touched = disturbed.chain(touched(rollout, scene)).collect();
            let sensing =
                Sensing { task, scene, factory, config, seed, counter: &counter, winner, touched: &touched };
            sensing.sense(rollout, &mut found.trials)?
        }
        _ => Vec::new(),
    };
    let strategies: Vec<Strategy> = chosen
        .iter()
        .zip(&predictions)
        .zip(&forecast)
        .map(|((c, prediction), row)| Strategy {
            name: c.strategy.clone(),
            action: c.action.clone(),
            objective: c.objective,
            prediction: *prediction,
            outcomes: shots(row).into_iter().map(|s| Some(s.objective()).filter(|v| v.is_finite())).collect(),
            refused: shots(row).into_iter().filter(|s| *s == Shot::Refused).count(),
            as_named_share: (!row.is_empty()).then(|| {
                let is_so = |shot: &&Seen| shot.1.as_ref().is_some_and(|s| s.0 == c.strategy);
                row.iter().filter(is_so).count() as f64 / row.len() as f64
            }),
        })
        .collect();
    let reasons = match &rollout {
        Some(rollout) if config.sensitivity_rollouts > 0 => {
            let explaining = Explaining {
                task,
                scene,
                factory,
                config,
                space: &space,
                nominal: &nominal,
                counter: &counter,
                scored: &found.scored,
                known: &known,
            };
            explaining.reasons(&chosen, &strategies, rollout, &mut found.trials)?
        }
        _ => Vec::new(),
    };
    let plan = Plan {
        task: task.kind().to_owned(),
        engine: factory.engine().to_owned(),
        parameters: task.parameters(),
        action,
        objective: winner.objective,
        objective_unit: task.objective_unit().to_owned(),
        objective_q90,
        evaluations: counter.done() + 1,
        invalid: counter.invalid(),
        unbelievable: counter.unbelievable(),
        searched,
        refused,
        striker: task.striker_name(),
        robot: task.arm().map(|a| a.settings().clone()),
        starts: found.starts,
        chosen_by: predicted.map(|_| config.objective),
        predicted,
        strategies,
        reasons,
        sensitivities,
        trajectory: rollout.and_then(|r| r.trajectory).unwrap_or_default(),
    };
    warn(task, &plan, warnings);
    Ok(PlanOutcome { plan, trials: found.trials })
}

/// What comes of a shot in a disturbed world, and the strategy that it turned out to be with the bodies that it touched.
type Seen = (Shot, Option<(String, BTreeSet<BodyId>)>);

fn shots(row: &[Seen]) -> Vec<Shot> {
    row.iter().map(|seen| seen.0).collect()
}

/// Tries the chosen actions in worlds that played no part in choosing them.
fn forecast(
    chosen: &[Candidate],
    worlds: &DisturbedWorlds<'_>,
    counter: &Counter<'_>,
    see: &(dyn Fn(&Rollout) -> (String, BTreeSet<BodyId>) + Sync),
    trials: &mut Vec<Trial>,
) -> Result<Vec<Vec<Seen>>, PlanError> {
    let actions: Vec<Action> = chosen.iter().map(|c| c.action.clone()).collect();
    let rows = worlds.look(&actions, 0..worlds.len(), counter, see)?;
    for (i, row) in rows.iter().enumerate() {
        for (w, objective) in shots(row).into_iter().map(Shot::objective).enumerate() {
            trials.push(Trial::new(Phase::Forecast, i as i32, w as i32, actions[i].clone(), objective));
        }
    }
    Ok(rows)
}

/// What a search of the nominal world alone found.
#[derive(Debug, Clone, PartialEq)]
pub struct NominalSearch {
    /// Every rollout: the scan, then the searches in order of their starts.
    pub trials: Vec<Trial>,
    /// The local searches.
    pub starts: Vec<StartSummary>,
}

impl NominalSearch {
    /// The best valid trial.
    pub fn best(&self) -> Option<&Trial> {
        self.trials.iter().filter(|t| t.valid).min_by(|a, b| a.objective.total_cmp(&b.objective))
    }
}

/// The first part of [`plan`] alone, for comparing methods: searches the nominal world with at most `budget` rollouts.
///
/// # Errors
/// As [`plan`]; a search without any valid rollout is not an error here.
pub fn search_nominal(
    task: &ResolvedTask,
    scene: &Scene,
    factory: &dyn WorldFactory,
    config: &PlanConfig,
    budget: usize,
    seed: Seed,
    cancel: &Cancel,
) -> Result<NominalSearch, PlanError> {
    config.validate(Path::new("(settings of the planner)"))?;
    let space = Space::new(task);
    let nominal = Worlds::new(task, Cow::Borrowed(scene), factory)?;
    let counter = Counter::new(&NoProgress, cancel);
    let feasible = |x: &[f64]| counter.draw(task, &space.action(x));
    let found = search(&space, config, seed.derive("search"), budget, &feasible, &|x| {
        counter.count(|| nominal.objective(&task.strike(&space.action(x))))
    })?;
    Ok(NominalSearch { trials: found.trials, starts: found.starts })
}

/// Constructs an optimiser of the box of actions. The points that it may try first are those that are feasible.
pub type MakeOptimiser<'a> = &'a dyn Fn(&Space, Feasible<'_>) -> Result<Box<dyn BatchOptimiser>, PlanError>;

/// [`search_nominal`] by another optimiser than the planner's.
///
/// # Errors
/// As [`search_nominal`].
pub fn search_nominal_by(
    task: &ResolvedTask,
    scene: &Scene,
    factory: &dyn WorldFactory,
    make: MakeOptimiser<'_>,
    budget: usize,
    cancel: &Cancel,
) -> Result<NominalSearch, PlanError> {
    let space = Space::new(task);
    let nominal = Worlds::new(task, Cow::Borrowed(scene), factory)?;
    let counter = Counter::new(&NoProgress, cancel);
    let feasible = |x: &[f64]| counter.draw(task, &space.action(x));
    let mut optimiser = make(&space, &feasible)?;
    let found = search_by(optimiser.as_mut(), &space, budget, &feasible, &|x| {
        counter.count(|| nominal.objective(&task.strike(&space.action(x))))
    })?;
    Ok(NominalSearch { trials: found.trials, starts: found.starts })
}

/// How many strikes are refused.
fn total(refusals: &[Refusal]) -> usize {
    refusals.iter().map(|r| r.count).sum()
}

/// The robot can make none of the strikes.
fn out_of_reach(task: &ResolvedTask, refusals: &[Refusal], evaluations: usize) -> InputError {
    let list: Vec<String> = refusals.iter().map(|r| format!("{} ({})", r.reason, r.count)).collect();
    let cue = task.cue();
    InputError::new(
        format!(
            "the robot can make none of the {evaluations} strikes of `{}` that were looked at: {}",
            cue.name,
            list.join(", ")
        ),
        "[robot]",
        "place the robot nearer or further away (`x_world_robot` of [robot]; 0.1 to 0.2 m further where its links would meet each \
         other), take away what stands beside the struck body, lower the task's speeds, or plan without the robot",
    )
}

fn warn(task: &ResolvedTask, plan: &Plan, warnings: &Warnings) {
    if !task.is_success(plan.objective) {
        warnings.add(
            "plan",
            "no_good_shot",
            format!(
                "no shot was found that does what the task asks; the best one comes to {:.1} cm",
                1e2 * plan.objective
            ),
            "move the goal, widen the task's bounds, or plan with more evaluations",
        );
    } else if !task.is_success(plan.objective_q90) {
        warnings.add(
            "plan",
            "fragile_shot",
            format!(
                "the chosen shot comes to {:.1} cm, but only to {:.1} cm in nine of ten worlds that \
                 differ within what is known",
                1e2 * plan.objective,
                1e2 * plan.objective_q90
            ),
            "narrow the material intervals, or choose a goal that is easier to reach",
        );
    }
    let refused = total(&plan.refused);
    if let Some(text) = plan.refused_text().filter(|_| 2 * refused > plan.searched) {
        warnings.add(
            "plan",
            "out_of_reach",
            text,
            "look at where the robot stands, and at what stands around the struck body",
        );
    }
    let unreachable = plan.starts.iter().filter(|s| s.is_out_of_reach()).count();
    if unreachable > 0 {
        warnings.add(
            "plan",
            "starts_out_of_reach",
            format!(
                "{unreachable} of {} searches were not begun: no strike that the robot can make was found for them",
                plan.starts.len()
            ),
            "look at where the robot stands, and at what stands around the struck body",
        );
    }
    if let Some(why) = plan.strategies.first().and_then(Strategy::unbelievable_text) {
        warnings.add(
            "plan",
            "forecast_failed",
            format!("what the chosen shot does in disturbed worlds is not known: it {why}"),
            if plan.strategies[0].refused == plan.strategies[0].outcomes.len() {
                "the strike is at the edge of what the robot can do: look at where it stands (`x_world_robot`)"
            } else {
                "look for interpenetrating or very light bodies in the scene; do not carry the shot out"
            },
        );
    }
    if plan.invalid > 0 {
        let why = plan.unbelievable_text().unwrap_or_default();
        warnings.add(
            "plan",
            "failed_rollouts",
            format!(
                "{} of {} simulated shots cannot be believed and were not counted: {why}",
                plan.invalid, plan.evaluations
            ),
            "look for interpenetrating or very light bodies in the scene",
        );
    }
}
