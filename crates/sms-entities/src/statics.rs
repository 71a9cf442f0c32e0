//! Surface that does not move: the environment, and bodies that are kept fixed. They are open meshes of the fused surface: they need no
//! volume, and a solid would guess the sides that nobody saw.

use crate::draft::SceneInputs;
use crate::fused::SurfacePoint;
use crate::support::{Carrier, RestingPlane};
use crate::views::Views;
use glamx::DVec3;
use sms_core::{Aabb, BACKGROUND, Entity, EntityKind, Mesh};
use sms_mesh::outline::{is_over, outline_on_plane};
use sms_mesh::{Plane, PointGrid, convex_hull, simplify, taubin, triangulate};
use std::collections::BTreeMap;

/// Static surface that continues the surface of a movable object closer than this belongs to the object (its mask ends too early),
/// metres.
const CLEARANCE: f64 = 0.008;
/// Least cosine between the normals of surfaces that continue each other. A carrier's surface beside an object faces elsewhere.
const CONTINUES: f64 = 0.5;
/// Measured surface this close to the plane under an object is replaced by the plane, metres.
const PATCH_BAND: f64 = 0.012;
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
/// Decimation errors, tried in this order until the face budget is met, metres. They add up.
const DECIMATION_ERRORS: [f64; 3] = [0.002, 0.004, 0.008];
/// Least number of faces that a mesh is decimated to.
const FEWEST_FACES: usize = 12;

/// Returns the open meshes of the fused surface that does not move, by the label of the fixed body; those of [`BACKGROUND`] are the
/// environment near the objects. Meshes face free space. They leave out the support plane (a half space replaces it) and have
/// flat patches under the movable objects that rest on them, where no camera could see. `rests` holds the support of each object
/// by its label.
pub(crate) fn static_meshes(
    scene: SceneInputs<'_>,
    objects: &[Entity],
    rests: &[(u16, RestingPlane)],
    fused: &[SurfacePoint],
) -> BTreeMap<u16, Mesh> {
    let SceneInputs { views, support_height, config, .. } = scene;
    let settings = &config.environment;
    let corners = objects.iter().filter_map(|e| e.mesh.aabb()).flat_map(|b| [b.min, b.max]);
    let region = Aabb::of_points(corners).unwrap_or(Aabb { min: DVec3::ZERO, max: DVec3::ZERO });
    let (low, high) = (region.min - settings.reach, region.max + settings.reach);
    let patches: Vec<Patch> = objects.iter().filter_map(|e| Patch::under(e, objects, rests)).collect();
    let mut points: Vec<SurfacePoint> =
        patches.iter().flat_map(|patch| patch.hidden_points(settings.spacing, views)).collect();
    let patched = points.len();
    let patch_w: Vec<DVec3> = points.iter().map(|p| p.p_w).collect();
    let patch_grid = PointGrid::new(&patch_w, settings.spacing);
    let is_patched = |p: DVec3| {
        let mut near = patches.iter().filter(|patch| patch.takes_place_of(p));
        near.any(|patch| patch_grid.is_near(patch.plane.project(p), settings.spacing))
    };
    let movable = objects.iter().filter(|e| e.kind == EntityKind::Dynamic);
    let (own_w, own_normals_w): (Vec<DVec3>, Vec<DVec3>) = movable.flat_map(oriented_points).unzip();
    let own_grid = PointGrid::new(&own_w, CLEARANCE);
    let is_own = |point: &SurfacePoint| {
        let mut is_own = false;
        let continues = |i: usize| own_normals_w[i].dot(point.n_w) > CONTINUES;
        own_grid.for_each_within(point.p_w, CLEARANCE, |i, _| is_own |= continues(i));
        is_own
    };
    for point in fused {
        let Some(label) = owner(point.label, objects) else { continue };
        let is_inside = label != BACKGROUND || (point.p_w.cmpge(low).all() && point.p_w.cmple(high).all());
        if is_inside && !is_patched(point.p_w) && !is_own(point) {
            points.push(SurfacePoint { label, ..*point });
        }
    }
    let at = |of: fn(&SurfacePoint) -> DVec3| points.iter().map(of).collect::<Vec<DVec3>>();
    let spacings: Vec<f64> = points.iter().map(|p| p.spacing_m).collect();
    let triangles = triangulate(&at(|p| p.p_w), &at(|p| p.n_w), &spacings);
    let mut mesh = Mesh::new(at(|p| p.p_w), triangles);
    smooth_open(&mut mesh, patched, 0.5 * settings.spacing);
    let floor = support_height.unwrap_or(f64::NEG_INFINITY);
    let is_floor =
        |v: u32| v as usize >= patched && mesh.vertices[v as usize].z < floor + settings.floor_band;
    let mut of_label: BTreeMap<u16, Vec<[u32; 3]>> = BTreeMap::new();
    for &triangle in mesh.triangles.iter().filter(|t| !t.iter().all(|&v| is_floor(v))) {
        let [a, b, c] = triangle.map(|v| points[v as usize].label);
        of_label.entry(if b == c { b } else { a }).or_default().push(triangle);
    }
    let hulls: Vec<Mesh> = objects
        .iter()
        .filter(|e| e.kind == EntityKind::Dynamic)
        .filter_map(|e| convex_hull(&e.mesh.vertices, HULL_VERTICES, 0.5 * CLEARANCE))
        .collect();
    // Surface without a label may be noise, or belong to a movable object that its mask lacks.
    let is_kept = |part: &Mesh| {
        let is_real = part.area() > MIN_AREA && !hulls.iter().any(|hull| hangs_inside(part, hull, floor));
        is_real || part.vertices.iter().any(|&v| patch_grid.is_near(v, 0.0))
    };
    let mut meshes: BTreeMap<u16, Mesh> = BTreeMap::new();
    for (label, triangles) in of_label {
        let mut whole = Mesh::default();
        let parts = Mesh::new(mesh.vertices.clone(), triangles).components();
        let kept = parts.iter().filter(|part| label != BACKGROUND || is_kept(part));
        kept.for_each(|part| append(&mut whole, part));
        if !whole.triangles.is_empty() {
            meshes.insert(label, whole);
        }
    }
    // One budget, by area: engines that know only convex shapes have one for each face.
    let area: f64 = meshes.values().map(Mesh::area).sum();
    for mesh in meshes.values_mut() {
        let budget = (settings.face_budget as f64 * mesh.area() / area) as usize;
        *mesh = within_faces(std::mem::take(mesh), budget.max(FEWEST_FACES));
    }
    meshes
}

/// Returns the label of the mesh that surface with this label is part of; `None` if it moves.
fn owner(label: u16, objects: &[Entity]) -> Option<u16> {
    match objects.iter().find(|e| e.label == label) {
        Some(object) => (object.kind == EntityKind::Static).then_some(label),
        None => Some(BACKGROUND),
    }
}

/// A part of the plane under a movable object, where its carrier is hidden.
struct Patch {
    outline: Vec<DVec3>,
    plane: Plane,
    /// Label of the carrier's mesh.
    label: u16,
}

impl Patch {
    /// Returns the patch under an object that rests on static surface; `None` under others.
    fn under(object: &Entity, objects: &[Entity], rests: &[(u16, RestingPlane)]) -> Option<Self> {
        let RestingPlane { plane, carrier, .. } = rests.iter().find(|r| r.0 == object.label)?.1;
        let label = match carrier {
            Carrier::Environment => BACKGROUND,
            Carrier::Object(label) => owner(label, objects)?,
            Carrier::Floor | Carrier::Unseen => return None,
        };
        let outline = outline_on_plane(&object.mesh.vertices, &plane, 0.01, CLEARANCE + 0.006);
        let is_patch = object.kind == EntityKind::Dynamic && outline.len() >= 3;
        is_patch.then_some(Self { outline, plane, label })
    }

    /// Returns whether the patch would take the place of the measured surface at `p`.
    fn takes_place_of(&self, p: DVec3) -> bool {
        self.plane.height(p).abs() < PATCH_BAND && is_over(&self.outline, &self.plane, p)
    }

    /// Returns points of the patch about `spacing` apart, without those that cameras see through.
    fn hidden_points(&self, spacing: f64, views: &Views<'_>) -> Vec<SurfacePoint> {
        let normal = self.plane.normal;
        let u = normal.any_orthonormal_vector();
        let v = normal.cross(u);
        let flat = self.outline.iter().map(|p| DVec3::new(p.dot(u), p.dot(v), 0.0));
        let Some(Aabb { min, max }) = Aabb::of_points(flat) else { return Vec::new() };
        // Rows of equilateral triangles: in a square lattice, the Delaunay triangulation is not unique.
        let height = spacing * 0.75f64.sqrt();
        let rows = 0..=((max.y - min.y) / height) as usize;
        let columns = 0..=((max.x - min.x) / spacing) as usize + 1;
        let places = rows.flat_map(|row| columns.clone().map(move |column| (row, column)));
        let points = places.map(|(row, column)| {
            let x = min.x + spacing * (column as f64 - 0.5 * (row % 2) as f64);
            u * x + v * (min.y + height * row as f64) + normal * self.plane.offset
        });
        let points: Vec<DVec3> = points.filter(|&p_w| is_over(&self.outline, &self.plane, p_w)).collect();
        let enough = views.enough_frames();
        let free = views.free_counts(&points, enough);
        let hidden = points.into_iter().zip(free).filter(|(_, free)| *free < enough);
        let point = |p_w: DVec3| SurfacePoint { p_w, n_w: normal, spacing_m: spacing, label: self.label };
        hidden.map(|(p_w, _)| point(p_w)).collect()
    }
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

/// Returns the open mesh with at most `budget` faces if the decimation errors allow it.
fn within_faces(mesh: Mesh, budget: usize) -> Mesh {
    DECIMATION_ERRORS.iter().fold(mesh, |mesh, &error_m| {
        if mesh.triangles.len() > budget { simplify(&mesh, budget, error_m) } else { mesh }
    })
}

/// Taubin smoothing that moves neither the boundary of an open mesh nor its first `fixed` vertices.
fn smooth_open(mesh: &mut Mesh, fixed: usize, limit: f64) {
    let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for &[a, b, c] in &mesh.triangles {
        for (i, j) in [(a, b), (b, c), (c, a)] {
            *edges.entry((i.min(j), i.max(j))).or_default() += if i < j { 1 } else { -1 };
        }
    }
    let mut stays: Vec<bool> = (0..mesh.vertices.len()).map(|v| v < fixed).collect();
    for ((a, b), count) in edges {
        if count != 0 {
            stays[a as usize] = true;
            stays[b as usize] = true;
        }
    }
    taubin(mesh, &stays, 6, limit);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::EntitiesConfig;
    use crate::fixtures::{entity, over_plate};
    use crate::fused::fused_surface;
    use crate::support::Surroundings;
    use glamx::DPose3;
    use sms_core::{Cancel, EntityShape, Seed};
    use sms_mesh::distances;

    /// The static meshes of a plate at z = 0 with a movable box of 10 cm on its middle, where every camera has this depth. The plate is a
    /// fixed body if it has a label.
    fn around_a_box(plate: u16, depth_below_m: f32) -> BTreeMap<u16, Mesh> {
        let (mut sequence, mut labels) = over_plate(4, 100);
        labels.maps.iter_mut().for_each(|map| map.data.fill(plate));
        for frame in &mut sequence.frames {
            for y in 43..57 {
                (43..57).for_each(|x| frame.depth[(x, y)] = depth_below_m);
            }
        }
        let views = Views::new(&sequence, &labels);
        let center = DPose3::from_translation(DVec3::new(0.0, 0.0, 0.05));
        let cube = Mesh::cuboid(DVec3::splat(0.05)).transformed(&center);
        let mut objects = vec![Entity { label: 2, ..entity("box", cube, EntityShape::Convex) }];
        if plate != BACKGROUND {
            let plate = entity("plate", Mesh::default(), EntityShape::TriMesh);
            objects.push(Entity { kind: EntityKind::Static, ..plate });
        }
        let carrier = if plate == BACKGROUND { Carrier::Environment } else { Carrier::Object(plate) };
        let rest = RestingPlane { plane: Plane::horizontal(0.0), carrier, noise_m: 0.0 };
        let config = EntitiesConfig::default();
        let around = Surroundings::default();
        let scene = SceneInputs { views: &views, around: &around, support_height: None, config: &config };
        let fused = fused_surface(&views, &config.environment, Seed(1), &Cancel::new()).unwrap();
        static_meshes(scene, &objects, &[(2, rest)], &fused)
    }

    #[test]
    fn the_hidden_surface_under_an_object_is_part_of_its_carrier() {
        for plate in [BACKGROUND, 1] {
            let meshes = around_a_box(plate, 0.0);
            assert_eq!(meshes.keys().collect::<Vec<_>>(), [&plate]);
            let under = [DVec3::ZERO, DVec3::new(0.06, 0.0, 0.0), DVec3::new(-0.3, 0.2, 0.0)];
            let off = distances(&under, &meshes[&plate]);
            assert!(off.iter().all(|d| *d < 1e-6), "{plate} {off:?}");
            let covered = meshes[&plate].area();
            assert!((0.94..1.01).contains(&covered), "{covered}");
        }
    }

    #[test]
    fn no_surface_is_assumed_where_cameras_see_through() {
        let meshes = around_a_box(1, 1.2);
        let off = distances(&[DVec3::ZERO], &meshes[&1])[0];
        assert!(off > 0.04, "{off}");
    }

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
