//! The static environment: all surface without a body.

use crate::body::residual_m;
use crate::config::EnvironmentConfig;
use crate::support::Surroundings;
use glamx::DVec3;
use sms_core::{BACKGROUND, Entity, EntityKind, EntityShape, Mesh, PointCloud};
use sms_mesh::{PointGrid, cloud::mean_color, colors_from};

/// Returns the entity of the open `mesh` of the surface without a body.
pub(crate) fn environment_entity(
    mut mesh: Mesh,
    around: &Surroundings,
    objects: &[Entity],
    settings: &EnvironmentConfig,
) -> Entity {
    let has_body = |label: u16| objects.iter().any(|e| e.label == label);
    let cloud = background_cloud(around, &mesh, 4.0 * settings.spacing, has_body);
    mesh.colors = colors_from(&cloud.points_w, &cloud.colors, &mesh, 2.0 * settings.spacing);
    let residual_m = residual_m(&cloud, &mesh, 500);
    Entity {
        label: BACKGROUND,
        name: "environment".into(),
        description: String::new(),
        kind: EntityKind::Static,
        shape: EntityShape::TriMesh,
        observed_share: crate::mesher::observed_share(&mesh, &cloud, 3.0 * settings.spacing),
        mean_color: mean_color(&cloud.colors),
        cloud,
        mesh,
        parts: Vec::new(),
        texture: None,
        residual_m,
    }
}

/// Returns the surface points without a body near the mesh.
fn background_cloud(
    around: &Surroundings,
    mesh: &Mesh,
    reach: f64,
    has_body: impl Fn(u16) -> bool,
) -> PointCloud {
    let mut on_mesh: Vec<DVec3> = mesh.vertices.clone();
    on_mesh.extend((0..mesh.triangles.len()).map(|t| mesh.corners(t).iter().sum::<DVec3>() / 3.0));
    let grid = PointGrid::new(&on_mesh, reach);
    let mut cloud = PointCloud::default();
    for i in 0..around.points.len() {
        if !has_body(around.labels[i]) && grid.is_near(around.points[i], reach) {
            cloud.points_w.push(around.points[i]);
            cloud.normals_w.push(around.normals[i]);
            cloud.colors.push(around.colors[i]);
        }
    }
    cloud
}
