//! Results of refined orbits: the table for people, and the figures.

use super::{BoxErrors, OrbitKind, PoseFault};
use sms_core::NORMAL_90;
use sms_core::metrics::Metrics;
use sms_poses::SizeUncertainty;
use std::collections::BTreeMap;

/// The result of one orbit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrbitRow {
    /// Kind of the scene.
    pub orbit: OrbitKind,
    /// Fault of the poses.
    pub fault: PoseFault,
    /// Scale of the refined camera centres.
    pub scale: f64,
    /// Errors of the box with the given poses.
    pub faces_before: BoxErrors,
    /// Errors of the box with the refined poses.
    pub faces: BoxErrors,
    /// Error of the fused surfaces with the refined poses, metres.
    pub surface_m: f64,
    /// That with the true poses.
    pub surface_true_m: f64,
    /// Standard deviations of scale and box as stated.
    pub sigmas: Sigmas,
    /// Whether the refined poses are judged better.
    pub is_improved: bool,
    /// Whether a change that many frames share exceeds the noise of the given poses.
    pub is_refused: bool,
    /// Time of the refinement.
    pub seconds: f64,
}

/// Stated standard deviations; `None` where none is stated.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sigmas {
    /// Of the scale of the camera centres.
    pub scale: Option<f64>,
    /// Of the distance between the faces across x, metres.
    pub width_m: Option<f64>,
    /// Of the distance between the faces across y, metres.
    pub depth_m: Option<f64>,
}

impl Sigmas {
    /// Takes them from the report of a refinement.
    pub fn of(size: &SizeUncertainty) -> Self {
        let across = |axis: usize| {
            let found = size.extents.iter().find(|e| e.direction_w[axis].abs() > 0.999);
            found.map(|e| e.sigma_m)
        };
        Self { scale: Some(size.scale_sigma), width_m: across(0), depth_m: across(1) }
    }
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

/// Figures of each scene and fault, in the order of [`COLUMNS`].
fn figures(rows: &[&OrbitRow]) -> [(&'static str, f64); 16] {
    let of = |f: fn(&OrbitRow) -> f64| mean_and_rms(rows.iter().map(|r| f(r)));
    let (scale_bias, scale_rms) = of(|r| r.scale - 1.0);
    let (width_bias_m, width_rms_m) = of(|r| r.faces.width_m);
    let (depth_bias_m, depth_rms_m) = of(|r| r.faces.depth_m);
    let share =
        |is: fn(&OrbitRow) -> bool| rows.iter().filter(|r| is(r)).count() as f64 / rows.len().max(1) as f64;
    let (surface_m, _) = of(|r| r.surface_m);
    // The share of the errors within the stated 90 % intervals, of scale, width and depth together.
    let stated = rows.iter().flat_map(|r| {
        let s = r.sigmas;
        [(r.scale - 1.0, s.scale), (r.faces.width_m, s.width_m), (r.faces.depth_m, s.depth_m)]
    });
    let held: Vec<bool> = stated.filter_map(|(e, s)| Some(e.abs() <= NORMAL_90 * s?)).collect();
    let coverage = held.iter().filter(|h| **h).count() as f64 / held.len().max(1) as f64;
    let sigma = |f: fn(&Sigmas) -> Option<f64>| {
        let all: Vec<f64> = rows.iter().filter_map(|r| f(&r.sigmas)).collect();
        all.iter().sum::<f64>() / all.len().max(1) as f64
    };
    [
        ("scale_bias", scale_bias),
        ("scale_rms", scale_rms),
        ("scale_sigma", sigma(|s| s.scale)),
        ("width_before_rms_m", of(|r| r.faces_before.width_m).1),
        ("width_bias_m", width_bias_m),
        ("width_rms_m", width_rms_m),
        ("width_sigma_m", sigma(|s| s.width_m)),
        ("depth_bias_m", depth_bias_m),
        ("depth_rms_m", depth_rms_m),
        ("depth_sigma_m", sigma(|s| s.depth_m)),
        ("surface_m", surface_m),
        ("surface_ratio", of(|r| r.surface_m / r.surface_true_m).0),
        ("coverage", coverage),
        ("improved_share", share(|r| r.is_improved)),
        ("refused_share", share(|r| r.is_refused)),
        ("seconds", of(|r| r.seconds).0),
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

/// Headings of [`figures`], with the factor to the shown unit, the digits and the unit.
const COLUMNS: [(&str, f64, usize, &str); 16] = [
    ("scale bias", 1e2, 3, " %"),
    ("rms", 1e2, 3, " %"),
    ("σ", 1e2, 3, " %"),
    ("given width", 1e3, 2, " mm"),
    ("width bias", 1e3, 2, " mm"),
    ("rms", 1e3, 2, " mm"),
    ("σ", 1e3, 2, " mm"),
    ("depth bias", 1e3, 2, " mm"),
    ("rms", 1e3, 2, " mm"),
    ("σ", 1e3, 2, " mm"),
    ("surface", 1e3, 2, " mm"),
    ("of true", 1.0, 2, ""),
    ("in 90 %", 1e2, 0, " %"),
    ("better", 1e2, 0, " %"),
    ("refused", 1e2, 0, " %"),
    ("s", 1.0, 1, ""),
];

/// Returns a table with one line per scene and fault.
pub fn orbit_table(rows: &[OrbitRow]) -> String {
    let mut out = format!("{:<5} {:<12} {:>3}", "scene", "fault", "n");
    COLUMNS.iter().for_each(|column| out += &format!(" {:>11}", column.0));
    for ((orbit, fault), rows) in groups(rows) {
        out += &format!("\n{:<5} {:<12} {:>3}", orbit.as_str(), fault.as_str(), rows.len());
        for ((_, value), (_, factor, digits, unit)) in figures(&rows).into_iter().zip(COLUMNS) {
            out += &format!(" {:>11}", format!("{:.digits$}{unit}", factor * value));
        }
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
            scale,
            faces_before: BoxErrors::default(),
            faces: BoxErrors { width_m, depth_m: 0.0 },
            surface_m: 3e-4,
            surface_true_m: 2e-4,
            sigmas: Sigmas { scale: Some(0.01), width_m: Some(0.001), depth_m: None },
            is_improved: width_m > 0.0,
            is_refused: width_m < 0.0,
            seconds: 2.0,
        };
        let rows = [
            row(PoseFault::Drift, 1.01, 0.003),
            row(PoseFault::Drift, 0.99, -0.001),
            row(PoseFault::Exact, 1.0, 0.0),
        ];
        let m = orbit_metrics(&rows);
        let n = |key: &str| m.number(&format!("bench.orbits.box.drift.{key}")).unwrap();
        assert_eq!((n("n"), n("seconds")), (2.0, 2.0));
        assert_eq!((n("improved_share"), n("refused_share")), (0.5, 0.5));
        assert!(n("scale_bias").abs() < 1e-12 && (n("scale_rms") - 0.01).abs() < 1e-12);
        assert!((n("width_bias_m") - 0.001).abs() < 1e-12);
        assert!((n("width_rms_m") - 5f64.sqrt() * 1e-3).abs() < 1e-12);
        // Of two scales and two widths, one width is beyond its interval.
        assert_eq!((n("coverage"), n("width_sigma_m")), (0.75, 0.001));
        assert!((n("surface_ratio") - 1.5).abs() < 1e-12);
        assert_eq!(orbit_table(&rows).lines().count(), 3);
    }
}
