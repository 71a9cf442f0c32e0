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
use crate::harmonics::CONSTANT;
use crate::{AFFINITY_DIM, RenderedMaps, Seedling};
use glamx::{DMat3, DQuat, DVec3, Vec3};
use rand::seq::SliceRandom;
use rayon::prelude::*;
use sms_core::{LabelMap, Seed, StageRng, standard_normal};
use sms_frames::Frame;
use sms_surface::{MeasuredPoint, SeedPixel, SurfaceConfig, Surfel, measured_point};

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
            std::array::from_fn(|_| CODE_SIGMA * standard_normal(&mut rng) as f32)
        };
        Self((0..classes).map(code).collect())
    }

    /// Returns the number of labels.
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns an affinity of a label.
    pub(crate) fn draw(&self, label: u16, rng: &mut StageRng) -> [f32; AFFINITY_DIM] {
        let code = self.0.get(usize::from(label)).copied().unwrap_or_default();
        code.map(|c| c + AFFINITY_SIGMA * standard_normal(rng) as f32)
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
    let surface = config.surface();
    let mut rng = seed.derive("order").rng();
    let candidates = candidates(frame, rendered, config, &surface);
    let radius = |point: &MeasuredPoint| point.spacing_m.max(config.seeding.radius_m) as f32;
    let widest = candidates.par_iter().map(|(_, point)| radius(point)).reduce(|| 0.0, f32::max);
    let order = || {
        let (mut edges, mut others): (Vec<_>, Vec<_>) =
            candidates.into_par_iter().partition(|(_, point)| point.is_edge);
        edges.shuffle(&mut rng);
        others.shuffle(&mut rng);
        edges.append(&mut others);
        edges
    };
    let (existing, tries) = rayon::join(|| HashGrid::of(widest, positions_w), order);
    let is_free: Vec<bool> =
        tries.par_iter().map(|(_, point)| !existing.any_within(point.p_w.as_vec3(), radius(point))).collect();

    let mut taken = HashGrid::new(widest);
    let mut affinity_rng = seed.derive("affinity").rng();
    let mut seedlings = Vec::new();
    for ((i, point), _) in tries.into_iter().zip(is_free).filter(|(_, is_free)| *is_free) {
        if seedlings.len() == room {
            break;
        }
        let position_w = point.p_w.as_vec3();
        if taken.any_within(position_w, radius(&point)) {
            continue;
        }
        taken.insert(position_w);
        let affinity = codes.draw(labels.data[i], &mut affinity_rng);
        let color = frame.color.data[i].map(|c| f32::from(c) / 255.0);
        let element = point.surfel(frame, &surface, SeedPixel::default());
        seedlings.push(disc(&element, element.spacing_m, color, affinity, config));
    }
    seedlings
}

/// Returns the pixels, in row order, with depth and a normal, and without a steep slant, that the Gaussians do not
/// explain.
fn candidates(
    frame: &Frame,
    rendered: Option<&RenderedMaps>,
    config: &ScanConfig,
    surface: &SurfaceConfig,
) -> Vec<(usize, MeasuredPoint)> {
    let unexplained = |i: usize, depth: f32| {
        rendered.is_none_or(|maps| {
            let behind =
                f64::from(maps.depth[i] - depth) > config.tolerance_m(&frame.depth_noise, f64::from(depth));
            maps.alpha[i] < config.seeding.alpha_below || behind
        })
    };
    let depths = frame.depth.data.par_iter().enumerate();
    depths
        .filter(|&(i, &depth)| depth > 0.0 && unexplained(i, depth))
        .filter_map(|(i, _)| Some((i, measured_point(frame, i, surface)?)))
        .filter(|(_, point)| point.cosine >= surface.min_cosine)
        .collect()
}

/// Returns the Gaussian of an element of the surface whose neighbours lie at `spacing_m` metres. However wide it is, it is as thick as
/// one at the element's own distance.
pub(crate) fn disc(
    surfel: &Surfel,
    spacing_m: f64,
    color: [f32; 3],
    affinity: [f32; AFFINITY_DIM],
    config: &ScanConfig,
) -> Seedling {
    let (settings, normal) = (&config.seeding, surfel.n_w);
    // First axis: the direction in which the surface recedes, along which pixels lie farther apart.
    let receding = surfel.to_camera_w - normal * normal.dot(surfel.to_camera_w);
    let first = if receding.length() > 1e-3 { receding.normalize() } else { normal.any_orthonormal_vector() };
    let sigma = settings.sigma_of_spacing * spacing_m;
    let thickness = settings.thickness * settings.sigma_of_spacing * surfel.spacing_m;
    let stretched = settings.sigma_of_spacing * surfel.pitch_m;
    Seedling {
        position_w: surfel.p_w.as_vec3(),
        rotation_wg: DQuat::from_mat3(&DMat3::from_cols(first, normal.cross(first), normal)).as_quat(),
        scale: DVec3::new(sigma.max(stretched), sigma, thickness).as_vec3(),
        opacity: settings.opacity,
        color,
        harmonics: CONSTANT,
        affinity,
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
