//! Seeding of new Gaussians: discs on the measured surface (paper, Section "Scan").
//!
//! A good start saves many steps. The position of a disc comes from depth averaged over neighbours on the same surface,
//! the normal from the normals of the depth image, the size from the footprint of a pixel, and the colour from the
//! pixel. Affinities start random (as in the paper), but around a random centre for each label. A hidden Gaussian,
//! which the segmentation loss never reaches, then keeps the label of its pixel (on the ball of the tests, this raises
//! the share of correct labels from two thirds to all but the rim). Pixels are tried in random order, pixels on edges
//! first, and used if no Gaussian is within the spacing.

use super::config::ScanConfig;
use super::occupancy::HashGrid;
use crate::{AFFINITY_DIM, RenderedMaps, Seedling};
use glamx::{DMat3, DQuat, DVec3, Quat, Vec3};
use rand::RngExt;
use rayon::prelude::*;
use sms_core::{Camera, LabelMap, Seed, StageRng};
use sms_frames::Frame;

/// Standard deviation of the components of a label's common affinity.
const CODE_SIGMA: f32 = 0.5;
/// Standard deviation around the common affinity.
const AFFINITY_SIGMA: f32 = 0.1;

/// The initial affinity of each label: the same for all frames of a scan.
pub(crate) struct AffinityCodes(Vec<[f32; AFFINITY_DIM]>);

impl AffinityCodes {
    /// For `classes` labels, the background included.
    pub(crate) fn new(classes: usize, seed: Seed) -> Self {
        let code = |label| {
            let mut rng = seed.derive_index("affinity code", label as u64).rng();
            std::array::from_fn(|_| CODE_SIGMA * normal_draw(&mut rng))
        };
        Self((0..classes).map(code).collect())
    }

    fn draw(&self, label: u16, rng: &mut StageRng) -> [f32; AFFINITY_DIM] {
        let code = self.0.get(usize::from(label)).copied().unwrap_or_default();
        code.map(|c| c + AFFINITY_SIGMA * normal_draw(rng))
    }
}

/// Seeds the pixels of `frame` that `rendered` (the current rendering; `None` for the first frame) does not explain.
/// `positions_w` are the centres of the existing Gaussians. Returns at most `room` new ones.
pub(crate) fn seed_frame(
    frame: &Frame,
    (labels, codes): (&LabelMap, &AffinityCodes),
    rendered: Option<&RenderedMaps>,
    positions_w: &[Vec3],
    room: usize,
    config: &ScanConfig,
    seed: Seed,
) -> Vec<Seedling> {
    let settings = &config.seeding;
    let k = frame.camera.intrinsics;
    let mut rng = seed.derive("order").rng();
    let candidates = candidates(frame, rendered, config);
    let spacing = |i: usize, edge: bool| {
        let px = settings.spacing_px * if edge { settings.edge_spacing } else { 1.0 };
        px * k.pixel_footprint(f64::from(frame.depth.data[i]))
    };
    let radius = |spacing_m: f64| spacing_m.max(settings.radius_m) as f32;
    let widest = candidates
        .par_iter()
        .map(|&i| radius(spacing(i, true).max(spacing(i, false))))
        .reduce(|| 0.0, f32::max);
    let order = || {
        let (mut edges, mut others): (Vec<usize>, Vec<usize>) =
            candidates.into_par_iter().partition(|&i| is_edge(frame, i, config));
        shuffle(&mut edges, &mut rng);
        shuffle(&mut others, &mut rng);
        let edges = edges.into_iter().map(|i| (i, spacing(i, true)));
        edges.chain(others.into_iter().map(|i| (i, spacing(i, false)))).collect::<Vec<(usize, f64)>>()
    };
    let (existing, tries) = rayon::join(|| HashGrid::of(widest, positions_w), order);
    let surfaces: Vec<Option<SeedSurface>> = tries
        .par_iter()
        .map(|&(i, spacing_m)| {
            let surface = surface_at(frame, i, config);
            (!existing.any_within(surface.point_w.as_vec3(), radius(spacing_m))).then_some(surface)
        })
        .collect();

    let mut taken = HashGrid::new(widest);
    let mut affinity_rng = seed.derive("affinity").rng();
    let mut seedlings = Vec::new();
    for ((i, spacing_m), surface) in tries.into_iter().zip(surfaces) {
        if seedlings.len() == room {
            break;
        }
        let Some(surface) = surface else { continue };
        let position_w = surface.point_w.as_vec3();
        if taken.any_within(position_w, radius(spacing_m)) {
            continue;
        }
        taken.insert(position_w);
        let pitch = k.pixel_footprint(surface.z);
        let affinity = codes.draw(labels.data[i], &mut affinity_rng);
        seedlings.push(disc(frame, i, &surface, spacing_m, pitch, affinity, config));
    }
    seedlings
}

/// Returns the pixels, in row order, with depth and a normal, and without a steep slant, that the Gaussians do not
/// explain.
fn candidates(frame: &Frame, rendered: Option<&RenderedMaps>, config: &ScanConfig) -> Vec<usize> {
    let unexplained = |i: usize, depth: f32| {
        rendered.is_none_or(|maps| {
            let behind =
                f64::from(maps.depth[i] - depth) > config.tolerance_m(&frame.depth_noise, f64::from(depth));
            maps.alpha[i] < config.seeding.alpha_below || behind
        })
    };
    let seen = |i: usize| {
        let normal_c = DVec3::from_array(frame.normal_c.data[i].map(f64::from));
        let cosine = -normal_c.dot(ray_c(&frame.camera, i).normalize());
        normal_c.length_squared() > 0.5 && cosine >= config.seeding.min_cosine
    };
    let depths = frame.depth.data.par_iter().enumerate();
    depths.filter(|&(i, &depth)| depth > 0.0 && unexplained(i, depth) && seen(i)).map(|(i, _)| i).collect()
}

/// Returns the ray through pixel `i` in the camera frame, with z = 1.
fn ray_c(camera: &Camera, i: usize) -> DVec3 {
    let k = &camera.intrinsics;
    let (x, y) = ((i % k.width) as f64 + 0.5, (i / k.width) as f64 + 0.5);
    DVec3::new((x - k.cx) / k.fx, (y - k.cy) / k.fy, 1.0)
}

/// Whether brightness changes fast at pixel `i` (Sobel), or depth jumps beside it.
fn is_edge(frame: &Frame, i: usize, config: &ScanConfig) -> bool {
    let (width, height) = frame.color.size();
    let (x, y) = ((i % width) as i64, (i / width) as i64);
    let luma = |dx: i64, dy: i64| {
        let (x, y) = ((x + dx).clamp(0, width as i64 - 1), (y + dy).clamp(0, height as i64 - 1));
        let [r, g, b] = frame.color[(x as usize, y as usize)].map(f32::from);
        (0.299 * r + 0.587 * g + 0.114 * b) / 255.0
    };
    let gx = luma(1, -1) + 2.0 * luma(1, 0) + luma(1, 1) - luma(-1, -1) - 2.0 * luma(-1, 0) - luma(-1, 1);
    let gy = luma(-1, 1) + 2.0 * luma(0, 1) + luma(1, 1) - luma(-1, -1) - 2.0 * luma(0, -1) - luma(1, -1);
    if gx.hypot(gy) / 8.0 > config.seeding.edge_threshold {
        return true;
    }
    let z = frame.depth.data[i];
    let jump = config.tolerance_m(&frame.depth_noise, f64::from(z)) as f32;
    [(1, 0), (-1, 0), (0, 1), (0, -1)]
        .into_iter()
        .filter_map(|(dx, dy)| frame.depth.get(x + dx, y + dy))
        .any(|&other| other > 0.0 && (other - z).abs() > jump)
}

/// The measured surface at a pixel.
struct SeedSurface {
    point_w: DVec3,
    normal_w: DVec3,
    /// Depth, metres.
    z: f64,
    /// Cosine between the normal and the direction to the camera.
    cosine: f64,
}

/// Returns the surface at pixel `i`. Its point is moved along the ray onto the mean of the 3 × 3 neighbours within the
/// noise of the tangent plane. A wider window would cut into curved surfaces: on a ball of 30 mm radius seen at 2 mm
/// per pixel, 3 × 3 lies 0.1 mm too deep and 5 × 5 0.3 mm.
fn surface_at(frame: &Frame, i: usize, config: &ScanConfig) -> SeedSurface {
    let (width, z) = (frame.depth.width, f64::from(frame.depth.data[i]));
    let normal_c = DVec3::from_array(frame.normal_c.data[i].map(f64::from)).normalize();
    let ray = ray_c(&frame.camera, i);
    let slope = -normal_c.dot(ray);
    let gate = config.seeding.tolerance_sigmas * frame.depth_noise.sigma_m(z) * slope.max(0.1);
    let (mut sum, mut count) = (0.0, 0.0);
    for dy in -1..=1i64 {
        for dx in -1..=1i64 {
            let (x, y) = ((i % width) as i64 + dx, (i / width) as i64 + dy);
            let Some(&neighbor) = frame.depth.get(x, y) else { continue };
            let neighbor_ray = ray_c(&frame.camera, (y as usize) * width + x as usize);
            let offset = normal_c.dot(neighbor_ray * f64::from(neighbor) - ray * z);
            if neighbor > 0.0 && offset.abs() <= gate {
                sum += offset;
                count += 1.0;
            }
        }
    }
    // Moving by δ along the ray changes n·p by −δ·slope; the centre pixel always counts.
    let depth = z - sum / f64::max(count, 1.0) / slope.max(0.1);
    SeedSurface {
        point_w: frame.camera.x_wc.transform_point(ray * depth),
        normal_w: frame.camera.x_wc.rotation * normal_c,
        z: depth,
        cosine: slope / ray.length(),
    }
}

fn disc(
    frame: &Frame,
    i: usize,
    surface: &SeedSurface,
    spacing_m: f64,
    pitch_m: f64,
    affinity: [f32; AFFINITY_DIM],
    config: &ScanConfig,
) -> Seedling {
    let settings = &config.seeding;
    let normal = surface.normal_w;
    let to_camera = (frame.camera.center_w() - surface.point_w).normalize();
    // First axis: the direction in which the surface recedes, along which pixels lie farther apart.
    let receding = to_camera - normal * normal.dot(to_camera);
    let first = if receding.length() > 1e-3 { receding.normalize() } else { normal.any_orthonormal_vector() };
    let rotation_wg: Quat = DQuat::from_mat3(&DMat3::from_cols(first, normal.cross(first), normal)).as_quat();
    let sigma = settings.sigma_of_spacing * spacing_m;
    let stretched = settings.sigma_of_spacing * pitch_m / surface.cosine.max(settings.min_cosine);
    let scale = DVec3::new(sigma.max(stretched), sigma, settings.thickness * sigma);
    Seedling {
        position_w: surface.point_w.as_vec3(),
        rotation_wg,
        scale: scale.as_vec3(),
        opacity: settings.opacity,
        color: frame.color.data[i].map(|c| f32::from(c) / 255.0),
        affinity,
    }
}

/// A draw from the standard normal distribution (Box and Muller 1958).
fn normal_draw(rng: &mut StageRng) -> f32 {
    let (u, v): (f32, f32) = (rng.random(), rng.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f32::consts::TAU * v).cos()
}

/// Fisher-Yates.
pub(crate) fn shuffle<T>(values: &mut [T], rng: &mut StageRng) {
    for i in (1..values.len()).rev() {
        values.swap(i, rng.random_range(0..=i));
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::{BALL, BOX, Recorded, SMALL, record, signed_distance_m};
    use super::*;

    fn seeds(
        frame: &Frame,
        rendered: Option<&RenderedMaps>,
        existing: &[Vec3],
        room: usize,
    ) -> Vec<Seedling> {
        let codes = AffinityCodes::new(3, Seed(1));
        let labels = record(Recorded { noise_m: 0.0, ..SMALL }).1;
        seed_frame(
            frame,
            (&labels.maps[0], &codes),
            rendered,
            existing,
            room,
            &ScanConfig::default(),
            Seed(2),
        )
    }

    fn first_frame() -> Frame {
        let mut frame = record(Recorded { noise_m: 0.0, ..SMALL }).0.frames.swap_remove(0);
        for y in 0..100 {
            frame.depth.data[y * 160..y * 160 + 40].fill(0.0);
        }
        frame
    }

    #[test]
    fn seeds_are_discs_on_the_measured_surface_spaced_and_none_without_depth() {
        let frame = first_frame();
        let seedlings = seeds(&frame, None, &[], usize::MAX);
        assert!(seedlings.len() > 1000, "{}", seedlings.len());
        let spacing = 0.5 * 2.5 * frame.camera.intrinsics.pixel_footprint(0.4);
        let mut sum = 0.0;
        for (i, s) in seedlings.iter().enumerate() {
            let distance = [0, BALL, BOX].map(|l| signed_distance_m(l, s.position_w).abs());
            let distance = distance.into_iter().fold(f64::MAX, f64::min);
            sum += distance;
            // Averaging over neighbours rounds the edges of the box.
            assert!(distance < 2.5e-3, "{s:?}");
            let (u, v, _) = frame.camera.project(s.position_w.as_dvec3()).unwrap();
            assert!(frame.depth[frame.camera.pixel_at(u, v).unwrap()] > 0.0);
            let apart = seedlings[..i].iter().map(|o| (o.position_w - s.position_w).length());
            assert!(apart.fold(f32::MAX, f32::min) > spacing as f32);
            assert!(s.scale.z < 0.2 * s.scale.y && s.scale.y <= s.scale.x && s.opacity == 0.5);
        }
        assert!(sum / (seedlings.len() as f64) < 1e-4, "{sum}");
        let floor = seedlings.iter().filter(|s| s.position_w.x.hypot(s.position_w.y) > 0.13);
        let tilted = floor.filter(|s| (s.rotation_wg * Vec3::Z).dot(Vec3::Z) < 0.999).count();
        assert_eq!(tilted, 0, "normals of the floor point up");
        assert_eq!(seeds(&frame, None, &[], 17).len(), 17);
        let existing: Vec<Vec3> = seedlings.iter().map(|s| s.position_w).collect();
        assert!(seeds(&frame, None, &existing, usize::MAX).len() < seedlings.len() / 10);
    }

    #[test]
    fn only_unexplained_pixels_are_seeded() {
        let frame = first_frame();
        let n = frame.depth.data.len();
        let mut maps = RenderedMaps {
            width: 160,
            height: 100,
            color: vec![[0.0; 3]; n],
            alpha: vec![1.0; n],
            depth: frame.depth.data.clone(),
            normal_w: vec![[0.0; 3]; n],
            label: vec![0; n],
        };
        assert!(seeds(&frame, Some(&maps), &[], usize::MAX).is_empty());
        maps.depth.iter_mut().for_each(|z| *z += 0.004);
        assert!(seeds(&frame, Some(&maps), &[], usize::MAX).is_empty(), "within the tolerance");
        maps.depth[50 * 160 + 120] += 0.003;
        assert_eq!(seeds(&frame, Some(&maps), &[], usize::MAX).len(), 1, "behind by 7 mm");
        maps.depth.iter_mut().for_each(|z| *z -= 0.1);
        assert!(seeds(&frame, Some(&maps), &[], usize::MAX).is_empty(), "in front: pruned, not seeded");
        maps.alpha.fill(0.5);
        assert!(seeds(&frame, Some(&maps), &[], usize::MAX).len() > 1000);
    }
}
