//! Projection of Gaussians onto the surface measured by all frames.
//!
//! Positions hardly move in the schedule `sequential`: colours would pull centres off the surface (by 2 mm at 1e-4 m per step), and the
//! depth of one view is noisy. Instead, centres and normals become those of the fused surface.

use super::config::ScanConfig;
use crate::parameters::{POSITION, Parameters, ROTATION, Row};
use glamx::{DQuat, DVec3, Quat, Vec3};
use rayon::prelude::*;
use sms_core::Cancel;
use sms_frames::Frame;
use sms_surface::{Surfel, WallSide, settle};

/// Moves every Gaussian along its normal to the mean of the measurements of `frames`, and turns it to their mean
/// normal. Gaussians without measurements remain unchanged; moments are kept.
pub(crate) fn fuse(parameters: &mut Parameters, frames: &[&Frame], config: &ScanConfig) {
    let discs: Vec<Surfel> = parameters.rows.par_iter().map(surfel_of).collect();
    let mut fused = discs.clone();
    // It takes seconds at most and is not interrupted, so that the checkpoint after it is written.
    if settle(&mut fused, frames, &config.surface(), WallSide::MostMeasured, &Cancel::new()).is_err() {
        return;
    }
    for (row, (before, after)) in parameters.rows.iter_mut().zip(discs.iter().zip(&fused)) {
        let along_w = after.n_w * after.n_w.dot(before.n_w).signum();
        let turn = DQuat::from_rotation_arc(before.n_w, along_w);
        let rotation_wg = (turn * Quat::from_slice(&row.0[ROTATION..]).as_dquat()).normalize().as_quat();
        row.0[POSITION..POSITION + 3].copy_from_slice(&after.p_w.as_vec3().to_array());
        if after.n_w != before.n_w {
            row.0[ROTATION..ROTATION + 4].copy_from_slice(&rotation_wg.to_array());
        }
    }
}

/// Returns the disc of a Gaussian: its normal is the shortest axis.
fn surfel_of(row: &Row) -> Surfel {
    Surfel {
        p_w: Vec3::from_slice(&row.0[POSITION..]).as_dvec3(),
        n_w: (Quat::from_slice(&row.0[ROTATION..]).as_dquat() * DVec3::AXES[row.shortest_axis()]).normalize(),
        ..Surfel::default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{Recorded, SMALL, record};
    use super::*;
    use crate::harmonics::CONSTANT;
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
            harmonics: CONSTANT,
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
        Frame::new(
            camera,
            Image::filled(32, 20, [0; 3]),
            Image::filled(32, 20, (eye_z_m - surface_z_m).abs() as f32),
            Image::filled(32, 20, [0.0, 0.0, -1.0]),
        )
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
                    harmonics: CONSTANT,
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
