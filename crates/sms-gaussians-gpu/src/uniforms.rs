//! Uniforms of one step in the kernels' layout (`Step` in `shaders/common.wgsl`).

use glamx::Mat3;
use sms_core::Camera;
use sms_gaussians::limits::MARGIN;
use sms_gaussians::{DepthTerm, TrainConfig};

/// Distance between steps in the buffer of uniforms: an offset that every device supports.
pub(crate) const STRIDE: u64 = 256;

/// Flags of [`Step::counts`].
pub(crate) const SEGMENTED: u32 = 1;
const FLATTENING: u32 = 2;
const DEPTH_NORMALIZED: u32 = 4;
const DEPTH_DETACHED: u32 = 8;

/// See `shaders/common.wgsl`, field by field.
#[derive(Debug, Clone, Copy, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(crate) struct Step {
    pub(crate) camera: [[f32; 4]; 3],
    pub(crate) intrinsics: [f32; 4],
    pub(crate) limits: [f32; 4],
    pub(crate) size: [u32; 4],
    pub(crate) counts: [u32; 4],
    pub(crate) groups: [u32; 4],
    pub(crate) pixel_weights: [f32; 4],
    pub(crate) other_weights: [f32; 4],
    pub(crate) background: [f32; 4],
    pub(crate) rates: [f32; 4],
    pub(crate) more_rates: [f32; 4],
    pub(crate) off_plane: [f32; 4],
}

const _: () = assert!(size_of::<Step>() as u64 <= STRIDE);

/// Number of pixels of a view in each term of the loss.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct UsedPixels {
    pub(crate) colored: usize,
    pub(crate) deep: usize,
    pub(crate) oriented: usize,
    pub(crate) labelled: usize,
}

impl Step {
    /// The camera-dependent part.
    pub(crate) fn of_camera(camera: &Camera) -> Self {
        let k = &camera.intrinsics;
        let x_cw = camera.x_wc.inverse();
        // Rows of the rotation from the world to the camera.
        let [r0, r1, r2] = Mat3::from_quat(x_cw.rotation.as_quat()).transpose().to_cols_array_2d();
        let t = x_cw.translation.as_vec3();
        let limits = |c: f64, f: f64, size: f64| {
            [(-(c + MARGIN * size) / f) as f32, ((size - c + MARGIN * size) / f) as f32]
        };
        let [x, y] = [limits(k.cx, k.fx, k.width as f64), limits(k.cy, k.fy, k.height as f64)];
        let (columns, rows) = (k.width.div_ceil(8) as u32, k.height.div_ceil(8) as u32);
        Self {
            camera: [[r0[0], r0[1], r0[2], t.x], [r1[0], r1[1], r1[2], t.y], [r2[0], r2[1], r2[2], t.z]],
            intrinsics: [k.fx as f32, k.fy as f32, k.cx as f32, k.cy as f32],
            limits: [x[0], x[1], y[0], y[1]],
            size: [k.width as u32, k.height as u32, columns, rows],
            groups: [(k.width as u32).div_ceil(16), (k.height as u32).div_ceil(16), 0, 0],
            ..Self::default()
        }
    }

    /// Adds the values of a training step.
    pub(crate) fn trained(mut self, config: &TrainConfig, pixels: &UsedPixels) -> Self {
        let w = &config.weights;
        let share = |weight: f32, count: usize| weight / count.max(1) as f32;
        let sampled = match config.segmentation_share {
            share if share.is_finite() => share.clamp(0.01, 1.0),
            _ => 1.0,
        };
        self.pixel_weights = [
            share(w.color * (1.0 - w.ssim), 3 * pixels.colored),
            share(w.depth, pixels.deep),
            share(w.normal, pixels.oriented),
            share(w.segmentation, pixels.labelled) / sampled,
        ];
        let values = (3 * self.size[0] * self.size[1]).max(1) as f32;
        self.other_weights = [-w.color * w.ssim / values, w.isotropic, w.flat, sampled];
        let r = &config.rates;
        self.rates = [r.position, r.rotation, r.log_scale, r.opacity];
        self.more_rates = [r.color, r.affinity, r.classifier, r.harmonics];
        self.off_plane = [r.off_plane, 0.0, 0.0, 0.0];
        let segmented = w.segmentation > 0.0 && pixels.labelled > 0;
        self.counts[3] = match config.depth_term {
            DepthTerm::Normalized => DEPTH_NORMALIZED,
            DepthTerm::Detached => DEPTH_DETACHED,
            DepthTerm::Accumulated => 0,
        } | if segmented { SEGMENTED } else { 0 }
            | if w.flat > 0.0 { FLATTENING } else { 0 };
        self
    }

    /// Whether the step has a segmentation term.
    pub(crate) fn segmented(&self) -> bool {
        self.counts[3] & SEGMENTED != 0
    }

    /// Tiles of the view.
    pub(crate) fn tiles(&self) -> u32 {
        self.size[2] * self.size[3]
    }

    /// Pixels of the view.
    pub(crate) fn pixels(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }
}
