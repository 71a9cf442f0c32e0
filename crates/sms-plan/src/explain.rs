//! Reasons for a choice, found by counterfactual rollouts: the outcome if a body that the shot relies on had a
//! different property.

use crate::candidate::{RobustCandidate, key};
use crate::search::ScoredPoint;
use crate::session::Session;
use crate::strategy::{Story, story_of};
use crate::worlds::Worlds;
use crate::{
    BodyProperty, Counterfactual, LocalSearch, NelderMead, PlanError, Reason, Strategy, Trial, TrialPhase,
};
use sms_core::{MassProperties, length_text};
use sms_scene::{Body, BodyKind};
use sms_sim::BodyId;
use sms_task::{Action, MotionRecording, Rollout};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Effective densities, kg/m³, of the lightest and heaviest common objects: an empty carton, and solid brass.
const LIGHT: f64 = 110.0;
const HEAVY: f64 = 8500.0;
/// Coefficients of slippery and rough, and of dull and lively surfaces.
const FRICTIONS: [f64; 2] = [0.1, 0.9];
const RESTITUTIONS: [f64; 2] = [0.1, 0.9];
/// Smallest change of the objective that matters, metres, and smallest factor.
const MATTERS: (f64, f64) = (0.005, 2.0);
/// A body that moves farther than this counts as pushed, metres.
const PUSHED_M: f64 = 0.001;
/// Largest number of examined bodies of the chosen shot, and of other strategies.
const MOST_BODIES: usize = 2;
const MOST_OTHERS: usize = 2;
/// Smallest budget of a search, rollouts.
const LEAST_SEARCH: usize = 6;
/// Time between recorded states when the motion of a pushed body is measured, seconds.
const EVERY_S: f64 = 0.02;

/// The explanation of one choice.
pub(crate) struct Explanation<'a> {
    pub(crate) session: &'a Session<'a>,
    /// Every shot of the nominal search.
    pub(crate) scored: &'a [ScoredPoint],
    /// Their strategies, by [`key`].
    pub(crate) known: &'a BTreeMap<Vec<u64>, String>,
}

/// A recorded shot.
struct ShotRecord {
    story: Story,
    rollout: Rollout,
}

/// A world in which one body has a different property, with the state of a search in it.
struct SearchWorld<'a> {
    worlds: &'a Worlds<'a>,
    /// The body; shots that do not touch it do not count.
    body: BodyId,
    /// Start index in the trial log.
    start: i32,
    /// Shots tried so far.
    tried: usize,
}

/// A body with a different property.
struct Change {
    body: BodyId,
    property: BodyProperty,
    values: [f64; 2],
}

impl Explanation<'_> {
    /// Returns the reasons, most important first. Spends at most `config.sensitivity_rollouts` rollouts.
    pub(crate) fn reasons(
        &self,
        chosen: &[RobustCandidate],
        strategies: &[Strategy],
        rollout: &Rollout,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<Reason>, PlanError> {
        let mut reasons: Vec<Reason> = self.comparison(strategies).into_iter().collect();
        let winner = &chosen[0];
        let look = self.look_of(rollout.clone());
        let relied: Vec<BodyId> = self.props(&look.story).into_iter().take(MOST_BODIES).collect();
        let mut spent = 0;
        let mut found: Vec<Counterfactual> = Vec::new();
        for &body in &relied {
            for change in self.changes(body) {
                if spent == self.session.config.sensitivity_rollouts {
                    break;
                }
                let world = self.world(&change)?;
                let other = self.record(&world, &winner.action, spent, trials)?;
                spent += 1;
                // An invalid rollout is no evidence.
                let Some(other) = other else { continue };
                if matters(look.rollout.objective, other.rollout.objective) {
                    found.push(self.counterfactual(winner.strategy.clone(), &change, &look, &other, 1));
                }
            }
        }
        found.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
        // Keep the most important property of each body.
        let mut explained: Vec<String> = Vec::new();
        for c in found {
            if !explained.contains(&c.body) {
                explained.push(c.body.clone());
                reasons.push(Reason { text: relies(&c), counterfactual: Some(c) });
            }
        }
        reasons.extend(self.others(chosen, &relied, spent, trials)?);
        Ok(reasons)
    }

    /// Compares the predictions of the best and of the second-best strategy.
    fn comparison(&self, strategies: &[Strategy]) -> Option<Reason> {
        let [best, next] = strategies.first_chunk::<2>()?;
        let text = match (&best.prediction, &next.prediction) {
            (Some(a), Some(b)) => format!(
                "“{}” misses by {} on average and succeeds in {:.0} % of {} worlds; the second best, “{}”, misses by {} and succeeds in {:.0} %",
                best.name,
                length_text(a.mean),
                100.0 * a.success_share,
                a.worlds,
                next.name,
                length_text(b.mean),
                100.0 * b.success_share,
            ),
            _ => format!(
                "“{}” misses by {} in the scanned world; the second best, “{}”, by {}",
                best.name,
                length_text(best.objective),
                next.name,
                length_text(next.objective),
            ),
        };
        Some(Reason { text, counterfactual: None })
    }

    /// Returns the dynamic bodies that a shot relies on, without the two bodies of the task.
    fn props(&self, story: &Story) -> Vec<BodyId> {
        let (cue, target) = (self.session.task.cue().index, self.session.task.target().index);
        let mut props: Vec<BodyId> = Vec::new();
        for &b in &story.involved {
            let is_prop = b != cue && b != target && self.session.scene.bodies[b].kind == BodyKind::Dynamic;
            if is_prop && !props.contains(&b) {
                props.push(b);
            }
        }
        props
    }

    /// Explains the rejection of strategies that rely on another body: a different property of this body would make
    /// them good. Searches shots of each strategy in worlds with such properties.
    fn others(
        &self,
        chosen: &[RobustCandidate],
        relied: &[BodyId],
        mut spent: usize,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<Reason>, PlanError> {
        let mut reasons = Vec::new();
        let (mut examined, mut explained) = (0, Vec::new());
        for (name, points) in self.ways(&chosen[0].strategy) {
            let left = self.session.config.sensitivity_rollouts.saturating_sub(spent);
            if examined == MOST_OTHERS || left < 1 + LEAST_SEARCH {
                break;
            }
            let action = self.session.space.action(&points[0].x);
            spent += 1;
            let Some(look) = self.record(&self.session.nominal, &action, spent, trials)? else { continue };
            let props = self.props(&look.story);
            let Some(&body) = props.iter().find(|b| !relied.contains(b) && !explained.contains(*b)) else {
                continue;
            };
            examined += 1;
            let changes: Vec<Change> =
                self.changes(body).into_iter().filter(|c| c.property == BodyProperty::Mass).collect();
            for change in &changes {
                let left = self.session.config.sensitivity_rollouts.saturating_sub(spent);
                let budget = left / ((MOST_OTHERS + 1 - examined) * changes.len()).max(1);
                if budget < LEAST_SEARCH {
                    continue;
                }
                let world = self.world(change)?;
                let mut search = SearchWorld { worlds: &world, body, start: spent as i32, tried: 0 };
                let best = self.best_in(&mut search, &points, budget - 1, trials)?;
                let shots = search.tried;
                spent += shots + 1;
                let Some(other) = best.map(|a| self.record(&world, &a, spent, trials)).transpose()?.flatten()
                else {
                    continue;
                };
                if matters(other.rollout.objective, look.rollout.objective) {
                    explained.push(body);
                    let c = self.counterfactual(name.clone(), change, &look, &other, shots);
                    let text = rejected(&c, matters(other.rollout.objective, chosen[0].objective));
                    reasons.push(Reason { text, counterfactual: Some(c) });
                }
            }
        }
        Ok(reasons)
    }

    /// Returns strategies other than the chosen one, ordered by their best shot, each with its shots, best first.
    fn ways(&self, chosen: &str) -> Vec<(String, Vec<&ScoredPoint>)> {
        let mut by_name: BTreeMap<&str, Vec<&ScoredPoint>> = BTreeMap::new();
        for s in self.scored.iter().filter(|s| s.objective.is_finite()) {
            if let Some(name) = self.known.get(&key(&s.x)).filter(|n| n.as_str() != chosen) {
                by_name.entry(name).or_default().push(s);
            }
        }
        let mut ways: Vec<(String, Vec<&ScoredPoint>)> =
            by_name.into_iter().map(|(name, shots)| (name.to_owned(), shots)).collect();
        for (_, shots) in &mut ways {
            shots.sort_by(|a, b| a.objective.total_cmp(&b.objective));
        }
        ways.sort_by(|a, b| a.1[0].objective.total_cmp(&b.1[0].objective));
        ways
    }

    /// Returns the best shot of a search world among those that still touch its body. The first half of the budget is
    /// spent on shots from the scanned world, from the best to the worst; the other half on a simplex search.
    fn best_in(
        &self,
        world: &mut SearchWorld<'_>,
        points: &[&ScoredPoint],
        budget: usize,
        trials: &mut Vec<Trial>,
    ) -> Result<Option<Action>, PlanError> {
        let count = points.len().min(budget.div_ceil(2));
        let mut best: Option<(Vec<f64>, f64)> = None;
        for k in 0..count {
            let x = &points[k * points.len() / count].x;
            let v = self.value_in(world, x, trials)?;
            if v.is_finite() && best.as_ref().is_none_or(|b| v < b.1) {
                best = Some((x.clone(), v));
            }
        }
        let Some((x, v)) = best else { return Ok(None) };
        let settings = NelderMead { restarts: 0, ..self.session.config.nelder_mead };
        let space = &self.session.space;
        let steps = space.steps(0.5 * self.session.config.initial_step, space.is_promising(&x));
        let mut search = LocalSearch::new(&settings, std::slice::from_ref(&x), &steps, Some(v));
        for _ in count..budget {
            let Some(x) = self.session.next_feasible(&mut search)? else { break };
            search.tell(self.value_in(world, &x, trials)?);
        }
        Ok(Some(space.action(&search.minimum().x)))
    }

    /// Returns the objective of a unit point in a search world; infinite if the shot does not touch its body.
    fn value_in(
        &self,
        world: &mut SearchWorld<'_>,
        x: &[f64],
        trials: &mut Vec<Trial>,
    ) -> Result<f64, PlanError> {
        let action = self.session.space.action(x);
        let mut touches = false;
        let objective = self.session.counter.count(|| {
            let rollout = world.worlds.rollout(&self.session.task.strike(&action), None)?;
            touches = self.look_of(rollout.clone()).story.involved.contains(&world.body);
            Ok(rollout.objective)
        })?;
        trials.push(Trial::new(TrialPhase::Reason, world.start, world.tried as i32, action, objective));
        world.tried += 1;
        Ok(if touches { objective } else { f64::INFINITY })
    }

    /// Plausible other properties of a body.
    fn changes(&self, body: BodyId) -> Vec<Change> {
        let b = &self.session.scene.bodies[body];
        let m = &b.material;
        let mut changes = Vec::new();
        let mut add = |property, was: f64, would: f64| {
            changes.push(Change { body, property, values: [was, would] });
        };
        if let Some(mass) = b.mass.map(|p| p.mass()) {
            let density = m.effective_density();
            let is_far = |to: f64| density > 0.0 && (density / to).ln().abs() > MATTERS.1.ln();
            if density > LIGHT && is_far(LIGHT) {
                add(BodyProperty::Mass, mass, mass * LIGHT / density);
            }
            if density < HEAVY && is_far(HEAVY) {
                add(BodyProperty::Mass, mass, mass * HEAVY / density);
            }
        }
        for (property, was, values) in [
            (BodyProperty::Friction, m.friction.value.best, FRICTIONS),
            (BodyProperty::Restitution, m.restitution.value.best, RESTITUTIONS),
        ] {
            for would in values {
                if (would - was).abs() > 0.1 {
                    add(property, was, would);
                }
            }
        }
        changes
    }

    fn world(&self, change: &Change) -> Result<Worlds<'_>, PlanError> {
        let mut scene = self.session.scene.without_pictures();
        change.apply(&mut scene.bodies[change.body]);
        Worlds::new(self.session.task, Cow::Owned(scene), self.session.factory)
    }

    /// Carries out a shot and records it; `None` when the rollout is invalid.
    fn record(
        &self,
        world: &Worlds<'_>,
        action: &Action,
        start: usize,
        trials: &mut Vec<Trial>,
    ) -> Result<Option<ShotRecord>, PlanError> {
        let mut seen = None;
        let objective = self.session.counter.count(|| {
            let recording = Some(MotionRecording { every_s: EVERY_S });
            let rollout = world.rollout(&self.session.task.strike(action), recording)?;
            let objective = rollout.objective;
            seen = Some(self.look_of(rollout));
            Ok(objective)
        })?;
        trials.push(Trial::new(TrialPhase::Reason, start as i32, -1, action.clone(), objective));
        Ok(seen)
    }

    fn look_of(&self, rollout: Rollout) -> ShotRecord {
        let story = story_of(&rollout.contacts, rollout.closest_s, self.session.scene, self.session.task);
        ShotRecord { story, rollout }
    }

    fn counterfactual(
        &self,
        strategy: String,
        change: &Change,
        look: &ShotRecord,
        other: &ShotRecord,
        shots: usize,
    ) -> Counterfactual {
        let body = self.session.scene.bodies[change.body].name.clone();
        Counterfactual {
            strategy,
            moved_m: [moved_m(&look.rollout, &body), moved_m(&other.rollout, &body)],
            body,
            property: change.property,
            values: change.values,
            objectives: [look.rollout.objective, other.rollout.objective],
            shots,
        }
    }
}

impl Change {
    fn apply(&self, body: &mut Body) {
        let [was, would] = self.values;
        match self.property {
            BodyProperty::Mass => {
                if let Some(p) = body.mass {
                    let ratio = would / was;
                    // A positive multiple of a valid inertia is valid.
                    body.mass = MassProperties::new(would, p.com(), p.inertia() * ratio).ok().or(Some(p));
                }
            }
            BodyProperty::Friction => body.material.friction.value.best = would,
            BodyProperty::Restitution => body.material.restitution.value.best = would,
            BodyProperty::Rolling => body.material.rolling_m.value.best = would,
        }
    }
}

/// Largest distance of a body from its start, metres.
fn moved_m(rollout: &Rollout, body: &str) -> f64 {
    let Some(trajectory) = &rollout.trajectory else { return 0.0 };
    let Some(track) = trajectory.body(body) else { return 0.0 };
    let places = || track.states.iter().map(|s| s.x_wb.translation);
    let start = places().next().unwrap_or_default();
    places().map(|p| p.distance(start)).fold(0.0, f64::max)
}

/// Returns whether the second objective is worse by a margin that matters.
fn matters(better: f64, worse: f64) -> bool {
    worse - better >= MATTERS.0 && worse >= MATTERS.1 * better
}

fn gain(c: &Counterfactual) -> f64 {
    (c.objectives[1] - c.objectives[0]).abs()
}

fn mass_text(kg: f64) -> String {
    if kg < 1.0 { format!("{:.0} g", 1e3 * kg) } else { format!("{kg:.1} kg") }
}

/// The actual and the counterfactual value of the property: "1.2 kg" and "50 g, as light as a carton of its size".
fn would_be(c: &Counterfactual) -> (String, String) {
    let [was, would] = c.values;
    match c.property {
        BodyProperty::Mass => {
            let like =
                if would < was { "as light as a carton of its size" } else { "as heavy as solid brass" };
            (mass_text(was), format!("{}, {like}", mass_text(would)))
        }
        _ => (format!("{was:.2}"), format!("{would:.2}")),
    }
}

fn property_text(c: &Counterfactual) -> String {
    format!("the {} of `{}`", c.property.as_str(), c.body)
}

fn relies(c: &Counterfactual) -> String {
    let (was, would) = would_be(c);
    let pushed = if (c.moved_m[1] - c.moved_m[0]).abs() < PUSHED_M {
        String::new()
    } else {
        let then = length_text(c.moved_m[1]);
        let now = if c.moved_m[0] < PUSHED_M {
            String::new()
        } else {
            format!(" instead of {}", length_text(c.moved_m[0]))
        };
        format!("; `{}` would be pushed by {then}{now}", c.body)
    };
    format!(
        "“{}” relies on {} ({was}): with {would}, this shot would miss by {} instead of {}{pushed}",
        c.strategy,
        property_text(c),
        length_text(c.objectives[1]),
        length_text(c.objectives[0])
    )
}

fn rejected(c: &Counterfactual, is_better: bool) -> String {
    let (was, would) = would_be(c);
    let pushed = if c.moved_m[0] >= PUSHED_M {
        format!(" and pushes `{}` by {}", c.body, length_text(c.moved_m[0]))
    } else {
        String::new()
    };
    format!(
        "“{}” misses by at least {}{pushed}. If {} were {would} instead of {was}, the best of {} such shots would miss by {}{}",
        c.strategy,
        length_text(c.objectives[0]),
        property_text(c),
        c.shots,
        length_text(c.objectives[1]),
        if is_better { ", less than the chosen shot" } else { "" }
    )
}
