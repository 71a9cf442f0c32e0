//! A task with its bodies found in the planner's scene.

use crate::billiards::{StrikeSettings, named};
use crate::body::{TaskBody, bodies_of, find, horizontal, task_body};
use crate::place::{check_near, check_reachable};
use crate::terms::TermTracker;
use crate::{Action, ActionForm, Billiards, Parameter, Region, RobotArm, Strike, Task, TaskError, Term};
use glamx::{DPose3, DVec2, DVec3};
use sms_core::{InputError, wrapped_angle};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::{StrikerMotion, WorldOptions};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A task resolved in the planner's scene. It defines actions in world coordinates, so that a target world with other
/// bodies can execute the same motion of the robot.
#[derive(Debug, Clone)]
pub struct ResolvedTask {
    kind: &'static str,
    pub(crate) common: StrikeSettings,
    source: PathBuf,
    cue: TaskBody,
    /// Corners of the struck body in the plane of the floor, relative to its centre; empty for a ball.
    outline: Vec<DVec2>,
    target: TaskBody,
    /// Direction of the angle 0 on the floor, radians from world x.
    base_angle: f64,
    pub(crate) objective: Objective,
    pub(crate) arm: Option<Arc<RobotArm>>,
}

/// The objective of a task.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Objective {
    /// Closest approach of the target ball to the goal on the floor.
    ClosestApproach(DVec2),
    /// Weighted terms, each with its bodies.
    Terms(Vec<(Term, Vec<TaskBody>)>),
}

impl Task {
    /// Finds the task's bodies in the planner's scene.
    ///
    /// # Errors
    /// [`TaskError::Input`] if a selector matches no dynamic body (the error lists the bodies of the scene), if cue
    /// and target are the same body, or if a setting is out of range.
    pub fn resolve(&self, scene: &Scene) -> Result<ResolvedTask, TaskError> {
        match self {
            Self::Billiards(settings) => resolve_billiards(settings, scene),
            Self::Strike(settings) => resolve_strike(settings, scene),
        }
    }
}

fn resolve_billiards(settings: &Billiards, scene: &Scene) -> Result<ResolvedTask, TaskError> {
    settings.validate()?;
    let path = settings.path();
    let cue = find(path, "cue", &settings.cue, scene)?;
    let target = find(path, "target", &settings.target, scene)?;
    if cue.index == target.index {
        return Err(InputError::new(
            format!("`cue` and `target` are the same body, `{}`", cue.name),
            path,
            format!("make the selectors differ; the scene has {}", bodies_of(scene)),
        )
        .into());
    }
    let goal_w = DVec2::from_array(settings.goal_w);
    check_near(path, "`goal_w`", goal_w, scene)?;
    check_reachable(path, "`goal_w`", goal_w, settings.success_m, &target, scene)?;
    Ok(ResolvedTask {
        kind: "billiards",
        common: settings.common(),
        source: settings.source.clone(),
        outline: Vec::new(),
        base_angle: horizontal(target.center_w - cue.center_w).to_angle(),
        objective: Objective::ClosestApproach(DVec2::from_array(settings.goal_w)),
        arm: None,
        cue,
        target,
    })
}

fn resolve_strike(settings: &Strike, scene: &Scene) -> Result<ResolvedTask, TaskError> {
    settings.validate()?;
    let path = settings.path();
    let cue = find(path, "strike", &settings.strike, scene)?;
    let mut named_bodies = vec![cue.index];
    let mut found = Vec::new();
    for (i, term) in settings.terms.iter().enumerate() {
        let find_term = |selector| find(path, &format!("terms[{i}].body"), selector, scene);
        let body = term.bodies().selector().map(find_term).transpose()?;
        named_bodies.extend(body.as_ref().map(|b| b.index));
        found.push(body);
    }
    let others: Vec<TaskBody> = (0..scene.bodies.len())
        .filter(|i| scene.bodies[*i].kind == BodyKind::Dynamic && !named_bodies.contains(i))
        .map(|i| task_body(scene, i))
        .collect();
    let moved = settings.terms.iter().zip(&found).find_map(|(term, body)| match term {
        Term::Reach { .. } | Term::Topple { .. } => body.clone().filter(|b| b.index != cue.index),
        _ => None,
    });
    let place = settings.terms.iter().find_map(|term| match term {
        Term::Reach { place, .. } => Some(place.middle_w()),
        _ => None,
    });
    let here = horizontal(cue.center_w);
    let towards = settings.towards_w.map(DVec2::from_array);
    let towards = towards.or(moved.as_ref().map(|b| horizontal(b.center_w))).or(place);
    let base_angle = towards.map_or(0.0, |p| (p - here).to_angle());
    for (i, term) in settings.terms.iter().enumerate() {
        if let Term::Reach { place, .. } | Term::Avoid { place, .. } = term {
            let what = format!("the place of `terms[{i}]`");
            check_near(path, &what, place.middle_w(), scene)?;
            let on_floor = match place {
                Region::Point { .. } => Some(0.0),
                Region::Disc { radius_m, .. } => Some(*radius_m),
                // A box may lie beside the floor or below it.
                Region::Box { .. } => None,
            };
            if let (Term::Reach { .. }, Some(body), Some(radius_m)) = (term, &found[i], on_floor) {
                let enough_m = settings.success_m + radius_m;
                check_reachable(path, &what, place.middle_w(), enough_m, body, scene)?;
            }
        }
    }
    let outline = outline_of(&scene.bodies[cue.index]);
    let terms = settings.terms.iter().cloned().zip(found);
    let terms = terms.map(|(term, body)| (term, body.map_or_else(|| others.clone(), |b| vec![b]))).collect();
    Ok(ResolvedTask {
        kind: "strike",
        common: settings.common(),
        source: settings.source.clone(),
        target: moved.unwrap_or_else(|| cue.clone()),
        base_angle,
        objective: Objective::Terms(terms),
        arm: None,
        outline,
        cue,
    })
}

/// Corners of a body in the plane of the floor, relative to its centre; empty for a ball.
fn outline_of(body: &Body) -> Vec<DVec2> {
    match &body.shape {
        BodyShape::Sphere { .. } | BodyShape::HalfSpace => Vec::new(),
        shape => {
            let corners = shape.meshes().into_iter().flat_map(|m| m.vertices);
            corners.map(|p| horizontal(body.x_wb.rotation * p)).collect()
        }
    }
}

impl ResolvedTask {
    /// Returns the goals on the floor with their names in the task file, as points of the surface that supports the
    /// body, in the world. Places that may lie beside the floor are not included.
    pub fn floor_places(&self) -> Vec<(String, DVec3)> {
        let under = |body: &TaskBody, place_w: DVec2| place_w.extend(body.center_w.z - body.radius);
        match &self.objective {
            Objective::ClosestApproach(goal_w) => vec![("`goal_w`".to_owned(), under(&self.target, *goal_w))],
            Objective::Terms(terms) => terms
                .iter()
                .enumerate()
                .filter_map(|(i, (term, bodies))| match term {
                    Term::Reach { place: place @ (Region::Point { .. } | Region::Disc { .. }), .. } => {
                        let place_w = under(bodies.first()?, place.middle_w());
                        Some((format!("the place of `terms[{i}]`"), place_w))
                    }
                    _ => None,
                })
                .collect(),
        }
    }

    /// The file name for messages.
    pub(crate) fn path(&self) -> &Path {
        named(&self.source)
    }

    /// Kind of task ("billiards", "strike").
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// The body that is struck.
    pub fn cue(&self) -> &TaskBody {
        &self.cue
    }

    /// The body that has to reach a place or to topple; the struck body if no term has another one.
    pub fn target(&self) -> &TaskBody {
        &self.target
    }

    /// The goal on the floor: the goal of billiards, or the centre of the first place to reach.
    pub fn goal_w(&self) -> Option<DVec2> {
        match &self.objective {
            Objective::ClosestApproach(goal_w) => Some(*goal_w),
            Objective::Terms(terms) => terms.iter().find_map(|(term, _)| match term {
                Term::Reach { place, .. } => Some(place.middle_w()),
                _ => None,
            }),
        }
    }

    /// Unit of the objective.
    pub fn objective_unit(&self) -> &'static str {
        "m"
    }

    /// Largest objective that counts as success, metres.
    pub fn success_m(&self) -> f64 {
        self.common.success_m
    }

    /// Whether an objective counts as success.
    pub fn is_success(&self, objective: f64) -> bool {
        objective <= self.common.success_m
    }

    /// Objective without any action, metres.
    pub fn initial_objective(&self) -> f64 {
        match &self.objective {
            Objective::ClosestApproach(goal_w) => horizontal(self.target.center_w).distance(*goal_w),
            Objective::Terms(terms) => terms
                .iter()
                .map(|(term, bodies)| {
                    let cost = |b: &TaskBody| {
                        let x_wb = DPose3::from_translation(b.center_w);
                        let mut tracker = TermTracker::new(term, x_wb);
                        tracker.observe(term.between_s()[0], &x_wb);
                        tracker.cost()
                    };
                    bodies.iter().map(cost).sum::<f64>()
                })
                .sum(),
        }
    }

    /// Settings of the worlds for this task.
    pub fn world_options(&self) -> WorldOptions {
        WorldOptions { dt: self.common.dt, ..WorldOptions::default() }
    }

    /// The parameters of an action, in order.
    pub fn parameters(&self) -> Vec<Parameter> {
        let b = &self.common.bounds;
        let parameter = |name: &str, unit: &str, [low, high]: [f64; 2]| Parameter {
            name: name.to_owned(),
            unit: unit.to_owned(),
            low,
            high,
        };
        let mut all = vec![parameter("speed", "m/s", b.speed), parameter("angle", "rad", b.angle)];
        if self.common.form == ActionForm::SpeedAngleContact {
            all.push(parameter("contact_along", "m", b.along));
            all.push(parameter("contact_across", "m", b.across));
        }
        all
    }

    /// The part of the parameter box in which the cue ball hits the target ball directly. Its range of angles is much
    /// smaller than the bounds, and it contains most good shots. `None` if it is not smaller.
    pub fn direct_box(&self) -> Option<Vec<[f64; 2]>> {
        if self.cue.index == self.target.index || !self.outline.is_empty() {
            return None;
        }
        let distance = horizontal(self.target.center_w - self.cue.center_w).length();
        let reach = (self.cue.radius + self.target.radius) / distance;
        let [low, high] = self.common.bounds.angle;
        // Beyond a cut of about 75° the target ball hardly moves.
        let cone = (0.97 * reach.min(1.0)).asin();
        // The angle 0 may point in another direction.
        let middle =
            wrapped_angle(horizontal(self.target.center_w - self.cue.center_w).to_angle() - self.base_angle);
        let narrowed = [low.max(middle - cone), high.min(middle + cone)];
        if narrowed[0] >= narrowed[1] || narrowed[1] - narrowed[0] > 0.9 * (high - low) {
            return None;
        }
        Some(
            self.parameters()
                .iter()
                .map(|p| if p.name == "angle" { narrowed } else { [p.low, p.high] })
                .collect(),
        )
    }

    /// Actions from billiards geometry: aim at the ghost ball (the position of the cue ball when it touches the
    /// target ball opposite to the goal) at several speeds. The search accounts for spin, friction and obstacles.
    pub fn suggestions(&self) -> Vec<Action> {
        let (cue, target) = (horizontal(self.cue.center_w), horizontal(self.target.center_w));
        let Some(to_goal) = self.goal_w().and_then(|goal_w| (goal_w - target).try_normalize()) else {
            return Vec::new();
        };
        let aim = if self.cue.index == self.target.index {
            to_goal
        } else {
            target - to_goal * (self.cue.radius + self.target.radius) - cue
        };
        // The far side of the target ball cannot be hit directly.
        if aim.dot(to_goal) <= 0.0 {
            return Vec::new();
        }
        let angle = wrapped_angle(aim.to_angle() - self.base_angle);
        let [low, high] = self.common.bounds.speed;
        [0.25, 0.5, 0.75, 1.0]
            .into_iter()
            .map(|t| {
                let mut values = vec![low + t * (high - low), angle];
                values.resize(self.parameters().len(), 0.0);
                self.clamped(&Action(values))
            })
            .collect()
    }

    /// The action with every value clamped to its bounds.
    pub fn clamped(&self, action: &Action) -> Action {
        let values = action.0.iter().zip(self.parameters());
        Action(values.map(|(&v, p)| v.max(p.low).min(p.high)).collect())
    }

    /// The motion of the robot's finger in world coordinates. The sweep follows the direction from cue to target ball,
    /// rotated by `angle`. Its speed is `speed` at the contact position, which is the cue ball's centre plus the
    /// contact offsets.
    ///
    /// # Panics
    /// If the number of values differs from the number of parameters.
    pub fn strike(&self, action: &Action) -> StrikerMotion {
        assert_eq!(action.0.len(), self.parameters().len(), "values of the action");
        let offset = |i: usize| action.0.get(i).copied().unwrap_or(0.0);
        let angle = wrapped_angle(self.base_angle + action.0[1]);
        let forward = DVec2::from_angle(angle);
        let contact = forward * offset(2) + forward.perp() * offset(3);
        // The finger must not touch an extended body at the start, in any orientation.
        let back = self.outline.iter().map(|p| -p.dot(forward)).fold(0.0, f64::max);
        StrikerMotion {
            contact_w: self.cue.center_w + DVec3::new(contact.x, contact.y, 0.0),
            angle,
            speed: action.0[0],
            ball_radius: if self.outline.is_empty() { self.cue.radius } else { back },
        }
    }
}
