//! The refinement: all poses at once, from coarse to fine images.

use crate::PosesConfig;
use crate::align::{align_rigidly, moved_about};
use crate::covariance::Covariance;
use crate::floor::{PairFloor, PairForm};
use crate::given::{GivenNoise, GivenPoses, Shared, rates};
use crate::graph::{Graph, choose_pairs};
use crate::histogram::ResidualStats;
use crate::judge::{Posed, judge};
use crate::linear::{CAMERA, COMMON, Common, FOCAL, HAND_EYE, Six, System, TIME};
use crate::modes::{CommonMode, largest_mode};
use crate::noise::depth_noise;
use crate::pair::{CameraSums, PairSums};
use crate::planes::PlaneMap;
use crate::residual::{Arc, Brightness, LinearisationPoint, Phase, Weighing, linearise};
use crate::size::SizeUncertainty;
use crate::views::{DirectedFrame, Direction, Point, PreparedFrame};
use glamx::{DPose3, DVec3};
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, Progress};
use sms_frames::DepthNoise;

/// The inputs of the refinement, which stay constant during it.
pub(crate) struct BundleAdjustment<'a> {
    pub(crate) views: &'a [PreparedFrame],
    pub(crate) given: &'a [DPose3],
    /// Time of each frame, seconds.
    times_s: &'a [Option<f64>],
    pub(crate) graph: Graph,
    pub(crate) config: &'a PosesConfig,
    /// Centre of rotation of the corrections.
    pub(crate) center_w: DVec3,
    /// Distance of the measured points from it (root mean square), metres.
    arm_m: f64,
    /// Mean depth of each frame, metres.
    depths_m: Vec<f64>,
}

/// The values that the refinement estimates, and the weights of its next iteration.
#[derive(Clone)]
struct RefinementState {
    /// Surface directions of each frame under the present poses.
    directions: Vec<Vec<Direction>>,
    poses: Vec<DPose3>,
    /// Motion of the camera at each frame.
    rates: Vec<Six>,
    /// Corrections of the given poses that all frames share.
    shared: Shared,
    camera: CameraValues,
    /// Whether each value of the cameras is estimated, or held at zero.
    is_free: [bool; CAMERA],
    /// Size of a value that is held at zero, as it was estimated.
    apparent: [f64; CAMERA],
    phase: Phase,
    arcs: Vec<Arc>,
    weighing: Weighing,
    floor: PairFloor,
    noise: GivenNoise,
}

/// Values of the cameras, which all frames share.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct CameraValues {
    /// Shift of the colour against the depth, pixels at loaded size.
    pub(crate) color_shift_px: [f64; 2],
    /// Logarithm of the factor by which the focal length differs from the recorded one.
    pub(crate) focal: f64,
}

impl CameraValues {
    fn to_array(self) -> [f64; CAMERA] {
        let [x, y] = self.color_shift_px;
        [x, y, self.focal]
    }

    fn from_array([x, y, focal]: [f64; CAMERA]) -> Self {
        Self { color_shift_px: [x, y], focal }
    }
}

/// An examination of the given poses.
pub(crate) struct Prospect {
    /// Share by which a refinement could reduce the squares of all residuals, to first order.
    pub(crate) gain: f64,
    pub(crate) depth_noise: Option<DepthNoise>,
}

/// The result of a refinement.
pub(crate) struct Refined {
    pub(crate) poses: Vec<DPose3>,
    pub(crate) camera: CameraValues,
    /// Standard deviation of the focal length, as a share; `None` if it cannot be computed.
    pub(crate) focal_sigma: Option<f64>,
    pub(crate) shared: Shared,
    /// Standard deviation of the time offset, seconds; `None` if the times of the frames are not known.
    pub(crate) time_sigma_s: Option<f64>,
    /// Deviation of each frame from its given pose with the hand-eye correction: metres, radians.
    pub(crate) deviations: Vec<[f64; 2]>,
    pub(crate) noise: GivenNoise,
    pub(crate) floor: PairFloor,
    pub(crate) depth_noise: Option<DepthNoise>,
    /// `None` if it cannot be computed.
    pub(crate) uncertainty: Option<SizeUncertainty>,
    /// The common change of the poses that is least like noise.
    pub(crate) common_mode: Option<CommonMode>,
    pub(crate) iterations: usize,
}

/// Standard deviations of an estimate; `None` where they cannot be computed.
#[derive(Debug, Default)]
struct Uncertainty {
    size: Option<SizeUncertainty>,
    /// Of the time offset, seconds; also `None` if the times of the frames are not known, or if it is not estimated.
    time_s: Option<f64>,
    /// Of the focal length, as a share; also `None` if it is not estimated.
    focal: Option<f64>,
}

/// Rounds of estimating the noise and refining with it, after a first refinement near the solution.
const NOISE_ROUNDS: usize = 2;
/// Steps of expectation maximisation in a round.
const NOISE_STEPS: usize = 4;
/// Size of the smallest cells of the surface relative to the distance between two points of a frame: neighbouring frames
/// then fill them.
const CELL_SHARE: f64 = 0.75;
/// Weight of a value that is not estimated.
const HELD: f64 = 1e12;
/// Standard deviations beyond which a value of the cameras is not chance.
const SIGNIFICANT: f64 = 3.0;

/// Returns the weight of a prior; a value with the deviation 0 is held.
fn weight_of(sigma: f64) -> f64 {
    if sigma > 0.0 { sigma.powi(-2).min(HELD) } else { HELD }
}

/// Sets gain and offset of each pair to those that fit best, without a motion.
pub(crate) fn settle_brightness(arcs: &mut [Arc], sums: &[PairSums]) {
    for (arc, pair) in arcs.iter_mut().zip(sums) {
        arc.brightness = pair.brightness_after(&[0.0; 6], &[0.0; CAMERA], arc.brightness);
    }
}

/// Returns the values of the cameras.
fn camera_part(common: &Common) -> [f64; CAMERA] {
    std::array::from_fn(|k| common[k])
}

/// Returns δᵢ − δⱼ.
fn difference(steps: &[Six], i: usize, j: usize) -> Six {
    std::array::from_fn(|a| steps[i][a] - steps[j][a])
}

pub(crate) fn arcs(pairs: &[(usize, usize)]) -> Vec<Arc> {
    pairs
        .iter()
        .flat_map(|&(i, j)| [(i, j), (j, i)])
        .map(|(from, to)| Arc { from, to, brightness: Brightness::default() })
        .collect()
}

impl<'a> BundleAdjustment<'a> {
    pub(crate) fn new(
        views: &'a [PreparedFrame],
        given: &'a [DPose3],
        times_s: &'a [Option<f64>],
        config: &'a PosesConfig,
    ) -> Self {
        let mut sum = DVec3::ZERO;
        let (mut square, mut count) = (0.0, 0usize);
        let mut depths_m = Vec::with_capacity(views.len());
        for (view, x) in views.iter().zip(given) {
            let points = view.alone().points(view.luma.len() - 1, 2.0, [0.5, 0.5], [0.0; 2], config);
            for point in &points {
                let p_w = x.transform_point(point.p_c);
                sum += p_w;
                square += p_w.length_squared();
            }
            count += points.len();
            depths_m.push(points.iter().map(|p| p.p_c.z).sum::<f64>() / points.len().max(1) as f64);
        }
        let center_w = if count > 0 { sum / count as f64 } else { DVec3::ZERO };
        let arm_m = (square / count.max(1) as f64 - center_w.length_squared()).max(0.0).sqrt();
        let graph = choose_pairs(&views.iter().collect::<Vec<_>>(), given, config);
        Self { views, given, times_s, graph, config, center_w, arm_m, depths_m }
    }

    /// Returns the frames without a pair; only the prior constrains them.
    pub(crate) fn frames_without_pairs(&self) -> Vec<usize> {
        let paired = self.graph.paired();
        (0..self.given.len()).filter(|i| !paired.contains(i)).collect()
    }

    /// Returns the first gate for projected points, metres: the errors of the given poses at the scene's distance.
    pub(crate) fn widest_gate_m(&self) -> f64 {
        let depth_m = self.depths_m.iter().copied().fold(0.0, f64::max).min(10.0);
        4.0 * (self.config.prior_position_m + self.config.prior_rotation_rad * depth_m)
    }

    pub(crate) fn linearise_all(
        &self,
        views: &[DirectedFrame<'_>],
        arcs: &[Arc],
        points: &[Vec<Point>],
        at: LinearisationPoint<'_>,
        weighing: &Weighing,
    ) -> Vec<PairSums> {
        let sums = |arc: &Arc| {
            let (points, into) = (&points[arc.from], views[arc.to]);
            linearise(points, into, arc, at, self.center_w, weighing, self.config)
        };
        arcs.par_iter().map(sums).collect()
    }

    fn given_poses<'b>(&'b self, estimate: &'b RefinementState) -> GivenPoses<'b> {
        GivenPoses { poses: self.given, rates: &estimate.rates, center_w: self.center_w }
    }

    /// Returns the points of each frame that the refinement compares, with colour that is shifted by `color_shift`.
    fn points(&self, views: &[DirectedFrame<'_>], level: usize, color_shift: [f64; 2]) -> Vec<Vec<Point>> {
        let of = |v: &DirectedFrame<'_>| {
            v.points(level, self.config.point_stride, [0.5, 0.5], color_shift, self.config)
        };
        views.par_iter().map(of).collect()
    }

    /// Replaces the normals by those of all frames together, and the rates by those of the present poses.
    fn renew_surfaces_and_rates(&self, estimate: &mut RefinementState) {
        estimate.rates = rates(&estimate.poses, self.times_s);
        let alone: Vec<DirectedFrame<'_>> =
            self.views.iter().map(|v| v.alone().with_focal(estimate.camera.focal)).collect();
        let points = self.points(&alone, 0, [0.0; 2]);
        let cell_m = CELL_SHARE * self.config.point_stride * self.pixel_at_scene_m(0);
        let map = PlaneMap::new(&points, &estimate.poses, self.center_w, cell_m);
        estimate.directions =
            alone.par_iter().zip(&estimate.poses).map(|(v, x)| map.directions(*v, x)).collect();
    }

    /// Returns the frames with other directions than their own, and with another focal length.
    fn directed<'b>(&'b self, directions: &'b [Vec<Direction>], focal: f64) -> Vec<DirectedFrame<'b>> {
        let with = |(frame, directions): (&'b PreparedFrame, &'b Vec<Direction>)| {
            DirectedFrame { directions, ..frame.alone() }.with_focal(focal)
        };
        self.views.iter().zip(directions).map(with).collect()
    }

    /// Linearises all pairs at the estimate; returns the sums of both directions of each.
    fn pass(&self, level: usize, estimate: &RefinementState) -> Vec<PairSums> {
        let views = self.directed(&estimate.directions, estimate.camera.focal);
        let points = self.points(&views, level, estimate.camera.color_shift_px);
        self.linearise_at(level, &views, &points, estimate)
    }

    /// As [`Self::pass`], with points that were made before.
    fn linearise_at(
        &self,
        level: usize,
        views: &[DirectedFrame<'_>],
        points: &[Vec<Point>],
        estimate: &RefinementState,
    ) -> Vec<PairSums> {
        let &RefinementState { ref poses, phase, .. } = estimate;
        let color_shift = estimate.camera.color_shift_px;
        let at = LinearisationPoint { level, poses, color_shift, phase };
        self.linearise_all(views, &estimate.arcs, points, at, &estimate.weighing)
    }

    /// Returns the quadratic form of each pair of frames. Gain and offset are eliminated.
    fn forms(&self, sums: &[PairSums]) -> Vec<PairForm> {
        let share = self.config.independent_share;
        let scaled = |s: Six| s.map(|v| share * v);
        let of = |pair: &PairSums| {
            let (h, g, camera) = pair.reduced();
            let camera = CameraSums {
                by: camera.by.map(scaled),
                h: camera.h.map(|r| r.map(|v| share * v)),
                g: camera.g.map(|v| share * v),
            };
            PairForm { h: h.map(scaled), g: scaled(g), camera }
        };
        sums.chunks_exact(2).map(|both| of(&both[0]).with_reverse(&of(&both[1]))).collect()
    }

    /// Returns the linear system of all corrections from the forms with the floor.
    fn system(&self, floored: &[PairForm], estimate: &RefinementState) -> System {
        let mut system = self.prior(estimate);
        for (&(i, j), form) in self.graph.pairs.iter().zip(floored) {
            system.add_pair(i, j, &form.h, &form.g, &form.camera);
        }
        system
    }

    /// Returns the part of the system that no pair contributes to: the given poses and the common values.
    fn prior(&self, estimate: &RefinementState) -> System {
        let config = self.config;
        let mut system = System::new(estimate.poses.len());
        // A value that is not estimated is held constant.
        let sigmas = self.camera_sigmas();
        for (k, value) in estimate.camera.to_array().into_iter().enumerate() {
            system.add_common(k, value, weight_of(if estimate.is_free[k] { sigmas[k] } else { 0.0 }));
        }
        let turn = estimate.shared.hand_eye.rotation.to_scaled_axis();
        let shift = estimate.shared.hand_eye.translation;
        for k in 0..3 {
            system.add_common(HAND_EYE + k, turn[k], weight_of(config.prior_hand_eye_rad));
            system.add_common(HAND_EYE + 3 + k, shift[k], weight_of(config.prior_hand_eye_m));
        }
        system.add_common(TIME, estimate.shared.time_s, weight_of(config.prior_time_offset_s));
        self.given_poses(estimate).add_to(&mut system, &estimate.poses, &estimate.shared, &estimate.noise);
        system
    }

    /// Returns the standard deviations of the values of the cameras before an estimate.
    fn camera_sigmas(&self) -> [f64; CAMERA] {
        let PosesConfig { prior_color_shift_px, prior_focal_share, .. } = *self.config;
        [prior_color_shift_px, prior_color_shift_px, prior_focal_share]
    }

    /// Returns errors of the values of the cameras that all points may share: those of shading that changes with the view, and of
    /// depth that is wrong at edges.
    fn camera_slips(&self) -> [f64; CAMERA] {
        let Some(view) = self.views.first() else { return [0.0; CAMERA] };
        let slip_px = self.config.color_slip_px * view.scale(0);
        // Root mean square distance of the pixels from the middle of the image.
        let distance_px =
            ((view.intrinsics.width.pow(2) + view.intrinsics.height.pow(2)) as f64 / 12.0).sqrt();
        [slip_px, slip_px, slip_px / distance_px]
    }

    /// Returns the state at the given poses.
    fn start(&self) -> RefinementState {
        RefinementState {
            directions: self.views.iter().map(|v| v.directions.clone()).collect(),
            poses: self.given.to_vec(),
            rates: vec![[0.0; 6]; self.given.len()],
            shared: Shared::default(),
            camera: CameraValues::default(),
            is_free: self.camera_sigmas().map(|sigma| sigma > 0.0),
            apparent: [0.0; CAMERA],
            phase: Phase::Approach,
            arcs: arcs(&self.graph.pairs),
            weighing: Weighing::first(self.widest_gate_m()),
            floor: PairFloor::default(),
            noise: GivenNoise::configured(self.config),
        }
    }

    /// Runs Gauss-Newton with robust weights at one level. Returns the number of iterations.
    fn refine_level(
        &self,
        level: usize,
        estimate: &mut RefinementState,
        cancel: &Cancel,
        mut tick: impl FnMut(&str),
    ) -> Result<usize, CoreError> {
        let config = self.config;
        let pixel_m = self.pixel_at_scene_m(level);
        for iteration in 0..config.iterations[level] {
            cancel.check()?;
            let sums = self.pass(level, estimate);
            let floored = estimate.floor.applied_to_all(&self.forms(&sums));
            let system = self.system(&floored, estimate);
            let Some((steps, common)) = system.solve() else { return Ok(iteration) };
            // Values that are held stay exactly as they are.
            let steps_of = camera_part(&common);
            let camera_step = std::array::from_fn(|k| if estimate.is_free[k] { steps_of[k] } else { 0.0 });
            let camera = estimate.camera.to_array();
            estimate.camera = CameraValues::from_array(std::array::from_fn(|k| camera[k] + camera_step[k]));
            let RefinementState { poses, arcs, .. } = estimate;
            estimate.shared = estimate.shared.after(&common);
            let mut squares = 0.0;
            for (pose, step) in poses.iter_mut().zip(&steps) {
                let moved = moved_about(self.center_w, step) * *pose;
                // The camera moves by the first, the scene before it by the second.
                let steps_m = [moved.translation - pose.translation, DVec3::new(step[3], step[4], step[5])];
                squares += steps_m.map(DVec3::length_squared).into_iter().fold(0.0, f64::max);
                *pose = DPose3::from_parts(moved.translation, moved.rotation.normalize());
            }
            for (arc, pair) in arcs.iter_mut().zip(&sums) {
                let delta = difference(&steps, arc.from, arc.to);
                arc.brightness = pair.brightness_after(&delta, &camera_step, arc.brightness);
            }
            estimate.weighing = self.weighing_after(&sums, &estimate.weighing);
            // A root mean square: a single frame that is badly determined must not keep all from being done.
            let paired = self.graph.paired().len().max(1) as f64;
            let typical_m = (squares / paired).sqrt().max(camera_step[FOCAL].abs() * self.arm_m);
            tick(&format!("step {:.2} mm", 1e3 * typical_m));
            // Smaller steps do not change the associated pixels.
            if typical_m < 0.02 * pixel_m {
                return Ok(iteration + 1);
            }
        }
        Ok(config.iterations[level])
    }

    /// Examines the given poses.
    pub(crate) fn prospect(&self) -> Prospect {
        // Passes in which gains, offsets and robust scales settle.
        const PASSES: usize = 3;
        let mut estimate = self.start();
        self.renew_surfaces_and_rates(&mut estimate);
        let directions = std::mem::take(&mut estimate.directions);
        let views = self.directed(&directions, estimate.camera.focal);
        let points = self.points(&views, 0, estimate.camera.color_shift_px);
        let mut sums = Vec::new();
        for _ in 0..PASSES {
            sums = self.linearise_at(0, &views, &points, &estimate);
            settle_brightness(&mut estimate.arcs, &sums);
            estimate.weighing = self.weighing_after(&sums, &estimate.weighing);
        }
        let forms = self.forms(&sums);
        let system = self.system(&forms, &estimate);
        let depth_noise = depth_noise(&views, &points, &estimate.poses, &self.graph.pairs);
        let Some((steps, common)) = system.solve() else { return Prospect { gain: 0.0, depth_noise } };
        let decrease = |(&(i, j), form): (&(usize, usize), &PairForm)| {
            -form.value(&difference(&steps, i, j), &camera_part(&common))
        };
        let cost = self.config.independent_share * sums.iter().map(|s| s.cost).sum::<f64>();
        let gain = self.graph.pairs.iter().zip(&forms).map(decrease).sum::<f64>() / cost.max(1e-300);
        Prospect { gain, depth_noise }
    }

    /// Estimates the noise floor of the pairs and the noise of the given poses from the forms at the estimate.
    fn estimate_noise(&self, forms: &[PairForm], estimate: &mut RefinementState) {
        let unknown = 6 * self.graph.paired().len().saturating_sub(1);
        estimate.floor = PairFloor::fitted(forms, self.arm_m, unknown);
        let floored = estimate.floor.applied_to_all(forms);
        for _ in 0..NOISE_STEPS {
            let system = self.system(&floored, estimate);
            let Some(inverse) = system.inverse() else { return };
            estimate.noise = self.given_poses(estimate).noise_after(
                &inverse,
                &estimate.poses,
                &estimate.shared,
                self.config,
            );
        }
    }

    /// Returns the size of one pixel of a level at the scene, metres.
    fn pixel_at_scene_m(&self, level: usize) -> f64 {
        let (mut sum, n) = (0.0, self.views.len().max(1));
        for (view, depth_m) in self.views.iter().zip(&self.depths_m) {
            sum += view.intrinsics.pixel_footprint(*depth_m) * view.scale(level);
        }
        sum / n as f64
    }

    /// Returns the robust scales after a pass: the typical residuals, but at least the noise.
    pub(crate) fn weighing_after(&self, sums: &[PairSums], before: &Weighing) -> Weighing {
        let mut seen = ResidualStats::default();
        sums.iter().for_each(|pair| seen.merge(&pair.seen));
        let sigmas_m = self.views.iter().zip(&self.depths_m).map(|(v, z)| v.depth_noise.sigma_m(*z));
        let sigma_m = sigmas_m.fold(0.0, f64::max);
        before.after(&seen, sigma_m)
    }

    /// Refines all poses: from coarse to fine images, then with the noise that the result shows.
    pub(crate) fn run(&self, progress: &dyn Progress, cancel: &Cancel) -> Result<Refined, CoreError> {
        let levels = self.views.first().map_or(0, |v| v.luma.len());
        let planned: usize = self.config.iterations[..levels].iter().sum();
        progress.begin("poses", planned as u64);
        let mut estimate = self.start();
        let (mut done, mut iterations) = (0, 0);
        for level in (0..levels).rev() {
            let mut at = done;
            let tick = |message: &str| {
                at += 1;
                progress.update(at as u64, message);
            };
            self.renew_surfaces_and_rates(&mut estimate);
            iterations += self.refine_level(level, &mut estimate, cancel, tick)?;
            done += self.config.iterations[level];
        }
        estimate.phase = Phase::Estimate;
        for round in 0..if levels > 0 { 1 + NOISE_ROUNDS } else { 0 } {
            self.renew_surfaces_and_rates(&mut estimate);
            let tick = |message: &str| progress.update(done as u64, message);
            iterations += self.refine_level(0, &mut estimate, cancel, tick)?;
            if round == NOISE_ROUNDS {
                break;
            }
            let forms = self.forms(&self.pass(0, &estimate));
            self.estimate_noise(&forms, &mut estimate);
            self.hold_insignificant_values(&forms, &mut estimate);
            iterations += self.hold_useless_focal(&mut estimate, cancel)?;
        }
        let views = self.directed(&estimate.directions, estimate.camera.focal);
        let points = self.points(&views, 0, estimate.camera.color_shift_px);
        let depth_noise = depth_noise(&views, &points, &estimate.poses, &self.graph.pairs);
        let Uncertainty { size, time_s: time_sigma_s, focal: focal_sigma } =
            if levels > 0 { self.uncertainty(&estimate) } else { Uncertainty::default() };
        let (centers_w, shifts) = self.given_poses(&estimate).shifts(&estimate.poses, &estimate.shared);
        let common_mode = largest_mode(&centers_w, &shifts, &estimate.noise);
        Ok(Refined {
            poses: self.in_place(&estimate.poses, estimate.camera.focal),
            camera: estimate.camera,
            focal_sigma,
            shared: estimate.shared,
            time_sigma_s,
            deviations: self.given_poses(&estimate).lengths(&estimate.poses, &estimate.shared),
            noise: estimate.noise,
            floor: estimate.floor,
            depth_noise,
            uncertainty: size,
            common_mode,
            iterations,
        })
    }

    /// Evaluates the covariance from the forms at the estimate; `None` if it is not determined.
    fn with_covariance<T>(
        &self,
        forms: &[PairForm],
        estimate: &RefinementState,
        f: impl FnOnce(&Covariance<'_>) -> T,
    ) -> Option<T> {
        let forms = estimate.floor.applied_to_all(forms);
        let system = self.system(&forms, estimate);
        let prior = self.prior(estimate);
        let inverse = system.inverse()?;
        let pairs = &self.graph.pairs;
        // A value that is held at zero may still be real: it counts with the size that the data show.
        let changed = |k: usize| {
            let mut common = [0.0; COMMON];
            common[k] = HELD * estimate.apparent[k];
            inverse.times(&vec![[0.0; 6]; estimate.poses.len()], &common)
        };
        let considered = (0..CAMERA).filter(|&k| !estimate.is_free[k]).map(changed).collect();
        let paired = self.graph.paired().len();
        Some(f(&Covariance { inverse: &inverse, prior: &prior, pairs, paired, forms: &forms, considered }))
    }

    /// Sets each value of the cameras to zero, and holds it there, unless it is larger than chance and than the error that all
    /// points may share.
    fn hold_insignificant_values(&self, forms: &[PairForm], estimate: &mut RefinementState) {
        if !estimate.is_free.contains(&true) {
            return;
        }
        let sigmas = self
            .with_covariance(forms, estimate, |c| std::array::from_fn::<_, CAMERA, _>(|k| c.common_sigma(k)));
        let mut camera = estimate.camera.to_array();
        for (k, slip) in self.camera_slips().into_iter().enumerate() {
            // Without a standard deviation, nothing tells that it is more than chance.
            let sigma = sigmas.and_then(|s| s[k]);
            let is_chance = sigma.is_none_or(|s| camera[k].abs() <= SIGNIFICANT * s.hypot(slip));
            if estimate.is_free[k] && is_chance {
                estimate.is_free[k] = false;
                estimate.apparent[k] = camera[k].hypot(sigma.unwrap_or(slip));
                camera[k] = 0.0;
            }
        }
        estimate.camera = CameraValues::from_array(camera);
    }

    /// Holds the recorded focal length unless held-out pairs agree better with another. Errors of depth that no noise model
    /// knows can look like a focal length that many standard deviations exclude, and that reduces no residual: the poses would
    /// absorb it. It then counts as uncertainty of the size. Returns the number of iterations.
    fn hold_useless_focal(
        &self,
        estimate: &mut RefinementState,
        cancel: &Cancel,
    ) -> Result<usize, CoreError> {
        if !estimate.is_free[FOCAL] {
            return Ok(0);
        }
        let mut held = estimate.clone();
        held.is_free[FOCAL] = false;
        held.apparent[FOCAL] = held.camera.focal;
        held.camera.focal = 0.0;
        // The poses have absorbed the focal length, and must be able to leave it.
        let coarser = 1.min(self.config.iterations.len() - 1);
        let mut iterations = self.refine_level(coarser, &mut held, cancel, |_| ())?;
        iterations += self.refine_level(0, &mut held, cancel, |_| ())?;
        iterations += self.refine_level(0, estimate, cancel, |_| ())?;
        let [before, after] =
            [&held, &*estimate].map(|state| Posed { poses: &state.poses, camera: state.camera });
        if !judge(self, before, after).improved() {
            *estimate = held;
        }
        Ok(iterations)
    }

    /// Returns the standard deviations of the scene's size, of the time offset and of the focal length.
    fn uncertainty(&self, estimate: &RefinementState) -> Uncertainty {
        let coarse = self.views.first().map_or(0, |v| v.luma.len() - 1);
        let points: Vec<Vec<Point>> = self
            .directed(&estimate.directions, estimate.camera.focal)
            .iter()
            .map(|v| v.points(coarse, 1.0, [0.5; 2], [0.0; 2], self.config))
            .collect();
        let forms = self.forms(&self.pass(0, estimate));
        // A focal length that is used has the error that all points may share, too.
        let slip = if estimate.is_free[FOCAL] { self.camera_slips()[FOCAL] } else { 0.0 };
        let used = |sigma: f64| sigma.hypot(slip);
        self.with_covariance(&forms, estimate, |covariance| {
            let is_timed =
                self.config.prior_time_offset_s > 0.0 && estimate.rates.iter().any(|rate| *rate != [0.0; 6]);
            Uncertainty {
                size: SizeUncertainty::of(covariance, &estimate.poses, &points, self.center_w),
                time_s: covariance.common_sigma(TIME).filter(|_| is_timed),
                focal: covariance
                    .common_sigma(FOCAL)
                    .filter(|_| self.config.prior_focal_share > 0.0)
                    .map(used),
            }
        })
        .unwrap_or_default()
    }

    /// Removes the common rigid motion: aligns the measured points with their positions under the given poses, so that
    /// masks, models and directions known in the given world stay valid.
    fn in_place(&self, poses: &[DPose3], focal: f64) -> Vec<DPose3> {
        let (mut from, mut to) = (Vec::new(), Vec::new());
        for ((view, given), refined) in self.views.iter().zip(self.given).zip(poses) {
            let of = |view: DirectedFrame<'_>| {
                view.points(view.frame.luma.len() - 1, 2.0, [0.5, 0.5], [0.0; 2], self.config)
            };
            from.extend(of(view.alone().with_focal(focal)).iter().map(|p| refined.transform_point(p.p_c)));
            to.extend(of(view.alone()).iter().map(|p| given.transform_point(p.p_c)));
        }
        let back = align_rigidly(&from, &to);
        poses.iter().map(|x| back * *x).collect()
    }
}
