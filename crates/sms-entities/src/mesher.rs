//! From an oriented cloud with its contact points to a closed mesh (paper, Section "Materialize").

use crate::config::{EntitiesConfig, MeshRule};
use crate::hollow::hidden_inside;
use crate::views::Views;
use glamx::DVec3;
use sms_core::{Mesh, PointCloud, polyhedron_mass_properties};
use sms_mesh::{
    Plane, PointGrid, convex_hull, decimate, taubin,
    tetra::{self, NONE, Tetrahedralization, delaunay},
};

/// The way a mesh was obtained; later variants are fallbacks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum MeshPath {
    /// The configured rule.
    Asked,
    /// The prune rule, because the vote gave no usable mesh.
    Prune,
    /// The convex hull, because neither rule gave a usable mesh.
    Hull,
}

/// Weight of the cut's faces against the votes. Each of the four corners has at most one vote.
const STIFFNESS: f64 = 0.7;
/// Vote against a tetrahedron for each camera that sees through its centre.
const FREE_VOTE: f64 = 1.5;
/// Largest number of cameras that vote against a tetrahedron.
const FREE_MOST: usize = 4;

/// Surface points of an object: seen points, and the contact points that close the surface.
pub(crate) struct MeshInput<'a> {
    /// Seen points.
    pub(crate) cloud: &'a PointCloud,
    /// Points on the resting plane.
    pub(crate) contact: &'a [DVec3],
    pub(crate) rest: Plane,
    /// Frames for free-space votes.
    pub(crate) views: Option<&'a Views<'a>>,
    /// Distance between neighbouring points, metres.
    pub(crate) spacing: f64,
}

/// A closed mesh with positive volume; `None` when the points lie in one plane.
pub(crate) fn mesh_object(input: &MeshInput, config: &EntitiesConfig) -> Option<(Mesh, MeshPath)> {
    let first = mesh_with(input, &[], config)?;
    if config.mesh != MeshRule::Vote || first.1 != MeshPath::Asked {
        return Some(first);
    }
    let hollowed = hidden_inside(input, &first.0)
        .and_then(|inside| mesh_with(input, &inside, config))
        .filter(|m| m.1 == MeshPath::Asked);
    hollowed.or(Some(first))
}

/// Like [`mesh_object`], with additional points and normals on the unseen inside of a hollow.
fn mesh_with(
    input: &MeshInput,
    inside: &[(DVec3, DVec3)],
    config: &EntitiesConfig,
) -> Option<(Mesh, MeshPath)> {
    let mut points = input.cloud.points_w.clone();
    let mut normals = input.cloud.normals_w.clone();
    points.extend_from_slice(input.contact);
    normals.extend(std::iter::repeat_n(-input.rest.normal, input.contact.len()));
    points.extend(inside.iter().map(|(p, _)| p));
    normals.extend(inside.iter().map(|(_, n)| n));
    let tetrahedra = delaunay(&points);
    let hull = convex_hull(&points, usize::MAX, 0.0)?;
    let usable = |mesh: &Mesh| {
        mesh.is_closed_oriented()
            && mesh.volume() > 0.02 * hull.volume()
            // An outlier a million metres away makes a needle. Its inertia is lost in rounding.
            && polyhedron_mass_properties(mesh, 1.0).is_ok_and(|m| is_wide(m.inertia()))
    };
    let other = if config.mesh == MeshRule::Vote { MeshRule::Prune } else { MeshRule::Vote };
    for (rule, path) in [(config.mesh, MeshPath::Asked), (other, MeshPath::Prune)] {
        let chosen = match rule {
            MeshRule::Vote => vote(&tetrahedra, &normals, input),
            MeshRule::Prune => {
                tetra::prune(&tetrahedra, config.prune_length, config.prune_factor, config.prune_neighbors)
            }
        };
        let chosen = tetra::largest_component(&tetrahedra, &chosen);
        if !chosen.contains(&true) {
            continue;
        }
        let mesh = finish(&tetrahedra, &chosen, input, config);
        if usable(&mesh) {
            return Some((mesh, path));
        }
    }
    let mesh = rest_on(within_budget(&hull, config), &input.rest, CONTACT_BAND);
    usable(&mesh).then_some((mesh, MeshPath::Hull))
}

/// Returns whether the second moment along the narrowest side of a body is above rounding errors. The moment is a
/// difference of numbers as large as the moment of the widest side.
fn is_wide(inertia: glamx::DMat3) -> bool {
    let moments = glamx::DSymmetricEigen3::new(inertia).eigenvalues;
    moments.element_sum() - 2.0 * moments.max_element() > 1e-9 * moments.max_element()
}

fn vote(tetrahedra: &Tetrahedralization, normals: &[DVec3], input: &MeshInput) -> Vec<bool> {
    let mut votes = tetra::normal_votes(tetrahedra, normals);
    if let Some(views) = input.views {
        let middle = |t: usize| tetrahedra.corners(t).iter().sum::<DVec3>() / 4.0;
        let middles: Vec<DVec3> = (0..votes.len()).map(middle).collect();
        for (vote, free) in votes.iter_mut().zip(views.free_counts(&middles, FREE_MOST + 1)) {
            if free >= views.enough_frames() {
                *vote -= FREE_VOTE * free.min(FREE_MOST) as f64;
            }
        }
    }
    tetra::cut(tetrahedra, &votes, STIFFNESS, 0.5 * input.spacing * input.spacing)
}

/// Vertices this close to the resting plane become the foot, metres.
const CONTACT_BAND: f64 = 0.002;

fn finish(
    tetrahedra: &Tetrahedralization,
    inside: &[bool],
    input: &MeshInput,
    config: &EntitiesConfig,
) -> Mesh {
    let (mut mesh, source) = tetra::boundary(tetrahedra, inside);
    let seen = input.cloud.points_w.len() as u32;
    let fixed: Vec<bool> = source.iter().map(|&s| s != NONE && s >= seen).collect();
    taubin(&mut mesh, &fixed, config.smoothing_iterations, 0.4 * input.spacing);
    let mesh = rest_on(mesh, &input.rest, CONTACT_BAND);
    let mut small = within_budget(&mesh, config);
    keep_volume(&mut small, mesh.volume());
    // The foot is flat except for rounding and the correction of the volume.
    let mesh = rest_on(small, &input.rest, 3e-4);
    let parts = mesh.components();
    // Splitting may separate sheets that only touched; the solid with the largest volume is the object.
    parts.into_iter().max_by(|a, b| a.volume().total_cmp(&b.volume())).unwrap_or(mesh)
}

/// Moves the surface evenly outwards until it encloses `volume`. Chords of a round shape lie inside it, so a mesh of
/// 2000 faces loses half a percent of volume.
fn keep_volume(mesh: &mut Mesh, volume: f64) {
    let (area, lost) = (mesh.area(), volume - mesh.volume());
    if !(area > 0.0 && lost.abs() < 0.05 * volume) {
        return;
    }
    let normals = mesh.vertex_normals();
    for (v, n) in mesh.vertices.iter_mut().zip(normals) {
        *v += n * (lost / area);
    }
}

/// Returns the mesh with at most the wanted number of faces, unless decimation would move its surface by more than a
/// twentieth of its size.
fn within_budget(mesh: &Mesh, config: &EntitiesConfig) -> Mesh {
    let size = mesh.aabb().map_or(0.0, |b| b.extents().max_element());
    decimate(mesh, config.face_budget, 0.05 * size)
}

/// Moves every vertex below the plane, or less than `band` above it, onto the plane. The body then has a flat foot and
/// overlaps nothing.
pub(crate) fn rest_on(mut mesh: Mesh, plane: &Plane, band: f64) -> Mesh {
    for v in &mut mesh.vertices {
        if plane.height(*v) < band {
            *v = plane.project(*v);
        }
    }
    mesh
}

/// Returns the share of the mesh's area with a seen point of similar normal within `reach`.
pub(crate) fn observed_share(mesh: &Mesh, cloud: &PointCloud, reach: f64) -> f64 {
    let grid = PointGrid::new(&cloud.points_w, reach);
    let (mut seen, mut total) = (0.0, 0.0);
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t);
        let cross = (b - a).cross(c - a);
        let (area, normal) = (0.5 * cross.length(), cross.normalize_or_zero());
        // Large faces of a decimated mesh may be seen only partly: four samples each.
        let middle = (a + b + c) / 3.0;
        for p in [middle, (middle + a) * 0.5, (middle + b) * 0.5, (middle + c) * 0.5] {
            let mut near = false;
            grid.for_each_within(p, reach, |i, _| near |= cloud.normals_w[i].dot(normal) > 0.3);
            total += area * 0.25;
            if near {
                seen += area * 0.25;
            }
        }
    }
    if total > 0.0 { seen / total } else { 0.0 }
}
