//! Fewer elements where the surface is flat and of one colour.
//!
//! Fusion adds elements at the distance that the frames resolve, and closer ones on the edges of every frame, which move with the
//! camera. A wide Gaussian draws a flat patch of one colour as well as many small ones. How far apart elements may lie follows from the
//! distance to the nearest point with another height over their plane, another colour or label, or on the border of the surface; the
//! surface is then sampled anew at these distances (Poisson disks of varying radius).

use super::appearance::Appearance;
use super::config::SeedingConfig;
use super::occupancy::HashGrid;
use glamx::Vec3;
use rand::seq::SliceRandom;
use rayon::prelude::*;
use sms_core::Seed;
use sms_surface::Surfel;
use std::collections::BTreeMap;

/// Distance between elements as a share of that to the nearest difference. The standard deviation of a disc is 0.6 of the distance, so
/// that a difference lies 3.3 of them away. On the scenes 1001 to 1004, 1 costs 0.6 dB, and 0.3 gains 0.1 dB with a third more Gaussians
/// (experiments/studies/scan/fused.md).
const GRADING: f32 = 0.5;
/// Height over distance above which a point does not lie in the plane of an element, in addition to the noise of both: one degree. On the
/// same scenes, 0 and 0.1 give the same as 0.02, as noise allows for more.
const SLOPE: f32 = 0.02;
/// Radius around an element in which the surface is looked for, in multiples of its distance to its neighbours: between elements at this
/// distance there are no holes twice as wide, and those around an element on an edge may be twice as far apart.
const NEIGHBORS: f32 = 4.0;
/// Sectors around an element.
const SECTORS: usize = 12;
/// An element lies on the border of the surface if this many neighbouring sectors (120°) are empty. At a straight border at least five
/// are, at a corner of the surface more.
const EMPTY: usize = 4;
/// An element leaves no more room around closer ones than twice their distance, as elements are added to a surface.
const FINER: f32 = 2.0;

/// An element that remains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SparseElement {
    /// Its position among all elements.
    pub(super) index: usize,
    /// Distance to its neighbours, metres.
    pub(super) spacing_m: f64,
}

/// Returns the elements that remain, in order. Those in `taken` have Gaussians already, at the distance stated there in metres; others are
/// placed around them, and between them where the surface needs closer ones by now.
pub(super) fn thin(
    surfels: &[Surfel],
    seen: &[Appearance],
    taken: &BTreeMap<usize, f32>,
    config: &SeedingConfig,
    seed: Seed,
) -> Vec<SparseElement> {
    let detail = SurfaceDetail::new(surfels, seen, config);
    let borders = detail.map(|i| detail.is_border(i));
    let mut spacings_m = detail.map(|i| detail.spacing_m(i, &borders));
    let mut kept = vec![false; surfels.len()];
    for (&i, &spacing_m) in taken {
        if spacing_m <= FINER * spacings_m[i] {
            (spacings_m[i], kept[i]) = (spacing_m, true);
        }
    }
    // Elements at small distances come first, so that wide ones leave room for them.
    let mut order: Vec<usize> = (0..surfels.len()).collect();
    order.shuffle(&mut seed.rng());
    order.sort_by(|&i, &j| spacings_m[i].total_cmp(&spacings_m[j]));
    for i in order {
        if kept[i] {
            continue;
        }
        kept[i] = detail.all_near(i, spacings_m[i], |j, distance_m| {
            !kept[j] || distance_m >= 0.5 * (spacings_m[i].min(FINER * spacings_m[j]) + spacings_m[j])
        });
    }
    let remaining = (0..surfels.len()).filter(|&i| kept[i]);
    remaining.map(|index| SparseElement { index, spacing_m: f64::from(spacings_m[index]) }).collect()
}

/// An element with its appearance, in single precision.
#[derive(Debug, Clone, Copy)]
struct Element {
    p_w: Vec3,
    n_w: Vec3,
    sigma_m: f32,
    spacing_m: f32,
    seen: Appearance,
}

/// The elements, for questions about their neighbours.
struct SurfaceDetail<'a> {
    config: &'a SeedingConfig,
    elements: Vec<Element>,
    /// Exponent of the radius of the first grid; that of every following one is twice as large.
    first: i32,
    grids: Vec<HashGrid>,
}

impl<'a> SurfaceDetail<'a> {
    fn new(surfels: &[Surfel], seen: &[Appearance], config: &'a SeedingConfig) -> Self {
        let element = |(surfel, seen): (&Surfel, &Appearance)| Element {
            p_w: surfel.p_w.as_vec3(),
            n_w: surfel.n_w.as_vec3(),
            sigma_m: surfel.sigma_m as f32,
            spacing_m: surfel.spacing_m as f32,
            seen: *seen,
        };
        let elements: Vec<Element> = surfels.iter().zip(seen).map(element).collect();
        let first = elements.iter().map(|e| exponent(e.spacing_m)).min().unwrap_or(0);
        let last = elements.iter().map(|e| exponent(config.coarsest / GRADING * e.spacing_m)).max();
        let last = last.unwrap_or(first).max(first);
        let positions_w: Vec<Vec3> = elements.iter().map(|e| e.p_w).collect();
        let grid = |exponent: i32| HashGrid::of((exponent as f32).exp2(), &positions_w);
        let grids = (first..=last).into_par_iter().map(grid).collect();
        Self { config, elements, first, grids }
    }

    /// Returns `f` of every element.
    fn map<T: Send>(&self, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
        (0..self.elements.len()).into_par_iter().with_min_len(256).map(f).collect()
    }

    /// Calls `f` with the elements on the same side of the surface nearer than `radius_m` to element `i`, and their distances, some of
    /// them twice, until it returns false. Returns whether it never did.
    fn all_near(&self, i: usize, radius_m: f32, mut f: impl FnMut(usize, f32) -> bool) -> bool {
        let level = (exponent(radius_m) - self.first).clamp(0, self.grids.len() as i32 - 1);
        let Element { p_w, n_w, .. } = self.elements[i];
        self.grids[level as usize].all_within(p_w, radius_m, |j, squared| {
            j == i || self.elements[j].n_w.dot(n_w) <= 0.0 || f(j, squared.sqrt())
        })
    }

    /// Returns the distance within which differences matter to an element, metres.
    fn reach_m(&self, i: usize) -> f32 {
        self.config.coarsest / GRADING * self.elements[i].spacing_m
    }

    /// Whether element `j`, at this distance from `i`, lies in the plane of `i`.
    fn is_in_plane(&self, i: usize, j: usize, distance_m: f32) -> bool {
        let (a, b) = (&self.elements[i], &self.elements[j]);
        let noise_m = self.config.tolerance_sigmas as f32 * a.sigma_m.hypot(b.sigma_m);
        (b.p_w - a.p_w).dot(a.n_w).abs() <= SLOPE * distance_m + noise_m
    }

    /// Whether an element lies on the border of the surface, or on an edge.
    fn is_border(&self, i: usize) -> bool {
        let a = &self.elements[i];
        let (x, y) = a.n_w.any_orthonormal_pair();
        let mut filled = [false; SECTORS];
        self.all_near(i, NEIGHBORS * a.spacing_m, |j, distance_m| {
            if distance_m > 0.0 && self.is_in_plane(i, j, distance_m) {
                let off = self.elements[j].p_w - a.p_w;
                let turns = off.dot(y).atan2(off.dot(x)) / std::f32::consts::TAU + 0.5;
                filled[((turns * SECTORS as f32) as usize).min(SECTORS - 1)] = true;
            }
            filled.contains(&false)
        });
        (0..SECTORS).any(|first| (0..EMPTY).all(|k| !filled[(first + k) % SECTORS]))
    }

    /// Returns the distance to its neighbours that an element needs, metres: at least its own.
    fn spacing_m(&self, i: usize, borders: &[bool]) -> f32 {
        let a = &self.elements[i];
        if borders[i] {
            return a.spacing_m;
        }
        let mut nearest_m = self.reach_m(i);
        self.all_near(i, nearest_m, |j, distance_m| {
            let b = &self.elements[j].seen;
            let differs = || {
                let step = |c: usize| (a.seen.color[c] - b.color[c]).abs();
                borders[j]
                    || a.seen.label != b.label
                    || (0..3).any(|c| step(c) > self.config.color_step)
                    || !self.is_in_plane(i, j, distance_m)
            };
            if distance_m < nearest_m && differs() {
                nearest_m = distance_m;
            }
            GRADING * nearest_m > a.spacing_m
        });
        a.spacing_m.max(GRADING * nearest_m)
    }
}

/// Returns the exponent of the least power of two that is not smaller than a length.
fn exponent(length_m: f32) -> i32 {
    length_m.clamp(1e-6, 1e6).log2().ceil() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DVec3;
    use rand::RngExt;

    const SPACING_M: f64 = 0.005;
    /// Mean distance between elements, which are never nearer than `SPACING_M`.
    const PITCH_M: f64 = 1.25 * SPACING_M;
    const SIDE: usize = 80;

    /// A square of elements at z = 0 with their colours by `color`, and heights by `height_m`, of x and y.
    fn square(
        color: impl Fn(f64, f64) -> f32,
        height_m: impl Fn(f64, f64) -> f64,
    ) -> (Vec<Surfel>, Vec<Appearance>) {
        let mut rng = Seed(3).rng();
        let mut at = |k: usize| PITCH_M * k as f64 + SPACING_M * rng.random_range(-0.1..0.1);
        let places: Vec<(f64, f64)> = (0..SIDE * SIDE).map(|i| (at(i % SIDE), at(i / SIDE))).collect();
        let surfel = |&(x, y): &(f64, f64)| Surfel {
            p_w: DVec3::new(x, y, height_m(x, y)),
            n_w: DVec3::Z,
            spacing_m: SPACING_M,
            ..Surfel::default()
        };
        let seen = |&(x, y): &(f64, f64)| Appearance { color: [color(x, y); 3], label: 0 };
        (places.iter().map(surfel).collect(), places.iter().map(seen).collect())
    }

    fn thinned(surfels: &[Surfel], seen: &[Appearance]) -> Vec<SparseElement> {
        thin(surfels, seen, &BTreeMap::new(), &SeedingConfig::default(), Seed(1))
    }

    /// Distance from the border of the square, metres.
    fn inside_m(surfel: &Surfel) -> f64 {
        let side = PITCH_M * (SIDE - 1) as f64;
        let p = surfel.p_w;
        p.x.min(p.y).min(side - p.x).min(side - p.y)
    }

    #[test]
    fn a_flat_square_of_one_colour_is_thinned_inside_and_covered_everywhere() {
        let (surfels, seen) = square(|_, _| 0.5, |_, _| 0.0);
        let sparse = thinned(&surfels, &seen);
        assert!(sparse.len() < surfels.len() / 4, "{}", sparse.len());
        let widest = 4.0 * SPACING_M;
        for s in &sparse {
            let inside = inside_m(&surfels[s.index]);
            assert!(s.spacing_m <= widest * 1.001 && s.spacing_m <= SPACING_M + 0.5 * inside.max(0.0));
            if inside > 0.06 {
                assert!((s.spacing_m / widest - 1.0).abs() < 1e-3, "{inside} {s:?}");
            }
        }
        for surfel in &surfels {
            let nearest = sparse.iter().map(|s| {
                let kept = &surfels[s.index];
                (kept.p_w - surfel.p_w).length() / s.spacing_m.max(SPACING_M)
            });
            assert!(nearest.fold(f64::MAX, f64::min) < 1.6);
        }
    }

    #[test]
    fn elements_with_gaussians_remain_and_need_no_others_unless_the_surface_has_finer_detail() {
        let (surfels, seen) = square(|_, _| 0.5, |_, _| 0.0);
        let first = thinned(&surfels, &seen);
        let taken: BTreeMap<usize, f32> = first.iter().map(|e| (e.index, e.spacing_m as f32)).collect();
        let again = |seen: &[Appearance]| thin(&surfels, seen, &taken, &SeedingConfig::default(), Seed(9));
        assert_eq!(again(&seen), first);
        let (_, striped) = square(|x, _| if x > 0.25 { 0.9 } else { 0.1 }, |_, _| 0.0);
        assert!(again(&striped).len() > first.len());
    }

    #[test]
    fn steps_of_colour_or_height_keep_their_elements_unless_they_are_faint() {
        let near = |surfel: &Surfel| (surfel.p_w.x - 0.2).abs() < 0.004;
        let step = |x: f64, high: f64| if x > 0.2 { high } else { 0.0 };
        for (surfels, seen) in
            [square(|x, _| step(x, 0.2) as f32, |_, _| 0.0), square(|_, _| 0.5, |x, _| step(x, 0.003))]
        {
            let sparse = thinned(&surfels, &seen);
            let at_step = sparse.iter().filter(|s| near(&surfels[s.index]));
            assert!(at_step.clone().all(|s| s.spacing_m < 1.01 * SPACING_M));
            let all = surfels.iter().filter(|s| near(s)).count();
            assert!(at_step.count() > all / 2, "of {all}");
        }
        let (surfels, seen) = square(|x, _| step(x, 0.04) as f32, |_, _| 0.0);
        let (plain, gray) = square(|_, _| 0.5, |_, _| 0.0);
        assert_eq!(thinned(&surfels, &seen), thinned(&plain, &gray));
        let fine = SeedingConfig { coarsest: 1.0, ..SeedingConfig::default() };
        assert!(thin(&plain, &gray, &BTreeMap::new(), &fine, Seed(1)).len() > plain.len() / 2);
        assert!(thin(&[], &[], &BTreeMap::new(), &fine, Seed(1)).is_empty());
    }

    #[test]
    fn the_noise_of_measurements_is_no_step_and_the_faces_of_a_wall_are_thinned_apart() {
        let mut rng = Seed(4).rng();
        let noise_m: Vec<f64> = (0..SIDE * SIDE).map(|_| rng.random_range(-0.001..0.001)).collect();
        let (mut surfels, seen) = square(|_, _| 0.5, |_, _| 0.0);
        surfels.iter_mut().zip(&noise_m).for_each(|(s, noise_m)| s.p_w.z += noise_m);
        let rough = thinned(&surfels, &seen).len();
        surfels.iter_mut().for_each(|s| s.sigma_m = 0.0006);
        let noisy = thinned(&surfels, &seen).len();
        assert!(2 * noisy < rough, "{noisy} {rough}");

        let (front, seen) = square(|_, _| 0.5, |_, _| 0.0);
        let alone = thinned(&front, &seen).len();
        let turned = |s: &Surfel| Surfel { p_w: s.p_w - DVec3::Z * 0.002, n_w: -s.n_w, ..*s };
        let wall: Vec<Surfel> = front.iter().copied().chain(front.iter().map(turned)).collect();
        let both = thinned(&wall, &[seen.clone(), seen].concat());
        assert!(both.len().abs_diff(2 * alone) < alone / 5, "{} {alone}", both.len());
    }

    #[test]
    fn gaps_have_rims_and_labels_have_borders() {
        // A strip is missing that is six distances wide; the surfaces beside it lie in one plane.
        let (surfels, seen) = square(|_, _| 0.5, |_, _| 0.0);
        let (left, right) = (0.2, 0.2 + 6.0 * SPACING_M);
        let there = |s: &Surfel| s.p_w.x < left || s.p_w.x > right;
        let (surfels, mut seen): (Vec<_>, Vec<_>) =
            surfels.into_iter().zip(seen).filter(|(s, _)| there(s)).unzip();
        let is_rim = |s: &Surfel| s.p_w.x > left - PITCH_M && s.p_w.x < right + PITCH_M;
        let widest = |sparse: &[SparseElement], of: &dyn Fn(&Surfel) -> bool| {
            let chosen = sparse.iter().filter(|s| of(&surfels[s.index]));
            chosen.map(|s| s.spacing_m).fold(0.0, f64::max)
        };
        assert!(widest(&thinned(&surfels, &seen), &is_rim) < 1.3 * SPACING_M);
        let at_label = |s: &Surfel| (s.p_w.x - 0.1).abs() < PITCH_M && inside_m(s) > 0.09;
        assert!(widest(&thinned(&surfels, &seen), &at_label) > 3.0 * SPACING_M);
        seen.iter_mut().zip(&surfels).for_each(|(seen, s)| seen.label = u16::from(s.p_w.x > 0.1));
        assert!(widest(&thinned(&surfels, &seen), &at_label) < 1.3 * SPACING_M);
    }

    #[test]
    fn no_hole_is_left_where_fine_elements_lie_among_coarse_ones() {
        let (mut surfels, mut seen) = square(|x, y| ((x / 0.003 + y / 0.004) % 2.0) as f32, |_, _| 0.0);
        // Coarse elements where fine ones are missing within twice the distance of these.
        let holes: Vec<DVec3> = (0..9)
            .map(|i| DVec3::new(0.1 + 0.12 * (i % 3) as f64, 0.1 + 0.12 * (i / 3) as f64, 0.0))
            .collect();
        let is_hole = |s: &Surfel| holes.iter().any(|h| (s.p_w - h).length() < 2.05 * SPACING_M);
        (surfels, seen) = surfels.into_iter().zip(seen).filter(|(s, _)| !is_hole(s)).unzip();
        let fine = surfels[0];
        surfels.extend(holes.iter().map(|&p_w| Surfel { p_w, spacing_m: 4.0 * SPACING_M, ..fine }));
        seen.extend(holes.iter().map(|_| Appearance { color: [0.5; 3], label: 0 }));
        let sparse = thinned(&surfels, &seen);
        let first_hole = surfels.len() - holes.len();
        assert_eq!(sparse.iter().filter(|s| s.index >= first_hole).count(), holes.len());
    }
}
