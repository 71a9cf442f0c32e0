//! Mass properties of closed meshes against trimesh: reference numbers written by `benches/peers/trimesh_mass.py`.

mod shapes;

use serde::Deserialize;
use sms_core::glamx::{DMat3, DVec3};
use sms_core::polyhedron_mass_properties;

/// Results of trimesh at 1 kg/m³: volume, centre of mass, inertia about it (rows).
#[derive(Deserialize)]
struct Reference {
    name: String,
    volume_m3: f64,
    com_m: DVec3,
    inertia_kg_m2: [[f64; 3]; 3],
}

#[test]
fn mass_centre_and_inertia_are_those_of_trimesh() {
    let references: Vec<Reference> = serde_json::from_str(include_str!("trimesh_mass.json")).unwrap();
    let shapes = shapes::shapes();
    assert_eq!(references.len(), shapes.len());
    for (reference, (name, mesh)) in references.iter().zip(&shapes) {
        assert_eq!(&reference.name, name);
        assert!(mesh.is_closed_oriented(), "{name}");
        let density = 730.0;
        let m = polyhedron_mass_properties(mesh, density).unwrap();
        let mass = reference.volume_m3 * density;
        assert!((m.mass() / mass - 1.0).abs() <= 1e-6, "{name}: {} {mass}", m.mass());
        assert!(
            (m.com() - reference.com_m).length() <= 1e-6 * mesh.aabb().unwrap().extents().length(),
            "{name}"
        );
        let expected = DMat3::from_cols_array_2d(&reference.inertia_kg_m2).transpose() * density;
        let norm = |m: DMat3| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        let off = norm(m.inertia() - expected) / norm(expected);
        assert!(off <= 1e-6, "{name}: inertia off by {off:e}");
    }
}
