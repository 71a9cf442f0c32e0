//! The noise floor of a pair. Registration errors of two frames have causes that more points do not average out
//! (calibration, interpolation, shading): 10⁵ points are not 10⁵ measurements. Each pair therefore has an unknown small
//! motion f of its own, and its information is (H⁻¹ + Σ_f)⁻¹. The size of f follows from the pairs' disagreement.

use crate::linear::{Block, CAMERA, Six, product};
use crate::pair::CameraSums;
use sms_core::{Cholesky, symmetric_eigen};

/// Standard deviations of the floor motions.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct PairFloor {
    /// Shift, metres. 0 without a floor.
    pub(crate) shift_m: f64,
    /// Distance at which a turn has the same effect, metres: that of the measured points from their centre.
    pub(crate) arm_m: f64,
}

/// The quadratic form of a pair of frames, both directions together.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PairForm {
    pub(crate) h: Block,
    pub(crate) g: Six,
    pub(crate) camera: CameraSums,
}

impl PairForm {
    /// Returns the value for a motion and values of the cameras.
    pub(crate) fn value(&self, x: &Six, camera: &[f64; CAMERA]) -> f64 {
        let hx = product(&self.h, x);
        let mut sum = (0..6).map(|k| x[k] * (0.5 * hx[k] + self.g[k])).sum::<f64>();
        for k in 0..CAMERA {
            sum += camera[k] * (self.camera.g[k] + (0..6).map(|a| self.camera.by[k][a] * x[a]).sum::<f64>());
            sum += 0.5 * camera[k] * (0..CAMERA).map(|l| self.camera.h[k][l] * camera[l]).sum::<f64>();
        }
        sum
    }

    /// Adds the form of the other direction, whose difference has the other sign.
    pub(crate) fn with_reverse(mut self, other: &Self) -> Self {
        for a in 0..6 {
            self.g[a] -= other.g[a];
            (0..6).for_each(|b| self.h[a][b] += other.h[a][b]);
            (0..CAMERA).for_each(|k| self.camera.by[k][a] -= other.camera.by[k][a]);
        }
        for k in 0..CAMERA {
            self.camera.g[k] += other.camera.g[k];
            (0..CAMERA).for_each(|l| self.camera.h[k][l] += other.camera.h[k][l]);
        }
        self
    }
}

impl PairFloor {
    /// Scale of each component of a motion.
    fn scales(&self) -> Six {
        let turn = self.shift_m / self.arm_m.max(1e-9);
        [turn, turn, turn, self.shift_m, self.shift_m, self.shift_m]
    }

    /// Eliminates the pair's own motion from its form.
    pub(crate) fn applied(&self, form: &PairForm) -> PairForm {
        if self.shift_m <= 0.0 {
            return *form;
        }
        let d = self.scales();
        let k: Block = std::array::from_fn(|a| std::array::from_fn(|b| d[a] * form.h[a][b] * d[b]));
        let mut with_one = k;
        (0..6).for_each(|a| with_one[a][a] += 1.0);
        let Some(l) = Cholesky::<6>::new(&with_one, 6) else { return *form };
        // (I + K)⁻¹ of a vector that is scaled by D.
        let damped = |v: &Six| -> Six {
            let mut x = std::array::from_fn(|a| d[a] * v[a]);
            l.solve(&mut x);
            x
        };
        let mut floored = *form;
        for b in 0..6 {
            let mut column: Six = std::array::from_fn(|a| k[a][b]);
            l.solve(&mut column);
            (0..6).for_each(|a| floored.h[a][b] = column[a] / (d[a] * d[b]));
        }
        let unscaled = |x: &Six| -> Six { std::array::from_fn(|a| x[a] / d[a]) };
        let g = damped(&form.g);
        floored.g = unscaled(&g);
        for i in 0..CAMERA {
            let by = damped(&form.camera.by[i]);
            floored.camera.by[i] = unscaled(&by);
            let along = |v: &Six| (0..6).map(|a| d[a] * form.camera.by[i][a] * v[a]).sum::<f64>();
            floored.camera.g[i] -= along(&g);
            for j in 0..CAMERA {
                floored.camera.h[i][j] -= along(&damped(&form.camera.by[j]));
            }
        }
        floored
    }

    /// Eliminates each pair's own motion from its form.
    pub(crate) fn applied_to_all(&self, forms: &[PairForm]) -> Vec<PairForm> {
        forms.iter().map(|form| self.applied(form)).collect()
    }

    /// Returns the floor with which the pairs' gradients at the joint estimate are as large as their information
    /// predicts: χ² equals the number of degrees of freedom, of which `fitted` were used by the estimate.
    pub(crate) fn fitted(forms: &[PairForm], arm_m: f64, fitted: usize) -> Self {
        /// Directions with less information than this share of the most certain one are not determined.
        const LEAST_SHARE: f64 = 1e-6;
        let unit = Self { shift_m: 1.0, arm_m }.scales();
        // Squares of the gradient along each eigenvector, and the eigenvalues, for a floor of one metre.
        let mut parts: Vec<(f64, f64)> = Vec::new();
        for form in forms {
            let k = std::array::from_fn(|a| std::array::from_fn(|b| unit[a] * form.h[a][b] * unit[b]));
            let y: Six = std::array::from_fn(|a| unit[a] * form.g[a]);
            let (values, vectors) = symmetric_eigen::<6>(k, 30, 1e-24);
            let most = values.iter().copied().fold(0.0, f64::max);
            for (e, value) in values.iter().enumerate().filter(|v| *v.1 > LEAST_SHARE * most) {
                let along: f64 = (0..6).map(|a| vectors[a][e] * y[a]).sum();
                parts.push((along * along, *value));
            }
        }
        let free = parts.len() as f64 - fitted as f64;
        let chi2 = |shift_m: f64| -> f64 {
            parts.iter().map(|(g2, l)| g2 / (l * (1.0 + shift_m * shift_m * l))).sum()
        };
        if free <= 0.0 || chi2(0.0) <= free {
            return Self { shift_m: 0.0, arm_m };
        }
        let (mut low, mut high) = (1e-7, 0.1);
        for _ in 0..60 {
            let middle = f64::sqrt(low * high);
            if chi2(middle) > free { low = middle } else { high = middle }
        }
        Self { shift_m: f64::sqrt(low * high), arm_m }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use sms_core::{Seed, StageRng};

    fn form(rng: &mut StageRng, rows: usize, size: f64) -> PairForm {
        let mut form = PairForm { h: [[0.0; 6]; 6], g: [0.0; 6], camera: CameraSums::default() };
        for _ in 0..rows {
            let v: Six = std::array::from_fn(|_| size * (rng.random::<f64>() - 0.5));
            let c: [f64; CAMERA] = std::array::from_fn(|_| size * (rng.random::<f64>() - 0.5));
            let r = rng.random::<f64>() - 0.5;
            for a in 0..6 {
                form.g[a] += v[a] * r;
                (0..6).for_each(|b| form.h[a][b] += v[a] * v[b]);
                (0..CAMERA).for_each(|k| form.camera.by[k][a] += c[k] * v[a]);
            }
            for k in 0..CAMERA {
                form.camera.g[k] += c[k] * r;
                (0..CAMERA).for_each(|l| form.camera.h[k][l] += c[k] * c[l]);
            }
        }
        form
    }

    /// The value of a form at a difference and values of the cameras, minimised over the floor motion.
    fn minimised(form: &PairForm, floor: &PairFloor, delta: &Six, c: &[f64; CAMERA]) -> f64 {
        let d = floor.scales();
        // (H + Σ⁻¹) f = −(H δ + g + B c)
        let mut a = form.h;
        (0..6).for_each(|k| a[k][k] += d[k].powi(-2));
        let hx = product(&form.h, delta);
        let right: Six = std::array::from_fn(|k| {
            hx[k] + form.g[k] + (0..CAMERA).map(|l| form.camera.by[l][k] * c[l]).sum::<f64>()
        });
        let mut f = right.map(|v| -v);
        Cholesky::<6>::new(&a, 6).unwrap().solve(&mut f);
        let x: Six = std::array::from_fn(|k| delta[k] + f[k]);
        form.value(&x, c) + 0.5 * (0..6).map(|k| (f[k] / d[k]).powi(2)).sum::<f64>()
    }

    #[test]
    fn a_floored_form_is_the_minimum_over_the_motion() {
        let mut rng = Seed(5).rng();
        for rows in [4, 12] {
            let form = form(&mut rng, rows, 30.0);
            let floor = PairFloor { shift_m: 0.02, arm_m: 0.7 };
            let floored = floor.applied(&form);
            let zero = minimised(&form, &floor, &[0.0; 6], &[0.0; CAMERA]);
            for _ in 0..20 {
                let delta: Six = std::array::from_fn(|_| 0.1 * (rng.random::<f64>() - 0.5));
                let c: [f64; CAMERA] = std::array::from_fn(|_| 0.3 * (rng.random::<f64>() - 0.5));
                let expected = minimised(&form, &floor, &delta, &c) - zero;
                let found = floored.value(&delta, &c);
                assert!((found - expected).abs() < 1e-8 * (1.0 + expected.abs()), "{found} {expected}");
            }
        }
    }

    #[test]
    fn the_floor_of_drawn_pairs_is_found() {
        let mut rng = Seed(6).rng();
        let truth = PairFloor { shift_m: 4e-4, arm_m: 0.7 };
        let normal = |rng: &mut StageRng| (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let forms: Vec<PairForm> = (0..400)
            .map(|_| {
                let mut pair = form(&mut rng, 30, 4e4);
                // g = H f + noise with covariance H.
                let d = truth.scales();
                let f: Six = std::array::from_fn(|a| d[a] * normal(&mut rng));
                let white: Six = std::array::from_fn(|_| normal(&mut rng));
                let (values, vectors) = symmetric_eigen::<6>(pair.h, 30, 1e-24);
                let measured =
                    |a: usize| (0..6).map(|e| vectors[a][e] * white[e] / values[e].sqrt()).sum::<f64>();
                let moved: Six = std::array::from_fn(|a| f[a] + measured(a));
                pair.g = product(&pair.h, &moved);
                pair
            })
            .collect();
        let found = PairFloor::fitted(&forms, 0.7, 0);
        assert!((found.shift_m / truth.shift_m - 1.0).abs() < 0.1, "{found:?}");
        // Without noise beyond the information, there is no floor.
        let exact: Vec<PairForm> =
            forms.iter().map(|f| PairForm { g: f.g.map(|v| 1e-3 * v), ..*f }).collect();
        assert_eq!(PairFloor::fitted(&exact, 0.7, 0).shift_m, 0.0);
    }
}
