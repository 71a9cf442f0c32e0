//! A scene with every shape, for tests.

use glamx::{DPose3, DQuat, DVec3};
use sms_core::{
    Image, MassProperties, Mesh, MeshTexture, box_mass_properties, cylinder_mass_properties,
    polyhedron_mass_properties, sphere_mass_properties,
};
use sms_scene::{Body, BodyKind, BodyShape, GRAVITY, SCENE_VERSION, Scene, example_material, floor_body};

fn body(name: &str, kind: BodyKind, x_wb: DPose3, shape: BodyShape, mass: Option<MassProperties>) -> Body {
    let mut material = example_material();
    let shift = 0.03 * name.len() as f64;
    material.friction.value.best -= 0.01 + 0.3 * shift;
    material.friction.value.low -= 0.1 + 0.3 * shift;
    material.rolling_m.value.low = 0.0;
    material.restitution.value.best -= 0.02 * shift;
    let mut visual = shape.meshes().swap_remove(0);
    visual.colors = (0..visual.vertices.len()).map(|i| [i as u8, 90, 200]).collect();
    Body {
        name: name.into(),
        x_wb,
        kind,
        shape,
        visual,
        mass,
        description: format!("a <{name}>"),
        color: [200, 90, 40],
        observed_share: 0.7,
        fit_se_m: 0.0,
        ..floor_body(0.0, material)
    }
}

/// A wedge of density 800 kg/m³ about its centre of mass: its principal axes are not the axes of its frame.
fn wedge() -> (Mesh, MassProperties) {
    let corners = [(0.0, 0.0), (0.08, 0.0), (0.0, 0.05)];
    let vertices = [0.0, 0.04].iter().flat_map(|&y| corners.map(|(x, z)| DVec3::new(x, y, z))).collect();
    let triangles =
        vec![[0, 1, 2], [3, 5, 4], [0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2], [2, 5, 3], [2, 3, 0]];
    let mesh = Mesh::new(vertices, triangles);
    let mass = polyhedron_mass_properties(&mesh, 800.0).expect("a wedge encloses volume");
    let centred = mesh.transformed(&DPose3::from_translation(-mass.com()));
    (centred, MassProperties::new(mass.mass(), DVec3::ZERO, mass.inertia()).expect("the same inertia"))
}

/// Floor, static mesh and box, dynamic sphere, box, cylinder and textured wedge, all at rest.
pub(crate) fn scene() -> Scene {
    let at = |x: f64, z: f64| DPose3::from_translation(DVec3::new(x, 0.1, z));
    let (mesh, mass) = wedge();
    let wedge_height = -mesh.aabb().expect("a wedge has corners").min.z;
    let mut wedge = body(
        "wedge.1-a",
        BodyKind::Dynamic,
        at(0.4, wedge_height),
        BodyShape::Hulls { hulls: vec![mesh.clone()] },
        Some(mass),
    );
    let corner_uv = (0..mesh.triangles.len()).map(|t| [[0.1 * t as f32, 0.0], [1.0, 0.25], [0.5, 1.0]]);
    wedge.texture = Some(MeshTexture {
        corner_uv: corner_uv.collect(),
        image: Image::from_vec(2, 2, vec![[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]]),
    });
    let half = DVec3::new(0.03, 0.05, 0.02);
    let lying =
        DPose3::from_parts(DVec3::new(0.0, 0.1, 0.02), DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2));
    let shelf = Mesh::cuboid(DVec3::new(0.1, 0.1, 0.02));
    Scene {
        version: SCENE_VERSION,
        name: "every <shape>".into(),
        gravity_w: DVec3::new(0.0, 0.0, -GRAVITY),
        size_sigma: 0.0,
        x_world_recording: DPose3::identity(),
        bodies: vec![
            floor_body(0.0, example_material()),
            body("environment", BodyKind::Static, at(1.0, 0.02), BodyShape::TriMesh { mesh: shelf }, None),
            body("block", BodyKind::Static, at(-1.0, 0.02), BodyShape::Box { half_extents: half }, None),
            body(
                "ball",
                BodyKind::Dynamic,
                at(-0.2, 0.03),
                BodyShape::Sphere { radius: 0.03 },
                sphere_mass_properties(DVec3::ZERO, 0.03, 1200.0).ok(),
            ),
            body(
                "carton",
                BodyKind::Dynamic,
                DPose3::from_parts(DVec3::new(0.2, 0.1, 0.02), DQuat::from_rotation_z(0.4)),
                BodyShape::Box { half_extents: half },
                box_mass_properties(half, 300.0).ok(),
            ),
            body(
                "can",
                BodyKind::Dynamic,
                DPose3::from_parts(DVec3::new(0.0, -0.1, 0.05), DQuat::IDENTITY),
                BodyShape::Cylinder { radius: 0.03, half_length: 0.05 },
                cylinder_mass_properties(0.03, 0.05, 900.0).ok(),
            ),
            body(
                "pencil",
                BodyKind::Dynamic,
                lying,
                BodyShape::Box { half_extents: DVec3::new(0.02, 0.01, 0.08) },
                box_mass_properties(DVec3::new(0.02, 0.01, 0.08), 600.0).ok(),
            ),
            wedge,
        ],
    }
}
