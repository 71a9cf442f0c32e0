//! Gaussians on the fused surface: discs with the colour and the most frequent label of all views.

use super::appearance::{DirectedColor, appearances, directed_colors};
use super::config::ScanConfig;
use super::seeding::{AffinityCodes, disc};
use super::thinning::thin;
use crate::Seedling;
use crate::harmonics::CONSTANT;
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, LabelMap, Seed};
use sms_frames::Frame;
use sms_surface::Surfel;
use std::collections::BTreeMap;

/// Returns discs that draw the surface: fewer than its elements where it is flat and of one colour.
///
/// # Errors
/// [`CoreError::Interrupted`] when cancelled.
pub(crate) fn place(
    surfels: &[Surfel],
    frames: &[(&Frame, &LabelMap)],
    codes: &AffinityCodes,
    config: &ScanConfig,
    seed: Seed,
    cancel: &Cancel,
) -> Result<Vec<Seedling>, CoreError> {
    let seen = appearances(surfels, frames, codes.len(), config);
    cancel.check()?;
    let sparse = thin(surfels, &seen, &BTreeMap::new(), &config.seeding, seed.derive("thinning"));
    let (surfels, seen): (Vec<_>, Vec<_>) = sparse.iter().map(|s| (surfels[s.index], seen[s.index])).unzip();
    cancel.check()?;
    let colors: Vec<DirectedColor> = if config.fused.rates.harmonics > 0.0 {
        directed_colors(&surfels, &seen, frames, config)
    } else {
        seen.iter().map(|seen| DirectedColor { color: seen.color, harmonics: CONSTANT }).collect()
    };
    let mut rng = seed.derive("affinity").rng();
    let affinities: Vec<_> = seen.iter().map(|s| codes.draw(s.label, &mut rng)).collect();
    let seedling = |i: usize| Seedling {
        harmonics: colors[i].harmonics,
        ..disc(&surfels[i], sparse[i].spacing_m, colors[i].color, affinities[i], config)
    };
    Ok((0..sparse.len()).into_par_iter().map(seedling).collect())
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{Recorded, SMALL, record};
    use super::*;
    use crate::harmonics::{basis, difference};
    use glamx::DVec3;

    /// The recording without noise, in one colour that depends on the direction (0 to 1, red).
    fn glossy() -> (Vec<Frame>, Vec<LabelMap>) {
        let (sequence, labels) = record(Recorded { noise_m: 0.0, ..SMALL });
        let mut frames = sequence.frames;
        for frame in &mut frames {
            let width = frame.depth.width;
            for i in 0..frame.depth.data.len() {
                let ray_w = frame.camera.unproject_pixel(i % width, i / width, 1.0) - frame.camera.center_w();
                frame.color.data[i] = [(255.0 * red(ray_w)).round() as u8, 128, 128];
            }
        }
        (frames, labels.maps)
    }

    fn red(direction_w: DVec3) -> f64 {
        let d = direction_w.normalize();
        0.5 + 0.2 * d.x + 0.15 * d.y * d.z
    }

    fn placed(config: &ScanConfig) -> (Vec<Surfel>, Vec<Seedling>) {
        let (frames, maps) = glossy();
        let views: Vec<&Frame> = frames.iter().collect();
        let surfels = sms_surface::fuse(&views, &config.surface(), Seed(1), &Cancel::new()).unwrap();
        let labelled: Vec<_> = frames.iter().zip(&maps).collect();
        let codes = AffinityCodes::new(3, Seed(1));
        let seedlings = place(&surfels, &labelled, &codes, config, Seed(2), &Cancel::new()).unwrap();
        (surfels, seedlings)
    }

    #[test]
    fn flat_surfaces_get_wide_thin_discs_with_the_colours_of_every_direction() {
        let config = ScanConfig::default();
        let (surfels, seedlings) = placed(&config);
        assert!(2 * seedlings.len() < surfels.len(), "{} of {}", seedlings.len(), surfels.len());
        let is_floor = |s: &&Seedling| s.position_w.z < 1e-3 && s.position_w.truncate().length() > 0.12;
        let floor: Vec<&Seedling> = seedlings.iter().filter(is_floor).collect();
        let across = |s: &&Seedling| s.scale.y;
        let widest = floor.iter().map(across).fold(0.0, f32::max);
        let narrowest = floor.iter().map(across).fold(f32::MAX, f32::min);
        assert!(widest > 3.0 * narrowest, "{widest} {narrowest}");
        let thickest = floor.iter().map(|s| s.scale.z).fold(0.0, f32::max);
        let own = surfels.iter().map(|s| s.spacing_m).fold(0.0, f64::max);
        let expected = config.seeding.thickness * config.seeding.sigma_of_spacing * own;
        assert!(f64::from(thickest) < 1.001 * expected, "{thickest} {expected}");
        let (frames, _) = glossy();
        let mut worst = 0.0f64;
        for (frame, s) in frames.iter().flat_map(|f| floor.iter().map(move |s| (f, s))) {
            let p_w = s.position_w.as_dvec3();
            let seen = frame.camera.project(p_w).is_some_and(|(u, v, z)| {
                let pixel = frame.camera.pixel_at(u, v);
                pixel.is_some_and(|pixel| (f64::from(frame.depth[pixel]) - z).abs() < 0.003)
            });
            if seen {
                let direction_w = p_w - frame.camera.center_w();
                let seen = s.color[0] + difference(&s.harmonics, &basis(direction_w.as_vec3().to_array()))[0];
                worst = worst.max((f64::from(seen) - red(direction_w)).abs());
            }
        }
        assert!(worst > 0.0 && worst < 0.02, "{worst}");
    }

    #[test]
    fn colours_that_are_not_trained_on_directions_do_not_depend_on_them() {
        let mut config = ScanConfig::default();
        config.fused.rates.harmonics = 0.0;
        let (_, seedlings) = placed(&config);
        assert!(!seedlings.is_empty() && seedlings.iter().all(|s| s.harmonics == CONSTANT));
    }
}
