//! Points of an object, grouped by place, with the frames that can answer a question about them.
//!
//! Most frames have nothing to say: something nearer hides the place, or the pixels there have another label. A look at the
//! few pixels around the image of a place rules them out for all of its points.

use crate::views::{NearPixel, Views};
use glamx::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Side of a place, metres.
const SIDE_M: f64 = 0.02;

/// Returns `ask` of every point, which gets the point's index and, in their order, all frames with a pixel near the point's
/// image that has something to say.
pub(crate) fn ask_frames<T: Send>(
    points_w: &[DVec3],
    views: &Views,
    has_something_to_say: impl Fn(NearPixel) -> bool + Sync,
    ask: impl Fn(usize, &[usize]) -> T + Sync,
) -> Vec<T> {
    let mut places: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (i, p) in points_w.iter().enumerate() {
        places.entry((p / SIDE_M).floor().to_array().map(|v| v as i64)).or_default().push(i);
    }
    let radius = 0.5 * SIDE_M * 3f64.sqrt() + 1e-9;
    let places: Vec<([i64; 3], Vec<usize>)> = places.into_iter().collect();
    let of_place = |(at, indices): &([i64; 3], Vec<usize>)| {
        let center_w = SIDE_M * DVec3::from_array(at.map(|v| v as f64 + 0.5));
        let frames = views.frames_with(center_w, radius, &has_something_to_say);
        indices.iter().map(|&i| (i, ask(i, &frames))).collect::<Vec<_>>()
    };
    let mut answers: Vec<(usize, T)> = places.par_iter().flat_map_iter(of_place).collect();
    answers.sort_unstable_by_key(|(i, _)| *i);
    answers.into_iter().map(|(_, answer)| answer).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::over_plate;
    use crate::views::Sight;
    use rand::RngExt;
    use sms_core::Seed;

    #[test]
    fn frames_that_have_nothing_to_say_change_no_answer() {
        let (mut sequence, labels) = over_plate(8, 60);
        let mut rng = Seed(7).rng();
        for (i, frame) in sequence.frames.iter_mut().enumerate() {
            frame.camera.x_wc.translation += DVec3::new(0.05, -0.03, 0.0) * i as f64;
            frame
                .depth
                .data
                .iter_mut()
                .filter(|z| **z > 0.0)
                .for_each(|z| *z += rng.random_range(-0.05..0.05));
        }
        let views = Views::new(&sequence, &labels);
        let random = |_| DVec3::from_array([-0.6..0.6, -0.6..0.6, -0.15..0.15].map(|r| rng.random_range(r)));
        let points: Vec<DVec3> = (0..4000).map(random).collect();
        let all: Vec<usize> = (0..sequence.len()).collect();
        let sights = |i: usize, frames: &[usize], wanted: fn(Sight) -> bool| {
            frames.iter().filter(|&&f| wanted(views.sight(f, points[i]))).count()
        };
        let is_surface = |s: Sight| s == Sight::Surface(1);
        type Case = (fn(NearPixel) -> bool, fn(Sight) -> bool);
        let cases: [Case; 3] = [
            (|p| p.may_be_seen(), |s| matches!(s, Sight::Surface(_) | Sight::Free)),
            (|p| p.may_be_free(), |s| s == Sight::Free),
            (|p| p.label == 1 && p.may_be_on_surface(), is_surface),
        ];
        for (says, wanted) in cases {
            let counted =
                ask_frames(&points, &views, says, |i, frames| (sights(i, frames, wanted), frames.len()));
            let asked: usize = counted.iter().map(|c| c.1).sum();
            assert!(asked < points.len() * all.len(), "{asked}");
            for (i, (count, _)) in counted.into_iter().enumerate() {
                assert_eq!(count, sights(i, &all, wanted), "{:?}", points[i]);
            }
        }
    }
}
