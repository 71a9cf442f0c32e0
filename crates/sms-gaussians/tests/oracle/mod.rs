//! A scalar double-precision renderer with the whole loss and the gradient of every parameter, written for clarity.
//! Unit tests compare every back end with this oracle, and the oracle with finite differences. It names the crate
//! `sms_gaussians`, so that the tests of another crate can include it by its path.
#![allow(dead_code, unreachable_pub, reason = "each crate that includes it uses its own part")]

mod dual;
mod loss;
mod project;

pub use loss::{CHANNELS, OracleTerms};
use project::{CONIC, DEPTH, MEAN, NORMAL, OPACITY_SHARE, OUTPUTS, Projection, project};
use sms_core::Camera;
use sms_gaussians::harmonics::BASIS;
use sms_gaussians::limits::{ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN};
use sms_gaussians::parameters::{
    AFFINITY, COLOR, HARMONICS, LOG_SCALE, LOGIT_OPACITY, PARAMETERS, POSITION, Parameters,
};
use sms_gaussians::{AFFINITY_DIM, TrainConfig, TrainFrame};

/// Parameters and settings in double precision.
#[derive(Debug, Clone)]
pub struct Oracle {
    /// One row per Gaussian, laid out as in [`sms_gaussians::parameters`].
    pub rows: Vec<[f64; PARAMETERS]>,
    /// Number of classes.
    pub classes: usize,
    /// The classifier, flat as in [`sms_gaussians::parameters::ClassifierState`].
    pub classifier: Vec<f64>,
    /// Colour behind all Gaussians.
    pub background: [f64; 3],
    /// Settings of the step.
    pub config: TrainConfig,
    /// Whether to drop faint alphas, limit strong ones and skip finished pixels, like the back ends; without these
    /// cut-offs the loss is continuous.
    pub cutoffs: bool,
    /// Changes of depth per pixel in place of the Gaussians' own: for finite differences, because the gradient holds
    /// them constant.
    pub depth_slopes: Option<Vec<[f64; 2]>>,
    /// Values of the harmonics in place of the Gaussians' own, for the same reason.
    pub bases: Option<Vec<[f64; BASIS]>>,
}

/// A rendered image.
#[derive(Debug, Clone)]
pub struct OracleImage {
    /// Colour 3, normal 3, affinity 16, depth (not normalised), accumulated opacity; row by row.
    pub pixels: Vec<[f64; CHANNELS]>,
    /// Gaussians that reached a pixel.
    pub seen: Vec<bool>,
}

/// Loss and gradient of a view.
#[derive(Debug, Clone)]
pub struct OracleGradient {
    /// The terms of the loss.
    pub terms: OracleTerms,
    /// ∂(total)/∂rows.
    pub rows: Vec<[f64; PARAMETERS]>,
    /// ∂(total)/∂classifier.
    pub classifier: Vec<f64>,
    /// Gaussians that reached a pixel.
    pub seen: Vec<bool>,
}

/// One splat's part in one pixel.
struct SplatHit {
    gaussian: usize,
    alpha: f64,
    /// Whether alpha still depends on opacity and power.
    free: bool,
    transmittance: f64,
    offset: [f64; 2],
}

/// A Gaussian in the view of a camera.
struct OracleSplat {
    projection: Projection,
    opacity: f64,
    depth_slope: [f64; 2],
    basis: [f64; BASIS],
    /// At the centre.
    features: [f64; CHANNELS],
}

impl OracleSplat {
    /// Returns the blended features at this offset from the centre.
    fn features_at(&self, [dx, dy]: [f64; 2]) -> [f64; CHANNELS] {
        let mut features = self.features;
        features[loss::DEPTH] += self.depth_slope[0] * dx + self.depth_slope[1] * dy;
        features
    }
}

/// Real spherical harmonics of degrees 1 and 2 in the viewing direction, from their definition by associated Legendre functions
/// with the phase (−1)ᵐ: m from −1 to 1, then from −2 to 2.
fn own_basis(row: &[f64; PARAMETERS], camera: &Camera) -> [f64; BASIS] {
    let p_w = glamx::DVec3::from_slice(&row[POSITION..POSITION + 3]);
    let d = (p_w - camera.center_w()).normalize();
    let (cos, sin, azimuth) = (d.z, d.truncate().length(), d.y.atan2(d.x));
    let pi = std::f64::consts::PI;
    let factorial = |n: u32| f64::from((1..=n).product::<u32>());
    let value = |degree: u32, order: i32| {
        let m = order.unsigned_abs();
        let legendre = match (degree, m) {
            (1, 0) => cos,
            (1, 1) => -sin,
            (2, 0) => 1.5 * cos * cos - 0.5,
            (2, 1) => -3.0 * cos * sin,
            _ => 3.0 * sin * sin,
        };
        let norm =
            (f64::from(2 * degree + 1) / (4.0 * pi) * factorial(degree - m) / factorial(degree + m)).sqrt();
        let turn = f64::from(m) * azimuth;
        norm * legendre
            * match order {
                0 => 1.0,
                1.. => 2f64.sqrt() * turn.cos(),
                _ => 2f64.sqrt() * turn.sin(),
            }
    };
    let orders = (-1..=1).map(|m| (1, m)).chain((-2..=2).map(|m| (2, m)));
    let mut basis = [0.0; BASIS];
    basis.iter_mut().zip(orders).for_each(|(to, (degree, order))| *to = value(degree, order));
    basis
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

impl Oracle {
    /// An exact copy of `parameters`, on black.
    pub fn new(parameters: &Parameters, config: &TrainConfig, cutoffs: bool) -> Self {
        Self {
            rows: parameters.rows.iter().map(|r| std::array::from_fn(|k| f64::from(r.0[k]))).collect(),
            classes: parameters.classifier.classes,
            classifier: parameters.classifier.values.iter().map(|v| f64::from(*v)).collect(),
            background: [0.0; 3],
            config: *config,
            cutoffs,
            depth_slopes: None,
            bases: None,
        }
    }

    fn splats(&self, camera: &Camera) -> Vec<Option<OracleSplat>> {
        let splat = |(i, row): (usize, &[f64; PARAMETERS])| {
            let projection = project(row, camera)?;
            let mut features = [0.0; CHANNELS];
            let basis = self.bases.as_ref().map_or_else(|| own_basis(row, camera), |held| held[i]);
            for c in 0..3 {
                let terms = (0..BASIS).map(|k| basis[k] * row[HARMONICS + 3 * k + c]);
                features[loss::COLOR + c] = row[COLOR + c] + terms.sum::<f64>();
            }
            features[loss::DEPTH] = projection.value(DEPTH);
            (0..3).for_each(|k| features[loss::NORMAL + k] = projection.value(NORMAL + k));
            features[loss::AFFINITY..loss::AFFINITY + AFFINITY_DIM]
                .copy_from_slice(&row[AFFINITY..AFFINITY + AFFINITY_DIM]);
            features[loss::OPACITY] = 1.0;
            let depth_slope = self.depth_slopes.as_ref().map_or(projection.depth_slope, |held| held[i]);
            let opacity = sigmoid(row[LOGIT_OPACITY]);
            Some(OracleSplat { projection, opacity, depth_slope, basis, features })
        };
        self.rows.iter().enumerate().map(splat).collect()
    }

    /// Indices of visible splats, nearest first.
    fn order(splats: &[Option<OracleSplat>]) -> Vec<usize> {
        let depth = |i: usize| splats[i].as_ref().map_or(0.0, |s| s.projection.value(DEPTH));
        let mut order: Vec<usize> = (0..splats.len()).filter(|&i| splats[i].is_some()).collect();
        order.sort_by(|&a, &b| depth(a).total_cmp(&depth(b)));
        order
    }

    /// The splats of one pixel, nearest first.
    fn hits(&self, splats: &[Option<OracleSplat>], order: &[usize], (x, y): (usize, usize)) -> Vec<SplatHit> {
        let mut hits = Vec::new();
        let mut transmittance = 1.0;
        for &gaussian in order {
            let Some(splat) = &splats[gaussian] else {
                continue;
            };
            if self.cutoffs && transmittance <= f64::from(TRANSMITTANCE_MIN) {
                break;
            }
            let value = |k: usize| splat.projection.value(k);
            let (dx, dy) = (x as f64 + 0.5 - value(MEAN), y as f64 + 0.5 - value(MEAN + 1));
            let power =
                -0.5 * (value(CONIC) * dx * dx + value(CONIC + 2) * dy * dy) - value(CONIC + 1) * dx * dy;
            let mut alpha = splat.opacity * value(OPACITY_SHARE) * power.exp();
            let mut free = true;
            if self.cutoffs {
                if alpha < f64::from(ALPHA_MIN) {
                    continue;
                }
                if alpha >= f64::from(ALPHA_MAX) {
                    (alpha, free) = (f64::from(ALPHA_MAX), false);
                }
            }
            hits.push(SplatHit { gaussian, alpha, free, transmittance, offset: [dx, dy] });
            transmittance *= 1.0 - alpha;
        }
        hits
    }

    /// Returns the background's contribution to a pixel.
    fn background_share(&self, hits: &[SplatHit]) -> [f64; CHANNELS] {
        let left = hits.last().map_or(1.0, |hit| hit.transmittance * (1.0 - hit.alpha));
        let mut share = [0.0; CHANNELS];
        (0..3).for_each(|c| share[loss::COLOR + c] = left * self.background[c]);
        share
    }

    /// Renders every channel.
    pub fn render(&self, camera: &Camera) -> OracleImage {
        let splats = self.splats(camera);
        let order = Self::order(&splats);
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let mut image =
            OracleImage { pixels: vec![[0.0; CHANNELS]; width * height], seen: vec![false; splats.len()] };
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let hits = self.hits(&splats, &order, (i % width, i / width));
            *pixel = self.background_share(&hits);
            for hit in hits {
                image.seen[hit.gaussian] = true;
                if let Some(splat) = &splats[hit.gaussian] {
                    for (out, f) in pixel.iter_mut().zip(&splat.features_at(hit.offset)) {
                        *out += hit.alpha * hit.transmittance * f;
                    }
                }
            }
        }
        image
    }

    /// Returns the divisor of depth at each pixel, to be held by [`Oracle::terms`] in finite differences.
    pub fn depth_divisors(&self, camera: &Camera) -> Vec<f64> {
        loss::depth_divisors(&self.render(camera).pixels, self.config.depth_term)
    }

    /// The change of depth per pixel of every Gaussian, to be held in finite differences; zero where not in view.
    pub fn own_depth_slopes(&self, camera: &Camera) -> Vec<[f64; 2]> {
        let slope =
            |splat: &Option<OracleSplat>| splat.as_ref().map_or([0.0; 2], |s| s.projection.depth_slope);
        self.splats(camera).iter().map(slope).collect()
    }

    /// The values of the harmonics of every Gaussian, to be held in finite differences.
    pub fn own_bases(&self, camera: &Camera) -> Vec<[f64; BASIS]> {
        self.rows.iter().map(|row| own_basis(row, camera)).collect()
    }

    /// The terms of the loss; `held` replaces the divisor of depth.
    pub fn terms(&self, frame: &TrainFrame, held: Option<&[f64]>) -> OracleTerms {
        let image = self.render(&frame.camera);
        let loss = loss::image_loss(&image.pixels, frame, &self.config, self.classes, &self.classifier, held);
        let mut terms = loss.terms;
        self.regularizers(&image.seen, &mut terms, None);
        terms
    }

    /// The terms and the gradient of their weighted sum.
    pub fn gradient(&self, frame: &TrainFrame) -> OracleGradient {
        let image = self.render(&frame.camera);
        let loss = loss::image_loss(&image.pixels, frame, &self.config, self.classes, &self.classifier, None);
        let splats = self.splats(&frame.camera);
        let order = Self::order(&splats);
        let width = frame.camera.intrinsics.width;
        let mut d_outputs = vec![[0.0; OUTPUTS]; splats.len()];
        let mut d_features = vec![[0.0; CHANNELS]; splats.len()];
        let mut d_logit = vec![0.0; splats.len()];
        for (i, g) in loss.d_image.iter().enumerate() {
            // Radiance behind each splat, channel by channel, from the last to the first.
            let hits = self.hits(&splats, &order, (i % width, i / width));
            let mut behind = self.background_share(&hits);
            for hit in hits.iter().rev() {
                let Some(splat) = &splats[hit.gaussian] else {
                    continue;
                };
                let weight = hit.alpha * hit.transmittance;
                let features = splat.features_at(hit.offset);
                let mut d_alpha = 0.0;
                for c in 0..CHANNELS {
                    let ahead = hit.transmittance * features[c];
                    d_alpha += g[c] * (ahead - behind[c] / (1.0 - hit.alpha));
                    d_features[hit.gaussian][c] += g[c] * weight;
                    behind[c] += weight * features[c];
                }
                let [dx, dy] = hit.offset;
                let d = &mut d_outputs[hit.gaussian];
                let d_depth = g[loss::DEPTH] * weight;
                (0..2).for_each(|k| d[MEAN + k] -= d_depth * splat.depth_slope[k]);
                if !hit.free {
                    continue;
                }
                d_logit[hit.gaussian] += d_alpha * hit.alpha * (1.0 - splat.opacity);
                let d_power = d_alpha * hit.alpha;
                d[OPACITY_SHARE] += d_power / splat.projection.value(OPACITY_SHARE);
                let conic = |k: usize| splat.projection.value(CONIC + k);
                d[MEAN] += d_power * (conic(0) * dx + conic(1) * dy);
                d[MEAN + 1] += d_power * (conic(1) * dx + conic(2) * dy);
                d[CONIC] -= 0.5 * d_power * dx * dx;
                d[CONIC + 1] -= d_power * dx * dy;
                d[CONIC + 2] -= 0.5 * d_power * dy * dy;
            }
        }
        let mut rows = vec![[0.0; PARAMETERS]; splats.len()];
        for (i, splat) in splats.iter().enumerate() {
            let Some(splat) = splat else {
                continue;
            };
            d_outputs[i][DEPTH] += d_features[i][loss::DEPTH];
            (0..3).for_each(|k| d_outputs[i][NORMAL + k] += d_features[i][loss::NORMAL + k]);
            let inputs = splat.projection.gradient(&d_outputs[i]);
            rows[i][..inputs.len()].copy_from_slice(&inputs);
            rows[i][LOGIT_OPACITY] = d_logit[i];
            (0..3).for_each(|k| rows[i][COLOR + k] = d_features[i][loss::COLOR + k]);
            (0..AFFINITY_DIM).for_each(|k| rows[i][AFFINITY + k] = d_features[i][loss::AFFINITY + k]);
            for (j, to) in rows[i][HARMONICS..].iter_mut().enumerate() {
                *to = splat.basis[j / 3] * d_features[i][loss::COLOR + j % 3];
            }
        }
        let mut terms = loss.terms;
        self.regularizers(&image.seen, &mut terms, Some(&mut rows));
        OracleGradient { terms, rows, classifier: loss.d_classifier, seen: image.seen }
    }

    /// Isotropic and flatness terms over the visible Gaussians.
    fn regularizers(
        &self,
        seen: &[bool],
        terms: &mut OracleTerms,
        mut d_rows: Option<&mut Vec<[f64; PARAMETERS]>>,
    ) {
        let w = &self.config.weights;
        let number = seen.iter().filter(|s| **s).count().max(1) as f64;
        for (i, row) in self.rows.iter().enumerate().filter(|(i, _)| seen[*i]) {
            let scale: [f64; 3] = std::array::from_fn(|k| row[LOG_SCALE + k].exp());
            let mut by_size = [0, 1, 2];
            by_size.sort_by(|&a, &b| scale[a].total_cmp(&scale[b]));
            let smallest = by_size[0];
            let taken = if w.flat > 0.0 { &by_size[1..] } else { &by_size[..] };
            let mean = taken.iter().map(|&k| scale[k]).sum::<f64>() / taken.len() as f64;
            let sign = |k: usize| if scale[k] == mean { 0.0 } else { (scale[k] - mean).signum() };
            let mean_sign = taken.iter().map(|&k| sign(k)).sum::<f64>() / taken.len() as f64;
            terms.isotropic += taken.iter().map(|&k| (scale[k] - mean).abs()).sum::<f64>() / number;
            terms.flat += scale[smallest] / number;
            if let Some(d) = &mut d_rows {
                for &k in taken {
                    d[i][LOG_SCALE + k] += f64::from(w.isotropic) / number * (sign(k) - mean_sign) * scale[k];
                }
                d[i][LOG_SCALE + smallest] += f64::from(w.flat) / number * scale[smallest];
            }
        }
    }
}
