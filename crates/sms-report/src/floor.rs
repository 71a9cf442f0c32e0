//! An image of the floor, put together from photographs.

use crate::photo::RecordedView;
use glamx::{DPose3, DVec3};
use rayon::prelude::*;
use sms_core::{BACKGROUND, ColorImage, Image};

/// Largest distance from the floor's plane of a point that belongs to it, metres: the band that reconstruction removes
/// from the surroundings as floor (`entities.environment.floor_band`).
const BAND_M: f64 = 0.012;
/// Size of a texel, metres, and the largest number of texels of a side. A pixel of a photograph of 640 pixels covers
/// about 2 mm at a distance of 1 m.
const TEXEL_M: f64 = 0.002;
const LARGEST_SIDE: usize = 1024;
/// Share of the observed floor that may lie beyond the image on each side, so that a few far pixels do not enlarge it.
const CUT: f64 = 0.01;

/// An image of the floor's plane.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FloorImage {
    /// Smallest x and y in the floor's frame, metres.
    pub low: [f64; 2],
    /// Largest x and y.
    pub high: [f64; 2],
    /// Mean colour, also of places that no photograph shows.
    pub mean: [u8; 3],
    /// The image: x to the right, y up.
    pub image: ColorImage,
}

/// Returns the image of the plane z = 0 of `x_wf` from views whose depth and labels show the floor there; `None` if no
/// pixel does. A texel is the mean of its views, weighted by how finely they resolve it.
pub(crate) fn floor_image(views: &[RecordedView], x_wf: &DPose3) -> Option<FloorImage> {
    let points: Vec<DVec3> = views.iter().flat_map(|v| floor_points(v, x_wf)).collect();
    let (low_x, high_x) = range(points.iter().map(|p| p.x).collect())?;
    let (low_y, high_y) = range(points.iter().map(|p| p.y).collect())?;
    let (low, high) = ([low_x, low_y], [high_x, high_y]);
    let longest = (high_x - low_x).max(high_y - low_y);
    let texel = TEXEL_M.max(longest / LARGEST_SIDE as f64);
    let side = |low: f64, high: f64| ((high - low) / texel).ceil().clamp(1.0, LARGEST_SIDE as f64) as usize;
    let (width, height) = (side(low_x, high_x), side(low_y, high_y));
    let texels: Vec<Option<[f64; 3]>> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let p_f = DVec3::new(
                low_x + x * (high_x - low_x) / width as f64,
                high_y - y * (high_y - low_y) / height as f64,
                0.0,
            );
            color_of(views, x_wf, x_wf.transform_point(p_f))
        })
        .collect();
    let seen: Vec<[f64; 3]> = texels.iter().copied().flatten().collect();
    if seen.is_empty() {
        return None;
    }
    let mean = [0, 1, 2].map(|k| seen.iter().map(|c| c[k]).sum::<f64>() / seen.len() as f64);
    let byte = |c: [f64; 3]| c.map(|v| v.round().clamp(0.0, 255.0) as u8);
    let pixels = texels.into_iter().map(|c| byte(c.unwrap_or(mean))).collect();
    Some(FloorImage { low, high, mean: byte(mean), image: Image::from_vec(width, height, pixels) })
}

/// Returns the points of a view that lie on the floor, in its frame.
fn floor_points<'a>(view: &'a RecordedView, x_wf: &'a DPose3) -> impl Iterator<Item = DVec3> + 'a {
    let width = view.depth.width.max(1);
    // Every third pixel in each direction bounds the image as well as all.
    let pixels = (0..view.depth.data.len())
        .filter(move |i| (i % width).is_multiple_of(3) && (i / width).is_multiple_of(3));
    pixels.filter_map(move |i| {
        let z = f64::from(view.depth.data[i]);
        if z <= 0.0 || view.labels.data.get(i) != Some(&BACKGROUND) {
            return None;
        }
        let p_f = x_wf.inverse_transform_point(view.camera.unproject_pixel(i % width, i / width, z));
        (p_f.z.abs() < BAND_M).then_some(p_f)
    })
}

/// Returns the range of values without the outermost ones; `None` if it is empty.
fn range(mut values: Vec<f64>) -> Option<(f64, f64)> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let cut = (CUT * last as f64) as usize;
    let (low, high) = (values[cut], values[last - cut]);
    (high > low).then_some((low, high))
}

/// Returns the mean colour of a floor point in the views that see it.
fn color_of(views: &[RecordedView], x_wf: &DPose3, p_w: DVec3) -> Option<[f64; 3]> {
    let up_w = x_wf.rotation * DVec3::Z;
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for view in views {
        let Some((u, v, z)) = view.camera.project(p_w) else { continue };
        let Some((x, y)) = view.camera.pixel_at(u, v) else { continue };
        let i = y * view.depth.width + x;
        let observed = f64::from(view.depth.data[i]);
        if observed <= 0.0 || view.labels.data.get(i) != Some(&BACKGROUND) {
            continue;
        }
        let p_f = x_wf.inverse_transform_point(view.camera.unproject(u, v, observed));
        if p_f.z.abs() > BAND_M {
            continue;
        }
        // Pixels per area of the floor.
        let cosine = (view.camera.center_w() - p_w).normalize().dot(up_w).max(0.0);
        let weight = cosine / (z * z);
        let size = (view.camera.intrinsics.width as f64, view.camera.intrinsics.height as f64);
        let at = (u / size.0 * view.photo.width as f64, v / size.1 * view.photo.height as f64);
        for (sum, c) in sum.iter_mut().zip(bilinear(&view.photo, at)) {
            *sum += weight * c;
        }
        total += weight;
    }
    (total > 0.0).then(|| sum.map(|s| s / total))
}

/// Interpolates a colour at image-plane coordinates; pixel centres are at halves.
fn bilinear(image: &ColorImage, (u, v): (f64, f64)) -> [f64; 3] {
    let (x, y) = (u - 0.5, v - 0.5);
    let (fx, fy) = (x - x.floor(), y - y.floor());
    let mut color = [0.0; 3];
    for (dx, dy, w) in
        [(0, 0, (1.0 - fx) * (1.0 - fy)), (1, 0, fx * (1.0 - fy)), (0, 1, (1.0 - fx) * fy), (1, 1, fx * fy)]
    {
        let column = (x.floor() as i64 + dx).clamp(0, image.width as i64 - 1) as usize;
        let row = (y.floor() as i64 + dy).clamp(0, image.height as i64 - 1) as usize;
        let pixel = image.data[row * image.width + column];
        for (c, p) in color.iter_mut().zip(pixel) {
            *c += w * f64::from(p);
        }
    }
    color
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::{Camera, Intrinsics};

    /// A view of a floor at z = 0.1 that is red for x < 0 and blue elsewhere, with a labelled object in a corner.
    fn view(eye_w: DVec3, labelled: u16) -> RecordedView {
        let intrinsics = Intrinsics::from_fov(64, 48, 1.0);
        let camera = Camera::look_at(intrinsics, eye_w, DVec3::new(0.0, 0.0, 0.1), DVec3::Y);
        let mut view = RecordedView {
            frame_index: 0,
            held_out: false,
            camera,
            photo: Image::filled(128, 96, [0, 0, 0]),
            depth: Image::filled(64, 48, 0.0),
            labels: Image::filled(64, 48, 0),
        };
        let point = |u: f64, v: f64| {
            let far = camera.unproject(u, v, 1.0) - eye_w;
            let z = (0.1 - eye_w.z) / far.z;
            (z, eye_w + z * far)
        };
        for y in 0..48 {
            for x in 0..64 {
                view.depth.data[y * 64 + x] = point(x as f64 + 0.5, y as f64 + 0.5).0 as f32;
                view.labels.data[y * 64 + x] = if x < 8 && y < 8 { labelled } else { 0 };
            }
        }
        for y in 0..96 {
            for x in 0..128 {
                let p = point((x as f64 + 0.5) / 2.0, (y as f64 + 0.5) / 2.0).1;
                view.photo.data[y * 128 + x] = if p.x < 0.0 { [200, 10, 10] } else { [10, 10, 200] };
            }
        }
        view
    }

    #[test]
    fn the_image_shows_the_floor_where_it_is() {
        let x_wf = DPose3::from_translation(DVec3::Z * 0.1);
        let views = [view(DVec3::new(0.3, -0.2, 1.1), 0), view(DVec3::new(-0.3, 0.2, 0.9), 0)];
        let floor = floor_image(&views, &x_wf).unwrap();
        assert!(floor.low[0] < -0.3 && floor.high[0] > 0.3, "{:?}", (floor.low, floor.high));
        let at = |x: f64, y: f64| {
            let u = (x - floor.low[0]) / (floor.high[0] - floor.low[0]) * floor.image.width as f64;
            let v = (floor.high[1] - y) / (floor.high[1] - floor.low[1]) * floor.image.height as f64;
            floor.image.data[v as usize * floor.image.width + u as usize]
        };
        for y in [-0.2, 0.0, 0.2] {
            assert_eq!((at(-0.05, y), at(0.05, y)), ([200, 10, 10], [10, 10, 200]));
        }
        // A plane that no view sees has no image, nor has one that is covered by objects.
        assert!(floor_image(&views, &DPose3::IDENTITY).is_none());
        let mut covered = view(DVec3::new(0.0, -0.1, 1.0), 3);
        covered.labels = covered.labels.map(|_| 3);
        assert!(floor_image(&[covered], &x_wf).is_none());
    }

    #[test]
    fn objects_leave_no_colour_on_the_floor() {
        let x_wf = DPose3::from_translation(DVec3::Z * 0.1);
        let mut one = view(DVec3::new(0.0, -0.1, 1.0), 5);
        for y in 0..16 {
            for x in 0..16 {
                one.photo.data[y * 128 + x] = [0, 255, 0];
            }
        }
        let floor = floor_image(&[one], &x_wf).unwrap();
        assert!(
            floor.image.data.iter().all(|c| c[1] < 150),
            "the object's colour appears only at its border"
        );
    }
}
