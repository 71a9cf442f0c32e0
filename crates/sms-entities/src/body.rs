//! Entities from drafts.

use crate::config::EntitiesConfig;
use crate::draft::{Draft, STAGE};
use crate::mesher::{self, MeshInput, MeshPath};
use crate::recognise::recognise_primitive;
use crate::support::Carrier;
use crate::underside::contact_points;
use crate::views::Views;
use glamx::DVec3;
use sms_core::{Entity, EntityKind, EntityShape, Mesh, Seed, Warnings};
use sms_mesh::{SphereFit, cloud, colors_from, convex_parts_cached, distances, median, primitive_mesh};

fn kind(draft: &Draft) -> EntityKind {
    if draft.fixed { EntityKind::Static } else { EntityKind::Dynamic }
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
    let mean_color = cloud::mean_color(&draft.cloud.colors);
    mesh.colors = vec![mean_color; mesh.vertices.len()];
    let residuals = draft.cloud.points_w.iter().map(|p| (p.distance(center_w) - fit.radius).abs()).collect();
    Entity {
        label: draft.info.id,
        name: draft.info.name.clone(),
        description: draft.info.description.clone(),
        kind: kind(draft),
        shape: EntityShape::Sphere { center_w, radius: fit.radius },
        cloud: draft.cloud.clone(),
        mesh,
        parts: Vec::new(),
        texture: None,
        observed_share: fit.coverage,
        residual_m: median(residuals),
        mean_color,
    }
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
    let input = MeshInput {
        cloud: &draft.cloud,
        contact: &contact,
        rest: draft.rest.plane,
        views: Some(views),
        spacing,
    };
    let Some((mut mesh, path)) = mesher::mesh_object(&input, config) else {
        warnings.add(
            STAGE,
            "object_flat",
            format!("the surface seen of `{name}` is flat: no solid can be made of it, and it is left out"),
            "scan it from more sides",
        );
        return None;
    };
    match path {
        MeshPath::Asked => {}
        MeshPath::Prune => warnings.add(
            STAGE,
            "mesh_rule_changed",
            format!("the chosen mesh rule left no solid of `{name}`; the other rule was used"),
            "scan it from more sides",
        ),
        MeshPath::Hull => warnings.add(
            STAGE,
            "mesh_is_hull",
            format!("`{name}` is represented by the convex hull of its points: its hollows are lost"),
            "scan it from more sides",
        ),
    }
    let exact = recognise_primitive(draft, &contact, &mesh, views, config, seed);
    if let Some(solid) = exact.as_ref().and_then(|shape| primitive_mesh(shape, spacing.max(0.004))) {
        mesh = solid;
    }
    mesh.colors = colors_from(&draft.cloud.points_w, &draft.cloud.colors, &mesh, spacing);
    let parts = match exact {
        Some(_) => Vec::new(),
        None => {
            let mut parts = convex_parts_cached(&mesh, &config.convex, config.parts_cache.as_deref());
            crate::foot::keep_foot(&mut parts, &mesh, &draft.rest.plane, config.convex.max_vertices);
            parts
        }
    };
    let stride = draft.cloud.points_w.len().div_ceil(1500).max(1);
    let sample: Vec<DVec3> = draft.cloud.points_w.iter().copied().step_by(stride).collect();
    Some(Entity {
        label: draft.info.id,
        name: name.clone(),
        description: draft.info.description.clone(),
        kind: kind(draft),
        shape: exact.unwrap_or(EntityShape::Convex),
        cloud: draft.cloud.clone(),
        observed_share: mesher::observed_share(&mesh, &draft.cloud, 1.5 * spacing),
        residual_m: median(distances(&sample, &mesh)),
        mean_color: cloud::mean_color(&draft.cloud.colors),
        mesh,
        parts,
        texture: None,
    })
}
