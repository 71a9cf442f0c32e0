//! The covariance of an estimate from the scatter of its pairs.
//!
//! The information of a pair assumes independent measurements. Depth noise in patches, interpolation, shading and shared
//! frames make it too small an error. The gradients of the pairs at the estimate show their true scatter: the variance
//! of Jᵀθ is Σ (Jᵀ A⁻¹ gₚ)(Jᵀ A⁻¹ g_q) over all pairs p and q that share a frame (dyadic cluster-robust variance;
//! Fafchamps and Gubert, "The formation of risk sharing networks", 2007; Aronow, Samii and Assenova, "Cluster-robust
//! variance estimation for dyadic data", 2015), and the given poses add Jᵀ A⁻¹ Q A⁻¹ J for their precision Q.

use crate::floor::PairForm;
use crate::linear::{CAMERA, COMMON, Common, Inverse, Row, Six, System};

/// Variances of functions of an estimate.
pub(crate) struct Covariance<'a> {
    pub(crate) inverse: &'a Inverse<'a>,
    /// The given poses and the priors of the common values alone.
    pub(crate) prior: &'a System,
    pub(crate) pairs: &'a [(usize, usize)],
    /// Number of frames that are part of a pair.
    pub(crate) paired: usize,
    /// The forms of the pairs at the estimate, as in the system.
    pub(crate) forms: &'a [PairForm],
    /// Responses of the estimate to errors of one standard deviation of values that it holds fixed.
    pub(crate) considered: Vec<(Vec<Six>, Common)>,
}

impl Covariance<'_> {
    /// Returns the standard deviation of a linear function of the unknowns; `None` if it cannot be computed.
    pub(crate) fn sigma(&self, of: &Row) -> Option<f64> {
        let frames = self.inverse.frames();
        let (mut right, mut common): (Vec<Six>, Common) = (vec![[0.0; 6]; frames], [0.0; COMMON]);
        of.add_to(&mut right, &mut common, 1.0);
        let (steps, values) = self.inverse.times(&right, &common);
        let scattered = self.scatter(&steps, &values) + self.prior.quadratic(&steps, &values);
        // The scatter of few pairs can be small by chance, but their information is not more than that of independent
        // measurements.
        let informed = of.of(&steps, &values);
        let held: f64 = self.considered.iter().map(|(steps, values)| of.of(steps, values).powi(2)).sum();
        let variance = scattered.max(informed) + held;
        (scattered.is_finite() && informed.is_finite() && variance > 0.0 && held.is_finite())
            .then(|| variance.sqrt())
    }

    /// Returns the standard deviation of a common value.
    pub(crate) fn common_sigma(&self, at: usize) -> Option<f64> {
        let mut common = [0.0; COMMON];
        common[at] = 1.0;
        self.sigma(&Row { frames: Vec::new(), common })
    }

    /// Returns the dyadic cluster-robust sum for a direction in the space of the unknowns.
    fn scatter(&self, steps: &[Six], common: &Common) -> f64 {
        let mut of_frame = vec![0.0; steps.len()];
        let mut squares = 0.0;
        for (&(i, j), form) in self.pairs.iter().zip(self.forms) {
            let along = |a: usize| form.g[a] * (steps[i][a] - steps[j][a]);
            let camera = (0..CAMERA).map(|k| form.camera.g[k] * common[k]).sum::<f64>();
            let u = (0..6).map(along).sum::<f64>() + camera;
            of_frame[i] += u;
            of_frame[j] += u;
            squares += u * u;
        }
        let shared: f64 = of_frame.iter().map(|u| u * u).sum::<f64>() - squares;
        // The estimate fits its pairs, which makes their gradients smaller: as for a residual variance. The sum over pairs
        // that share a frame can be negative by chance; it is then at least that of independent pairs.
        let (pairs, fitted) = (self.pairs.len() as f64, self.paired as f64);
        let free = (pairs - fitted).max(1.0);
        shared.max(squares) * pairs / free
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linear::Block;
    use crate::pair::CameraSums;
    use rand::RngExt;
    use sms_core::Seed;

    #[test]
    fn the_scatter_of_the_pairs_counts_and_not_their_information() {
        // Frames on a ring with chords, known by their differences only.
        let n = 40;
        let pairs: Vec<(usize, usize)> =
            (0..n).flat_map(|i| [1, 2, 3, 5].map(|k| (i.min((i + k) % n), i.max((i + k) % n)))).collect();
        let mut h: Block = [[0.0; 6]; 6];
        (0..6).for_each(|a| h[a][a] = 1e4);
        let held = |system: &mut System| {
            for i in 0..n {
                for a in 0..6 {
                    let own = std::array::from_fn(|b| f64::from(u8::from(a == b)));
                    let row = Row { frames: vec![(i, own)], common: [0.0; COMMON] };
                    system.add_row(&row, 0.0, 1e-2);
                }
            }
            (0..COMMON).for_each(|k| system.add_common(k, 0.0, 1.0));
        };
        let mut first = [0.0; 6];
        first[3] = 1.0;
        let of = Row { frames: vec![(0, first), (n / 2, first.map(|v| -v))], common: [0.0; COMMON] };
        let (mut squares, mut stated) = (0.0, 0.0);
        let runs = 200;
        for run in 0..runs {
            let mut rng = Seed(run).rng();
            let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
            // The information of a pair states a deviation of 0.01; the true one is 0.03.
            let form = |_: &(usize, usize)| {
                let g = [(); 6].map(|()| 1e4 * 0.03 * normal());
                PairForm { h, g, camera: CameraSums::default() }
            };
            let mut forms: Vec<PairForm> = pairs.iter().map(form).collect();
            let mut system = System::new(n);
            held(&mut system);
            pairs.iter().zip(&forms).for_each(|(&(i, j), f)| system.add_pair(i, j, &f.h, &f.g, &f.camera));
            let (steps, common) = system.solve().unwrap();
            let error = of.of(&steps, &common);
            squares += error * error;
            // Gradients at the estimate.
            for (&(i, j), form) in pairs.iter().zip(&mut forms) {
                (0..6).for_each(|a| form.g[a] += 1e4 * (steps[i][a] - steps[j][a]));
            }
            let mut prior = System::new(n);
            held(&mut prior);
            let inverse = system.inverse().unwrap();
            let covariance = Covariance {
                inverse: &inverse,
                prior: &prior,
                pairs: &pairs,
                paired: n,
                forms: &forms,
                considered: Vec::new(),
            };
            stated += covariance.sigma(&of).unwrap().powi(2);
        }
        let ratio = (stated / squares).sqrt();
        assert!((0.85..1.15).contains(&ratio), "{ratio}");
    }
}
