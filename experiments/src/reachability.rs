//! Whether the fixed scenes can be solved in a target engine: the shots that brute force in the planner's engine likes best,
//! executed there, and a search around the best of them.

use crate::BenchError;
use crate::solvability::{ArmScene, Tried};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::metrics::Metrics;
use sms_core::{Cancel, Progress, Seed};
use sms_plan::{Halton, LocalSearch, NelderMead};
use sms_sim::{RapierFactory, Simulation};
use sms_synth::{FIXED_SCENES, FixedScene};
use sms_target::Target;
use std::fmt::Write as _;
use std::sync::atomic::{AtomicU64, Ordering};

/// Candidates are at least this far apart, as shares of the ranges of speed and angle.
const APART: f64 = 0.02;
/// First steps of the search, as such shares: 0.02 m/s and a degree or so.
const STEP: f64 = 0.03;
/// The search ends at this distance to the goal, metres.
const GOOD_ENOUGH_M: f64 = 0.002;
/// From this distance on the search begins again at the next candidate, metres.
const POOR_M: f64 = 0.015;
/// Candidates around which is searched at most.
const SEARCHES: usize = 3;

/// Settings of the study.
#[derive(Debug, Clone)]
pub struct ReachabilityBench {
    /// Numbers of the fixed scenes, 1 to 18.
    pub scenes: Vec<usize>,
    /// Shots of the brute force in the planner's engine.
    pub shots: u64,
    /// Number of their best distinct ones that are executed in the target.
    pub candidates: usize,
    /// Number of the best distinct ones without a rebound that are also executed in the target.
    pub direct: usize,
    /// Shots of one search around the best.
    pub local: usize,
}

impl Default for ReachabilityBench {
    fn default() -> Self {
        Self { scenes: (1..=FIXED_SCENES.len()).collect(), shots: 600, candidates: 12, direct: 4, local: 40 }
    }
}

/// Result of one scene. Distances to the goal in metres, infinite without a shot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reachability {
    /// 1 to 18.
    pub scene: usize,
    /// Best shot of the brute force, in the planner's engine.
    pub planner_m: f64,
    /// Best of the candidates in the target.
    pub candidate_m: f64,
    /// Best of all shots in the target.
    pub best_m: f64,
    /// Its rebounds.
    pub rebounds: Option<usize>,
    /// Speed (m/s) and angle (rad).
    pub best_action: Vec<f64>,
    /// Best shot without a rebound in the planner's engine.
    pub planner_direct_m: f64,
    /// Best shot without a rebound in the target, of all that were executed there.
    pub direct_m: f64,
    /// Shots in the target.
    pub target_shots: usize,
}

/// Looks at the scenes.
///
/// # Errors
/// [`BenchError`]: a scene that an engine refuses, or interruption.
pub fn run_reachability(
    bench: &ReachabilityBench,
    target: &dyn Target,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Vec<Reachability>, BenchError> {
    let scenes: Vec<&FixedScene> = FIXED_SCENES.iter().filter(|s| bench.scenes.contains(&s.number)).collect();
    progress.begin(&format!("bench scenes: {}", target.label()), scenes.len() as u64);
    let done = AtomicU64::new(0);
    let found: Vec<Option<Reachability>> = scenes
        .par_iter()
        .map(|fixed| {
            let found = look(bench, fixed, target, cancel);
            progress.update(done.fetch_add(1, Ordering::SeqCst) + 1, "scenes");
            found
        })
        .collect::<Result<_, _>>()?;
    progress.end("");
    Ok(found.into_iter().flatten().collect())
}

fn look(
    bench: &ReachabilityBench,
    fixed: &FixedScene,
    target: &dyn Target,
    cancel: &Cancel,
) -> Result<Option<Reachability>, BenchError> {
    let Some(table) = ArmScene::new(&fixed.generate())? else { return Ok(None) };
    let (planned, units) = brute_force(bench, fixed, &table, cancel)?;
    let planner_direct = distinct(&planned, &units, bench.direct, |t| t.rebounds == Some(0));
    let mut chosen = distinct(&planned, &units, bench.candidates, |t| t.rebounds.is_some());
    let candidates = chosen.len();
    chosen.extend(
        planner_direct.iter().filter(|i| !chosen[..candidates].contains(i)).copied().collect::<Vec<_>>(),
    );

    let mut simulation = table.world(target.factory(), &target.world_options(&table.task.world_options()))?;
    let mut court = Court { table: &table, simulation: &mut simulation, tried: Vec::new(), shots: 0, cancel };
    // Candidates by their objective in the target.
    let mut starts: Vec<(f64, usize)> = Vec::new();
    for (place, &i) in chosen.iter().enumerate() {
        let objective = court.shoot(&units[i])?;
        if place < candidates {
            starts.push((objective, i));
        }
    }
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let candidate_m = starts.first().map_or(f64::INFINITY, |s| s.0);
    for &(known, start) in starts.iter().take(SEARCHES) {
        court.search(&units[start], known, bench.local)?;
        if court.best() <= POOR_M {
            break;
        }
    }
    let least = |tried: &[Tried], direct: bool| {
        let of = tried.iter().filter(|t| !direct || t.rebounds == Some(0));
        of.map(|t| t.objective).fold(f64::INFINITY, f64::min)
    };
    let best = court.tried.iter().min_by(|a, b| a.objective.total_cmp(&b.objective));
    Ok(Some(Reachability {
        scene: fixed.number,
        planner_m: least(&planned, false),
        candidate_m,
        best_m: court.best(),
        rebounds: best.and_then(|b| b.rebounds),
        best_action: best.map(|b| b.action.0.clone()).unwrap_or_default(),
        planner_direct_m: least(&planned, true),
        direct_m: least(&court.tried, true),
        target_shots: court.shots,
    }))
}

/// Shots of the planner's engine that reach the target ball, with their places in the unit box.
fn brute_force(
    bench: &ReachabilityBench,
    fixed: &FixedScene,
    table: &ArmScene,
    cancel: &Cancel,
) -> Result<(Vec<Tried>, Vec<Vec<f64>>), BenchError> {
    let mut simulation = table.world(&RapierFactory, &table.task.world_options())?;
    let points = Halton::new(table.task.parameters().len(), Seed(fixed.seed));
    let (mut tried, mut units) = (Vec::new(), Vec::new());
    for i in 0..bench.shots {
        cancel.check()?;
        let unit = points.point(i);
        if let Ok(shot) = table.shoot(&mut simulation, table.action_at(&unit))?
            && shot.rebounds.is_some()
        {
            tried.push(shot);
            units.push(unit);
        }
    }
    Ok((tried, units))
}

/// Indices of the best shots that are wanted, none near a better one.
fn distinct(
    tried: &[Tried],
    units: &[Vec<f64>],
    count: usize,
    wanted: impl Fn(&Tried) -> bool,
) -> Vec<usize> {
    let mut order: Vec<usize> = (0..tried.len()).filter(|&i| wanted(&tried[i])).collect();
    order.sort_by(|&a, &b| tried[a].objective.total_cmp(&tried[b].objective));
    let mut chosen: Vec<usize> = Vec::new();
    for i in order {
        let near = |&j: &usize| units[i].iter().zip(&units[j]).all(|(a, b)| (a - b).abs() < APART);
        if chosen.len() < count && !chosen.iter().any(near) {
            chosen.push(i);
        }
    }
    chosen
}

/// The target's world of a scene, and the shots in it.
struct Court<'a> {
    table: &'a ArmScene,
    simulation: &'a mut Simulation,
    tried: Vec<Tried>,
    shots: usize,
    cancel: &'a Cancel,
}

impl Court<'_> {
    /// Distance to the goal; infinite if the arm refuses or the engine cannot finish it.
    fn shoot(&mut self, unit: &[f64]) -> Result<f64, BenchError> {
        self.cancel.check()?;
        let outcome = self.table.shoot(self.simulation, self.table.action_at(unit))?;
        self.shots += 1;
        let Ok(tried) = outcome else { return Ok(f64::INFINITY) };
        let objective = tried.objective;
        self.tried.push(tried);
        Ok(objective)
    }

    fn search(&mut self, start: &[f64], known: f64, shots: usize) -> Result<(), BenchError> {
        let method = NelderMead { max_iterations: shots, ..NelderMead::default() };
        let steps = vec![STEP; start.len()];
        let mut search = LocalSearch::new(&method, &[start.to_vec()], &steps, Some(known));
        for _ in 0..shots {
            let Some(unit) = search.next_point().map(<[f64]>::to_vec) else { break };
            search.tell(self.shoot(&unit)?);
            if self.best() <= GOOD_ENOUGH_M {
                break;
            }
        }
        Ok(())
    }

    fn best(&self) -> f64 {
        self.tried.iter().map(|t| t.objective).fold(f64::INFINITY, f64::min)
    }
}

/// Keys `bench.scenes.fixed_NN.{planner,candidate,best,planner_direct,direct}_m` and `….target_shots`; missing values
/// has no key.
pub fn reachability_metrics(found: &[Reachability]) -> Metrics {
    let mut metrics = Metrics::new();
    metrics.set("bench.scenes.scenes", found.len());
    metrics.set("bench.scenes.solved", found.iter().filter(|s| s.best_m <= POOR_M).count());
    for s in found {
        for (name, value) in [
            ("planner", s.planner_m),
            ("candidate", s.candidate_m),
            ("best", s.best_m),
            ("planner_direct", s.planner_direct_m),
            ("direct", s.direct_m),
        ] {
            if value.is_finite() {
                metrics.set(format!("bench.scenes.fixed_{:02}.{name}_m", s.scene), value);
            }
        }
        metrics.set(format!("bench.scenes.fixed_{:02}.target_shots", s.scene), s.target_shots);
    }
    metrics
}

/// The results as a table, distances in millimetres.
pub fn reachability_table(found: &[Reachability], engine: &str) -> String {
    let mm = |m: f64| if m.is_finite() { format!("{:.1}", 1e3 * m) } else { "-".to_owned() };
    let mut text = format!(
        "distance to the goal, mm: best shot of the planner's engine; of its best ones and of all in {engine}\n\n\
         | scene | planner | candidates | best | its rebounds | no rebound: planner | no rebound | shots |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- |\n"
    );
    for s in found {
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} | {} |",
            s.scene,
            mm(s.planner_m),
            mm(s.candidate_m),
            mm(s.best_m),
            s.rebounds.map_or_else(|| "-".to_owned(), |n| n.to_string()),
            mm(s.planner_direct_m),
            mm(s.direct_m),
            s.target_shots
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::NoProgress;
    use sms_target::SameEngineTarget;
    use sms_task::Action;

    #[test]
    fn the_scene_without_obstacles_is_solved_directly() {
        let bench = ReachabilityBench { scenes: vec![1], shots: 150, candidates: 3, direct: 2, local: 20 };
        let found = run_reachability(&bench, &SameEngineTarget, &NoProgress, &Cancel::new()).unwrap();
        let s = &found[0];
        assert!((s.scene, s.rebounds) == (1, Some(0)) && s.best_action.len() == 2, "{s:?}");
        // The search improves on the planner's proposals, and the best shot has no rebound.
        assert!(s.best_m < 0.01 && s.best_m < s.candidate_m && s.direct_m == s.best_m, "{s:?}");
        assert!((4..=3 + 2 + 3 * 20).contains(&s.target_shots), "{s:?}");
        assert_eq!(reachability_metrics(&found).number("bench.scenes.fixed_01.best_m"), Some(s.best_m));
        assert!(reachability_table(&found, "rapier").contains("| 1 |"));
    }

    #[test]
    fn candidates_are_the_best_and_not_neighbours() {
        let shot = |objective: f64, rebounds| Tried { action: Action(vec![]), objective, rebounds };
        let tried = [shot(0.3, Some(0)), shot(0.1, Some(1)), shot(0.11, Some(1)), shot(0.2, Some(0))];
        let units = [vec![0.1, 0.1], vec![0.5, 0.5], vec![0.51, 0.505], vec![0.5, 0.6]];
        assert_eq!(distinct(&tried, &units, 3, |_| true), [1, 3, 0]);
        assert_eq!(distinct(&tried, &units, 2, |t| t.rebounds == Some(0)), [3, 0]);
    }
}
