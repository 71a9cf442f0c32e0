//! Hollows with an unseen floor.
//!
//! Cameras look into a mug at a slant: they see its inner wall down to some depth and nothing below. Closing the mesh
//! there fills the rest, and an empty mug weighs twice as much as it should. The hollow is continued down to a floor as
//! thick as the walls if the object has thin walls, if cameras look into it, and if no surface was seen at the end of
//! their view.

use crate::mesher::MeshInput;
use crate::views::Views;
use glamx::{DPose3, DVec3};
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::TriMesh;
use sms_core::Mesh;
use sms_mesh::{PointGrid, median};

/// Least and largest thickness of a thin wall, metres.
const WALL_M: [f64; 2] = [0.001, 0.01];
/// Largest thickness of a thin wall as a share of the object's size.
const WALL_SHARE: f64 = 0.12;
/// Share of the seen surface that must have a thin wall behind it.
const THIN_SHARE: f64 = 0.35;
/// A column of the mesh above the contact area may be filled only because it was not seen if it is higher than this
/// number of wall thicknesses.
const COLUMN_WALLS: f64 = 2.5;
/// Heights above the top of a column at which free space is tested, metres.
const LOOK_ABOVE_M: [f64; 3] = [0.005, 0.009, 0.014];
/// Least number of columns of a hollow.
const FEWEST: usize = 6;
/// Share of these columns above which cameras must see free space.
const LOOKED_INTO: f64 = 0.3;

/// Returns the unseen floor of a hollow of `mesh`, which was made from `input`, and the unseen part of its walls, as
/// points with normals into the hollow. The wall points are the seen outside, moved inwards by the thickness of the
/// wall. Returns `None` if the object is not hollow, or its hollow was seen to the floor.
pub(crate) fn hidden_inside(input: &MeshInput, mesh: &Mesh) -> Option<Vec<(DVec3, DVec3)>> {
    let views = input.views?;
    let solid = TriMesh::new(mesh.vertices.clone(), mesh.triangles.clone()).ok()?;
    let wall = wall_thickness(input, mesh, &solid)?;
    let plane = &input.rest;
    let up = plane.normal;
    let reach = 2.5 * input.spacing;
    let seen = PointGrid::new(&input.cloud.points_w, reach);
    // Columns above the contact area that end in unseen material.
    let columns: Vec<(DVec3, f64)> = input
        .contact
        .iter()
        .filter_map(|&q| {
            let height = exit(&solid, q + up * 1e-4, up)?;
            (height > COLUMN_WALLS * wall && !seen.is_near(q + up * height, reach)).then_some((q, height))
        })
        .collect();
    let looked_into = columns.iter().filter(|(q, h)| is_looked_into(views, *q + up * *h, up)).count();
    if looked_into < FEWEST || (looked_into as f64) < LOOKED_INTO * columns.len() as f64 {
        return None;
    }
    let mut inside: Vec<(DVec3, DVec3)> = columns.iter().map(|(q, _)| (*q + up * wall, up)).collect();
    // The columns end at this height; the seen part of the wall begins there.
    let end = median(columns.iter().map(|c| c.1).collect());
    for (&p, &n) in input.cloud.points_w.iter().zip(&input.cloud.normals_w) {
        let height = plane.height(p);
        let deep = || exit(&solid, p - n * (0.5 * wall), -n).is_some_and(|d| d > COLUMN_WALLS * wall);
        if height > wall && height < end && n.dot(up).abs() < 0.8 && deep() {
            inside.push((p - n * wall, -n));
        }
    }
    Some(inside)
}

/// Returns the distance at which a ray from inside leaves the solid, metres.
fn exit(solid: &TriMesh, origin: DVec3, direction: DVec3) -> Option<f64> {
    solid.cast_ray(&DPose3::IDENTITY, &Ray::new(origin, direction), 10.0, false)
}

/// Returns the median thickness of the walls behind the seen surface, or `None` if most of it has no thin wall.
fn wall_thickness(input: &MeshInput, mesh: &Mesh, solid: &TriMesh) -> Option<f64> {
    let size = mesh.aabb()?.extents().max_element();
    let limit = WALL_M[1].min(WALL_SHARE * size);
    let cloud = input.cloud;
    let stride = cloud.points_w.len().div_ceil(800).max(1);
    let (mut thin, mut cast) = (Vec::new(), 0usize);
    for i in (0..cloud.points_w.len()).step_by(stride) {
        let inward = -cloud.normals_w[i];
        // The ray starts slightly in front of the surface and passes through both sides of the wall.
        let start = cloud.points_w[i] - inward * 0.002;
        let Some(first) = exit(solid, start, inward).filter(|&d| d < 0.005) else { continue };
        let Some(second) = exit(solid, start + inward * (first + 1e-5), inward) else { continue };
        cast += 1;
        if second <= limit {
            thin.push(second);
        }
    }
    let enough = cast >= 50 && thin.len() as f64 >= THIN_SHARE * cast as f64;
    enough.then(|| median(thin).max(WALL_M[0]))
}

/// Returns whether cameras see through the space just above a point.
fn is_looked_into(views: &Views, top: DVec3, up: DVec3) -> bool {
    LOOK_ABOVE_M.iter().any(|&h| views.free_count(top + up * h, 2) >= 2)
}
