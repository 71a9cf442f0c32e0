//! The paper's baseline (appendix "Baseline Implementation Details"): a grid of speeds and angles, billiards geometry,
//! and an obstacle map in top view.

use glamx::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::InputError;
use sms_scene::{BodyShape, Scene};
use sms_task::{Action, ResolvedTask};

/// Predictions count as equal if they differ by less than this, metres: the model is not more accurate.
const RESOLUTION_M: f64 = 0.005;

/// Settings of the baseline. The grid and the threshold come from the paper; the other values are our choice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GridBaseline {
    /// Speeds, evenly spaced over `speed`.
    pub speeds: usize,
    /// Lowest and highest speed, m/s.
    pub speed: [f64; 2],
    /// Angles, evenly spaced over ± `angle`.
    pub angles: usize,
    /// Largest angle to the line from cue to target ball, radians.
    pub angle: f64,
    /// Points higher than this above the floor are obstacles, metres.
    pub threshold_m: f64,
    /// Edge length of a map cell, metres.
    pub cell_m: f64,
    /// Margin of the map around all bodies and the goal, metres. The workspace ends at the margin.
    pub margin_m: f64,
    /// Simulated motion of the target ball, seconds. The ball does not slow down, because the paper's model has no
    /// friction.
    pub horizon_s: f64,
}

impl Default for GridBaseline {
    fn default() -> Self {
        Self {
            speeds: 20,
            speed: [0.2, 0.85],
            angles: 60,
            angle: 10f64.to_radians(),
            threshold_m: 0.005,
            cell_m: 0.0025,
            margin_m: 0.5,
            horizon_s: 4.0,
        }
    }
}

/// The choice of the baseline.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridPlan {
    /// The action.
    pub action: Action,
    /// Predicted distance of the target ball to the goal, metres.
    pub predicted_m: f64,
}

impl GridBaseline {
    /// Tries the whole grid and returns the action with the smallest predicted distance of the target ball to the goal.
    /// Among predictions within 5 mm, the action with the fewest reflections wins, then the lowest speed, because a
    /// ball that never slows down passes almost everywhere after enough reflections.
    ///
    /// The model gives the cue ball the action's speed and angle at once, and the target ball the component along the
    /// line of centres. After that the target ball moves at constant velocity and is reflected by obstacles and by the
    /// borders of the map. No object moves.
    ///
    /// # Errors
    /// [`InputError`] for tasks other than billiards, and for an empty grid.
    pub fn plan(&self, task: &ResolvedTask, scene: &Scene) -> Result<GridPlan, InputError> {
        let Some(goal) = task.goal_w() else {
            return Err(InputError::new(
                "the grid baseline plans billiards only",
                "(task)",
                "use a task with kind = \"billiards\"",
            ));
        };
        let (cue, target) = (task.cue(), task.target());
        let (from, at) = (cue.center_w.truncate(), target.center_w.truncate());
        let map = Map::new(self, scene, &[cue.index, target.index], goal);
        let line = at - from;
        let apart = cue.radius + target.radius;
        let dimensions = task.parameters().len();
        let even = |k: usize, n: usize, [low, high]: [f64; 2]| {
            low + (high - low) * if n > 1 { k as f64 / (n - 1) as f64 } else { 0.5 }
        };
        let mut best: Option<([f64; 5], GridPlan)> = None;
        for s in 0..self.speeds {
            let speed = even(s, self.speeds, self.speed);
            for a in 0..self.angles {
                let angle = even(a, self.angles, [-self.angle, self.angle]);
                let heading = DVec2::from_angle(angle).rotate(line.normalize_or_zero());
                // Position of the cue ball when it touches the target ball.
                let ahead = line.dot(heading);
                let aside_squared = line.length_squared() - ahead * ahead;
                let reached = ahead > 0.0 && aside_squared < apart * apart;
                let (predicted_m, reflections) = if reached {
                    let contact = from + heading * (ahead - (apart * apart - aside_squared).sqrt());
                    let normal = (at - contact) / apart;
                    map.nearest(at, normal * speed * heading.dot(normal), target.radius, goal, self.horizon_s)
                } else {
                    (at.distance(goal), 0)
                };
                let class = (predicted_m / RESOLUTION_M).round();
                let key = [class, reflections as f64, predicted_m, speed, angle.abs()];
                if best.as_ref().is_none_or(|b| key < b.0) {
                    let mut values = vec![speed, angle];
                    values.resize(dimensions, 0.0);
                    let action = task.clamped(&Action(values));
                    best = Some((key, GridPlan { action, predicted_m }));
                }
            }
        }
        best.map(|b| b.1).ok_or_else(|| {
            InputError::new("the grid has no speeds or no angles", "(settings)", "give at least one of each")
        })
    }
}

/// An obstacle map of the floor: the distance of each cell centre to the nearest obstacle.
struct Map {
    low: DVec2,
    cell_m: f64,
    size: [usize; 2],
    /// Distances from obstacles, metres; at most the map's size.
    distance_m: Vec<f64>,
}

impl Map {
    fn new(settings: &GridBaseline, scene: &Scene, left_out: &[usize], goal: DVec2) -> Self {
        // Triangles of each body, with their heights, for the top view.
        let mut triangles: Vec<[DVec3; 3]> = Vec::new();
        let mut bounds = [goal, goal];
        let mut include = |p: DVec2| bounds = [bounds[0].min(p), bounds[1].max(p)];
        for (index, body) in scene.bodies.iter().enumerate() {
            if matches!(body.shape, BodyShape::HalfSpace) {
                continue;
            }
            let center = body.x_wb.translation.truncate();
            include(center);
            if left_out.contains(&index) {
                continue;
            }
            for t in 0..body.visual.triangles.len() {
                let corners = body.visual.corners(t).map(|p| body.x_wb.transform_point(p));
                if corners.iter().any(|p| p.z > settings.threshold_m) {
                    corners.iter().for_each(|p| include(p.truncate()));
                    triangles.push(corners);
                }
            }
        }
        let low = bounds[0] - DVec2::splat(settings.margin_m);
        let extent = bounds[1] + DVec2::splat(settings.margin_m) - low;
        let size = [extent.x, extent.y].map(|e| ((e / settings.cell_m).ceil() as usize).clamp(1, 4000));
        let mut occupied = vec![false; size[0] * size[1]];
        for t in &triangles {
            mark(t, settings, low, size, &mut occupied);
        }
        let distance_m = distances(&occupied, size).into_iter().map(|d| d.sqrt() * settings.cell_m).collect();
        Self { low, cell_m: settings.cell_m, size, distance_m }
    }

    /// Distance of a point from the nearest obstacle, bilinear between cells.
    fn clearance(&self, p: DVec2) -> f64 {
        let g = (p - self.low) / self.cell_m - DVec2::splat(0.5);
        let at = |i: f64, j: f64| {
            let x = (i.max(0.0) as usize).min(self.size[0] - 1);
            let y = (j.max(0.0) as usize).min(self.size[1] - 1);
            self.distance_m[y * self.size[0] + x]
        };
        let (i, j) = (g.x.floor(), g.y.floor());
        let (u, v) = (g.x - i, g.y - j);
        (1.0 - v) * ((1.0 - u) * at(i, j) + u * at(i + 1.0, j))
            + v * ((1.0 - u) * at(i, j + 1.0) + u * at(i + 1.0, j + 1.0))
    }

    /// Returns the smallest distance to the goal, metres, of a ball that starts at `p` with velocity `v` (m/s), and the
    /// number of reflections before it.
    fn nearest(&self, mut p: DVec2, mut v: DVec2, radius: f64, goal: DVec2, horizon_s: f64) -> (f64, usize) {
        let high = self.low + DVec2::new(self.size[0] as f64, self.size[1] as f64) * self.cell_m;
        let mut nearest = (p.distance(goal), 0);
        let mut reflections = 0;
        let speed = v.length();
        if speed < 1e-6 {
            return nearest;
        }
        let steps = (speed * horizon_s / self.cell_m).ceil() as usize;
        for _ in 0..steps {
            let next = p + v / speed * self.cell_m;
            for axis in 0..2 {
                let outside = next[axis] < self.low[axis] + radius && v[axis] < 0.0
                    || next[axis] > high[axis] - radius && v[axis] > 0.0;
                if outside {
                    v[axis] = -v[axis];
                    reflections += 1;
                }
            }
            if self.clearance(next) < radius {
                let h = self.cell_m;
                let slope = |d: DVec2| self.clearance(next + d) - self.clearance(next - d);
                let normal = DVec2::new(slope(DVec2::X * h), slope(DVec2::Y * h)).normalize_or_zero();
                let into = v.dot(normal);
                // A ball in contact with an obstacle may move away from it.
                if into < 0.0 {
                    v -= 2.0 * into * normal;
                    reflections += 1;
                }
            }
            p += v / speed * self.cell_m;
            if p.distance(goal) < nearest.0 - RESOLUTION_M * f64::from(u8::from(reflections > nearest.1)) {
                nearest = (p.distance(goal), reflections);
            }
        }
        nearest
    }
}

/// Marks the cells below the part of a triangle that is higher than the threshold.
fn mark(t: &[DVec3; 3], settings: &GridBaseline, low: DVec2, size: [usize; 2], occupied: &mut [bool]) {
    // Samples closer than half a cell cover every cell.
    let longest = (0..3).map(|i| t[i].distance(t[(i + 1) % 3])).fold(0.0, f64::max);
    let n = ((longest / (0.5 * settings.cell_m)).ceil() as usize).clamp(1, 4000);
    for i in 0..=n {
        for j in 0..=n - i {
            let (a, b) = (i as f64 / n as f64, j as f64 / n as f64);
            let p = t[0] + (t[1] - t[0]) * a + (t[2] - t[0]) * b;
            if p.z > settings.threshold_m {
                let g = (p.truncate() - low) / settings.cell_m;
                let (x, y) = (g.x as usize, g.y as usize);
                if g.x >= 0.0 && g.y >= 0.0 && x < size[0] && y < size[1] {
                    occupied[y * size[0] + x] = true;
                }
            }
        }
    }
}

/// Squared distance of every cell to the nearest marked one, in cells (Felzenszwalb and Huttenlocher, "Distance
/// transforms of sampled functions", 2012: rows, then columns, each by the lower envelope of parabolas).
fn distances(occupied: &[bool], [width, height]: [usize; 2]) -> Vec<f64> {
    let far = ((width + height) as f64).powi(2);
    let mut d: Vec<f64> = occupied.iter().map(|&o| if o { 0.0 } else { far }).collect();
    for y in 0..height {
        let row = envelope(&d[y * width..(y + 1) * width]);
        d[y * width..(y + 1) * width].copy_from_slice(&row);
    }
    for x in 0..width {
        let column: Vec<f64> = (0..height).map(|y| d[y * width + x]).collect();
        for (y, v) in envelope(&column).into_iter().enumerate() {
            d[y * width + x] = v;
        }
    }
    d
}

/// min over q of (p − q)² + f(q), for every p.
fn envelope(f: &[f64]) -> Vec<f64> {
    let meet = |p: usize, q: usize| {
        let (x, y) = (p as f64, q as f64);
        ((f[p] + x * x) - (f[q] + y * y)) / (2.0 * (x - y))
    };
    let mut roots: Vec<usize> = vec![0];
    let mut starts = vec![f64::NEG_INFINITY];
    for p in 1..f.len() {
        let mut s = meet(p, roots[roots.len() - 1]);
        while s <= starts[starts.len() - 1] {
            roots.pop();
            starts.pop();
            s = meet(p, roots[roots.len() - 1]);
        }
        roots.push(p);
        starts.push(s);
    }
    let mut k = 0;
    (0..f.len())
        .map(|p| {
            while k + 1 < starts.len() && starts[k + 1] < p as f64 {
                k += 1;
            }
            let d = p as f64 - roots[k] as f64;
            d * d + f[roots[k]]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A map with only the marked cells as obstacles.
    fn map(size: [usize; 2], marked: &[[usize; 2]]) -> Map {
        let mut occupied = vec![false; size[0] * size[1]];
        marked.iter().for_each(|[x, y]| occupied[y * size[0] + x] = true);
        let distance_m = distances(&occupied, size).into_iter().map(|d| d.sqrt() * 0.01).collect();
        Map { low: DVec2::ZERO, cell_m: 0.01, size, distance_m }
    }

    #[test]
    fn a_ball_that_is_not_hindered_goes_straight() {
        let m = map([200, 100], &[]);
        let from = DVec2::new(0.3, 0.5);
        let near = m.nearest(from, DVec2::new(0.5, 0.0), 0.03, DVec2::new(1.0, 0.62), 4.0).0;
        assert!((near - 0.12).abs() < 1e-9, "{near}");
    }

    #[test]
    fn a_wall_and_the_border_reflect() {
        // A wall along y at x = 1.0: the ball hits it at 45° and is reflected at 45°.
        let wall: Vec<[usize; 2]> = (0..300).map(|y| [100, y]).collect();
        let m = map([200, 300], &wall);
        let from = DVec2::new(0.4, 0.3);
        // The centre is reflected where its distance to the wall's cells is one radius.
        let turn = 1.005 - 0.05;
        let goal = DVec2::new(turn - 0.3, 0.3 + (turn - 0.4) + 0.3);
        let near = m.nearest(from, DVec2::new(0.5, 0.5), 0.05, goal, 4.0);
        assert!(near.0 < 0.02 && near.1 == 1, "{near:?}");
        let empty = map([200, 300], &[]);
        let goal = DVec2::new(0.6, 0.05 + 0.35);
        let near = empty.nearest(DVec2::new(0.6, 0.8), DVec2::new(0.0, -0.5), 0.05, goal, 4.0).0;
        assert!(near < 0.01, "{near}");
    }

    proptest! {
        #[test]
        fn distances_are_those_of_trying_all(cells in proptest::collection::vec((0..17usize, 0..11usize), 1..6)) {
            let mut occupied = vec![false; 17 * 11];
            cells.iter().for_each(|(x, y)| occupied[y * 17 + x] = true);
            let found = distances(&occupied, [17, 11]);
            for y in 0..11usize {
                for x in 0..17usize {
                    let square = |&(cx, cy): &(usize, usize)| x.abs_diff(cx).pow(2) + y.abs_diff(cy).pow(2);
                    let expected = cells.iter().map(square).min().unwrap() as f64;
                    prop_assert!((found[y * 17 + x] - expected).abs() < 1e-9);
                }
            }
        }
    }
}
