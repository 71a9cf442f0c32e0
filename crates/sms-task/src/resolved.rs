//! A task with its bodies found in the planner's scene.

use crate::billiards::{Common, named};
use crate::place::{check_near, check_reachable};
use crate::terms::Tracker;
use crate::{
    Action, ActionForm, Billiards, Bodies, Parameter, Region, RobotArm, Selector, Strike, Task, Term,
};
use glamx::{DPose3, DVec2, DVec3};
use sms_core::{CoreError, InputError, wrapped_angle};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::{SimError, StrikerMotion, WorldOptions};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Errors of resolving or running a task.
#[derive(Debug, thiserror::Error)]
pub enum TaskError {
    /// The task does not fit the scene; names the task file and lists the bodies there are.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The world could not be built or blew up.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// A file could not be read or written.
    #[error(transparent)]
    Core(#[from] CoreError),
}

/// A task resolved against the planner's scene. It holds all that an action means in world coordinates, so that a
/// target world, whose bodies are others, carries out the same motion of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ResolvedTask {
    kind: &'static str,
    pub(crate) common: Common,
    source: PathBuf,
    cue: Ball,
    /// Corners of the struck body on the floor, relative to its centre; none for a ball.
    outline: Vec<DVec2>,
    target: Ball,
    /// Direction of the angle 0 on the floor, radians from world x.
    base_angle: f64,
    pub(crate) wish: Wish,
    pub(crate) arm: Option<Arc<RobotArm>>,
}

/// What the objective is.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Wish {
    /// The target ball passes over the goal on the floor.
    Pass(DVec2),
    /// Terms, each with the bodies that it is about.
    Terms(Vec<(Term, Vec<Ball>)>),
}

/// A body of the task, as the planner's scene has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Ball {
    /// Name of the body.
    pub name: String,
    /// Index of the body in the scene; also its [`sms_sim::BodyId`].
    pub index: usize,
    /// Centre in the world, metres.
    pub center_w: DVec3,
    /// Radius, metres; for a body that is no sphere, half of its mean extent.
    pub radius: f64,
}

impl Task {
    /// Finds the task's bodies in the planner's scene.
    ///
    /// # Errors
    /// [`TaskError::Input`] when a selector matches no dynamic body (the bodies there are, are listed), when cue and
    /// target are the same body, or when a setting is out of range.
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
        wish: Wish::Pass(DVec2::from_array(settings.goal_w)),
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
        let body = match term.bodies() {
            Bodies::One(selector) => Some(find(path, &format!("terms[{i}].body"), selector, scene)?),
            Bodies::Others(_) => None,
        };
        named_bodies.extend(body.as_ref().map(|b| b.index));
        found.push(body);
    }
    let others: Vec<Ball> = (0..scene.bodies.len())
        .filter(|i| scene.bodies[*i].kind == BodyKind::Dynamic && !named_bodies.contains(i))
        .map(|i| ball_of(scene, i))
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
                // It may be beside the floor, or below it.
                Region::Box { .. } => None,
            };
            if let (Term::Reach { .. }, Some(body), Some(radius_m)) = (term, &found[i], on_floor) {
                let enough_m = settings.success_m + radius_m;
                check_reachable(path, &what, place.middle_w(), enough_m, body, scene)?;
            }
        }
    }
    let outline = outline_of(&scene.bodies[cue.index]);
    let wish = settings.terms.iter().cloned().zip(found);
    let wish = wish.map(|(term, body)| (term, body.map_or_else(|| others.clone(), |b| vec![b]))).collect();
    Ok(ResolvedTask {
        kind: "strike",
        common: settings.common(),
        source: settings.source.clone(),
        target: moved.unwrap_or_else(|| cue.clone()),
        base_angle,
        wish: Wish::Terms(wish),
        arm: None,
        outline,
        cue,
    })
}

/// Corners of a body that is no ball on the floor, relative to its centre.
fn outline_of(body: &Body) -> Vec<DVec2> {
    match &body.shape {
        BodyShape::Sphere { .. } | BodyShape::HalfSpace => Vec::new(),
        shape => {
            let corners = shape.meshes().into_iter().flat_map(|m| m.vertices);
            corners.map(|p| horizontal(body.x_wb.rotation * p)).collect()
        }
    }
}

fn find(path: &Path, key: &str, selector: &Selector, scene: &Scene) -> Result<Ball, InputError> {
    let index = selector.select(scene).ok_or_else(|| {
        InputError::new(
            format!("`{key} = {selector}` matches no dynamic body of scene `{}`", scene.name),
            path,
            format!("select one of the bodies that the scene has: {}", bodies_of(scene)),
        )
    })?;
    Ok(ball_of(scene, index))
}

fn ball_of(scene: &Scene, index: usize) -> Ball {
    let body = &scene.bodies[index];
    Ball { name: body.name.clone(), index, center_w: body.x_wb.translation, radius: radius_of(body) }
}

/// "a (sphere, #f0f0f0, at [0.10, 0.20, 0.03]), b (static), …".
pub(crate) fn bodies_of(scene: &Scene) -> String {
    let describe = |b: &Body| {
        if b.kind == BodyKind::Static {
            return format!("{} (static)", b.name);
        }
        let shape = if matches!(b.shape, BodyShape::Sphere { .. }) { "sphere" } else { "no sphere" };
        let ([r, g, blue], p) = (b.color, b.x_wb.translation);
        format!("{} ({shape}, color [{r}, {g}, {blue}], at [{:.3}, {:.3}, {:.3}])", b.name, p.x, p.y, p.z)
    };
    let list: Vec<String> = scene.bodies.iter().map(describe).collect();
    if list.is_empty() { "none".to_owned() } else { list.join(", ") }
}

fn radius_of(body: &Body) -> f64 {
    match &body.shape {
        BodyShape::Sphere { radius } => *radius,
        BodyShape::HalfSpace => 0.0,
        shape => {
            let corners = shape.meshes().into_iter().flat_map(|m| m.vertices);
            sms_core::Aabb::of_points(corners).map_or(0.0, |b| b.extents().element_sum() / 6.0)
        }
    }
}

impl ResolvedTask {
    /// Places on the floor that bodies have to come to, with what they are called in the task's file: points of the surface on
    /// which the body stands, in the world. Places that may be beside the floor are none of them.
    pub fn floor_places(&self) -> Vec<(String, DVec3)> {
        let under = |body: &Ball, place_w: DVec2| place_w.extend(body.center_w.z - body.radius);
        match &self.wish {
            Wish::Pass(goal_w) => vec![("`goal_w`".to_owned(), under(&self.target, *goal_w))],
            Wish::Terms(terms) => terms
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

    /// The file to name in messages.
    pub(crate) fn path(&self) -> &Path {
        named(&self.source)
    }

    /// Kind of task ("billiards", "strike").
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// The body that is struck.
    pub fn cue(&self) -> &Ball {
        &self.cue
    }

    /// The body that has to come to a place or to topple; the struck one where no term names another.
    pub fn target(&self) -> &Ball {
        &self.target
    }

    /// The goal on the floor: that of billiards, or the middle of the first place to reach.
    pub fn goal_w(&self) -> Option<DVec2> {
        match &self.wish {
            Wish::Pass(goal_w) => Some(*goal_w),
            Wish::Terms(terms) => terms.iter().find_map(|(term, _)| match term {
                Term::Reach { place, .. } => Some(place.middle_w()),
                _ => None,
            }),
        }
    }

    /// Unit of the objective.
    pub fn objective_unit(&self) -> &'static str {
        "m"
    }

    /// Largest objective that counts as success; metres where it is a distance.
    pub fn success_m(&self) -> f64 {
        self.common.success_m
    }

    /// Whether an objective counts as success.
    pub fn is_success(&self, objective: f64) -> bool {
        objective <= self.common.success_m
    }

    /// Objective of doing nothing, metres: where everything stays where it is.
    pub fn initial_objective(&self) -> f64 {
        match &self.wish {
            Wish::Pass(goal_w) => horizontal(self.target.center_w).distance(*goal_w),
            Wish::Terms(terms) => terms
                .iter()
                .map(|(term, bodies)| {
                    let cost = |b: &Ball| {
                        let x_wb = DPose3::from_translation(b.center_w);
                        let mut tracker = Tracker::new(term, x_wb);
                        tracker.observe(term.between_s()[0], &x_wb);
                        tracker.cost()
                    };
                    bodies.iter().map(cost).sum::<f64>()
                })
                .sum(),
        }
    }

    /// How worlds are built for this task.
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

    /// The part of the parameters' box where the cue ball can reach the target ball directly: a far smaller range
    /// of angles than the bounds allow, where most good shots are. `None` when it is not smaller.
    pub fn direct_box(&self) -> Option<Vec<[f64; 2]>> {
        if self.cue.index == self.target.index || !self.outline.is_empty() {
            return None;
        }
        let distance = horizontal(self.target.center_w - self.cue.center_w).length();
        let reach = (self.cue.radius + self.target.radius) / distance;
        let [low, high] = self.common.bounds.angle;
        // Beyond a cut of about 75° the target ball hardly moves.
        let cone = (0.97 * reach.min(1.0)).asin();
        // The angle 0 may go towards something else.
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

    /// Actions that billiards geometry suggests: aim at the ghost ball, the place where the cue ball touches the
    /// target ball opposite to the goal, at several speeds. Spin, friction and obstacles are left to the search.
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
        // The far side of the target ball cannot be struck directly.
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

    /// The action with every value inside its bounds.
    pub fn clamped(&self, action: &Action) -> Action {
        let values = action.0.iter().zip(self.parameters());
        Action(values.map(|(&v, p)| v.max(p.low).min(p.high)).collect())
    }

    /// The motion of the robot's finger, in world coordinates, that an action means: the sweep goes along the
    /// direction from cue to target ball turned by `angle`, and has `speed` at the contact position, which is the
    /// cue ball's centre plus the contact offsets.
    ///
    /// # Panics
    /// When the action has another number of values than the task has parameters.
    pub fn strike(&self, action: &Action) -> StrikerMotion {
        assert_eq!(action.0.len(), self.parameters().len(), "values of the action");
        let offset = |i: usize| action.0.get(i).copied().unwrap_or(0.0);
        let angle = wrapped_angle(self.base_angle + action.0[1]);
        let forward = DVec2::from_angle(angle);
        let contact = forward * offset(2) + forward.perp() * offset(3);
        // The finger starts clear of a body that is no ball, whichever way it lies.
        let back = self.outline.iter().map(|p| -p.dot(forward)).fold(0.0, f64::max);
        StrikerMotion {
            contact_w: self.cue.center_w + DVec3::new(contact.x, contact.y, 0.0),
            angle,
            speed: action.0[0],
            ball_radius: if self.outline.is_empty() { self.cue.radius } else { back },
        }
    }
}

/// The part of a world vector that lies in the floor.
pub(crate) fn horizontal(v_w: DVec3) -> DVec2 {
    DVec2::new(v_w.x, v_w.y)
}
