//! A task with its bodies found in the planner's scene.

use crate::{Action, ActionForm, Billiards, Parameter, Selector, Task};
use glamx::{DVec2, DVec3};
use sms_core::{CoreError, InputError};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::{SimError, StrikerMotion, WorldOptions};

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
    settings: Billiards,
    cue: Ball,
    target: Ball,
}

/// A ball of the task, as the planner's scene has it.
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
        let Self::Billiards(settings) = self;
        settings.validate()?;
        let cue = find(settings, "cue", &settings.cue, scene)?;
        let target = find(settings, "target", &settings.target, scene)?;
        if cue.index == target.index {
            return Err(InputError::new(
                format!("`cue` and `target` are the same body, `{}`", cue.name),
                settings.path(),
                format!("make the selectors differ; the scene has {}", bodies_of(scene)),
            )
            .into());
        }
        Ok(ResolvedTask { settings: settings.clone(), cue, target })
    }
}

fn find(settings: &Billiards, key: &str, selector: &Selector, scene: &Scene) -> Result<Ball, InputError> {
    let index = selector.select(scene).ok_or_else(|| {
        InputError::new(
            format!("`{key} = {selector}` matches no dynamic body of scene `{}`", scene.name),
            settings.path(),
            format!("select one of the bodies that the scene has: {}", bodies_of(scene)),
        )
    })?;
    let body = &scene.bodies[index];
    Ok(Ball { name: body.name.clone(), index, center_w: body.x_wb.translation, radius: radius_of(body) })
}

/// "a (sphere, #f0f0f0, at [0.10, 0.20, 0.03]), b (static), …".
fn bodies_of(scene: &Scene) -> String {
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
    /// The task's settings.
    pub fn settings(&self) -> &Billiards {
        &self.settings
    }

    /// Kind of task ("billiards").
    pub fn kind(&self) -> &'static str {
        "billiards"
    }

    /// The ball that is struck.
    pub fn cue(&self) -> &Ball {
        &self.cue
    }

    /// The ball that has to reach the goal.
    pub fn target(&self) -> &Ball {
        &self.target
    }

    /// The goal on the floor.
    pub fn goal_w(&self) -> DVec2 {
        DVec2::from_array(self.settings.goal_w)
    }

    /// Unit of the objective.
    pub fn objective_unit(&self) -> &'static str {
        "m"
    }

    /// Whether an objective counts as success.
    pub fn is_success(&self, objective: f64) -> bool {
        objective <= self.settings.success_m
    }

    /// Objective of doing nothing: the target ball's distance to the goal at the start, metres.
    pub fn initial_objective(&self) -> f64 {
        horizontal(self.target.center_w).distance(self.goal_w())
    }

    /// How worlds are built for this task.
    pub fn world_options(&self) -> WorldOptions {
        WorldOptions { dt: self.settings.dt, ..WorldOptions::default() }
    }

    /// The parameters of an action, in order.
    pub fn parameters(&self) -> Vec<Parameter> {
        let b = &self.settings.bounds;
        let parameter = |name: &str, unit: &str, [low, high]: [f64; 2]| Parameter {
            name: name.to_owned(),
            unit: unit.to_owned(),
            low,
            high,
        };
        let mut all = vec![parameter("speed", "m/s", b.speed), parameter("angle", "rad", b.angle)];
        if self.settings.form == ActionForm::SpeedAngleContact {
            all.push(parameter("contact_along", "m", b.along));
            all.push(parameter("contact_across", "m", b.across));
        }
        all
    }

    /// The part of the parameters' box where the cue ball can reach the target ball directly: a far smaller range
    /// of angles than the bounds allow, where most good shots are. `None` when it is not smaller.
    pub fn direct_box(&self) -> Option<Vec<[f64; 2]>> {
        let distance = horizontal(self.target.center_w - self.cue.center_w).length();
        let reach = (self.cue.radius + self.target.radius) / distance;
        let [low, high] = self.settings.bounds.angle;
        // Beyond a cut of about 75° the target ball hardly moves.
        let cone = (0.97 * reach.min(1.0)).asin();
        let narrowed = [low.max(-cone), high.min(cone)];
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
        let Some(to_goal) = (self.goal_w() - target).try_normalize() else { return Vec::new() };
        let ghost = target - to_goal * (self.cue.radius + self.target.radius);
        let aim = ghost - cue;
        // The far side of the target ball cannot be struck directly.
        if aim.dot(to_goal) <= 0.0 {
            return Vec::new();
        }
        let angle = wrap(aim.to_angle() - self.base_angle());
        let [low, high] = self.settings.bounds.speed;
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
        let angle = wrap(self.base_angle() + action.0[1]);
        let forward = DVec2::from_angle(angle);
        let contact = forward * offset(2) + forward.perp() * offset(3);
        StrikerMotion {
            contact_w: self.cue.center_w + DVec3::new(contact.x, contact.y, 0.0),
            angle,
            speed: action.0[0],
            ball_radius: self.cue.radius,
        }
    }

    /// Direction from cue to target ball on the floor, radians from world x.
    fn base_angle(&self) -> f64 {
        horizontal(self.target.center_w - self.cue.center_w).to_angle()
    }
}

/// The part of a world vector that lies in the floor.
pub(crate) fn horizontal(v_w: DVec3) -> DVec2 {
    DVec2::new(v_w.x, v_w.y)
}

/// An angle in (−π, π].
fn wrap(angle: f64) -> f64 {
    let turned = angle.rem_euclid(std::f64::consts::TAU);
    if turned > std::f64::consts::PI { turned - std::f64::consts::TAU } else { turned }
}
