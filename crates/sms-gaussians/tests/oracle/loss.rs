//! The paper's losses of a rendered image and their gradient with respect to image and classifier, in double precision.

use sms_gaussians::limits::{DEPTH_OPACITY_MIN, SSIM_C1, SSIM_C2, SSIM_RADIUS};
use sms_gaussians::{AFFINITY_DIM, DepthTerm, LossWeights, TrainConfig, TrainFrame};

/// Hidden width of the classifier.
const HIDDEN_DIM: usize = 32;

/// Values per pixel: colour 3, normal 3, affinity 16, depth 1, accumulated opacity.
pub const CHANNELS: usize = 24;
pub(super) const COLOR: usize = 0;
pub(super) const NORMAL: usize = 3;
pub(super) const AFFINITY: usize = 6;
pub(super) const DEPTH: usize = 22;
pub(super) const OPACITY: usize = 23;

/// The terms of [`sms_gaussians::LossTerms`] in double precision.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OracleTerms {
    /// Mean absolute colour error.
    pub color_l1: f64,
    /// 1 − SSIM; zero if it has no weight, since it is the slowest term.
    pub dssim: f64,
    /// Isotropic regulariser, metres.
    pub isotropic: f64,
    /// Depth L1, metres.
    pub depth: f64,
    /// Normal L1.
    pub normal: f64,
    /// Mean smallest scale, metres.
    pub flat: f64,
    /// Cross-entropy, nats.
    pub segmentation: f64,
}

impl OracleTerms {
    /// The weighted sum.
    pub fn total(&self, w: &LossWeights) -> f64 {
        let [color, ssim, isotropic, depth, normal, flat, segmentation] =
            [w.color, w.ssim, w.isotropic, w.depth, w.normal, w.flat, w.segmentation].map(f64::from);
        color * ((1.0 - ssim) * self.color_l1 + ssim * self.dssim)
            + isotropic * self.isotropic
            + depth * self.depth
            + normal * self.normal
            + flat * self.flat
            + segmentation * self.segmentation
    }
}

/// The pixel terms of an image with their weighted gradient.
pub(super) struct ImageLoss {
    pub(super) terms: OracleTerms,
    pub(super) d_image: Vec<[f64; CHANNELS]>,
    pub(super) d_classifier: Vec<f64>,
}

fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

/// Returns the divisor of depth at each pixel.
pub(super) fn depth_divisors(image: &[[f64; CHANNELS]], term: DepthTerm) -> Vec<f64> {
    let divisor = |pixel: &[f64; CHANNELS]| match term {
        DepthTerm::Accumulated => 1.0,
        DepthTerm::Detached | DepthTerm::Normalized => pixel[OPACITY].max(DEPTH_OPACITY_MIN),
    };
    image.iter().map(divisor).collect()
}

/// Evaluates the pixel terms. `held` replaces the divisor of depth (for finite differences with the divisor held).
pub(super) fn image_loss(
    image: &[[f64; CHANNELS]],
    frame: &TrainFrame,
    config: &TrainConfig,
    classes: usize,
    classifier: &[f64],
    held: Option<&[f64]>,
) -> ImageLoss {
    let w = &config.weights;
    let mut out = ImageLoss {
        terms: OracleTerms::default(),
        d_image: vec![[0.0; CHANNELS]; image.len()],
        d_classifier: vec![0.0; classifier.len()],
    };
    let divisors = depth_divisors(image, config.depth_term);
    let divisors = held.unwrap_or(&divisors);
    let colored: Vec<bool> = frame.color.iter().map(|c| c.iter().all(|v| v.abs() <= 1e3)).collect();
    let deep = |i: usize| frame.depth[i] > 0.0 && frame.depth[i] <= 1e3;
    let oriented = |i: usize| {
        let length = frame.normal_w[i].iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        (length - 1.0).abs() < 0.5
    };
    let labelled = |i: usize| usize::from(frame.label[i]) < classes;
    let count = |used: &dyn Fn(usize) -> bool| (0..image.len()).filter(|&i| used(i)).count().max(1) as f64;
    let (n_color, n_depth) = (3.0 * count(&|i| colored[i]), count(&deep));
    let (n_normal, n_label) = (count(&oriented), count(&labelled));
    for (i, pixel) in image.iter().enumerate() {
        let d = &mut out.d_image[i];
        for c in 0..3 {
            if colored[i] {
                let error = pixel[COLOR + c] - f64::from(frame.color[i][c]);
                out.terms.color_l1 += error.abs() / n_color;
                d[COLOR + c] += f64::from(w.color * (1.0 - w.ssim)) * sign(error) / n_color;
            }
            if oriented(i) {
                let error = pixel[NORMAL + c] - f64::from(frame.normal_w[i][c]);
                out.terms.normal += error.abs() / n_normal;
                d[NORMAL + c] += f64::from(w.normal) * sign(error) / n_normal;
            }
        }
        if deep(i) {
            let error = pixel[DEPTH] / divisors[i] - f64::from(frame.depth[i]);
            out.terms.depth += error.abs() / n_depth;
            let g = f64::from(w.depth) * sign(error) / n_depth;
            d[DEPTH] += g / divisors[i];
            if config.depth_term == DepthTerm::Normalized && pixel[OPACITY] > DEPTH_OPACITY_MIN {
                d[OPACITY] -= g * pixel[DEPTH] / (divisors[i] * divisors[i]);
            }
        }
        if labelled(i) {
            let scale = f64::from(w.segmentation) / n_label;
            let affinity: [f64; AFFINITY_DIM] = std::array::from_fn(|k| pixel[AFFINITY + k]);
            let label = usize::from(frame.label[i]);
            let (loss, d_affinity) =
                cross_entropy(&affinity, label, classes, classifier, scale, &mut out.d_classifier);
            out.terms.segmentation += loss / n_label;
            (0..AFFINITY_DIM).for_each(|k| d[AFFINITY + k] += d_affinity[k]);
        }
    }
    let ssim_weight = -f64::from(w.color) * f64::from(w.ssim);
    if ssim_weight != 0.0 {
        out.terms.dssim = 1.0 - similarity(image, frame, &colored, ssim_weight, &mut out.d_image);
    }
    out
}

/// Mean SSIM by its definition, with a full two-dimensional window; adds `weight` times its gradient.
fn similarity(
    image: &[[f64; CHANNELS]],
    frame: &TrainFrame,
    colored: &[bool],
    weight: f64,
    d_image: &mut [[f64; CHANNELS]],
) -> f64 {
    let (width, height) = (frame.camera.intrinsics.width, frame.camera.intrinsics.height);
    let radius = SSIM_RADIUS as isize;
    let gauss = |d: isize| (-(d as f64 / 1.5).powi(2) / 2.0).exp();
    let sum: f64 = (-radius..=radius).map(gauss).sum();
    let window = |dx: isize, dy: isize| gauss(dx) * gauss(dy) / (sum * sum);
    let scale = 1.0 / (3 * width * height) as f64;
    let mut mean = 0.0;
    for c in 0..3 {
        let x_of = |i: usize| if colored[i] { image[i][COLOR + c] } else { 0.0 };
        let y_of = |i: usize| if colored[i] { f64::from(frame.color[i][c]) } else { 0.0 };
        for v in 0..height as isize {
            for u in 0..width as isize {
                let mut taps = Vec::new();
                for dy in -radius..=radius {
                    for dx in -radius..=radius {
                        let (x, y) = (u + dx, v + dy);
                        if x >= 0 && y >= 0 && x < width as isize && y < height as isize {
                            taps.push((y as usize * width + x as usize, window(dx, dy)));
                        }
                    }
                }
                let average = |f: &dyn Fn(usize) -> f64| taps.iter().map(|&(i, w)| w * f(i)).sum::<f64>();
                let (ux, uy) = (average(&x_of), average(&y_of));
                let var_x = average(&|i| x_of(i) * x_of(i)) - ux * ux;
                let var_y = average(&|i| y_of(i) * y_of(i)) - uy * uy;
                let cov = average(&|i| x_of(i) * y_of(i)) - ux * uy;
                let (a1, a2) = (2.0 * ux * uy + SSIM_C1, 2.0 * cov + SSIM_C2);
                let (b1, b2) = (ux * ux + uy * uy + SSIM_C1, var_x + var_y + SSIM_C2);
                let s = a1 * a2 / (b1 * b2);
                mean += s * scale;
                for &(i, w) in &taps {
                    if colored[i] {
                        // ∂ux = w, ∂var_x = 2w(x − ux), ∂cov = w(y − uy).
                        let d = 2.0 * uy * w / a1 * s + 2.0 * w * (y_of(i) - uy) / a2 * s
                            - 2.0 * ux * w / b1 * s
                            - 2.0 * w * (x_of(i) - ux) / b2 * s;
                        d_image[i][COLOR + c] += weight * scale * d;
                    }
                }
            }
        }
    }
    mean
}

/// Returns the cross-entropy of one pixel (nats) and `scale` times its gradient with respect to the affinity. Adds the
/// gradient with respect to the classifier.
fn cross_entropy(
    affinity: &[f64; AFFINITY_DIM],
    label: usize,
    classes: usize,
    classifier: &[f64],
    scale: f64,
    d_classifier: &mut [f64],
) -> (f64, [f64; AFFINITY_DIM]) {
    let b1 = HIDDEN_DIM * AFFINITY_DIM;
    let w2 = b1 + HIDDEN_DIM;
    let b2 = w2 + classes * HIDDEN_DIM;
    let hidden: Vec<f64> = (0..HIDDEN_DIM)
        .map(|j| {
            let sum: f64 = (0..AFFINITY_DIM).map(|c| classifier[j * AFFINITY_DIM + c] * affinity[c]).sum();
            (sum + classifier[b1 + j]).max(0.0)
        })
        .collect();
    let logits: Vec<f64> = (0..classes)
        .map(|k| {
            let sum: f64 = (0..HIDDEN_DIM).map(|j| classifier[w2 + k * HIDDEN_DIM + j] * hidden[j]).sum();
            sum + classifier[b2 + k]
        })
        .collect();
    let largest = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = logits.iter().map(|l| (l - largest).exp()).sum();
    let loss = sum.ln() + largest - logits[label];
    let mut d_hidden = [0.0; HIDDEN_DIM];
    for k in 0..classes {
        let probability = (logits[k] - largest).exp() / sum;
        let d = scale * (probability - f64::from(u8::from(k == label)));
        d_classifier[b2 + k] += d;
        for j in 0..HIDDEN_DIM {
            d_classifier[w2 + k * HIDDEN_DIM + j] += d * hidden[j];
            d_hidden[j] += d * classifier[w2 + k * HIDDEN_DIM + j];
        }
    }
    let mut d_affinity = [0.0; AFFINITY_DIM];
    for j in (0..HIDDEN_DIM).filter(|&j| hidden[j] > 0.0) {
        d_classifier[b1 + j] += d_hidden[j];
        for c in 0..AFFINITY_DIM {
            d_classifier[j * AFFINITY_DIM + c] += d_hidden[j] * affinity[c];
            d_affinity[c] += d_hidden[j] * classifier[j * AFFINITY_DIM + c];
        }
    }
    (loss, d_affinity)
}
