//! Visibility of points: on a surface, in free space, or hidden.

use crate::frame_cells::FrameCells;
use crate::places::ask_frames;
use glamx::DVec3;
use sms_core::Labels;
use sms_frames::Sequence;
use sms_mesh::median;
use std::sync::Arc;

/// Visibility of a point in one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sight {
    /// The measured surface is at the point, with this label.
    Surface(u16),
    /// The camera sees something farther away through the point.
    Free,
    /// Something nearer hides it.
    Hidden,
    /// Outside the image, or nothing measured.
    Unknown,
}

/// The frames with their labels.
pub(crate) struct Views<'a> {
    pub(crate) sequence: &'a Sequence,
    pub(crate) labels: &'a Labels,
    cells: Arc<FrameCells>,
}

/// Returns the expected depth noise (one standard deviation, metres) at depth `z` for common stereo and
/// structured-light cameras. It grows with the square of depth.
pub(crate) fn depth_sigma(z: f64) -> f64 {
    0.0008 + 0.0015 * z * z
}

/// Returns the difference in depth that separates two surfaces, metres.
pub(crate) fn depth_tolerance(z: f64) -> f64 {
    (3.0 * depth_sigma(z)).max(0.004)
}

/// A pixel near the image of a ball: its measured depth (0 without one) and label, and the depths of the ball.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NearPixel {
    pub(crate) depth: f64,
    pub(crate) label: u16,
    /// Least depth of the ball, metres.
    pub(crate) nearest: f64,
    /// Greatest depth of the ball, metres.
    pub(crate) farthest: f64,
}

impl NearPixel {
    /// Returns whether a point of the ball may lie on the surface measured here, or cameras may see through it.
    pub(crate) fn may_be_seen(&self) -> bool {
        self.depth > 0.0 && self.depth >= self.nearest - depth_tolerance(self.farthest)
    }

    /// Returns whether a point of the ball may lie on the surface measured here.
    pub(crate) fn may_be_on_surface(&self) -> bool {
        self.may_be_seen() && self.depth <= self.farthest + depth_tolerance(self.farthest)
    }

    /// Returns whether cameras may see through a point of the ball.
    pub(crate) fn may_be_free(&self) -> bool {
        self.depth > self.nearest + depth_tolerance(self.nearest)
    }
}

/// Totals over all frames.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct SightCount {
    /// Number of frames that measure a surface with the given label.
    pub(crate) own: usize,
    /// Number of frames that measure a surface with another label.
    pub(crate) other: usize,
    /// Number of frames that see through the point.
    pub(crate) free: usize,
    /// Sum of unit directions from the point to the cameras that measure a surface.
    pub(crate) towards: DVec3,
}

impl<'a> Views<'a> {
    pub(crate) fn new(sequence: &'a Sequence, labels: &'a Labels) -> Self {
        Self { sequence, labels, cells: Arc::new(FrameCells::of(sequence)) }
    }

    /// Returns the same frames with other labels.
    pub(crate) fn relabelled<'b>(&self, labels: &'b Labels) -> Views<'b>
    where
        'a: 'b,
    {
        Views { sequence: self.sequence, labels, cells: Arc::clone(&self.cells) }
    }

    /// Returns, in their order, the frames whose image may contain `p_w`. In all others it is [`Sight::Unknown`].
    pub(crate) fn frames_near(&self, p_w: DVec3) -> impl Iterator<Item = usize> {
        self.cells.at(p_w).iter().map(|&f| f as usize)
    }

    /// Returns, in their order, the frames whose image may contain a point of the ball.
    pub(crate) fn frames_around(&self, center_w: DVec3, radius: f64) -> impl Iterator<Item = usize> {
        self.cells.around(center_w, radius).iter().map(|&f| f as usize)
    }

    /// Returns, in their order, all frames with a wanted pixel around the image of the ball, and others.
    pub(crate) fn frames_with(
        &self,
        center_w: DVec3,
        radius: f64,
        is_wanted: impl Fn(NearPixel) -> bool,
    ) -> Vec<usize> {
        let frames = self.frames_around(center_w, radius);
        frames.filter(|&f| self.has_near_pixel(f, center_w, radius, &is_wanted)).collect()
    }

    /// Returns whether frame `f` has a wanted pixel around the image of the ball. Also `true` if the camera is in the ball, and
    /// if there are many pixels.
    pub(crate) fn has_near_pixel(
        &self,
        f: usize,
        center_w: DVec3,
        radius: f64,
        is_wanted: impl Fn(NearPixel) -> bool,
    ) -> bool {
        /// More pixels are not looked at one by one.
        const MOST_PIXELS: usize = 400;
        let (frame, map) = (&self.sequence.frames[f], &self.labels.maps[f]);
        let (k, center_c) = (&frame.camera.intrinsics, frame.camera.x_wc.inverse_transform_point(center_w));
        let (nearest, farthest) = (center_c.z - radius, center_c.z + radius);
        if nearest <= 0.0 {
            return true;
        }
        let range = |focal: f64, middle: f64, across: f64, size: usize| {
            let at = focal * across / center_c.z + middle;
            // The image of the ball ends nowhere farther out; the rest is for rounding.
            let reach = focal * radius * across.hypot(center_c.z) / (center_c.z * nearest) + 1e-6;
            (at - reach).max(0.0) as usize..((at + reach + 1.0).max(0.0) as usize).min(size)
        };
        let columns = range(k.fx, k.cx, center_c.x, k.width);
        let rows = range(k.fy, k.cy, center_c.y, k.height);
        if columns.len() * rows.len() > MOST_PIXELS {
            return true;
        }
        rows.into_iter().any(|y| {
            columns.clone().any(|x| {
                let (depth, label) = (f64::from(frame.depth[(x, y)]), map[(x, y)]);
                is_wanted(NearPixel { depth, label, nearest, farthest })
            })
        })
    }

    /// Returns the image-plane coordinates of `p_w` in frame `f`; `None` unless the frame measures a surface with this
    /// label there.
    pub(crate) fn image_point(&self, f: usize, p_w: DVec3, label: u16) -> Option<(f64, f64)> {
        let camera = &self.sequence.frames[f].camera;
        let (u, v, z) = camera.project(p_w)?;
        let at = camera.pixel_at(u, v)?;
        (self.sight_at(f, z, at) == Sight::Surface(label)).then_some((u, v))
    }

    /// Returns the depth of `p_w` in frame `f`, metres, and the pixel that it projects to.
    fn pixel(&self, f: usize, p_w: DVec3) -> Option<(f64, (usize, usize))> {
        let camera = &self.sequence.frames[f].camera;
        let (u, v, z) = camera.project(p_w)?;
        Some((z, camera.pixel_at(u, v)?))
    }

    /// Returns the visibility of `p_w` in frame `f`.
    pub(crate) fn sight(&self, f: usize, p_w: DVec3) -> Sight {
        self.pixel(f, p_w).map_or(Sight::Unknown, |(z, at)| self.sight_at(f, z, at))
    }

    /// Returns the visibility of a point at depth `z` (metres) behind pixel `at` of frame `f`.
    fn sight_at(&self, f: usize, z: f64, at: (usize, usize)) -> Sight {
        let depth = f64::from(self.sequence.frames[f].depth[at]);
        let tolerance = depth_tolerance(z);
        if depth.is_nan() || depth <= 0.0 {
            Sight::Unknown
        } else if depth > z + tolerance {
            Sight::Free
        } else if depth < z - tolerance {
            Sight::Hidden
        } else {
            Sight::Surface(self.labels.maps[f][at])
        }
    }

    /// Returns the number of frames that must see through a place to believe them: a single one may be wrong at a depth
    /// edge, but a short recording has no second.
    pub(crate) fn enough_frames(&self) -> usize {
        if self.sequence.len() < 6 { 1 } else { 2 }
    }

    /// Returns the number of frames that see through `p_w`, at most `most`.
    pub(crate) fn free_count(&self, p_w: DVec3, most: usize) -> usize {
        self.free_count_in(self.frames_near(p_w), p_w, most)
    }

    /// Returns [`Self::free_count`] of every point.
    pub(crate) fn free_counts(&self, points_w: &[DVec3], most: usize) -> Vec<usize> {
        ask_frames(
            points_w,
            self,
            |pixel| pixel.may_be_free(),
            |i, frames| self.free_count_in(frames.iter().copied(), points_w[i], most),
        )
    }

    fn free_count_in(&self, frames: impl Iterator<Item = usize>, p_w: DVec3, most: usize) -> usize {
        frames.filter(|&f| self.sight(f, p_w) == Sight::Free).take(most).count()
    }

    /// Returns the label of the pixel that `p_w` projects to in frame `f`, without a depth test.
    pub(crate) fn label_at(&self, f: usize, p_w: DVec3) -> Option<u16> {
        self.pixel(f, p_w).map(|(_, at)| self.labels.maps[f][at])
    }

    /// Counts over all frames how they see `p_w`, for an object with this label.
    pub(crate) fn count(&self, p_w: DVec3, label: u16) -> SightCount {
        self.count_in(self.frames_near(p_w), p_w, label)
    }

    /// Returns [`Self::count`] of every point.
    pub(crate) fn counts(&self, points_w: &[DVec3], label: u16) -> Vec<SightCount> {
        ask_frames(
            points_w,
            self,
            |pixel| pixel.may_be_seen(),
            |i, frames| self.count_in(frames.iter().copied(), points_w[i], label),
        )
    }

    fn count_in(&self, frames: impl Iterator<Item = usize>, p_w: DVec3, label: u16) -> SightCount {
        let mut count = SightCount::default();
        for f in frames {
            match self.sight(f, p_w) {
                Sight::Surface(seen) => {
                    count.own += usize::from(seen == label);
                    count.other += usize::from(seen != label);
                    let eye = self.sequence.frames[f].camera.center_w();
                    count.towards += (eye - p_w).normalize_or_zero();
                }
                Sight::Free => count.free += 1,
                Sight::Hidden | Sight::Unknown => {}
            }
        }
        count
    }

    /// Returns whether most frames with `p_w` in their image see a nearer surface, and none sees a surface with this
    /// label at `p_w`. Surfaces without depth (glass) may be there.
    pub(crate) fn is_inside(&self, p_w: DVec3, label: u16) -> bool {
        let (mut hidden, mut frames) = (0, 0);
        for f in self.frames_near(p_w) {
            let Some((z, at)) = self.pixel(f, p_w) else { continue };
            let frame = &self.sequence.frames[f];
            if !frame.shows_scene(at.1 * frame.depth.width + at.0) {
                continue;
            }
            frames += 1;
            match self.sight_at(f, z, at) {
                Sight::Surface(seen) if seen == label => return false,
                Sight::Hidden => hidden += 1,
                _ => {}
            }
        }
        // A single frame may be wrong at a depth edge.
        2 * hidden > frames && hidden >= self.sequence.len().min(2)
    }

    /// Returns, for every point, the label that most frames have for the surface there; `None` where none
    /// measures one, or more see through the point.
    pub(crate) fn labels_of(&self, points_w: &[DVec3]) -> Vec<Option<u16>> {
        let label_of = |i: usize, frames: &[usize]| {
            let mut votes: Vec<(u16, usize)> = Vec::new();
            let (mut seen, mut free) = (0, 0);
            for &f in frames {
                match self.sight(f, points_w[i]) {
                    Sight::Surface(label) => {
                        seen += 1;
                        match votes.iter_mut().find(|(voted, _)| *voted == label) {
                            Some((_, count)) => *count += 1,
                            None => votes.push((label, 1)),
                        }
                    }
                    Sight::Free => free += 1,
                    Sight::Hidden | Sight::Unknown => {}
                }
            }
            let most = votes.into_iter().max_by_key(|&(label, count)| (count, std::cmp::Reverse(label)))?;
            (free <= seen).then_some(most.0)
        };
        ask_frames(points_w, self, |pixel| pixel.may_be_seen(), label_of)
    }

    /// Returns for every point, with its normal, the median signed distance along the normal to the surface measured at its
    /// pixel, over frames that label the pixel `label` and measure less than a centimetre; `None` with fewer than three.
    pub(crate) fn surface_offsets(
        &self,
        points_w: &[DVec3],
        normals: &[DVec3],
        label: u16,
    ) -> Vec<Option<f64>> {
        ask_frames(
            points_w,
            self,
            |pixel| pixel.label == label && pixel.depth > 0.0,
            |i, frames| self.surface_offset_in(frames, points_w[i], normals[i], label),
        )
    }

    fn surface_offset_in(&self, frames: &[usize], p_w: DVec3, normal: DVec3, label: u16) -> Option<f64> {
        let mut offsets = Vec::new();
        for &f in frames {
            let frame = &self.sequence.frames[f];
            let Some((_, at)) = self.pixel(f, p_w) else { continue };
            let depth = f64::from(frame.depth[at]);
            let towards = (frame.camera.center_w() - p_w).normalize_or_zero();
            // In a grazing view, one pixel causes a large error along the normal.
            if depth <= 0.0 || self.labels.maps[f][at] != label || towards.dot(normal) < 0.35 {
                continue;
            }
            // The measured point belongs to the centre of the pixel. Comparing only along the normal moves it along the
            // tangent plane to the ray of `p_w`.
            let measured = frame.camera.unproject_pixel(at.0, at.1, depth);
            let offset = (measured - p_w).dot(normal);
            if offset.abs() < 0.01 {
                offsets.push(offset);
            }
        }
        (offsets.len() >= 3).then(|| median(offsets))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::over_plate;

    #[test]
    fn what_lies_below_a_surface_is_inside_and_what_has_no_depth_may_be_there() {
        let (sequence, labels) = over_plate(3, 80);
        let views = Views::new(&sequence, &labels);
        let at = |column: f64, z: f64| {
            let p = sequence.frames[0].camera.unproject_pixel(column as usize, 50, 1.0 - z);
            p.with_z(z)
        };
        // On the plate, and 5 cm below it; below the floor beside it; where nothing was measured.
        assert!(!views.is_inside(at(20.0, 0.0), 1) && views.is_inside(at(20.0, -0.05), 1));
        assert!(views.is_inside(at(60.0, -0.05), 1));
        assert!(!views.is_inside(at(90.0, -0.05), 1));
        // Surface of another label is not inside.
        assert!(!views.is_inside(at(60.0, 0.0), 1));
    }
}
