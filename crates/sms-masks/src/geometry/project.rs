//! Projection of labelled surfels to label maps.

use super::GeometryConfig;
use super::fuse::Surfel;
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{BACKGROUND, Cancel, CoreError, Image, LabelMap};
use sms_frames::{Frame, Sequence};

/// A surfel visible in a frame.
#[derive(Debug, Clone, Copy)]
struct VisibleSurfel {
    pixel: u32,
    label: u16,
    p_c: DVec3,
    n_c: DVec3,
}

/// A surfel under a pixel's ray.
#[derive(Debug, Clone, Copy)]
struct RayCandidate {
    label: u16,
    /// Depth at which the ray meets the surfel's plane.
    z: f64,
    /// Distance in that plane from the surfel, in cells.
    rho: f64,
}

/// Labels every frame: each pixel gets the label of the surfels visible in it.
///
/// The measured depth of the pixel selects these surfels if the cloud agrees with it. Elsewhere (holes, flying pixels)
/// the frontmost surfels count. The vote of a surfel grows the closer the ray meets its plane, so that borders lie
/// between surfels and do not follow cells.
pub(crate) fn label_frames(
    sequence: &Sequence,
    surfels: &[Surfel],
    labels: &[u16],
    config: &GeometryConfig,
    cancel: &Cancel,
) -> Result<Vec<LabelMap>, CoreError> {
    sequence
        .frames
        .par_iter()
        .map(|frame| {
            cancel.check()?;
            Ok(label_frame(frame, surfels, labels, config))
        })
        .collect()
}

fn label_frame(frame: &Frame, surfels: &[Surfel], labels: &[u16], config: &GeometryConfig) -> LabelMap {
    let (w, h) = frame.depth.size();
    let mut map = Image::filled(w, h, BACKGROUND);
    let mut seen = visible(frame, surfels, labels, |label, _| label != BACKGROUND);
    let nearest = seen.iter().map(|s| s.p_c.z).fold(f64::INFINITY, f64::min);
    if !nearest.is_finite() {
        return map;
    }
    // Largest distance between a pixel whose ray meets a surfel's disc and the projected centre, in pixels.
    let k = &frame.camera.intrinsics;
    let reach = ((REACH * config.voxel_m * k.fx.max(k.fy) / nearest).ceil() as usize).clamp(1, 12);
    // All other pixels are background.
    let near = around(&seen, (w, h), reach);
    let wanted = around(&seen, (w, h), 2 * reach);
    seen.extend(visible(frame, surfels, labels, |label, pixel| label == BACKGROUND && wanted[pixel]));
    let (start, seen) = by_pixel(&seen, w * h);
    let mut candidates = Vec::new();
    for (x, y) in (0..w * h).filter(|&i| near[i]).map(|i| (i % w, i / w)) {
        let d = DVec3::new((x as f64 + 0.5 - k.cx) / k.fx, (y as f64 + 0.5 - k.cy) / k.fy, 1.0);
        candidates.clear();
        for j in y.saturating_sub(reach)..(y + reach + 1).min(h) {
            let row = (j * w + x.saturating_sub(reach), j * w + (x + reach).min(w - 1));
            for s in &seen[start[row.0] as usize..start[row.1 + 1] as usize] {
                let rate = s.n_c.dot(d);
                // The surfel faces away from the camera, or is too grazing to determine where the ray meets its plane.
                if rate > -0.05 {
                    continue;
                }
                let z = s.n_c.dot(s.p_c) / rate;
                let rho = (z * d).distance(s.p_c) / config.voxel_m;
                if rho < REACH {
                    candidates.push(RayCandidate { label: s.label, z, rho });
                }
            }
        }
        map[(x, y)] = vote(&candidates, f64::from(frame.depth[(x, y)]));
    }
    map
}

/// Largest distance of a ray from a surfel, in cells.
const REACH: f64 = 1.25;

/// Returns the surfels in front of the camera whose label and pixel are accepted by `keep`.
fn visible(
    frame: &Frame,
    surfels: &[Surfel],
    labels: &[u16],
    keep: impl Fn(u16, usize) -> bool,
) -> Vec<VisibleSurfel> {
    let camera = &frame.camera;
    let x_cw = camera.x_wc.inverse();
    let r_cw = glamx::DMat3::from_quat(x_cw.rotation);
    let k = &camera.intrinsics;
    let mut seen = Vec::new();
    for (s, &label) in surfels.iter().zip(labels) {
        let p_c = r_cw * s.p_w + x_cw.translation;
        if p_c.z < 0.02 {
            continue;
        }
        let Some((x, y)) = camera.pixel_at(k.fx * p_c.x / p_c.z + k.cx, k.fy * p_c.y / p_c.z + k.cy) else {
            continue;
        };
        let pixel = y * k.width + x;
        if keep(label, pixel) {
            let n_c = r_cw * s.n_w;
            // Surfels that face away hide only places that other surfels hide as well.
            if n_c.dot(p_c) < 0.0 {
                seen.push(VisibleSurfel { pixel: pixel as u32, label, p_c, n_c });
            }
        }
    }
    seen
}

/// Sorts the surfels by pixel. Also returns the position of each pixel's first surfel (counting sort; equal pixels keep
/// their order).
fn by_pixel(seen: &[VisibleSurfel], pixels: usize) -> (Vec<u32>, Vec<VisibleSurfel>) {
    let mut start = vec![0u32; pixels + 1];
    seen.iter().for_each(|s| start[s.pixel as usize + 1] += 1);
    for i in 1..start.len() {
        start[i] += start[i - 1];
    }
    let mut next = start.clone();
    let mut sorted = seen.to_vec();
    for s in seen {
        let slot = &mut next[s.pixel as usize];
        sorted[*slot as usize] = *s;
        *slot += 1;
    }
    (start, sorted)
}

/// Marks the pixels within `reach` pixels of a surfel.
fn around(seen: &[VisibleSurfel], (w, h): (usize, usize), reach: usize) -> Vec<bool> {
    let mut holds = vec![false; w * h];
    seen.iter().for_each(|s| holds[s.pixel as usize] = true);
    let mut near = vec![false; w * h];
    for i in (0..w * h).filter(|&i| holds[i]) {
        let (x, y) = (i % w, i / w);
        for j in y.saturating_sub(reach)..(y + reach + 1).min(h) {
            near[j * w + x.saturating_sub(reach)..j * w + (x + reach + 1).min(w)].fill(true);
        }
    }
    near
}

/// Returns the winning label of the candidates at one pixel.
fn vote(candidates: &[RayCandidate], measured: f64) -> u16 {
    let sigma = |z: f64| 0.0015 + 0.0025 * z * z;
    let supports = |c: &RayCandidate, z: f64| (c.z - z).abs() < 3.0 * sigma(z);
    let surface = if measured > 0.0 && candidates.iter().any(|c| c.rho < 1.2 && supports(c, measured)) {
        measured
    } else {
        candidates.iter().filter(|c| c.rho < 0.8).map(|c| c.z).fold(f64::INFINITY, f64::min)
    };
    if !surface.is_finite() {
        return BACKGROUND;
    }
    let mut sums: Vec<(u16, f64)> = Vec::new();
    for c in candidates.iter().filter(|c| supports(c, surface)) {
        let off = (c.z - surface) / sigma(surface);
        let weight = (-2.0 * c.rho * c.rho - 0.5 * off * off).exp();
        match sums.iter_mut().find(|s| s.0 == c.label) {
            Some(sum) => sum.1 += weight,
            None => sums.push((c.label, weight)),
        }
    }
    sums.iter().fold((BACKGROUND, 0.0), |best, s| if s.1 > best.1 { *s } else { best }).0
}
