//! The result in one sentence, and the figures of the run with judgements.

use crate::input::ReportInput;
use crate::landing::{predicted_card, verdict};
use sms_core::{
    DepthAgreement, NORMAL_90, counted, escape_xml, is_at_rest, judge_depth_error, judge_psnr, judge_success,
    length_text, lengths_text,
};
use sms_scene::{BodyKind, BodyShape};
use std::fmt::Write;

/// Returns the result in one sentence, with the next command where a stage is missing.
pub(crate) fn result_sentence(input: &ReportInput<'_>) -> String {
    let (class, text, next) = result(input);
    let next = next.map(|c| format!(" Next: <code>sms {c}</code>.")).unwrap_or_default();
    format!("<p class=\"result {class}\" id=\"result\">{}{next}</p>", escape_xml(&text))
}

fn result(input: &ReportInput<'_>) -> (&'static str, String, Option<&'static str>) {
    let role = |word: &str| input.roles.iter().find(|r| r.1 == word).map(|r| r.0.as_str());
    let strike = match (role("cue"), role("target")) {
        (Some(cue), Some(target)) if cue != target => {
            format!("The strike of {cue} sends {target} to the goal")
        }
        (_, Some(target)) => format!("The strike moves {target} to the goal"),
        _ => "The strike is planned".to_owned(),
    };
    if let Some(plan) = input.plan {
        let mean = plan.predicted.map_or(plan.objective, |p| p.mean);
        return match input.execution {
            Some(e) => {
                let (class, word) = if e.success { ("good", "success") } else { ("bad", "missed") };
                let [mean, realised] = lengths_text([mean, e.objective]);
                let text = format!(
                    "{strike}: predicted to miss it by {mean}, it missed by {realised} in the target world: {word}."
                );
                (class, text, None)
            }
            None => ("", format!("{strike}: predicted to miss it by {}.", length_text(mean)), None),
        };
    }
    if let Some(landing) = &input.landing {
        let (predicted, _) = predicted_card(landing.plan);
        let on = &landing.plan.surface.body;
        return match landing.realised {
            Some(r) if r.outcome.is_success() => (
                "good",
                format!("The landing on {on} is predicted ({predicted}), and succeeds in the target world."),
                None,
            ),
            Some(r) => (
                "bad",
                format!(
                    "The landing on {on} is predicted ({predicted}), and fails in the target world: {}.",
                    verdict(r.outcome)
                ),
                None,
            ),
            None => ("", format!("The landing on {on} is predicted: {predicted}."), None),
        };
    }
    let Some(scene) = input.scene else {
        return match input.gaussians {
            Some(_) => ("", "The recording is scanned.".to_owned(), Some("materialize RUN")),
            None => ("", "There is no scan yet.".to_owned(), Some("scan RECORDING --out RUN")),
        };
    };
    let count = scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic).count();
    let text = format!("{} can be simulated", counted(count, "object", "objects"));
    let drift = input.metrics.number("simulate.drift_m").zip(input.metrics.number("simulate.turn_rad"));
    match drift {
        None => ("", format!("{text}."), Some("simulate RUN")),
        Some((moved, turned)) if is_at_rest(moved, turned) => (
            "good",
            format!("{text}, and all rest: none moves more than {}.", length_text(moved)),
            Some("plan RUN --task TASK.toml"),
        ),
        Some((moved, turned)) => {
            let turned = turned.to_degrees();
            (
                "bad",
                format!(
                    "{text}, but not all rest: one moves by {} or turns by {turned:.1}°.",
                    length_text(moved)
                ),
                None,
            )
        }
    }
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

/// Returns the figures of the run.
pub(crate) fn cards(input: &ReportInput<'_>) -> String {
    let mut html = String::new();
    plan_cards(&mut html, input);
    if let Some(landing) = &input.landing {
        let (value, note) = predicted_card(landing.plan);
        card(&mut html, "Predicted", &value, &note, "predicted");
        if let Some(r) = landing.realised {
            let (class, value) =
                if r.outcome.is_success() { ("realised good", "landed") } else { ("realised bad", "failed") };
            let text =
                if r.outcome.is_success() { String::new() } else { format!("{}; ", verdict(r.outcome)) };
            card(&mut html, "Realised", value, &format!("{text}in {}", r.engine), class);
        }
    }
    scan_cards(&mut html, input);
    if html.is_empty() { html } else { format!("<div class=\"cards\">{html}</div>") }
}

fn plan_cards(html: &mut String, input: &ReportInput<'_>) {
    if let Some(plan) = input.plan {
        let unbelievable = plan.strategies.first().and_then(|s| s.failure_text());
        let note = match (&plan.predicted, unbelievable) {
            (Some(p), _) => format!(
                "{}: succeeds in {:.0} % of {} perturbed worlds; within {} in 90 % of them, {} in the scanned one",
                judge_success(p.success_share).grade,
                100.0 * p.success_share,
                p.worlds,
                length_text(p.q90),
                length_text(plan.objective)
            ),
            (None, Some(text)) => format!("in the scanned world; the plan {text}"),
            _ if plan.is_nominal_only() => "in the scanned world; not tested in perturbed ones".to_owned(),
            // Plans of earlier versions.
            _ => format!("within {} in 90 % of perturbed worlds", length_text(plan.objective_q90)),
        };
        let value = plan.predicted.map_or(plan.objective, |p| p.mean);
        card(html, "Predicted miss", &length_text(value), &note, "predicted");
    }
    if let Some(e) = input.execution {
        let class = if e.success { "realised good" } else { "realised bad" };
        let verdict = if e.success { "success" } else { "missed" };
        let rank = e.predicted.map_or_else(String::new, |p| format!(", {}", p.rank_text()));
        let note = format!("{verdict}{rank}; in {}; chaos floor {}", e.engine, length_text(e.chaos_floor));
        card(html, "Realised miss", &length_text(e.objective), &note, class);
    }
}

fn scan_cards(html: &mut String, input: &ReportInput<'_>) {
    let m = |key: &str| input.metrics.number(key);
    if let Some(psnr) = m("scan.holdout_psnr_db").or(m("scan.train_psnr_db")) {
        let held = m("scan.holdout_psnr_db").is_some();
        let views = if held { "views held out of training" } else { "training views" };
        let note = format!("{views}: {}", judge_psnr(psnr));
        card(html, "Scan PSNR", &format!("{psnr:.1} dB"), &note, "");
    }
    if let Some(mae) = m("scan.holdout_depth_mae_m").or(m("scan.train_depth_mae_m")) {
        let median = m("scan.holdout_depth_median_m").or(m("scan.train_depth_median_m"));
        let note =
            median.map(|v| format!("mean; median {}", length_text(v))).unwrap_or_else(|| "mean".into());
        let note = format!("{note}: {}", judge_depth_error(mae));
        card(html, "Depth error", &length_text(mae), &note, "");
    }
    if let Some(agreement) = DepthAgreement::of_run(&input.metrics) {
        let views = if agreement.held_out { "held-out views" } else { "all views" };
        let note = format!(
            "of the recorded depth lies on the scene ({views}), {:.1} % behind a false surface: {}",
            100.0 * agreement.false_surface,
            agreement.judge()
        );
        card(html, "Scene against depth", &format!("{:.1} %", 100.0 * agreement.agrees), &note, "");
    }
    if let Some(n) = m("scan.gaussians") {
        let note = m("scan.steps").map(|s| format!("{s:.0} training steps")).unwrap_or_default();
        card(html, "Gaussians", &format!("{n:.0}"), &note, "");
    }
    if let Some(scene) = input.scene {
        let dynamic = scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic);
        let count = |is: fn(&BodyShape) -> bool| dynamic.clone().filter(|b| is(&b.shape)).count();
        let kinds = [
            (count(|s| matches!(s, BodyShape::Sphere { .. })), "sphere"),
            (count(|s| matches!(s, BodyShape::Box { .. })), "box"),
            (count(|s| matches!(s, BodyShape::Cylinder { .. })), "cylinder"),
        ];
        let plural = |n: usize, word: &str| match (n, word) {
            (1, _) => format!("1 {word}"),
            (_, "box") => format!("{n} boxes"),
            _ => format!("{n} {word}s"),
        };
        let exact: Vec<String> = kinds.iter().filter(|k| k.0 > 0).map(|k| plural(k.0, k.1)).collect();
        let note =
            if exact.is_empty() { String::new() } else { format!("of these exact: {}", exact.join(", ")) };
        card(html, "Objects", &dynamic.count().to_string(), &note, "");
        if scene.size_sigma > 0.0 {
            let value = format!("±{:.2} %", 100.0 * NORMAL_90 * scene.size_sigma);
            card(html, "Size", &value, "90 % interval of sizes and distances, from the camera poses", "");
        }
    }
    let seconds: f64 =
        ["scan.seconds", "materialize.seconds", "plan.seconds"].iter().filter_map(|k| m(k)).sum();
    if seconds > 0.0 {
        let stages = if input.plan.is_some() || input.landing.is_some() {
            "scan, materialize, plan"
        } else {
            "scan, materialize"
        };
        card(html, "Time", &format!("{seconds:.0} s"), stages, "");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::metrics::Metrics;

    #[test]
    fn the_sentence_names_the_next_stage() {
        let text = result_sentence(&ReportInput::default());
        assert!(text.contains("sms scan"), "{text}");
        let model = sms_gaussians::GaussianModel::default();
        let scanned = ReportInput { gaussians: Some(&model), ..ReportInput::default() };
        assert!(result_sentence(&scanned).contains("sms materialize"));
    }

    #[test]
    fn a_scene_that_moves_at_rest_is_not_called_resting() {
        let scene = sms_scene::Scene {
            version: 1,
            name: "t".into(),
            gravity_w: glamx::DVec3::NEG_Z * 9.81,
            size_sigma: 0.0,
            x_world_recording: glamx::DPose3::identity(),
            bodies: vec![sms_scene::Body {
                kind: BodyKind::Dynamic,
                ..sms_scene::floor_body(0.0, sms_scene::example_material())
            }],
        };
        let sentence = |moved: Option<f64>| {
            let mut metrics = Metrics::new();
            if let Some(m) = moved {
                metrics.set("simulate.drift_m", m).set("simulate.turn_rad", 0.0);
            }
            result(&ReportInput { scene: Some(&scene), metrics, ..ReportInput::default() })
        };
        assert_eq!((sentence(None).0, sentence(None).2), ("", Some("simulate RUN")));
        assert_eq!(sentence(Some(0.0019)).0, "good");
        assert_eq!(sentence(Some(0.0021)).0, "bad");
    }
}
