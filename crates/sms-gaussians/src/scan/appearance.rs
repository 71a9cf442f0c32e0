//! Colour and label of the elements of a surface, from all frames that measure them.

use super::config::ScanConfig;
use crate::harmonics::{BASIS, CONSTANT, Harmonics, basis};
use rayon::prelude::*;
use sms_core::{Cholesky, LabelMap};
use sms_frames::Frame;
use sms_surface::{Surfel, map_nearby};

/// Ratio of the variance of a measured colour to that of the coefficients of its dependence on the direction: a standard deviation of
/// 0.02 (noise, misalignment) to one of 0.12. On the scenes 1001 to 1004, on which it was chosen, 1, 0.3 and 0.1 give 33.2, 33.3 and 33.4
/// dB with a rate of rotations of 10⁻³, and 0.03 and 0.01 give 33.6 dB with the rates of the time (experiments/studies/scan/fused.md).
const RIDGE: f64 = 0.03;

/// Mean colour (0 to 1) and most frequent label of an element.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Appearance {
    pub(super) color: [f32; 3],
    pub(super) label: u16,
}

/// Colour of an element (0 to 1), and how it depends on the direction.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct DirectedColor {
    pub(super) color: [f32; 3],
    pub(super) harmonics: Harmonics,
}

/// Returns the appearance of every element, of `classes` labels.
pub(super) fn appearances(
    surfels: &[Surfel],
    frames: &[(&Frame, &LabelMap)],
    classes: usize,
    config: &ScanConfig,
) -> Vec<Appearance> {
    let add = |sum: &mut AppearanceSum, _, sight: &Sight| sum.add(sight);
    let mean = |i: usize, sum: AppearanceSum| {
        let seed = surfels[i].seed;
        let (frame, labels) = frames[seed.slot];
        sum.mean((frame.color.data[seed.pixel], labels.data[seed.pixel]))
    };
    summed(surfels, frames, config, &AppearanceSum::new(classes), add, mean)
}

/// Fits the colour of every element and its dependence on the direction to all frames (ridge regression). `seen` are their mean colours,
/// which elements without measurements keep.
pub(super) fn directed_colors(
    surfels: &[Surfel],
    seen: &[Appearance],
    frames: &[(&Frame, &LabelMap)],
    config: &ScanConfig,
) -> Vec<DirectedColor> {
    let add = |fit: &mut ColorFit, i: usize, sight: &Sight| {
        let mean = seen[i].color;
        let difference = std::array::from_fn(|c| sight.color[c] - f64::from(mean[c]));
        fit.add(sight.weight, difference, &basis(sight.direction_w));
    };
    let solve = |i: usize, fit: ColorFit| fit.solve(seen[i].color);
    summed(surfels, frames, config, &ColorFit::default(), add, solve)
}

/// Adds all measurements of every element to a copy of `empty`, and returns the sums after `finish`; both take the element's position.
fn summed<S: Clone + Sync, T: Send + Clone + Default>(
    surfels: &[Surfel],
    frames: &[(&Frame, &LabelMap)],
    config: &ScanConfig,
    empty: &S,
    add: impl Fn(&mut S, usize, &Sight) + Sync,
    finish: impl Fn(usize, S) -> T + Sync,
) -> Vec<T> {
    let positions_w: Vec<_> = surfels.iter().map(|s| s.p_w.as_vec3()).collect();
    map_nearby(&positions_w, |group| {
        let mut sums = vec![empty.clone(); group.len()];
        for (frame, labels) in frames {
            for (&i, sum) in group.iter().zip(&mut sums) {
                if let Some(sight) = Sight::of(&surfels[i as usize], frame, labels, config) {
                    add(sum, i as usize, &sight);
                }
            }
        }
        group.iter().zip(sums).map(|(&i, sum)| finish(i as usize, sum)).collect()
    })
}

/// A measurement of an element by a frame.
struct Sight {
    /// Cosine of the viewing angle over the square of the depth.
    weight: f64,
    /// Colour, 0 to 1.
    color: [f64; 3],
    label: u16,
    /// Vector from the camera to the element, metres.
    direction_w: [f32; 3],
}

impl Sight {
    /// `None` where the frame does not measure the element, or too obliquely.
    fn of(surfel: &Surfel, frame: &Frame, labels: &LabelMap, config: &ScanConfig) -> Option<Self> {
        let (u, v, z) = frame.camera.project(surfel.p_w)?;
        let pixel = frame.camera.pixel_at(u, v)?;
        let depth = f64::from(frame.depth[pixel]);
        if !(depth > 0.0 && (depth - z).abs() <= config.tolerance_m(&frame.depth_noise, z)) {
            return None;
        }
        let direction_w = surfel.p_w - frame.camera.center_w();
        let facing = surfel.n_w.dot(-direction_w.normalize());
        (facing >= config.seeding.min_cosine).then(|| Self {
            weight: facing / (z * z),
            color: color_at(frame, (u, v)),
            label: labels[pixel],
            direction_w: direction_w.as_vec3().to_array(),
        })
    }
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

    fn add(&mut self, sight: &Sight) {
        if let Some(votes) = self.votes.get_mut(usize::from(sight.label)) {
            *votes += 1;
        }
        (0..3).for_each(|c| self.color[c] += sight.weight * sight.color[c]);
        self.weight += sight.weight;
    }

    /// Returns the mean; that of the pixel that added the element if no frame measures it.
    fn mean(&self, (color, label): ([u8; 3], u16)) -> Appearance {
        let most = self.votes.iter().enumerate().max_by_key(|&(label, n)| (*n, std::cmp::Reverse(label)));
        let label = most.filter(|(_, n)| **n > 0).map_or(label, |(label, _)| label as u16);
        let color = if self.weight > 0.0 {
            self.color.map(|c| (c / self.weight) as f32)
        } else {
            color.map(|c| f32::from(c) / 255.0)
        };
        Appearance { color, label }
    }
}

/// Mean colour of an element over the frames so far, while frames arrive.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeanColor {
    /// Colour of the pixel that added the element.
    first: [f32; 3],
    sum: [f64; 3],
    weight: f64,
}

impl MeanColor {
    /// Returns the colour of the pixel that adds an element, until a frame measures it.
    pub(super) fn of(pixel: [u8; 3]) -> Self {
        Self { first: pixel.map(|v| f32::from(v) / 255.0), sum: [0.0; 3], weight: 0.0 }
    }

    /// Returns the mean as an appearance without a label.
    pub(super) fn appearance(&self) -> Appearance {
        let mean = self.sum.map(|c| (c / self.weight) as f32);
        Appearance { color: if self.weight > 0.0 { mean } else { self.first }, label: 0 }
    }
}

/// Adds the measurements of a frame to the mean colours, one for each element.
pub(super) fn add_colors(
    surfels: &[Surfel],
    colors: &mut [MeanColor],
    (frame, labels): (&Frame, &LabelMap),
    config: &ScanConfig,
) {
    surfels.par_iter().zip(colors).with_min_len(512).for_each(|(surfel, mean)| {
        if let Some(sight) = Sight::of(surfel, frame, labels, config) {
            (0..3).for_each(|c| mean.sum[c] += sight.weight * sight.color[c]);
            mean.weight += sight.weight;
        }
    });
}

/// Number of unknowns: the constant colour and its harmonics.
const UNKNOWNS: usize = 1 + BASIS;

/// Weighted normal equations of a colour, relative to a mean. Only the lower triangle is filled.
#[derive(Debug, Clone, Default)]
struct ColorFit {
    products: [[f64; UNKNOWNS]; UNKNOWNS],
    right: [[f64; 3]; UNKNOWNS],
    count: f64,
}

impl ColorFit {
    fn add(&mut self, weight: f64, difference: [f64; 3], basis: &[f32; BASIS]) {
        let row: [f64; UNKNOWNS] =
            std::array::from_fn(|k| if k == 0 { 1.0 } else { f64::from(basis[k - 1]) });
        for (i, value) in row.iter().enumerate() {
            let weighted = weight * value;
            (0..=i).for_each(|j| self.products[i][j] += weighted * row[j]);
            (0..3).for_each(|c| self.right[i][c] += weighted * difference[c]);
        }
        self.count += 1.0;
    }

    /// Returns the colours; `mean` from all directions without measurements.
    fn solve(mut self, mean: [f32; 3]) -> DirectedColor {
        let mut fitted = DirectedColor { color: mean, harmonics: CONSTANT };
        // A measurement has the mean weight.
        let ridge = RIDGE * self.products[0][0] / self.count;
        (1..UNKNOWNS).for_each(|k| self.products[k][k] += ridge);
        let Some(factors) = Cholesky::new(&self.products, UNKNOWNS) else { return fitted };
        factors.solve_each(&mut self.right);
        for c in 0..3 {
            fitted.color[c] += self.right[0][c] as f32;
            (0..BASIS).for_each(|k| fitted.harmonics[3 * k + c] = self.right[k + 1][c] as f32);
        }
        fitted
    }
}

/// Returns the colour (0 to 1) at image coordinates, bilinear.
fn color_at(frame: &Frame, (u, v): (f64, f64)) -> [f64; 3] {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonics::difference;
    use rand::RngExt;
    use sms_core::Seed;

    /// Directions downwards, as from cameras above a table.
    fn directions(count: usize) -> Vec<[f32; BASIS]> {
        let mut rng = Seed(5).rng();
        let one = |_| basis([rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), -0.7]);
        (0..count).map(one).collect()
    }

    #[test]
    fn colors_that_depend_on_the_direction_are_found_where_they_were_seen() {
        let harmonics: Harmonics = std::array::from_fn(|i| 0.04 * ((7 * i % 11) as f32 / 11.0 - 0.5));
        let mean = [0.4, 0.5, 0.6];
        let mut fit = ColorFit::default();
        let expected = |b: &[f32; BASIS]| difference(&harmonics, b).map(|d| f64::from(d) + 0.1);
        for (i, b) in directions(60).iter().enumerate() {
            fit.add(1.0 + (i % 3) as f64, expected(b), b);
        }
        let found = fit.solve(mean);
        for b in directions(100) {
            let (seen, expected) = (difference(&found.harmonics, &b), expected(&b));
            for c in 0..3 {
                let error = f64::from(found.color[c] + seen[c] - mean[c]) - expected[c];
                assert!(error.abs() < 2e-3, "{error}");
            }
        }
    }

    #[test]
    fn one_measurement_is_met_from_all_directions_and_none_leaves_the_mean() {
        let mean = [0.2, 0.3, 0.4];
        assert_eq!(ColorFit::default().solve(mean), DirectedColor { color: mean, harmonics: CONSTANT });
        let mut fit = ColorFit::default();
        fit.add(5.0, [0.1, 0.0, -0.1], &directions(1)[0]);
        let found = fit.solve(mean);
        assert!((0..3).all(|c| (found.color[c] - [0.3, 0.3, 0.3][c]).abs() < 1e-6), "{found:?}");
        assert!(found.harmonics.iter().all(|h| h.abs() < 1e-6), "{found:?}");
    }
}
