//! Object descriptions for the choice of materials.

use crate::EntitySet;
use sms_core::{Entity, EntityKind, EntityShape};
use sms_materials::ObjectQuery;
use sms_mesh::convex_hull;
use std::f64::consts::PI;

/// Name and description of the support plane.
const FLOOR: &str = "floor";
/// Vertex limit of the hulls whose volume is compared with that of the meshes.
const HULL_VERTICES: usize = 256;

/// Describes each entity, in order, for the choice of its material; the floor comes last.
pub fn material_queries(set: &EntitySet) -> Vec<ObjectQuery> {
    let mut queries: Vec<ObjectQuery> = set.entities.iter().map(query).collect();
    queries.push(ObjectQuery {
        name: FLOOR.into(),
        description: FLOOR.into(),
        mean_color: [128; 3],
        ..ObjectQuery::default()
    });
    queries
}

fn query(e: &Entity) -> ObjectQuery {
    let base = ObjectQuery {
        name: e.name.clone(),
        description: e.description.clone(),
        is_sphere: matches!(e.shape, EntityShape::Sphere { .. }),
        mean_color: e.mean_color,
        ..ObjectQuery::default()
    };
    if e.kind == EntityKind::Static {
        return base;
    }
    let (volume_m3, hull_fill, hull_area_m2) = match e.shape {
        EntityShape::Sphere { radius, .. } => {
            (4.0 / 3.0 * PI * radius.powi(3), 1.0, 4.0 * PI * radius * radius)
        }
        EntityShape::Box { half_extents: h, .. } => {
            (8.0 * h.element_product(), 1.0, 8.0 * (h.x * h.y + h.y * h.z + h.z * h.x))
        }
        EntityShape::Cylinder { radius, half_length, .. } => {
            let area = 2.0 * PI * radius * (radius + 2.0 * half_length);
            (2.0 * PI * radius * radius * half_length, 1.0, area)
        }
        EntityShape::Convex | EntityShape::TriMesh => {
            let volume = e.mesh.volume();
            let hull = convex_hull(&e.mesh.vertices, HULL_VERTICES, 0.0);
            let (in_hull, area) = hull.map_or((0.0, 0.0), |h| (h.volume(), h.area()));
            (volume, if in_hull > 0.0 { (volume / in_hull).clamp(0.0, 1.0) } else { 0.0 }, area)
        }
    };
    ObjectQuery { volume_m3: volume_m3.max(0.0), hull_fill, hull_area_m2, ..base }
}
