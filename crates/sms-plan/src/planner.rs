//! The planner: from a task and a scene to a plan (paper section "Simulate").

use crate::candidate::{RobustCandidate, key};
use crate::config::SOLVED;
use crate::counter::{Counter, Reasons};
use crate::explain::Explanation;
use crate::prediction::RolloutOutcome;
use crate::robust::RobustChoice;
use crate::screening::Feasible;
use crate::search::{SearchLog, optimiser, search};
use crate::sensitivity_analysis::SensitivityAnalysis;
use crate::session::Session;
use crate::space::Space;
use crate::strategy::touched;
use crate::worlds::{PerturbedWorlds, Worlds};
use crate::{
    BatchOptimiser, Plan, PlanConfig, PlanError, PlanOutcome, Prediction, Reason, Refusal, Sensitivity,
    Strategy, Trial, TrialPhase,
};
use sms_core::{Cancel, InputError, NoProgress, StageContext, Warnings, counted, length_text, lengths_text};
use sms_scene::Scene;
use sms_sim::{BodyId, WorldFactory};
use sms_task::{Action, MotionRecording, ResolvedTask, Rollout};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::Path;
use std::sync::Mutex;

/// Time between recorded states of the plan's trajectory, seconds.
const RECORD_EVERY_S: f64 = 1.0 / 120.0;

/// Plans an action for a task.
///
/// The planner searches the actions in the nominal world. It then chooses by the outcomes in perturbed worlds:
/// materials sampled within their intervals, small errors of object poses, radii and the strike. All candidates are
/// tried in the same worlds.
///
/// Candidates are distinct actions that improve on doing nothing, from the nominal search and from a scan of the
/// perturbed worlds. They are tried in a few worlds, simplex searches start from the best of them, and the better half
/// is tried in twice as many worlds until half of the worlds are used. The best few are then tried in the other half,
/// and the smallest [`PlanConfig::objective`] over all worlds wins. Its prediction comes from worlds that were not used
/// for the choice.
///
/// The plan is the same for any number of threads of rayon's current pool. The planner uses only `scene`, never the
/// truth.
///
/// # Errors
/// [`PlanError`]: bad settings, a scene that cannot be simulated, no strike within the robot's reach, or interruption.
pub fn plan(
    task: &ResolvedTask,
    scene: &Scene,
    factory: &dyn WorldFactory,
    config: &PlanConfig,
    context: StageContext<'_>,
) -> Result<PlanOutcome, PlanError> {
    let StageContext { progress, cancel, warnings, seed } = context;
    config.validate(Path::new(SETTINGS))?;
    let session = Session {
        task,
        scene,
        factory,
        config,
        seed,
        space: Space::new(task),
        nominal: Worlds::new(task, Cow::Borrowed(scene), factory)?,
        counter: Counter::new(progress, cancel),
    };
    let mut planning = Planning::search(&session)?;
    let counter = &session.counter;
    counter.end(&format!("best of {} shots: {}", planning.evaluations, length_text(planning.found.best())));
    let chosen = planning.choose()?;
    counter.end(&counted(chosen.len(), "strategy", "strategies"));
    let forecast = planning.forecast(&chosen)?;
    let (searched, refused) = planning.considered();
    let predictions: Vec<Option<Prediction>> =
        forecast.iter().map(|row| Prediction::of(&outcomes(row), |v| task.is_success(v))).collect();
    let winner = &chosen[0];
    let predicted = predictions[0];
    let on_average = |p: Prediction| format!("chosen shot: {} on average", length_text(p.mean));
    counter.end(&predicted.map(on_average).unwrap_or_default());
    let objective_q90 = predicted.map_or(winner.objective, |p| p.q90);
    for start in planning.found.starts.iter_mut().filter(|s| s.action == winner.action) {
        start.objective_q90 = Some(objective_q90);
    }
    let rollout = planning.record(&winner.action)?;
    let (mut sensitivities, mut reasons) = (Vec::new(), Vec::new());
    let strategies = strategies(&chosen, &predictions, &forecast);
    if let Some(rollout) = rollout.as_ref().filter(|_| config.sensitivity_rollouts > 0) {
        // The number of rollouts depends on what they show.
        counter.begin("plan: reasons", 0);
        // Sensitivities explain the spread of a forecast, so they need one.
        if predicted.is_some() {
            sensitivities = planning.sensitivities(winner, rollout, &forecast[0])?;
        }
        reasons = planning.reasons(&chosen, &strategies, rollout)?;
        let found = counted(sensitivities.len(), "sensitivity", "sensitivities");
        counter.end(&format!("{}, {found}", counted(reasons.len(), "reason", "reasons")));
    }
    let plan = Plan {
        task: task.kind().to_owned(),
        engine: factory.engine().to_owned(),
        parameters: task.parameters(),
        action: winner.action.clone(),
        objective: winner.objective,
        objective_unit: task.objective_unit().to_owned(),
        objective_q90,
        evaluations: counter.done() + 1,
        invalid: counter.invalid(),
        invalid_rollouts: counter.invalid_rollouts(),
        searched,
        refused,
        striker: task.striker_name(),
        robot: task.arm().map(|a| a.settings().clone()),
        starts: planning.found.starts,
        chosen_by: predicted.map(|_| config.objective),
        predicted,
        strategies,
        reasons,
        sensitivities,
        trajectory: rollout.and_then(|r| r.trajectory).unwrap_or_default(),
    };
    warn(task, &plan, warnings);
    Ok(PlanOutcome { plan, trials: planning.found.trials })
}

/// Source of settings made by the caller, for error messages.
const SETTINGS: &str = "(settings of the planner)";

/// A planning run after its nominal search.
struct Planning<'a> {
    session: &'a Session<'a>,
    found: SearchLog,
    /// Strategies of the rollouts of the search, by [`key`].
    known: BTreeMap<Vec<u64>, String>,
    /// Rollouts of the search.
    evaluations: usize,
    /// Strikes refused in place of a rollout during the search.
    struck: Reasons,
}

/// The outcome of a shot in a forecast world; for a simulated shot also its strategy and the touched bodies.
type ForecastOutcome = (RolloutOutcome, Option<(String, BTreeSet<BodyId>)>);

fn outcomes(row: &[ForecastOutcome]) -> Vec<RolloutOutcome> {
    row.iter().map(|o| o.0).collect()
}

impl<'a> Planning<'a> {
    /// Searches the nominal world, repeatedly from other points while the best objective is poor.
    fn search(session: &'a Session<'a>) -> Result<Self, PlanError> {
        let (config, counter) = (session.config, &session.counter);
        counter.begin("plan: search", config.planned_evaluations());
        // Keyed by the point, so that the order in which threads finish does not matter.
        let known: Mutex<BTreeMap<Vec<u64>, String>> = Mutex::default();
        let settings = PlanConfig { evaluations: config.nominal_evaluations(), ..config.clone() };
        let objective = |x: &[f64]| {
            let mut strategy = None;
            let objective = counter.count(|| {
                let rollout =
                    session.nominal.rollout(&session.task.strike(&session.space.action(x)), None)?;
                strategy = Some(session.strategy_of(&rollout));
                Ok(rollout.objective)
            })?;
            if let (Some(strategy), Ok(mut known)) = (strategy, known.lock()) {
                known.insert(key(x), strategy);
            }
            Ok(objective)
        };
        let mut found = SearchLog::default();
        for round in 0..config.searches() {
            if round > 0 {
                counter.begin("plan: search from other points", config.planned_evaluations());
            }
            // Seeds derive from these names, which therefore stay unchanged.
            let seed = match round {
                0 => session.seed.derive("search"),
                _ => session.seed.derive_index("search anew", round as u64),
            };
            let feasible = |x: &[f64]| session.is_feasible(x);
            let mut optimiser = optimiser(&session.space, &settings, seed, &feasible)?;
            found.append(search(optimiser.as_mut(), &session.space, config.budget(), &feasible, &objective)?);
            if found.best() <= SOLVED * session.task.success_m() {
                break;
            }
        }
        let known = known.into_inner().unwrap_or_default();
        let planning = Self { session, found, known, evaluations: counter.done(), struck: counter.refused() };
        planning.check_found()?;
        Ok(planning)
    }

    /// Returns an error if no rollout of the search was valid.
    fn check_found(&self) -> Result<(), PlanError> {
        if self.found.best().is_finite() {
            return Ok(());
        }
        let (session, evaluations) = (self.session, self.evaluations);
        let refused = session.counter.refusals(&self.struck);
        let considered = evaluations + Refusal::total(&refused) - self.struck.values().sum::<usize>();
        if Refusal::total(&refused) == considered {
            return Err(PlanError::OutOfReach(out_of_reach(session.task, &refused, considered)));
        }
        Err(PlanError::Nothing { engine: session.factory.engine().to_owned(), evaluations })
    }

    fn perturbed_worlds(&self, indices: Range<usize>) -> Result<PerturbedWorlds<'a>, PlanError> {
        PerturbedWorlds::new(self.session, self.session.seed.derive("disturbed"), indices, &|_| true)
    }

    /// The best action of each strategy, best strategy first; at least one.
    fn choose(&mut self) -> Result<Vec<RobustCandidate>, PlanError> {
        let session = self.session;
        if session.config.perturbation.worlds > 0 {
            session.counter.begin("plan: perturbed worlds", session.config.perturbed_rollouts());
        }
        let worlds = self.perturbed_worlds(0..2 * session.config.perturbation.worlds)?;
        let choice = RobustChoice { session, known: &self.known };
        let chosen = choice.choose(&mut self.found, &worlds, session.seed.derive("robust scan"))?;
        if chosen.is_empty() {
            let refused = session.counter.refusals(&self.struck);
            return Err(PlanError::OutOfReach(out_of_reach(
                session.task,
                &refused,
                Refusal::total(&refused),
            )));
        }
        Ok(chosen)
    }

    /// Tries the chosen actions in other worlds: the winner's outcomes in the worlds of the choice are biased.
    fn forecast(&mut self, chosen: &[RobustCandidate]) -> Result<Vec<Vec<ForecastOutcome>>, PlanError> {
        let session = self.session;
        let first = 2 * session.config.perturbation.worlds;
        let count = if first == 0 { 0 } else { session.config.forecast_worlds };
        let worlds = self.perturbed_worlds(first..first + count)?;
        let actions: Vec<Action> = chosen.iter().map(|c| c.action.clone()).collect();
        if worlds.len() > 0 {
            session.counter.begin("plan: forecast", actions.len() * worlds.len());
        }
        let look = |rollout: &Rollout| (session.strategy_of(rollout), touched(rollout, session.scene));
        let rows = worlds.look(&actions, 0..worlds.len(), &look)?;
        for (i, row) in rows.iter().enumerate() {
            let objectives: Vec<f64> = row.iter().map(|o| o.0.objective()).collect();
            self.found.trials.extend(Trial::row(TrialPhase::Forecast, i, 0, &actions[i], &objectives));
        }
        Ok(rows)
    }

    /// The number of actions considered so far (rollouts of the search, scan, refused points of both), and the refused.
    fn considered(&self) -> (usize, Vec<Refusal>) {
        let is_scan = |t: &&Trial| t.phase == TrialPhase::Perturbed && t.start == -1;
        let scanned = self.found.trials.iter().filter(is_scan).count();
        let refused = self.session.counter.refusals(&self.struck);
        let struck = self.struck.values().sum::<usize>();
        (self.evaluations + scanned + Refusal::total(&refused) - struck, refused)
    }

    /// Records the motion of an action in the nominal world. Returns `None` if the rollout is not valid to its end,
    /// which may be later than the moment that decides the objective.
    fn record(&self, action: &Action) -> Result<Option<Rollout>, PlanError> {
        let recording = MotionRecording { every_s: RECORD_EVERY_S };
        match self.session.nominal.rollout(&self.session.task.strike(action), Some(recording)) {
            Err(e) if !e.is_invalid_rollout() => Err(e.into()),
            other => Ok(other.ok()),
        }
    }

    fn sensitivities(
        &mut self,
        winner: &RobustCandidate,
        rollout: &Rollout,
        forecast: &[ForecastOutcome],
    ) -> Result<Vec<Sensitivity>, PlanError> {
        let perturbed = forecast.iter().filter_map(|o| o.1.as_ref()).flat_map(|o| o.1.clone());
        let touched = perturbed.chain(touched(rollout, self.session.scene)).collect();
        let sensing = SensitivityAnalysis { session: self.session, winner, touched: &touched };
        sensing.sense(rollout, &mut self.found.trials)
    }

    fn reasons(
        &mut self,
        chosen: &[RobustCandidate],
        strategies: &[Strategy],
        rollout: &Rollout,
    ) -> Result<Vec<Reason>, PlanError> {
        let explaining =
            Explanation { session: self.session, scored: &self.found.scored, known: &self.known };
        explaining.reasons(chosen, strategies, rollout, &mut self.found.trials)
    }
}

/// The chosen actions with their predictions and outcomes.
fn strategies(
    chosen: &[RobustCandidate],
    predictions: &[Option<Prediction>],
    forecast: &[Vec<ForecastOutcome>],
) -> Vec<Strategy> {
    let strategy =
        |((c, prediction), row): ((&RobustCandidate, &Option<Prediction>), &Vec<ForecastOutcome>)| {
            let all = outcomes(row);
            let is_as_named = |o: &&ForecastOutcome| o.1.as_ref().is_some_and(|s| s.0 == c.strategy);
            Strategy {
                name: c.strategy.clone(),
                action: c.action.clone(),
                objective: c.objective,
                prediction: *prediction,
                outcomes: all.iter().map(|o| Some(o.objective()).filter(|v| v.is_finite())).collect(),
                refused: all.iter().filter(|o| **o == RolloutOutcome::Refused).count(),
                as_named_share: (!row.is_empty())
                    .then(|| row.iter().filter(is_as_named).count() as f64 / row.len() as f64),
            }
        };
    chosen.iter().zip(predictions).zip(forecast).map(strategy).collect()
}

/// Constructs an optimiser for the box of actions. It may first try points that are feasible.
pub type MakeOptimiser<'a> = &'a dyn Fn(&Space, Feasible<'_>) -> Result<Box<dyn BatchOptimiser>, PlanError>;

/// Searches the nominal world with at most `budget` rollouts: the first part of [`plan`], for comparisons of methods.
///
/// # Errors
/// As [`plan`], except that a search without a valid rollout is not an error.
pub fn search_nominal(
    task: &ResolvedTask,
    scene: &Scene,
    factory: &dyn WorldFactory,
    make: MakeOptimiser<'_>,
    budget: usize,
    cancel: &Cancel,
) -> Result<SearchLog, PlanError> {
    let space = Space::new(task);
    let nominal = Worlds::new(task, Cow::Borrowed(scene), factory)?;
    let counter = Counter::new(&NoProgress, cancel);
    let feasible = |x: &[f64]| counter.draw(task, &space.action(x));
    let mut optimiser = make(&space, &feasible)?;
    search(optimiser.as_mut(), &space, budget, &feasible, &|x| {
        counter.count(|| nominal.objective(&task.strike(&space.action(x))))
    })
}

/// Number of refused strikes.
/// The error for a robot that cannot carry out any strike.
fn out_of_reach(task: &ResolvedTask, refusals: &[Refusal], considered: usize) -> InputError {
    let list: Vec<String> = refusals.iter().map(|r| format!("{} ({})", r.reason, r.count)).collect();
    InputError::new(
        format!(
            "the robot cannot carry out any of the {considered} strikes of `{}` that were considered: {}",
            task.cue().name,
            list.join(", ")
        ),
        "[robot]",
        "move the robot nearer or further away (`x_world_robot` of [robot]; by 0.1 to 0.2 m further where its links would \
         collide), remove obstacles beside the struck body, lower the task's speeds, or plan without the robot",
    )
}

fn warn(task: &ResolvedTask, plan: &Plan, warnings: &Warnings) {
    if !task.is_success(plan.objective) {
        warnings.add(
            "plan",
            "no_good_shot",
            format!(
                "no shot meets the task's success limit; the best one misses by {}",
                length_text(plan.objective)
            ),
            "move the goal, widen the task's bounds, or plan with more evaluations",
        );
    } else if !task.is_success(plan.objective_q90) {
        let [scanned, q90] = lengths_text([plan.objective, plan.objective_q90]);
        warnings.add(
            "plan",
            "fragile_shot",
            format!(
                "the chosen shot misses by {scanned} in the scanned world, but by {q90} at the 90 % quantile over perturbed \
                 worlds"
            ),
            "narrow the material intervals, or choose an easier goal",
        );
    }
    if let Some(text) = plan.refused_text().filter(|_| plan.is_mostly_refused()) {
        warnings.add(
            "plan",
            "out_of_reach",
            text,
            "check the robot's pose and the obstacles around the struck body",
        );
    }
    let unreachable = plan.starts.iter().filter(|s| s.is_out_of_reach()).count();
    if unreachable > 0 {
        warnings.add(
            "plan",
            "starts_out_of_reach",
            format!(
                "{unreachable} of {} searches did not start: no strike within the robot's reach was found for them",
                plan.starts.len()
            ),
            "check the robot's pose and the obstacles around the struck body",
        );
    }
    if let Some(why) = plan.strategies.first().and_then(Strategy::failure_text) {
        warnings.add(
            "plan",
            "forecast_failed",
            format!("the chosen shot has no forecast in perturbed worlds: it {why}"),
            if plan.strategies[0].refused == plan.strategies[0].outcomes.len() {
                "the strike is at the edge of the robot's reach: move the robot (`x_world_robot`)"
            } else {
                "check the scene for interpenetrating or very light bodies; do not carry out the shot"
            },
        );
    }
    if plan.invalid > 0 {
        let why = plan.failure_text().unwrap_or_default();
        warnings.add(
            "plan",
            "failed_rollouts",
            format!(
                "{} of {} simulated shots are invalid and were not counted: {why}",
                plan.invalid, plan.evaluations
            ),
            "check the scene for interpenetrating or very light bodies",
        );
    }
}
