//! Choice of keyframes.
//!
//! A camera at 30 frames a second sees a surface hundreds of times from nearly the same place. Each of these frames costs as much memory
//! and time as the first, and adds little: the error of a mean falls with the root of their number. A frame is left out
//! if most parts of the surface that it sees are seen by a stated number of keyframes already. Hence a recording of at most that many
//! frames keeps all of them, and the keyframes of a longer one follow the size of the scene rather than the number of frames.

use crate::{FramesError, Recording};
use glamx::{DPose3, DVec3, Vec3};
use rayon::prelude::*;
use sms_core::{QuantileRule, StageContext, quantile};
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};

/// Measurements that are taken from a frame, along its longer side.
const SAMPLES: usize = 32;
/// Width of a cell in distances between neighbouring samples at the median depth: a frame that sees a cell has a sample in it,
/// up to twice that depth.
const CELL_SAMPLES: f64 = 2.0;
/// Ranges of distances to the camera per doubling. Frames in the same range count as equally near.
const RANGES_PER_OCTAVE: f32 = 2.0;
/// Number of these ranges, from 1 cm on.
const RANGES: usize = 24;

/// Returns those of the frames `candidates` of the recording that are kept, in the same order.
///
/// The choice goes through the candidates in finer and finer steps, so that the frames kept are spread over all of them. A frame
/// is left out if more than half of the cells of space in which it measures a surface are seen by `views` frames kept before, from about
/// the same of six sides and from at most √2 times its distance.
///
/// # Errors
/// [`FramesError`] if a depth image cannot be read for other reasons than its content, or when cancelled. Damaged or empty images are
/// left to the loader.
pub(crate) fn keyframes(
    recording: &Recording,
    candidates: &[usize],
    views: usize,
    context: StageContext<'_>,
) -> Result<Vec<usize>, FramesError> {
    if views == 0 || candidates.len() <= views {
        return Ok(candidates.to_vec());
    }
    let StageContext { progress, cancel, .. } = context;
    progress.begin("keyframes", candidates.len() as u64);
    let done = AtomicU64::new(0);
    let samples: Vec<Result<Samples, FramesError>> = candidates
        .par_iter()
        .map(|&i| {
            cancel.check()?;
            let samples = Samples::read(recording, i);
            progress.update(done.fetch_add(1, Ordering::Relaxed) + 1, &format!("frame {i}"));
            samples
        })
        .collect();
    let samples = samples.into_iter().collect::<Result<Vec<_>, _>>()?;
    let chosen = choose(&samples, views);
    let kept: Vec<usize> = candidates.iter().zip(chosen).filter_map(|(&i, kept)| kept.then_some(i)).collect();
    progress.end(&format!("{} of {} frames", kept.len(), candidates.len()));
    Ok(kept)
}

/// Returns which frames are kept.
fn choose(samples: &[Samples], views: usize) -> Vec<bool> {
    let mut kept = vec![true; samples.len()];
    let mut filter = KeyframeFilter { cells: Cells::of(samples), ..KeyframeFilter::new(views) };
    for slot in spread(samples.len()) {
        kept[slot] = filter.keeps(&samples[slot]);
    }
    kept
}

/// The choice of keyframes among frames that come one after another.
pub(crate) struct KeyframeFilter {
    /// Greatest number of views; 0 for all.
    views: usize,
    /// `None` before a frame measures anything.
    cells: Option<Cells>,
    seen: HashMap<Side, [u16; RANGES]>,
}

impl KeyframeFilter {
    /// Returns a choice among frames of unknown distances: those of the first frame stand for all.
    pub(crate) fn new(views: usize) -> Self {
        Self { views, cells: None, seen: HashMap::new() }
    }

    /// Returns whether the next frame is kept.
    pub(crate) fn keeps(&mut self, samples: &Samples) -> bool {
        if self.cells.is_none() {
            self.cells = Cells::of(std::slice::from_ref(samples));
        }
        // A frame without any measurement is kept: the loader reports or skips it.
        let Some(cells) = self.cells.as_ref().filter(|_| self.views > 0) else { return true };
        let sides = cells.sides(samples);
        let is_open = |(side, range): &(&Side, &usize)| {
            let nearer = self.seen.get(side).into_iter().flat_map(|counts| &counts[..=**range]);
            nearer.map(|&n| usize::from(n)).sum::<usize>() < self.views
        };
        let is_kept = 2 * sides.iter().filter(is_open).count() >= sides.len();
        if is_kept {
            for (side, range) in sides {
                let count = &mut self.seen.entry(side).or_insert([0; RANGES])[range];
                *count = count.saturating_add(1);
            }
        }
        is_kept
    }
}

/// The measurements of one frame that stand for all of them.
pub(crate) struct Samples {
    /// Camera centre in the world, metres.
    center_w: DVec3,
    /// From the measured points to the camera centre, in the world, metres.
    to_camera_w: Vec<Vec3>,
    /// Distance between neighbouring samples at a distance of 1 m, metres.
    pitch: f64,
}

impl Samples {
    /// Returns the measurements of a recorded frame; none if its depth is damaged or empty.
    ///
    /// # Errors
    /// [`FramesError`] if its file cannot be read for other reasons than its content.
    pub(crate) fn read(recording: &Recording, index: usize) -> Result<Self, FramesError> {
        let frame = &recording.frames[index];
        let (lens, x_wc): (_, DPose3) = (&frame.depth_lens, frame.x_rc);
        let k = &lens.intrinsics;
        let step = k.width.max(k.height).div_ceil(SAMPLES).max(1);
        let depth = match recording.read_depth_m(index) {
            Err(FramesError::Input(_)) => None,
            depth => Some(depth?),
        };
        let at = |(x, y): (usize, usize)| {
            let z = f64::from(depth.as_ref()?[(x, y)]);
            let ray_c = lens.ray_c(x as f64 + 0.5, y as f64 + 0.5)?;
            (z > 0.0).then(|| (x_wc.rotation * -ray_c * z).as_vec3())
        };
        let along = |side: usize| (step.min(side) / 2..side).step_by(step);
        let pixels = along(k.height).flat_map(|y| along(k.width).map(move |x| (x, y)));
        Ok(Self {
            center_w: x_wc.translation,
            to_camera_w: pixels.filter_map(at).collect(),
            pitch: step as f64 / (k.fx * k.fy).sqrt(),
        })
    }
}

/// A part of a surface as it is seen from one side: indices of the cell, and the axis that is closest to the direction of the camera
/// (±1 to ±3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Side {
    cell: [i32; 3],
    toward: i8,
}

/// Cubic cells of space.
struct Cells {
    /// A corner, in the world, metres. Near the cameras, so that indices are small.
    origin_w: DVec3,
    /// Width, metres.
    width_m: f64,
}

impl Cells {
    /// `None` if no frame measures anything.
    fn of(samples: &[Samples]) -> Option<Self> {
        let spacing_m = |frame: &Samples| {
            let mut distances: Vec<f64> = frame.to_camera_w.iter().map(|v| f64::from(v.length())).collect();
            Some(frame.pitch * quantile(&mut distances, 0.5, QuantileRule::Nearest)?)
        };
        let mut spacings_m: Vec<f64> = samples.iter().filter_map(spacing_m).collect();
        let width_m = CELL_SAMPLES * quantile(&mut spacings_m, 0.5, QuantileRule::Nearest)?;
        Some(Self { origin_w: samples[0].center_w, width_m })
    }

    /// Returns the parts of the surface that a frame sees, each with the range of its least distance.
    fn sides(&self, frame: &Samples) -> HashMap<Side, usize> {
        let mut sides: HashMap<Side, usize> = HashMap::new();
        for to_camera_w in &frame.to_camera_w {
            let axis = to_camera_w.abs().max_position();
            let toward = (axis as i8 + 1) * to_camera_w[axis].signum() as i8;
            let p_w = frame.center_w - self.origin_w - to_camera_w.as_dvec3();
            let cell = (p_w / self.width_m).floor().as_ivec3().to_array();
            let octaves = (to_camera_w.length() / 0.01).max(1.0).log2();
            let range = ((octaves * RANGES_PER_OCTAVE) as usize).min(RANGES - 1);
            let nearest = sides.entry(Side { cell, toward }).or_insert(range);
            *nearest = range.min(*nearest);
        }
        sides
    }
}

/// Returns all numbers below `n`, so that each beginning of the list is spread evenly: 0, then the halves, the quarters, …
fn spread(n: usize) -> Vec<usize> {
    let bits = usize::BITS - n.saturating_sub(1).leading_zeros();
    let reversed = |i: usize| if bits == 0 { 0 } else { i.reverse_bits() >> (usize::BITS - bits) };
    (0..1usize << bits).map(reversed).filter(|&i| i < n).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera that sees a square around the world's `at_w` from `from_m` along +z (or -z if negative).
    fn facing(at_w: DVec3, from_m: f32) -> Samples {
        let offsets = (0..64).map(|i| Vec3::new((i % 8) as f32 - 3.5, (i / 8) as f32 - 3.5, 0.0) * 0.04);
        Samples {
            center_w: at_w + DVec3::Z * f64::from(from_m),
            to_camera_w: offsets.map(|offset| Vec3::Z * from_m + offset).collect(),
            pitch: 0.04,
        }
    }

    fn count(kept: &[bool]) -> usize {
        kept.iter().filter(|kept| **kept).count()
    }

    #[test]
    fn views_from_afar_or_from_behind_do_not_stand_for_near_ones() {
        let frames = |distances: [f32; 2]| -> Vec<Samples> {
            (0..32).map(|i| facing(DVec3::ZERO, distances[i / 16])).collect()
        };
        assert_eq!(count(&choose(&frames([1.0, 1.0]), 4)), 4);
        assert_eq!(count(&choose(&frames([1.0, -1.0]), 4)), 8);
        let of_both = choose(&frames([1.0, 3.0]), 4);
        assert_eq!(count(&of_both[..16]), 4, "far views count for nothing");
        assert!(count(&of_both[16..]) <= 4);
    }

    #[test]
    fn frames_that_see_something_else_are_kept_wherever_the_world_lies() {
        for world in [0.0, 3e5, -2e7] {
            let at = |i: usize| DVec3::new(world, if i == 13 { 5.0 } else { 0.0 }, world);
            let frames: Vec<Samples> = (0..32).map(|i| facing(at(i), 1.0)).collect();
            let kept = choose(&frames, 4);
            assert!(kept[13] && count(&kept) == 5, "{world} {kept:?}");
        }
    }

    #[test]
    fn frames_that_come_one_after_another_are_kept_until_there_are_enough_views() {
        let count_of = |views: usize| {
            let mut filter = KeyframeFilter::new(views);
            (0..32).filter(|_| filter.keeps(&facing(DVec3::ZERO, 1.0))).count()
        };
        assert_eq!((count_of(4), count_of(0)), (4, 32));
        let mut filter = KeyframeFilter::new(1);
        let empty = Samples { to_camera_w: Vec::new(), ..facing(DVec3::ZERO, 1.0) };
        let keeps = |samples: &Samples| filter.keeps(samples);
        assert_eq!(
            [&empty, &facing(DVec3::ZERO, 1.0), &facing(DVec3::ZERO, 1.0)].map(keeps),
            [true, true, false]
        );
    }

    #[test]
    fn frames_without_measurements_are_left_to_the_loader() {
        let empty = || Samples { to_camera_w: Vec::new(), ..facing(DVec3::ZERO, 1.0) };
        assert!(choose(&[empty(), empty(), empty()], 1).iter().all(|kept| *kept));
        let mixed: Vec<Samples> =
            (0..8).map(|i| if i == 5 { empty() } else { facing(DVec3::ZERO, 1.0) }).collect();
        let kept = choose(&mixed, 2);
        assert!(kept[5] && count(&kept) == 3);
    }

    #[test]
    fn each_beginning_of_the_order_is_spread_evenly() {
        assert_eq!(spread(8), [0, 4, 2, 6, 1, 5, 3, 7]);
        assert_eq!(spread(5), [0, 4, 2, 1, 3]);
        assert_eq!((spread(1), spread(0)), (vec![0], vec![0; 0]));
    }
}
