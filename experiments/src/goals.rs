//! Where the goal of a fixed scene may lie: brute force with the arm, each place judged by which of the shots pass it. The
//! paper adjusted its goals by hand; ours, where a layout draws them too near, are chosen from this table.

use crate::BenchError;
use crate::solvability::{Table, rebounds, task_in};
use glamx::DVec2;
use rayon::prelude::*;
use sms_core::{Cancel, Progress, Seed};
use sms_plan::{GridBaseline, Halton, PlanError};
use sms_sim::{ContactEvent, RapierFactory, Simulation};
use sms_synth::{BALL_RADIUS_M, FixedScene, TruthScene};
use sms_task::{Action, Recording};
use std::sync::atomic::{AtomicU64, Ordering};

/// Time between the recorded places of the target ball, seconds: a centimetre at most.
const RECORD_EVERY_S: f64 = 1.0 / 120.0;
/// Farthest goal from the robot's base and from its middle line, metres: floor that a scan shows.
const FARTHEST_M: f64 = 0.95;
const ASIDE_M: f64 = 0.42;
/// Places looked at: a grid of this width, metres.
const STEP_M: f64 = 0.03;
/// Within this a shot counts as one that gets there, metres (a task's default).
const SUCCESS_M: f64 = 0.05;

/// What to look at.
#[derive(Debug, Clone)]
pub struct GoalsBench {
    /// Scenes.
    pub scenes: Vec<FixedScene>,
    /// Shots of the arm, spread evenly over speed and angle.
    pub shots: u64,
    /// Fastest strike that counts, metres per second. A goal that takes the fastest there are leaves a planner nothing to spare
    /// where what it was told of materials takes more speed than the truth.
    pub fastest_m_s: f64,
    /// Distances of a goal from the target ball, metres.
    pub distance_m: [f64; 2],
    /// Least share of shots that come within 5 cm.
    pub least_share: f64,
    /// The most that the best shot may miss by, metres.
    pub best_m: f64,
    /// Nearest that a straight shot may come, metres, in scenes that are to need a rebound.
    pub direct_m: f64,
    /// Places of each scene that the baseline is tried on, those that most shots pass first.
    pub places: usize,
}

/// A place for a goal.
#[derive(Debug, Clone, PartialEq)]
pub struct GoalPlace {
    /// Number of the scene, 1 to 18.
    pub scene: usize,
    /// The place, world x and y; metres.
    pub goal_w: DVec2,
    /// From the target ball, metres.
    pub distance_m: f64,
    /// Best shot by number of rebounds (none, one, more), metres; infinite where there is none of that kind.
    pub best_m: [f64; 3],
    /// Share of all shots, the ones too fast to count among them, that come within 5 cm.
    pub share: f64,
    /// What the paper's baseline comes to, planning with the true shapes; metres.
    pub grid_m: f64,
}

/// A shot that was carried out to its end.
struct Shot {
    /// Times and places of the target ball.
    track: Vec<(f64, DVec2)>,
    contacts: Vec<ContactEvent>,
}

impl Shot {
    /// How near to a place the target ball comes and when.
    fn nearest(&self, place: DVec2) -> (f64, f64) {
        let mut best = (f64::INFINITY, 0.0);
        for pair in self.track.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let along = b.1 - a.1;
            let t = ((place - a.1).dot(along) / along.length_squared().max(1e-12)).clamp(0.0, 1.0);
            let d = place.distance(a.1 + along * t);
            if d < best.0 {
                best = (d, a.0 + (b.0 - a.0) * t);
            }
        }
        best
    }
}

struct Looking<'a> {
    bench: &'a GoalsBench,
    fixed: FixedScene,
    truth: TruthScene,
    table: Table,
}

impl Looking<'_> {
    fn shot(&self, simulation: &mut Simulation, action: &Action) -> Result<Option<Shot>, BenchError> {
        let task = &self.table.task;
        simulation.restore();
        // With a recording a shot goes on after it has passed the scene's own goal.
        let whole = Some(Recording { every_s: RECORD_EVERY_S });
        let found = task
            .striker(&task.strike(action))
            .and_then(|s| task.rollout(simulation, s, &self.table.bodies, whole));
        let rollout = match found {
            Ok(rollout) => rollout,
            Err(e) if e.is_invalid_rollout() => return Ok(None),
            Err(e) => return Err(PlanError::from(e).into()),
        };
        let recorded = rollout.trajectory.unwrap_or_default();
        let start = (0.0, task.target().center_w.truncate());
        let Some(moved) = recorded.body(&task.target().name) else {
            return Ok(Some(Shot { track: vec![start, start], contacts: rollout.contacts }));
        };
        let places = moved.states.iter().map(|s| s.x_wb.translation.truncate());
        let track = recorded.times_s.iter().copied().zip(places).collect();
        Ok(Some(Shot { track, contacts: rollout.contacts }))
    }

    /// Free floor at the distances asked for.
    fn is_free(&self, place: DVec2) -> bool {
        let target = self.table.task.target().center_w.truncate();
        let cue = self.table.task.cue().center_w.truncate();
        let [near, far] = self.bench.distance_m;
        (near..=far).contains(&place.distance(target))
            && place.distance(cue) > 0.12
            && place.length() <= FARTHEST_M
            && place.y.abs() <= ASIDE_M
            && self.truth.objects.iter().all(|o| {
                let bounds = o.aabb_w();
                let (low, high) = (bounds.min.truncate(), bounds.max.truncate());
                let nearest = place.clamp(low, high);
                [&self.truth.cue, &self.truth.target].contains(&&o.name)
                    || place.distance(nearest) > BALL_RADIUS_M
            })
    }

    fn judge(&self, place: DVec2, shots: &[Shot]) -> GoalPlace {
        let (mut best_m, mut within) = ([f64::INFINITY; 3], 0usize);
        for shot in shots {
            let (d, at_s) = shot.nearest(place);
            let Some(count) = rebounds(&shot.contacts, at_s, &self.table.scene, &self.table.task) else {
                continue;
            };
            best_m[count.min(2)] = best_m[count.min(2)].min(d);
            within += usize::from(d <= SUCCESS_M);
        }
        GoalPlace {
            scene: self.fixed.number,
            goal_w: place,
            distance_m: place.distance(self.table.task.target().center_w.truncate()),
            best_m,
            share: within as f64 / self.bench.shots as f64,
            grid_m: f64::NAN,
        }
    }

    fn is_fit(&self, place: &GoalPlace) -> bool {
        let best = place.best_m.iter().copied().fold(f64::INFINITY, f64::min);
        let needs_rebound = self.fixed.number >= 8;
        best <= self.bench.best_m
            && place.share >= self.bench.least_share
            && (!needs_rebound || place.best_m[0] >= self.bench.direct_m)
    }

    fn look(&self, cancel: &Cancel) -> Result<Vec<GoalPlace>, BenchError> {
        let task = &self.table.task;
        let mut simulation = self.table.world(&RapierFactory, &task.world_options())?;
        let points = Halton::new(task.parameters().len(), Seed(self.fixed.seed));
        let mut shots = Vec::new();
        for i in 0..self.bench.shots {
            cancel.check()?;
            let action = self.table.action_at(&points.point(i));
            if task.strike(&action).speed > self.bench.fastest_m_s {
                continue;
            }
            shots.extend(self.shot(&mut simulation, &action)?);
        }
        let mut fit: Vec<GoalPlace> = Vec::new();
        let steps = |extent: f64| (extent / STEP_M) as i64;
        for x in 0..=steps(FARTHEST_M) {
            for y in -steps(ASIDE_M)..=steps(ASIDE_M) {
                let place = DVec2::new(x as f64, y as f64) * STEP_M;
                if self.is_free(place) {
                    fit.extend(Some(self.judge(place, &shots)).filter(|p| self.is_fit(p)));
                }
            }
        }
        fit.sort_by(|a, b| b.share.total_cmp(&a.share));
        fit.truncate(self.bench.places);
        let own = self.judge(DVec2::from_array(self.truth.goal_w), &shots);
        fit.insert(0, own);
        for place in &mut fit {
            let scene = &self.table.scene;
            let there = task_in(scene, &self.truth, place.goal_w.to_array())?;
            let plan = GridBaseline::default().plan(&there, scene)?;
            if let Some(shot) = self.shot(&mut simulation, &plan.action)? {
                place.grid_m = shot.nearest(place.goal_w).0;
            }
        }
        Ok(fit)
    }
}

/// Places for the goals of scenes: first the goal that a scene has, then the fit ones, those that most shots pass first.
///
/// # Errors
/// [`BenchError`]: a scene that cannot be simulated, or interruption.
pub fn run_goals(
    bench: &GoalsBench,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Vec<GoalPlace>, BenchError> {
    progress.begin("goals", bench.scenes.len() as u64);
    let done = AtomicU64::new(0);
    let found: Vec<Vec<GoalPlace>> = bench
        .scenes
        .par_iter()
        .map(|&fixed| {
            let truth = fixed.generate();
            let Some(table) = Table::new(&truth)? else { return Ok(Vec::new()) };
            let places = Looking { bench, fixed, truth, table }.look(cancel);
            progress.update(done.fetch_add(1, Ordering::SeqCst) + 1, "scenes");
            places
        })
        .collect::<Result<_, BenchError>>()?;
    progress.end("");
    Ok(found.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shot_is_nearest_between_its_recorded_places() {
        let track = vec![(0.0, DVec2::ZERO), (0.5, DVec2::new(1.0, 0.0)), (1.0, DVec2::new(1.0, 1.0))];
        let shot = Shot { track, contacts: Vec::new() };
        let (d, at_s) = shot.nearest(DVec2::new(0.6, -0.25));
        assert!((d - 0.25).abs() < 1e-12 && (at_s - 0.3).abs() < 1e-12);
        let (d, at_s) = shot.nearest(DVec2::new(1.5, 2.0));
        assert!((d - 1.25f64.sqrt()).abs() < 1e-12 && at_s == 1.0);
        // A ball that stays is where it is.
        let still = Shot { track: vec![(0.0, DVec2::ZERO); 2], contacts: Vec::new() };
        assert_eq!(still.nearest(DVec2::new(0.0, 0.3)).0, 0.3);
    }
}
