//! `bodies.json`: the machine-readable list of bodies in every export.

use crate::Format;
use crate::text::principal;
use glamx::{DPose3, DQuat, DVec3};
use serde_json::{Value, json};
use sms_core::{Material, Property};
use sms_scene::{Body, BodyKind, BodyShape, Scene, hull_file, trimesh_file, visual_file};

fn wxyz(q: DQuat) -> [f64; 4] {
    [q.w, q.x, q.y, q.z]
}

fn pose(pose: &DPose3) -> Value {
    json!({ "position_m": pose.translation.to_array(), "quaternion_wxyz": wxyz(pose.rotation) })
}

fn shape(body: &Body, format: Format) -> Value {
    let at = format.mesh_folder(body);
    match &body.shape {
        BodyShape::Hulls { hulls } => {
            let mut shape = json!({ "type": "hulls" });
            if let Some(at) = at.filter(|_| !hulls.is_empty()) {
                let files = (0..hulls.len()).map(|i| format!("{at}{}", hull_file(body, i)));
                shape["files"] = files.collect();
            }
            shape["count"] = hulls.len().into();
            shape
        }
        BodyShape::TriMesh { .. } => {
            let mut shape = json!({ "type": "tri_mesh" });
            if let Some(at) = at {
                shape["file"] = format!("{at}{}", trimesh_file(body)).into();
            }
            shape
        }
        primitive => json!(primitive),
    }
}

fn body_value(body: &Body, format: Format, has_gaussians: bool) -> Value {
    let mut value = json!({
        "name": body.name,
        "description": body.description,
        "kind": body.kind,
        "pose_world": pose(&body.x_wb),
        "shape": shape(body, format),
    });
    if let Some(at) = format.mesh_folder(body).filter(|_| !body.visual.triangles.is_empty()) {
        let visual = format!("{at}{}", visual_file(body));
        value["visual"] = visual.as_str().into();
        if body.texture.is_some() {
            value["picture"] = visual.replace(".obj", ".png").into();
        }
    }
    if let Some(mass) = &body.mass {
        let (moments, axes) = principal(mass);
        value["mass"] = json!(mass);
        value["principal"] = json!({ "moments_kg_m2": moments.to_array(), "axes_wxyz": wxyz(axes) });
    }
    value["material"] = json!(body.material);
    value["color_srgb"] = json!(body.color);
    value["observed_share"] = json!(body.observed_share);
    if has_gaussians {
        value["gaussians"] = format!("gaussians/{}.ply", body.name).into();
    }
    value
}

/// Returns the content of the file; `gaussians` names the bodies with exported Gaussians.
pub(crate) fn bodies_json(scene: &Scene, format: Format, gaussians: &[String]) -> Value {
    let entry = |body: &Body| body_value(body, format, gaussians.contains(&body.name));
    json!({
        "format": format.name(),
        "scene": scene.name,
        "units": "metre, kilogram, second, radian",
        "frames": "world: z up; a moving body's frame has its origin at the centre of mass; \
                   inertia about the centre of mass in the axes of the body frame",
        "gravity_w": scene.gravity_w.to_array(),
        "x_world_recording": pose(&scene.x_world_recording),
        "bodies": scene.bodies.iter().map(entry).collect::<Vec<_>>(),
    })
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
