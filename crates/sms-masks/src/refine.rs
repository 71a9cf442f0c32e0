//! The paper's correction of mask borders (appendix, "Object detection and segmentation").

use crate::MasksError;
use crate::voxels::key_of;
use glamx::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use sms_core::{BACKGROUND, InputError, LabelMap, Labels};
use sms_frames::{Frame, Sequence};
use std::collections::HashSet;
use std::num::NonZeroUsize;

/// Margin of the paper, in pixels of an image 1280 wide; see [`scaled_margin_px`].
const DEFAULT_MARGIN_PX: f64 = 5.0;
/// Number of voting neighbours.
const NEIGHBORS: NonZeroUsize = NonZeroUsize::new(12).unwrap();

/// Voters are thinned to one per label and cell of this size, so that close frames do not outvote distant ones.
const CELL_M: f64 = 0.003;
/// Weight of a voter inside the margin of its own frame, where labels are doubtful. It is not 0, because all pixels of
/// a thin object lie inside the margin.
const DOUBTFUL_WEIGHT: f32 = 0.1;

/// Scales the paper's 5 pixels (at a width of 1280) to images `width` wide; at least 1.
pub(crate) fn scaled_margin_px(width: usize) -> usize {
    (DEFAULT_MARGIN_PX * width as f64 / 1280.0).round().max(1.0) as usize
}

/// Largest distance of a voter. Farther voters may be flying pixels between two surfaces.
const REACH_M: f64 = 0.012;
/// Size of the cells round borders outside of which voters are left out. It is a multiple of the voters' cells, so that none of these
/// is cut, and their means are those of all points; and at least twice the reach, so that the corners of the cube around a point lie in
/// all cells that the cube touches.
const NEAR_M: f64 = 16.0 * CELL_M;
const _: () = assert!(NEAR_M >= 2.0 * REACH_M);
/// Spread of colour on one surface, 8-bit levels: noise and light.
const COLOR_SIGMA: f64 = 20.0;
/// Weight of a voter with a colour unlike the pixel's, relative to 1 for the same colour. Near silhouettes, depth often
/// belongs to the other surface while colour is right.
const UNLIKE_WEIGHT: f64 = 0.01;

/// A voter: the mean of the points of one label in one cell.
#[derive(Debug, Clone, Copy)]
struct Voter {
    key: u64,
    label: u16,
    p_w: DVec3,
    weight: f32,
    /// Mean sRGB colour, 8-bit levels.
    color: [f32; 3],
}

/// Relabels every pixel with depth within `margin_px` pixels of a mask edge by a vote of its 12 nearest neighbours in
/// the cloud back-projected from all frames. A vote has the inverse of the distance as its weight. Pixels within the
/// margin of their own frame's edges vote with a tenth of the weight. In addition to the paper's method, voters with
/// the pixel's colour count more than others. This preserves correct masks where depth is wrong at a silhouette.
///
/// Pixels without depth keep their label. Labels, names and sizes remain unchanged.
///
/// # Errors
/// [`MasksError::Input`] if labels and sequence differ in frames or sizes.
pub fn refine_edges(labels: &Labels, sequence: &Sequence, margin_px: usize) -> Result<Labels, MasksError> {
    let same = labels.maps.len() == sequence.len()
        && labels.maps.iter().zip(&sequence.frames).all(|(m, f)| m.size() == f.depth.size());
    if !same {
        let (maps, frames) = (labels.maps.len(), sequence.len());
        let what = format!("{maps} masks do not fit the {frames} frames in number or size");
        let cure = "make the masks again from this sequence";
        return Err(InputError::new(what, &sequence.source, cure).into());
    }
    let margins: Vec<Vec<bool>> = labels.maps.par_iter().map(|map| margin(map, margin_px)).collect();
    Ok(refine_near(labels, sequence, &margins, &cells_near(sequence, &margins)))
}

/// Relabels the pixels of the margins, by the votes of the points in the cells `near`.
fn refine_near(labels: &Labels, sequence: &Sequence, margins: &[Vec<bool>], near: &HashSet<u64>) -> Labels {
    let per_frame: Vec<Vec<Voter>> = (0..sequence.len())
        .into_par_iter()
        .map(|i| merge(voters(&sequence.frames[i], &labels.maps[i], &margins[i], near)))
        .collect();
    let cloud = merge(per_frame.into_iter().flatten().collect());
    if cloud.is_empty() {
        return labels.clone();
    }
    let points: Vec<[f64; 3]> = cloud.iter().map(|v| v.p_w.to_array()).collect();
    let tree = ImmutableKdTree::<f64, 3>::new_from_slice(&points);
    let maps = (0..sequence.len())
        .into_par_iter()
        .map(|i| {
            let (frame, mut map) = (&sequence.frames[i], labels.maps[i].clone());
            for (pixel, value) in map.data.iter_mut().enumerate().filter(|(pixel, _)| margins[i][*pixel]) {
                let Some(p_w) = point_w(frame, pixel) else { continue };
                let near = tree.nearest_n::<SquaredEuclidean>(&p_w.to_array(), NEIGHBORS);
                *value = vote(
                    near.iter().map(|n| (&cloud[n.item as usize], n.distance)),
                    *value,
                    frame.color.data[pixel].map(f32::from),
                );
            }
            map
        })
        .collect();
    Labels { maps, ..labels.clone() }
}

/// Marks pixels within `margin_px` (Chebyshev) of a change of label.
fn margin(map: &LabelMap, margin_px: usize) -> Vec<bool> {
    let (w, h) = map.size();
    let mut edge = vec![false; w * h];
    for y in 0..h {
        for x in 0..w {
            let own = map[(x, y)];
            let right = x + 1 < w && map[(x + 1, y)] != own;
            let below = y + 1 < h && map[(x, y + 1)] != own;
            if right || below {
                edge[y * w + x] = true;
                edge[y * w + x + usize::from(right)] = true;
                edge[(y + usize::from(below)) * w + x] = true;
            }
        }
    }
    // The two pixels on both sides of an edge are the first pixels of the margin.
    let reach = margin_px.saturating_sub(1);
    let across: Vec<bool> = (0..w * h)
        .map(|i| {
            let (x, row) = (i % w, i / w * w);
            (x.saturating_sub(reach)..=(x + reach).min(w - 1)).any(|x| edge[row + x])
        })
        .collect();
    (0..w * h)
        .map(|i| {
            let (x, y) = (i % w, i / w);
            margin_px > 0 && (y.saturating_sub(reach)..=(y + reach).min(h - 1)).any(|y| across[y * w + x])
        })
        .collect()
}

/// Returns the measured point of a pixel.
fn point_w(frame: &Frame, pixel: usize) -> Option<DVec3> {
    let (width, z) = (frame.depth.width, f64::from(frame.depth.data[pixel]));
    (z > 0.0).then(|| frame.camera.unproject_pixel(pixel % width, pixel / width, z))
}

/// Returns the cells of size [`NEAR_M`] that hold everything within [`REACH_M`] of the points in the margins. Points elsewhere have no
/// vote, and would be most of the memory.
fn cells_near(sequence: &Sequence, margins: &[Vec<bool>]) -> HashSet<u64> {
    let of_frame = |(frame, margin): (&Frame, &Vec<bool>)| {
        let points_w = (0..margin.len()).filter(|&i| margin[i]).filter_map(|i| point_w(frame, i));
        let corner = |k: u8| {
            DVec3::from_array([0, 1, 2].map(|axis| if k >> axis & 1 == 1 { REACH_M } else { -REACH_M }))
        };
        let keys = points_w.flat_map(|p_w| (0..8).filter_map(move |k| key_of(p_w + corner(k), NEAR_M)));
        keys.collect::<HashSet<u64>>()
    };
    let union = |mut all: HashSet<u64>, of_one: HashSet<u64>| {
        all.extend(of_one);
        all
    };
    sequence.frames.par_iter().zip(margins).map(of_frame).reduce(HashSet::new, union)
}

fn voters(frame: &Frame, map: &LabelMap, margin: &[bool], near: &HashSet<u64>) -> Vec<Voter> {
    (0..map.data.len())
        .filter_map(|pixel| {
            let p_w = point_w(frame, pixel)?;
            let key = key_of(p_w, CELL_M)?;
            let weight = if margin[pixel] { DOUBTFUL_WEIGHT } else { 1.0 };
            key_of(p_w, NEAR_M).is_some_and(|cell| near.contains(&cell)).then_some(Voter {
                key,
                label: map.data[pixel],
                p_w,
                weight,
                color: frame.color.data[pixel].map(f32::from),
            })
        })
        .collect()
}

/// Merges voters with the same cell and label to their weighted mean. The sort is stable, so sums run in the order of
/// the frames.
fn merge(mut all: Vec<Voter>) -> Vec<Voter> {
    all.sort_by_key(|v| (v.key, v.label));
    all.chunk_by(|a, b| (a.key, a.label) == (b.key, b.label))
        .map(|same| {
            let total: f32 = same.iter().map(|v| v.weight).sum();
            let p_w = same.iter().map(|v| v.p_w * f64::from(v.weight)).sum::<DVec3>() / f64::from(total);
            let mut color = [0.0; 3];
            for v in same {
                for k in 0..3 {
                    color[k] += v.color[k] * v.weight / total;
                }
            }
            Voter { p_w, weight: total, color, ..same[0] }
        })
        .collect()
}

/// Returns the label with the largest sum of weight / distance among the voters, weighted by likeness to the colour
/// `own`; `present` wins ties.
fn vote<'a>(near: impl Iterator<Item = (&'a Voter, f64)>, present: u16, own: [f32; 3]) -> u16 {
    let mut sums: Vec<(u16, f64)> = vec![(present, 0.0)];
    for (voter, squared) in near.filter(|n| n.1 < REACH_M * REACH_M) {
        // Distances below a millimetre are noise.
        let weight = f64::from(voter.weight.min(8.0)) / (squared.sqrt() + 1e-3);
        let unlike: f32 = own.iter().zip(&voter.color).map(|(a, b)| (a - b).powi(2)).sum();
        let weight = weight * (UNLIKE_WEIGHT + (-0.5 * f64::from(unlike) / COLOR_SIGMA.powi(2)).exp());
        match sums.iter_mut().find(|s| s.0 == voter.label) {
            Some(sum) => sum.1 += weight,
            None => sums.push((voter.label, weight)),
        }
    }
    sums.iter().fold((BACKGROUND, f64::NEG_INFINITY), |best, &s| if s.1 > best.1 { s } else { best }).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Sensor, best_iou, scene, table_scene};
    use sms_core::{Image, LabelInfo, MaskSource};

    fn truth_labels(maps: Vec<LabelMap>, count: u16) -> Labels {
        let info = |id| LabelInfo { id, name: format!("o{id}"), description: String::new() };
        Labels { maps, objects: (1..=count).map(info).collect(), source: MaskSource::Files }
    }

    /// Returns the mean IoU over the objects.
    fn mean_iou(truth: &[LabelMap], labels: &Labels) -> f64 {
        let count = labels.objects.len();
        (1..=count as u16).map(|v| best_iou(truth, v, labels).0).sum::<f64>() / count as f64
    }

    /// Grows (odd frames) or shrinks (even frames) every mask by `n` pixels.
    fn corrupt(map: &LabelMap, frame: usize, n: i64) -> LabelMap {
        let mut out = map.clone();
        for y in 0..map.height as i64 {
            for x in 0..map.width as i64 {
                let around = (-n..=n).flat_map(|dy| (-n..=n).map(move |dx| (x + dx, y + dy)));
                let around = around.filter_map(|(x, y)| map.get(x, y).copied());
                let own = map[(x as usize, y as usize)];
                let grown = if frame % 2 == 1 { around.max() } else { around.min() };
                let changes = if frame % 2 == 1 { own == 0 } else { own != 0 };
                out[(x as usize, y as usize)] = if changes { grown.unwrap_or(own) } else { own };
            }
        }
        out
    }

    #[test]
    fn borders_wrong_by_two_pixels_are_mended() {
        let solids = table_scene();
        let (sequence, truth) = scene(&solids, Sensor { frames: 10, ..Sensor::default() }, 3);
        let wrong = truth.iter().enumerate().map(|(i, m)| corrupt(m, i, 2)).collect();
        let before = truth_labels(wrong, solids.len() as u16);
        let after = refine_edges(&before, &sequence, 3).unwrap();
        for value in 1..=solids.len() as u16 {
            let (b, a) = (best_iou(&truth, value, &before).0, best_iou(&truth, value, &after).0);
            println!("solid {value}: IoU {b:.3} before, {a:.3} after");
            assert!(b < 0.8 && a > b + 0.1 && a > 0.87, "solid {value}: {b:.3} -> {a:.3}");
        }
    }

    #[test]
    fn points_far_from_all_borders_have_no_vote() {
        let solids = table_scene();
        let (sequence, truth) = scene(&solids, Sensor { frames: 6, ..Sensor::default() }, 3);
        let wrong = truth.iter().enumerate().map(|(i, m)| corrupt(m, i, 2)).collect();
        let labels = truth_labels(wrong, solids.len() as u16);
        let margins: Vec<Vec<bool>> = labels.maps.iter().map(|map| margin(map, 3)).collect();
        let near = cells_near(&sequence, &margins);
        let points_w =
            sequence.frames.iter().flat_map(|f| (0..f.depth.data.len()).filter_map(|i| point_w(f, i)));
        let everywhere: HashSet<u64> = points_w.filter_map(|p_w| key_of(p_w, NEAR_M)).collect();
        assert!(near.intersection(&everywhere).count() < everywhere.len() / 2);
        let maps = |cells: &HashSet<u64>| refine_near(&labels, &sequence, &margins, cells).maps;
        assert_eq!(maps(&near), maps(&everywhere));
    }

    #[test]
    fn borders_wrong_by_five_pixels_are_mended() {
        let solids = table_scene();
        let (sequence, truth) =
            scene(&solids, Sensor { frames: 10, size: (640, 400), ..Sensor::default() }, 3);
        let wrong = truth.iter().enumerate().map(|(i, m)| corrupt(m, i, 5)).collect();
        let before = truth_labels(wrong, solids.len() as u16);
        let after = refine_edges(&before, &sequence, 6).unwrap();
        let (b, a) = (mean_iou(&truth, &before), mean_iou(&truth, &after));
        println!("mean IoU {b:.3} before, {a:.3} after");
        assert!(b < 0.75 && a > 0.9, "{b:.3} -> {a:.3}");
    }

    /// The paper's case: five pixels at 1280, with the default margin. Frames that agree on a wrong border outvote the
    /// right one, so less is corrected than if the frames differ.
    #[test]
    fn of_borders_that_all_frames_have_wrong_four_tenths_are_mended() {
        let solids = table_scene();
        let (sequence, truth) =
            scene(&solids, Sensor { frames: 6, size: (1280, 800), ..Sensor::default() }, 3);
        let margin_px = scaled_margin_px(1280);
        for (what, frame) in [("grown", 1), ("shrunk", 0)] {
            let wrong = truth.iter().map(|m| corrupt(m, frame, 5)).collect();
            let before = truth_labels(wrong, solids.len() as u16);
            let after = refine_edges(&before, &sequence, margin_px).unwrap();
            let (b, a) = (mean_iou(&truth, &before), mean_iou(&truth, &after));
            println!("{what}: mean IoU {b:.3} before, {a:.3} after");
            assert!(b < 0.75 && a > b + 0.4 * (1.0 - b), "{what}: {b:.3} -> {a:.3}");
        }
    }

    #[test]
    fn right_borders_stay_and_the_inside_is_never_touched() {
        let solids = table_scene();
        let (sequence, truth) = scene(&solids, Sensor { frames: 6, ..Sensor::default() }, 4);
        let before = truth_labels(truth.clone(), solids.len() as u16);
        let margin_px = scaled_margin_px(320);
        let after = refine_edges(&before, &sequence, margin_px).unwrap();
        for value in 1..=solids.len() as u16 {
            let iou = best_iou(&truth, value, &after).0;
            assert!(iou > 0.93, "solid {value}: {iou:.3}");
        }
        for (map, refined) in before.maps.iter().zip(&after.maps) {
            let margin = margin(map, margin_px);
            for i in (0..map.data.len()).filter(|&i| !margin[i]) {
                assert_eq!(map.data[i], refined.data[i]);
            }
        }
        assert_eq!(refine_edges(&before, &sequence, 0).unwrap(), before);
    }

    #[test]
    fn the_margin_has_the_stated_width() {
        let mut map = Image::filled(12, 3, 0u16);
        for y in 0..3 {
            for x in 6..12 {
                map[(x, y)] = 1;
            }
        }
        for (px, expect) in [(0, 0), (1, 2), (2, 4), (5, 10)] {
            assert_eq!(margin(&map, px)[..12].iter().filter(|m| **m).count(), expect, "margin {px}");
        }
        assert_eq!((scaled_margin_px(1280), scaled_margin_px(640), scaled_margin_px(100)), (5, 3, 1));
    }

    #[test]
    fn mismatched_input_is_refused() {
        let (sequence, truth) = scene(&[], Sensor { frames: 2, size: (8, 6), ..Sensor::default() }, 1);
        let labels = truth_labels(truth[..1].to_vec(), 0);
        assert!(matches!(refine_edges(&labels, &sequence, 1), Err(MasksError::Input(_))));
    }
}
