//! The static environment: everything that no label explains.

use crate::config::EntitiesConfig;
use crate::grid::PointGrid;
use crate::refine;
use crate::support::{Carrier, Plane, Rest};
use crate::tsdf::Tsdf;
use crate::underside::outline_on_plane;
use crate::views::Views;
use glamx::DVec3;
use sms_core::{Aabb, BACKGROUND, Entity, EntityKind, EntityShape, Mesh, PointCloud};

/// Environment surface this near to an object's own surface is the object, bled over its mask's edge, metres.
const CLEARANCE: f64 = 0.008;
/// Connected surface smaller than this is noise, m².
const MIN_AREA: f64 = 4e-4;
/// Largest error of decimation, metres.
const DECIMATION_ERROR: f64 = 0.002;

/// The static environment near the objects as an open mesh that faces free space, without the support plane (a half
/// space stands for it), and with flat patches under the objects that rest on it, where no camera could see.
/// `rests[i]` is what object `i` rests on. `None` where nothing but the support plane was seen.
pub(crate) fn environment_entity(
    views: &Views,
    objects: &[Entity],
    rests: &[(u16, Rest)],
    support_height: Option<f64>,
    config: &EntitiesConfig,
) -> Option<Entity> {
    let settings = &config.environment;
    let corners = objects.iter().filter_map(|e| e.mesh.aabb()).flat_map(|b| [b.min, b.max]);
    let region = Aabb::of_points(corners).unwrap_or(Aabb { min: DVec3::ZERO, max: DVec3::ZERO });
    let reach = DVec3::splat(settings.reach);
    let region = Aabb { min: region.min - reach, max: region.max + reach };
    let floor = support_height.unwrap_or(f64::NEG_INFINITY);
    let is_floor = |p: DVec3| p.z < floor + settings.floor_band;
    let tsdf = Tsdf::fuse(views, &region, settings.voxel, is_floor);
    let mut mesh = tsdf.surface();
    smooth_open(&mut mesh, 0.5 * settings.voxel);
    let own: Vec<DVec3> = objects.iter().flat_map(|e| e.cloud.points_w.iter().copied()).collect();
    let own = PointGrid::new(&own, CLEARANCE);
    let patches: Vec<(Vec<DVec3>, Plane)> = objects
        .iter()
        .filter_map(|e| {
            let rest = rests.iter().find(|r| r.0 == e.label)?.1;
            let outline = outline_on_plane(&e.mesh.vertices, &rest.plane, 0.01, CLEARANCE + 0.006);
            (rest.carrier == Carrier::Environment && outline.len() >= 3).then_some((outline, rest.plane))
        })
        .collect();
    let triangles = std::mem::take(&mut mesh.triangles);
    mesh.triangles = triangles
        .into_iter()
        .filter(|t| {
            let corners = t.map(|v| mesh.vertices[v as usize]);
            let center = corners.iter().sum::<DVec3>() / 3.0;
            let replaced = patches.iter().any(|(outline, plane)| {
                plane.height_over(center).abs() < 0.012 && is_over(outline, plane, center)
            });
            let mut near_object = false;
            own.for_each_within(center, CLEARANCE, |_, _| near_object = true);
            !corners.iter().all(|&p| is_floor(p)) && !replaced && !near_object
        })
        .collect();
    let mut out = Mesh::default();
    for part in mesh.components() {
        if part.area() > MIN_AREA {
            append(&mut out, &part);
        }
    }
    let mut mesh = refine::simplify(&out, settings.face_budget, DECIMATION_ERROR);
    for (outline, _) in &patches {
        let fan = (1..outline.len() - 1).map(|k| [0, k as u32, k as u32 + 1]).collect();
        append(&mut mesh, &Mesh::new(outline.clone(), fan));
    }
    if mesh.triangles.is_empty() {
        return None;
    }
    let cloud = background_cloud(views, &mesh, settings.voxel);
    mesh.colors = refine::colors_from(&cloud.points_w, &cloud.colors, &mesh, 2.0 * settings.voxel);
    let stride = cloud.points_w.len().div_ceil(500).max(1);
    let sample: Vec<DVec3> = cloud.points_w.iter().copied().step_by(stride).collect();
    let residual_m = crate::grid::median(crate::mesher::distances(&sample, &mesh));
    Some(Entity {
        label: BACKGROUND,
        name: "environment".into(),
        description: String::new(),
        kind: EntityKind::Static,
        shape: EntityShape::TriMesh,
        observed_share: crate::mesher::observed_share(&mesh, &cloud, 3.0 * settings.voxel),
        mean_color: crate::cloud::mean_color(&cloud.colors),
        cloud,
        mesh,
        parts: Vec::new(),
        residual_m,
    })
}

fn append(mesh: &mut Mesh, part: &Mesh) {
    let offset = mesh.vertices.len() as u32;
    mesh.vertices.extend_from_slice(&part.vertices);
    mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + offset)));
}

/// Whether `p` lies over the convex outline, seen along the plane's normal.
fn is_over(outline: &[DVec3], plane: &Plane, p: DVec3) -> bool {
    (0..outline.len()).all(|i| {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        (b - a).cross(p - a).dot(plane.normal) >= 0.0
    })
}

/// Taubin smoothing that leaves the rim of an open mesh where it is.
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
    refine::taubin(mesh, &rim, 6, limit);
}

/// Unlabelled measured points on the mesh, thinned, with colours.
fn background_cloud(views: &Views, mesh: &Mesh, voxel: f64) -> PointCloud {
    let Some(bounds) = mesh.aabb() else { return PointCloud::default() };
    let mut taken = std::collections::BTreeSet::new();
    let mut cloud = PointCloud::default();
    let (low, high) = (bounds.min - DVec3::splat(voxel), bounds.max + DVec3::splat(voxel));
    for (f, frame) in views.sequence.frames.iter().enumerate() {
        let map = &views.labels.maps[f];
        for (i, &label) in map.data.iter().enumerate() {
            let (x, y) = (i % map.width, i / map.width);
            let depth = f64::from(frame.depth.data[i]);
            let n = frame.normal_c.data[i].map(f64::from);
            if label != BACKGROUND || depth <= 0.0 || n == [0.0; 3] {
                continue;
            }
            let p = frame.camera.unproject_pixel(x, y, depth);
            if p.cmplt(low).any() || p.cmpgt(high).any() {
                continue;
            }
            if taken.insert((p / (1.5 * voxel)).floor().to_array().map(|v| v as i64)) {
                cloud.points_w.push(p);
                cloud.normals_w.push(frame.camera.x_wc.rotation * DVec3::from_array(n));
                cloud.colors.push(frame.color.data[i]);
            }
        }
    }
    // The plane itself, and what was cut away, are not on the mesh.
    let centers: Vec<DVec3> =
        (0..mesh.triangles.len()).map(|t| mesh.corners(t).iter().sum::<DVec3>() / 3.0).collect();
    let mut on_mesh: Vec<DVec3> = mesh.vertices.clone();
    on_mesh.extend(centers);
    let grid = PointGrid::new(&on_mesh, 4.0 * voxel);
    let keep: Vec<bool> = cloud
        .points_w
        .iter()
        .map(|&p| {
            let mut near = false;
            grid.for_each_within(p, 4.0 * voxel, |_, _| near = true);
            near
        })
        .collect();
    crate::cloud::retain(&mut cloud, &keep);
    cloud
}
