//! Candidates drawn on a picture.

use crate::canvas::Canvas;
use crate::{Approach, LandingSite, Sites};
use glamx::{DVec2, DVec3};
use sms_core::{Camera, ColorImage};
use sms_frames::resize_color;

/// Colours of curves, distinguishable by the colour-blind (after Okabe and Ito 2008).
const COLORS: [[u8; 3]; 9] = [
    [230, 159, 0],
    [86, 180, 233],
    [0, 158, 115],
    [240, 228, 66],
    [0, 114, 178],
    [213, 94, 0],
    [204, 121, 167],
    [150, 80, 40],
    [120, 220, 60],
];
const SITE: [u8; 3] = [200, 30, 40];
const CHOSEN: [u8; 3] = [0, 160, 60];
const WHITE: [u8; 3] = [255; 3];
const BLACK: [u8; 3] = [0; 3];
/// Number of corners of a drawn circle.
const CORNERS: usize = 40;
/// Number of pieces of a drawn curve.
const PIECES: usize = 80;
/// Nearest drawn distance from the camera, metres.
const NEAR_M: f64 = 0.05;

/// A picture with marks: their numbers and the pixels of their labels' centres.
#[derive(Debug, Clone, PartialEq)]
pub struct Annotated {
    /// The picture.
    pub image: ColorImage,
    /// Labels within the picture.
    pub labels: Vec<(u32, [f64; 2])>,
}

/// Returns the index of the view with most sites in the picture; of equal ones, the one that looks down most
/// steeply. `None` if no view shows any.
pub fn best_view<'a>(cameras: impl IntoIterator<Item = &'a Camera>, sites: &[LandingSite]) -> Option<usize> {
    let score = |camera: &Camera| -> f64 {
        sites
            .iter()
            .map(|site| {
                let sight = camera.center_w() - site.p_w;
                let steepness = sight.z / sight.length();
                let k = camera.intrinsics;
                let margin = 0.03 * k.width as f64;
                let is_seen = |(u, v, _)| is_in((k.width, k.height), DVec2::new(u, v), margin);
                // Being in the picture counts more than being seen steeply.
                let counts = camera.project(site.p_w).is_some_and(is_seen) && steepness > 0.1;
                if counts { 2.0 + steepness } else { 0.0 }
            })
            .sum()
    };
    let scores = cameras.into_iter().map(score).enumerate().filter(|(_, score)| *score > 0.0);
    scores.reduce(|best, next| if next.1 > best.1 { next } else { best }).map(|best| best.0)
}

/// Resizes the picture to a longer side of `long_side` pixels, with its camera: labels must be legible, and servers
/// refuse large images.
pub fn resized(image: &ColorImage, camera: &Camera, long_side: usize) -> (ColorImage, Camera) {
    let scale = long_side as f64 / image.width.max(image.height).max(1) as f64;
    let to = |n: usize| ((n as f64 * scale).round() as usize).max(1);
    let (width, height) = (to(image.width), to(image.height));
    let camera = Camera::new(camera.intrinsics.scaled_to(width, height), camera.x_wc);
    (resize_color(image, width, height), camera)
}

fn at(camera: &Camera, p_w: DVec3) -> Option<DVec2> {
    camera.project(p_w).filter(|(_, _, z)| *z > NEAR_M).map(|(u, v, _)| DVec2::new(u, v))
}

fn label_height(image: &ColorImage) -> f64 {
    image.width.max(image.height) as f64 / 70.0
}

/// Projects a horizontal circle; `None` if a part of it is behind the camera.
fn circle(camera: &Camera, center_w: DVec3, radius: f64) -> Option<Vec<DVec2>> {
    let corner = |k: usize| {
        let angle = std::f64::consts::TAU * k as f64 / CORNERS as f64;
        at(camera, center_w + radius * DVec2::from_angle(angle).extend(0.0))
    };
    (0..CORNERS).map(corner).collect()
}

/// Draws the sites as numbered circles on the picture of a camera, the site `chosen` in another colour.
pub fn sites_picture(image: &ColorImage, camera: &Camera, sites: &Sites, chosen: Option<u32>) -> Annotated {
    let mut canvas = Canvas { image: image.clone() };
    let height = label_height(image);
    let color = |site: &LandingSite| if chosen == Some(site.id) { CHOSEN } else { SITE };
    for site in &sites.sites {
        let Some(outline) = circle(camera, site.p_w, 0.45 * sites.spacing) else { continue };
        canvas.polygon(&outline, color(site), 0.55);
        let ring: Vec<Option<DVec2>> = outline.iter().chain(&outline[..1]).copied().map(Some).collect();
        canvas.line(&ring, 2.0, WHITE);
    }
    let mut labels = Vec::new();
    for site in &sites.sites {
        let place = at(camera, site.p_w).filter(|c| is_in(image.size(), *c, 0.5 * height));
        let Some(center) = place else { continue };
        canvas.number(site.id, center, height, color(site));
        labels.push((site.id, center.to_array()));
    }
    Annotated { image: canvas.image, labels }
}

fn is_in((width, height): (usize, usize), p: DVec2, margin: f64) -> bool {
    p.min_element() > margin && p.x < width as f64 - margin && p.y < height as f64 - margin
}

/// Draws the approaches as numbered curves of different colours, at the height of the landing point (as in the
/// paper). With `chosen`, only that one has its full colour.
pub fn paths_picture(
    image: &ColorImage,
    camera: &Camera,
    site: &LandingSite,
    approaches: &[Approach],
    chosen: Option<u32>,
) -> Annotated {
    let mut canvas = Canvas { image: image.clone() };
    let height = label_height(image);
    let width = (height / 4.0).max(2.0);
    let lines: Vec<Vec<Option<DVec2>>> = approaches
        .iter()
        .map(|a| {
            let length = a.path.length();
            let point = |k: usize| a.path.point(length * k as f64 / PIECES as f64).0.with_z(site.p_w.z);
            (0..=PIECES).map(|k| at(camera, point(k))).collect()
        })
        .collect();
    let color = |a: &Approach| match chosen {
        Some(id) if id != a.id => [150; 3],
        _ => COLORS[(a.id as usize + COLORS.len() - 1) % COLORS.len()],
    };
    // The chosen one on top.
    let mut order: Vec<usize> = (0..approaches.len()).collect();
    order.sort_by_key(|&i| chosen == Some(approaches[i].id));
    for &i in &order {
        canvas.line(&lines[i], width + 3.0, BLACK);
        canvas.line(&lines[i], width, color(&approaches[i]));
    }
    if let Some(center) = at(camera, site.p_w) {
        canvas.disc(center, 0.7 * height, WHITE);
        canvas.disc(center, 0.5 * height, BLACK);
    }
    let mut labels: Vec<(u32, [f64; 2])> = Vec::new();
    for (a, line) in approaches.iter().zip(&lines) {
        let Some(p) = label_place(image, line, &labels, 1.1 * height) else { continue };
        canvas.disc(p, 1.25 * height, BLACK);
        canvas.disc(p, 1.1 * height, color(a));
        canvas.number(a.id, p, height, BLACK);
        labels.push((a.id, p.to_array()));
    }
    Annotated { image: canvas.image, labels }
}

/// Returns a label's place on its curve: visible, as far from the landing point as the picture reaches, and clear
/// of other labels.
fn label_place(
    image: &ColorImage,
    line: &[Option<DVec2>],
    taken: &[(u32, [f64; 2])],
    radius: f64,
) -> Option<DVec2> {
    let seen: Vec<DVec2> =
        line.iter().flatten().copied().filter(|p| is_in(image.size(), *p, 1.3 * radius)).collect();
    let clearance =
        |p: &DVec2| taken.iter().map(|(_, q)| p.distance((*q).into())).fold(f64::INFINITY, f64::min);
    let clear = seen.iter().find(|p| clearance(p) > 2.4 * radius).copied();
    clear.or_else(|| seen.iter().copied().max_by(|a, b| clearance(a).total_cmp(&clearance(b))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ApproachSettings, approaches};
    use sms_core::Intrinsics;

    fn sites() -> Sites {
        let at =
            |id: u32, x: f64, y: f64| LandingSite { id, p_w: DVec3::new(x, y, 0.7), surface: "box".into() };
        let sites = vec![at(1, 0.0, 0.0), at(2, 0.2, 0.1), at(3, -0.2, 0.1)];
        Sites { sites, platform: "box".into(), center_w: DVec3::Z * 0.7, spacing: 0.1 }
    }

    fn camera(eye: [f64; 3]) -> Camera {
        Camera::look_at(Intrinsics::from_fov(640, 400, 1.1), eye.into(), DVec3::Z * 0.5, DVec3::Z)
    }

    #[test]
    fn labels_are_where_the_sites_project() {
        let view = camera([0.0, -1.2, 1.4]);
        let (image, view) = resized(&ColorImage::filled(640, 400, [90; 3]), &view, 1024);
        assert_eq!((image.width, image.height), (1024, 640));
        let drawn = sites_picture(&image, &view, &sites(), Some(2));
        assert_eq!(drawn.labels.iter().map(|l| l.0).collect::<Vec<_>>(), [1, 2, 3]);
        for (id, [u, v]) in &drawn.labels {
            let (x, y, _) = view.project(sites().sites[*id as usize - 1].p_w).unwrap();
            assert!((x - u).hypot(y - v) < 1e-9);
            // Beside the number, within the circle.
            let pixel = drawn.image[(*u as usize + 16, *v as usize)];
            assert_eq!(pixel[1] > pixel[0], *id == 2, "{pixel:?}");
        }
    }

    #[test]
    fn every_curve_has_a_label_of_its_own() {
        let view = camera([0.3, -1.5, 1.6]);
        let (image, view) = resized(&ColorImage::filled(640, 400, [90; 3]), &view, 1024);
        let site = &sites().sites[0];
        for start in [[2.0, 0.0, 1.05], [0.0, 2.0, 1.05], [-1.4, -1.4, 1.05]] {
            let all = approaches(start.into(), site.p_w, &ApproachSettings::default());
            let drawn = paths_picture(&image, &view, site, &all, None);
            assert_eq!(drawn.labels.len(), 9, "{start:?}");
            for (i, (_, p)) in drawn.labels.iter().enumerate() {
                for (_, q) in &drawn.labels[..i] {
                    assert!((p[0] - q[0]).hypot(p[1] - q[1]) > 20.0, "{start:?}: {p:?} {q:?}");
                }
            }
            assert_ne!(drawn.image, paths_picture(&image, &view, site, &all, Some(3)).image);
        }
    }

    #[test]
    fn the_view_from_above_that_shows_all_is_chosen() {
        let cameras = [
            camera([1.2, 0.0, 0.3]),
            camera([1.2, 0.0, 1.0]),
            camera([0.8, 0.0, 1.6]),
            camera([0.0, 1.2, 1.2]),
        ];
        assert_eq!(best_view(&cameras, &sites().sites), Some(2));
        assert_eq!(best_view(&cameras[..1], &sites().sites), None, "from below nothing is seen");
    }
}
