//! Obstacles around the robot, from a scene.

use crate::{LinkShape, Obstacle, ObstacleShape};
use sms_scene::{Body, BodyShape, Scene};

/// Returns every body of a scene as an obstacle, the body at index `struck` as [`Obstacle::struck`]. Bodies without
/// extent are left out.
pub fn obstacles(scene: &Scene, struck: usize) -> Vec<Obstacle> {
    let obstacle = |(i, body): (usize, &Body)| {
        let obstacle = Obstacle::new(body.name.clone(), body.x_wb, obstacle_shape(body)?);
        Some(if i == struck { obstacle.struck() } else { obstacle })
    };
    scene.bodies.iter().enumerate().filter_map(obstacle).collect()
}

fn obstacle_shape(body: &Body) -> Option<ObstacleShape> {
    let link = match &body.shape {
        BodyShape::Sphere { radius } => LinkShape::Sphere { radius: *radius },
        BodyShape::Box { half_extents } => LinkShape::Box { half: *half_extents },
        BodyShape::Cylinder { radius, half_length } => {
            LinkShape::Cylinder { radius: *radius, half_length: *half_length }
        }
        BodyShape::HalfSpace => return Some(ObstacleShape::HalfSpace),
        BodyShape::TriMesh { mesh } => return ObstacleShape::surface(mesh),
        BodyShape::Hulls { hulls } => {
            let links: Vec<LinkShape> = hulls.iter().filter_map(|h| LinkShape::convex(&h.vertices)).collect();
            return (!links.is_empty()).then_some(ObstacleShape::Hulls(links));
        }
    };
    Some(ObstacleShape::Link(link))
}
