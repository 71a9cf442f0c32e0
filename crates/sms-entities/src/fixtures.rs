//! Objects for tests.

use sms_core::{Entity, EntityKind, EntityShape, Mesh, PointCloud};

pub(crate) fn entity(name: &str, mesh: Mesh, shape: EntityShape) -> Entity {
    let parts = if shape.is_primitive() { Vec::new() } else { vec![mesh.clone()] };
    Entity {
        label: 1,
        name: name.into(),
        description: String::new(),
        kind: EntityKind::Dynamic,
        shape,
        cloud: PointCloud::default(),
        mesh,
        texture: None,
        parts,
        observed_share: 1.0,
        residual_m: 0.0,
        mean_color: [0; 3],
    }
}
