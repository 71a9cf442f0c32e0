//! The picture of a question: the view that shows most of the object, with its box in red.

use sms_core::{ColorImage, DepthImage, Image};
use sms_frames::resize_color;
use std::path::Path;

/// Least visible area of an object.
const MIN_AREA_PX: usize = 30;
/// Distance of the box from the object, so that it hides nothing of it (released code: 5).
const BOX_GAP_PX: f64 = 5.0;
const BOX_WIDTH_PX: i64 = 3;
/// Smaller crops are enlarged: models recognize little in tiny images.
const MIN_SIDE_PX: f64 = 448.0;
const JPEG_QUALITY: u8 = 92;

/// A box in pixels; the ends are exclusive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelBounds {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Column after the last.
    pub x1: usize,
    /// Row after the last.
    pub y1: usize,
}

/// Visibility of an object in one view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectViewScore {
    /// Number of pixels of the object off the image's border.
    pub area_px: usize,
    /// Share of its outline cut by the image's border.
    pub border_share: f64,
    /// Share of its outline beside a nearer surface.
    pub occluded_share: f64,
    /// The box around it.
    pub bounds: PixelBounds,
}

impl ObjectViewScore {
    /// Returns the score: the number of pixels, reduced for hidden parts. Half of the outline hidden counts as a
    /// quarter of the area, and touching the border at all halves the score.
    pub fn score(&self) -> f64 {
        let touches = if self.border_share > 0.0 { 0.5 } else { 1.0 };
        let seen = (1.0 - self.border_share) * (1.0 - self.occluded_share);
        self.area_px as f64 * touches * seen * seen
    }
}

/// Scores an object's mask in one view; `depth` is the view's depth in metres (0 where unknown). Returns `None` if
/// too little is visible.
pub fn score_view(mask: &Image<bool>, depth: Option<&DepthImage>) -> Option<ObjectViewScore> {
    let (width, height) = mask.size();
    let depth = depth.filter(|d| d.size() == mask.size());
    let margin = (width.max(height) / 64).max(2);
    let mut bounds: Option<PixelBounds> = None;
    let (mut all, mut area_px, mut outline, mut cut, mut occluded) = (0, 0, 0usize, 0usize, 0usize);
    for y in 0..height {
        for x in 0..width {
            if !mask[(x, y)] {
                continue;
            }
            all += 1;
            let inside = x >= margin && y >= margin && x + margin < width && y + margin < height;
            area_px += usize::from(inside);
            let b = bounds.get_or_insert(PixelBounds { x0: x, y0: y, x1: x + 1, y1: y + 1 });
            (b.x0, b.x1, b.y1) = (b.x0.min(x), b.x1.max(x + 1), y + 1);
            let (xi, yi) = (x as i64, y as i64);
            let around = [(xi - 1, yi), (xi + 1, yi), (xi, yi - 1), (xi, yi + 1)];
            if around.iter().all(|&(u, v)| mask.get(u, v) == Some(&true)) {
                continue;
            }
            outline += 1;
            if around.iter().any(|&(u, v)| mask.get(u, v).is_none()) {
                cut += 1;
            } else if let Some(depth) = depth {
                let own = depth[(x, y)];
                let is_nearer = |z: f32| z > 0.0 && own > 0.0 && z < own - 0.02_f32.max(0.02 * own);
                let hidden = around.iter().any(|&(u, v)| {
                    mask.get(u, v) == Some(&false) && depth.get(u, v).is_some_and(|&z| is_nearer(z))
                });
                occluded += usize::from(hidden);
            }
        }
    }
    let bounds = bounds.filter(|_| all >= MIN_AREA_PX)?;
    let share = |n: usize| n as f64 / outline.max(1) as f64;
    Some(ObjectViewScore { area_px, border_share: share(cut), occluded_share: share(occluded), bounds })
}

/// Returns the index and score of the best view; the first of equal ones.
pub fn best_view(
    views: impl IntoIterator<Item = Option<ObjectViewScore>>,
) -> Option<(usize, ObjectViewScore)> {
    let seen = views.into_iter().enumerate().filter_map(|(index, view)| Some((index, view?)));
    seen.reduce(|best, next| if next.1.score() > best.1.score() { next } else { best })
}

/// Reads the picture in a file, if it has the proportions of `like` (within 2 %): the recording's own image shows
/// more than the scan's frame made of it. Lens correction between the two moves things by a few pixels, which fit
/// into the box's gap.
pub fn picture(path: &Path, like: (usize, usize)) -> Option<ColorImage> {
    let read = sms_core::read_color(path).ok()?;
    let (width, height) = read.size();
    let (ours, other) = (width as f64 / height.max(1) as f64, like.0 as f64 / like.1.max(1) as f64);
    if (ours / other - 1.0).abs() > 0.02 || width < like.0 {
        return None;
    }
    Some(read)
}

/// Returns the object with `context` sizes of its box around it, at most `max_side` pixels long, its box in red.
/// `bounds` may refer to the same view in another size, `size_of_bounds`.
pub fn annotated(
    color: &ColorImage,
    bounds: PixelBounds,
    size_of_bounds: (usize, usize),
    context: f64,
    max_side: usize,
) -> ColorImage {
    let (width, height) = (color.width as f64, color.height as f64);
    let (sx, sy) = (width / size_of_bounds.0.max(1) as f64, height / size_of_bounds.1.max(1) as f64);
    let (x0, x1) = (bounds.x0 as f64 * sx, (bounds.x1 as f64 * sx).min(width));
    let (y0, y1) = (bounds.y0 as f64 * sy, (bounds.y1 as f64 * sy).min(height));
    let room = context.max(0.0) * (x1 - x0).max(y1 - y0) + 2.0 * BOX_GAP_PX;
    let left = (x0 - room).floor().clamp(0.0, width - 1.0);
    let top = (y0 - room).floor().clamp(0.0, height - 1.0);
    let right = (x1 + room).ceil().clamp(left + 1.0, width);
    let bottom = (y1 + room).ceil().clamp(top + 1.0, height);
    let (w, h) = (right - left, bottom - top);
    let long = w.max(h);
    let max_side = max_side.max(16) as f64;
    let scale =
        if long > max_side { max_side / long } else { (MIN_SIDE_PX.min(max_side) / long).clamp(1.0, 4.0) };
    let part = color.cropped((left as usize, top as usize), (right as usize, bottom as usize));
    let to = |side: f64| ((side * scale).round() as usize).max(1);
    let mut out = resize_color(&part, to(w), to(h));
    let at = |v: f64, origin: f64| (v - origin) * scale;
    draw_box(
        &mut out,
        [
            at(x0, left) - BOX_GAP_PX,
            at(y0, top) - BOX_GAP_PX,
            at(x1, left) + BOX_GAP_PX,
            at(y1, top) + BOX_GAP_PX,
        ],
    );
    out
}

/// Draws a red frame with inner edge `[x0, y0, x1, y1]`, moved inside the image.
fn draw_box(image: &mut ColorImage, [x0, y0, x1, y1]: [f64; 4]) {
    let low = |v: f64| (v.floor() as i64 - BOX_WIDTH_PX).max(0) as usize;
    let high = |v: f64| (v.ceil() as i64 + BOX_WIDTH_PX).max(0) as usize;
    image.draw_box((low(x0), low(y0)), (high(x1), high(y1)), BOX_WIDTH_PX as usize, [255, 0, 0]);
}

/// Encodes the image as JPEG; the same image gives the same bytes.
pub fn jpeg(image: &ColorImage) -> Vec<u8> {
    sms_core::jpeg_bytes(image, JPEG_QUALITY)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(width: usize, height: usize, inside: impl Fn(usize, usize) -> bool) -> Image<bool> {
        Image::from_vec(width, height, (0..width * height).map(|i| inside(i % width, i / width)).collect())
    }

    #[test]
    fn the_box_and_the_outline_are_those_of_the_mask() {
        let m = mask(100, 80, |x, y| (20..40).contains(&x) && (30..60).contains(&y));
        let score = score_view(&m, None).unwrap();
        assert_eq!(score.bounds, PixelBounds { x0: 20, y0: 30, x1: 40, y1: 60 });
        assert_eq!((score.area_px, score.border_share, score.occluded_share), (600, 0.0, 0.0));
        assert_eq!(score.score(), 600.0);
        assert_eq!(score_view(&mask(100, 80, |x, y| x == 5 && y < 20), None), None, "too little");
        assert_eq!(score_view(&mask(100, 80, |_, _| false), None), None);
    }

    #[test]
    fn a_whole_view_beats_a_larger_one_that_is_cut_or_hidden() {
        let whole = mask(100, 100, |x, y| (30..60).contains(&x) && (30..60).contains(&y));
        let cut = mask(100, 100, |x, y| x < 36 && (30..66).contains(&y));
        let larger = mask(100, 100, |x, y| (20..56).contains(&x) && (20..56).contains(&y));
        // An occluder in front of the left half of the larger one's surroundings.
        let depth = DepthImage::from_vec(
            100,
            100,
            (0..10_000).map(|i| if larger.data[i] || i % 100 >= 40 { 1.0 } else { 0.5 }).collect(),
        );
        let view = |m: &Image<bool>, d: Option<&DepthImage>| score_view(m, d);
        let hidden = view(&larger, Some(&depth)).unwrap();
        assert!(hidden.occluded_share > 0.3, "{hidden:?}");
        assert!(view(&cut, None).unwrap().border_share > 0.2);
        let best =
            best_view([view(&cut, None), None, view(&whole, Some(&depth)), view(&larger, Some(&depth))]);
        assert_eq!(best.unwrap().0, 2);
        assert_eq!(best_view([view(&whole, None), view(&larger, None)]).unwrap().0, 1, "else the larger one");
        assert_eq!(best_view([view(&whole, None), view(&whole, None)]).unwrap().0, 0);
        let farther = depth.map(|&z| if z < 1.0 { 2.0 } else { z });
        assert_eq!(
            view(&larger, Some(&farther)).unwrap().occluded_share,
            0.0,
            "what lies behind hides nothing"
        );
    }

    #[test]
    fn the_red_frame_surrounds_the_object_at_every_size() {
        for (size, max_side) in [((100, 80), 1024), ((1000, 800), 256), ((100, 80), 64)] {
            let color = ColorImage::filled(size.0, size.1, [40, 80, 120]);
            let bounds = PixelBounds { x0: 40, y0: 30, x1: 60, y1: 50 };
            let image = annotated(&color, bounds, (100, 80), 1.0, max_side);
            assert!(image.width <= max_side && image.height <= max_side, "{:?}", image.size());
            let is_red = |p: &[u8; 3]| p[0] > 200 && p[1] < 60 && p[2] < 60;
            let red: Vec<(usize, usize)> = (0..image.data.len())
                .filter(|&i| is_red(&image.data[i]))
                .map(|i| (i % image.width, i / image.width))
                .collect();
            assert!(!red.is_empty());
            let (cx, cy) = (image.width / 2, image.height / 2);
            assert!(!is_red(&image[(cx, cy)]), "the object itself is not painted over");
            assert!(red.iter().any(|p| p.0 < cx) && red.iter().any(|p| p.0 > cx));
            assert!(red.iter().any(|p| p.1 < cy) && red.iter().any(|p| p.1 > cy));
        }
    }

    #[test]
    fn the_recordings_own_picture_is_used_where_it_is_the_same_view() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("000.png");
        sms_core::write_png_color(&path, &ColorImage::filled(640, 400, [1, 2, 3])).unwrap();
        assert_eq!(picture(&path, (320, 200)).unwrap().size(), (640, 400));
        assert_eq!(picture(&path, (320, 240)), None, "another shape is another view");
        assert_eq!(picture(&path, (1280, 800)), None, "it shows less");
        assert_eq!(picture(&dir.path().join("gone.png"), (320, 200)), None);
        std::fs::write(&path, b"no picture").unwrap();
        assert_eq!(picture(&path, (320, 200)), None);
    }

    #[test]
    fn boxes_at_the_edge_and_whole_images_stay_inside() {
        let color = ColorImage::filled(50, 40, [9; 3]);
        for bounds in [
            PixelBounds { x0: 0, y0: 0, x1: 50, y1: 40 },
            PixelBounds { x0: 49, y0: 39, x1: 50, y1: 40 },
            PixelBounds { x0: 0, y0: 0, x1: 1, y1: 1 },
        ] {
            for context in [0.0, 1.0, 100.0] {
                let image = annotated(&color, bounds, (50, 40), context, 1024);
                assert!(image.data.contains(&[255, 0, 0]));
                let bytes = jpeg(&image);
                assert_eq!(bytes[..2], [0xFF, 0xD8]);
                assert_eq!(bytes, jpeg(&image), "the same bytes, for the cache");
            }
        }
    }
}
