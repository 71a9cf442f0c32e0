//! Delaunay tetrahedralisation, compared with its definition, the convex hull and SciPy's counts.

use proptest::prelude::*;
use rand::RngExt;
use serde::Deserialize;
use sms_core::Seed;
use sms_core::glamx::DVec3;
use sms_mesh::convex_hull;
use sms_mesh::tetra::{FACES, NONE, Tetrahedralization, delaunay};

/// Checks positive volumes, symmetric neighbours, outward faces, and that volumes add up to the hull's.
fn check_structure(mesh: &Tetrahedralization) {
    let mut total = 0.0;
    for t in 0..mesh.tetrahedra.len() {
        assert!(mesh.volume(t) > -1e-15, "tetrahedron {t} is inside out: {}", mesh.volume(t));
        total += mesh.volume(t);
        for (face, &next) in mesh.neighbors[t].iter().enumerate() {
            if next != NONE {
                assert!(mesh.neighbors[next as usize].contains(&(t as u32)));
                let shared = FACES[face].map(|k| mesh.tetrahedra[t][k]);
                assert!(shared.iter().all(|v| mesh.tetrahedra[next as usize].contains(v)));
            }
        }
    }
    let hull = convex_hull(&mesh.points, usize::MAX, 0.0).expect("a solid set");
    assert!((total / hull.volume() - 1.0).abs() < 1e-9, "{total} against {}", hull.volume());
}

/// Checks that no point lies inside any circumsphere by more than rounding.
fn check_empty_spheres(mesh: &Tetrahedralization) {
    for t in 0..mesh.tetrahedra.len() {
        let [a, b, c, d] = mesh.corners(t);
        for (i, &p) in mesh.points.iter().enumerate() {
            if mesh.tetrahedra[t].contains(&(i as u32)) {
                continue;
            }
            let coord = |p: DVec3| robust::Coord3D { x: p.x, y: p.y, z: p.z };
            let inside = robust::insphere(coord(b), coord(a), coord(c), coord(d), coord(p));
            assert!(inside <= 0.0, "point {i} lies inside the sphere of tetrahedron {t}");
        }
    }
}

fn cloud(kind: usize, n: usize, seed: u64) -> Vec<DVec3> {
    let mut rng = Seed(seed).rng();
    (0..n)
        .map(|_| {
            let p = DVec3::new(rng.random(), rng.random(), rng.random()) * 2.0 - DVec3::ONE;
            match kind {
                0 => p,
                // A coarse grid: cospherical everywhere, with many duplicates.
                1 => (p * 3.0).round(),
                // Cospherical up to rounding.
                2 => p.normalize(),
                // The faces of an exact box.
                _ => {
                    let k = rng.random_range(0..3usize);
                    let mut q = p;
                    q[k] = q[k].signum();
                    q
                }
            }
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn circumspheres_are_empty(kind in 0usize..4, n in 20usize..150, seed in 0u64..1000) {
        let mesh = delaunay(&cloud(kind, n, seed));
        check_structure(&mesh);
        check_empty_spheres(&mesh);
    }
}

#[test]
fn grids_boxes_duplicates_and_flat_sets_survive() {
    let grid: Vec<DVec3> = (0..1000)
        .map(|i| DVec3::new((i % 10) as f64, (i / 10 % 10) as f64, (i / 100) as f64) * 0.01)
        .collect();
    let mesh = delaunay(&grid);
    check_structure(&mesh);
    assert_eq!(mesh.duplicates, 0);
    let twice: Vec<DVec3> = grid.iter().chain(&grid).copied().collect();
    assert_eq!(delaunay(&twice).duplicates, 1000);
    let flat: Vec<DVec3> = grid[..100].to_vec();
    assert!(delaunay(&flat).tetrahedra.is_empty());
    assert!(delaunay(&[]).tetrahedra.is_empty());
    assert!(delaunay(&[DVec3::ONE; 20]).tetrahedra.is_empty());
    // A million metres away, with a spacing of half a millimetre.
    let far: Vec<DVec3> = cloud(0, 300, 1).iter().map(|&p| p * 5e-4 + DVec3::splat(1e6)).collect();
    check_structure(&delaunay(&far));
}

#[derive(Deserialize)]
struct Row {
    kind: String,
    n: usize,
    seed: u64,
    tetrahedra: usize,
    hull_volume: f64,
}

/// The same generator as in `oracle/scipy_delaunay.py`.
fn oracle_points(row: &Row) -> Vec<DVec3> {
    let mut state = row.seed;
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut out = Vec::new();
    while out.len() < row.n {
        let p = DVec3::new(uniform(), uniform(), uniform()) * 2.0 - DVec3::ONE;
        let r = p.length();
        match row.kind.as_str() {
            "cube" => out.push(p),
            _ if r <= 0.1 || r >= 1.0 => {}
            "ball" => out.push(p),
            _ => out.push(p / r * (1.0 + 0.02 * p.x)),
        }
    }
    out
}

#[test]
fn counts_and_volumes_are_scipys() {
    let rows: Vec<Row> = serde_json::from_str(include_str!("../oracle/scipy_delaunay.json")).unwrap();
    assert_eq!(rows.len(), 15);
    for row in rows {
        let mesh = delaunay(&oracle_points(&row));
        assert_eq!(mesh.tetrahedra.len(), row.tetrahedra, "{} {}", row.kind, row.n);
        let volume: f64 = (0..mesh.tetrahedra.len()).map(|t| mesh.volume(t)).sum();
        assert!((volume / row.hull_volume - 1.0).abs() < 1e-9, "{} {}", row.kind, row.n);
    }
}
