//! The table of the objects.

use crate::html::rgb;
use crate::input::ReportInput;
use serde_json::Value;
use sms_core::metrics::Metrics;
use sms_core::{BACKGROUND, Interval, escape_xml};
use sms_scene::{Body, BodyShape};
use std::fmt::Write;

/// Formats a comparison of the body with this name; empty if it was not compared.
type CheckText = fn(&Metrics, &str) -> String;
/// The head of a column, and its text.
type Check = (&'static str, CheckText);

/// Returns the section; empty without a scene.
pub(crate) fn objects_section(input: &ReportInput<'_>) -> String {
    let Some(scene) = input.scene else { return String::new() };
    let checks: [Check; 2] = [("recorded depth", depth_text), ("error to the known model", truth_text)];
    let has = |text: CheckText| scene.bodies.iter().any(|body| !text(&input.metrics, &body.name).is_empty());
    let checks: Vec<Check> = checks.into_iter().filter(|(_, text)| has(*text)).collect();
    let mut heads = vec!["object", "shape", "material", "mass", "friction", "restitution", "observed"];
    heads.extend(checks.iter().map(|(head, _)| *head));
    let heads: String = heads.iter().map(|h| format!("<th scope=\"col\">{h}</th>")).collect();
    let mut html = format!(
        "<section id=\"section-objects\"><h2>Objects</h2><div class=\"scroll\" tabindex=\"0\" role=\"region\" \
         aria-label=\"table of the objects\"><table class=\"bodies\"><thead><tr>{heads}</tr></thead><tbody>"
    );
    for body in &scene.bodies {
        row(&mut html, input, body, &checks);
    }
    html.push_str("</tbody></table></div></section>");
    html
}

fn shape_text(shape: &BodyShape) -> String {
    match shape {
        BodyShape::Sphere { radius } => format!("sphere, r = {:.2} mm", radius * 1e3),
        BodyShape::Box { half_extents } => {
            let [x, y, z] = (2e3 * *half_extents).to_array();
            format!("box, {x:.1} × {y:.1} × {z:.1} mm")
        }
        BodyShape::Cylinder { radius, half_length } => {
            format!("cylinder, r = {:.2} mm, {:.1} mm long", radius * 1e3, half_length * 2e3)
        }
        BodyShape::HalfSpace => "half space".into(),
        BodyShape::Hulls { hulls } if hulls.len() == 1 => "1 convex part".into(),
        BodyShape::Hulls { hulls } => format!("{} convex parts", hulls.len()),
        BodyShape::TriMesh { mesh } => format!("static mesh, {} triangles", mesh.triangles.len()),
    }
}

fn row(html: &mut String, input: &ReportInput<'_>, body: &Body, checks: &[Check]) {
    let m = &body.material;
    let role = input.roles.iter().find(|r| r.0 == body.name).map(|r| r.1.as_str());
    let role = role.map(|r| format!(" <span class=\"tag\">{}</span>", escape_xml(r))).unwrap_or_default();
    let mass = body.mass.map(|p| format!("{:.0} g", p.mass() * 1e3)).unwrap_or_else(|| "static".into());
    let interval = |v: Interval| format!("{:.2} <small>[{:.2}, {:.2}]</small>", v.best, v.low, v.high);
    let source = serde_json::to_value(m.density.source).ok();
    let source = source.as_ref().and_then(Value::as_str).unwrap_or("");
    // The colour of an object in the labelled picture; the surroundings have their own.
    let color = if body.label == BACKGROUND { body.color } else { sms_masks::label_color(body.label) };
    let name = escape_xml(&body.name);
    let _ = write!(
        html,
        "<tr data-body=\"{name}\" tabindex=\"0\"><th scope=\"row\"><span class=\"swatch\" style=\"background:{}\"></span> \
         {name}{role}</th><td>{}</td><td>{} <small>({source})</small></td><td>{mass}</td><td>{}</td><td>{}</td>\
         <td>{:.0} %</td>",
        rgb(color),
        shape_text(&body.shape),
        escape_xml(&m.class),
        interval(m.friction.value),
        interval(m.restitution.value),
        100.0 * body.observed_share
    );
    for (_, text) in checks {
        let _ = write!(html, "<td>{}</td>", text(&input.metrics, &body.name));
    }
    html.push_str("</tr>");
}

/// Formats the agreement of a body with the recorded depth of the pixels in which it is the first surface of the scene; empty if
/// there are none.
fn depth_text(metrics: &Metrics, name: &str) -> String {
    let get = |key: &str| metrics.number(&format!("evaluate.{name}.depth_{key}"));
    match (get("agrees"), get("false_surface")) {
        (Some(agrees), Some(wrong)) => {
            format!("{:.0} % on it, {:.0} % behind it", 100.0 * agrees, 100.0 * wrong)
        }
        _ => String::new(),
    }
}

fn truth_text(metrics: &Metrics, name: &str) -> String {
    let get = |key: &str| metrics.number(&format!("evaluate.{name}.{key}"));
    let mut parts = Vec::new();
    if let (Some(c), Some(r)) = (get("center_error_m"), get("radius_error_m")) {
        parts.push(format!("centre {:.2} mm, radius {:.2} mm", c * 1e3, r * 1e3));
    }
    if let (Some(a), Some(f)) = (get("accuracy_median_m"), get("f1_2p5mm")) {
        parts.push(format!("surface {:.2} mm median, F1 {f:.2} at 2.5 mm", a * 1e3));
    }
    if let Some(v) = get("volume_ratio") {
        parts.push(format!("volume × {v:.2}"));
    }
    if let Some(c) = get("mass_center_error_m") {
        parts.push(format!("mass centre {:.2} mm", c * 1e3));
    }
    parts.join("; ")
}
