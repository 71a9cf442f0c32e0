//! Builds the report page.

use crate::figures::view_rows;
use crate::forecast::forecast_section;
use crate::html::{action_table, write_picture};
use crate::input::ReportInput;
use crate::landing::{landing_section, landing_svg, predicted_card, verdict};
use crate::shot::shot_svg;
use crate::view3d::view_data;
use serde_json::Value;
use sms_core::metrics::Metrics;
use sms_core::{ColorImage, CoreError, Warning, atomic, escape_xml, length_text};
use sms_gaussians::LossSample;
use sms_scene::{BodyKind, BodyShape};
use std::fmt::Write;
use std::path::{Path, PathBuf};

const TEMPLATE: &str = include_str!("../assets/page.html");
const STYLE: &str = include_str!("../assets/page.css");
const VIEWER: &str = include_str!("../assets/viewer.js");
const THREE: &str = include_str!("../assets/three.bundle.js");
const THREE_LICENSE: &str = include_str!("../assets/three.LICENSE");

/// Writes `index.html` and its pictures into `dir`; returns the page's path.
///
/// # Errors
/// [`CoreError`] if a file cannot be written.
pub fn write_report(dir: &Path, input: &ReportInput<'_>) -> Result<PathBuf, CoreError> {
    let views = view_rows(&input.views, dir)?;
    let (file, shot) = match (&input.landing, input.scene) {
        (Some(landing), Some(scene)) => ("landing.svg", landing_svg(scene, landing)),
        _ => ("shot.svg", shot_svg(input)),
    };
    if let Some(svg) = &shot {
        atomic::write_bytes(&dir.join(file), svg.as_bytes())?;
    }
    let pictures = choice_pictures(&input.pictures, dir)?;
    // `</` would end the script element.
    let data = view_data(input).to_string().replace("</", "<\\/");
    let parts: [(&str, String); 17] = [
        ("title", escape_xml(&input.title)),
        ("subtitle", escape_xml(&input.subtitle)),
        ("style", STYLE.to_owned()),
        ("cards", cards(input)),
        ("shot", shot.unwrap_or_else(|| missing("scene", "simulate RUN"))),
        ("from_above", if input.landing.is_some() { "The approach" } else { "The shot" }.to_owned()),
        ("plan", input.landing.as_ref().map_or_else(|| plan_section(input), landing_section)),
        ("pictures", pictures),
        ("forecast", forecast_section(input.plan, input.execution)),
        ("objects", objects_table(input)),
        ("views", if views.is_empty() { missing("rendered views", "scan DIR --out RUN") } else { views }),
        ("losses", loss_curves(&input.losses)),
        ("warnings", warnings_list(&input.warnings)),
        ("metrics", metrics_table(&input.metrics)),
        ("settings", escape_xml(&input.settings_toml)),
        ("data", data),
        ("scripts", format!("<script>/*\n{THREE_LICENSE}*/\n{THREE}</script>\n<script>{VIEWER}</script>")),
    ];
    let path = dir.join("index.html");
    atomic::write_bytes(&path, fill(TEMPLATE, &parts).as_bytes())?;
    Ok(path)
}

/// Replaces each `{{name}}` in one pass, so that inserted text is not searched again.
fn fill(template: &str, parts: &[(&str, String)]) -> String {
    let mut out = String::with_capacity(template.len() + parts.iter().map(|p| p.1.len()).sum::<usize>());
    let mut rest = template;
    while let Some(start) = rest.find("{{") {
        let Some(length) = rest[start..].find("}}") else { break };
        out.push_str(&rest[..start]);
        let name = &rest[start + 2..start + length];
        if let Some((_, text)) = parts.iter().find(|p| p.0 == name) {
            out.push_str(text);
        }
        rest = &rest[start + length + 2..];
    }
    out.push_str(rest);
    out
}

fn missing(what: &str, command: &str) -> String {
    format!("<p class=\"missing\">No {what} yet. Run <code>sms {command}</code>.</p>")
}

fn card(html: &mut String, label: &str, value: &str, note: &str, class: &str) {
    let _ = write!(
        html,
        "<div class=\"card {class}\"><div class=\"label\">{}</div><div class=\"value\">{}</div><div \
         class=\"note\">{}</div></div>",
        escape_xml(label),
        escape_xml(value),
        escape_xml(note)
    );
}

fn cards(input: &ReportInput<'_>) -> String {
    let mut html = String::new();
    let m = |key: &str| input.metrics.number(key);
    if let Some(plan) = input.plan {
        let unbelievable = plan.strategies.first().and_then(|s| s.failure_text());
        let note = match (&plan.predicted, unbelievable) {
            (Some(p), _) => format!(
                "on average; within {} in 90 % of perturbed worlds, {} in the scanned one",
                length_text(p.q90),
                length_text(plan.objective)
            ),
            (None, Some(text)) => format!("in the scanned world; the plan {text}"),
            _ if plan.is_nominal_only() => "in the scanned world; not tested in perturbed ones".to_owned(),
            // Plans of earlier versions.
            _ => format!("within {} in 90 % of perturbed worlds", length_text(plan.objective_q90)),
        };
        let value = plan.predicted.map_or(plan.objective, |p| p.mean);
        card(&mut html, "Predicted miss", &length_text(value), &note, "main");
    }
    if let Some(e) = input.execution {
        let class = if e.success { "main good" } else { "main bad" };
        let verdict = if e.success { "success" } else { "missed" };
        let rank = e.predicted.map_or_else(String::new, |p| format!(", {}", p.rank_text()));
        let note = format!("{verdict}{rank}; in {}; chaos floor {}", e.engine, length_text(e.chaos_floor));
        card(&mut html, "Realised miss", &length_text(e.objective), &note, class);
    }
    if let Some(landing) = &input.landing {
        let (value, note) = predicted_card(landing.plan);
        card(&mut html, "Predicted", &value, &note, "main");
        if let Some(r) = landing.realised {
            let (class, value) =
                if r.outcome.is_success() { ("main good", "landed") } else { ("main bad", "failed") };
            let text =
                if r.outcome.is_success() { String::new() } else { format!("{}; ", verdict(r.outcome)) };
            card(&mut html, "Realised", value, &format!("{text}in {}", r.engine), class);
        }
    }
    if let Some(psnr) = m("scan.holdout_psnr_db").or(m("scan.train_psnr_db")) {
        let held = m("scan.holdout_psnr_db").is_some();
        let note = if held { "views held out of training" } else { "training views" };
        card(&mut html, "Scan PSNR", &format!("{psnr:.1} dB"), note, "");
    }
    if let Some(mae) = m("scan.holdout_depth_mae_m").or(m("scan.train_depth_mae_m")) {
        let median = m("scan.holdout_depth_median_m").or(m("scan.train_depth_median_m"));
        let note =
            median.map(|v| format!("mean; median {}", length_text(v))).unwrap_or_else(|| "mean".into());
        card(&mut html, "Depth error", &length_text(mae), &note, "");
    }
    if let Some(n) = m("scan.gaussians") {
        let note = m("scan.steps").map(|s| format!("{s:.0} training steps")).unwrap_or_default();
        card(&mut html, "Gaussians", &format!("{n:.0}"), &note, "");
    }
    if let Some(scene) = input.scene {
        let dynamic = scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic);
        let spheres = dynamic.clone().filter(|b| matches!(b.shape, BodyShape::Sphere { .. })).count();
        card(&mut html, "Objects", &dynamic.count().to_string(), &format!("{spheres} spheres"), "");
    }
    let seconds: f64 =
        ["scan.seconds", "materialize.seconds", "plan.seconds"].iter().filter_map(|k| m(k)).sum();
    if seconds > 0.0 {
        card(&mut html, "Time", &format!("{seconds:.0} s"), "scan, materialize, plan", "");
    }
    html
}

/// Writes the pictures as `choice_N.png` and returns the section that shows them; empty without pictures.
fn choice_pictures(pictures: &[(String, ColorImage)], dir: &Path) -> Result<String, CoreError> {
    if pictures.is_empty() {
        return Ok(String::new());
    }
    let mut html = String::from("<section><h2>Candidates of the choice</h2><div class=\"columns\">");
    for (k, (text, image)) in pictures.iter().enumerate() {
        let path = dir.join(format!("choice_{}.png", k + 1));
        let data = write_picture(&path, image)?;
        let text = escape_xml(text);
        let _ = write!(
            html,
            "<figure><img style=\"max-width:100%\" alt=\"{text}\" src=\"{data}\">\
             <figcaption>{text}</figcaption></figure>"
        );
    }
    html.push_str("</div></section>");
    Ok(html)
}

fn plan_section(input: &ReportInput<'_>) -> String {
    let Some(plan) = input.plan else {
        return missing("plan", "plan RUN --task T.toml");
    };
    let mut html = action_table(&plan.parameters, &plan.action.0, 4);
    let invalid = if plan.invalid > 0 {
        let why = plan.failure_text().map(|t| format!(" ({})", escape_xml(&t))).unwrap_or_default();
        format!(", {} of which were invalid and discarded{why}", plan.invalid)
    } else {
        String::new()
    };
    let _ = write!(
        html,
        "<p>{} rollouts in {}{invalid}, from {} starts.</p>",
        plan.evaluations,
        escape_xml(&plan.engine),
        plan.starts.len()
    );
    html
}

fn objects_table(input: &ReportInput<'_>) -> String {
    let Some(scene) = input.scene else {
        return missing("objects", "materialize RUN");
    };
    let truth = input.metrics.iter().any(|(k, _)| k.starts_with("evaluate."));
    let mut html = String::from(
        "<table><tr><th></th><th>object</th><th>shape</th><th>material</th><th>mass</th><th>friction</th>\
         <th>restitution</th><th>observed</th>",
    );
    if truth {
        html.push_str("<th>error to the known model</th>");
    }
    html.push_str("</tr>");
    for body in &scene.bodies {
        let m = &body.material;
        let shape = match &body.shape {
            BodyShape::Sphere { radius } => format!("sphere, r = {:.2} mm", radius * 1e3),
            BodyShape::Box { half_extents } => {
                let [x, y, z] = (2e3 * *half_extents).to_array();
                format!("box, {x:.1} × {y:.1} × {z:.1} mm")
            }
            BodyShape::Cylinder { radius, half_length } => {
                format!("cylinder, r = {:.2} mm, {:.1} mm long", radius * 1e3, half_length * 2e3)
            }
            BodyShape::HalfSpace => "half space".into(),
            BodyShape::Hulls { hulls } => format!("{} convex parts", hulls.len()),
            BodyShape::TriMesh { mesh } => format!("static mesh, {} triangles", mesh.triangles.len()),
        };
        let role = input.roles.iter().find(|r| r.0 == body.name).map(|r| r.1.as_str());
        let role = role.map(|r| format!(" <span class=\"tag\">{}</span>", escape_xml(r))).unwrap_or_default();
        let mass = body.mass.map(|p| format!("{:.0} g", p.mass() * 1e3)).unwrap_or_else(|| "static".into());
        let interval =
            |v: sms_core::Interval| format!("{:.2} <small>[{:.2}, {:.2}]</small>", v.best, v.low, v.high);
        let source = serde_json::to_value(m.density.source).ok();
        let source = source.as_ref().and_then(Value::as_str).unwrap_or("");
        let [r, g, b] = body.color;
        let _ = write!(
            html,
            "<tr><td><span class=\"swatch\" style=\"background:rgb({r},{g},{b})\"></span></td><td>{}{role}</td>\
             <td>{shape}</td><td>{} <small>({source})</small></td><td>{mass}</td><td>{}</td><td>{}</td>\
             <td>{:.0} %</td>",
            escape_xml(&body.name),
            escape_xml(&m.class),
            interval(m.friction.value),
            interval(m.restitution.value),
            100.0 * body.observed_share
        );
        if truth {
            let _ = write!(html, "<td>{}</td>", truth_text(&input.metrics, &body.name));
        }
        html.push_str("</tr>");
    }
    html.push_str("</table>");
    html
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

fn loss_curves(losses: &[LossSample]) -> String {
    if losses.len() < 2 {
        return "<p class=\"missing\">No training curves.</p>".into();
    }
    let (w, h) = (760.0, 180.0);
    let last = losses.last().map_or(1, |l| l.step.max(1)) as f64;
    let mut html = String::new();
    let curves: [(&str, fn(&LossSample) -> f32, &str); 3] = [
        ("colour error (mean absolute)", |l| l.loss.color_l1, "#c77700"),
        ("depth error (m)", |l| l.loss.depth, "#1f5fd0"),
        ("total loss", |l| l.loss.total, "#555"),
    ];
    for (name, value, color) in curves {
        let logs: Vec<f64> = losses.iter().map(|l| f64::from(value(l)).max(1e-6).log10()).collect();
        let (low, high) = logs.iter().fold((f64::MAX, f64::MIN), |(a, b), &v| (a.min(v), b.max(v)));
        let span = (high - low).max(1e-3);
        let points: Vec<String> = losses
            .iter()
            .zip(&logs)
            .map(|(l, v)| {
                format!("{:.1},{:.1}", l.step as f64 / last * w, (high - v) / span * (h - 30.0) + 8.0)
            })
            .collect();
        let _ = write!(
            html,
            "<figure class=\"curve\"><svg viewBox=\"0 0 {w} {h}\"><polyline points=\"{}\" fill=\"none\" \
             stroke=\"{color}\" stroke-width=\"1.5\"/><text x=\"4\" y=\"{:.0}\" font-size=\"13\" fill=\"#777\">0 to {last:.0} \
             steps; {:.2e} to {:.2e}, log scale</text></svg><figcaption>{name}</figcaption></figure>",
            points.join(" "),
            h - 4.0,
            10f64.powf(low),
            10f64.powf(high)
        );
    }
    html
}

fn warnings_list(warnings: &[Warning]) -> String {
    if warnings.is_empty() {
        return "<p>None.</p>".into();
    }
    let mut html = String::from("<ul class=\"warnings\">");
    for w in warnings {
        let times = if w.count > 1 { format!(" <small>({} times)</small>", w.count) } else { String::new() };
        let _ = write!(
            html,
            "<li><b>{}</b>: {}{times} <i>{}</i></li>",
            escape_xml(&w.stage),
            escape_xml(&w.message),
            escape_xml(&w.cure)
        );
    }
    html.push_str("</ul>");
    html
}

fn metrics_table(metrics: &Metrics) -> String {
    let mut html = String::from("<table class=\"metrics\">");
    for (key, value) in metrics.iter() {
        let shown = match value {
            Value::Number(n) => match n.as_f64() {
                Some(f) if n.is_f64() => format!("{f:.6}"),
                _ => n.to_string(),
            },
            Value::String(s) => s.clone(),
            other => other.to_string(),
        };
        let _ =
            write!(html, "<tr><td><code>{}</code></td><td>{}</td></tr>", escape_xml(key), escape_xml(&shown));
    }
    html.push_str("</table>");
    html
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DVec3};
    use sms_core::{MassProperties, Mesh};
    use sms_plan::Plan;
    use sms_scene::{Body, Scene, example_material, floor_body};
    use sms_sim::BodyState;
    use sms_task::{Action, BodyTrack, Parameter, Trajectory};

    fn scene() -> Scene {
        let mut ball = floor_body(0.0, example_material());
        ball.name = "ball".into();
        ball.kind = BodyKind::Dynamic;
        ball.x_wb = DPose3::from_translation(DVec3::new(0.3, 0.1, 0.03));
        ball.shape = BodyShape::Sphere { radius: 0.03 };
        ball.visual = Mesh::icosphere(0.03, 1);
        let mass = sms_core::sphere_mass_properties(DVec3::ZERO, 0.03, 1500.0).unwrap();
        ball.mass = Some(MassProperties::new(mass.mass(), DVec3::ZERO, mass.inertia()).unwrap());
        let bodies: Vec<Body> = vec![floor_body(0.0, example_material()), ball];
        Scene {
            version: 1,
            name: "t".into(),
            gravity_w: DVec3::NEG_Z * 9.81,
            x_world_recording: DPose3::identity(),
            bodies,
        }
    }

    fn trajectory() -> Trajectory {
        let state = |x: f64| BodyState {
            x_wb: DPose3::from_translation(DVec3::new(x, 0.1, 0.03)),
            v_w: DVec3::X,
            w_w: DVec3::ZERO,
        };
        Trajectory {
            times_s: vec![0.0, 0.5, 1.0],
            bodies: vec![BodyTrack { name: "ball".into(), states: vec![state(0.3), state(0.4), state(0.5)] }],
        }
    }

    #[test]
    fn a_whole_page_has_every_section_and_no_outside_files() {
        let dir = tempfile::tempdir().unwrap();
        let scene = scene();
        let parameter = Parameter { name: "speed".into(), unit: "m/s".into(), low: 0.2, high: 0.85 };
        let plan = Plan {
            task: "billiards".into(),
            engine: "rapier3d f32".into(),
            parameters: vec![parameter],
            action: Action(vec![0.5]),
            objective: 0.004,
            objective_unit: "m".into(),
            objective_q90: 0.02,
            evaluations: 10,
            invalid: 0,
            invalid_rollouts: Vec::new(),
            searched: 10,
            refused: Vec::new(),
            striker: String::new(),
            robot: None,
            starts: Vec::new(),
            chosen_by: None,
            predicted: None,
            strategies: Vec::new(),
            reasons: Vec::new(),
            sensitivities: Vec::new(),
            trajectory: trajectory(),
        };
        let mut metrics = Metrics::new();
        metrics.set("evaluate.ball.center_error_m", 0.0005).set("evaluate.ball.radius_error_m", 0.0001);
        let input = ReportInput {
            title: "a <b> & c".into(),
            scene: Some(&scene),
            plan: Some(&plan),
            goal_w: Some([0.5, 0.1]),
            roles: vec![("ball".into(), "target".into())],
            metrics,
            ..ReportInput::default()
        };
        let page = std::fs::read_to_string(write_report(dir.path(), &input).unwrap()).unwrap();
        assert!(page.contains("a &lt;b&gt; &amp; c") && page.contains("4.00 mm"));
        assert!(page.contains("centre 0.50 mm, radius 0.10 mm"));
        assert!(!page.contains("{{") && !page.contains("src=\"http") && !page.contains("href=\"http"));
        assert!(dir.path().join("shot.svg").exists());
    }

    #[test]
    fn an_empty_run_says_what_is_missing() {
        let dir = tempfile::tempdir().unwrap();
        let page =
            std::fs::read_to_string(write_report(dir.path(), &ReportInput::default()).unwrap()).unwrap();
        for command in ["sms scan", "sms materialize", "sms plan", "sms simulate"] {
            assert!(page.contains(command), "{command}");
        }
    }
}
