//! Data of the interactive 3-D view: JSON with binary buffers in base64.

use crate::html::base64_of;
use crate::input::ReportInput;
use crate::landing::{planner_name, with_vehicle};
use serde_json::{Value, json};
use sms_core::Mesh;
use sms_scene::{Body, BodyShape};
use sms_task::Trajectory;

/// Largest number of Gaussians shown as points; more are thinned evenly.
const MAX_POINTS: usize = 60_000;

fn floats(values: impl IntoIterator<Item = f64>) -> String {
    let bytes: Vec<u8> = values.into_iter().flat_map(|v| (v as f32).to_le_bytes()).collect();
    base64_of(&bytes)
}

fn mesh_value(mesh: &Mesh) -> Value {
    let triangles: Vec<u8> = mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
    let colors = (mesh.colors.len() == mesh.vertices.len() && !mesh.colors.is_empty())
        .then(|| base64_of(mesh.colors.as_flattened()));
    json!({
        "v": floats(mesh.vertices.iter().flat_map(|p| p.to_array())),
        "t": base64_of(&triangles),
        "c": colors,
    })
}

fn body_value(body: &Body) -> Value {
    let t = body.x_wb.translation;
    let q = body.x_wb.rotation;
    let parts: Vec<Value> = body.shape.meshes().iter().map(mesh_value).collect();
    json!({
        "name": body.name,
        "kind": body.kind,
        "color": body.color,
        "pose": [t.x, t.y, t.z, q.x, q.y, q.z, q.w],
        "floor": matches!(body.shape, BodyShape::HalfSpace),
        "visual": (!body.visual.triangles.is_empty()).then(|| mesh_value(&body.visual)),
        "parts": parts,
    })
}

fn trajectory_value(trajectory: &Trajectory, rename: impl Fn(&str) -> Option<String>) -> Value {
    let mut bodies = serde_json::Map::new();
    for track in &trajectory.bodies {
        let Some(name) = rename(&track.name) else { continue };
        let values = track.states.iter().flat_map(|s| {
            let (t, q) = (s.x_wb.translation, s.x_wb.rotation);
            [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
        });
        bodies.insert(name, Value::String(floats(values)));
    }
    json!({ "times": floats(trajectory.times_s.iter().copied()), "bodies": bodies })
}

/// Returns the data for the page's script.
pub(crate) fn view_data(input: &ReportInput<'_>) -> Value {
    let points = input.gaussians.map(|g| {
        let stride = g.len().div_ceil(MAX_POINTS).max(1);
        let chosen: Vec<usize> = (0..g.len()).step_by(stride).collect();
        let colors: Vec<u8> = chosen
            .iter()
            .flat_map(|&i| g.colors[i].map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8))
            .collect();
        let labels: Vec<u8> = chosen.iter().flat_map(|&i| sms_masks::label_color(g.labels[i])).collect();
        json!({
            "pos": floats(chosen.iter().flat_map(|&i| g.positions_w[i].to_array().map(f64::from))),
            "size": floats(chosen.iter().map(|&i| {
                let [(_, a), (_, b)] = g.disc(i).1;
                f64::from((a * b).sqrt())
            })),
            "col": base64_of(&colors),
            "lab": base64_of(&labels),
        })
    });
    let scene = input.scene.map(|s| with_vehicle(s, input.landing.as_ref()));
    json!({
        "points": points,
        "bodies": scene.map(|s| s.bodies.iter().map(body_value).collect::<Vec<_>>()).unwrap_or_default(),
        "goal": input.goal_w,
        "striker": input.striker_half_m,
        "predicted": input.predicted().map(|t| trajectory_value(t, |n| Some(n.to_owned()))),
        "realised": input.realised().map(|(t, matches)| trajectory_value(t, |n| planner_name(matches, n))),
    })
}
