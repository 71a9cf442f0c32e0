//! The forecast section: strategies, reasons for the choice, predicted and realised objective, and sensitivities to the
//! unknowns.

use sms_core::{escape_xml, length_text};
use sms_plan::{Plan, Strategy};
use sms_task::Execution;
use std::fmt::Write;

/// Width and height of the distribution strips, and the margin of the axes, in SVG units.
const STRIP: (f64, f64) = (300.0, 34.0);
const MARGIN: f64 = 8.0;
/// Size of the histogram, in SVG units.
const HISTOGRAM: (f64, f64) = (620.0, 220.0);
const BINS: usize = 16;
/// Smallest share of a sensitivity that is drawn; smaller ones are only counted.
const LEAST_SHARE: f64 = 0.01;

/// A linear axis of the objective from 0 to a round number.
struct Scale {
    top: f64,
    left: f64,
    right: f64,
}

impl Scale {
    /// Rounds up to the next of 1, 2 and 5 times a power of ten, or a half step in between.
    fn new(highest: f64, left: f64, right: f64) -> Self {
        let highest = if highest.is_finite() && highest > 0.0 { highest } else { 0.01 };
        let power = 10f64.powf(highest.log10().floor());
        let steps = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0];
        let top = steps.into_iter().map(|s| s * power).find(|t| *t >= highest).unwrap_or(10.0 * power);
        Self { top, left, right }
    }

    fn at(&self, value: f64) -> f64 {
        self.left + (value / self.top).clamp(0.0, 1.0) * (self.right - self.left)
    }
}

/// Formats a length for axes: "0", "5 mm", "12 cm".
fn tick_text(metres: f64) -> String {
    let number = |v: f64| format!("{v:.2}").trim_end_matches('0').trim_end_matches('.').to_owned();
    match metres {
        0.0 => "0".to_owned(),
        m if m < 0.01 => format!("{} mm", number(1e3 * m)),
        m if m < 1.0 => format!("{} cm", number(1e2 * m)),
        m => format!("{} m", number(m)),
    }
}

fn outcomes(strategy: &Strategy) -> Vec<f64> {
    strategy.outcomes.iter().copied().flatten().collect()
}

/// Returns the section; empty for a nominal plan with a single strategy and without reasons.
pub(crate) fn forecast_section(plan: Option<&Plan>, execution: Option<&Execution>) -> String {
    let Some(plan) = plan.filter(|p| !p.strategies.is_empty()) else { return String::new() };
    let mut html = String::from("<section id=\"section-forecast\"><h2>Strategies</h2>");
    reasons(&mut html, plan);
    table(&mut html, plan, execution);
    let histogram = histogram(plan, execution);
    let bars = sensitivities(plan);
    if !(histogram.is_empty() && bars.is_empty()) {
        let _ = write!(html, "<div class=\"pair\">{histogram}{bars}</div>");
    }
    html.push_str("</section>");
    html
}

/// Formats names in backticks as code.
fn with_names(text: &str) -> String {
    let mut html = String::new();
    for (k, part) in text.split('`').enumerate() {
        let part = escape_xml(part);
        html += &if k % 2 == 1 { format!("<b class=\"name\">{part}</b>") } else { part };
    }
    html
}

fn reasons(html: &mut String, plan: &Plan) {
    if plan.reasons.is_empty() {
        return;
    }
    html.push_str("<ul class=\"reasons\">");
    for r in &plan.reasons {
        let _ = write!(html, "<li>{}.</li>", with_names(&r.text));
    }
    html.push_str("</ul>");
}

fn table(html: &mut String, plan: &Plan, execution: Option<&Execution>) {
    let highest = |s: &Strategy| outcomes(s).into_iter().fold(s.objective, f64::max);
    let realised = execution.map(|e| e.objective).filter(|v| v.is_finite());
    let all = plan.strategies.iter().map(highest).chain(realised).filter(|v| v.is_finite());
    let scale = Scale::new(all.fold(0.0, f64::max), MARGIN, STRIP.0 - MARGIN);
    let has_worlds = plan.strategies.iter().any(|s| !s.outcomes.is_empty());
    html.push_str(
        "<div class=\"scroll\"><table class=\"ways\"><tr><th>strategy</th><th class=\"n\">scanned world</th>",
    );
    if has_worlds {
        let _ = write!(
            html,
            "<th class=\"n\">mean</th><th class=\"n\">10 %</th><th class=\"n\">50 %</th><th class=\"n\">90 %</th><th \
             class=\"n\">success</th><th>{}</th>",
            axis(&scale)
        );
    }
    html.push_str("</tr>");
    for (k, s) in plan.strategies.iter().enumerate() {
        let is_chosen = k == 0;
        let tag = if is_chosen { " <span class=\"tag\">chosen</span>" } else { "" };
        let _ = write!(
            html,
            "<tr{}><td>{}{tag}</td><td class=\"n\">{}</td>",
            if is_chosen { " class=\"chosen\"" } else { "" },
            with_names(&s.name),
            length_text(s.objective)
        );
        if let Some(p) = &s.prediction {
            for v in [p.mean, p.q10, p.q50, p.q90] {
                let _ = write!(html, "<td class=\"n\">{}</td>", length_text(v));
            }
            let invalid =
                p.missing_text().map(|text| format!("<br><small>{text}</small>")).unwrap_or_default();
            let _ = write!(
                html,
                "<td class=\"n\">{:.0} %{invalid}</td><td>{}</td>",
                100.0 * p.success_share,
                strip(s, &scale, realised.filter(|_| is_chosen))
            );
        } else if let Some(text) = s.failure_text() {
            let _ = write!(html, "<td colspan=\"6\" class=\"missing\">{text}</td>");
        } else if has_worlds {
            html.push_str("<td colspan=\"6\"></td>");
        }
        html.push_str("</tr>");
    }
    html.push_str("</table></div>");
    if has_worlds {
        let realised = if realised.is_some() { " The orange line is the realised value." } else { "" };
        let _ = write!(
            html,
            "<p class=\"key\">Each stroke is one perturbed world that was not used for the choice. The bar spans 10 to 90 %, \
             the white line is the median, the dot the mean.{realised}</p>"
        );
    }
}

fn axis(scale: &Scale) -> String {
    let (w, y) = (STRIP.0, 12.0);
    let mut svg = format!("<svg class=\"strip\" viewBox=\"0 0 {w} 18\" aria-hidden=\"true\">");
    for (k, anchor) in ["start", "middle", "end"].into_iter().enumerate() {
        let v = 0.5 * k as f64 * scale.top;
        let x = [0.0, scale.at(v), w][k];
        let _ = write!(svg, "<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"{anchor}\">{}</text>", tick_text(v));
    }
    svg.push_str("</svg>");
    svg
}

/// Draws one distribution: worlds as strokes, quantiles as a bar.
fn strip(s: &Strategy, scale: &Scale, realised: Option<f64>) -> String {
    let Some(p) = &s.prediction else { return String::new() };
    let (w, h) = STRIP;
    let label =
        format!("mean {}, 10 to 90 %: {} to {}", length_text(p.mean), length_text(p.q10), length_text(p.q90));
    let mut svg = format!(
        "<svg class=\"strip\" viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"{label}\"><title>{label}</title>"
    );
    let middle = 0.5 * h;
    let _ = write!(
        svg,
        "<line class=\"base\" x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{middle}\" y2=\"{middle}\"/>",
        scale.left, scale.right
    );
    let (a, b) = (scale.at(p.q10), scale.at(p.q90));
    let _ = write!(
        svg,
        "<rect class=\"bar\" x=\"{a:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"12\" rx=\"3\"/>",
        middle - 6.0,
        (b - a).max(2.0)
    );
    for v in outcomes(s) {
        let x = scale.at(v);
        let _ = write!(
            svg,
            "<line class=\"world\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{:.1}\" y2=\"{:.1}\"/>",
            middle - 11.0,
            middle + 11.0
        );
    }
    let x = scale.at(p.q50);
    let _ = write!(
        svg,
        "<line class=\"median\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{:.1}\" y2=\"{:.1}\"/><circle class=\"mean\" \
         cx=\"{:.1}\" cy=\"{middle}\" r=\"3.5\"/>",
        middle - 6.0,
        middle + 6.0,
        scale.at(p.mean)
    );
    if let Some(v) = realised {
        let x = scale.at(v);
        let _ = write!(
            svg,
            "<line class=\"realised\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"1\" y2=\"{:.1}\"/>",
            h - 1.0
        );
    }
    svg.push_str("</svg>");
    svg
}

/// Draws the histogram of the chosen shot and the realised value.
fn histogram(plan: &Plan, execution: Option<&Execution>) -> String {
    let Some(p) = &plan.predicted else { return String::new() };
    let values = plan.strategies.first().map(outcomes).unwrap_or_default();
    if values.is_empty() {
        return String::new();
    }
    let realised = execution.map(|e| e.objective).filter(|v| v.is_finite());
    let (w, h) = HISTOGRAM;
    let (top, floor) = (44.0, h - 26.0);
    let highest = values.iter().copied().chain(realised).fold(0.0, f64::max);
    let scale = Scale::new(highest, MARGIN, w - MARGIN);
    let mut counts = [0usize; BINS];
    for v in &values {
        counts[((v / scale.top * BINS as f64) as usize).min(BINS - 1)] += 1;
    }
    let most = counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    let width = (scale.right - scale.left) / BINS as f64;
    let mut svg = format!("<svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"predicted distribution\">");
    for (k, &count) in counts.iter().enumerate().filter(|c| *c.1 > 0) {
        let height = count as f64 / most * (floor - top);
        let _ = write!(
            svg,
            "<rect class=\"bin\" x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\" rx=\"2\"><title>{count} \
             worlds: {} to {}</title></rect>",
            scale.left + k as f64 * width + 1.0,
            floor - height,
            width - 2.0,
            tick_text(k as f64 * scale.top / BINS as f64),
            tick_text((k + 1) as f64 * scale.top / BINS as f64)
        );
    }
    let _ = write!(
        svg,
        "<line class=\"axis\" x1=\"{:.1}\" x2=\"{:.1}\" y1=\"{floor}\" y2=\"{floor}\"/>",
        scale.left, scale.right
    );
    for (k, anchor) in ["start", "middle", "middle", "middle", "end"].into_iter().enumerate() {
        let v = 0.25 * k as f64 * scale.top;
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}</text>",
            scale.at(v),
            floor + 17.0,
            tick_text(v)
        );
    }
    let mut mark = |class: &str, v: f64, y: f64, text: &str| {
        let x = scale.at(v);
        let (dx, anchor) = if x > 0.72 * w { (-5.0, "end") } else { (5.0, "start") };
        let _ = write!(
            svg,
            "<line class=\"{class}\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{:.1}\" y2=\"{floor}\"/><text class=\"{class}\" \
             x=\"{:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\">{text} {}</text>",
            y - 10.0,
            x + dx,
            length_text(v)
        );
    };
    mark("mean", p.mean, 24.0, "mean");
    mark("q90", p.q90, 38.0, "90 %");
    if let Some(v) = realised {
        mark("realised", v, 10.0, "realised");
    }
    svg.push_str("</svg>");
    let mut caption = match execution.and_then(|e| e.predicted.or_else(|| plan.against(e.objective))) {
        Some(a) => format!("Realised {}: {}.", length_text(realised.unwrap_or(f64::NAN)), a.rank_text()),
        None => format!("{} perturbed worlds; not executed yet.", values.len()),
    };
    if let Some(missing) = p.missing_text() {
        let _ = write!(caption, " Not shown: {missing}.");
    }
    let chosen = plan.strategies.first().map(|s| s.as_named_share.unwrap_or(1.0)).unwrap_or(1.0);
    if chosen < 1.0 {
        let _ = write!(caption, " It follows its strategy in {:.0} % of the worlds.", 100.0 * chosen);
    }
    format!(
        "<figure class=\"histogram\"><h3>Predicted and realised</h3>{svg}<figcaption>{}</figcaption></figure>",
        escape_xml(&caption)
    )
}

/// Draws the sensitivities to the unknowns as bars.
fn sensitivities(plan: &Plan) -> String {
    let drawn: Vec<_> = plan.sensitivities.iter().filter(|s| s.share >= LEAST_SHARE).take(8).collect();
    let Some(most) = drawn.first().map(|s| s.change).filter(|v| *v > 0.0) else { return String::new() };
    let mut html = String::from("<figure class=\"matters\"><h3>Sensitivities</h3><table>");
    for s in &drawn {
        let _ = write!(
            html,
            "<tr><td>{}</td><td class=\"track\"><span style=\"width:{:.1}%\"></span></td><td class=\"n\">± {}</td></tr>",
            with_names(&s.to_string()),
            100.0 * s.change / most,
            length_text(s.change)
        );
    }
    html.push_str(
        "</table><figcaption>Root-mean-square change of the miss when a single unknown varies within its \
                   uncertainty; interactions are not included.",
    );
    let rest = plan.sensitivities.len() - drawn.len();
    if rest > 0 {
        let _ = write!(html, " {rest} smaller ones are not shown.");
    }
    html.push_str("</figcaption></figure>");
    html
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_plan::{Prediction, Reason, Sensitivity, Unknown};
    use sms_task::{Action, Trajectory};

    fn strategy(name: &str, outcomes: Vec<Option<f64>>, prediction: Option<Prediction>) -> Strategy {
        Strategy {
            name: name.into(),
            action: Action(vec![0.5]),
            objective: 0.01,
            prediction,
            outcomes,
            refused: 0,
            as_named_share: Some(0.75),
        }
    }

    fn plan() -> Plan {
        let p = Prediction {
            mean: 0.02,
            q10: 0.01,
            q50: 0.02,
            q90: 0.03,
            success_share: 0.75,
            worlds: 4,
            invalid: 1,
            refused: 0,
        };
        let outcomes = vec![Some(0.01), Some(0.02), None, Some(0.03)];
        Plan {
            task: "billiards".into(),
            engine: "e".into(),
            parameters: Vec::new(),
            action: Action(vec![0.5]),
            objective: 0.01,
            objective_unit: "m".into(),
            objective_q90: 0.03,
            evaluations: 9,
            invalid: 1,
            invalid_rollouts: Vec::new(),
            searched: 9,
            refused: Vec::new(),
            striker: String::new(),
            robot: None,
            starts: Vec::new(),
            chosen_by: None,
            predicted: Some(p),
            strategies: vec![
                strategy("target off `a<b`", outcomes, Some(p)),
                strategy("direct", vec![None; 4], None),
            ],
            reasons: vec![Reason { text: "it relies on `a<b`".into(), counterfactual: None }],
            sensitivities: vec![Sensitivity {
                unknown: Unknown::Execution,
                change: 0.004,
                share: 1.0,
                property: None,
            }],
            trajectory: Trajectory::default(),
        }
    }

    #[test]
    fn the_section_shows_every_way_the_reason_and_where_the_realised_value_fell() {
        let plan = plan();
        let mut execution = Execution {
            engine: "t".into(),
            objective: 0.025,
            objective_unit: "m".into(),
            success: true,
            chaos_floor: 0.0,
            predicted: plan.against(0.025),
            trajectory: Trajectory::default(),
            matches: Vec::new(),
        };
        assert!((execution.predicted.unwrap().rank - 2.0 / 3.0).abs() < 1e-12);
        let html = forecast_section(Some(&plan), Some(&execution));
        assert!(
            html.contains("target off <b class=\"name\">a&lt;b</b> <span class=\"tag\">chosen"),
            "{html}"
        );
        assert_eq!(html.matches("class=\"world\"").count(), 3);
        assert!(html.contains("worse than in 67 % of 3 predicted worlds"));
        assert!(html.contains("Not shown: 1 of 4 invalid."));
        assert!(html.contains("is invalid in 4 of 4 worlds"));
        assert!(html.contains("it relies on <b class=\"name\">a&lt;b</b>.") && html.contains("± 4.00 mm"));
        // Ranks at both ends, and a value equal to a predicted one.
        for (v, rank) in [(0.001, 0.0), (0.5, 1.0), (0.02, 0.5)] {
            execution.objective = v;
            assert_eq!(plan.against(v).unwrap().rank, rank);
            assert!(forecast_section(Some(&plan), Some(&execution)).contains("class=\"realised\""));
        }
        assert_eq!(forecast_section(None, None), "");
    }

    #[test]
    fn scales_end_at_round_numbers_that_hold_everything() {
        for (v, top) in [(0.0, 0.01), (0.011, 0.015), (0.1401, 0.15), (0.16, 0.2), (0.95, 1.0), (7.0, 8.0)] {
            let scale = Scale::new(v, 0.0, 1.0);
            assert!((scale.top - top).abs() < 1e-12, "{v}: {}", scale.top);
            assert!(scale.at(v) <= 1.0 && scale.at(2.0 * scale.top) == 1.0);
        }
        assert_eq!(
            [0.0, 0.005, 0.0125, 0.15, 1.5].map(tick_text),
            ["0", "5 mm", "1.25 cm", "15 cm", "1.5 m"]
        );
    }
}
