//! Entities from drafts.

use crate::config::EntitiesConfig;
use crate::draft::{Draft, STAGE};
use crate::mesher::{self, MeshInput, MeshPath};
use crate::recognise::recognise_primitive;
use crate::support::Carrier;
use crate::underside::contact_points;
use crate::views::Views;
use glamx::DVec3;
use sms_core::{Entity, EntityKind, EntityShape, Mesh, PointCloud, Seed, Warnings};
use sms_mesh::{
    Plane, SphereFit, cloud::mean_color, colors_from, convex_parts_cached, distances, median, primitive_mesh,
};

/// Returns the entity of a draft, without convex parts.
fn entity(draft: &Draft, shape: EntityShape, mesh: Mesh, observed_share: f64, residual_m: f64) -> Entity {
    Entity {
        label: draft.info.id,
        name: draft.info.name.clone(),
        description: draft.info.description.clone(),
        kind: if draft.fixed { EntityKind::Static } else { EntityKind::Dynamic },
        shape,
        cloud: draft.cloud.clone(),
        mesh,
        parts: Vec::new(),
        texture: None,
        observed_share,
        residual_m,
        mean_color: mean_color(&draft.cloud.colors),
    }
}

/// Builds an object that is a sphere.
pub(crate) fn sphere_entity(draft: &Draft, fit: &SphereFit) -> Entity {
    let mut center_w = fit.center;
    if draft.rest.carrier != Carrier::Unseen {
        // Closes a gap or an overlap between the sphere and its carrier that is within the accuracy of the scan.
        let gap = draft.rest.plane.height(center_w) - fit.radius;
        if gap.abs() < 0.003 {
            center_w -= draft.rest.plane.normal * gap;
        }
    }
    let mut mesh = Mesh::icosphere(fit.radius, 3);
    for v in &mut mesh.vertices {
        *v += center_w;
    }
    mesh.colors = vec![mean_color(&draft.cloud.colors); mesh.vertices.len()];
    let residuals = draft.cloud.points_w.iter().map(|p| (p.distance(center_w) - fit.radius).abs()).collect();
    let shape = EntityShape::Sphere { center_w, radius: fit.radius };
    entity(draft, shape, mesh, fit.coverage, median(residuals))
}

/// Builds an object of any other shape. Returns `None`, with a warning that names the object, if no solid can be made.
pub(crate) fn mesh_entity(
    draft: &Draft,
    views: &Views,
    config: &EntitiesConfig,
    seed: Seed,
    warnings: &Warnings,
) -> Option<Entity> {
    let name = &draft.info.name;
    let spacing = draft.spacing;
    let contact = contact_points(&draft.cloud, &draft.rest, views, draft.info.id, spacing);
    let (cloud, rest) = (&draft.cloud, draft.rest.plane);
    let input = MeshInput { cloud, contact: &contact, rest, views: Some(views), spacing };
    let warn = |code: &str, message: String| warnings.add(STAGE, code, message, "scan it from more sides");
    let Some((mut mesh, path)) = mesher::mesh_object(&input, config) else {
        warn(
            "object_flat",
            format!("the surface seen of `{name}` is flat: no solid can be made of it, and it is left out"),
        );
        return None;
    };
    match path {
        MeshPath::Asked => {}
        MeshPath::Prune => warn(
            "mesh_rule_changed",
            format!("the chosen mesh rule left no solid of `{name}`; the other rule was used"),
        ),
        MeshPath::Hull => warn(
            "mesh_is_hull",
            format!("`{name}` is represented by the convex hull of its points: its hollows are lost"),
        ),
    }
    let exact = recognise_primitive(draft, &contact, &mesh, views, config, seed);
    if let Some(solid) = exact.as_ref().and_then(|shape| primitive_mesh(shape, spacing.max(0.004))) {
        mesh = solid;
    }
    mesh.colors = colors_from(&cloud.points_w, &cloud.colors, &mesh, spacing);
    let observed_share = mesher::observed_share(&mesh, cloud, 1.5 * spacing);
    let residual_m = residual_m(cloud, &mesh, RESIDUAL_SAMPLES);
    let shape = exact.unwrap_or(EntityShape::Convex);
    let mut entity = entity(draft, shape, mesh, observed_share, residual_m);
    // A fixed body needs them only if it has no measured surface.
    if !draft.fixed {
        add_parts(&mut entity, &rest, config);
    }
    Some(entity)
}

/// Splits the mesh of a body that is no exact solid into convex parts.
pub(crate) fn add_parts(entity: &mut Entity, rest: &Plane, config: &EntitiesConfig) {
    if entity.shape == EntityShape::Convex {
        entity.parts = convex_parts_cached(&entity.mesh, &config.convex, config.parts_cache.as_deref());
        crate::foot::keep_foot(&mut entity.parts, &entity.mesh, rest, config.convex.max_vertices);
    }
}

/// Number of points of an object that its residual is measured at.
const RESIDUAL_SAMPLES: usize = 1500;

/// Returns the median distance of about `samples` points of the cloud from the mesh, metres.
pub(crate) fn residual_m(cloud: &PointCloud, mesh: &Mesh, samples: usize) -> f64 {
    let stride = cloud.points_w.len().div_ceil(samples).max(1);
    let sample: Vec<DVec3> = cloud.points_w.iter().copied().step_by(stride).collect();
    median(distances(&sample, mesh))
}

/// Gives a fixed body the open mesh of its measured surface.
pub(crate) fn keep_surface(entity: &mut Entity, mut mesh: Mesh, spacing: f64) {
    let reach = 2.0 * spacing;
    mesh.colors = colors_from(&entity.cloud.points_w, &entity.cloud.colors, &mesh, reach);
    entity.observed_share = mesher::observed_share(&mesh, &entity.cloud, reach);
    entity.residual_m = residual_m(&entity.cloud, &mesh, RESIDUAL_SAMPLES);
    entity.shape = EntityShape::TriMesh;
    entity.mesh = mesh;
}
