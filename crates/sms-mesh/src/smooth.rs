//! Smoothing, decimation of open meshes, colours.

use glamx::DVec3;
use sms_core::Mesh;

/// Taubin's λ|μ smoothing (1995) with umbrella weights. Vertices of `fixed` stay; no vertex moves farther than `limit`.
pub fn taubin(mesh: &mut Mesh, fixed: &[bool], iterations: usize, limit: f64) {
    const LAMBDA: f64 = 0.5;
    const MU: f64 = -0.53;
    let start = mesh.vertices.clone();
    for _ in 0..iterations {
        for factor in [LAMBDA, MU] {
            let mut sum = vec![DVec3::ZERO; mesh.vertices.len()];
            let mut degree = vec![0.0f64; mesh.vertices.len()];
            for &[a, b, c] in &mesh.triangles {
                // On a closed mesh each neighbour occurs once as the end of an edge that starts here.
                for (i, j) in [(a, b), (b, c), (c, a)] {
                    sum[i as usize] += mesh.vertices[j as usize];
                    degree[i as usize] += 1.0;
                }
            }
            for v in 0..mesh.vertices.len() {
                if degree[v] > 0.0 && !fixed[v] {
                    let step = (sum[v] / degree[v] - mesh.vertices[v]) * factor;
                    mesh.vertices[v] += step;
                }
            }
        }
    }
    for (v, &p) in start.iter().enumerate() {
        mesh.vertices[v] = p + (mesh.vertices[v] - p).clamp_length_max(limit);
    }
}

/// Simplifies an open mesh (crate `meshopt`): quadric collapses down to `target` faces that move the surface by at most
/// `max_error` metres.
pub fn simplify(mesh: &Mesh, target: usize, max_error: f64) -> Mesh {
    let Some(bounds) = mesh.aabb() else { return mesh.clone() };
    // Single precision is sufficient once the mesh is near the origin. Vertices of different sheets at one place would
    // be welded: an offset of a micrometre keeps them apart.
    let mut order: Vec<usize> = (0..mesh.vertices.len()).collect();
    let key = |i: usize| mesh.vertices[i].to_array();
    order.sort_by(|&a, &b| key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal).then(a.cmp(&b)));
    let mut positions = vec![[0.0f32; 3]; mesh.vertices.len()];
    let mut twins = 0;
    for (n, &i) in order.iter().enumerate() {
        twins = if n > 0 && key(order[n - 1]) == key(i) { twins + 1 } else { 0 };
        let apart = DVec3::splat(1e-6 * f64::from(twins));
        positions[i] = (mesh.vertices[i] + apart - bounds.center()).as_vec3().to_array();
    }
    let triangles = collapsed(&mesh.triangles, &positions, target, max_error);
    Mesh { vertices: mesh.vertices.clone(), triangles, colors: mesh.colors.clone() }.compacted()
}

/// Returns the triangles left by quadric collapses (crate `meshopt`) down to `target` faces that move the surface by at
/// most `max_error`.
pub(crate) fn collapsed(
    triangles: &[[u32; 3]],
    positions: &[[f32; 3]],
    target: usize,
    max_error: f64,
) -> Vec<[u32; 3]> {
    let options = meshopt::SimplifyOptions::ErrorAbsolute;
    let (indices, error) = (triangles.as_flattened(), max_error as f32);
    let kept = meshopt::simplify_decoder(indices, positions, target * 3, error, options, None);
    kept.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect()
}

/// Returns, per vertex, the colour of the nearest cloud point.
pub fn colors_from(points: &[DVec3], colors: &[[u8; 3]], mesh: &Mesh, cell: f64) -> Vec<[u8; 3]> {
    let grid = crate::point_grid::PointGrid::new(points, cell);
    mesh.vertices
        .iter()
        .map(|&v| grid.nearest(v).and_then(|(_, i)| colors.get(i).copied()).unwrap_or([128; 3]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_removes_noise_and_keeps_the_volume() {
        use rand::RngExt;
        let mut mesh = Mesh::icosphere(0.05, 4);
        let exact = mesh.volume();
        let mut rng = sms_core::Seed(3).rng();
        for v in &mut mesh.vertices {
            *v *= 1.0 + 0.02 * (rng.random::<f64>() - 0.5);
        }
        let rough: f64 = mesh.vertices.iter().map(|v| (v.length() - 0.05).abs()).sum();
        let fixed = vec![false; mesh.vertices.len()];
        taubin(&mut mesh, &fixed, 10, 1.0);
        let smooth: f64 = mesh.vertices.iter().map(|v| (v.length() - 0.05).abs()).sum();
        assert!(smooth < 0.5 * rough);
        assert!((mesh.volume() / exact - 1.0).abs() < 0.01);
    }
}
