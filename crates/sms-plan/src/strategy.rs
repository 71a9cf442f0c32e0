//! Strategies: ways to reach the goal, classified by the order of contacts.

use crate::Prediction;
use serde::{Deserialize, Serialize};
use sms_scene::{BodyKind, BodyShape, Scene};
use sms_sim::{BodyId, ContactEvent};
use sms_task::{Action, ResolvedTask, Rollout};
use std::collections::BTreeSet;

/// Largest number of pushed bodies in the name of a chain.
const DEEPEST_CHAIN: usize = 3;

/// A strategy with its best action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Strategy {
    /// Name: "direct", "target off `statue`", "cue off `mug` first", "pushes `box` which pushes `mug`".
    pub name: String,
    /// The best action found for this strategy.
    pub action: Action,
    /// Its objective in the nominal world.
    pub objective: f64,
    /// Its forecast; `None` without forecast worlds or without a valid rollout in them.
    pub prediction: Option<Prediction>,
    /// Objective in each forecast world, in order; `None` for an invalid rollout or a refused strike.
    #[serde(default)]
    pub outcomes: Vec<Option<f64>>,
    /// Number of forecast worlds in which the robot cannot carry out the perturbed strike.
    #[serde(default)]
    pub refused: usize,
    /// Share of the forecast worlds in which the shot follows the named strategy.
    #[serde(default)]
    pub as_named_share: Option<f64>,
}

impl Strategy {
    /// Explains a forecast without any valid outcome: "is invalid in 32 of 32 worlds", or "is refused by the robot in
    /// 32 of 32 worlds". `None` otherwise.
    pub fn failure_text(&self) -> Option<String> {
        let (all, refused) = (self.outcomes.len(), self.refused.min(self.outcomes.len()));
        if all == 0 || self.outcomes.iter().any(Option::is_some) {
            return None;
        }
        let mut parts = Vec::new();
        if refused < all {
            parts.push(format!("is invalid in {} of {all} worlds", all - refused));
        }
        if refused > 0 {
            parts.push(format!("is refused by the robot in {refused} of {all} worlds"));
        }
        Some(parts.join(" and "))
    }
}

/// The contacts of a rollout, summarised.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Story {
    /// Name of the strategy.
    pub(crate) name: String,
    /// Bodies touched by the struck and the target body, in order, with those that pass on the motion, without these two.
    pub(crate) involved: Vec<BodyId>,
}

/// The name of the strategy that a rollout follows.
pub(crate) fn strategy_of(rollout: &Rollout, scene: &Scene, task: &ResolvedTask) -> String {
    story_of(&rollout.contacts, rollout.closest_s, scene, task).name
}

/// Bodies that touch anything except a floor during a rollout.
pub(crate) fn touched(rollout: &Rollout, scene: &Scene) -> BTreeSet<BodyId> {
    let known = |b: BodyId| scene.bodies.get(b).is_none_or(|b| !matches!(b.shape, BodyShape::HalfSpace));
    let pairs = rollout.contacts.iter().filter(|c| known(c.body) && known(c.other));
    pairs.flat_map(|c| [c.body, c.other]).collect()
}

/// Summarises the contacts until `until_s`.
pub(crate) fn story_of(contacts: &[ContactEvent], until_s: f64, scene: &Scene, task: &ResolvedTask) -> Story {
    let is_ball = |b: BodyId| matches!(scene.bodies[b].shape, BodyShape::Sphere { .. });
    let builder = StoryBuilder {
        touches: contacts
            .iter()
            .filter(|c| c.time_s <= until_s)
            .map(|c| (c.body, c.other))
            // Contacts with floors do not count as rebounds.
            .filter(|&(a, b)| is_prop(a, scene) && is_prop(b, scene))
            .collect(),
        scene,
        cue: task.cue().index,
        target: task.target().index,
    };
    if is_ball(builder.cue) { builder.rebounds() } else { builder.pushes() }
}

/// Whether a body belongs to the scene and is not a floor. The robot has no body in the scene.
fn is_prop(body: BodyId, scene: &Scene) -> bool {
    scene.bodies.get(body).is_some_and(|b| !matches!(b.shape, BodyShape::HalfSpace))
}

struct StoryBuilder<'a> {
    touches: Vec<(BodyId, BodyId)>,
    scene: &'a Scene,
    cue: BodyId,
    target: BodyId,
}

impl StoryBuilder<'_> {
    fn quoted_name(&self, body: BodyId) -> String {
        format!("`{}`", self.scene.bodies[body].name)
    }

    fn list(&self, bodies: &[BodyId]) -> String {
        bodies.iter().map(|&b| self.quoted_name(b)).collect::<Vec<_>>().join(", ")
    }

    /// Returns the bodies that a body touches, in order, within a range of the contacts.
    fn touched_by(&self, body: BodyId, range: std::ops::Range<usize>) -> Vec<BodyId> {
        let other = |&(a, b): &(BodyId, BodyId)| (a == body).then_some(b).or((b == body).then_some(a));
        self.touches[range].iter().filter_map(other).collect()
    }

    /// Returns the chain of contacts that transfers the motion from the struck body to `to`, without the struck body
    /// itself, and the index of its last contact. `None` if there is none.
    fn chain(&self, to: BodyId) -> Option<(Vec<BodyId>, usize)> {
        let mut set_off_by: Vec<(BodyId, BodyId)> = vec![(self.cue, self.cue)];
        for (at, &(a, b)) in self.touches.iter().enumerate() {
            let moves = |body: BodyId| set_off_by.iter().any(|s| s.0 == body);
            let (by, set_off) = match (moves(a), moves(b)) {
                (true, false) => (a, b),
                (false, true) => (b, a),
                _ => continue,
            };
            set_off_by.push((set_off, by));
            if set_off != to {
                continue;
            }
            let mut chain = vec![to];
            while let Some(&(_, by)) = set_off_by.iter().find(|s| Some(&s.0) == chain.last()) {
                if by == self.cue {
                    break;
                }
                chain.push(by);
            }
            chain.reverse();
            return Some((chain, at));
        }
        None
    }

    /// Names the strategy of a struck ball by the rebounds of this ball and of the target ball.
    fn rebounds(&self) -> Story {
        let all = 0..self.touches.len();
        if self.cue == self.target {
            let by_cue = self.touched_by(self.cue, all);
            let name = match by_cue.as_slice() {
                [] => "direct".to_owned(),
                [a] => format!("off {}", self.quoted_name(*a)),
                [_, _] => format!("double rebound: {}", self.list(&by_cue)),
                _ => format!("off {}", self.list(&by_cue)),
            };
            return Story { name, involved: by_cue };
        }
        let Some((chain, at)) = self.chain(self.target) else {
            let by_cue = self.touched_by(self.cue, all);
            let mut name = format!("{} is not touched", self.quoted_name(self.target));
            if !by_cue.is_empty() {
                name = format!("{name}, cue off {}", self.list(&by_cue));
            }
            return Story { name, involved: by_cue };
        };
        let between = &chain[..chain.len() - 1];
        // Contacts of the cue ball count until it transfers its motion.
        let first = between.first().copied().unwrap_or(self.target);
        let handed = self
            .touches
            .iter()
            .position(|&(a, b)| (a, b) == (self.cue, first) || (b, a) == (self.cue, first));
        let by_cue = self.touched_by(self.cue, 0..handed.unwrap_or(at));
        let mut by_target = self.touched_by(self.target, at + 1..all.end);
        by_target.retain(|b| *b != self.cue && !between.contains(b));
        let mut parts = Vec::new();
        if !by_cue.is_empty() {
            parts.push(format!("cue off {} first", self.list(&by_cue)));
        }
        if !between.is_empty() {
            parts.push(format!("by way of {}", self.list(between)));
        }
        if !by_target.is_empty() {
            parts.push(format!("target off {}", self.list(&by_target)));
        }
        let mut name = if parts.is_empty() { "direct".to_owned() } else { parts.join(", ") };
        if by_cue.len() + by_target.len() == 2 && between.is_empty() {
            name = format!("double rebound: {name}");
        }
        let involved = by_cue.iter().chain(between).chain(&by_target).copied().collect();
        Story { name, involved }
    }

    /// Names the strategy of any other struck body by the chain of bodies that it pushes.
    fn pushes(&self) -> Story {
        let mut listed = vec![self.cue];
        let name = format!("pushes {}", self.pushed(self.cue, &mut listed, DEEPEST_CHAIN));
        let named = listed.split_off(1);
        let is_left_out = self.target != self.cue && !named.contains(&self.target);
        let name = if is_left_out && self.chain(self.target).is_none() {
            format!("{name}, {} is not touched", self.quoted_name(self.target))
        } else {
            name
        };
        Story { name, involved: named.into_iter().filter(|b| *b != self.target).collect() }
    }

    fn pushed(&self, body: BodyId, listed: &mut Vec<BodyId>, depth: usize) -> String {
        let mut text = self.quoted_name(body);
        if depth <= 1 {
            return text;
        }
        let next: Vec<BodyId> = self
            .touched_by(body, 0..self.touches.len())
            .into_iter()
            // Static bodies are not pushed.
            .filter(|&b| !listed.contains(&b) && self.scene.bodies[b].kind == BodyKind::Dynamic)
            .collect();
        listed.extend(&next);
        let names: Vec<String> = next.into_iter().map(|b| self.pushed(b, listed, depth - 1)).collect();
        if !names.is_empty() {
            text += &format!(" which pushes {}", names.join(" and "));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Mesh;
    use sms_core::glamx::{DPose3, DVec3};
    use sms_scene::{Body, SCENE_VERSION, example_material, floor_body};
    use sms_task::{Billiards, Selector, Task};
    use std::io::Write as _;

    const NAMES: [&str; 7] = ["floor", "cue", "target", "a", "b", "wall", "box"];
    /// The finger has the first index after the bodies of the scene.
    const FINGER: BodyId = NAMES.len();

    fn scene() -> Scene {
        let floor = floor_body(0.0, example_material());
        let body = |(i, name): (usize, &&str)| Body {
            name: (*name).into(),
            kind: if *name == "wall" { BodyKind::Static } else { BodyKind::Dynamic },
            x_wb: DPose3::from_translation(DVec3::new(0.2 * i as f64, 0.0, 0.03)),
            shape: if ["cue", "target"].contains(name) {
                BodyShape::Sphere { radius: 0.03 }
            } else {
                BodyShape::Box { half_extents: DVec3::splat(0.03) }
            },
            visual: Mesh::default(),
            ..floor.clone()
        };
        let bodies =
            NAMES.iter().enumerate().map(|n| if n.0 == 0 { floor.clone() } else { body(n) }).collect();
        Scene {
            version: SCENE_VERSION,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z,
            size_sigma: 0.0,
            x_world_recording: DPose3::identity(),
            bodies,
        }
    }

    fn story(task: &Task, touches: &[(BodyId, BodyId)]) -> Story {
        let scene = scene();
        let task = task.resolve(&scene).unwrap();
        let event =
            |(k, &(body, other)): (usize, &(BodyId, BodyId))| ContactEvent { time_s: k as f64, body, other };
        let contacts: Vec<ContactEvent> = touches.iter().enumerate().map(event).collect();
        story_of(&contacts, 9.5, &scene, &task)
    }

    #[test]
    fn refusals_and_invalid_rollouts_are_counted_apart() {
        let text = |outcomes: Vec<Option<f64>>, refused: usize| {
            let (name, action, prediction) = (String::new(), Action(Vec::new()), None);
            Strategy { name, action, objective: 0.0, prediction, outcomes, refused, as_named_share: None }
                .failure_text()
        };
        assert_eq!(text(vec![None; 4], 0).unwrap(), "is invalid in 4 of 4 worlds");
        assert_eq!(text(vec![None; 4], 4).unwrap(), "is refused by the robot in 4 of 4 worlds");
        let both = text(vec![None; 4], 1).unwrap();
        assert!(both.contains("3 of 4") && both.contains("1 of 4"), "{both}");
        assert!(text(vec![None, Some(0.1)], 1).is_none() && text(Vec::new(), 0).is_none());
    }

    #[test]
    fn ball_shots_are_named_by_their_rebounds() {
        let (cue, target) = (Selector::by_name("cue"), Selector::by_name("target"));
        let task = Task::Billiards(Billiards::new(cue, target, [0.6, 0.3]));
        let (cue, target, a, b, wall) = (1, 2, 3, 4, 5);
        for (touches, name) in [
            (vec![(FINGER, cue), (cue, target)], "direct"),
            (vec![(FINGER, cue), (cue, target), (cue, b), (target, 0)], "direct"),
            (vec![(cue, target), (target, a)], "target off `a`"),
            (vec![(cue, wall), (cue, target)], "cue off `wall` first"),
            (vec![(cue, target), (a, target), (target, b)], "double rebound: target off `a`, `b`"),
            (vec![(cue, b), (cue, target), (target, a)], "double rebound: cue off `b` first, target off `a`"),
            (vec![(cue, a), (a, target)], "by way of `a`"),
            (vec![(cue, a), (a, b), (b, target), (target, wall)], "by way of `a`, `b`, target off `wall`"),
            (vec![(cue, a)], "`target` is not touched, cue off `a`"),
            (vec![(FINGER, target)], "`target` is not touched"),
        ] {
            assert_eq!(story(&task, &touches).name, name, "{touches:?}");
        }
        assert_eq!(story(&task, &[(cue, b), (cue, target), (target, a)]).involved, [b, a]);
        // Contacts after the closest approach do not count.
        let mut late = vec![(cue, target)];
        late.extend([(FINGER, cue); 9]);
        late.push((target, a));
        assert_eq!(story(&task, &late).name, "direct");
    }

    fn strike(body: &str, moved: &str) -> Task {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        write!(
            file,
            "kind = \"strike\"\nstrike = {{ name = \"{body}\" }}\n[[terms]]\nterm = \"reach\"\nbody = {{ name = \
             \"{moved}\" }}\nplace = {{ at_w = [0.5, 0.2] }}\n"
        )
        .unwrap();
        Task::read(file.path()).unwrap()
    }

    #[test]
    fn other_bodies_are_named_by_the_bodies_they_push() {
        let (a, b, wall, cube) = (3, 4, 5, 6);
        let push = strike("box", "box");
        for (touches, name) in [
            (vec![(FINGER, cube)], "pushes `box`"),
            (vec![(FINGER, cube), (cube, a)], "pushes `box` which pushes `a`"),
            (vec![(cube, a), (cube, b)], "pushes `box` which pushes `a` and `b`"),
            (vec![(cube, a), (a, b), (b, wall)], "pushes `box` which pushes `a` which pushes `b`"),
        ] {
            assert_eq!(story(&push, &touches).name, name, "{touches:?}");
        }
        assert_eq!(
            story(&strike("box", "a"), &[(cube, b)]).name,
            "pushes `box` which pushes `b`, `a` is not touched"
        );
        // A single ball, both struck and sent to the goal.
        let own = strike("cue", "cue");
        assert_eq!(story(&own, &[(FINGER, 1)]).name, "direct");
        assert_eq!(story(&own, &[(1, wall)]).name, "off `wall`");
        assert_eq!(story(&own, &[(1, wall), (1, a)]).name, "double rebound: `wall`, `a`");
    }
}
