//! Means, targets and tables of `sms-experiments materialize`.

use crate::scenes::BenchScene;
use sms_core::metrics::Metrics;
use std::fmt::Write;

const PREFIX: &str = "bench.materialize.";

/// The figures shown: key, heading, factor to the shown unit, digits.
const COLUMNS: [(&str, &str, f64, usize); 14] = [
    ("masks_iou", "mask IoU", 1.0, 3),
    ("gaussians_f1_2p5mm", "scan F1", 1.0, 4),
    ("f1_2p5mm", "F1@2.5", 1.0, 4),
    ("f1_5mm", "F1@5", 1.0, 4),
    ("surface_median_m", "median mm", 1e3, 3),
    ("surface_p90_m", "p90 mm", 1e3, 2),
    ("completion_m", "compl. mm", 1e3, 3),
    ("volume_ratio", "volume ×", 1.0, 3),
    ("parts", "parts", 1.0, 0),
    ("parts_iou", "parts IoU", 1.0, 3),
    ("faces", "faces", 1.0, 0),
    ("residual_m", "resid. mm", 1e3, 3),
    ("seconds", "s", 1.0, 2),
    ("cpu_seconds", "CPU s", 1.0, 2),
];

/// A figure to reach: at most (`true`) or at least (`false`), as mean over the models.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MaterializeTarget {
    /// Key without its prefix.
    pub key: &'static str,
    /// Whether the value shall be at most (else at least) the limit.
    pub at_most: bool,
    /// The limit.
    pub limit: f64,
}

/// Targets of the means over the models.
pub fn materialize_targets() -> [MaterializeTarget; 3] {
    let target = |key, at_most, limit| MaterializeTarget { key, at_most, limit };
    [
        target("f1_2p5mm", false, 0.9),
        target("surface_median_m", true, 0.001),
        target("volume_error", true, 0.08),
    ]
}

/// Adds `bench.materialize.mean.…`, the mean of every figure over the models that have it, and
/// `bench.materialize.seconds`, the time of their entities stages together.
pub fn add_materialize_means(metrics: &mut Metrics, scenes: &[BenchScene]) {
    let models: Vec<String> = scenes
        .iter()
        .filter(|s| matches!(s, BenchScene::Model(_)))
        .map(|s| format!("{PREFIX}{s}."))
        .filter(|p| metrics.number(&format!("{p}seconds")).is_some())
        .collect();
    if models.is_empty() {
        return;
    }
    let mut keys: Vec<String> = Vec::new();
    for prefix in &models {
        for (key, _) in metrics.iter() {
            if let Some(key) = key.strip_prefix(prefix.as_str())
                && !keys.iter().any(|k| k == key)
            {
                keys.push(key.to_owned());
            }
        }
    }
    for key in keys {
        let values = models.iter().filter_map(|p| metrics.number(&format!("{p}{key}")));
        let values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
        if !values.is_empty() {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            metrics.set(format!("{PREFIX}mean.{key}"), mean);
        }
    }
    for key in ["seconds", "cpu_seconds"] {
        let sum: f64 = models.iter().filter_map(|p| metrics.number(&format!("{p}{key}"))).sum();
        metrics.set(format!("{PREFIX}{key}"), sum);
    }
}

fn rows(metrics: &Metrics, scenes: &[BenchScene]) -> Vec<(String, Vec<Option<String>>)> {
    let named = scenes.iter().map(ToString::to_string);
    let with_mean =
        named.chain(scenes.iter().any(|s| matches!(s, BenchScene::Model(_))).then(|| "mean".into()));
    with_mean
        .map(|name| {
            let cell = |(key, _, factor, digits): (&str, &str, f64, usize)| {
                let value = metrics.number(&format!("{PREFIX}{name}.{key}"))?;
                Some(format!("{:.digits$}", value * factor))
            };
            let mut cells: Vec<Option<String>> = COLUMNS.into_iter().map(cell).collect();
            let shape = metrics.get(&format!("{PREFIX}{name}.shape"));
            cells.push(shape.and_then(|v| v.as_str()).map(str::to_owned));
            (name, cells)
        })
        .collect()
}

/// The table for people: a row an object, the means, and the targets. With an earlier result, the means' differences to it.
pub fn materialize_table(metrics: &Metrics, scenes: &[BenchScene], baseline: Option<&Metrics>) -> String {
    let mut text = format!("{:<24}", "object");
    for (_, name, _, _) in COLUMNS {
        let _ = write!(text, " {name:>9}");
    }
    text.push_str("  shape\n");
    for (name, cells) in rows(metrics, scenes) {
        let _ = write!(text, "{name:<24}");
        let (shape, figures) = cells.split_last().map_or((None, &[][..]), |(s, f)| (s.clone(), f));
        for cell in figures {
            let _ = write!(text, " {:>9}", cell.as_deref().unwrap_or("-"));
        }
        let _ = writeln!(text, "  {}", shape.as_deref().unwrap_or(""));
    }
    for target in materialize_targets() {
        let Some(value) = metrics.number(&format!("{PREFIX}mean.{}", target.key)) else { continue };
        let met = if target.at_most { value <= target.limit } else { value >= target.limit };
        let _ = writeln!(
            text,
            "{} mean {} {value:.5}, {} {}",
            if met { "met   " } else { "MISSED" },
            target.key,
            if target.at_most { "at most" } else { "at least" },
            target.limit
        );
    }
    text.push_str(&largest_ratios(metrics, PREFIX));
    if let Some(seconds) = metrics.number(&format!("{PREFIX}seconds")) {
        let _ = writeln!(text, "entities of all models in {seconds:.1} s");
    }
    if let Some(baseline) = baseline {
        text.push_str("against the earlier result: object, key, then, now\n");
        for (key, value) in metrics.iter() {
            let judged = COLUMNS.iter().take(7).any(|c| key.ends_with(&format!(".{}", c.0)));
            let both = value.as_f64().zip(baseline.number(key)).filter(|_| judged);
            if let Some((now, then)) = both.filter(|(now, then)| (now - then).abs() > 0.005 * then.abs()) {
                let _ = writeln!(text, "  {:<44} {then:>10.5} {now:>10.5}", key.trim_start_matches(PREFIX));
            }
        }
    }
    text
}

/// The same as a Markdown table, without targets.
pub fn materialize_markdown(metrics: &Metrics, scenes: &[BenchScene]) -> String {
    let mut text = String::from("| object |");
    COLUMNS.iter().for_each(|(_, name, _, _)| text.push_str(&format!(" {name} |")));
    text.push_str(" shape |\n|---|");
    text.push_str(&"---|".repeat(COLUMNS.len() + 1));
    for (name, cells) in rows(metrics, scenes) {
        let _ = write!(text, "\n| {name} |");
        for cell in cells {
            let _ = write!(text, " {} |", cell.as_deref().unwrap_or(""));
        }
    }
    text.push('\n');
    text
}

/// The largest ratios of all objects, in a line each; empty where there are none.
fn largest_ratios(metrics: &Metrics, prefix: &str) -> String {
    // Keys are `{scene}.{object}.{figure}`, of models `{model}.{figure}`; means are `{scene}.{figure}` and `mean.{figure}`.
    let of_object = |key: &str, figure: &str| {
        let object = key.strip_prefix(prefix)?.strip_suffix(figure)?;
        let is_mean = !object.contains('.') && (object.starts_with("scene_") || object == "mean");
        (!is_mean).then(|| key.strip_suffix(figure)).flatten().map(str::to_owned)
    };
    let mut largest = [("places of balls", 0.0f64, 0usize), ("radii", 0.0, 0), ("places of others", 0.0, 0)];
    for (key, value) in metrics.iter() {
        let Some(ratio) = value.as_f64() else { continue };
        let row = if of_object(key, ".radius_ratio").is_some() {
            1
        } else if let Some(object) = of_object(key, ".place_ratio") {
            if metrics.number(&format!("{object}.radius_ratio")).is_some() { 0 } else { 2 }
        } else {
            continue;
        };
        largest[row] = (largest[row].0, largest[row].1.max(ratio), largest[row].2 + 1);
    }
    let mut text = String::new();
    for (name, ratio, count) in largest.into_iter().filter(|l| l.2 > 0) {
        let _ = writeln!(
            text,
            "largest error over its standard error by the residuals: {name} ({count}) {ratio:.1}"
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_over_the_models_that_have_the_figure() {
        let scenes = [BenchScene::Model("a".into()), BenchScene::Model("b".into()), BenchScene::Ten(1)];
        let mut m = Metrics::new();
        for (key, value) in [
            ("a.seconds", 1.0),
            ("b.seconds", 2.5),
            ("scene_1.seconds", 9.0),
            ("a.f1_2p5mm", 0.8),
            ("b.f1_2p5mm", 0.9),
            ("scene_1.f1_2p5mm", 0.1),
            ("b.volume_error", 0.07),
        ] {
            m.set(format!("{PREFIX}{key}"), value);
        }
        m.set(format!("{PREFIX}a.shape"), "box");
        let earlier = m.clone();
        add_materialize_means(&mut m, &scenes);
        assert!((m.number("bench.materialize.mean.f1_2p5mm").unwrap() - 0.85).abs() < 1e-12);
        assert_eq!(m.number("bench.materialize.mean.volume_error"), Some(0.07));
        assert_eq!(m.number("bench.materialize.seconds"), Some(3.5));
        assert!(m.get("bench.materialize.mean.shape").is_none());
        m.set(format!("{PREFIX}b.f1_2p5mm"), 0.95);
        let text = materialize_table(&m, &scenes, Some(&earlier));
        assert!(text.contains("MISSED mean f1_2p5mm 0.85000") && text.contains("met    mean volume_error"));
        assert!(text.contains("b.f1_2p5mm"), "{text}");
        let markdown = materialize_markdown(&m, &scenes);
        assert_eq!(markdown.lines().count(), 2 + 4);
        assert!(markdown.lines().all(|l| l.matches('|').count() == COLUMNS.len() + 3), "{markdown}");
    }

    #[test]
    fn the_largest_are_of_objects_and_not_of_means() {
        let mut m = Metrics::new();
        for (key, value) in [
            ("scene_1.cue.place_ratio", 1.5),
            ("scene_1.cue.radius_ratio", 4.0),
            ("scene_1.mug.place_ratio", 11.0),
            ("mug_model.place_ratio", 12.0),
            ("scene_1.place_ratio", 90.0),
            ("scene_1.radius_ratio", 90.0),
            ("mean.place_ratio", 90.0),
        ] {
            m.set(format!("p.{key}"), value);
        }
        let text = largest_ratios(&m, "p.");
        assert_eq!(text.lines().count(), 3);
        assert!(
            text.contains("balls (1) 1.5")
                && text.contains("radii (1) 4.0")
                && text.contains("others (2) 12.0")
        );
        assert_eq!(largest_ratios(&Metrics::new(), "p."), "");
    }
}
