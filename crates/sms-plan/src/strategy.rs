//! Ways of reaching the goal, told apart by who touches whom first.

use crate::Prediction;
use serde::{Deserialize, Serialize};
use sms_scene::{BodyShape, Scene};
use sms_sim::ContactEvent;
use sms_task::{Action, ResolvedTask, Rollout};

/// A way of reaching the goal with its best action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Strategy {
    /// In words: "cue off mug → target".
    pub name: String,
    /// The best action of this kind that was found.
    pub action: Action,
    /// Its objective in the nominal world.
    pub objective: f64,
    /// What it is predicted to do in worlds that played no part in choosing it.
    pub prediction: Option<Prediction>,
}

/// The first touches, until the target ball is nearest to the goal, of cue and target ball with each other and with
/// bodies that are no floor; of the cue ball only those before it leaves the story by touching the target ball.
fn touches(
    contacts: &[ContactEvent],
    until_s: f64,
    scene: &Scene,
    task: &ResolvedTask,
) -> Vec<(usize, usize)> {
    let (cue, target) = (task.cue().index, task.target().index);
    let mut found: Vec<(usize, usize)> = Vec::new();
    for c in contacts.iter().filter(|c| c.time_s <= until_s) {
        let is_prop =
            |b: usize| scene.bodies.get(b).is_some_and(|body| !matches!(body.shape, BodyShape::HalfSpace));
        if !is_prop(c.ball) || !is_prop(c.other) {
            continue;
        }
        let pair = match (c.ball, c.other) {
            (a, b) if a == cue || (a == target && b != cue) => (a, b),
            (a, b) if b == cue || b == target => (b, a),
            _ => continue,
        };
        let is_struck = found.contains(&(cue, target));
        let is_aside = is_struck && pair.0 == cue;
        if !(is_aside || found.contains(&pair)) {
            found.push(pair);
        }
    }
    found
}

/// What happens in a rollout, in words.
pub(crate) fn strategy_of(rollout: &Rollout, scene: &Scene, task: &ResolvedTask) -> String {
    name(&touches(&rollout.contacts, rollout.closest_s, scene, task), scene, task)
}

/// The touches in words.
fn name(touches: &[(usize, usize)], scene: &Scene, task: &ResolvedTask) -> String {
    let (cue, target) = (task.cue().index, task.target().index);
    let called = |b: usize| scene.bodies.get(b).map_or("?", |body| body.name.as_str());
    let list = |ball: usize| -> Vec<&str> {
        touches.iter().filter(|t| t.0 == ball && t.1 != target).map(|t| called(t.1)).collect()
    };
    let (by_cue, by_target) = (list(cue), list(target));
    let off = |names: &[&str]| names.iter().map(|n| format!(" off {n}")).collect::<String>();
    if touches.contains(&(cue, target)) {
        return format!("{}{} → {}{}", called(cue), off(&by_cue), called(target), off(&by_target));
    }
    match by_target.split_first() {
        None => format!("{} is not touched", called(target)),
        Some((first, rest)) => {
            format!("{}{} → {first} → {}{}", called(cue), off(&by_cue), called(target), off(rest))
                .replace(&format!(" off {first} → {first} →"), &format!(" → {first} →"))
        }
    }
}
