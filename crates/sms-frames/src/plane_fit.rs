//! Local planes in a depth image: inverse depth is exactly affine in pixel coordinates on a plane.

/// Weighted least squares of w = c + gx·dx + gy·dy.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct InverseDepthFit {
    s: [f64; 6],
    b: [f64; 3],
    /// Samples added.
    pub(crate) count: usize,
}

/// A fitted plane: inverse depth `c` (1/m) at the origin of the offsets and its slopes per pixel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct InverseDepthPlane {
    pub(crate) c: f64,
    pub(crate) gx: f64,
    pub(crate) gy: f64,
}

/// Products of an offset (dx, dy) with the weight of a sample: 1, dx, dy, dx², dx dy, dy².
#[derive(Debug, Clone, Copy)]
pub(crate) struct WeightedOffset([f64; 6]);

impl WeightedOffset {
    pub(crate) fn new(dx: f64, dy: f64, weight: f64) -> Self {
        Self([1.0, dx, dy, dx * dx, dx * dy, dy * dy].map(|v| weight * v))
    }
}

impl InverseDepthFit {
    /// Adds a sample of inverse depth `w` at (dx, dy) pixels from the origin.
    pub(crate) fn add(&mut self, dx: f64, dy: f64, w: f64, weight: f64) {
        self.add_weighted(&WeightedOffset::new(dx, dy, weight), w);
    }

    /// Adds a sample of inverse depth `w` at an offset of which the weighted products are known.
    pub(crate) fn add_weighted(&mut self, at: &WeightedOffset, w: f64) {
        self.s.iter_mut().zip(at.0).for_each(|(sum, v)| *sum += v);
        self.b.iter_mut().zip(at.0).for_each(|(sum, v)| *sum += v * w);
        self.count += 1;
    }

    /// Returns the plane; `None` if the samples lie on a line (the spread across it is below a fifth of a pixel).
    pub(crate) fn solve(&self) -> Option<InverseDepthPlane> {
        let [n, sx, sy, sxx, sxy, syy] = self.s;
        if n <= 0.0 {
            return None;
        }
        // Centred second moments; their smaller eigenvalue is the spread across the samples' main direction.
        let (mx, my, mw) = (sx / n, sy / n, self.b[0] / n);
        let (cxx, cxy, cyy) = (sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my);
        let det = cxx * cyy - cxy * cxy;
        if det < 0.04 * (cxx + cyy) {
            return None;
        }
        let (cxw, cyw) = (self.b[1] / n - mx * mw, self.b[2] / n - my * mw);
        let gx = (cyy * cxw - cxy * cyw) / det;
        let gy = (cxx * cyw - cxy * cxw) / det;
        Some(InverseDepthPlane { c: mw - gx * mx - gy * my, gx, gy })
    }
}

impl InverseDepthPlane {
    /// Returns the depth in metres at an offset; infinite or negative where the plane does not face the camera.
    pub(crate) fn depth_at(&self, dx: f64, dy: f64) -> f64 {
        1.0 / self.inverse_depth_at(dx, dy)
    }

    /// Returns the inverse depth at an offset, 1/m.
    pub(crate) fn inverse_depth_at(&self, dx: f64, dy: f64) -> f64 {
        self.c + self.gx * dx + self.gy * dy
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recovers_a_plane_and_refuses_a_line() {
        let mut fit = InverseDepthFit::default();
        for (dx, dy, weight) in
            [(0.0, 0.0, 1.0), (1.0, 0.0, 3.0), (-1.0, 1.0, 0.5), (2.0, -2.0, 1.0), (0.0, 2.0, 2.0)]
        {
            fit.add(dx, dy, 1.7 + 0.02 * dx - 0.05 * dy, weight);
        }
        let plane = fit.solve().unwrap();
        assert!(
            (plane.c - 1.7).abs() < 1e-12
                && (plane.gx - 0.02).abs() < 1e-12
                && (plane.gy + 0.05).abs() < 1e-12
        );
        let mut line = InverseDepthFit::default();
        (0..6).for_each(|i| line.add(f64::from(i), f64::from(i), 1.0, 1.0));
        assert!(line.solve().is_none());
    }
}
