//! Why an action was chosen: what would happen if a body that it relies on were another one.

use crate::robust::{Candidate, key};
use crate::search::Scored;
use crate::space::Space;
use crate::strategy::{Story, story_of};
use crate::worlds::{Counter, Worlds};
use crate::{LocalSearch, NelderMead, Phase, PlanConfig, PlanError, Strategy, Trial};
use serde::{Deserialize, Serialize};
use sms_core::{MassProperties, length_text};
use sms_scene::{Body, BodyKind, Scene};
use sms_sim::{BodyId, SimError, WorldFactory};
use sms_task::{Action, Recording, ResolvedTask, Rollout};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Effective densities, kg/m³, of an empty carton and of solid brass: as light and as heavy as things of a size are.
const LIGHT: f64 = 110.0;
const HEAVY: f64 = 8500.0;
/// Coefficients of slippery and of rough surfaces, of dull and of lively ones.
const FRICTIONS: [f64; 2] = [0.1, 0.9];
const RESTITUTIONS: [f64; 2] = [0.1, 0.9];
/// A change of the objective matters when it is at least this much, metres, and a factor of this.
const MATTERS: (f64, f64) = (0.005, 2.0);
/// A body that comes farther than this from its place is pushed, metres.
const PUSHED_M: f64 = 0.001;
/// Bodies of the chosen shot, and other strategies, that are looked at.
const MOST_BODIES: usize = 2;
const MOST_OTHERS: usize = 2;
/// Fewer rollouts are no search.
const LEAST_SEARCH: usize = 6;
/// Time between states in which a pushed body is looked at, seconds.
const EVERY_S: f64 = 0.02;

/// A property of a body that can be other than it is thought to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyProperty {
    /// Mass in kilograms, the inertia with it.
    Mass,
    /// Coefficient of friction.
    Friction,
    /// Coefficient of restitution.
    Restitution,
    /// Lever of the rolling resistance, metres.
    Rolling,
}

impl BodyProperty {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Mass, Self::Friction, Self::Restitution, Self::Rolling];

    /// In words.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Mass => "mass",
            Self::Friction => "friction",
            Self::Restitution => "restitution",
            Self::Rolling => "rolling resistance",
        }
    }

    /// Gives a body what another one has of this property.
    pub(crate) fn copy(self, from: &Body, to: &mut Body) {
        let (a, b) = (&from.material, &mut to.material);
        match self {
            Self::Mass => to.mass = from.mass,
            Self::Friction => b.friction.value.best = a.friction.value.best,
            Self::Restitution => b.restitution.value.best = a.restitution.value.best,
            Self::Rolling => b.rolling_m.value.best = a.rolling_m.value.best,
        }
    }
}

/// A shot in the scanned world, and in one in which one property of one body is another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Counterfactual {
    /// The way of reaching the goal.
    pub strategy: String,
    /// The body that it relies on.
    pub body: String,
    /// Its property.
    pub property: BodyProperty,
    /// What the property is, and what it would be.
    pub values: [f64; 2],
    /// Objective in the scanned world and in the other one.
    pub objectives: [f64; 2],
    /// How far the body is pushed, metres.
    pub moved_m: [f64; 2],
    /// Shots of the strategy that were tried in the other world: 1 for the chosen shot, which is as it is.
    pub shots: usize,
}

/// One reason for the choice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// In words.
    pub text: String,
    /// The rollouts that say so; `None` for a comparison of two strategies' predictions.
    pub counterfactual: Option<Counterfactual>,
}

/// What finding reasons needs.
pub(crate) struct Explaining<'a> {
    pub(crate) task: &'a ResolvedTask,
    pub(crate) scene: &'a Scene,
    pub(crate) factory: &'a dyn WorldFactory,
    pub(crate) config: &'a PlanConfig,
    pub(crate) space: &'a Space,
    pub(crate) nominal: &'a Worlds<'a>,
    pub(crate) counter: &'a Counter<'a>,
    /// Every shot of the search, and what it does by [`key`].
    pub(crate) scored: &'a [Scored],
    pub(crate) known: &'a BTreeMap<Vec<u64>, String>,
}

/// A shot that was looked at closely.
struct Look {
    objective: f64,
    story: Story,
    rollout: Rollout,
}

/// A body with another property.
struct Change {
    body: BodyId,
    property: BodyProperty,
    values: [f64; 2],
}

impl Explaining<'_> {
    /// The reasons, the most telling first. At most `config.sensitivity_rollouts` are spent on them.
    pub(crate) fn reasons(
        &self,
        chosen: &[Candidate],
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
                if spent == self.config.sensitivity_rollouts {
                    break;
                }
                let world = self.world(&change)?;
                let other = self.record(&world, &winner.action, spent, trials)?;
                spent += 1;
                // What cannot be believed says nothing.
                let Some(other) = other else { continue };
                if matters(look.objective, other.objective) {
                    found.push(self.counterfactual(winner.strategy.clone(), &change, &look, &other, 1));
                }
            }
        }
        found.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
        // Of each body the property that matters most.
        let mut told: Vec<String> = Vec::new();
        for c in found {
            if !told.contains(&c.body) {
                told.push(c.body.clone());
                reasons.push(Reason { text: relies(&c), counterfactual: Some(c) });
            }
        }
        reasons.extend(self.others(chosen, &relied, spent, trials)?);
        Ok(reasons)
    }

    /// What the best strategy is predicted to do, and the next best.
    fn comparison(&self, strategies: &[Strategy]) -> Option<Reason> {
        let [best, next] = strategies.first_chunk::<2>()?;
        let text = match (&best.prediction, &next.prediction) {
            (Some(a), Some(b)) => format!(
                "“{}” comes to {} on average and succeeds in {:.0} % of {} worlds; the next best, “{}”, to {} and in {:.0} %",
                best.name,
                length_text(a.mean),
                100.0 * a.success_share,
                a.worlds,
                next.name,
                length_text(b.mean),
                100.0 * b.success_share,
            ),
            _ => format!(
                "“{}” comes to {} in the scanned world; the next best, “{}”, to {}",
                best.name,
                length_text(best.objective),
                next.name,
                length_text(next.objective),
            ),
        };
        Some(Reason { text, counterfactual: None })
    }

    /// Dynamic bodies that a shot relies on, other than the two that the task names.
    fn props(&self, story: &Story) -> Vec<BodyId> {
        let (cue, target) = (self.task.cue().index, self.task.target().index);
        let mut props: Vec<BodyId> = Vec::new();
        for &b in &story.involved {
            let is_prop = b != cue && b != target && self.scene.bodies[b].kind == BodyKind::Dynamic;
            if is_prop && !props.contains(&b) {
                props.push(b);
            }
        }
        props
    }

    /// Other ways that rely on a body which the chosen one does not: what would make them good. The shots of such a way
    /// that were tried, and a short search from the best of them, in the world with another body.
    fn others(
        &self,
        chosen: &[Candidate],
        relied: &[BodyId],
        mut spent: usize,
        trials: &mut Vec<Trial>,
    ) -> Result<Vec<Reason>, PlanError> {
        let mut reasons = Vec::new();
        let (mut looked, mut told) = (0, Vec::new());
        for (name, points) in self.ways(&chosen[0].strategy) {
            let left = self.config.sensitivity_rollouts.saturating_sub(spent);
            if looked == MOST_OTHERS || left < 1 + LEAST_SEARCH {
                break;
            }
            let action = self.space.action(&points[0].x);
            spent += 1;
            let Some(look) = self.record(self.nominal, &action, spent, trials)? else { continue };
            let props = self.props(&look.story);
            let Some(&body) = props.iter().find(|b| !relied.contains(b) && !told.contains(*b)) else {
                continue;
            };
            looked += 1;
            let changes: Vec<Change> =
                self.changes(body).into_iter().filter(|c| c.property == BodyProperty::Mass).collect();
            for change in &changes {
                let left = self.config.sensitivity_rollouts.saturating_sub(spent);
                let budget = left / ((MOST_OTHERS + 1 - looked) * changes.len()).max(1);
                if budget < LEAST_SEARCH {
                    continue;
                }
                let world = self.world(change)?;
                let (best, shots) = self.best_in(&world, body, &points, budget - 1, spent, trials)?;
                spent += shots + 1;
                let Some(other) = best.map(|a| self.record(&world, &a, spent, trials)).transpose()?.flatten()
                else {
                    continue;
                };
                if matters(other.objective, look.objective) {
                    told.push(body);
                    let c = self.counterfactual(name.clone(), change, &look, &other, shots);
                    let text = rejected(&c, matters(other.objective, chosen[0].objective));
                    reasons.push(Reason { text, counterfactual: Some(c) });
                }
            }
        }
        Ok(reasons)
    }

    /// Ways that the search has come upon, other than the chosen one, by the best shot of each; and their shots, best first.
    fn ways(&self, chosen: &str) -> Vec<(String, Vec<&Scored>)> {
        let mut by_name: BTreeMap<&str, Vec<&Scored>> = BTreeMap::new();
        for s in self.scored.iter().filter(|s| s.objective.is_finite()) {
            if let Some(name) = self.known.get(&key(&s.x)).filter(|n| n.as_str() != chosen) {
                by_name.entry(name).or_default().push(s);
            }
        }
        let mut ways: Vec<(String, Vec<&Scored>)> =
            by_name.into_iter().map(|(name, shots)| (name.to_owned(), shots)).collect();
        for (_, shots) in &mut ways {
            shots.sort_by(|a, b| a.objective.total_cmp(&b.objective));
        }
        ways.sort_by(|a, b| a.1[0].objective.total_cmp(&b.1[0].objective));
        ways
    }

    /// The best shot in a world among those that still touch the body: the first half of the budget on shots that were
    /// tried in the scanned world, from the best to the worst, the other half on a simplex search. And how many were tried.
    fn best_in(
        &self,
        world: &Worlds<'_>,
        body: BodyId,
        points: &[&Scored],
        budget: usize,
        start: usize,
        trials: &mut Vec<Trial>,
    ) -> Result<(Option<Action>, usize), PlanError> {
        let mut tried = 0;
        let mut value = |x: &[f64], trials: &mut Vec<Trial>| -> Result<f64, PlanError> {
            let action = self.space.action(x);
            let mut touches = false;
            let objective = self.counter.count(|| {
                let rollout = world.rollout(&self.task.strike(&action), None)?;
                touches = self.look_of(rollout.clone()).story.involved.contains(&body);
                Ok(rollout.objective)
            })?;
            trials.push(Trial::new(Phase::Reason, start as i32, tried as i32, action, objective));
            tried += 1;
            Ok(if touches { objective } else { f64::INFINITY })
        };
        let count = points.len().min(budget.div_ceil(2));
        let mut best: Option<(Vec<f64>, f64)> = None;
        for k in 0..count {
            let x = &points[k * points.len() / count].x;
            let v = value(x, trials)?;
            if v.is_finite() && best.as_ref().is_none_or(|b| v < b.1) {
                best = Some((x.clone(), v));
            }
        }
        let Some((x, v)) = best else { return Ok((None, tried)) };
        let settings = NelderMead { restarts: 0, ..self.config.nelder_mead };
        let steps = self.space.steps(0.5 * self.config.initial_step, self.space.is_promising(&x));
        let mut search = LocalSearch::new(&settings, std::slice::from_ref(&x), &steps, Some(v));
        for _ in count..budget {
            let Some(x) = self.counter.next_feasible(self.task, self.space, &mut search)? else { break };
            search.tell(value(&x, trials)?);
        }
        Ok((Some(self.space.action(&search.minimum().x)), tried))
    }

    /// What a body could be instead.
    fn changes(&self, body: BodyId) -> Vec<Change> {
        let b = &self.scene.bodies[body];
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
        let mut scene = self.scene.without_pictures();
        change.apply(&mut scene.bodies[change.body]);
        Worlds::new(self.task, Cow::Owned(scene), self.factory)
    }

    /// Carries out a shot and records it; `None` where it cannot be believed.
    fn record(
        &self,
        world: &Worlds<'_>,
        action: &Action,
        start: usize,
        trials: &mut Vec<Trial>,
    ) -> Result<Option<Look>, PlanError> {
        let mut seen = None;
        let objective = self.counter.count(|| {
            let recording = Some(Recording { every_s: EVERY_S });
            let rollout: Result<Rollout, SimError> = world.rollout(&self.task.strike(action), recording);
            let rollout = rollout?;
            let objective = rollout.objective;
            seen = Some(self.look_of(rollout));
            Ok(objective)
        })?;
        trials.push(Trial::new(Phase::Reason, start as i32, -1, action.clone(), objective));
        Ok(seen)
    }

    fn look_of(&self, rollout: Rollout) -> Look {
        let story = story_of(&rollout.contacts, rollout.closest_s, self.scene, self.task);
        Look { objective: rollout.objective, story, rollout }
    }

    fn counterfactual(
        &self,
        strategy: String,
        change: &Change,
        look: &Look,
        other: &Look,
        shots: usize,
    ) -> Counterfactual {
        let body = self.scene.bodies[change.body].name.clone();
        Counterfactual {
            strategy,
            moved_m: [moved_m(&look.rollout, &body), moved_m(&other.rollout, &body)],
            body,
            property: change.property,
            values: change.values,
            objectives: [look.objective, other.objective],
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
                    // A positive multiple of a possible inertia is possible.
                    body.mass = MassProperties::new(would, p.com(), p.inertia() * ratio).ok().or(Some(p));
                }
            }
            BodyProperty::Friction => body.material.friction.value.best = would,
            BodyProperty::Restitution => body.material.restitution.value.best = would,
            BodyProperty::Rolling => body.material.rolling_m.value.best = would,
        }
    }
}

/// Farthest that a body comes from its start.
fn moved_m(rollout: &Rollout, body: &str) -> f64 {
    let Some(trajectory) = &rollout.trajectory else { return 0.0 };
    let Some(track) = trajectory.body(body) else { return 0.0 };
    let places = || track.states.iter().map(|s| s.x_wb.translation);
    let start = places().next().unwrap_or_default();
    places().map(|p| p.distance(start)).fold(0.0, f64::max)
}

/// Whether the second objective is worse enough.
fn matters(better: f64, worse: f64) -> bool {
    worse - better >= MATTERS.0 && worse >= MATTERS.1 * better
}

fn gain(c: &Counterfactual) -> f64 {
    (c.objectives[1] - c.objectives[0]).abs()
}

fn mass_text(kg: f64) -> String {
    if kg < 1.0 { format!("{:.0} g", 1e3 * kg) } else { format!("{kg:.1} kg") }
}

/// What the property is, and what it would be: "1.2 kg" and "50 g, as light as a carton of its size".
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
            format!(", not {}", length_text(c.moved_m[0]))
        };
        format!("; `{}` would be pushed {then} away{now}", c.body)
    };
    format!(
        "“{}” relies on {} ({was}): were it {would}, this shot would come to {}, not {}{pushed}",
        c.strategy,
        property_text(c),
        length_text(c.objectives[1]),
        length_text(c.objectives[0])
    )
}

fn rejected(c: &Counterfactual, is_better: bool) -> String {
    let (was, would) = would_be(c);
    let pushed = if c.moved_m[0] >= PUSHED_M {
        format!(", and `{}` is pushed {} away", c.body, length_text(c.moved_m[0]))
    } else {
        String::new()
    };
    format!(
        "“{}” comes to {} at best{pushed}: were {} {would}, not {was}, the best of {} such shots would come to {}{}",
        c.strategy,
        length_text(c.objectives[0]),
        property_text(c),
        c.shots,
        length_text(c.objectives[1]),
        if is_better { ", better than the chosen one" } else { "" }
    )
}
