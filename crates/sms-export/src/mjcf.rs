//! MuJoCo.
//!
//! MuJoCo replaces a mesh by its convex hull when it collides. Moving bodies therefore export their convex parts; a
//! static triangle mesh exports one thin prism per triangle, which keeps its surface exactly.
//!
//! Contacts: a moving body has the mean of its own and the ground's coefficients and a higher `priority` than static
//! geoms, so its values apply against them; of two moving bodies MuJoCo takes the larger friction. MuJoCo has no
//! restitution; the damping ratio of an underdamped contact is chosen to reproduce it.

use crate::contact::{damping_ratio, with_ground};
use crate::mjcf_view::{FLOOR_GRID, floor_material, statistic};
use crate::text::{number, numbers, principal, rgba, small};
use glamx::{DQuat, DVec3};
use sms_core::{CoreError, Mesh, atomic, escape_xml};
use sms_scene::{Body, BodyKind, BodyShape, Scene, hull_file, visual_file, write_meshes};
use std::fmt::Write;
use std::path::Path;

/// Extrusion of a static triangle against its normal, metres: thinner than cardboard, and thick enough that a body at rest
/// cannot pass within a time step.
const PRISM_THICKNESS: f64 = 0.003;
/// Triangles smaller than this (m²) are left out of the prisms: MuJoCo refuses meshes without volume.
const MIN_PRISM_AREA: f64 = 1e-8;
/// Time step in seconds: a sixth of the half period of contacts, below which their damping is no longer resolved.
const TIME_STEP: f64 = 0.001;
/// Half of the edge lengths of the slab that replaces a half space, metres. MuJoCo finds at most three contacts between a mesh
/// and a plane, the deepest vertex and its neighbours. The mass centre of a block on four corners lies on the edge of that
/// triangle, so it rocks and creeps by up to 12 mm in a second. Against a slab it has four contacts.
const GROUND_HALF_EDGE: f64 = 3.0;
const GROUND_HALF_DEPTH: f64 = 0.5;
/// Angular frequency of contacts, rad/s. An impact at 1 m/s goes 2 mm deep; at rest MuJoCo's impedance leaves 2 µm.
const CONTACT_FREQUENCY: f64 = 500.0;

/// Exported share of the damping: MuJoCo's step and impedance add the rest.
const DAMPING_LEFT: f64 = 0.9;

/// Writes `scene.xml` and its meshes into `dir`.
pub(crate) fn write(dir: &Path, scene: &Scene) -> Result<(), CoreError> {
    write_meshes(scene, dir)?;
    atomic::write_bytes(&dir.join("scene.xml"), mjcf_text(scene).as_bytes())
}

/// Formats the scene as MJCF text. Mesh files are named relative to it, as [`sms_scene::write_meshes`] (and so
/// [`sms_scene::save_scene`]) writes them.
pub fn mjcf_text(scene: &Scene) -> String {
    let mut file = File { scene, assets: String::new(), world: String::new() };
    for body in &scene.bodies {
        file.body(body);
    }
    format!(
        include_str!("../assets/scene.xml"),
        time_step = TIME_STEP,
        name = escape_xml(&scene.name),
        gravity = numbers(scene.gravity_w.to_array()),
        statistic = statistic(scene),
        assets = file.assets,
        world = file.world,
    )
}

/// Returns the half edge of the ground, which extends a metre beyond every body.
fn ground_half_edge(scene: &Scene) -> f64 {
    let far = |b: &Body| b.x_wb.translation.x.abs().max(b.x_wb.translation.y.abs()) + 1.0;
    scene.bodies.iter().map(far).fold(GROUND_HALF_EDGE, f64::max)
}

fn wxyz(q: DQuat) -> String {
    numbers([q.w, q.x, q.y, q.z])
}

struct File<'a> {
    scene: &'a Scene,
    assets: String,
    world: String,
}

impl File<'_> {
    fn asset(&mut self, line: &str) {
        let _ = writeln!(self.assets, "    {line}");
    }

    fn line(&mut self, line: &str) {
        let _ = writeln!(self.world, "    {line}");
    }

    fn body(&mut self, body: &Body) {
        let name = &body.name;
        let position = numbers(body.x_wb.translation.to_array());
        self.line(&format!(
            "<body name=\"{name}\" pos=\"{position}\" quat=\"{}\">",
            wxyz(body.x_wb.rotation)
        ));
        if body.kind == BodyKind::Dynamic {
            self.line(&format!("  <freejoint name=\"{name}_free\"/>"));
            if let Some(mass) = &body.mass {
                let (moments, axes) = principal(mass);
                let moments = moments.to_array().map(small).join(" ");
                self.line(&format!(
                    "  <inertial pos=\"{}\" quat=\"{}\" mass=\"{:.9}\" diaginertia=\"{moments}\"/>",
                    numbers(mass.com().to_array()),
                    wxyz(axes),
                    mass.mass(),
                ));
            }
        }
        self.visual(body);
        self.collision(body);
        self.line("</body>");
    }

    fn visual(&mut self, body: &Body) {
        if body.visual.triangles.is_empty() {
            if body.shape == BodyShape::HalfSpace {
                self.floor(body);
            }
            return;
        }
        let (name, file) = (&body.name, visual_file(body));
        self.asset(&format!("<mesh name=\"{name}_visual\" file=\"{file}\" inertia=\"shell\"/>"));
        let look = if body.texture.is_some() {
            let image = file.replace(".obj", ".png");
            self.asset(&format!("<texture name=\"{name}_picture\" type=\"2d\" file=\"{image}\"/>"));
            self.asset(&format!(
                "<material name=\"{name}_look\" texture=\"{name}_picture\" specular=\"0.1\"/>"
            ));
            format!("material=\"{name}_look\"")
        } else {
            format!("rgba=\"{}\"", rgba(body.color))
        };
        self.line(&format!(
            "  <geom name=\"{name}_visual\" class=\"visual\" type=\"mesh\" mesh=\"{name}_visual\" {look}/>"
        ));
    }

    /// Draws a half space as a plane: viewers hide the group of its slab.
    fn floor(&mut self, body: &Body) {
        let (name, edge) = (&body.name, ground_half_edge(self.scene));
        let size = numbers([edge, edge, FLOOR_GRID]);
        self.assets.push_str(&floor_material(name, body.color));
        self.line(&format!(
            "  <geom name=\"{name}_visual\" class=\"visual\" type=\"plane\" size=\"{size}\" material=\"{name}_look\"/>"
        ));
    }

    /// Returns friction, restitution and rolling resistance of the collision geoms of a body.
    fn contact(&self, body: &Body) -> String {
        let of = |property: fn(&Body) -> sms_core::Property| with_ground(self.scene, body, property);
        let friction = of(|b| b.material.friction);
        // The third coefficient is our rolling lever; the second its counterpart about the normal.
        let rolling = of(|b| b.material.rolling_m);
        let ratio = damping_ratio(of(|b| b.material.restitution));
        // Stiffness and damping as negative numbers: of two moving bodies MuJoCo then takes the greater damping. With time
        // constants it would take the mean, which is too soft.
        let spring = -CONTACT_FREQUENCY * CONTACT_FREQUENCY;
        let damper = -2.0 * DAMPING_LEFT * ratio * CONTACT_FREQUENCY;
        let priority = u8::from(body.kind == BodyKind::Dynamic);
        format!(
            "class=\"collision\" friction=\"{friction:.4} 0.001 {rolling:.6}\" priority=\"{priority}\" \
             solref=\"{} {}\"",
            number(spring),
            number((1e3 * damper).round() / 1e3),
        )
    }

    fn collision(&mut self, body: &Body) {
        let (name, contact, color) = (&body.name, self.contact(body), rgba(body.color));
        let primitive = match &body.shape {
            // Shapes that roll need rolling friction, and thus all six dimensions.
            BodyShape::Sphere { radius } => {
                Some(format!("type=\"sphere\" size=\"{}\" condim=\"6\"", number(*radius)))
            }
            BodyShape::Cylinder { radius, half_length } => {
                Some(format!("type=\"cylinder\" size=\"{}\" condim=\"6\"", numbers([*radius, *half_length])))
            }
            BodyShape::Box { half_extents } => {
                Some(format!("type=\"box\" size=\"{}\"", numbers(half_extents.to_array())))
            }
            BodyShape::HalfSpace => Some(format!(
                "type=\"box\" size=\"{}\" pos=\"{}\"",
                {
                    let edge = ground_half_edge(self.scene);
                    numbers([edge, edge, GROUND_HALF_DEPTH])
                },
                numbers([0.0, 0.0, -GROUND_HALF_DEPTH])
            )),
            BodyShape::Hulls { .. } | BodyShape::TriMesh { .. } => None,
        };
        if let Some(primitive) = primitive {
            self.line(&format!("  <geom name=\"{name}\" {contact} {primitive} rgba=\"{color}\"/>"));
        }
        match &body.shape {
            BodyShape::Hulls { hulls } => {
                for i in 0..hulls.len() {
                    let part = format!("{name}_hull_{i:02}");
                    let file = hull_file(body, i);
                    self.asset(&format!("<mesh name=\"{part}\" file=\"{file}\" inertia=\"shell\"/>"));
                    self.line(&format!("  <geom name=\"{part}\" {contact} type=\"mesh\" mesh=\"{part}\"/>"));
                }
            }
            BodyShape::TriMesh { mesh } => self.prisms(name, mesh, &contact),
            _ => {}
        }
    }

    fn prisms(&mut self, name: &str, mesh: &Mesh, contact: &str) {
        for t in 0..mesh.triangles.len() {
            let corners = mesh.corners(t);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            if 0.5 * normal.length() < MIN_PRISM_AREA {
                continue;
            }
            let down = -normal.normalize_or(DVec3::Z) * PRISM_THICKNESS;
            let six = corners.iter().copied().chain(corners.iter().map(|&c| c + down));
            let vertices = numbers(six.flat_map(|p| p.to_array()));
            let prism = format!("{name}_prism_{t:04}");
            self.asset(&format!("<mesh name=\"{prism}\" vertex=\"{vertices}\" inertia=\"shell\"/>"));
            self.line(&format!("  <geom name=\"{prism}\" {contact} type=\"mesh\" mesh=\"{prism}\"/>"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::scene;

    #[test]
    fn every_body_is_in_the_text_with_its_geometry() {
        let text = mjcf_text(&scene());
        assert_eq!(text.matches("_prism_").count(), 12 * 3, "one prism a triangle: asset, geom and its mesh");
        assert!(text.contains("type=\"box\" size=\"3 3 0.5\" pos=\"0 0 -0.5\""));
        assert!(text.contains("size=\"0.03\" condim=\"6\""));
        assert!(text.contains("type=\"box\" size=\"0.03 0.05 0.02\""));
        assert!(text.contains("type=\"cylinder\" size=\"0.03 0.05\" condim=\"6\""));
        assert_eq!(text.matches("<freejoint").count(), 5);
        assert!(text.contains("model=\"every &lt;shape&gt;\""));
        assert!(text.contains("file=\"meshes/wedge.1-a_visual.png\""));
    }

    /// Viewers show the groups 0 to 2 at first.
    #[test]
    fn every_body_can_be_seen_on_a_lit_floor() {
        let scene = scene();
        let text = mjcf_text(&scene);
        for body in &scene.bodies {
            let own = text.split(&format!("<body name=\"{}\"", body.name)).nth(1).unwrap();
            let own = own.split("</body>").next().unwrap();
            assert!(own.contains("class=\"visual\""), "{}: {own}", body.name);
        }
        let floor = text.lines().find(|l| l.contains("name=\"floor_visual\"")).unwrap();
        let material = floor.split("material=\"").nth(1).unwrap().split('"').next().unwrap();
        assert!(text.contains(&format!("<material name=\"{material}\" texture=")), "{floor}");
        assert!(floor.contains("type=\"plane\" size=\"3 3 "), "as large as the slab: {floor}");
        assert!(text.contains("<light ") && text.contains("type=\"skybox\""));
    }

    #[test]
    fn a_body_on_the_floor_has_the_mean_friction() {
        let scene = scene();
        let text = mjcf_text(&scene);
        let (a, b) = (scene.body("carton").unwrap(), scene.body("floor").unwrap());
        let mean = 0.5 * (a.material.friction.value.best + b.material.friction.value.best);
        let line = text.lines().find(|l| l.contains("<geom name=\"carton\"")).unwrap();
        assert!(
            line.contains(&format!("friction=\"{mean:.4} ")) && line.contains("priority=\"1\""),
            "{line}"
        );
    }
}
