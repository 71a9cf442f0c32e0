//! Ways of reaching the goal, told apart by who touches whom first.

use crate::Prediction;
use serde::{Deserialize, Serialize};
use sms_scene::{BodyKind, BodyShape, Scene};
use sms_sim::{BodyId, ContactEvent};
use sms_task::{Action, ResolvedTask, Rollout};
use std::collections::BTreeSet;

/// Bodies of a chain that are told by name; what they push in turn is left out.
const DEEPEST_CHAIN: usize = 3;

/// A way of reaching the goal with its best action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Strategy {
    /// In words: "direct", "target off `statue`", "cue off `mug` first", "pushes `box` which pushes `mug`".
    pub name: String,
    /// The best action of this kind that was found.
    pub action: Action,
    /// Its objective in the nominal world.
    pub objective: f64,
    /// What it is predicted to do in worlds that played no part in choosing it; `None` where there are none or no rollout
    /// in them can be believed.
    pub prediction: Option<Prediction>,
    /// Objective in each of those worlds, in their order; `None` where the rollout cannot be believed or the robot cannot
    /// make the strike.
    #[serde(default)]
    pub outcomes: Vec<Option<f64>>,
    /// In how many of them the robot cannot make the strike as it would be carried out there.
    #[serde(default)]
    pub refused: usize,
    /// Share of those worlds in which what happens is what the name says.
    #[serde(default)]
    pub as_named_share: Option<f64>,
}

impl Strategy {
    /// What to say where worlds were looked at and nothing is known of any of them: "could not be believed: 32 of 32
    /// rollouts", or "could not be made by the robot: 32 of 32 strikes".
    pub fn unbelievable_text(&self) -> Option<String> {
        let (all, refused) = (self.outcomes.len(), self.refused.min(self.outcomes.len()));
        if all == 0 || self.outcomes.iter().any(Option::is_some) {
            return None;
        }
        let mut parts = Vec::new();
        if refused < all {
            parts.push(format!("could not be believed: {} of {all} rollouts", all - refused));
        }
        if refused > 0 {
            parts.push(format!("could not be made by the robot: {refused} of {all} strikes"));
        }
        Some(parts.join("; "))
    }
}

/// What happens in a rollout.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Story {
    /// Name of the strategy.
    pub(crate) name: String,
    /// Bodies that struck and target body touch and that are neither, in order; bodies that carry a chain included.
    pub(crate) involved: Vec<BodyId>,
}

/// What happens in a rollout, in words.
pub(crate) fn strategy_of(rollout: &Rollout, scene: &Scene, task: &ResolvedTask) -> String {
    story_of(&rollout.contacts, rollout.closest_s, scene, task).name
}

/// Every body that touches something other than a floor in a rollout, in order of their indices.
pub(crate) fn touched(rollout: &Rollout, scene: &Scene) -> BTreeSet<BodyId> {
    let known = |b: BodyId| scene.bodies.get(b).is_none_or(|b| !matches!(b.shape, BodyShape::HalfSpace));
    let pairs = rollout.contacts.iter().filter(|c| known(c.body) && known(c.other));
    pairs.flat_map(|c| [c.body, c.other]).collect()
}

/// What happens until `until_s`.
pub(crate) fn story_of(contacts: &[ContactEvent], until_s: f64, scene: &Scene, task: &ResolvedTask) -> Story {
    let is_ball = |b: BodyId| matches!(scene.bodies[b].shape, BodyShape::Sphere { .. });
    let teller = Teller {
        touches: contacts
            .iter()
            .filter(|c| c.time_s <= until_s)
            .map(|c| (c.body, c.other))
            // Floors carry, and are none of the things that a ball rebounds off.
            .filter(|&(a, b)| is_prop(a, scene) && is_prop(b, scene))
            .collect(),
        scene,
        cue: task.cue().index,
        target: task.target().index,
    };
    if is_ball(teller.cue) { teller.rebounds() } else { teller.pushes() }
}

/// Whether it is a body of the scene other than a floor; the robot is none.
fn is_prop(body: BodyId, scene: &Scene) -> bool {
    scene.bodies.get(body).is_some_and(|b| !matches!(b.shape, BodyShape::HalfSpace))
}

struct Teller<'a> {
    touches: Vec<(BodyId, BodyId)>,
    scene: &'a Scene,
    cue: BodyId,
    target: BodyId,
}

impl Teller<'_> {
    fn called(&self, body: BodyId) -> String {
        format!("`{}`", self.scene.bodies[body].name)
    }

    fn list(&self, bodies: &[BodyId]) -> String {
        bodies.iter().map(|&b| self.called(b)).collect::<Vec<_>>().join(", ")
    }

    /// What a body touches, in order, among the touches of a range.
    fn touched_by(&self, body: BodyId, range: std::ops::Range<usize>) -> Vec<BodyId> {
        let other = |&(a, b): &(BodyId, BodyId)| (a == body).then_some(b).or((b == body).then_some(a));
        self.touches[range].iter().filter_map(other).collect()
    }

    /// The chain of touches from the struck body to `to`: who set whom in motion, without the struck body itself. `None`
    /// where there is none.
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

    /// A struck ball: what it and the target ball rebound off.
    fn rebounds(&self) -> Story {
        let all = 0..self.touches.len();
        if self.cue == self.target {
            let by_cue = self.touched_by(self.cue, all);
            let name = match by_cue.as_slice() {
                [] => "direct".to_owned(),
                [a] => format!("off {}", self.called(*a)),
                [_, _] => format!("double rebound: {}", self.list(&by_cue)),
                _ => format!("off {}", self.list(&by_cue)),
            };
            return Story { name, involved: by_cue };
        }
        let Some((chain, at)) = self.chain(self.target) else {
            let by_cue = self.touched_by(self.cue, all);
            let mut name = format!("{} is not touched", self.called(self.target));
            if !by_cue.is_empty() {
                name = format!("{name}, cue off {}", self.list(&by_cue));
            }
            return Story { name, involved: by_cue };
        };
        let between = &chain[..chain.len() - 1];
        // The cue ball leaves the story where it hands its motion on.
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

    /// A struck body that is no ball: what it pushes, and what that pushes.
    fn pushes(&self) -> Story {
        let mut told = vec![self.cue];
        let name = format!("pushes {}", self.pushed(self.cue, &mut told, DEEPEST_CHAIN));
        let named = told.split_off(1);
        let is_left_out = self.target != self.cue && !named.contains(&self.target);
        let name = if is_left_out && self.chain(self.target).is_none() {
            format!("{name}, {} is not touched", self.called(self.target))
        } else {
            name
        };
        Story { name, involved: named.into_iter().filter(|b| *b != self.target).collect() }
    }

    fn pushed(&self, body: BodyId, told: &mut Vec<BodyId>, depth: usize) -> String {
        let mut text = self.called(body);
        if depth <= 1 {
            return text;
        }
        let next: Vec<BodyId> = self
            .touched_by(body, 0..self.touches.len())
            .into_iter()
            // A wall is not pushed.
            .filter(|&b| !told.contains(&b) && self.scene.bodies[b].kind == BodyKind::Dynamic)
            .collect();
        told.extend(&next);
        let names: Vec<String> = next.into_iter().map(|b| self.pushed(b, told, depth - 1)).collect();
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
    /// The finger: the first body that is none of the scene.
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
            x_world_recording: DPose3::identity(),
            bodies,
        }
    }

    fn told(task: &Task, touches: &[(BodyId, BodyId)]) -> Story {
        let scene = scene();
        let task = task.resolve(&scene).unwrap();
        let event =
            |(k, &(body, other)): (usize, &(BodyId, BodyId))| ContactEvent { time_s: k as f64, body, other };
        let contacts: Vec<ContactEvent> = touches.iter().enumerate().map(event).collect();
        story_of(&contacts, 9.5, &scene, &task)
    }

    #[test]
    fn refusals_are_not_told_as_simulations_that_cannot_be_believed() {
        let text = |outcomes: Vec<Option<f64>>, refused: usize| {
            let (name, action, prediction) = (String::new(), Action(Vec::new()), None);
            Strategy { name, action, objective: 0.0, prediction, outcomes, refused, as_named_share: None }
                .unbelievable_text()
        };
        assert_eq!(text(vec![None; 4], 0).unwrap(), "could not be believed: 4 of 4 rollouts");
        assert_eq!(text(vec![None; 4], 4).unwrap(), "could not be made by the robot: 4 of 4 strikes");
        let both = text(vec![None; 4], 1).unwrap();
        assert!(both.contains("believed: 3 of 4") && both.contains("robot: 1 of 4"), "{both}");
        assert!(text(vec![None, Some(0.1)], 1).is_none() && text(Vec::new(), 0).is_none());
    }

    #[test]
    fn shots_of_balls_are_told_by_what_they_rebound_off() {
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
            assert_eq!(told(&task, &touches).name, name, "{touches:?}");
        }
        assert_eq!(told(&task, &[(cue, b), (cue, target), (target, a)]).involved, [b, a]);
        // What happens after the target ball was nearest is no part of it.
        let mut late = vec![(cue, target)];
        late.extend([(FINGER, cue); 9]);
        late.push((target, a));
        assert_eq!(told(&task, &late).name, "direct");
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
    fn what_is_no_ball_pushes() {
        let (a, b, wall, cube) = (3, 4, 5, 6);
        let push = strike("box", "box");
        for (touches, name) in [
            (vec![(FINGER, cube)], "pushes `box`"),
            (vec![(FINGER, cube), (cube, a)], "pushes `box` which pushes `a`"),
            (vec![(cube, a), (cube, b)], "pushes `box` which pushes `a` and `b`"),
            (vec![(cube, a), (a, b), (b, wall)], "pushes `box` which pushes `a` which pushes `b`"),
        ] {
            assert_eq!(told(&push, &touches).name, name, "{touches:?}");
        }
        assert_eq!(
            told(&strike("box", "a"), &[(cube, b)]).name,
            "pushes `box` which pushes `b`, `a` is not touched"
        );
        // One ball alone: struck, and sent somewhere itself.
        let own = strike("cue", "cue");
        assert_eq!(told(&own, &[(FINGER, 1)]).name, "direct");
        assert_eq!(told(&own, &[(1, wall)]).name, "off `wall`");
        assert_eq!(told(&own, &[(1, wall), (1, a)]).name, "double rebound: `wall`, `a`");
    }
}
