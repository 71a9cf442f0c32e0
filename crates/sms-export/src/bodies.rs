//! `bodies.json`: the machine-readable list of bodies in every export.

use crate::Format;
use crate::text::principal;
use glamx::{DPose3, DVec3};
use serde::Serialize;
use sms_core::{MassProperties, Material, Property};
use sms_scene::{Body, BodyKind, BodyShape, Scene, hull_file, trimesh_file, visual_file};

#[derive(Serialize)]
struct BodiesFile<'a> {
    format: &'static str,
    scene: &'a str,
    units: &'static str,
    frames: &'static str,
    gravity_w: [f64; 3],
    x_world_recording: PoseEntry,
    bodies: Vec<ExportedBody<'a>>,
}

#[derive(Serialize)]
struct PoseEntry {
    position_m: [f64; 3],
    quaternion_wxyz: [f64; 4],
}

#[derive(Serialize)]
struct PrincipalEntry {
    moments_kg_m2: [f64; 3],
    axes_wxyz: [f64; 4],
}

#[derive(Serialize)]
struct ExportedBody<'a> {
    name: &'a str,
    description: &'a str,
    kind: BodyKind,
    pose_world: PoseEntry,
    shape: ExportedShape,
    #[serde(skip_serializing_if = "Option::is_none")]
    visual: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    picture: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mass: Option<MassProperties>,
    #[serde(skip_serializing_if = "Option::is_none")]
    principal: Option<PrincipalEntry>,
    material: &'a Material,
    color_srgb: [u8; 3],
    observed_share: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    gaussians: Option<String>,
}

#[derive(Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum ExportedShape {
    Sphere {
        radius: f64,
    },
    Box {
        half_extents: [f64; 3],
    },
    Cylinder {
        radius: f64,
        half_length: f64,
    },
    HalfSpace,
    Hulls {
        #[serde(skip_serializing_if = "Vec::is_empty")]
        files: Vec<String>,
        count: usize,
    },
    TriMesh {
        #[serde(skip_serializing_if = "Option::is_none")]
        file: Option<String>,
    },
}

fn pose(pose: &DPose3) -> PoseEntry {
    let q = pose.rotation;
    PoseEntry { position_m: pose.translation.to_array(), quaternion_wxyz: [q.w, q.x, q.y, q.z] }
}

fn principal_entry(mass: &MassProperties) -> PrincipalEntry {
    let (moments, q) = principal(mass);
    PrincipalEntry { moments_kg_m2: moments.to_array(), axes_wxyz: [q.w, q.x, q.y, q.z] }
}

fn shape(body: &Body, format: Format) -> ExportedShape {
    let at = format.mesh_folder(body);
    match &body.shape {
        BodyShape::Sphere { radius } => ExportedShape::Sphere { radius: *radius },
        BodyShape::Box { half_extents } => ExportedShape::Box { half_extents: half_extents.to_array() },
        BodyShape::Cylinder { radius, half_length } => {
            ExportedShape::Cylinder { radius: *radius, half_length: *half_length }
        }
        BodyShape::HalfSpace => ExportedShape::HalfSpace,
        BodyShape::Hulls { hulls } => ExportedShape::Hulls {
            files: at.map_or_else(Vec::new, |at| {
                (0..hulls.len()).map(|i| format!("{at}{}", hull_file(body, i))).collect()
            }),
            count: hulls.len(),
        },
        BodyShape::TriMesh { .. } => {
            ExportedShape::TriMesh { file: at.map(|at| format!("{at}{}", trimesh_file(body))) }
        }
    }
}

/// Returns the content of the file; `gaussians` names the bodies with exported Gaussians.
pub(crate) fn bodies_json<'a>(
    scene: &'a Scene,
    format: Format,
    gaussians: &[String],
) -> impl Serialize + use<'a> {
    let entry = |body: &'a Body| {
        let Body { name, description, kind, x_wb, visual, mass, material, color, observed_share, .. } = body;
        let visual_path = (format.mesh_folder(body).filter(|_| !visual.triangles.is_empty()))
            .map(|at| format!("{at}{}", visual_file(body)));
        ExportedBody {
            name,
            description,
            kind: *kind,
            pose_world: pose(x_wb),
            shape: shape(body, format),
            picture: visual_path
                .as_ref()
                .filter(|_| body.texture.is_some())
                .map(|p| p.replace(".obj", ".png")),
            visual: visual_path,
            mass: *mass,
            principal: mass.as_ref().map(principal_entry),
            material,
            color_srgb: *color,
            observed_share: *observed_share,
            gaussians: gaussians.contains(name).then(|| format!("gaussians/{name}.ply")),
        }
    };
    BodiesFile {
        format: format.name(),
        scene: &scene.name,
        units: "metre, kilogram, second, radian",
        frames: "world: z up; a moving body's frame has its origin at the centre of mass; \
                 inertia about the centre of mass in the axes of the body frame",
        gravity_w: scene.gravity_w.to_array(),
        x_world_recording: pose(&scene.x_world_recording),
        bodies: scene.bodies.iter().map(entry).collect(),
    }
}

/// Returns the rows of the table of bodies in the README.
pub(crate) fn table(scene: &Scene) -> String {
    let mut text = String::from(
        "| body | kind | shape | size, mm | mass, kg | density, kg/m³ | friction | restitution | rolling lever, mm | seen |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for body in &scene.bodies {
        let m = &body.material;
        let kind = match body.kind {
            BodyKind::Dynamic => "moves",
            BodyKind::Static => "fixed",
        };
        let mass = body.mass.map_or_else(|| "–".into(), |mass| format!("{:.4}", mass.mass()));
        text.push_str(&format!(
            "| `{}` | {kind} | {} | {} | {mass} | {} | {} | {} | {} | {:.0} % |\n",
            body.name,
            shape_text(&body.shape),
            size_text(body),
            density_text(m),
            property(&m.friction, 1.0),
            property(&m.restitution, 1.0),
            property(&m.rolling_m, 1e3),
            100.0 * body.observed_share,
        ));
    }
    text
}

fn shape_text(shape: &BodyShape) -> String {
    match shape {
        BodyShape::Sphere { .. } => "sphere".into(),
        BodyShape::Box { .. } => "box".into(),
        BodyShape::Cylinder { .. } => "cylinder".into(),
        BodyShape::HalfSpace => "half space below z = 0 of its frame".into(),
        BodyShape::Hulls { hulls } if hulls.len() == 1 => "1 convex part".into(),
        BodyShape::Hulls { hulls } => format!("{} convex parts", hulls.len()),
        BodyShape::TriMesh { mesh } => format!("mesh of {} triangles", mesh.triangles.len()),
    }
}

fn size_text(body: &Body) -> String {
    let extents = match &body.shape {
        BodyShape::Sphere { radius } => DVec3::splat(2.0 * radius),
        BodyShape::Box { half_extents } => 2.0 * *half_extents,
        BodyShape::Cylinder { radius, half_length } => {
            DVec3::new(2.0 * radius, 2.0 * radius, 2.0 * half_length)
        }
        BodyShape::HalfSpace => return "–".into(),
        BodyShape::Hulls { .. } | BodyShape::TriMesh { .. } => {
            let corners = body.shape.meshes().into_iter().filter_map(|m| m.aabb());
            let all = sms_core::Aabb::of_points(corners.flat_map(|b| [b.min, b.max]));
            all.map_or(DVec3::ZERO, |b| b.extents())
        }
    };
    let [x, y, z] = (1e3 * extents).to_array();
    format!("{x:.1} × {y:.1} × {z:.1}")
}

fn density_text(m: &Material) -> String {
    let share = &m.fill_factor.value;
    let filled = if share.low == 1.0 && share.best == 1.0 {
        String::new()
    } else {
        format!(", filled to {}", property(&m.fill_factor, 1.0))
    };
    format!("{}{filled}", property(&m.density, 1.0))
}

fn property(p: &Property, unit: f64) -> String {
    let v = p.value;
    let round = |x: f64| {
        let x = x * unit;
        if x >= 100.0 { format!("{x:.0}") } else { format!("{}", (x * 1e3).round() / 1e3) }
    };
    let source = format!("{:?}", p.source).to_lowercase();
    if v.low == v.high {
        return format!("{} ({source})", round(v.best));
    }
    format!("{} [{}, {}] ({source})", round(v.best), round(v.low), round(v.high))
}
