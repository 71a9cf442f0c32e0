//! Projection of Gaussians onto the surface measured by all frames.
//!
//! Positions hardly move in training: colours would pull centres off the surface (by 2 mm at 1e-4 m per step), and the
//! depth of one view is noisy. Instead, centres and normals become the weighted means of the measurements of all
//! frames, as in projective fusion of depth (Curless and Levoy, SIGGRAPH 1996). The two sides of a wall are fused
//! separately.

use super::config::ScanConfig;
use super::nearby::map_nearby;
use crate::parameters::{LOG_SCALE, POSITION, Parameters, ROTATION, Row};
use glamx::{DQuat, DVec3, Quat, Vec3};
use rayon::prelude::*;
use sms_frames::Frame;

/// Number of passes; the second measures at the position found by the first.
const PASSES: usize = 2;
/// Least cosine between the disc's normal and the normals of its surface.
const SAME_SURFACE_COSINE: f64 = 0.7;

/// Moves every Gaussian along its normal to the mean of the measurements of `frames`, and turns it to their mean
/// normal. Gaussians without measurements remain unchanged; moments are kept.
pub(crate) fn fuse(parameters: &mut Parameters, frames: &[&Frame], config: &ScanConfig) {
    let rows = &parameters.rows;
    let positions_w: Vec<Vec3> = rows.par_iter().map(|row| Vec3::from_slice(&row.0[POSITION..])).collect();
    let fused = map_nearby(&positions_w, |group| {
        let mut discs: Vec<GaussianDisc> =
            group.iter().map(|&i| GaussianDisc::of(&rows[i as usize])).collect();
        for _ in 0..PASSES {
            let mut sums: Vec<[SideMeasurement; 2]> = discs.iter().map(|_| Default::default()).collect();
            for frame in frames {
                for (disc, sides) in discs.iter().zip(&mut sums) {
                    add_frame(sides, frame, disc, config);
                }
            }
            discs.iter_mut().zip(sums).for_each(|(disc, sides)| disc.adjust(sides));
        }
        discs
    });
    for (row, disc) in parameters.rows.iter_mut().zip(fused) {
        row.0[POSITION..POSITION + 3].copy_from_slice(&disc.position_w.to_array());
        row.0[ROTATION..ROTATION + 4].copy_from_slice(&disc.rotation_wg.to_array());
    }
}

/// A Gaussian as a disc.
#[derive(Debug, Clone, Copy, Default)]
struct GaussianDisc {
    position_w: Vec3,
    rotation_wg: Quat,
    /// Its shortest axis: 0, 1 or 2.
    axis: usize,
    /// Centre in double precision, and shortest axis in the world.
    center_w: DVec3,
    axis_w: DVec3,
}

impl GaussianDisc {
    fn of(row: &Row) -> Self {
        let axis = (0..3).min_by(|&a, &b| row.0[LOG_SCALE + a].total_cmp(&row.0[LOG_SCALE + b])).unwrap_or(2);
        Self {
            position_w: Vec3::from_slice(&row.0[POSITION..]),
            rotation_wg: Quat::from_slice(&row.0[ROTATION..]),
            axis,
            ..Self::default()
        }
        .in_double()
    }

    fn in_double(self) -> Self {
        Self {
            center_w: self.position_w.as_dvec3(),
            axis_w: self.rotation_wg.as_dquat() * DVec3::AXES[self.axis],
            ..self
        }
    }

    /// Moves and turns the disc to the measurements.
    fn adjust(&mut self, [front, back]: [SideMeasurement; 2]) {
        // A thin wall is measured from both sides, and the mean would lie inside the wall. Each disc belongs to the
        // side with more measurements.
        let sum = if back.weight > front.weight { back } else { front };
        let Self { center_w, axis_w, .. } = *self;
        if sum.weight > 0.0 {
            self.position_w = (center_w + axis_w * (sum.offset / sum.weight)).as_vec3();
        }
        if sum.normal_w.length() > 0.0 {
            let along = sum.normal_w * sum.normal_w.dot(axis_w).signum();
            let turn = DQuat::from_rotation_arc(axis_w, along.normalize());
            self.rotation_wg = (turn * self.rotation_wg.as_dquat()).normalize().as_quat();
        }
        *self = self.in_double();
    }
}

/// Weighted sums over frames.
#[derive(Default)]
struct SideMeasurement {
    /// Sum of signed distances from the centre along the disc's axis, metres.
    offset: f64,
    weight: f64,
    /// Sum of unit normals, which face the cameras.
    normal_w: DVec3,
}

/// Adds the measurements of one frame to the side of the disc that faces the camera. Uses the four pixels around the
/// projected centre, weighted bilinearly and by the inverse variance of the depth noise.
fn add_frame(sides: &mut [SideMeasurement; 2], frame: &Frame, disc: &GaussianDisc, config: &ScanConfig) {
    let GaussianDisc { center_w, axis_w, .. } = *disc;
    let Some((u, v, z)) = frame.camera.project(center_w) else { return };
    let rotation_wc = frame.camera.x_wc.rotation;
    let (x, y) = ((u - 0.5).floor(), (v - 0.5).floor());
    let (fx, fy) = (u - 0.5 - x, v - 0.5 - y);
    let gate = config.tolerance_m(&frame.depth_noise, z);
    // Computed on demand: most frames do not see the surface.
    let mut precision_and_direction = None;
    for (dx, dy, share) in
        [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
    {
        let (px, py) = (x as i64 + dx, y as i64 + dy);
        let Some(&depth) = frame.depth.get(px, py) else { continue };
        let normal_c = frame.normal_c[(px as usize, py as usize)];
        if depth <= 0.0 || normal_c == [0.0; 3] || (f64::from(depth) - z).abs() > gate {
            continue;
        }
        let (precision, to_camera) = *precision_and_direction.get_or_insert_with(|| {
            (frame.depth_noise.sigma_m(z).powi(-2), (frame.camera.center_w() - center_w).normalize())
        });
        let normal_w = rotation_wc * DVec3::from_array(normal_c.map(f64::from));
        let cosine = normal_w.dot(axis_w);
        if normal_w.dot(to_camera) < config.seeding.min_cosine || cosine.abs() < SAME_SURFACE_COSINE {
            continue;
        }
        let measured_w = frame.camera.unproject_pixel(px as usize, py as usize, f64::from(depth));
        let weight = share * precision;
        let side = &mut sides[usize::from(cosine < 0.0)];
        side.offset += weight * axis_w.dot(measured_w - center_w);
        side.weight += weight;
        side.normal_w += normal_w * weight;
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{Recorded, SMALL, record};
    use super::*;
    use crate::{AFFINITY_DIM, CpuTrainer, Seedling, TrainConfig, Trainer};
    use sms_core::{Camera, Image, Intrinsics, Seed};

    #[test]
    fn displaced_and_tilted_discs_come_back_to_the_floor_and_hidden_ones_stay() {
        let (sequence, _) = record(Recorded { noise_m: 0.0, ..SMALL });
        let frames: Vec<&Frame> = sequence.frames.iter().collect();
        let seedling = |position_w: Vec3, tilt: f32| Seedling {
            position_w,
            rotation_wg: Quat::from_rotation_x(tilt),
            scale: Vec3::new(3e-3, 3e-3, 3e-4),
            opacity: 0.5,
            color: [0.5; 3],
            affinity: [0.0; AFFINITY_DIM],
        };
        let mut trainer = CpuTrainer::new(&TrainConfig::default(), 3, Seed(1));
        let below = Vec3::new(0.0, -0.12, -0.05);
        trainer.insert(&[
            seedling(Vec3::new(0.0, -0.12, 0.002), 0.2),
            seedling(Vec3::new(0.02, -0.1, -0.003), -0.3),
            seedling(below, 0.3),
        ]);
        let before = trainer.model();
        trainer.edit(&mut |p| fuse(p, &frames, &ScanConfig::default())).unwrap();
        let model = trainer.model();
        for i in 0..2 {
            assert!(model.positions_w[i].z.abs() < 5e-5, "{}", model.positions_w[i]);
            assert!(model.disc(i).0.z.abs() > 0.9999);
            assert!((model.positions_w[i] - before.positions_w[i]).truncate().length() < 1.5e-3);
        }
        assert_eq!((model.positions_w[2], model.rotations_wg[2]), (below, before.rotations_wg[2]));
    }

    /// A camera at `eye_z_m` on the z axis that looks at the origin and measures a plane at height `surface_z_m`.
    fn facing_plane(eye_z_m: f64, surface_z_m: f64) -> Frame {
        let k = Intrinsics::from_fov(32, 20, 0.3);
        let camera = Camera::look_at(k, DVec3::Z * eye_z_m, DVec3::ZERO, DVec3::Y);
        Frame {
            depth_noise: sms_frames::DepthNoise::default(),
            index: 0,
            time_s: None,
            camera,
            color: Image::filled(32, 20, [0; 3]),
            depth: Image::filled(32, 20, (eye_z_m - surface_z_m).abs() as f32),
            normal_c: Image::filled(32, 20, [0.0, 0.0, -1.0]),
            color_path: "".into(),
            mask_path: None,
        }
    }

    #[test]
    fn a_disc_of_a_thin_wall_goes_to_the_side_that_is_measured_most_not_between_the_sides() {
        // A wall of 3 mm, seen once from above and twice from below, and the other way round.
        let (above, below) = (facing_plane(0.5, 0.003), facing_plane(-0.5, 0.0));
        for (frames, expected_z) in [([&above, &below, &below], 0.0f32), ([&above, &above, &below], 0.003)] {
            for axis_up in [true, false] {
                let mut trainer = CpuTrainer::new(&TrainConfig::default(), 1, Seed(1));
                trainer.insert(&[Seedling {
                    position_w: Vec3::new(0.0, 0.0, 0.001),
                    rotation_wg: if axis_up { Quat::IDENTITY } else { Quat::from_rotation_x(3.0) },
                    scale: Vec3::new(3e-3, 1e-3, 3e-4),
                    opacity: 0.5,
                    color: [0.5; 3],
                    affinity: [0.0; AFFINITY_DIM],
                }]);
                trainer.edit(&mut |p| fuse(p, &frames, &ScanConfig::default())).unwrap();
                let model = trainer.model();
                assert!((model.positions_w[0].z - expected_z).abs() < 1e-5, "{}", model.positions_w[0]);
                let (normal, [(long, _), _]) = model.disc(0);
                assert!(normal.z.abs() > 0.99999 && long.x.abs() > 0.999, "{normal} {long}");
            }
        }
    }
}
