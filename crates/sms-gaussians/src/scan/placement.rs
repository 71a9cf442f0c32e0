//! Gaussians on the fused surface: discs with the colour and the most frequent label of all views.

use super::appearance::{appearances, directed_colors};
use super::config::ScanConfig;
use super::seeding::{AffinityCodes, disc};
use super::thinning::thin;
use crate::Seedling;
use rayon::prelude::*;
use sms_core::{LabelMap, Seed};
use sms_frames::Frame;
use sms_surface::Surfel;

/// Returns discs that draw the surface: fewer than its elements where it is flat and of one colour.
pub(crate) fn place(
    surfels: &[Surfel],
    frames: &[(&Frame, &LabelMap)],
    codes: &AffinityCodes,
    config: &ScanConfig,
    seed: Seed,
) -> Vec<Seedling> {
    let seen = appearances(surfels, frames, codes.len(), config);
    let sparse = thin(surfels, &seen, &config.seeding, seed.derive("thinning"));
    let (surfels, seen): (Vec<_>, Vec<_>) = sparse.iter().map(|s| (surfels[s.index], seen[s.index])).unzip();
    let colors = directed_colors(&surfels, &seen, frames, config);
    let mut rng = seed.derive("affinity").rng();
    let affinities: Vec<_> = seen.iter().map(|s| codes.draw(s.label, &mut rng)).collect();
    let place = |i: usize| Seedling {
        harmonics: colors[i].harmonics,
        ..disc(&surfels[i], sparse[i].spacing_m, colors[i].color, affinities[i], config)
    };
    (0..sparse.len()).into_par_iter().map(place).collect()
}
