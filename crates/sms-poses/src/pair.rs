//! The quadratic form of one direction of a pair of frames.
//!
//! Depth is compared by least squares: with residuals r, derivatives J and weights w, H = Σ w J Jᵀ and g = Σ w J r.
//!
//! Colour is not. The derivative of a noisy image has noise ν of its own, and Σ w J Jᵀ contains Σ w ν νᵀ: flat surfaces then
//! seem to resist motion, steps are too small, and pairs with noise seem to have information. The derivatives of both images at
//! the same point, J(i) and J(j), have independent noise. Their mean J̄ is the instrument (Wooldridge 2010, section 8.3): the
//! estimating function g = Σ w J̄ r has the derivative S = Σ w ½ (J(i) J(j)ᵀ + J(j) J(i)ᵀ), in which noise has no part on
//! average, and the variance V = Σ w J̄ J̄ᵀ. It is equivalent to the quadratic form with H = S V⁻¹ S and gradient S V⁻¹ g. Without
//! noise, J(i) = J(j), and both forms are the same.

use crate::gram::Gram;
use crate::histogram::ResidualStats;
use crate::linear::{Block, CAMERA, FOCAL, Six};
use crate::residual::{Brightness, Phase};
use glamx::{DMat3, DVec3};
use sms_core::symmetric_eigen;

/// Unknowns besides the poses: the pair's gain and offset, then the values of the cameras ([`CAMERA`]).
const EXTRA: usize = 2 + CAMERA;

/// Contribution of a pair to the values of the cameras, with gain and offset eliminated: the coupling with δ, and the block of
/// these values.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct CameraSums {
    pub(crate) by: [Six; CAMERA],
    pub(crate) h: [[f64; CAMERA]; CAMERA],
    pub(crate) g: [f64; CAMERA],
}

/// Unknowns of a direction: the motion (turn, shift), then the [`EXTRA`].
pub(crate) const UNKNOWNS: usize = 6 + EXTRA;
/// Unknowns on which depth depends, and their places: the motion, and the focal length.
const OF_DEPTH: [usize; 7] = [0, 1, 2, 3, 4, 5, 8 + FOCAL];
type Square = [[f64; UNKNOWNS]; UNKNOWNS];
/// Derivatives of a colour residual with respect to all unknowns.
pub(crate) type ColorRow = [f64; UNKNOWNS];

/// Sums in the axes of camera j.
#[derive(Debug)]
pub(crate) struct Sums {
    /// Of derivatives with respect to the unknowns of [`OF_DEPTH`], and the residual.
    depth: Gram<8>,
    color: ColorSums,
}

/// Sums over colour residuals.
#[derive(Debug)]
struct ColorSums {
    /// Of J̄, and the residual: V, g and the squares.
    mean: Gram<{ UNKNOWNS + 1 }>,
    /// Of half of the difference of both derivatives: V − S. Not needed from afar.
    noise: Option<Gram<UNKNOWNS>>,
}

impl Sums {
    pub(crate) fn new(phase: Phase) -> Self {
        Self { depth: Gram::default(), color: ColorSums::new(phase) }
    }

    /// Adds a residual with its derivatives with respect to the motion and to the focal length.
    pub(crate) fn add_depth(&mut self, jacobian: &Six, by_focal: f64, residual: f64, weight: f64) {
        let (root, [a, b, c, d, e, f]) = (weight.sqrt(), *jacobian);
        self.depth.add(&[a, b, c, d, e, f, by_focal, residual].map(|v| root * v));
    }

    /// Adds a residual with its derivatives by the images of both frames.
    pub(crate) fn add_color(&mut self, by_i: &ColorRow, by_j: &ColorRow, residual: f64, weight: f64) {
        self.color.add(by_i, by_j, residual, weight);
    }

    /// Returns the form of both kinds of residuals in the axes of the world.
    pub(crate) fn in_world(self, r_wj: &DMat3, seen: ResidualStats) -> PairSums {
        let depth = self.depth.sums();
        let ColorForm { h: mut all, g: mut gradient, squares } = self.color.form();
        for (k, &a) in OF_DEPTH.iter().enumerate() {
            gradient[a] += depth[k][7];
            OF_DEPTH.iter().enumerate().for_each(|(l, &b)| all[a][b] += depth[k][l]);
        }
        let rotated = |s: &[f64]| -> Six {
            let (a, b) = (*r_wj * DVec3::new(s[0], s[1], s[2]), *r_wj * DVec3::new(s[3], s[4], s[5]));
            [a.x, a.y, a.z, b.x, b.y, b.z]
        };
        // R H Rᵀ: rows first, then columns.
        let rows: Block = std::array::from_fn(|a| rotated(&all[a]));
        let mut h = [[0.0; 6]; 6];
        for b in 0..6 {
            let column = rotated(&rows.map(|row| row[b]));
            (0..6).for_each(|a| h[a][b] = column[a]);
        }
        PairSums {
            h,
            g: rotated(&gradient),
            by_extra: std::array::from_fn(|k| rotated(&all[6 + k])),
            extra_h: std::array::from_fn(|k| std::array::from_fn(|l| all[6 + k][6 + l])),
            extra_g: std::array::from_fn(|k| gradient[6 + k]),
            cost: 0.5 * (depth[7][7] + squares),
            seen,
        }
    }
}

/// The quadratic form of colour.
#[derive(Debug)]
struct ColorForm {
    h: Square,
    g: ColorRow,
    /// Σ w r².
    squares: f64,
}

impl ColorSums {
    fn new(phase: Phase) -> Self {
        Self { mean: Gram::default(), noise: (phase == Phase::Estimate).then(Gram::default) }
    }

    fn add(&mut self, by_i: &ColorRow, by_j: &ColorRow, residual: f64, weight: f64) {
        let root = weight.sqrt();
        let half = 0.5 * root;
        self.mean.add(&std::array::from_fn(|a| {
            if a < UNKNOWNS { half * (by_i[a] + by_j[a]) } else { root * residual }
        }));
        if let Some(noise) = &mut self.noise {
            noise.add(&std::array::from_fn(|a| half * (by_i[a] - by_j[a])));
        }
    }

    /// Returns S V⁻¹ S and S V⁻¹ g; zero without residuals. From afar, V and g.
    ///
    /// In coordinates in which V is the identity, S is M = I − N with N = V − S. Few residuals scatter M: its eigenvalues are
    /// clipped to 0 and 1, so that no direction has negative information, or more than with least squares.
    fn form(self) -> ColorForm {
        /// Directions with less variance than this share of the largest have none.
        const LEAST: f64 = 1e-6;
        let sums = self.mean.sums();
        let v: Square = std::array::from_fn(|a| std::array::from_fn(|b| sums[a][b]));
        let g: ColorRow = std::array::from_fn(|a| sums[a][UNKNOWNS]);
        let squares = sums[UNKNOWNS][UNKNOWNS];
        let Some(noise) = self.noise else { return ColorForm { h: v, g, squares } };
        let noise = noise.sums();
        // Units differ: the directions are those of the correlations.
        let size: ColorRow = std::array::from_fn(|a| v[a][a].max(0.0).sqrt());
        let scaled = |value: f64, size: f64| if size > 0.0 { value / size } else { 0.0 };
        let correlations =
            std::array::from_fn(|a| std::array::from_fn(|b| scaled(v[a][b], size[a] * size[b])));
        let (values, vectors) = symmetric_eigen::<UNKNOWNS>(correlations, SWEEPS, TOLERANCE);
        let most = values.iter().copied().fold(0.0, f64::max);
        // V = A Aᵀ, and W Aᵀ is the identity in the directions with variance.
        let is_kept = |e: usize| values[e] > LEAST * most;
        let root = |e: usize| if is_kept(e) { values[e].sqrt() } else { 0.0 };
        let inverse_root = |e: usize| if is_kept(e) { values[e].sqrt().recip() } else { 0.0 };
        let forth: Square =
            std::array::from_fn(|a| std::array::from_fn(|e| size[a] * vectors[a][e] * root(e)));
        let back: Square = std::array::from_fn(|e| {
            std::array::from_fn(|a| scaled(vectors[a][e] * inverse_root(e), size[a]))
        });
        let mut m = times(&times(&back, &noise), &transposed(&back)).map(|row| row.map(|value| -value));
        (0..UNKNOWNS).for_each(|e| m[e][e] += f64::from(u8::from(is_kept(e))));
        let (shares, axes) = symmetric_eigen::<UNKNOWNS>(m, SWEEPS, TOLERANCE);
        let shares = shares.map(|share| share.clamp(0.0, 1.0));
        let out = times(&forth, &axes);
        let into = times(&transposed(&axes), &back);
        let product = |row: &ColorRow| row.iter().zip(&g).map(|(w, g)| w * g).sum::<f64>();
        let along: ColorRow = std::array::from_fn(|e| shares[e] * product(&into[e]));
        let h = std::array::from_fn(|a| {
            std::array::from_fn(|b| {
                (0..UNKNOWNS).map(|e| out[a][e] * shares[e] * shares[e] * out[b][e]).sum::<f64>()
            })
        });
        ColorForm { h, g: out.map(|row| row.iter().zip(&along).map(|(w, g)| w * g).sum()), squares }
    }
}

/// Limits of the eigenvalue iteration.
const SWEEPS: usize = 30;
const TOLERANCE: f64 = 1e-24;

fn times(a: &Square, b: &Square) -> Square {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..UNKNOWNS).map(|k| a[i][k] * b[k][j]).sum::<f64>()))
}

fn transposed(a: &Square) -> Square {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

/// The quadratic form of a pair: ½ δᵀ H δ + gᵀ δ with δ = δᵢ − δⱼ about the world's `center`, in world axes.
#[derive(Debug, Clone)]
pub(crate) struct PairSums {
    pub(crate) h: Block,
    pub(crate) g: Six,
    /// Coupling with gain, offset and the values of the cameras, and the block of these.
    by_extra: [Six; EXTRA],
    extra_h: [[f64; EXTRA]; EXTRA],
    extra_g: [f64; EXTRA],
    /// ½ Σ w r².
    pub(crate) cost: f64,
    pub(crate) seen: ResidualStats,
}

impl PairSums {
    /// Adds the prior of gain and offset.
    pub(crate) fn with_prior(mut self, at: Brightness) -> Self {
        let values = [at.gain, at.offset];
        for (k, (value, sigma)) in values.into_iter().zip(Brightness::PRIOR).enumerate() {
            self.extra_h[k][k] += sigma.powi(-2);
            self.extra_g[k] += value * sigma.powi(-2);
        }
        self
    }

    /// Returns the inverse of the block of gain and offset.
    fn brightness_inverse(&self) -> [[f64; 2]; 2] {
        let ([a, b, ..], d) = (self.extra_h[0], self.extra_h[1][1]);
        let det = (a * d - b * b).max(1e-300);
        [[d / det, -b / det], [-b / det, a / det]]
    }

    /// Returns H, g and the terms of the cameras with gain and offset eliminated, so that gain and offset stay optimal for every
    /// correction.
    pub(crate) fn reduced(&self) -> (Block, Six, CameraSums) {
        let inverse = self.brightness_inverse();
        let (mut h, mut g) = (self.h, self.g);
        let mut camera = CameraSums {
            by: std::array::from_fn(|k| self.by_extra[2 + k]),
            h: std::array::from_fn(|k| std::array::from_fn(|l| self.extra_h[2 + k][2 + l])),
            g: std::array::from_fn(|k| self.extra_g[2 + k]),
        };
        for k in 0..2 {
            for l in 0..2 {
                let w = inverse[k][l];
                for a in 0..6 {
                    let left = self.by_extra[k][a] * w;
                    g[a] -= left * self.extra_g[l];
                    for b in 0..6 {
                        h[a][b] -= left * self.by_extra[l][b];
                    }
                }
                for m in 0..CAMERA {
                    let left = self.extra_h[2 + m][k] * w;
                    camera.g[m] -= left * self.extra_g[l];
                    for n in 0..CAMERA {
                        camera.h[m][n] -= left * self.extra_h[l][2 + n];
                    }
                    for a in 0..6 {
                        camera.by[m][a] -= left * self.by_extra[l][a];
                    }
                }
            }
        }
        (h, g, camera)
    }

    /// Returns the optimal gain and offset for a correction δ = δᵢ − δⱼ and a change of the values of the cameras.
    pub(crate) fn brightness_after(
        &self,
        delta: &Six,
        camera: &[f64; CAMERA],
        before: Brightness,
    ) -> Brightness {
        let inverse = self.brightness_inverse();
        let right: [f64; 2] = std::array::from_fn(|k| {
            self.extra_g[k]
                + (0..6).map(|a| self.by_extra[k][a] * delta[a]).sum::<f64>()
                + (0..CAMERA).map(|l| self.extra_h[k][2 + l] * camera[l]).sum::<f64>()
        });
        Brightness {
            gain: before.gain - inverse[0][0] * right[0] - inverse[0][1] * right[1],
            offset: before.offset - inverse[1][0] * right[0] - inverse[1][1] * right[1],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::RngExt;
    use sms_core::Seed;

    proptest! {
        #[test]
        fn sums_in_world_axes_are_those_of_world_jacobians(
            turn in prop::array::uniform3(-2.0..2.0f64), rows in prop::collection::vec(prop::array::uniform6(-1.0..1.0f64), 3)
        ) {
            let r_wj = DMat3::from_quat(glamx::DQuat::from_scaled_axis(DVec3::from_array(turn)));
            let mut sums = Sums::new(Phase::Estimate);
            let (mut h, mut g) = ([[0.0; 6]; 6], [0.0; 6]);
            for (k, row) in rows.iter().enumerate() {
                let (r, w) = (0.3 + k as f64, 1.0 / (1.0 + k as f64));
                sums.add_depth(row, 0.0, r, w);
                let (a, b) = (DVec3::from_slice(row), DVec3::from_slice(&row[3..]));
                let world = [r_wj * a, r_wj * b].map(|v| v.to_array());
                let world = world.as_flattened();
                for a in 0..6 {
                    g[a] += w * r * world[a];
                    for b in 0..6 {
                        h[a][b] += w * world[a] * world[b];
                    }
                }
            }
            let found = sums.in_world(&r_wj, ResidualStats::default());
            for a in 0..6 {
                prop_assert!((found.g[a] - g[a]).abs() < 1e-9);
                for b in 0..6 {
                    prop_assert!((found.h[a][b] - h[a][b]).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn brightness_is_eliminated_exactly() {
        // Residuals r + J δ + C (gain, offset, shift) of twelve measurements.
        let mut sums = Sums::new(Phase::Estimate);
        let pseudo = |k: usize, a: usize| ((k * k * 7 + a * a * 3 + k * a * 5) as f64).sin();
        let rows: [(Six, f64, [f64; EXTRA]); 16] = std::array::from_fn(|k| {
            let extra = [pseudo(k, 9), -1.0, pseudo(k, 11), pseudo(k, 13), pseudo(k, 15)];
            (std::array::from_fn(|a| pseudo(k, a)), 0.1 * k as f64 - 0.3, extra)
        });
        for (j, r, c) in &rows {
            let row: ColorRow = std::array::from_fn(|a| if a < 6 { j[a] } else { c[a - 6] });
            sums.add_color(&row, &row, *r, 1.0);
        }
        let pair = sums.in_world(&DMat3::IDENTITY, ResidualStats::default());
        let (h, g, camera) = pair.reduced();
        // Frame 0 and a frame that a very strong prior holds fixed.
        let mut system = crate::linear::System::new(2);
        system.add_pair(0, 1, &h, &g, &camera);
        for a in 0..6 {
            let row = crate::linear::Row {
                frames: vec![(1, std::array::from_fn(|b| f64::from(u8::from(a == b))))],
                common: [0.0; crate::linear::COMMON],
            };
            system.add_row(&row, 0.0, 1e9);
        }
        (CAMERA..crate::linear::COMMON).for_each(|k| system.add_common(k, 0.0, 1.0));
        let (steps, common) = system.solve().unwrap();
        let step = [common[0], common[1], common[2]];
        let delta: Six = std::array::from_fn(|a| steps[0][a] - steps[1][a]);
        let after = pair.brightness_after(&delta, &step, Brightness::default());
        // At the joint minimum the residual is orthogonal to every column.
        let all = [after.gain, after.offset, step[0], step[1], step[2]];
        let residual = |(j, r, c): &(Six, f64, [f64; EXTRA])| {
            r + (0..6).map(|a| j[a] * delta[a]).sum::<f64>() + (0..EXTRA).map(|k| c[k] * all[k]).sum::<f64>()
        };
        for a in 0..6 {
            let off = rows.iter().map(|row| row.0[a] * residual(row)).sum::<f64>();
            assert!(off.abs() < 1e-6, "{off}");
        }
        for k in 0..EXTRA {
            let off = rows.iter().map(|row| row.2[k] * residual(row)).sum::<f64>();
            assert!(off.abs() < 1e-6, "{off}");
        }
    }

    #[test]
    fn noise_of_derivatives_is_no_information() {
        // Gradients along the first unknown, and noise of the same size along it and the second.
        let mut rng = Seed(7).rng();
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let (count, truth) = (20_000, 1.0);
        let [mut sums, mut least_squares] = [Phase::Estimate, Phase::Approach].map(ColorSums::new);
        for _ in 0..count {
            let texture = normal();
            let mut row = || -> ColorRow {
                let noise = [normal(), normal()];
                std::array::from_fn(|a| match a {
                    0 => texture + noise[0],
                    1 => noise[1],
                    _ => 0.0,
                })
            };
            let (by_i, by_j) = (row(), row());
            let residual = -texture * truth + normal();
            sums.add(&by_i, &by_j, residual, 1.0);
            least_squares.add(&by_i, &by_j, residual, 1.0);
        }
        let ColorForm { h, g, .. } = sums.form();
        let naive_form = least_squares.form();
        // The minimum is at the true motion; least squares would stop at two thirds of it.
        assert!((-g[0] / h[0][0] / truth - 1.0).abs() < 0.05, "{}", -g[0] / h[0][0]);
        let naive = -naive_form.g[0] / naive_form.h[0][0];
        assert!((naive / truth - 2.0 / 3.0).abs() < 0.05, "{naive}");
        // Information: S V⁻¹ S = 1 / 1.5 of that without noise along the texture, and none where there is only noise.
        let n = f64::from(count);
        assert!((h[0][0] / n - 1.0 / 1.5).abs() < 0.05, "{}", h[0][0] / n);
        assert!(h[1][1] / n < 0.01, "{}", h[1][1] / n);
        assert!(naive_form.h[1][1] / n > 0.4);
    }

    proptest! {
        #[test]
        fn information_is_never_negative_nor_more_than_that_of_least_squares(
            count in 1usize..40, seed in 0u64..1000, noise in 0.1..3.0f64
        ) {
            let mut rng = Seed(seed).rng();
            let [mut sums, mut least_squares] = [Phase::Estimate, Phase::Approach].map(ColorSums::new);
            for _ in 0..count {
                let texture: ColorRow = std::array::from_fn(|_| rng.random::<f64>() - 0.5);
                let mut row = || texture.map(|t| t + noise * (rng.random::<f64>() - 0.5));
                let (by_i, by_j) = (row(), row());
                sums.add(&by_i, &by_j, 0.1, 1.0);
                least_squares.add(&by_i, &by_j, 0.1, 1.0);
            }
            let (v, h) = (least_squares.form().h, sums.form().h);
            let most: f64 = (0..UNKNOWNS).map(|a| v[a][a]).sum();
            for _ in 0..50 {
                let x: ColorRow = std::array::from_fn(|_| rng.random::<f64>() - 0.5);
                let of = |m: &Square| -> f64 {
                    (0..UNKNOWNS).map(|a| (0..UNKNOWNS).map(|b| x[a] * m[a][b] * x[b]).sum::<f64>()).sum()
                };
                prop_assert!(of(&h) > -1e-9 * most && of(&h) < of(&v) + 1e-5 * most, "{} {}", of(&h), of(&v));
            }
        }
    }
}
