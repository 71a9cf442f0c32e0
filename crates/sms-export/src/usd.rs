//! OpenUSD as text, with the physics schemas of UsdPhysics.
//!
//! PhysX, which Isaac Sim uses, takes the mean of a pair's friction and restitution as we do: values are exported
//! unchanged.

use crate::surface::{GROUND_HALF_EDGE, SplitMesh, split};
use crate::text::{linear, number, principal, small};
use glamx::{DQuat, DVec3};
use sms_core::{CoreError, Mesh, atomic, write_png_color};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::Path;

/// Writes `scene.usda` and the images in `textures/`.
pub(crate) fn write(dir: &Path, scene: &Scene) -> Result<(), CoreError> {
    for body in &scene.bodies {
        if let Some(texture) = &body.texture {
            write_png_color(&dir.join(texture_file(body)), &texture.image)?;
        }
    }
    atomic::write_bytes(&dir.join("scene.usda"), text(scene).as_bytes())
}

fn texture_file(body: &Body) -> String {
    format!("textures/{}.png", body.name)
}

/// Returns prim names (letters, digits and underscores, not beginning with a digit), unique, parallel to the bodies.
pub(crate) fn prim_names(scene: &Scene) -> Vec<String> {
    let mut taken: BTreeSet<String> = ["PhysicsScene", "Materials"].map(String::from).into();
    let mut names = Vec::with_capacity(scene.bodies.len());
    for body in &scene.bodies {
        let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        let mut name: String = body.name.chars().map(plain).collect();
        if name.starts_with(|c: char| c.is_ascii_digit()) {
            name.insert(0, '_');
        }
        while !taken.insert(name.clone()) {
            name.push('_');
        }
        names.push(name);
    }
    names
}

fn text(scene: &Scene) -> String {
    let g = scene.gravity_w;
    let names = prim_names(scene);
    let named = || scene.bodies.iter().zip(&names);
    let mut w = UsdWriter { text: String::new(), depth: 1 };
    for (body, name) in named() {
        w.body(body, name);
    }
    format!(
        include_str!("../assets/scene.usda"),
        doc = quoted(&format!("Written by sms: {}", scene.name)),
        direction = tuple(g.normalize_or(DVec3::NEG_Z).to_array()),
        magnitude = number(g.length()),
        materials = named().map(|(body, name)| materials(body, name)).collect::<String>(),
        bodies = w.text,
    )
}

/// Returns the physical material, and a preview surface with the colour of the texture, else of the mesh's vertices.
fn materials(body: &Body, name: &str) -> String {
    let (source, shaders) = if body.texture.is_some() {
        let file = texture_file(body);
        let shaders = format!(include_str!("../assets/picture_shaders.usda"), name = name, file = file);
        ("Picture.outputs:rgb", shaders)
    } else {
        ("Color.outputs:result", include_str!("../assets/color_shader.usda").to_owned())
    };
    format!(
        include_str!("../assets/material.usda"),
        name = name,
        density = number(body.material.effective_density()),
        friction = number(body.material.friction.value.best),
        restitution = number(body.material.restitution.value.best),
        source = source,
        shaders = shaders,
    )
}

fn tuple<const N: usize>(values: [f64; N]) -> String {
    format!("({})", values.map(number).join(", "))
}

fn quoted(text: &str) -> String {
    let text = text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', " ");
    format!("\"{text}\"")
}

fn quaternion(q: DQuat) -> String {
    tuple([q.w, q.x, q.y, q.z])
}

/// Formats an array of tuples of `f32` with the shortest digits that read back the same.
fn tuples<const N: usize>(values: impl Iterator<Item = [f32; N]>) -> String {
    let all: Vec<String> = values.map(|v| format!("({})", v.map(|x| x.to_string()).join(", "))).collect();
    format!("[{}]", all.join(", "))
}

fn linear_color(color: [u8; 3]) -> [f32; 3] {
    color.map(|c| linear(c) as f32)
}

struct UsdWriter {
    text: String,
    depth: usize,
}

impl UsdWriter {
    fn line(&mut self, line: &str) {
        let _ = writeln!(self.text, "{:1$}{line}", "", 4 * self.depth);
    }

    /// Opens a prim with metadata.
    fn open(&mut self, header: &str, metadata: &[&str]) {
        if metadata.is_empty() {
            self.line(header);
        } else {
            self.line(&format!("{header} ("));
            self.depth += 1;
            for entry in metadata {
                self.line(entry);
            }
            self.depth -= 1;
            self.line(")");
        }
        self.line("{");
        self.depth += 1;
    }

    fn close(&mut self) {
        self.depth -= 1;
        self.line("}");
    }

    fn body(&mut self, body: &Body, name: &str) {
        let moves = body.kind == BodyKind::Dynamic;
        let apis = "prepend apiSchemas = [\"PhysicsRigidBodyAPI\", \"PhysicsMassAPI\"]";
        let doc = format!("doc = {}", quoted(&body.description));
        let mut metadata = vec!["kind = \"component\""];
        if !body.description.is_empty() {
            metadata.push(&doc);
        }
        if moves {
            metadata.push(apis);
        }
        self.open(&format!("def Xform \"{name}\""), &metadata);
        if let Some(mass) = body.mass.as_ref().filter(|_| moves) {
            let (moments, axes) = principal(mass);
            self.line(&format!("point3f physics:centerOfMass = {}", tuple(mass.com().to_array())));
            let moments = moments.to_array().map(small).join(", ");
            self.line(&format!("float3 physics:diagonalInertia = ({moments})"));
            self.line(&format!("float physics:mass = {}", number(mass.mass())));
            self.line(&format!("quatf physics:principalAxes = {}", quaternion(axes)));
        }
        self.line(&format!("quatd xformOp:orient = {}", quaternion(body.x_wb.rotation)));
        self.line(&format!("double3 xformOp:translate = {}", tuple(body.x_wb.translation.to_array())));
        self.line("uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\"]");
        let has_visual = !body.visual.triangles.is_empty();
        if has_visual {
            self.visual(body, name);
        }
        self.collision(body, name, has_visual);
        self.close();
    }

    fn visual(&mut self, body: &Body, name: &str) {
        let surface = split(&body.visual, body.texture.as_ref());
        self.open("def Mesh \"visual\"", &["prepend apiSchemas = [\"MaterialBindingAPI\"]"]);
        self.line(&format!("rel material:binding = </World/Materials/{name}_look>"));
        // Static surfaces are open, so their back is visible.
        self.line(&format!("uniform bool doubleSided = {}", u8::from(body.kind == BodyKind::Static)));
        self.mesh(&surface);
        if !surface.uv.is_empty() {
            let st = tuples(surface.uv.iter().copied());
            self.line(&format!("texCoord2f[] primvars:st = {st} (interpolation = \"vertex\")"));
        } else if surface.colors.is_empty() {
            self.color(body.color);
        } else {
            let colors = tuples(surface.colors.iter().map(|&c| linear_color(c)));
            self.line(&format!("color3f[] primvars:displayColor = {colors} (interpolation = \"vertex\")"));
        }
        self.close();
    }

    fn color(&mut self, color: [u8; 3]) {
        let one = tuples([linear_color(color)].into_iter());
        self.line(&format!("color3f[] primvars:displayColor = {one}"));
    }

    /// Writes topology, points, normals and extent.
    fn mesh(&mut self, surface: &SplitMesh) {
        self.extent(surface.positions.iter().copied());
        let indices: Vec<String> = surface.indices.iter().map(u32::to_string).collect();
        self.line(&format!("int[] faceVertexCounts = [{}]", vec!["3"; indices.len() / 3].join(", ")));
        self.line(&format!("int[] faceVertexIndices = [{}]", indices.join(", ")));
        if !surface.normals.is_empty() {
            let normals = tuples(surface.normals.iter().copied());
            self.line(&format!("normal3f[] normals = {normals} (interpolation = \"vertex\")"));
        }
        self.line(&format!("point3f[] points = {}", tuples(surface.positions.iter().copied())));
        self.line("uniform token subdivisionScheme = \"none\"");
    }

    fn extent(&mut self, points: impl Iterator<Item = [f32; 3]> + Clone) {
        let bound = |pick: fn(f32, f32) -> f32, start: f32| {
            [0, 1, 2].map(|k| points.clone().map(|p| p[k]).fold(start, pick))
        };
        let corners = [bound(f32::min, f32::INFINITY), bound(f32::max, f32::NEG_INFINITY)];
        self.line(&format!("float3[] extent = {}", tuples(corners.into_iter())));
    }

    /// Writes collision prims: guides if there is a visual mesh, else visible.
    fn collision(&mut self, body: &Body, name: &str, hidden: bool) {
        self.open("def Scope \"collision\"", &[]);
        let purpose = if hidden { "guide" } else { "default" };
        let prim = |w: &mut Self, kind: &str, prim_name: &str, mesh_api: &str, fill: &dyn Fn(&mut Self)| {
            let apis =
                format!("prepend apiSchemas = [\"PhysicsCollisionAPI\", {mesh_api}\"MaterialBindingAPI\"]");
            w.open(&format!("def {kind} \"{prim_name}\""), &[&apis]);
            w.line(&format!("uniform token purpose = \"{purpose}\""));
            w.line(&format!("rel material:binding:physics = </World/Materials/{name}_physics>"));
            if !hidden {
                w.line(&format!("rel material:binding = </World/Materials/{name}_look>"));
                w.color(body.color);
            }
            fill(w);
            w.close();
        };
        let corners = |half: DVec3| [-half, half].map(|v| v.as_vec3().to_array());
        match &body.shape {
            BodyShape::Sphere { radius } => prim(self, "Sphere", "sphere", "", &|w| {
                w.extent(corners(DVec3::splat(*radius)).into_iter());
                w.line(&format!("double radius = {}", number(*radius)));
            }),
            BodyShape::Box { half_extents } => prim(self, "Cube", "box", "", &|w| {
                w.extent(corners(DVec3::ONE).into_iter());
                w.line("double size = 2");
                w.line(&format!("double3 xformOp:scale = {}", tuple(half_extents.to_array())));
                w.line("uniform token[] xformOpOrder = [\"xformOp:scale\"]");
            }),
            BodyShape::Cylinder { radius, half_length } => prim(self, "Cylinder", "cylinder", "", &|w| {
                w.line("uniform token axis = \"Z\"");
                w.extent(corners(DVec3::new(*radius, *radius, *half_length)).into_iter());
                w.line(&format!("double height = {}", number(2.0 * half_length)));
                w.line(&format!("double radius = {}", number(*radius)));
            }),
            // The collider is infinite; the edge lengths are for display.
            BodyShape::HalfSpace => prim(self, "Plane", "half_space", "", &|w| {
                w.line("uniform token axis = \"Z\"");
                w.extent(corners(DVec3::new(GROUND_HALF_EDGE, GROUND_HALF_EDGE, 0.0)).into_iter());
                w.line(&format!("double length = {}", number(2.0 * GROUND_HALF_EDGE)));
                w.line(&format!("double width = {}", number(2.0 * GROUND_HALF_EDGE)));
            }),
            BodyShape::Hulls { hulls } => {
                for (i, hull) in hulls.iter().enumerate() {
                    prim(self, "Mesh", &format!("hull_{i:02}"), "\"PhysicsMeshCollisionAPI\", ", &|w| {
                        w.line("uniform token physics:approximation = \"convexHull\"");
                        w.mesh(&plain(hull));
                    });
                }
            }
            BodyShape::TriMesh { mesh } => {
                prim(self, "Mesh", "mesh", "\"PhysicsMeshCollisionAPI\", ", &|w| {
                    w.line("uniform token physics:approximation = \"none\"");
                    w.mesh(&plain(mesh));
                })
            }
        }
        self.close();
    }
}

/// Returns a mesh unchanged, without normals.
fn plain(mesh: &Mesh) -> SplitMesh {
    SplitMesh {
        positions: mesh.vertices.iter().map(|v| v.as_vec3().to_array()).collect(),
        indices: mesh.triangles.as_flattened().to_vec(),
        ..SplitMesh::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::scene;

    #[test]
    fn prims_have_valid_unique_names() {
        let mut scene = scene();
        for (body, name) in scene.bodies.iter_mut().zip(["1", "a-b", "a.b", "Materials", "a_b"]) {
            body.name = name.into();
        }
        assert_eq!(prim_names(&scene)[..5], ["_1", "a_b", "a_b_", "Materials_", "a_b__"]);
    }

    #[test]
    fn each_shape_has_its_prim_and_braces_match() {
        let text = text(&scene());
        for prim in ["Sphere \"sphere\"", "Cube \"box\"", "Cylinder \"cylinder\"", "Plane \"half_space\""] {
            assert!(text.contains(&format!("def {prim}")), "{prim}");
        }
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        assert_eq!(text.matches("PhysicsRigidBodyAPI").count(), 5);
        assert_eq!(text.matches("physics:approximation = \"convexHull\"").count(), 1);
        assert_eq!(text.matches("physics:approximation = \"none\"").count(), 1);
        assert_eq!(text.matches("@./textures/wedge.1-a.png@").count(), 1);
    }
}
