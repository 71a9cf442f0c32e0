//! Builds the report page.

use crate::date::date_text;
use crate::figures::view_rows;
use crate::forecast::forecast_section;
use crate::html::{PREDICTED, REALISED, action_table, write_picture};
use crate::input::ReportInput;
use crate::labelled::photo_section;
use crate::landing::{landing_section, landing_svg};
use crate::objects::objects_section;
use crate::shot::shot_svg;
use crate::summary::{cards, result_sentence};
use crate::viewer::with_viewer;
use serde_json::Value;
use sms_core::metrics::Metrics;
use sms_core::{ColorImage, CoreError, Warning, atomic, escape_xml};
use sms_gaussians::LossSample;
use std::fmt::Write;
use std::path::{Path, PathBuf};

const TEMPLATE: &str = include_str!("../assets/page.html");
const STYLE: &str = include_str!("../assets/page.css");

/// Writes `index.html` and its pictures into `dir`; returns the page's path.
///
/// # Errors
/// [`CoreError`] if a file cannot be written.
pub fn write_report(dir: &Path, input: &ReportInput<'_>) -> Result<PathBuf, CoreError> {
    let views = view_rows(&input.views, dir)?;
    let pictures = choice_pictures(&input.pictures, dir)?;
    let plan = plan_section(input, dir)?;
    let colors = format!(":root {{ --predicted: {PREDICTED}; --realised: {REALISED}; }}\n");
    let parts: [(&str, String); 15] = [
        ("title", escape_xml(&input.title)),
        ("subtitle", escape_xml(&input.subtitle)),
        ("style", colors + STYLE),
        ("photo", photo_section(input)),
        ("result", result_sentence(input)),
        ("cards", cards(input)),
        ("objects", objects_section(input)),
        ("plan", plan),
        ("pictures", pictures),
        ("forecast", forecast_section(input.plan, input.execution)),
        ("warnings", warnings_list(&input.warnings)),
        ("views", section("Observed and rendered", &views)),
        ("losses", section("Training", &loss_curves(&input.losses))),
        ("details", details(input)),
        ("footer", footer(input)),
    ];
    let page = fill(TEMPLATE, &parts);
    let page = with_viewer(&page, input);
    let path = dir.join("index.html");
    atomic::write_bytes(&path, page.as_bytes())?;
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

fn section(title: &str, content: &str) -> String {
    if content.is_empty() { String::new() } else { format!("<section><h2>{title}</h2>{content}</section>") }
}

fn details(input: &ReportInput<'_>) -> String {
    let mut html = String::new();
    if input.metrics.iter().next().is_some() {
        let _ = write!(
            html,
            "<details><summary>All metrics</summary>{}</details>",
            metrics_table(&input.metrics)
        );
    }
    if !input.settings_toml.is_empty() {
        let text = escape_xml(&input.settings_toml);
        let _ = write!(
            html,
            "<details><summary>Effective settings (run.toml)</summary><pre tabindex=\"0\">{text}</pre></details>"
        );
    }
    html
}

fn footer(input: &ReportInput<'_>) -> String {
    let date = input.written.map(|t| format!(" on {} (UTC)", date_text(t))).unwrap_or_default();
    let mut html = format!("<p>Written by sms {}{date}.", env!("CARGO_PKG_VERSION"));
    if !input.commands.is_empty() {
        html.push_str(" Commands:</p><pre tabindex=\"0\">");
        html.push_str(&escape_xml(&input.commands.join("\n")));
        html.push_str("</pre><p>");
    }
    html + " This page is self-contained and works offline; the 3-D view uses three.js (MIT).</p>"
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
            "<figure><img loading=\"lazy\" width=\"{}\" height=\"{}\" alt=\"{text}\" src=\"{data}\">\
             <figcaption>{text}</figcaption></figure>",
            image.width, image.height
        );
    }
    html.push_str("</div></section>");
    Ok(html)
}

/// Returns the section of the plan with its picture from above, which is also written as SVG; empty without a plan.
fn plan_section(input: &ReportInput<'_>, dir: &Path) -> Result<String, CoreError> {
    let (file, svg, title, text) = match (&input.landing, input.scene) {
        (Some(landing), scene) => {
            let svg = scene.and_then(|s| landing_svg(s, landing));
            ("landing.svg", svg, "The approach from above", landing_section(landing))
        }
        _ => match action_text(input) {
            Some(text) => ("shot.svg", shot_svg(input), "The shot from above", text),
            None => return Ok(String::new()),
        },
    };
    if let Some(svg) = &svg {
        atomic::write_bytes(&dir.join(file), svg.as_bytes())?;
    }
    let picture = svg.map(|svg| format!("<div><h2>{title}</h2>{svg}</div>")).unwrap_or_default();
    Ok(format!(
        "<section class=\"columns\" id=\"section-plan\">{picture}<div><h2>The plan</h2>{text}</div></section>"
    ))
}

/// Returns the action and the effort of its search; `None` without a plan.
fn action_text(input: &ReportInput<'_>) -> Option<String> {
    let plan = input.plan?;
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
    Some(html)
}

fn loss_curves(losses: &[LossSample]) -> String {
    if losses.len() < 2 {
        return String::new();
    }
    let (w, h) = (760.0, 180.0);
    let last = losses.last().map_or(1, |l| l.step.max(1)) as f64;
    let mut html = String::from("<div class=\"curves\">");
    let curves: [(&str, fn(&LossSample) -> f32, &str); 3] = [
        ("colour error (mean absolute)", |l| l.loss.color_l1, "#c77700"),
        ("depth error (m)", |l| l.loss.depth, "#3f7fae"),
        ("total loss", |l| l.loss.total, "#808080"),
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
            "<figure class=\"curve\"><svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"{name}\"><polyline points=\"{}\" fill=\"none\" \
             stroke=\"{color}\" stroke-width=\"1.5\"/><text x=\"4\" y=\"{:.0}\" font-size=\"13\" class=\"soft\" fill=\"#666\">0 to {last:.0} \
             steps; {:.2e} to {:.2e}, log scale</text></svg><figcaption>{name}</figcaption></figure>",
            points.join(" "),
            h - 4.0,
            10f64.powf(low),
            10f64.powf(high)
        );
    }
    html + "</div>"
}

fn warnings_list(warnings: &[Warning]) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    let mut html = String::from("<section id=\"section-warnings\"><h2>Warnings</h2><ul class=\"warnings\">");
    for w in warnings {
        let times = if w.count > 1 { format!(" <small>({} times)</small>", w.count) } else { String::new() };
        let _ = write!(
            html,
            "<li><b>{}</b>: {}{times}<br><span class=\"cure\">{}</span></li>",
            escape_xml(&w.stage),
            escape_xml(&w.message),
            escape_xml(&w.cure)
        );
    }
    html.push_str("</ul></section>");
    html
}

fn metrics_table(metrics: &Metrics) -> String {
    let mut html = String::from("<div class=\"scroll\"><table class=\"metrics\">");
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
    html.push_str("</table></div>");
    html
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DVec3};
    use sms_core::{MassProperties, Mesh};
    use sms_plan::Plan;
    use sms_scene::{Body, BodyKind, BodyShape, Scene, example_material, floor_body};
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
            size_sigma: 0.0,
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
        for (of, agrees, wrong) in [("", 0.91, 0.013), ("holdout_", 0.87, 0.024), ("ball.", 0.77, 0.21)] {
            metrics.set(format!("evaluate.{of}depth_agrees"), agrees);
            metrics.set(format!("evaluate.{of}depth_false_surface"), wrong);
        }
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
        // Held-out views come first, and each body has its own shares.
        assert!(page.contains("87.0 %") && !page.contains("91.0 %") && page.contains("2.4 %"));
        assert!(page.contains("77 % on it, 21 % behind it"));
        assert!(!page.contains("{{") && !page.contains("src=\"http") && !page.contains("href=\"http"));
        assert!(dir.path().join("shot.svg").exists());
    }

    fn written(input: &ReportInput<'_>) -> String {
        let dir = tempfile::tempdir().unwrap();
        std::fs::read_to_string(write_report(dir.path(), input).unwrap()).unwrap()
    }

    #[test]
    fn an_empty_run_says_what_is_missing_and_has_no_empty_parts() {
        let page = written(&ReportInput::default());
        assert!(page.contains("sms scan"));
        assert!(!page.contains("id=\"canvas\"") && !page.contains("<section"), "no part without content");
    }

    #[test]
    fn a_page_without_a_plan_shows_none_of_its_parts() {
        let scene = scene();
        let mut metrics = Metrics::new();
        metrics.set("evaluate.ball.depth_agrees", 0.8).set("evaluate.ball.depth_false_surface", 0.1);
        let input = ReportInput { scene: Some(&scene), metrics, ..ReportInput::default() };
        let dir = tempfile::tempdir().unwrap();
        let page = std::fs::read_to_string(write_report(dir.path(), &input).unwrap()).unwrap();
        assert!(page.contains("id=\"canvas\"") && page.contains("section-objects"));
        assert!(page.contains("80 % on it, 10 % behind it") && !page.contains("error to the known model"));
        assert!(
            !page.contains("section-plan")
                && !page.contains("from above")
                && !page.contains("Predicted miss")
        );
        assert!(!dir.path().join("shot.svg").exists());
    }

    #[test]
    fn photograph_objects_and_result_come_first_and_the_foot_names_the_command() {
        let scene = scene();
        let labels = sms_core::Image::filled(8, 6, 0);
        let view = crate::RecordedView {
            frame_index: 3,
            held_out: false,
            camera: sms_core::Camera::new(sms_core::Intrinsics::from_fov(8, 6, 1.0), DPose3::IDENTITY),
            photo: sms_core::Image::filled(16, 12, [9, 9, 9]),
            depth: sms_core::Image::filled(8, 6, 1.0),
            labels,
        };
        let input = ReportInput {
            scene: Some(&scene),
            recorded: vec![view],
            commands: vec!["sms report a<b>".into()],
            written: Some(std::time::SystemTime::UNIX_EPOCH),
            ..ReportInput::default()
        };
        let page = written(&input);
        let order = ["section-photo", "id=\"result\"", "id=\"canvas\"", "section-objects", "<footer"];
        let places: Vec<usize> =
            order.iter().map(|p| page.find(p).unwrap_or_else(|| panic!("{p}"))).collect();
        assert!(places.is_sorted(), "{places:?}");
        assert!(page.contains("sms report a&lt;b&gt;") && page.contains("on 1970-01-01 (UTC)"));
        assert!(page.contains(&format!("sms {}", env!("CARGO_PKG_VERSION"))));
    }
}
