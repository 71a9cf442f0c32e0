//! Data of the interactive 3-D view: JSON with binary buffers in base64.

use crate::floor::floor_image;
use crate::html::base64_of;
use crate::input::ReportInput;
use crate::landing::{planner_name, with_vehicle};
use crate::photo::{RecordedView, photo_address};
use crate::splats::splats_value;
use crate::textures::{fitting, texture_addresses};
use glamx::DPose3;
use serde_json::{Value, json};
use sms_core::{BACKGROUND, Mesh, MeshTexture};
use sms_scene::{Body, BodyShape};
use sms_task::Trajectory;

/// How much the view contains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Detail {
    /// Largest number of Gaussians; more are thinned evenly.
    pub splats: usize,
    /// Largest size of all textures of bodies, bytes.
    pub texture_bytes: usize,
    /// Largest number of recorded views.
    pub views: usize,
    /// Whether the convex parts of the bodies are included.
    pub convex_parts: bool,
}

fn floats(values: impl IntoIterator<Item = f64>) -> String {
    let bytes: Vec<u8> = values.into_iter().flat_map(|v| (v as f32).to_le_bytes()).collect();
    base64_of(&bytes)
}

fn shorts(values: impl IntoIterator<Item = u16>) -> String {
    let bytes: Vec<u8> = values.into_iter().flat_map(u16::to_le_bytes).collect();
    base64_of(&bytes)
}

/// Encodes vertices (f32), triangles (u16 or u32, as `wide` says), and colours or texture coordinates (u16, 65535 is 1).
fn mesh_value(mesh: &Mesh, texture: Option<&MeshTexture>) -> Value {
    let indices = || mesh.triangles.iter().flatten();
    let narrow: Option<Vec<u16>> = indices().map(|&i| u16::try_from(i).ok()).collect();
    let wide = || base64_of(&indices().flat_map(|i| i.to_le_bytes()).collect::<Vec<u8>>());
    let is_wide = narrow.is_none();
    let colors = (texture.is_none() && mesh.colors.len() == mesh.vertices.len() && !mesh.colors.is_empty())
        .then(|| base64_of(mesh.colors.as_flattened()));
    let short = |v: &f32| (65535.0 * v.clamp(0.0, 1.0)).round() as u16;
    json!({
        "v": floats(mesh.vertices.iter().flat_map(|p| p.to_array())),
        "t": narrow.map_or_else(wide, shorts),
        "wide": is_wide,
        "c": colors,
        "uv": texture.map(|t| shorts(t.corner_uv.as_flattened().as_flattened().iter().map(short))),
    })
}

fn pose_value(pose: &DPose3) -> Value {
    let (t, q) = (pose.translation, pose.rotation);
    json!([t.x, t.y, t.z, q.x, q.y, q.z, q.w])
}

fn body_value(body: &Body, picture: Option<&String>, role: Option<&str>, convex_parts: bool) -> Value {
    let texture = picture.and(body.texture.as_ref()).and_then(|t| fitting(&body.visual, t));
    let shapes = if convex_parts { body.shape.meshes() } else { Vec::new() };
    let parts: Vec<Value> = shapes.iter().map(|m| mesh_value(m, None)).collect();
    let visual = (!body.visual.triangles.is_empty()).then(|| mesh_value(&body.visual, texture));
    json!({
        "name": body.name,
        "role": role,
        "kind": body.kind,
        "color": body.color,
        "label": (body.label != BACKGROUND).then(|| sms_masks::label_color(body.label)),
        "pose": pose_value(&body.x_wb),
        "floor": matches!(body.shape, BodyShape::HalfSpace),
        "visual": visual,
        "picture": picture,
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

/// Encodes the cameras and photographs. The first photograph is already in the page.
fn views_value(views: &[RecordedView], limit: usize) -> Vec<Value> {
    let stride = views.len().div_ceil(limit.max(1)).max(1);
    let chosen = views.iter().enumerate().step_by(stride);
    chosen
        .map(|(k, view)| {
            let i = view.camera.intrinsics;
            json!({
                "frame": view.frame_index,
                "held_out": view.held_out,
                "pose": pose_value(&view.camera.x_wc),
                "lens": [i.width as f64, i.height as f64, i.fx, i.fy, i.cx, i.cy],
                "photo": (k > 0).then(|| photo_address(&view.photo)),
            })
        })
        .collect()
}

/// Returns the image of the floor as data of the page; `None` if no view shows it.
pub(crate) fn floor_value(input: &ReportInput<'_>) -> Option<Value> {
    let body = input.scene?.bodies.iter().find(|b| matches!(b.shape, BodyShape::HalfSpace))?;
    let floor = floor_image(&input.recorded, &body.x_wb)?;
    Some(json!({
        "low": floor.low,
        "high": floor.high,
        "mean": floor.mean,
        "picture": photo_address(&floor.image),
    }))
}

/// Returns the data for the page's script. `floor` comes from [`floor_value`]; it is the same for all details.
pub(crate) fn view_data(input: &ReportInput<'_>, detail: &Detail, floor: Option<&Value>) -> Value {
    let scene = input.scene.map(|s| with_vehicle(s, input.landing.as_ref()));
    let bodies = scene.as_deref().map(|s| s.bodies.as_slice()).unwrap_or_default();
    let pictures = texture_addresses(bodies, detail.texture_bytes);
    let role = |name: &str| input.roles.iter().find(|r| r.0 == name).map(|r| r.1.as_str());
    let of_body =
        |(b, p): (&Body, &Option<String>)| body_value(b, p.as_ref(), role(&b.name), detail.convex_parts);
    let bodies: Vec<Value> = bodies.iter().zip(&pictures).map(of_body).collect();
    json!({
        "splats": input.gaussians.and_then(|g| splats_value(g, detail.splats)),
        "bodies": bodies,
        "floor": floor,
        "views": views_value(&input.recorded, detail.views),
        "goal": input.goal_w,
        "striker": input.striker_half_m,
        "predicted": input.predicted().map(|t| trajectory_value(t, |n| Some(n.to_owned()))),
        "realised": input.realised().map(|(t, matches)| trajectory_value(t, |n| planner_name(matches, n))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec3;
    use sms_core::{Camera, Image, Intrinsics};
    use sms_scene::{Scene, example_material, floor_body};

    const ALL: Detail = Detail { splats: 100, texture_bytes: usize::MAX, views: 12, convex_parts: true };

    fn view_data(input: &ReportInput<'_>, detail: &Detail) -> Value {
        super::view_data(input, detail, floor_value(input).as_ref())
    }

    fn scene(texture: Option<MeshTexture>) -> Scene {
        let mut visual = Mesh::cuboid(DVec3::splat(0.05));
        visual.colors = vec![[1, 2, 3]; 8];
        let duck =
            Body { name: "duck".into(), label: 3, visual, texture, ..floor_body(0.0, example_material()) };
        let bodies = vec![
            floor_body(0.0, example_material()),
            Body { shape: BodyShape::Sphere { radius: 0.1 }, ..duck },
        ];
        Scene {
            version: 1,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z * 9.81,
            size_sigma: 0.0,
            x_world_recording: DPose3::IDENTITY,
            bodies,
        }
    }

    #[test]
    fn a_textured_body_is_sent_with_its_picture_and_others_with_their_colours() {
        let image = Image::filled(16, 16, [200, 100, 50]);
        let texture = MeshTexture { corner_uv: vec![[[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]]; 12], image };
        let textured = scene(Some(texture));
        let input = ReportInput { scene: Some(&textured), ..ReportInput::default() };
        let value = view_data(&input, &ALL);
        let body = &value["bodies"][1];
        assert!(body["picture"].as_str().unwrap().starts_with("data:image/jpeg;base64,"));
        // 12 triangles, three corners, two numbers of two bytes.
        assert_eq!(body["visual"]["uv"].as_str().unwrap().len(), (12 * 3 * 2 * 2) / 3 * 4);
        assert!(body["visual"]["c"].is_null() && body["visual"]["wide"] == false);
        assert_eq!(body["label"], json!(sms_masks::label_color(3)));
        assert!(value["bodies"][0]["label"].is_null(), "the floor is no object");

        // The sphere is one convex part.
        assert_eq!(body["parts"].as_array().unwrap().len(), 1);
        let without = view_data(&input, &Detail { convex_parts: false, ..ALL });
        assert_eq!(without["bodies"][1]["parts"], json!([]));
        assert_eq!(without["bodies"][1]["visual"], body["visual"]);

        // Without room for pictures, and without a texture, the colours of the vertices are sent.
        let plain = scene(None);
        let untextured = ReportInput { scene: Some(&plain), ..ReportInput::default() };
        let small = Detail { texture_bytes: 10, ..ALL };
        for value in [view_data(&input, &small), view_data(&untextured, &ALL)] {
            let body = &value["bodies"][1];
            assert!(body["picture"].is_null() && body["visual"]["uv"].is_null());
            assert_eq!(body["visual"]["c"].as_str().unwrap().len(), 32);
        }
    }

    #[test]
    fn the_first_recorded_camera_comes_first_with_its_pose_and_lens() {
        let view = |k: usize| RecordedView {
            frame_index: 5 * k,
            held_out: k == 1,
            camera: Camera::new(
                Intrinsics::from_fov(40, 30, 1.0),
                DPose3::from_translation(DVec3::new(k as f64, 2.0, 3.0)),
            ),
            photo: Image::filled(80, 60, [k as u8; 3]),
            depth: Image::filled(40, 30, 1.0),
            labels: Image::filled(40, 30, 0),
        };
        let input = ReportInput { recorded: (0..4).map(view).collect(), ..ReportInput::default() };
        let data = view_data(&input, &Detail { views: 2, ..ALL });
        let views = data["views"].as_array().unwrap();
        assert_eq!(views.iter().map(|v| v["frame"].as_u64().unwrap()).collect::<Vec<_>>(), [0, 10]);
        assert_eq!(views[0]["pose"], json!([0.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]));
        assert_eq!(views[0]["lens"].as_array().unwrap()[..2], [json!(40.0), json!(30.0)]);
        assert!(views[0]["photo"].is_null(), "the page holds the first photograph already");
        assert!(views[1]["photo"].as_str().unwrap().starts_with("data:image/jpeg;base64,"));
    }
}
