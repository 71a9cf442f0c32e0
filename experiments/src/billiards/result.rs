//! Kept results of a scene.

use super::{Ablation, BilliardsBench, BilliardsGeometry, Drawing, Row, Unfinished};
use crate::{BenchError, MaterialPrior};
use serde::{Deserialize, Serialize};
use sms_core::table::{Column, write_table};
use sms_core::{CoreError, Hash, atomic};
use sms_synth::{FIXED_SCENES, FixedScene, Layout};
use sms_task::Action;
use std::collections::BTreeMap;
use std::path::Path;

/// One plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shot {
    /// The strike; `None` if the planner found none that the robot can make. The shot then does nothing.
    pub action: Option<Action>,
    /// Objective in the scanned world, metres; without an action, the distance of target ball and goal.
    pub predicted_m: f64,
    /// Mean over worlds that were not used to choose it, if the plan has one.
    pub predicted_mean_m: Option<f64>,
    /// Rollouts.
    pub evaluations: usize,
    /// Iterations of the local searches (`paper`: of the one search, which ends when it has converged or after 30).
    pub iterations: usize,
    /// Whether the arm can make the strike; else a kinematic finger makes it (the baseline has no arm).
    pub by_arm: bool,
}

impl Shot {
    /// The shot that does nothing: the target ball stays `idle_m` from the goal.
    pub(super) fn nothing(idle_m: f64) -> Self {
        Self {
            action: None,
            predicted_m: idle_m,
            predicted_mean_m: None,
            evaluations: 0,
            iterations: 0,
            by_arm: true,
        }
    }

    /// Predicted objective, metres: the mean over perturbed worlds if there is one, else the nominal one.
    pub(super) fn expected_m(&self) -> f64 {
        self.predicted_mean_m.unwrap_or(self.predicted_m)
    }
}

/// A scene's plans and their outcomes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BilliardsScene {
    /// Hash of the plans' inputs.
    pub key: Hash,
    /// 1 to 18.
    pub number: usize,
    /// The scene's layout.
    pub layout: Layout,
    /// The planner's knowledge of materials.
    #[serde(rename = "told")]
    pub material_prior: MaterialPrior,
    /// Source of its geometry.
    pub geometry: BilliardsGeometry,
    /// Distance of the target ball from the goal without an action, metres (truth).
    pub idle_m: f64,
    /// Objects of the true scene.
    pub objects: usize,
    /// Objects that have a body of the planner's scene in their place.
    pub matched: usize,
    /// Bodies of the planner's scene, fixed ones included, that match no object.
    pub strays: usize,
    /// Reason for which nothing could be planned.
    pub problem: Option<String>,
    /// Reason for which nothing could be planned in row `paper`, which builds its bodies differently.
    #[serde(default)]
    pub paper_problem: Option<String>,
    /// Plans of every row.
    pub plans: BTreeMap<Row, Vec<Shot>>,
    /// Planning time by row, seconds.
    pub seconds: BTreeMap<Row, f64>,
    /// Realised objectives, metres, by the engine's name in metrics, in the order of `plans`; `None` where the engine could
    /// not finish the shot.
    pub realised: BTreeMap<String, BTreeMap<Row, Vec<Option<f64>>>>,
    /// Reasons for which an engine could not finish a shot, by its name in metrics, row and index in `realised`.
    #[serde(default)]
    pub unfinished: BTreeMap<String, BTreeMap<Row, Unfinished>>,
    /// Engines that could not be used, with the reason.
    #[serde(default)]
    pub not_run: BTreeMap<String, String>,
    /// CPU seconds of this process in each part: `see` (reading or making scan and bodies), `plan_{row}`, `{engine}`.
    #[serde(default)]
    pub cpu_s: BTreeMap<String, f64>,
    /// Data of the pictures.
    #[serde(default)]
    pub drawing: Drawing,
    /// The ablation.
    #[serde(default)]
    pub ablation: Option<Ablation>,
}

impl BilliardsScene {
    /// Realised objectives of a row, metres. A shot that the engine could not finish counts as one that does nothing.
    pub fn realised_m(&self, engine: &str, row: Row) -> Option<Vec<f64>> {
        let values = self.realised.get(engine)?.get(&row)?;
        Some(values.iter().map(|v| v.unwrap_or(self.idle_m)).collect())
    }

    /// Reason that the engine could not finish a shot; `None` if it could, or in files of earlier versions.
    pub fn why_unfinished(&self, engine: &str, row: Row, start: usize) -> Option<&str> {
        self.unfinished.get(engine)?.get(&row)?.get(&start).map(String::as_str)
    }

    /// Predicted objectives of a row, metres.
    pub fn predicted_m(&self, row: Row) -> Vec<f64> {
        self.plans.get(&row).map_or_else(Vec::new, |shots| shots.iter().map(|s| s.predicted_m).collect())
    }
}

/// Reads the kept results of a scene; `None` if there are none, or of other inputs.
pub(super) fn kept(
    bench: &BilliardsBench,
    scene: &FixedScene,
    material_prior: MaterialPrior,
) -> Result<Option<BilliardsScene>, CoreError> {
    let path = bench.file(scene, material_prior);
    if !path.is_file() {
        return Ok(None);
    }
    // A file of an earlier version is made again.
    let Ok(found) = atomic::read_json::<BilliardsScene>(&path) else { return Ok(None) };
    Ok(Some(found).filter(|f| f.key == bench.key(scene, material_prior)))
}

/// All results in the folder that were made with the settings of `bench`, of this run and of others, in the order of
/// materials and scenes: of the fixed scenes, or, where `bench` has drawn ones, of its own.
///
/// # Errors
/// [`BenchError`] of a file that cannot be read.
pub fn read_billiards(bench: &BilliardsBench) -> Result<Vec<BilliardsScene>, BenchError> {
    let mut all = Vec::new();
    let is_fixed = bench.scenes.iter().all(FixedScene::is_fixed);
    let scenes = if is_fixed { &FIXED_SCENES[..] } else { &bench.scenes[..] };
    for material_prior in MaterialPrior::ALL {
        for scene in scenes {
            all.extend(kept(bench, scene, material_prior)?);
        }
    }
    Ok(all)
}

/// Writes one row for every shot and engine as Parquet: `scene`, `layout`, `geometry`, `materials`, `engine`, `row`,
/// `start`, `predicted_m`, `realised_m`, `finished`, `why`, `evaluations`, `iterations`, `by_arm`, `speed_mps`, `angle_rad`.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_shots(path: &Path, scenes: &[BilliardsScene]) -> Result<(), CoreError> {
    let (mut scene, mut start, mut evaluations, mut iterations) = (vec![], vec![], vec![], vec![]);
    let (mut finished, mut why, mut by_arm) = (vec![], vec![], vec![]);
    let (mut layout, mut geometry, mut material_prior, mut engines, mut rows) =
        (vec![], vec![], vec![], vec![], vec![]);
    let (mut predicted, mut realised, mut speed, mut angle) = (vec![], vec![], vec![], vec![]);
    for s in scenes {
        for (engine, of_engine) in &s.realised {
            for (row, values) in of_engine {
                for (i, (shot, value)) in s.plans[row].iter().zip(values).enumerate() {
                    let parameter =
                        |k: usize| shot.action.as_ref().and_then(|a| a.0.get(k).copied()).unwrap_or(f64::NAN);
                    scene.push(s.number as i32);
                    layout.push(s.layout.as_str().to_owned());
                    geometry.push(s.geometry.as_str().to_owned());
                    material_prior.push(s.material_prior.as_str().to_owned());
                    engines.push(engine.clone());
                    rows.push(row.as_str().to_owned());
                    start.push(i as i32);
                    predicted.push(shot.predicted_m);
                    realised.push(value.unwrap_or(s.idle_m));
                    finished.push(i32::from(value.is_some()));
                    why.push(s.why_unfinished(engine, *row, i).unwrap_or_default().to_owned());
                    evaluations.push(shot.evaluations as i32);
                    iterations.push(shot.iterations as i32);
                    by_arm.push(i32::from(shot.by_arm));
                    speed.push(parameter(0));
                    angle.push(parameter(1));
                }
            }
        }
    }
    let columns = [
        ("scene", Column::I32(scene)),
        ("layout", Column::Text(layout)),
        ("geometry", Column::Text(geometry)),
        ("materials", Column::Text(material_prior)),
        ("engine", Column::Text(engines)),
        ("row", Column::Text(rows)),
        ("start", Column::I32(start)),
        ("predicted_m", Column::F64(predicted)),
        ("realised_m", Column::F64(realised)),
        ("finished", Column::I32(finished)),
        ("why", Column::Text(why)),
        ("evaluations", Column::I32(evaluations)),
        ("iterations", Column::I32(iterations)),
        ("by_arm", Column::I32(by_arm)),
        ("speed_mps", Column::F64(speed)),
        ("angle_rad", Column::F64(angle)),
    ];
    write_table(path, &columns)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use sms_task::Action;

    /// Scene 3 with one robust plan and its outcome in the engine `judge`.
    pub(in crate::billiards) fn scene(predicted_m: f64, realised_m: Option<f64>) -> BilliardsScene {
        let shot = Shot { action: Some(Action(vec![0.5, 0.1])), predicted_m, ..Shot::nothing(0.4) };
        let of = |v| BTreeMap::from([(Row::Robust, vec![v])]);
        BilliardsScene {
            key: Hash("k".into()),
            number: 3,
            layout: Layout::ALL[1],
            material_prior: MaterialPrior::Class,
            geometry: BilliardsGeometry::Truth,
            idle_m: 0.4,
            objects: 4,
            matched: 4,
            strays: 0,
            problem: None,
            paper_problem: None,
            plans: BTreeMap::from([(Row::Robust, vec![shot])]),
            seconds: BTreeMap::new(),
            realised: BTreeMap::from([("judge".to_owned(), of(realised_m))]),
            unfinished: BTreeMap::new(),
            not_run: BTreeMap::new(),
            cpu_s: BTreeMap::new(),
            drawing: Drawing::default(),
            ablation: None,
        }
    }
}
