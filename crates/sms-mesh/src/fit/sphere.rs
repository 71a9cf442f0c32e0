//! Spheres: random sample consensus (Fischler and Bolles 1981) with geometric refinement.

use crate::fit::config::SphereConfig;
use crate::fit::linear::{normal_equations, solve, tukey};
use crate::statistics::median;
use crate::tetra::to_circumcenter;
use glamx::DVec3;
use rand::RngExt;
use sms_core::{Aabb, Seed};

/// A sphere fitted to points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SphereFit {
    /// Centre, metres, in the points' frame.
    pub center: DVec3,
    /// Radius, metres.
    pub radius: f64,
    /// Share of the points that are inliers.
    pub inlier_share: f64,
    /// Share of the sphere's directions covered by inliers.
    pub coverage: f64,
    /// Robust standard deviation of the inliers' distances, metres.
    pub sigma: f64,
}

/// A measured surface point with the ray it was measured along.
#[derive(Debug, Clone, Copy)]
pub struct RaySample {
    /// Centre of the camera, metres.
    pub origin: DVec3,
    /// Unit direction.
    pub direction: DVec3,
    /// Measured distance along the ray, metres.
    pub distance: f64,
    /// Standard deviation of the distance, metres.
    pub sigma: f64,
}

/// Finds the sphere with the most `points` on it, and refines it to the geometric least-squares sphere of its inliers
/// (robustly weighted, corrected for the outward bias of noise on a curved surface). Returns `None` when every sphere
/// of allowed size has less than a fifth of the points.
///
/// ```
/// use sms_core::{Mesh, Seed};
/// let points = Mesh::icosphere(0.03, 3).vertices;
/// let fit = sms_mesh::fit_sphere(&points, &Default::default(), Seed(1)).unwrap();
/// assert!((fit.radius - 0.03).abs() < 1e-6 && fit.coverage > 0.99);
/// ```
pub fn fit_sphere(points: &[DVec3], config: &SphereConfig, seed: Seed) -> Option<SphereFit> {
    if points.len() < 8 {
        return None;
    }
    let mut rng = seed.derive("sphere").rng();
    let stride = points.len().div_ceil(3000);
    let sample: Vec<DVec3> = points.iter().copied().step_by(stride).collect();
    // Truncated squares (MSAC; Torr and Zisserman 2000) prefer the tightest fit among equal counts.
    let cost = |center: DVec3, radius: f64| -> f64 {
        let reach = inlier_distance(config, radius);
        sample.iter().map(|p| (((p.distance(center) - radius) / reach).powi(2)).min(1.0)).sum()
    };
    let allowed = config.min_radius..=config.max_radius;
    let mut candidates: Vec<(f64, DVec3, f64)> = (0..config.samples)
        .filter_map(|_| {
            let pick = std::array::from_fn(|_| sample[rng.random_range(0..sample.len())]);
            let offset = to_circumcenter(pick)?;
            let (center, radius) = (pick[0] + offset, offset.length());
            allowed.contains(&radius).then(|| (cost(center, radius), center, radius))
        })
        .collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Four noisy points of a shallow cap give only a rough sphere, so several of the best ones are refined (locally
    // optimised RANSAC; Chum, Matas and Kittler 2003).
    let (found, center, radius) = candidates
        .iter()
        .take(12)
        .map(|&(_, center, radius)| {
            let (center, radius, _) = refine(&sample, center, radius, inlier_distance(config, radius));
            (if allowed.contains(&radius) { cost(center, radius) } else { f64::INFINITY }, center, radius)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    if found > 0.9 * sample.len() as f64 {
        return None;
    }
    let (center, radius, sigma) = refine(points, center, radius, inlier_distance(config, radius));
    if !allowed.contains(&radius) {
        return None;
    }
    Some(SphereFit::of_sphere(points, center, radius, sigma, config))
}

impl SphereFit {
    /// Measures the inlier share and the coverage of `points` on a given sphere; `sigma` is stored as given.
    pub fn of_sphere(
        points: &[DVec3],
        center: DVec3,
        radius: f64,
        sigma: f64,
        config: &SphereConfig,
    ) -> Self {
        let reach = inlier_distance(config, radius);
        let inliers: Vec<DVec3> =
            points.iter().copied().filter(|p| (p.distance(center) - radius).abs() <= reach).collect();
        Self {
            center,
            radius,
            inlier_share: inliers.len() as f64 / points.len().max(1) as f64,
            coverage: coverage(&inliers, center),
            sigma,
        }
    }

    /// Returns whether the fit is good enough to treat the object as a ball: most of the cloud lies on the sphere,
    /// enough of the sphere was seen, and the cloud is not a small patch of a larger surface.
    pub fn explains(&self, points: &[DVec3], config: &SphereConfig) -> bool {
        let extent = Aabb::of_points(points.iter().copied()).map_or(0.0, |b| b.extents().max_element());
        self.inlier_share >= config.min_inlier_share
            && self.coverage >= config.min_coverage
            && 2.0 * self.radius <= 1.25 * extent
            && self.sigma <= inlier_distance(config, self.radius)
    }
}

fn inlier_distance(config: &SphereConfig, radius: f64) -> f64 {
    config.inlier_distance.max(config.inlier_radius_share * radius)
}

/// Returns the share of 162 even directions with a point within 12°.
fn coverage(points: &[DVec3], center: DVec3) -> f64 {
    let directions = sms_core::Mesh::icosphere(1.0, 2).vertices;
    let unit: Vec<DVec3> = points.iter().map(|&p| (p - center).normalize_or_zero()).collect();
    let near = 12f64.to_radians().cos();
    let seen = directions.iter().filter(|d| unit.iter().any(|u| u.dot(**d) > near)).count();
    seen as f64 / directions.len() as f64
}

/// Gauss-Newton on distances to the surface. Returns centre, radius and the residuals' robust deviation.
fn refine(points: &[DVec3], mut center: DVec3, mut radius: f64, reach: f64) -> (DVec3, f64, f64) {
    let mut sigma = reach;
    for round in 0..30 {
        let residuals: Vec<f64> = points.iter().map(|p| p.distance(center) - radius).collect();
        let near: Vec<f64> = residuals.iter().map(|r| r.abs()).filter(|&r| r < 2.0 * reach).collect();
        sigma = (1.4826 * median(near)).max(1e-6);
        // A wide scale at first allows large corrections of a rough start.
        let scale = if round < 4 { 3.0 * reach } else { 4.685 * sigma };
        let rows = points.iter().zip(&residuals).map(|(p, &r)| {
            let n = (*p - center).normalize_or_zero();
            ([-n.x, -n.y, -n.z, -1.0], r, tukey(r, scale))
        });
        let Some(step) = solve_normal(rows) else { break };
        center += DVec3::new(step[0], step[1], step[2]);
        radius += step[3];
        if step.iter().all(|s| s.abs() < 1e-9) {
            break;
        }
    }
    // Noise across the line of sight moves points outwards by σ²/R on average (two tangential directions).
    (center, radius - sigma * sigma / radius.max(1e-6), sigma)
}

/// Refines a sphere on measured rays. Residuals are along the rays, like the sensor's noise. Rays that graze the sphere
/// are excluded by the model's geometry instead of their residual, which keeps the fit unbiased. `floor` is the height
/// of a plane that the sphere may rest on, with its standard deviation.
pub fn refine_on_rays(
    rays: &[RaySample],
    mut center: DVec3,
    mut radius: f64,
    floor: Option<(f64, f64)>,
) -> Option<(DVec3, f64)> {
    for round in 0..25 {
        let mut rows = Vec::with_capacity(rays.len());
        for ray in rays {
            let along = ray.direction.dot(center - ray.origin);
            let miss2 = (center - ray.origin).length_squared() - along * along;
            if miss2 >= 0.8 * radius * radius {
                continue;
            }
            let predicted = along - (radius * radius - miss2).sqrt();
            let n = (ray.origin + ray.direction * predicted - center) / radius;
            let slope = n.dot(ray.direction);
            let r = (ray.distance - predicted) / ray.sigma;
            rows.push(([n.x, n.y, n.z, 1.0].map(|v| -v / (slope * ray.sigma)), r));
        }
        if rows.len() < 30 {
            return None;
        }
        let spread = 1.4826 * median(rows.iter().map(|r| r.1.abs()).collect());
        let scale = if round < 3 { 8.0 } else { 4.685 } * spread.max(0.05);
        let mut weighted: Vec<([f64; 4], f64, f64)> =
            rows.into_iter().map(|(j, r)| (j, r, tukey(r, scale))).collect();
        if let Some((height, sigma)) = floor {
            // Rays of one frame share errors, so the plane counts as a few hundred of them instead of one.
            let weight = weighted.len() as f64 * 0.05;
            let r = (center.z - radius - height) / sigma;
            weighted.push(([0.0, 0.0, 1.0 / sigma, -1.0 / sigma], r, weight * tukey(r, 10.0)));
        }
        let step = solve_normal(weighted.into_iter())?;
        center += DVec3::new(step[0], step[1], step[2]);
        radius += step[3];
        if radius <= 0.0 || !center.is_finite() {
            return None;
        }
        if step.iter().all(|s| s.abs() < 1e-8) {
            break;
        }
    }
    Some((center, radius))
}

/// Minimises Σ w (r + J x)² for four unknowns; `None` if they are not determined.
fn solve_normal(rows: impl Iterator<Item = ([f64; 4], f64, f64)>) -> Option<[f64; 4]> {
    let (a, b) = normal_equations(rows);
    let size = (0..4).map(|k| a[k][k]).fold(0.0, f64::max);
    solve(a, b, 1e-12 * size)
}
