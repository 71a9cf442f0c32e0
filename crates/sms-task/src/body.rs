//! Bodies of the planner's scene that a task refers to.

use crate::Selector;
use glamx::{DVec2, DVec3};
use sms_core::InputError;
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use std::path::Path;

/// A body of the task with its state in the planner's scene.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskBody {
    /// Name of the body.
    pub name: String,
    /// Index of the body in the scene; also its [`sms_sim::BodyId`].
    pub index: usize,
    /// Centre in the world, metres.
    pub center_w: DVec3,
    /// Radius, metres; half the mean extent for bodies other than spheres.
    pub radius: f64,
}

pub(crate) fn find(
    path: &Path,
    key: &str,
    selector: &Selector,
    scene: &Scene,
) -> Result<TaskBody, InputError> {
    let index = selector.select(scene).ok_or_else(|| {
        InputError::new(
            format!("`{key} = {selector}` matches no dynamic body of scene `{}`", scene.name),
            path,
            format!("select one of the bodies that the scene has: {}", bodies_of(scene)),
        )
    })?;
    Ok(task_body(scene, index))
}

pub(crate) fn task_body(scene: &Scene, index: usize) -> TaskBody {
    let body = &scene.bodies[index];
    TaskBody { name: body.name.clone(), index, center_w: body.x_wb.translation, radius: radius_of(body) }
}

/// The bodies of a scene as a list for messages: "a (sphere, #f0f0f0, at [0.10, 0.20, 0.03]), b (static), …".
pub(crate) fn bodies_of(scene: &Scene) -> String {
    let describe = |b: &Body| {
        if b.kind == BodyKind::Static {
            return format!("{} (static)", b.name);
        }
        let shape = if matches!(b.shape, BodyShape::Sphere { .. }) { "sphere" } else { "not a sphere" };
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

/// The horizontal part of a world vector.
pub(crate) fn horizontal(v_w: DVec3) -> DVec2 {
    DVec2::new(v_w.x, v_w.y)
}
