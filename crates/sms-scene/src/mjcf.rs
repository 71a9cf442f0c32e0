//! Export for MuJoCo.
//!
//! MuJoCo replaces a mesh by its convex hull when it collides. Dynamic bodies therefore export their convex parts;
//! a static triangle mesh exports one thin prism per triangle, which keeps its surface exactly.

use crate::manifest::{hull_file, visual_file, write_meshes};
use crate::{Body, BodyKind, BodyShape, Scene};
use glamx::{DMat3, DVec3};
use sms_core::{CoreError, Mesh, atomic};
use std::fmt::Write;
use std::path::Path;

/// How far a static triangle is extruded against its normal, metres. Thin enough not to come out of the other side
/// of cardboard, thick enough that a body at rest cannot pass within a time step.
const PRISM_THICKNESS: f64 = 0.003;
/// Triangles smaller than this (m²) are left out of the prisms: MuJoCo refuses meshes without volume.
const MIN_PRISM_AREA: f64 = 1e-8;

/// Writes `scene.xml` and its meshes into `dir`.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_mjcf(dir: &Path, scene: &Scene) -> Result<(), CoreError> {
    write_meshes(scene, dir)?;
    atomic::write_bytes(&dir.join("scene.xml"), mjcf_text(scene).as_bytes())
}

/// The scene as MJCF text; mesh files are named relative to the scene's folder.
///
/// Friction: MuJoCo takes the larger coefficient of a pair where we take the mean, so every dynamic body is given
/// the mean of its own and the floor's; the floor's own is set to the smallest of these.
pub fn mjcf_text(scene: &Scene) -> String {
    let mut assets = String::new();
    let mut world = String::new();
    let floor_friction = scene
        .bodies
        .iter()
        .find(|b| matches!(b.shape, BodyShape::HalfSpace))
        .map_or(0.5, |b| b.material.friction.value.best);
    let pair_friction = |b: &Body| 0.5 * (b.material.friction.value.best + floor_friction);
    let least = scene
        .bodies
        .iter()
        .filter(|b| b.kind == BodyKind::Dynamic)
        .map(pair_friction)
        .fold(floor_friction, f64::min);
    for body in &scene.bodies {
        let friction = if body.kind == BodyKind::Dynamic { pair_friction(body) } else { least };
        write_body(body, friction, &mut assets, &mut world);
    }
    let g = scene.gravity_w;
    format!(
        r#"<mujoco model="{name}">
  <!-- Written by sms. Metres, kilograms, seconds, radians; world z up. -->
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" gravity="{gx} {gy} {gz}" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default>
    <geom solref="0.005 1" solimp="0.95 0.99 0.0005"/>
    <default class="collision"><geom group="3"/></default>
    <default class="visual"><geom group="2" contype="0" conaffinity="0"/></default>
  </default>
  <visual><headlight ambient="0.4 0.4 0.4"/></visual>
  <asset>
{assets}  </asset>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1" diffuse="0.6 0.6 0.6"/>
{world}  </worldbody>
</mujoco>
"#,
        name = escape(&scene.name),
        gx = g.x,
        gy = g.y,
        gz = g.z,
    )
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

fn numbers(values: impl IntoIterator<Item = f64>) -> String {
    // Nine significant digits: nanometres at desk scale, and stable text.
    values.into_iter().map(|v| format!("{v:.9}")).collect::<Vec<_>>().join(" ")
}

fn rgba(color: [u8; 3]) -> String {
    let [r, g, b] = color.map(|c| f64::from(c) / 255.0);
    format!("{r:.3} {g:.3} {b:.3} 1")
}

fn write_body(body: &Body, friction: f64, assets: &mut String, world: &mut String) {
    let name = &body.name;
    let q = body.x_wb.rotation;
    let pose = format!(
        "pos=\"{}\" quat=\"{}\"",
        numbers(body.x_wb.translation.to_array()),
        numbers([q.w, q.x, q.y, q.z])
    );
    // The third friction coefficient of MuJoCo is our rolling lever arm; the second its torsional counterpart.
    let rolling = body.material.rolling_m.value.best;
    let contact = format!("class=\"collision\" friction=\"{friction:.4} 0.001 {rolling:.6}\"");
    let _ = writeln!(world, "    <body name=\"{name}\" {pose}>");
    if body.kind == BodyKind::Dynamic {
        let _ = writeln!(world, "      <freejoint name=\"{name}_free\"/>");
        if let Some(mass) = &body.mass {
            let _ = writeln!(
                world,
                "      <inertial pos=\"{}\" mass=\"{:.9}\" fullinertia=\"{}\"/>",
                numbers(mass.com().to_array()),
                mass.mass(),
                inertia_numbers(mass.inertia())
            );
        }
    }
    if !body.visual.triangles.is_empty() {
        let _ = writeln!(
            assets,
            "    <mesh name=\"{name}_visual\" file=\"{}\" inertia=\"shell\"/>",
            visual_file(body)
        );
        let _ = writeln!(
            world,
            "      <geom name=\"{name}_visual\" class=\"visual\" type=\"mesh\" mesh=\"{name}_visual\" rgba=\"{}\"/>",
            rgba(body.color)
        );
    }
    match &body.shape {
        BodyShape::Sphere { radius } => {
            let _ = writeln!(
                world,
                "      <geom name=\"{name}\" {contact} type=\"sphere\" size=\"{radius:.9}\" condim=\"6\" rgba=\"{}\"/>",
                rgba(body.color)
            );
        }
        BodyShape::Box { half_extents } => {
            let _ = writeln!(
                world,
                "      <geom name=\"{name}\" {contact} type=\"box\" size=\"{}\" rgba=\"{}\"/>",
                numbers(half_extents.to_array()),
                rgba(body.color)
            );
        }
        BodyShape::Cylinder { radius, half_length } => {
            let _ = writeln!(
                world,
                "      <geom name=\"{name}\" {contact} type=\"cylinder\" size=\"{radius:.9} {half_length:.9}\" rgba=\"{}\"/>",
                rgba(body.color)
            );
        }
        BodyShape::HalfSpace => {
            let _ = writeln!(
                world,
                "      <geom name=\"{name}\" {contact} type=\"plane\" size=\"3 3 0.1\" rgba=\"{}\"/>",
                rgba(body.color)
            );
        }
        BodyShape::Hulls { hulls } => {
            for i in 0..hulls.len() {
                let _ = writeln!(
                    assets,
                    "    <mesh name=\"{name}_hull_{i:02}\" file=\"{}\" inertia=\"shell\"/>",
                    hull_file(body, i)
                );
                let _ = writeln!(
                    world,
                    "      <geom name=\"{name}_hull_{i:02}\" {contact} type=\"mesh\" mesh=\"{name}_hull_{i:02}\"/>"
                );
            }
        }
        BodyShape::TriMesh { mesh } => write_prisms(name, mesh, &contact, assets, world),
    }
    let _ = writeln!(world, "    </body>");
}

fn inertia_numbers(inertia: DMat3) -> String {
    let i = inertia.to_cols_array_2d();
    let six = [i[0][0], i[1][1], i[2][2], i[0][1], i[0][2], i[1][2]];
    six.map(|v| format!("{v:.9e}")).join(" ")
}

fn write_prisms(name: &str, mesh: &Mesh, contact: &str, assets: &mut String, world: &mut String) {
    for t in 0..mesh.triangles.len() {
        let corners = mesh.corners(t);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        if 0.5 * normal.length() < MIN_PRISM_AREA {
            continue;
        }
        let down = -normal.normalize_or(DVec3::Z) * PRISM_THICKNESS;
        let six = corners.iter().copied().chain(corners.iter().map(|&c| c + down));
        let vertices = numbers(six.flat_map(|p| p.to_array()));
        let _ = writeln!(
            assets,
            "    <mesh name=\"{name}_prism_{t:04}\" vertex=\"{vertices}\" inertia=\"shell\"/>"
        );
        let _ = writeln!(
            world,
            "      <geom name=\"{name}_prism_{t:04}\" {contact} type=\"mesh\" mesh=\"{name}_prism_{t:04}\"/>"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SCENE_VERSION, example_material, floor_body};
    use glamx::DPose3;

    #[test]
    fn every_body_is_in_the_text_with_its_geometry() {
        let mut wall = floor_body(0.0, example_material());
        wall.name = "environment".into();
        wall.shape = BodyShape::TriMesh { mesh: Mesh::cuboid(DVec3::splat(0.1)) };
        let mut ball = floor_body(0.0, example_material());
        ball.name = "ball".into();
        ball.kind = BodyKind::Dynamic;
        ball.shape = BodyShape::Sphere { radius: 0.03 };
        ball.mass = Some(sms_core::sphere_mass_properties(DVec3::ZERO, 0.03, 1000.0).unwrap());
        let scene = Scene {
            version: SCENE_VERSION,
            name: "a<b".into(),
            gravity_w: DVec3::new(0.0, 0.0, -9.81),
            x_world_recording: DPose3::identity(),
            bodies: vec![floor_body(0.0, example_material()), wall, ball],
        };
        let text = mjcf_text(&scene);
        assert_eq!(text.matches("_prism_").count(), 12 * 3, "one prism a triangle: asset, geom and its mesh");
        assert!(text.contains("type=\"plane\"") && text.contains("size=\"0.030000000\" condim=\"6\""));
        assert_eq!(text.matches("<freejoint").count(), 1);
        assert!(text.contains("model=\"a&lt;b\""));
    }
}
