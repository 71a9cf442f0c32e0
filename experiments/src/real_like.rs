//! `sms-experiments real-like`: objects found and reconstructed in recordings with the errors of real sensors.

use crate::scenes::BenchScene;
use crate::stacked::Structure;
use crate::{BenchError, BenchOptions, MaterializeOptions, run_masks, run_materialize};
use serde::{Deserialize, Serialize};
use sms_core::StageContext;
use sms_core::metrics::Metrics;
use sms_eval::FOUND_IOU;
use sms_synth::Sensor;
use std::fmt::Write as _;

/// The result of one scene with one sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RealLikeRow {
    /// The sensor.
    pub sensor: Sensor,
    /// The scene.
    pub scene: BenchScene,
    /// Whether the scene is kept from tuning.
    pub is_held_out: bool,
    /// Objects in the scene.
    pub objects: usize,
    /// Objects with a mask that overlaps the true one by an IoU of at least 0.5, over all frames.
    pub found: usize,
    /// Masks that belong to no object.
    pub strays: usize,
    /// Mean F1 of the objects' meshes at 5 mm; 0 for an object without one.
    pub f1_5mm: f64,
    /// Why there is no result, or none of the meshes: the whole scene counts as 0.
    pub failure: Option<String>,
}

/// Returns a billiards scene and a stack for each seed; stacks take turns.
pub fn real_like_scenes(seeds: &[u64]) -> Vec<BenchScene> {
    let kinds = Structure::ALL.len() as u64;
    let stack = |seed: u64| Structure::ALL[(seed.wrapping_sub(1) % kinds) as usize];
    let stacks = seeds.iter().map(|&seed| BenchScene::DrawnStacked(stack(seed), seed));
    seeds.iter().map(|&seed| BenchScene::Billiards(seed)).chain(stacks).collect()
}

/// Returns whether a scene is kept from tuning: those of even seeds are.
pub fn is_held_out(scene: &BenchScene) -> bool {
    matches!(scene, BenchScene::Billiards(seed) | BenchScene::DrawnStacked(_, seed) if seed % 2 == 0)
}

/// Records a scene with the sensor of the options, finds its objects by geometry and makes their meshes.
///
/// # Errors
/// [`BenchError`] if interrupted. Other errors of a stage are the row's failure.
pub fn run_real_like(
    scene: &BenchScene,
    options: &MaterializeOptions,
    context: StageContext<'_>,
) -> Result<RealLikeRow, BenchError> {
    let objects = crate::generated(scene)?.map_or(0, |made| made.scene.objects.len());
    let bench = BenchOptions { true_masks: false, ..options.bench.clone() };
    let mut row = RealLikeRow {
        sensor: bench.sensor,
        scene: scene.clone(),
        is_held_out: is_held_out(scene),
        objects,
        found: 0,
        strays: 0,
        f1_5mm: 0.0,
        failure: None,
    };
    match run_masks(scene, &bench, None, context) {
        Ok(scored) => {
            row.strays = scored.iter().map(|(scores, _)| scores.false_labels).sum();
            let all = scored.iter().flat_map(|(scores, _)| &scores.objects);
            row.found = all.filter(|o| o.iou >= FOUND_IOU).count();
        }
        Err(error) => row.failure = Some(format!("masks: {error}")),
    }
    context.cancel.check()?;
    if row.failure.is_none() {
        match run_materialize(scene, options, context) {
            Ok(metrics) => {
                let key = format!("bench.materialize.{scene}.f1_5mm");
                row.f1_5mm = metrics.and_then(|m| m.number(&key)).unwrap_or(0.0);
            }
            Err(error) => row.failure = Some(format!("meshes: {error}")),
        }
    }
    context.cancel.check()?;
    Ok(row)
}

/// Figures of some rows.
struct Sums {
    found: usize,
    objects: usize,
    strays: usize,
    /// Mean over the scenes.
    f1_5mm: f64,
    failures: usize,
}

impl Sums {
    fn of(rows: &[&RealLikeRow]) -> Self {
        let sum = |of: fn(&RealLikeRow) -> usize| rows.iter().map(|r| of(r)).sum::<usize>();
        Self {
            found: sum(|r| r.found),
            objects: sum(|r| r.objects),
            strays: sum(|r| r.strays),
            f1_5mm: rows.iter().map(|r| r.f1_5mm).sum::<f64>() / rows.len() as f64,
            failures: sum(|r| usize::from(r.failure.is_some())),
        }
    }

    fn found_share(&self) -> f64 {
        self.found as f64 / self.objects.max(1) as f64
    }
}

/// Returns the rows of each sensor that has any, by parts: all scenes, those for tuning, those held out.
fn parts(rows: &[RealLikeRow]) -> Vec<(Sensor, &'static str, Vec<&RealLikeRow>)> {
    let mut all = Vec::new();
    for sensor in Sensor::ALL {
        for (part, keeps) in [("all", None), ("tuning", Some(false)), ("held_out", Some(true))] {
            let own: Vec<&RealLikeRow> = rows
                .iter()
                .filter(|r| r.sensor == sensor && keeps.is_none_or(|held| r.is_held_out == held))
                .collect();
            if !own.is_empty() {
                all.push((sensor, part, own));
            }
        }
    }
    all
}

/// Returns the figures `bench.real_like.SENSOR.PART.*`, where the part is `all`, `tuning` or `held_out`.
pub fn real_like_metrics(rows: &[RealLikeRow]) -> Metrics {
    let mut metrics = Metrics::new();
    for (sensor, part, own) in parts(rows) {
        let sums = Sums::of(&own);
        let key = |name: &str| format!("bench.real_like.{}.{part}.{name}", sensor.as_str());
        metrics.set(key("scenes"), own.len()).set(key("objects"), sums.objects);
        metrics.set(key("found_share"), sums.found_share()).set(key("f1_5mm"), sums.f1_5mm);
        metrics.set(key("strays"), sums.strays).set(key("failures"), sums.failures);
    }
    metrics
}

/// Returns one line for each sensor, and one for each scene with it.
pub fn real_like_table(rows: &[RealLikeRow]) -> String {
    let mut text =
        String::from("sensor        scenes     n   found (n objects)   strays   F1 at 5 mm   failures\n");
    for (sensor, part, own) in parts(rows) {
        let sums = Sums::of(&own);
        let share = format!("{:.1} % ({})", 100.0 * sums.found_share(), sums.objects);
        let (name, part) = (sensor.as_str(), part.replace('_', " "));
        let _ = writeln!(
            text,
            "{name:<13} {part:<9} {:>2}   {share:>17}   {:>6}   {:>10.3}   {:>8}",
            own.len(),
            sums.strays,
            sums.f1_5mm,
            sums.failures
        );
    }
    text += "\nscene                              held out   sensor          found   strays   F1 at 5 mm\n";
    for row in rows {
        let held_out = if row.is_held_out { "yes" } else { "no" };
        let (scene, found) = (row.scene.to_string(), format!("{}/{}", row.found, row.objects));
        let (sensor, failure) = (row.sensor.as_str(), row.failure.as_deref().unwrap_or(""));
        let _ = writeln!(
            text,
            "{scene:<34} {held_out:<10} {sensor:<13} {found:>7}   {:>6}   {:>10.3}   {failure}",
            row.strays, row.f1_5mm
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_over_objects_and_means_over_scenes() {
        let row = |seed: u64, objects, found, f1_5mm, failure: Option<&str>| {
            let scene = BenchScene::Billiards(seed);
            RealLikeRow {
                sensor: Sensor::D435,
                is_held_out: is_held_out(&scene),
                scene,
                objects,
                found,
                strays: 2,
                f1_5mm,
                failure: failure.map(str::to_owned),
            }
        };
        let rows = [row(1, 7, 7, 0.8, None), row(2, 3, 1, 0.4, None), row(3, 2, 0, 0.0, Some("masks: none"))];
        let metrics = real_like_metrics(&rows);
        let number = |key: &str| metrics.number(&format!("bench.real_like.d435.{key}")).unwrap();
        assert!((number("all.found_share") - 8.0 / 12.0).abs() < 1e-12);
        assert!((number("all.f1_5mm") - 0.4).abs() < 1e-12);
        assert_eq!((number("tuning.scenes"), number("held_out.scenes")), (2.0, 1.0));
        assert!((number("held_out.found_share") - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!((number("all.failures"), number("held_out.failures")), (1.0, 0.0));
        assert_eq!((number("all.strays"), number("held_out.strays")), (6.0, 2.0));
        assert!(metrics.number("bench.real_like.xtion.all.scenes").is_none());
        // Three lines for the sensor, three for the scenes, two headings and a gap.
        assert_eq!(real_like_table(&rows).lines().count(), 9);
    }

    #[test]
    fn every_seed_gives_a_billiards_scene_and_a_stack() {
        let scenes = real_like_scenes(&[5, 6]);
        let names: Vec<String> = scenes.iter().map(ToString::to_string).collect();
        assert_eq!(
            names,
            ["billiards_5", "billiards_6", "stacked_box_on_stool_5", "stacked_tote_on_table_6"]
        );
        let held: Vec<bool> = scenes.iter().map(is_held_out).collect();
        assert_eq!(held, [false, true, false, true]);
    }
}
