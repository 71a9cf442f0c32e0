//! Principal axes of point sets.

use glamx::{DMat3, DVec3};

/// Returns the second moments about the mean, and the mean, of weighted points; `None` without weight.
pub fn scatter(points: impl Iterator<Item = (DVec3, f64)> + Clone) -> Option<(DMat3, DVec3)> {
    let (sum, weight) = points.clone().fold((DVec3::ZERO, 0.0), |(s, w), (p, k)| (s + p * k, w + k));
    if weight <= 0.0 {
        return None;
    }
    let mean = sum / weight;
    let moments = points.fold(DMat3::ZERO, |m, (p, k)| {
        let d = p - mean;
        m + DMat3::from_cols(d * d.x, d * d.y, d * d.z) * (k / weight)
    });
    Some((moments, mean))
}

/// Returns the variances in ascending order with their unit axes; `None` where all points coincide.
pub fn principal_axes(moments: DMat3) -> Option<([f64; 3], [DVec3; 3])> {
    let columns = moments.to_cols_array();
    let size = columns.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    if !(size > 0.0 && size.is_finite()) {
        return None;
    }
    // Moments in square metres are tiny, but the solver's thresholds assume numbers near one.
    let eigen = glamx::DSymmetricEigen3::new(moments * (1.0 / size));
    let axes = [eigen.eigenvectors.x_axis, eigen.eigenvectors.y_axis, eigen.eigenvectors.z_axis];
    let values = (eigen.eigenvalues * size).to_array();
    axes.iter().all(|v| v.is_finite()).then_some((values, axes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_of_a_turned_millimetre_box_are_found() {
        let turn = glamx::DQuat::from_scaled_axis(DVec3::new(0.3, -0.8, 0.5));
        let points: Vec<DVec3> = (0..1000)
            .map(|i| {
                let p = DVec3::new(f64::from(i % 10), f64::from(i / 10 % 10), f64::from(i / 100))
                    - DVec3::splat(4.5);
                turn * (p * DVec3::new(3e-4, 1e-4, 2e-5)) + DVec3::splat(0.7)
            })
            .collect();
        let (moments, mean) = scatter(points.iter().map(|&p| (p, 2.0))).unwrap();
        assert!((mean - DVec3::splat(0.7)).length() < 1e-12);
        let (values, axes) = principal_axes(moments).unwrap();
        for (k, (axis, pitch)) in
            [(DVec3::Z, 2e-5), (DVec3::Y, 1e-4), (DVec3::X, 3e-4)].into_iter().enumerate()
        {
            assert!((axes[k].dot(turn * axis).abs() - 1.0).abs() < 1e-9);
            assert!((values[k] / (8.25 * pitch * pitch) - 1.0).abs() < 1e-6);
        }
    }
}
