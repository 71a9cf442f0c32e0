//! Gaussians on the fused surface: discs with the mean colour and the most frequent label of all views.

use super::config::ScanConfig;
use super::seeding::{AffinityCodes, disc};
use crate::Seedling;
use rayon::prelude::*;
use sms_core::{LabelMap, Seed};
use sms_frames::Frame;
use sms_surface::{Surfel, map_nearby};

/// Returns a disc for every element of the surface.
pub(crate) fn place(
    surfels: &[Surfel],
    frames: &[(&Frame, &LabelMap)],
    codes: &AffinityCodes,
    config: &ScanConfig,
    seed: Seed,
) -> Vec<Seedling> {
    let positions_w: Vec<_> = surfels.par_iter().map(|s| s.p_w.as_vec3()).collect();
    let seen: Vec<SeenAppearance> = map_nearby(&positions_w, |group| {
        let mut sums = vec![AppearanceSum::new(codes.len()); group.len()];
        for (frame, labels) in frames {
            for (&i, sum) in group.iter().zip(&mut sums) {
                sum.add(&surfels[i as usize], frame, labels, config);
            }
        }
        let own = |i: u32| {
            let seed = surfels[i as usize].seed;
            let (frame, labels) = frames[seed.slot];
            (frame.color.data[seed.pixel], labels.data[seed.pixel])
        };
        group.iter().zip(sums).map(|(&i, sum)| sum.mean(own(i))).collect()
    });
    let mut rng = seed.derive("affinity").rng();
    let affinities: Vec<_> = seen.iter().map(|s| codes.draw(s.label, &mut rng)).collect();
    let elements = surfels.par_iter().zip(&seen).zip(affinities);
    elements.map(|((surfel, seen), affinity)| disc(surfel, seen.color, affinity, config)).collect()
}

/// Colour (0 to 1) and label of an element.
#[derive(Debug, Clone, Copy, Default)]
struct SeenAppearance {
    color: [f32; 3],
    label: u16,
}

/// Sums over the frames that measure an element.
#[derive(Debug, Clone)]
struct AppearanceSum {
    color: [f64; 3],
    weight: f64,
    votes: Vec<u32>,
}

impl AppearanceSum {
    fn new(classes: usize) -> Self {
        Self { color: [0.0; 3], weight: 0.0, votes: vec![0; classes] }
    }

    fn add(&mut self, surfel: &Surfel, frame: &Frame, labels: &LabelMap, config: &ScanConfig) {
        let Some((u, v, z)) = frame.camera.project(surfel.p_w) else { return };
        let Some((x, y)) = frame.camera.pixel_at(u, v) else { return };
        let depth = f64::from(frame.depth[(x, y)]);
        let facing = surfel.n_w.dot((frame.camera.center_w() - surfel.p_w).normalize());
        let measured = depth > 0.0 && (depth - z).abs() <= config.tolerance_m(&frame.depth_noise, z);
        if !measured || facing < config.seeding.min_cosine {
            return;
        }
        if let Some(votes) = self.votes.get_mut(usize::from(labels[(x, y)])) {
            *votes += 1;
        }
        let weight = facing / (z * z);
        let color = color_at(frame, u, v);
        (0..3).for_each(|c| self.color[c] += weight * color[c]);
        self.weight += weight;
    }

    /// Returns the mean; that of the pixel that added the element if no frame measures it.
    fn mean(&self, (color, label): ([u8; 3], u16)) -> SeenAppearance {
        let most = self.votes.iter().enumerate().max_by_key(|&(label, n)| (*n, std::cmp::Reverse(label)));
        let label = most.filter(|(_, n)| **n > 0).map_or(label, |(label, _)| label as u16);
        let color = if self.weight > 0.0 {
            self.color.map(|c| (c / self.weight) as f32)
        } else {
            color.map(|c| f32::from(c) / 255.0)
        };
        SeenAppearance { color, label }
    }
}

/// Returns the colour (0 to 1) at image coordinates, bilinear.
fn color_at(frame: &Frame, u: f64, v: f64) -> [f64; 3] {
    let (width, height) = frame.color.size();
    let (x, y) = ((u - 0.5).floor(), (v - 0.5).floor());
    let (fx, fy) = (u - 0.5 - x, v - 0.5 - y);
    let at = |dx: i64, dy: i64| {
        let column = (x as i64 + dx).clamp(0, width as i64 - 1) as usize;
        let row = (y as i64 + dy).clamp(0, height as i64 - 1) as usize;
        frame.color[(column, row)].map(|c| f64::from(c) / 255.0)
    };
    let (a, b, c, d) = (at(0, 0), at(1, 0), at(0, 1), at(1, 1));
    std::array::from_fn(|k| {
        (1.0 - fy) * ((1.0 - fx) * a[k] + fx * b[k]) + fy * ((1.0 - fx) * c[k] + fx * d[k])
    })
}
