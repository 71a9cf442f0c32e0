//! The refinement: all poses at once, from coarse to fine images.

use crate::PosesConfig;
use crate::align::{add_row, align_rigidly, lever, moved_about};
use crate::graph::{Graph, choose_pairs};
use crate::linear::{Block, Six, System};
use crate::residual::{
    Arc, Brightness, Histogram, LinearisationPoint, PairSums, ResidualStats, ShiftSums, Weighing, linearise,
};
use crate::views::{Point, PreparedFrame};
use glamx::{DPose3, DVec3};
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, Progress};
use std::collections::BTreeSet;

/// The inputs of the refinement, which stay constant during it.
pub(crate) struct BundleAdjustment<'a> {
    pub(crate) views: &'a [PreparedFrame],
    pub(crate) given: &'a [DPose3],
    pub(crate) graph: Graph,
    pub(crate) config: &'a PosesConfig,
    /// Centre of rotation of the corrections.
    pub(crate) center_w: DVec3,
}

/// The values that the refinement estimates, and the weights of its next iteration.
struct RefinementState {
    poses: Vec<DPose3>,
    /// Shift of the colour against the depth, pixels at loaded size.
    color_shift: [f64; 2],
    arcs: Vec<Arc>,
    weighing: Weighing,
}

pub(crate) fn arcs(pairs: &[(usize, usize)]) -> Vec<Arc> {
    pairs
        .iter()
        .flat_map(|&(i, j)| [(i, j), (j, i)])
        .map(|(from, to)| Arc { from, to, brightness: Brightness::default() })
        .collect()
}

impl<'a> BundleAdjustment<'a> {
    pub(crate) fn new(views: &'a [PreparedFrame], given: &'a [DPose3], config: &'a PosesConfig) -> Self {
        let mut sum = DVec3::ZERO;
        let mut count = 0usize;
        for (view, x) in views.iter().zip(given) {
            for point in view.points(view.luma.len() - 1, 2.0, [0.5, 0.5], [0.0; 2], config) {
                sum += x.transform_point(point.p_c);
                count += 1;
            }
        }
        let center_w = if count > 0 { sum / count as f64 } else { DVec3::ZERO };
        Self { views, given, graph: choose_pairs(views, given, config), config, center_w }
    }

    /// Returns the frames without a pair; only the prior constrains them.
    pub(crate) fn frames_without_pairs(&self) -> Vec<usize> {
        let paired: BTreeSet<usize> = self.graph.pairs.iter().flat_map(|&(i, j)| [i, j]).collect();
        (0..self.given.len()).filter(|i| !paired.contains(i)).collect()
    }

    /// Returns the first gate for projected points, metres: the errors of the given poses at the scene's distance.
    pub(crate) fn widest_gate_m(&self) -> f64 {
        let distance =
            self.given.iter().map(|x| (x.translation - self.center_w).length()).fold(0.0, f64::max).min(10.0);
        4.0 * (self.config.prior_position_m + self.config.prior_rotation_rad * distance)
    }

    pub(crate) fn linearise_all(
        &self,
        arcs: &[Arc],
        points: &[Vec<Point>],
        at: LinearisationPoint<'_>,
        weighing: &Weighing,
    ) -> Vec<PairSums> {
        let sums = |arc: &Arc| {
            let (points, into) = (&points[arc.from], &self.views[arc.to]);
            linearise(points, into, arc, at, self.center_w, weighing, self.config)
        };
        arcs.par_iter().map(sums).collect()
    }

    /// Adds the prior at the given pose: rotation and camera position, each with its standard deviation.
    fn add_prior(&self, system: &mut System, frame: usize, pose: &DPose3) {
        let given = &self.given[frame];
        let turned = (pose.rotation * given.rotation.inverse()).to_scaled_axis();
        let shifted = pose.translation - given.translation;
        let arm = pose.translation - self.center_w;
        let (wr, wt) = (self.config.prior_rotation_rad.powi(-2), self.config.prior_position_m.powi(-2));
        let (mut h, mut g): (Block, Six) = ([[0.0; 6]; 6], [0.0; 6]);
        for axis in 0..3 {
            h[axis][axis] += wr;
            g[axis] += wr * turned[axis];
            add_row(&mut h, &mut g, &lever(arm, DVec3::AXES[axis]), shifted[axis], wt);
        }
        system.add_own(frame, &h, &g);
    }

    /// Runs Gauss-Newton with robust weights at one level. Returns the number of iterations.
    fn refine_level(
        &self,
        level: usize,
        estimate: &mut RefinementState,
        shift_is_free: bool,
        cancel: &Cancel,
        mut tick: impl FnMut(&str),
    ) -> Result<usize, CoreError> {
        let RefinementState { poses, color_shift, arcs, weighing } = estimate;
        let config = self.config;
        let pixel_m = self.pixel_at_scene_m(level);
        for iteration in 0..config.iterations[level] {
            cancel.check()?;
            let points: Vec<Vec<Point>> = self
                .views
                .par_iter()
                .map(|v| v.points(level, config.point_stride, [0.5, 0.5], *color_shift, config))
                .collect();
            let at = LinearisationPoint { level, poses, color_shift: *color_shift };
            let sums = self.linearise_all(arcs, &points, at, weighing);
            let mut system = System::new(poses.len());
            let share = config.independent_share;
            for (arc, pair) in arcs.iter().zip(&sums) {
                let (h, g, shift) = pair.reduced();
                let scaled = |s: Six| s.map(|v| share * v);
                let shift = ShiftSums {
                    by: shift.by.map(scaled),
                    h: shift.h.map(|r| r.map(|v| share * v)),
                    g: shift.g.map(|v| share * v),
                };
                system.add_pair(arc.from, arc.to, &h.map(scaled), &scaled(g), &shift);
            }
            // A shift that is not estimated is held constant.
            let w = if shift_is_free { config.prior_color_shift_px.powi(-2) } else { 1e12 };
            system.add_shift(&[[w, 0.0], [0.0, w]], &color_shift.map(|d| w * d));
            for (frame, pose) in poses.iter().enumerate() {
                self.add_prior(&mut system, frame, pose);
            }
            let Some((steps, shift_step)) = system.solve() else { return Ok(iteration) };
            (0..2).for_each(|k| color_shift[k] += shift_step[k]);
            let mut largest = 0.0f64;
            for (pose, step) in poses.iter_mut().zip(&steps) {
                let moved = moved_about(self.center_w, step) * *pose;
                largest = largest.max((moved.translation - pose.translation).length());
                largest = largest.max(DVec3::new(step[3], step[4], step[5]).length());
                *pose = DPose3::from_parts(moved.translation, moved.rotation.normalize());
            }
            for (arc, pair) in arcs.iter_mut().zip(&sums) {
                let delta: Six = std::array::from_fn(|a| steps[arc.from][a] - steps[arc.to][a]);
                arc.brightness = pair.brightness_after(&delta, shift_step, arc.brightness);
            }
            *weighing = self.weighing_after(&sums, weighing);
            tick(&format!("step {:.2} mm", 1e3 * largest));
            // Smaller steps do not change the associated pixels.
            if largest < 0.02 * pixel_m {
                return Ok(iteration + 1);
            }
        }
        Ok(config.iterations[level])
    }

    /// Returns the size of one pixel of a level at the scene, metres.
    fn pixel_at_scene_m(&self, level: usize) -> f64 {
        let (mut sum, n) = (0.0, self.views.len().max(1));
        for (view, x) in self.views.iter().zip(self.given) {
            let distance = (x.translation - self.center_w).length();
            sum += view.intrinsics.pixel_footprint(distance) * view.scale(level);
        }
        sum / n as f64
    }

    /// Returns the robust scales after a pass: the typical residuals, but at least the noise.
    pub(crate) fn weighing_after(&self, sums: &[PairSums], before: &Weighing) -> Weighing {
        let mut seen = ResidualStats::default();
        sums.iter().for_each(|pair| seen.merge(&pair.seen));
        let scale = |h: &Histogram| h.median().map_or(1.0, |m| (1.4826 * m).max(1.0));
        let depth_scale = scale(&seen.depth);
        // σ of the difference of two measurements at the scene's typical distance.
        let sigma_m = self
            .given
            .iter()
            .map(|x| self.config.noise.sigma_m((x.translation - self.center_w).length()))
            .fold(0.0, f64::max)
            * std::f64::consts::SQRT_2;
        Weighing {
            depth_scale,
            color_scale: scale(&seen.color),
            gate_m: (8.0 * depth_scale * sigma_m).max(0.01).min(before.gate_m),
        }
    }

    /// Refines all poses. Returns them with the shift of colour against depth (pixels at loaded size) and the number
    /// of iterations done.
    pub(crate) fn run(
        &self,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<(Vec<DPose3>, [f64; 2], usize), CoreError> {
        let levels = self.views.first().map_or(0, |v| v.luma.len());
        let planned: usize = self.config.iterations[..levels].iter().sum();
        progress.begin("poses", planned as u64);
        let mut estimate = RefinementState {
            poses: self.given.to_vec(),
            color_shift: [0.0; 2],
            arcs: arcs(&self.graph.pairs),
            weighing: Weighing { depth_scale: 10.0, color_scale: 4.0, gate_m: self.widest_gate_m() },
        };
        let (mut done, mut iterations) = (0, 0);
        let free = self.config.prior_color_shift_px > 0.0;
        for level in (0..levels).rev() {
            let mut at = done;
            let tick = |message: &str| {
                at += 1;
                progress.update(at as u64, message);
            };
            iterations += self.refine_level(level, &mut estimate, free, cancel, tick)?;
            done += self.config.iterations[level];
        }
        // Registered cameras also give a shift of some tenths of a pixel; applying it makes results worse.
        const LEAST_SHIFT_PX: f64 = 0.75;
        let [du, dv] = estimate.color_shift;
        if free && du.hypot(dv) < LEAST_SHIFT_PX {
            estimate.color_shift = [0.0; 2];
            for level in (0..levels.min(2)).rev() {
                let tick = |message: &str| progress.update(done as u64, message);
                iterations += self.refine_level(level, &mut estimate, false, cancel, tick)?;
            }
            estimate.color_shift = [0.0; 2];
        }
        Ok((self.in_place(&estimate.poses), estimate.color_shift, iterations))
    }

    /// Removes the common rigid motion: aligns the measured points with their positions under the given poses, so that
    /// masks, models and directions known in the given world stay valid.
    fn in_place(&self, poses: &[DPose3]) -> Vec<DPose3> {
        let (mut from, mut to) = (Vec::new(), Vec::new());
        for ((view, given), refined) in self.views.iter().zip(self.given).zip(poses) {
            for point in view.points(view.luma.len() - 1, 2.0, [0.5, 0.5], [0.0; 2], self.config) {
                from.push(refined.transform_point(point.p_c));
                to.push(given.transform_point(point.p_c));
            }
        }
        let back = align_rigidly(&from, &to);
        poses.iter().map(|x| back * *x).collect()
    }
}
