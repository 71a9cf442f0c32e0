//! SDFormat 1.9: a world with one model per body, and each model as a separate folder for use in other worlds.

use crate::contact::{factors, with_ground};
use crate::text::{number, numbers, pose_rpy, principal, rgba, small};
use glamx::DPose3;
use sms_core::{CoreError, atomic, escape_xml};
use sms_scene::{Body, BodyKind, BodyShape, Scene, hull_file, trimesh_file, visual_file, write_meshes};
use std::fmt::Write;
use std::path::Path;

/// Writes `world.sdf`, the meshes, and `models/<name>/{model.config,model.sdf,meshes/}` for each body.
pub(crate) fn write(dir: &Path, scene: &Scene) -> Result<(), CoreError> {
    let mut models = String::new();
    for body in &scene.bodies {
        let folder = dir.join("models").join(&body.name);
        let alone = Scene { bodies: vec![body.clone()], ..scene.clone() };
        write_meshes(&alone, &folder)?;
        let at_origin = model(scene, body, None, "");
        let text = format!("<?xml version=\"1.0\"?>\n<sdf version=\"1.9\">\n{at_origin}</sdf>\n");
        atomic::write_bytes(&folder.join("model.sdf"), text.as_bytes())?;
        atomic::write_bytes(&folder.join("model.config"), config(body).as_bytes())?;
        models += &model(scene, body, Some(&body.x_wb), &format!("models/{}/", body.name));
    }
    let world = format!(
        include_str!("../assets/world.sdf"),
        name = escape_xml(&scene.name),
        gravity = numbers(scene.gravity_w.to_array()),
        models = models,
    );
    atomic::write_bytes(&dir.join("world.sdf"), world.as_bytes())
}

fn config(body: &Body) -> String {
    format!(
        include_str!("../assets/model.config"),
        name = escape_xml(&body.name),
        description = escape_xml(if body.description.is_empty() { &body.name } else { &body.description }),
    )
}

/// Returns the geometries of the collision elements; mesh files are below `prefix`.
fn geometries(body: &Body, prefix: &str) -> Vec<String> {
    let mesh = |file: String| format!("<mesh><uri>{prefix}{file}</uri></mesh>");
    match &body.shape {
        BodyShape::Sphere { radius } => {
            vec![format!("<sphere><radius>{}</radius></sphere>", number(*radius))]
        }
        BodyShape::Box { half_extents } => {
            vec![format!("<box><size>{}</size></box>", numbers((2.0 * *half_extents).to_array()))]
        }
        BodyShape::Cylinder { radius, half_length } => vec![format!(
            "<cylinder><radius>{}</radius><length>{}</length></cylinder>",
            number(*radius),
            number(2.0 * half_length)
        )],
        BodyShape::HalfSpace => {
            vec!["<plane><normal>0 0 1</normal><size>20 20</size></plane>".into()]
        }
        BodyShape::Hulls { hulls } => (0..hulls.len()).map(|i| mesh(hull_file(body, i))).collect(),
        BodyShape::TriMesh { .. } => vec![mesh(trimesh_file(body))],
    }
}

/// Returns the contact parameters. Gazebo's engines take the smaller friction of a pair, so a moving body gets its mean with the
/// ground and static ones the largest of these. Restitution is multiplied.
fn surface(scene: &Scene, body: &Body) -> String {
    let mean = |b: &Body| with_ground(scene, b, |b| b.material.friction);
    let friction = match body.kind {
        BodyKind::Dynamic => mean(body),
        BodyKind::Static => scene.bodies.iter().map(mean).fold(0.0, f64::max),
    };
    format!(
        "        <surface>\n          <friction><ode><mu>{friction:.6}</mu><mu2>{friction:.6}</mu2></ode></friction>\n          \
         <bounce><restitution_coefficient>{:.6}</restitution_coefficient><threshold>0.05</threshold></bounce>\n        \
         </surface>\n",
        factors(scene, body).restitution
    )
}

fn model(scene: &Scene, body: &Body, pose: Option<&DPose3>, prefix: &str) -> String {
    let name = escape_xml(&body.name);
    let mut t = format!("    <model name=\"{name}\">\n");
    if let Some(pose) = pose {
        let _ = writeln!(t, "      <pose>{}</pose>", pose_rpy(pose));
    }
    let _ = writeln!(t, "      <static>{}</static>", body.kind == BodyKind::Static);
    t.push_str("      <link name=\"link\">\n");
    if let Some(mass) = body.mass.as_ref().filter(|_| body.kind == BodyKind::Dynamic) {
        let (moments, axes) = principal(mass);
        let [xx, yy, zz] = moments.to_array().map(small);
        let _ = writeln!(
            t,
            "        <inertial>\n          <pose>{}</pose>\n          <mass>{:.9}</mass>\n          <inertia>\
             <ixx>{xx}</ixx><ixy>0</ixy><ixz>0</ixz><iyy>{yy}</iyy><iyz>0</iyz><izz>{zz}</izz></inertia>\n        \
             </inertial>",
            pose_rpy(&DPose3::from_parts(mass.com(), axes)),
            mass.mass()
        );
    }
    let shapes = geometries(body, prefix);
    let visuals = if body.visual.triangles.is_empty() {
        shapes.clone()
    } else {
        vec![format!("<mesh><uri>{prefix}{}</uri></mesh>", visual_file(body))]
    };
    let color = rgba(body.color);
    // Without this element, a mesh keeps the material of its MTL file.
    let material = if body.texture.is_some() {
        String::new()
    } else {
        format!("<material><ambient>{color}</ambient><diffuse>{color}</diffuse></material>")
    };
    for (i, geometry) in visuals.iter().enumerate() {
        let _ = writeln!(
            t,
            "        <visual name=\"visual_{i:02}\"><geometry>{geometry}</geometry>{material}</visual>"
        );
    }
    let surface = surface(scene, body);
    for (i, geometry) in shapes.iter().enumerate() {
        let _ = write!(
            t,
            "        <collision name=\"collision_{i:02}\">\n        <geometry>{geometry}</geometry>\n{surface}        \
             </collision>\n"
        );
    }
    t.push_str("      </link>\n    </model>\n");
    t
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::scene;

    #[test]
    fn the_world_names_only_files_below_it() {
        let dir = tempfile::tempdir().unwrap();
        let scene = scene();
        write(dir.path(), &scene).unwrap();
        let world = std::fs::read_to_string(dir.path().join("world.sdf")).unwrap();
        assert_eq!(world.matches("<model name=").count(), scene.bodies.len());
        assert_eq!(world.matches("<inertial>").count(), 5);
        assert!(world.contains("every &lt;shape&gt;") && world.contains("<plane>"));
        let uris: Vec<&str> =
            world.split("<uri>").skip(1).filter_map(|rest| rest.split("</uri>").next()).collect();
        assert!(!uris.is_empty() && uris.iter().all(|uri| dir.path().join(uri).is_file()), "{uris:?}");
        let model = dir.path().join("models/wedge.1-a/model.sdf");
        let text = std::fs::read_to_string(model).unwrap();
        assert!(text.contains("<uri>meshes/wedge.1-a_visual.obj</uri>") && !text.contains("<material>"));
    }
}
