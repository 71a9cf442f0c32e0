//! Self-collision and distance to obstacles.

use crate::arm::model::LinkCollision;
use crate::arm::shape::{Clearance, distance, obstacle_distance};
use crate::{Obstacle, RobotModel, Workspace};
use glamx::DPose3;
use std::f64::consts::PI;

/// Number of sampled postures that determine which shapes always overlap, and the share of them that counts as always.
const PROBES: usize = 64;
const ALWAYS: f64 = 0.95;

impl RobotModel {
    /// Poses `X_WS` of all collision shapes, in the order of [`Self::collisions`]. After
    /// [`Self::forward_kinematics`].
    pub fn shape_poses(&self, ws: &Workspace, out: &mut Vec<DPose3>) {
        out.clear();
        out.extend(self.collisions.iter().map(|c| self.body_pose(c.joint, ws) * c.x_js));
    }

    /// Returns the two links that are nearest to each other, or overlap most. Links of the same body and of
    /// neighbouring bodies are skipped, and so are shapes that overlap in nearly every posture, because such an overlap
    /// is part of the model. Returns `None` when no pair is left. Distances beyond `enough` metres are not computed
    /// exactly.
    pub fn self_clearance(&self, poses: &[DPose3], enough: f64) -> Option<Clearance> {
        let mut best = (f64::INFINITY, None);
        for &(i, j) in &self.pairs {
            let (a, b) = (&self.collisions[i], &self.collisions[j]);
            let gap = bounding_gap(&self.collisions, poses, i, j);
            let is_far = gap > enough.min(best.0);
            let d = if is_far { gap } else { distance(&a.shape, &poses[i], &b.shape, &poses[j]) };
            if d < best.0 {
                best = (d, Some((i, j)));
            }
        }
        best.1.map(|(i, j)| Clearance {
            link: self.collisions[i].link.clone(),
            other: self.collisions[j].link.clone(),
            distance_m: best.0,
        })
    }

    /// Returns the moving link that is nearest to an obstacle. `None` when no moving link has a shape. Distances beyond
    /// `enough` metres are not computed exactly.
    pub fn obstacle_clearance(
        &self,
        poses: &[DPose3],
        obstacle: &Obstacle,
        enough: f64,
    ) -> Option<Clearance> {
        let mut best = (f64::INFINITY, None);
        for (i, c) in self.collisions.iter().enumerate().filter(|(_, c)| c.joint.is_some()) {
            let d = obstacle_distance((&c.shape, c.radius), &poses[i], obstacle, enough.min(best.0));
            if d < best.0 {
                best = (d, Some(i));
            }
        }
        best.1.map(|i| Clearance {
            link: self.collisions[i].link.clone(),
            other: obstacle.name.clone(),
            distance_m: best.0,
        })
    }

    /// Returns whether the bounding spheres of an obstacle and of a moving link come within `enough` metres of each
    /// other. If they do not, no distance is smaller than `enough`.
    pub(crate) fn may_be_near(&self, poses: &[DPose3], obstacle: &Obstacle, enough: f64) -> bool {
        let (center_w, radius) = obstacle.sphere_w();
        let mut moving = self.collisions.iter().zip(poses).filter(|(c, _)| c.joint.is_some());
        moving.any(|(c, x)| {
            let most = enough + radius + c.radius;
            center_w.distance_squared(x.translation) <= most * most
        })
    }

    /// Finds the pairs of shapes to compare.
    pub(crate) fn find_pairs(&mut self) {
        let parent = |joint: Option<usize>| joint.and_then(|j| self.joints[j].parent);
        let neighbours = |a: Option<usize>, b: Option<usize>| {
            a == b || (b.is_some() && parent(b) == a) || (a.is_some() && parent(a) == b)
        };
        let count = self.collisions.len();
        let mut pairs: Vec<(usize, usize)> = (0..count)
            .flat_map(|i| (i + 1..count).map(move |j| (i, j)))
            .filter(|&(i, j)| !neighbours(self.collisions[i].joint, self.collisions[j].joint))
            .collect();
        let mut touching = vec![0usize; pairs.len()];
        let mut ws = Workspace::default();
        let mut poses = Vec::new();
        for probe in 0..PROBES {
            let q = self.spread_posture(probe);
            self.forward_kinematics(&q, &mut ws);
            self.shape_poses(&ws, &mut poses);
            for (count, &(i, j)) in touching.iter_mut().zip(&pairs) {
                let (a, b) = (&self.collisions[i].shape, &self.collisions[j].shape);
                let apart = bounding_gap(&self.collisions, &poses, i, j) > 0.0
                    || distance(a, &poses[i], b, &poses[j]) > 0.0;
                *count += usize::from(!apart);
            }
        }
        let mut counts = touching.into_iter();
        pairs.retain(|_| counts.next().is_some_and(|c| (c as f64) < ALWAYS * PROBES as f64));
        self.pairs = pairs;
    }

    /// Returns the `index`-th of a sequence of postures spread over the ranges of all joints (Halton; 0 is the middle).
    pub(crate) fn spread_posture(&self, index: usize) -> Vec<f64> {
        const PRIMES: [u32; 16] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53];
        self.joints
            .iter()
            .zip(PRIMES)
            .map(|(joint, prime)| {
                // Skips the first samples, in which the large bases are correlated.
                let share = if index == 0 { 0.5 } else { halton(index as u32 + 60, prime) };
                let limits = (joint.limits.lower, joint.limits.upper);
                let (low, high) = if limits.0.is_finite() { limits } else { (-PI, PI) };
                low + share * (high - low)
            })
            .collect()
    }
}

/// Distance between the bounding spheres of two shapes.
fn bounding_gap(shapes: &[LinkCollision], poses: &[DPose3], i: usize, j: usize) -> f64 {
    poses[i].translation.distance(poses[j].translation) - shapes[i].radius - shapes[j].radius
}

fn halton(mut index: u32, base: u32) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0);
    while index > 0 {
        digit /= f64::from(base);
        value += digit * f64::from(index % base);
        index /= base;
    }
    value
}
