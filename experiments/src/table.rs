//! Results of several scenes: means, the table for people, and the comparison with an earlier result.

use crate::scenes::BenchScene;
use sms_core::metrics::Metrics;
use std::fmt::Write;

/// The figures that the table shows: key, heading, factor to the shown unit, digits.
const COLUMNS: [(&str, &str, f64, usize); 11] = [
    ("total_seconds", "total s", 1.0, 1),
    ("seconds", "scan s", 1.0, 1),
    ("step_cpu_ms", "step ms", 1.0, 1),
    ("peak_bytes", "MiB", 1.0 / 1_048_576.0, 0),
    ("gaussians", "Gauss.", 1.0, 0),
    ("holdout_psnr_db", "PSNR dB", 1.0, 2),
    ("holdout_depth_mae_m", "depth mm", 1e3, 2),
    ("surface_median_m", "surf. mm", 1e3, 3),
    ("surface_p90_m", "p90 mm", 1e3, 2),
    ("f1_2p5mm", "F1@2.5", 1.0, 4),
    ("holdout_miou", "mIoU", 1.0, 4),
];

/// A figure to reach: at most (`true`) or at least (`false`), in the metric's own unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FigureTarget {
    /// Key without its prefix.
    pub key: &'static str,
    /// Whether the value shall be at most (else at least) the limit.
    pub at_most: bool,
    /// The limit.
    pub limit: f64,
}

impl FigureTarget {
    /// Whether a value meets it.
    pub fn met(&self, value: f64) -> bool {
        if self.at_most { value <= self.limit } else { value >= self.limit }
    }
}

/// Targets of a preset on 2 cores, as means over the generated scenes (of peak memory, over each).
pub fn targets(preset: &str) -> Vec<FigureTarget> {
    let target = |key, at_most, limit| FigureTarget { key, at_most, limit };
    let gib = f64::from(1u32 << 30);
    let quality = [
        target("holdout_psnr_db", false, 30.0),
        target("holdout_depth_mae_m", true, 0.003),
        target("surface_median_m", true, 0.001),
        target("f1_2p5mm", false, 0.95),
        target("holdout_miou", false, 0.95),
    ];
    let cost = match preset {
        "standard" => vec![("total_seconds", 100.0), ("peak_bytes", gib), ("step_cpu_ms", 25.0)],
        "fine" => vec![("total_seconds", 300.0), ("peak_bytes", 2.0 * gib), ("step_cpu_ms", 65.0)],
        _ => vec![],
    };
    cost.into_iter().map(|(key, limit)| target(key, true, limit)).chain(quality).collect()
}

/// Adds `bench.scan.mean.…`: the mean of every key over the generated scenes.
pub fn add_means(metrics: &mut Metrics, scenes: &[BenchScene]) {
    let generated: Vec<String> = scenes
        .iter()
        .filter(|s| matches!(s, BenchScene::Billiards(_)))
        .map(|s| format!("bench.scan.{s}."))
        .collect();
    let Some(first) = generated.first() else { return };
    let keys: Vec<String> =
        metrics.iter().filter_map(|(k, _)| k.strip_prefix(first.as_str()).map(str::to_owned)).collect();
    for key in keys {
        let values: Vec<f64> =
            generated.iter().filter_map(|p| metrics.number(&format!("{p}{key}"))).collect();
        if !values.is_empty() {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            metrics.set(format!("bench.scan.mean.{key}"), mean);
        }
    }
}

/// The table as text: a row for each scene, the means, and the targets, met or missed.
pub fn table(metrics: &Metrics, scenes: &[BenchScene], preset: &str, baseline: Option<&Metrics>) -> String {
    let mut text = String::new();
    let _ = write!(text, "{:<18}", "scene");
    for (_, name, _, _) in COLUMNS {
        let _ = write!(text, " {name:>9}");
    }
    let mut row = |name: &str, prefix: &str| {
        let _ = write!(text, "\n{name:<18}");
        for (key, _, factor, digits) in COLUMNS {
            let _ = match metrics.number(&format!("{prefix}{key}")) {
                Some(value) => write!(text, " {:>9.digits$}", value * factor),
                None => write!(text, " {:>9}", "-"),
            };
        }
    };
    scenes.iter().for_each(|s| row(&s.to_string(), &format!("bench.scan.{s}.")));
    if scenes.iter().any(|s| matches!(s, BenchScene::Billiards(_))) {
        row("mean", "bench.scan.mean.");
    }
    text.push('\n');
    for target in targets(preset) {
        let shown = COLUMNS.iter().find(|c| c.0 == target.key);
        let Some((_, name, factor, digits)) = shown.copied() else { continue };
        let Some(value) = metrics.number(&format!("bench.scan.mean.{}", target.key)) else { continue };
        let worst = scenes
            .iter()
            .filter(|s| matches!(s, BenchScene::Billiards(_)))
            .filter_map(|s| metrics.number(&format!("bench.scan.{s}.{}", target.key)))
            .reduce(|a, b| if target.at_most { a.max(b) } else { a.min(b) })
            .unwrap_or(value);
        let word = if target.met(value) { "met   " } else { "MISSED" };
        let bound = if target.at_most { "at most" } else { "at least" };
        let _ = writeln!(
            text,
            "{word} {name:<9} mean {:>9.digits$}, worst {:>9.digits$}, {bound} {:.digits$}",
            value * factor,
            worst * factor,
            target.limit * factor,
        );
    }
    if let Some(baseline) = baseline {
        text.push_str(&comparison(metrics, baseline));
    }
    text
}

/// Ratios of means to those of an earlier result; where that has other scenes, of the scenes that both have.
fn comparison(metrics: &Metrics, baseline: &Metrics) -> String {
    let mut text = String::from("against the baseline, over the scenes of both: now, then, ratio\n");
    for (key, name, factor, digits) in COLUMNS {
        let suffix = format!(".{key}");
        let pairs: Vec<(f64, f64)> = metrics
            .iter()
            .filter(|(k, _)| k.starts_with("bench.scan.billiards_") && k.ends_with(&suffix))
            .filter_map(|(k, v)| Some((v.as_f64()?, baseline.number(k)?)))
            .collect();
        if pairs.is_empty() {
            continue;
        }
        let n = pairs.len() as f64;
        let now = pairs.iter().map(|p| p.0).sum::<f64>() / n;
        let then = pairs.iter().map(|p| p.1).sum::<f64>() / n;
        let _ = writeln!(
            text,
            "  {name:<9} {:>9.digits$} {:>9.digits$}  × {:.3}",
            now * factor,
            then * factor,
            now / then
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_targets_and_ratios_are_of_the_generated_scenes() {
        let scenes: Vec<BenchScene> =
            ["1001", "1002", "seq_tabletop_bin"].iter().map(|s| s.parse().unwrap()).collect();
        let mut m = Metrics::new();
        m.set("bench.scan.billiards_1001.f1_2p5mm", 0.9).set("bench.scan.billiards_1002.f1_2p5mm", 1.0);
        m.set("bench.scan.seq_tabletop_bin.f1_2p5mm", 0.1);
        m.set("bench.scan.billiards_1001.surface_median_m", 0.002);
        let baseline = m.clone();
        m.set("bench.scan.billiards_1002.f1_2p5mm", 0.98);
        add_means(&mut m, &scenes);
        assert!((m.number("bench.scan.mean.f1_2p5mm").unwrap() - 0.94).abs() < 1e-12);
        let text = table(&m, &scenes, "standard", Some(&baseline));
        assert!(text.contains("MISSED F1@2.5") && text.contains("worst    0.9000"), "{text}");
        assert!(text.contains("MISSED surf. mm"), "{text}");
        assert!(text.contains("× 0.989"), "{text}");
    }
}
