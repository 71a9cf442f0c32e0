//! The static environment: all unlabelled surface.

use crate::draft::SceneInputs;
use crate::support::{Carrier, RestingPlane, Surroundings};
use glamx::DVec3;
use sms_core::{Aabb, BACKGROUND, Entity, EntityKind, EntityShape, Mesh, PointCloud};
use sms_mesh::outline::{is_over, outline_on_plane};
use sms_mesh::{
    Plane, PointGrid, Tsdf, TsdfFrame, cloud::mean_color, colors_from, convex_hull, distances, median,
    simplify, taubin,
};

/// Environment surface closer than this to an object belongs to the object (its mask ends too early), metres.
const CLEARANCE: f64 = 0.008;
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
/// Decimation errors, tried in this order until the face budget is met, metres.
const DECIMATION_ERRORS: [f64; 3] = [0.002, 0.004, 0.008];

/// Builds the static environment near the objects as an open mesh that faces free space. The mesh leaves out the
/// support plane (a half space replaces it) and has flat patches under the objects that rest on it, where no camera
/// could see. `rests` holds the support of each object by its label. Returns `None` if only the support plane was seen.
pub(crate) fn environment_entity(
    scene: SceneInputs<'_>,
    objects: &[Entity],
    rests: &[(u16, RestingPlane)],
) -> Option<Entity> {
    let SceneInputs { views, around, support_height, config } = scene;
    let settings = &config.environment;
    let corners = objects.iter().filter_map(|e| e.mesh.aabb()).flat_map(|b| [b.min, b.max]);
    let region = Aabb::of_points(corners).unwrap_or(Aabb { min: DVec3::ZERO, max: DVec3::ZERO });
    let reach = DVec3::splat(settings.reach);
    let region = Aabb { min: region.min - reach, max: region.max + reach };
    let floor = support_height.unwrap_or(f64::NEG_INFINITY);
    let is_floor = |p: DVec3| p.z < floor + settings.floor_band;
    let frames = views.sequence.frames.iter().enumerate();
    let frames: Vec<TsdfFrame> = frames
        .map(|(f, frame)| TsdfFrame {
            camera: &frame.camera,
            depth: &frame.depth,
            pixels: views.unlabelled_pixels(f),
        })
        .collect();
    let mut mesh = Tsdf::fuse(&frames, &region, settings.voxel, is_floor).surface();
    smooth_open(&mut mesh, 0.5 * settings.voxel);
    let own: Vec<DVec3> = objects
        .iter()
        .flat_map(|e| {
            let faces = (0..e.mesh.triangles.len()).map(|t| e.mesh.corners(t).iter().sum::<DVec3>() / 3.0);
            e.cloud.points_w.iter().chain(&e.mesh.vertices).copied().chain(faces)
        })
        .collect();
    let own = PointGrid::new(&own, CLEARANCE);
    let patches: Vec<(Vec<DVec3>, Plane)> = objects
        .iter()
        .filter_map(|e| {
            let rest = rests.iter().find(|r| r.0 == e.label)?.1;
            let outline = outline_on_plane(&e.mesh.vertices, &rest.plane, 0.01, CLEARANCE + 0.006);
            (rest.carrier == Carrier::Environment && outline.len() >= 3).then_some((outline, rest.plane))
        })
        .collect();
    mesh.triangles.retain(|t| {
        let corners = t.map(|v| mesh.vertices[v as usize]);
        let center = corners.iter().sum::<DVec3>() / 3.0;
        let replaced = patches
            .iter()
            .any(|(outline, plane)| plane.height(center).abs() < 0.012 && is_over(outline, plane, center));
        let near_object = own.is_near(center, CLEARANCE);
        !corners.iter().all(|&p| is_floor(p)) && !replaced && !near_object
    });
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
    let mut mesh = out;
    for error in DECIMATION_ERRORS {
        if mesh.triangles.len() > settings.face_budget {
            mesh = simplify(&mesh, settings.face_budget, error);
        }
    }
    for (outline, _) in &patches {
        let fan = (1..outline.len() - 1).map(|k| [0, k as u32, k as u32 + 1]).collect();
        append(&mut mesh, &Mesh::new(outline.clone(), fan));
    }
    if mesh.triangles.is_empty() {
        return None;
    }
    let cloud = background_cloud(around, &mesh, 4.0 * settings.voxel);
    mesh.colors = colors_from(&cloud.points_w, &cloud.colors, &mesh, 2.0 * settings.voxel);
    let stride = cloud.points_w.len().div_ceil(500).max(1);
    let sample: Vec<DVec3> = cloud.points_w.iter().copied().step_by(stride).collect();
    let residual_m = median(distances(&sample, &mesh));
    Some(Entity {
        label: BACKGROUND,
        name: "environment".into(),
        description: String::new(),
        kind: EntityKind::Static,
        shape: EntityShape::TriMesh,
        observed_share: crate::mesher::observed_share(&mesh, &cloud, 3.0 * settings.voxel),
        mean_color: mean_color(&cloud.colors),
        cloud,
        mesh,
        parts: Vec::new(),
        texture: None,
        residual_m,
    })
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

/// Taubin smoothing that does not move the boundary of an open mesh.
fn smooth_open(mesh: &mut Mesh, limit: f64) {
    let mut edges: std::collections::BTreeMap<(u32, u32), i32> = Default::default();
    for &[a, b, c] in &mesh.triangles {
        for (i, j) in [(a, b), (b, c), (c, a)] {
            *edges.entry((i.min(j), i.max(j))).or_default() += if i < j { 1 } else { -1 };
        }
    }
    let mut rim = vec![false; mesh.vertices.len()];
    for ((a, b), count) in edges {
        if count != 0 {
            rim[a as usize] = true;
            rim[b as usize] = true;
        }
    }
    taubin(mesh, &rim, 6, limit);
}

/// Returns the unlabelled surface points near the mesh.
fn background_cloud(around: &Surroundings, mesh: &Mesh, reach: f64) -> PointCloud {
    let mut on_mesh: Vec<DVec3> = mesh.vertices.clone();
    on_mesh.extend((0..mesh.triangles.len()).map(|t| mesh.corners(t).iter().sum::<DVec3>() / 3.0));
    let grid = PointGrid::new(&on_mesh, reach);
    let mut cloud = PointCloud::default();
    for i in 0..around.points.len() {
        if around.labels[i] == BACKGROUND && grid.is_near(around.points[i], reach) {
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
