//! The static environment: all surface without a body.

use crate::draft::SceneInputs;
use crate::fused::{FusedSurface, SurfacePoints, within_faces};
use crate::support::{Carrier, RestingPlane, Surroundings};
use crate::views::Views;
use glamx::DVec3;
use sms_core::{Aabb, BACKGROUND, Entity, EntityKind, EntityShape, Mesh, PointCloud};
use sms_mesh::outline::{is_over, outline_on_plane};
use sms_mesh::{Plane, PointGrid, cloud::mean_color, colors_from, convex_hull, distances, median};

/// Environment surface that continues the surface of a movable object closer than this belongs to the object (its mask ends too
/// early), metres.
const CLEARANCE: f64 = 0.008;
/// Least cosine between the normals of surfaces that continue each other. A carrier's surface beside an object faces elsewhere.
const CONTINUES: f64 = 0.5;
/// Connected surface smaller than this is noise, m².
const MIN_AREA: f64 = 4e-4;
/// Vertex limit of the hulls for tests whether a point is inside an object.
const HULL_VERTICES: usize = 64;
/// Surface whose lower end is higher than this above the floor counts as floating, metres.
const HANGS: f64 = 0.03;
/// Largest distance between an object's hull and a rim that is missing from its mask, metres.
const LOST_RIM: f64 = 0.025;
/// A piece of surface counts as inside an object if this share of it is; the rest is noise.
const INSIDE: f64 = 0.95;

/// Builds the static environment near the objects as an open mesh of the fused surface that faces free space. The mesh leaves out
/// the support plane (a half space replaces it) and has flat patches under the movable objects that rest on it, where no camera
/// could see. `rests` holds the support of each object by its label. Returns `None` if only the support plane was seen.
pub(crate) fn environment_entity(
    scene: SceneInputs<'_>,
    objects: &[Entity],
    rests: &[(u16, RestingPlane)],
    fused: &FusedSurface,
) -> Option<Entity> {
    let SceneInputs { views, around, support_height, config } = scene;
    let settings = &config.environment;
    let corners = objects.iter().filter_map(|e| e.mesh.aabb()).flat_map(|b| [b.min, b.max]);
    let region = Aabb::of_points(corners).unwrap_or(Aabb { min: DVec3::ZERO, max: DVec3::ZERO });
    let reach = DVec3::splat(settings.reach);
    let region = Aabb { min: region.min - reach, max: region.max + reach };
    let floor = support_height.unwrap_or(f64::NEG_INFINITY);
    let is_floor = |p: DVec3| p.z < floor + settings.floor_band;
    let has_body = |label: u16| objects.iter().any(|e| e.label == label);
    let (own, own_normals): (Vec<DVec3>, Vec<DVec3>) =
        objects.iter().filter(|e| e.kind == EntityKind::Dynamic).flat_map(oriented_points).unzip();
    let own = PointGrid::new(&own, CLEARANCE);
    let is_own = |p: DVec3, normal: DVec3| {
        let mut is_own = false;
        own.for_each_within(p, CLEARANCE, |i, _| is_own |= own_normals[i].dot(normal) > CONTINUES);
        is_own
    };
    let patches: Vec<(Vec<DVec3>, Plane)> = objects
        .iter()
        .filter_map(|e| {
            let rest = rests.iter().find(|r| r.0 == e.label)?.1;
            let outline = outline_on_plane(&e.mesh.vertices, &rest.plane, 0.01, CLEARANCE + 0.006);
            let rests = e.kind == EntityKind::Dynamic && rest.carrier == Carrier::Environment;
            (rests && outline.len() >= 3).then_some((outline, rest.plane))
        })
        .collect();
    let is_part = |p: DVec3, normal: DVec3, label: u16| {
        let is_inside = p.cmpge(region.min).all() && p.cmple(region.max).all();
        is_inside && !has_body(label) && !is_replaced(&patches, p) && !is_own(p, normal)
    };
    let mut surface = fused.part(is_part);
    for (outline, plane) in &patches {
        surface.extend(hidden_patch(outline, plane, settings.spacing, views));
    }
    let mut mesh = surface.mesh(settings);
    mesh.triangles.retain(|t| !t.iter().all(|&v| is_floor(mesh.vertices[v as usize])));
    let hulls: Vec<Mesh> = objects
        .iter()
        .filter(|e| e.kind == EntityKind::Dynamic)
        .filter_map(|e| convex_hull(&e.mesh.vertices, HULL_VERTICES, 0.5 * CLEARANCE))
        .collect();
    let mut out = Mesh::default();
    for part in mesh.components() {
        if part.area() > MIN_AREA && !hulls.iter().any(|hull| hangs_inside(&part, hull, floor)) {
            append(&mut out, &part);
        }
    }
    let mut mesh = within_faces(out, settings.face_budget);
    if mesh.triangles.is_empty() {
        return None;
    }
    let cloud = background_cloud(around, &mesh, 4.0 * settings.spacing, has_body);
    mesh.colors = colors_from(&cloud.points_w, &cloud.colors, &mesh, 2.0 * settings.spacing);
    let stride = cloud.points_w.len().div_ceil(500).max(1);
    let sample: Vec<DVec3> = cloud.points_w.iter().copied().step_by(stride).collect();
    let residual_m = median(distances(&sample, &mesh));
    Some(Entity {
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
    })
}

/// Returns the points of an object's cloud and mesh with their normals.
fn oriented_points(entity: &Entity) -> impl Iterator<Item = (DVec3, DVec3)> {
    let mesh = &entity.mesh;
    let faces = (0..mesh.triangles.len()).map(|t| {
        let [a, b, c] = mesh.corners(t);
        ((a + b + c) / 3.0, (b - a).cross(c - a).normalize_or_zero())
    });
    let cloud = entity.cloud.points_w.iter().copied().zip(entity.cloud.normals_w.iter().copied());
    cloud.chain(mesh.vertices.iter().copied().zip(mesh.vertex_normals())).chain(faces)
}

/// Returns whether a patch of the plane below an object takes the place of `p`.
fn is_replaced(patches: &[(Vec<DVec3>, Plane)], p: DVec3) -> bool {
    patches.iter().any(|(outline, plane)| plane.height(p).abs() < 0.012 && is_over(outline, plane, p))
}

/// Returns points of the plane within an outline where no camera could see: none sees through them.
fn hidden_patch(outline: &[DVec3], plane: &Plane, spacing: f64, views: &Views<'_>) -> SurfacePoints {
    let u = plane.normal.any_orthonormal_vector();
    let v = plane.normal.cross(u);
    let bounds = Aabb::of_points(outline.iter().map(|p| DVec3::new(p.dot(u), p.dot(v), 0.0)));
    let mut out = SurfacePoints::default();
    let Some(Aabb { min, max }) = bounds else { return out };
    let steps = |from: f64, to: f64| ((to - from) / spacing).ceil() as usize + 1;
    for row in 0..steps(min.y, max.y) {
        for column in 0..steps(min.x, max.x) {
            let (x, y) = (min.x + spacing * column as f64, min.y + spacing * row as f64);
            let p = u * x + v * y + plane.normal * plane.offset;
            if is_over(outline, plane, p)
                && views.free_count(p, views.enough_frames()) < views.enough_frames()
            {
                out.push(p, plane.normal, spacing);
            }
        }
    }
    out
}

/// Returns whether a piece of surface floats inside an object's hull, or within the width of a rim beside it. Such a
/// piece belongs to the object although its mask lacks it (for example the rim of a bin under a board). As a fixed
/// obstacle it would push the object away.
fn hangs_inside(part: &Mesh, hull: &Mesh, floor: f64) -> bool {
    let planes: Vec<(DVec3, f64)> = (0..hull.triangles.len())
        .map(|t| {
            let [a, b, c] = hull.corners(t);
            let n = (b - a).cross(c - a).normalize_or_zero();
            (n, n.dot(a))
        })
        .collect();
    let is_in = |p: &&DVec3| planes.iter().all(|(n, d)| n.dot(**p) < d + LOST_RIM);
    let within = part.vertices.iter().filter(is_in).count();
    let lowest = part.vertices.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    lowest > floor + HANGS && within as f64 > INSIDE * part.vertices.len() as f64
}

fn append(mesh: &mut Mesh, part: &Mesh) {
    let offset = mesh.vertices.len() as u32;
    mesh.vertices.extend_from_slice(&part.vertices);
    mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + offset)));
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

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DPose3;

    #[test]
    fn what_hangs_in_an_object_is_of_it_and_what_stands_on_the_floor_or_beside_it_is_not() {
        let at =
            |center: DVec3, half: DVec3| Mesh::cuboid(half).transformed(&DPose3::from_translation(center));
        let bin = at(DVec3::new(0.0, 0.0, 0.25), DVec3::new(0.17, 0.2, 0.25));
        let hull = convex_hull(&bin.vertices, HULL_VERTICES, 1e-3).unwrap();
        let strip = DVec3::new(0.15, 0.15, 0.01);
        let hangs = |center: DVec3, floor: f64| hangs_inside(&at(center, strip), &hull, floor);
        assert!(hangs(DVec3::new(0.0, 0.0, 0.49), 0.0));
        // On the ground, for example below a ladder.
        assert!(!hangs(DVec3::new(0.0, 0.0, 0.02), 0.0));
        // The edge of a shelf beside it.
        assert!(!hangs(DVec3::new(0.25, 0.0, 0.49), 0.0));
    }
}
