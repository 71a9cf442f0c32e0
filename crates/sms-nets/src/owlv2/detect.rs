//! Conversion of the network's output to boxes on the image.

use candle_core::{Result, Tensor};

/// A box on an image in pixels; the corner of the first pixel is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelBox {
    /// Left edge.
    pub x0: f64,
    /// Upper edge.
    pub y0: f64,
    /// Right edge.
    pub x1: f64,
    /// Lower edge.
    pub y1: f64,
}

impl PixelBox {
    /// Returns the area in pixels; 0 for an inverted box.
    pub fn area(&self) -> f64 {
        (self.x1 - self.x0).max(0.0) * (self.y1 - self.y0).max(0.0)
    }

    /// Returns the part on an image of this size.
    pub fn clipped(&self, width: usize, height: usize) -> Self {
        let (w, h) = (width as f64, height as f64);
        Self {
            x0: self.x0.clamp(0.0, w),
            y0: self.y0.clamp(0.0, h),
            x1: self.x1.clamp(0.0, w),
            y1: self.y1.clamp(0.0, h),
        }
    }

    /// Returns the intersection over union, in 0..1.
    pub fn overlap(&self, other: &Self) -> f64 {
        let shared = self.shared(other);
        let joint = self.area() + other.area() - shared;
        if joint > 0.0 { shared / joint } else { 0.0 }
    }

    /// Returns the intersection's area.
    fn shared(&self, other: &Self) -> f64 {
        let w = self.x1.min(other.x1) - self.x0.max(other.x0);
        let h = self.y1.min(other.y1) - self.y0.max(other.y0);
        w.max(0.0) * h.max(0.0)
    }

    /// Returns whether at least `share` of `other` lies in this box.
    pub fn holds(&self, other: &Self, share: f64) -> bool {
        other.area() > 0.0 && self.shared(other) >= share * other.area()
    }
}

/// A detected object.
#[derive(Debug, Clone, PartialEq)]
pub struct Detection {
    /// Index of the query with the highest score.
    pub query: usize,
    /// Score of this query, in 0..1.
    pub score: f64,
    /// Bounding box of the object.
    pub bbox: PixelBox,
}

/// Returns the detections above `threshold`, in the order of the patches: `logits` (1, patches, queries) and
/// `boxes` (1, patches, 4), centre and size relative to the padded square, on an image of `width` × `height`
/// pixels.
///
/// The image was padded to a square before it was resized, so boxes are scaled by its **longer** side.
///
/// # Errors
/// If the tensors have other shapes.
pub fn detections(
    logits: &Tensor,
    boxes: &Tensor,
    (width, height): (usize, usize),
    threshold: f64,
) -> Result<Vec<Detection>> {
    let logits = logits.squeeze(0)?.to_vec2::<f32>()?;
    let boxes = boxes.squeeze(0)?.to_vec2::<f32>()?;
    let side = width.max(height) as f64;
    let mut found = Vec::new();
    for (logits, cxcywh) in logits.iter().zip(&boxes) {
        let best =
            logits.iter().enumerate().fold(None, |best: Option<(usize, f32)>, (i, &logit)| match best {
                Some((_, value)) if value >= logit => best,
                _ => Some((i, logit)),
            });
        let Some((query, logit)) = best else { continue };
        let score = 1.0 / (1.0 + f64::from(-logit).exp());
        let [cx, cy, w, h] = [0, 1, 2, 3].map(|i| f64::from(cxcywh[i]) * side);
        let bbox = PixelBox { x0: cx - w / 2.0, y0: cy - h / 2.0, x1: cx + w / 2.0, y1: cy + h / 2.0 };
        if score > threshold {
            found.push(Detection { query, score, bbox });
        }
    }
    Ok(found)
}

/// Non-maximum suppression across all queries: returns the best detections first, without those that overlap a better
/// one by more than `max_overlap`. The network itself has no suppression, and several queries and patches find the same
/// object.
pub fn suppressed(mut found: Vec<Detection>, max_overlap: f64) -> Vec<Detection> {
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Detection> = Vec::new();
    for candidate in found {
        if kept.iter().all(|better| better.bbox.overlap(&candidate.bbox) <= max_overlap) {
            kept.push(candidate);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    fn at(query: usize, score: f64, x0: f64, x1: f64) -> Detection {
        Detection { query, score, bbox: PixelBox { x0, y0: 0.0, x1, y1: 10.0 } }
    }

    #[test]
    fn the_better_of_two_that_overlap_stays() {
        let found = vec![at(0, 0.3, 0.0, 10.0), at(1, 0.9, 1.0, 11.0), at(0, 0.5, 10.0, 20.0)];
        let kept = suppressed(found, 0.5);
        assert_eq!(kept.iter().map(|d| d.score).collect::<Vec<_>>(), [0.9, 0.5]);
    }

    #[test]
    fn boxes_are_scaled_by_the_longer_side() {
        let logits = Tensor::new(&[[[-3f32, 2.0], [-9.0, -9.0]]], &Device::Cpu).unwrap();
        let boxes = Tensor::new(&[[[0.5f32, 0.25, 0.2, 0.1], [0.5; 4]]], &Device::Cpu).unwrap();
        let found = detections(&logits, &boxes, (200, 100), 0.5).unwrap();
        assert_eq!(found.len(), 1);
        let PixelBox { x0, y0, x1, y1 } = found[0].bbox;
        assert_eq!([x0, y0, x1, y1].map(|v| (v * 1e3).round() / 1e3), [80.0, 40.0, 120.0, 60.0]);
        assert_eq!(found[0].query, 1);
        assert!((found[0].score - 1.0 / (1.0 + (-2f64).exp())).abs() < 1e-9);
    }

    #[test]
    fn overlap_and_holding_of_boxes() {
        let (a, b) = (at(0, 0.0, 0.0, 10.0).bbox, at(0, 0.0, 5.0, 10.0).bbox);
        assert_eq!(a.overlap(&b), 0.5);
        assert!(a.holds(&b, 1.0) && !b.holds(&a, 0.6));
        assert_eq!(a.clipped(4, 4).area(), 16.0);
    }
}
