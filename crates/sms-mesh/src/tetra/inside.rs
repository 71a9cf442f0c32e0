//! Inside rules: selection of the tetrahedra that form the solid.

use crate::point_grid::PointGrid;
use crate::predicates::FACES;
use crate::statistics::median;
use crate::tetra::delaunay::{NONE, Tetrahedralization};
use crate::tetra::maxflow::FlowNetwork;
use glamx::DVec3;

/// Returns the tetrahedra that the paper's rule keeps: those without an edge longer than `length`. The adaptive limit
/// is `factor` times the local feature size of the corners (their mean distance to `k` neighbours, as in the released
/// code).
pub fn prune(mesh: &Tetrahedralization, length: Option<f64>, factor: f64, k: usize) -> Vec<bool> {
    let feature: Vec<f64> = match length {
        Some(_) => Vec::new(),
        None => {
            let cell = typical_edge(mesh).max(1e-6);
            let grid = PointGrid::new(&mesh.points, cell);
            mesh.points
                .iter()
                .map(|&p| {
                    let near = grid.nearest_k(p, k + 1);
                    let others = near.len().saturating_sub(1).max(1) as f64;
                    near.iter().map(|n| n.0.sqrt()).sum::<f64>() / others
                })
                .collect()
        }
    };
    let inside = (0..mesh.tetrahedra.len())
        .map(|t| {
            let corners = mesh.corners(t);
            let longest = (0..4)
                .flat_map(|i| (0..i).map(move |j| (i, j)))
                .map(|(i, j)| corners[i].distance(corners[j]))
                .fold(0.0, f64::max);
            let limit = length.unwrap_or_else(|| {
                factor * mesh.tetrahedra[t].iter().map(|&v| feature[v as usize]).sum::<f64>() / 4.0
            });
            longest <= limit
        })
        .collect();
    fill_voids(mesh, inside)
}

/// Returns the median edge length.
fn typical_edge(mesh: &Tetrahedralization) -> f64 {
    let stride = mesh.tetrahedra.len().div_ceil(5000).max(1);
    let edges = (0..mesh.tetrahedra.len()).step_by(stride).map(|t| {
        let [a, b, ..] = mesh.corners(t);
        a.distance(b)
    });
    median(edges.collect())
}

/// Returns the sum of the votes of each tetrahedron's corners. A corner's vote is +1 if its normal points straight away
/// from the circumcentre, and −1 if it points straight at it. On a dense sample of a surface, inner circumcentres lie
/// on the medial axis behind the surface and outer ones in front of it (Amenta and Bern 1999, poles).
pub fn normal_votes(mesh: &Tetrahedralization, normals: &[DVec3]) -> Vec<f64> {
    (0..mesh.tetrahedra.len())
        .map(|t| {
            let corners = mesh.corners(t);
            let Some(center) = mesh.circumcenter(t) else { return 0.0 };
            (0..4)
                .map(|k| {
                    let outward = normals[mesh.tetrahedra[t][k] as usize];
                    -outward.dot((center - corners[k]).normalize_or_zero())
                })
                .sum()
        })
        .collect()
}

/// Cost of area beyond that of a sampled face, as a share of the stiffness. Such large faces lie where nothing was
/// seen.
const LARGE_FACE: f64 = 0.1;

/// Reconciles votes (positive: inside) by a minimum cut. Separating two neighbours costs `stiffness` times the area of
/// their face in units of `area`, at most `stiffness`.
pub fn cut(mesh: &Tetrahedralization, votes: &[f64], stiffness: f64, area: f64) -> Vec<bool> {
    const UNIT: f64 = 10_000.0;
    let mut network = FlowNetwork::new(mesh.tetrahedra.len());
    for (t, &vote) in votes.iter().enumerate() {
        let mut gain = vote;
        let corners = mesh.corners(t);
        for face in 0..4 {
            let [a, b, c] = FACES[face].map(|k| corners[k]);
            let size = 0.5 * (b - a).cross(c - a).length() / area;
            let cost = stiffness * (0.2 + 0.8 * size.min(1.0) + LARGE_FACE * (size - 1.0).clamp(0.0, 20.0));
            match mesh.neighbors[t][face] {
                // Beyond the hull is outside.
                NONE => gain -= 0.3 * cost,
                next if next as usize > t => network.link(t, next as usize, (cost * UNIT) as i64),
                _ => {}
            }
        }
        network.terminal(t, (gain * UNIT) as i64);
    }
    fill_voids(mesh, network.source_side())
}

/// Marks everything that cannot be reached from the outside as inside.
fn fill_voids(mesh: &Tetrahedralization, inside: Vec<bool>) -> Vec<bool> {
    let mut reached = vec![false; inside.len()];
    let mut stack: Vec<usize> =
        (0..inside.len()).filter(|&t| !inside[t] && mesh.neighbors[t].contains(&NONE)).collect();
    for &t in &stack {
        reached[t] = true;
    }
    while let Some(t) = stack.pop() {
        for &next in &mesh.neighbors[t] {
            let next = next as usize;
            if next != NONE as usize && !inside[next] && !reached[next] {
                reached[next] = true;
                stack.push(next);
            }
        }
    }
    reached.into_iter().map(|r| !r).collect()
}

/// Keeps the inside component (connected through faces) with the largest volume.
pub fn largest_component(mesh: &Tetrahedralization, inside: &[bool]) -> Vec<bool> {
    let mut component = vec![NONE; inside.len()];
    let mut best = (0.0, NONE);
    let mut count = 0;
    for start in 0..inside.len() {
        if !inside[start] || component[start] != NONE {
            continue;
        }
        let mut stack = vec![start];
        component[start] = count;
        let mut volume = 0.0;
        while let Some(t) = stack.pop() {
            volume += mesh.volume(t);
            for &next in &mesh.neighbors[t] {
                let next = next as usize;
                if next != NONE as usize && inside[next] && component[next] == NONE {
                    component[next] = count;
                    stack.push(next);
                }
            }
        }
        if volume > best.0 {
            best = (volume, count);
        }
        count += 1;
    }
    component.iter().map(|&c| c != NONE && c == best.1).collect()
}
