//! Results of refined orbits: the table for people, and the figures.

use super::{BoxErrors, OrbitKind, PoseFault};
use sms_core::metrics::Metrics;
use std::collections::BTreeMap;
use std::fmt::Write;

/// The result of one orbit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrbitRow {
    /// Kind of the scene.
    pub orbit: OrbitKind,
    /// Fault of the poses.
    pub fault: PoseFault,
    /// Scale of the given camera centres.
    pub scale_before: f64,
    /// Scale of the refined camera centres.
    pub scale: f64,
    /// Errors of the box with the given poses.
    pub faces_before: BoxErrors,
    /// Errors of the box with the refined poses.
    pub faces: BoxErrors,
    /// Whether the refined poses are judged better.
    pub is_improved: bool,
    /// Median residual of held-out pairs, metres.
    pub residual_m: Option<f64>,
    /// Estimated shift of the colour, pixels.
    pub color_shift_px: [f64; 2],
    /// Time of the refinement.
    pub seconds: f64,
}

type Groups<'a> = BTreeMap<(OrbitKind, PoseFault), Vec<&'a OrbitRow>>;

fn groups(rows: &[OrbitRow]) -> Groups<'_> {
    let mut groups = Groups::new();
    for row in rows {
        groups.entry((row.orbit, row.fault)).or_default().push(row);
    }
    groups
}

fn mean_and_rms(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let values: Vec<f64> = values.collect();
    let n = values.len().max(1) as f64;
    (values.iter().sum::<f64>() / n, (values.iter().map(|v| v * v).sum::<f64>() / n).sqrt())
}

/// Figures of each scene and fault, in the order of the columns of [`orbit_table`].
fn figures(rows: &[&OrbitRow]) -> [(&'static str, f64); 9] {
    let scale = |f: fn(&OrbitRow) -> f64| mean_and_rms(rows.iter().map(|r| f(r) - 1.0));
    let length = |f: fn(&OrbitRow) -> f64| mean_and_rms(rows.iter().map(|r| f(r)));
    let (bias, _) = scale(|r| r.scale);
    let (_, spread) = scale(|r| r.scale);
    let improved = rows.iter().filter(|r| r.is_improved).count() as f64 / rows.len().max(1) as f64;
    [
        ("scale_bias", bias),
        ("scale_rms", spread),
        ("width_before_rms_m", length(|r| r.faces_before.width_m).1),
        ("width_bias_m", length(|r| r.faces.width_m).0),
        ("width_rms_m", length(|r| r.faces.width_m).1),
        ("depth_bias_m", length(|r| r.faces.depth_m).0),
        ("depth_rms_m", length(|r| r.faces.depth_m).1),
        ("improved_share", improved),
        ("seconds", length(|r| r.seconds).0),
    ]
}

/// Returns the figures `bench.orbits.SCENE.FAULT.*`.
pub fn orbit_metrics(rows: &[OrbitRow]) -> Metrics {
    let mut m = Metrics::new();
    for ((orbit, fault), rows) in groups(rows) {
        let prefix = format!("bench.orbits.{}.{}", orbit.as_str(), fault.as_str());
        m.set(format!("{prefix}.n"), rows.len());
        for (key, value) in figures(&rows) {
            m.set(format!("{prefix}.{key}"), value);
        }
    }
    m
}

/// Returns a table with one line per scene and fault.
pub fn orbit_table(rows: &[OrbitRow]) -> String {
    let mut out = format!(
        "{:<5} {:<12} {:>3} {:>10} {:>9} {:>11} {:>10} {:>9} {:>10} {:>9} {:>7} {:>6}\n",
        "scene",
        "fault",
        "n",
        "scale bias",
        "rms",
        "given width",
        "width bias",
        "rms",
        "depth bias",
        "rms",
        "better",
        "s"
    );
    for ((orbit, fault), rows) in groups(rows) {
        let f = figures(&rows).map(|f| f.1);
        let _ = writeln!(
            out,
            "{:<5} {:<12} {:>3} {:>8.3} % {:>7.3} % {:>8.2} mm {:>7.2} mm {:>6.2} mm {:>7.2} mm {:>6.2} mm {:>5.0} % {:>6.1}",
            orbit.as_str(),
            fault.as_str(),
            rows.len(),
            1e2 * f[0],
            1e2 * f[1],
            1e3 * f[2],
            1e3 * f[3],
            1e3 * f[4],
            1e3 * f[5],
            1e3 * f[6],
            1e2 * f[7],
            f[8]
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_roots_of_mean_squares_are_per_scene_and_fault() {
        let row = |fault, scale, width_m| OrbitRow {
            orbit: OrbitKind::Box,
            fault,
            scale_before: 1.0,
            scale,
            faces_before: BoxErrors::default(),
            faces: BoxErrors { width_m, depth_m: 0.0 },
            is_improved: width_m > 0.0,
            residual_m: None,
            color_shift_px: [0.0; 2],
            seconds: 2.0,
        };
        let rows = [
            row(PoseFault::Drift, 1.01, 0.003),
            row(PoseFault::Drift, 0.99, -0.001),
            row(PoseFault::Exact, 1.0, 0.0),
        ];
        let m = orbit_metrics(&rows);
        let n = |key: &str| m.number(&format!("bench.orbits.box.drift.{key}")).unwrap();
        assert_eq!((n("n"), n("improved_share"), n("seconds")), (2.0, 0.5, 2.0));
        assert!(n("scale_bias").abs() < 1e-12 && (n("scale_rms") - 0.01).abs() < 1e-12);
        assert!((n("width_bias_m") - 0.001).abs() < 1e-12);
        assert!((n("width_rms_m") - 5f64.sqrt() * 1e-3).abs() < 1e-12);
        assert_eq!(orbit_table(&rows).lines().count(), 3);
    }
}
