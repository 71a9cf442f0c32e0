//! URDF: one file per body, because a URDF holds one robot and no free bodies, and a loader for PyBullet.

use crate::contact::factors;
use crate::text::{numbers, pose_rpy, principal, rgba, rpy, small};
use sms_core::{CoreError, atomic, escape_xml};
use sms_scene::{Body, BodyKind, BodyShape, Scene, hull_file, trimesh_file, visual_file, write_meshes};
use std::fmt::Write;
use std::path::Path;

/// The loader.
const LOADER: &str = include_str!("load_pybullet.py");
/// Edge lengths in metres of the slab that replaces a half space.
const SLAB: [f64; 3] = [20.0, 20.0, 1.0];

/// Writes `<name>.urdf` for each body, `poses.yaml`, `load_pybullet.py` and the meshes.
pub(crate) fn write(dir: &Path, scene: &Scene) -> Result<(), CoreError> {
    write_meshes(scene, dir)?;
    for body in &scene.bodies {
        let text = body_text(scene, body);
        atomic::write_bytes(&dir.join(format!("{}.urdf", body.name)), text.as_bytes())?;
    }
    atomic::write_bytes(&dir.join("poses.yaml"), poses(scene).as_bytes())?;
    atomic::write_bytes(&dir.join("load_pybullet.py"), LOADER.as_bytes())
}

fn mesh(file: &str) -> String {
    format!("<mesh filename=\"{file}\"/>")
}

/// Returns origin and geometry of each collision element.
fn collisions(body: &Body) -> Vec<(String, String)> {
    let here = || "0 0 0".to_owned();
    match &body.shape {
        BodyShape::Sphere { radius } => {
            vec![(here(), format!("<sphere radius=\"{}\"/>", numbers([*radius])))]
        }
        BodyShape::Box { half_extents } => {
            let size = numbers((2.0 * *half_extents).to_array());
            vec![(here(), format!("<box size=\"{size}\"/>"))]
        }
        BodyShape::Cylinder { radius, half_length } => {
            let (radius, length) = (numbers([*radius]), numbers([2.0 * half_length]));
            vec![(here(), format!("<cylinder radius=\"{radius}\" length=\"{length}\"/>"))]
        }
        BodyShape::HalfSpace => {
            vec![(numbers([0.0, 0.0, -0.5 * SLAB[2]]), format!("<box size=\"{}\"/>", numbers(SLAB)))]
        }
        BodyShape::Hulls { hulls } => (0..hulls.len()).map(|i| (here(), mesh(&hull_file(body, i)))).collect(),
        BodyShape::TriMesh { .. } => vec![(here(), mesh(&trimesh_file(body)))],
    }
}

fn body_text(scene: &Scene, body: &Body) -> String {
    let name = escape_xml(&body.name);
    let f = factors(scene, body);
    let mut t = format!("<?xml version=\"1.0\"?>\n<robot name=\"{name}\">\n  <link name=\"{name}\">\n");
    if let Some(mass) = body.mass.as_ref().filter(|_| body.kind == BodyKind::Dynamic) {
        let (moments, axes) = principal(mass);
        let (com, turn) = (numbers(mass.com().to_array()), numbers(rpy(axes).to_array()));
        let [xx, yy, zz] = moments.to_array().map(small);
        let _ = writeln!(
            t,
            "    <inertial>\n      <origin xyz=\"{com}\" rpy=\"{turn}\"/>\n      <mass value=\"{:.9}\"/>\n      \
             <inertia ixx=\"{xx}\" ixy=\"0\" ixz=\"0\" iyy=\"{yy}\" iyz=\"0\" izz=\"{zz}\"/>\n    </inertial>",
            mass.mass()
        );
    }
    let shapes = collisions(body);
    let visuals = if body.visual.triangles.is_empty() {
        shapes.clone()
    } else {
        vec![("0 0 0".into(), mesh(&visual_file(body)))]
    };
    // A textured mesh has its own material; a colour here would override it.
    let colored = body.texture.is_none() || body.visual.triangles.is_empty();
    let look = format!("<material name=\"{name}\"><color rgba=\"{}\"/></material>", rgba(body.color));
    let material = if colored { look.as_str() } else { "" };
    for (at, geometry) in visuals {
        let _ = writeln!(
            t,
            "    <visual><origin xyz=\"{at}\"/><geometry>{geometry}</geometry>{material}</visual>"
        );
    }
    let concave = if matches!(body.shape, BodyShape::TriMesh { .. }) { " concave=\"yes\"" } else { "" };
    for (at, geometry) in shapes {
        let _ = writeln!(
            t,
            "    <collision{concave}><origin xyz=\"{at}\"/><geometry>{geometry}</geometry></collision>"
        );
    }
    let _ = writeln!(
        t,
        "    <contact>\n      <lateral_friction value=\"{:.6}\"/>\n      <restitution value=\"{:.6}\"/>\n      \
         <rolling_friction value=\"{:.9}\"/>\n      <spinning_friction value=\"{:.9}\"/>\n    </contact>",
        f.friction, f.restitution, f.rolling, f.rolling
    );
    t.push_str("  </link>\n</robot>\n");
    t
}

/// Formats the poses in the world, for readers of URDF without our loader.
fn poses(scene: &Scene) -> String {
    let mut text = String::from(
        "# Pose of each body's link in the world (z up): x y z in metres, then roll, pitch, yaw in radians.\n",
    );
    let _ = writeln!(text, "gravity: [{}]", numbers(scene.gravity_w.to_array()).replace(' ', ", "));
    text.push_str("bodies:\n");
    for body in &scene.bodies {
        let fixed = body.kind == BodyKind::Static;
        let _ = writeln!(
            text,
            "  - {{name: \"{0}\", file: \"{0}.urdf\", fixed: {fixed}, pose: [{1}]}}",
            body.name,
            pose_rpy(&body.x_wb).replace(' ', ", ")
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::scene;

    #[test]
    fn each_shape_has_its_element() {
        let scene = scene();
        let text = |name: &str| body_text(&scene, scene.body(name).unwrap());
        assert!(text("can").contains("<cylinder radius=\"0.03\" length=\"0.1\"/>"));
        assert!(text("carton").contains("<box size=\"0.06 0.1 0.04\"/>"));
        assert!(text("environment").contains("<collision concave=\"yes\">"));
        assert!(!text("environment").contains("<inertial>"));
        assert!(text("wedge.1-a").contains("meshes/wedge.1-a_hull_00.obj"));
        assert!(!text("wedge.1-a").contains("<color"), "a colour would override its texture");
        assert!(
            poses(&scene).contains("name: \"ball\", file: \"ball.urdf\", fixed: false, pose: [-0.2, 0.1,")
        );
    }
}
