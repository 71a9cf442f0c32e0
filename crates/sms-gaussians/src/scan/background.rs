//! The colour behind all Gaussians: that of the sky or a distant backdrop, where no depth is measured and so no
//! Gaussian is seeded.

use rayon::prelude::*;
use sms_frames::Frame;

/// Pixels within this distance of measured depth (in rows or columns) may be dropouts at the edge of an object.
const CLEARANCE_PX: usize = 5;
/// Smallest share of the pixels that counts as a backdrop.
const LEAST_SHARE: f64 = 0.01;

/// Returns the mean colour (0 to 1) of the pixels without measured depth within [`CLEARANCE_PX`], over all frames;
/// black if there are too few. The mean minimizes the squared error.
pub(crate) fn background_color(frames: &[&Frame]) -> [f32; 3] {
    let each: Vec<([u64; 3], u64, u64)> = frames.par_iter().map(|frame| sum_of_frame(frame)).collect();
    let (mut sum, mut count, mut pixels) = ([0u64; 3], 0u64, 0u64);
    for (frame_sum, frame_count, frame_pixels) in each {
        (0..3).for_each(|c| sum[c] += frame_sum[c]);
        count += frame_count;
        pixels += frame_pixels;
    }
    if count == 0 || (count as f64) < LEAST_SHARE * pixels as f64 {
        return [0.0; 3];
    }
    sum.map(|s| (s as f64 / (255.0 * count as f64)) as f32)
}

/// Returns sum and number of the pixels of a frame that are clear of depth, and the number of all pixels.
fn sum_of_frame(frame: &Frame) -> ([u64; 3], u64, u64) {
    let (width, height) = frame.depth.size();
    let is_clear = |(i, &z): (usize, &f32)| z <= 0.0 && frame.shows_scene(i);
    let taken: Vec<bool> = frame.depth.data.iter().enumerate().map(|pixel| !is_clear(pixel)).collect();
    let mut in_row = vec![false; taken.len()];
    for y in 0..height {
        let row = y * width..(y + 1) * width;
        spread(&taken, &mut in_row, row.clone());
        spread(&taken, &mut in_row, row.rev());
    }
    let mut near = vec![false; taken.len()];
    for x in 0..width {
        let column = (x..taken.len()).step_by(width);
        spread(&in_row, &mut near, column.clone());
        spread(&in_row, &mut near, column.rev());
    }
    let (mut sum, mut count) = ([0u64; 3], 0u64);
    for (color, _) in frame.color.data.iter().zip(&near).filter(|(_, near)| !**near) {
        (0..3).for_each(|c| sum[c] += u64::from(color[c]));
        count += 1;
    }
    (sum, count, near.len() as u64)
}

/// Marks the places of a line at or within the clearance after a set place of `from`.
fn spread(from: &[bool], to: &mut [bool], line: impl Iterator<Item = usize>) {
    // End of the reach of the last set place.
    let mut reach = 0;
    for (k, i) in line.enumerate() {
        if from[i] {
            reach = k + CLEARANCE_PX + 1;
        }
        to[i] |= k < reach;
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{SMALL, record};
    use super::*;

    /// A frame with depth in all rows from `first_row` on, white where there is depth, `sky` elsewhere.
    fn frame(first_row: usize, sky: [u8; 3]) -> Frame {
        let mut frame = record(super::super::fixture::Recorded { frames: 1, ..SMALL }).0.frames.remove(0);
        for y in 0..SMALL.height {
            for x in 0..SMALL.width {
                frame.depth[(x, y)] = if y >= first_row { 1.0 } else { 0.0 };
                frame.color[(x, y)] = if y >= first_row { [255; 3] } else { sky };
            }
        }
        frame
    }

    #[test]
    fn the_mean_of_pixels_clear_of_depth() {
        let (mut a, b) = (frame(30, [51, 102, 204]), frame(30, [51, 102, 0]));
        assert_eq!(background_color(&[&a]), [0.2, 0.4, 0.8]);
        assert_eq!(background_color(&[&a, &b]), [0.2, 0.4, 0.4]);
        // Dropouts on an object and pixels near an edge do not count: neither rows 25 to 29 nor a hole.
        for (x, y) in (40..50).flat_map(|x| (60..70).map(move |y| (x, y))) {
            a.depth[(x, y)] = 0.0;
            a.color[(x, y)] = [255, 0, 0];
        }
        a.color.data[25 * SMALL.width..30 * SMALL.width].fill([0; 3]);
        assert_eq!(background_color(&[&a]), [0.2, 0.4, 0.8]);
        // Row 24 is just far enough from depth.
        a.color.data[24 * SMALL.width..25 * SMALL.width].fill([0; 3]);
        assert!(background_color(&[&a])[0] < 0.2);
    }

    #[test]
    fn the_clearance_is_the_same_on_all_sides() {
        let mut single = frame(SMALL.height, [255; 3]);
        single.depth[(40, 50)] = 1.0;
        let side = 2 * CLEARANCE_PX + 1;
        for y in 0..side {
            for x in 0..side {
                single.color[(40 + x - CLEARANCE_PX, 50 + y - CLEARANCE_PX)] = [0; 3];
            }
        }
        assert_eq!(background_color(&[&single]), [1.0; 3]);
        single.depth[(40, 50)] = 0.0;
        assert!(background_color(&[&single])[0] < 1.0);
    }

    #[test]
    fn too_few_pixels_are_black() {
        let (none, five, seven) = (frame(0, [200; 3]), frame(5, [200; 3]), frame(7, [200; 3]));
        assert_eq!(background_color(&[&none]), [0.0; 3]);
        assert_eq!(background_color(&[&five]), [0.0; 3]);
        // Two rows of a hundred; then less than one percent of all frames.
        assert_eq!(background_color(&[&seven]), [200.0 / 255.0; 3]);
        assert_eq!(background_color(&[&seven, &none, &none]), [0.0; 3]);
        assert_eq!(background_color(&[]), [0.0; 3]);
    }
}
