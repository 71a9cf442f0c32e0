//! An observed view on the device: eight words per pixel, invalid values marked as on the CPU.

use crate::gpu::Gpu;
use crate::uniforms::{Step, UsedPixels};
use rayon::prelude::*;
use sms_gaussians::TrainFrame;

/// Greatest valid depth, metres.
const DEPTH_MAX: f32 = 1e3;
/// Greatest valid colour.
const COLOR_MAX: f32 = 1e3;
/// Flag in the word of the label for valid colour.
const COLORED: u32 = 0x1_0000;
/// The label of a pixel without one.
const UNLABELLED: u32 = 0xffff;

/// A view to train on.
pub(crate) struct DeviceTarget {
    /// The camera-dependent part of the uniforms.
    pub(crate) camera: Step,
    pub(crate) pixels: UsedPixels,
    /// Colour 3, depth, normal 3, label with [`COLORED`]; row by row.
    pub(crate) words: wgpu::Buffer,
}

/// Returns the words of a frame. Pixels with a colour, depth or normal that is not finite are excluded from that
/// term, and labels not below `classes` from the segmentation.
pub(crate) fn words_of(frame: &TrainFrame, classes: usize) -> (Vec<[u32; 8]>, UsedPixels) {
    let pixels = frame.color.par_iter().zip(&frame.depth).zip(&frame.normal_w).zip(&frame.label);
    let words: Vec<[u32; 8]> = pixels
        .map(|(((color, depth), normal), label)| {
            let mut words = [0; 8];
            let labelled = usize::from(*label) < classes;
            words[7] = if labelled { u32::from(*label) } else { UNLABELLED };
            if color.iter().all(|c| c.abs() <= COLOR_MAX) {
                words[7] |= COLORED;
                (0..3).for_each(|c| words[c] = color[c].to_bits());
            }
            if *depth > 0.0 && *depth <= DEPTH_MAX {
                words[3] = depth.to_bits();
            }
            let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
            if (length - 1.0).abs() < 0.5 {
                (0..3).for_each(|c| words[4 + c] = normal[c].to_bits());
            }
            words
        })
        .collect();
    let mut used = UsedPixels::default();
    for words in &words {
        used.colored += usize::from(words[7] & COLORED != 0);
        used.deep += usize::from(words[3] != 0);
        // Unknown normals are zero.
        used.oriented += usize::from(words[4..7] != [0; 3]);
        used.labelled += usize::from(words[7] & UNLABELLED != UNLABELLED);
    }
    (words, used)
}

impl DeviceTarget {
    /// # Panics
    /// If a buffer has another size than the camera's image.
    pub(crate) fn new(gpu: &Gpu, frame: &TrainFrame, classes: usize) -> Self {
        let count = frame.camera.intrinsics.width * frame.camera.intrinsics.height;
        let sizes = [frame.color.len(), frame.depth.len(), frame.normal_w.len(), frame.label.len()];
        assert_eq!(sizes, [count; 4], "every buffer has one entry per pixel of the camera");
        let (words, pixels) = words_of(frame, classes);
        let words = gpu.upload("observed", bytemuck::cast_slice(&words), wgpu::BufferUsages::STORAGE);
        Self { camera: Step::of_camera(&frame.camera), pixels, words }
    }
}
