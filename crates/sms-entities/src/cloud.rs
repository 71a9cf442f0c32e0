//! From an object's Gaussians to a dense, oriented surface cloud (paper, Section "Materialize").

use crate::config::EntitiesConfig;
use crate::views::Views;
use glamx::DVec3;
use rand::RngExt;
use sms_core::{Entity, PointCloud, Seed};
use sms_gaussians::GaussianModel;
use sms_mesh::{
    PointGrid,
    cloud::{drop_strays, smooth_normals, thin},
    median,
};

/// One Gaussian as a flat disc.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfaceDisc {
    pub(crate) center: DVec3,
    /// Unit normal towards the cameras that saw it.
    pub(crate) normal: DVec3,
    /// In-plane axes scaled to one standard deviation.
    pub(crate) axes: [DVec3; 2],
    pub(crate) opacity: f64,
    pub(crate) color: [u8; 3],
}

/// Largest distance between neighbouring points of a cloud.
pub(crate) fn coarse_spacing(config: &EntitiesConfig) -> f64 {
    1.0 / config.density_per_m2.max(100.0).sqrt()
}

/// Returns the point distance at which the point budget covers the surface of the discs.
pub(crate) fn spacing(
    discs: &[SurfaceDisc],
    views: &Views,
    label: u16,
    config: &EntitiesConfig,
    seed: Seed,
) -> f64 {
    let coarse = coarse_spacing(config);
    // The number of samples falls with the square of their distance.
    let count = sample(discs, views, label, coarse, config, seed).points_w.len() as f64;
    let within_budget = coarse * (count / config.point_budget.max(1) as f64).sqrt();
    within_budget.clamp(config.min_spacing.min(coarse), coarse)
}

/// Returns the discs of the Gaussians that are classified as `label`, oriented and checked against the frames. Drops
/// discs that cameras see through, or that cameras label otherwise.
pub(crate) fn label_discs(
    model: &GaussianModel,
    views: &Views,
    label: u16,
    config: &EntitiesConfig,
) -> Vec<SurfaceDisc> {
    let mut discs = Vec::new();
    let is_usable = |&i: &usize| {
        model.labels[i] == label
            && model.is_measured(i)
            && f64::from(model.label_confidence[i]) >= config.min_confidence
            && f64::from(model.opacities[i]) >= config.min_opacity
            && model.positions_w[i].is_finite()
            && model.scales[i].is_finite()
    };
    let usable: Vec<usize> = (0..model.len()).filter(is_usable).collect();
    let centers: Vec<DVec3> = usable.iter().map(|&i| model.positions_w[i].as_dvec3()).collect();
    let counts = views.counts(&centers, label);
    for ((i, center), count) in usable.into_iter().zip(centers).zip(counts) {
        let (normal, axes) = model.disc(i);
        let seen = count.own + count.other;
        if count.free > seen || (seen >= 2 && count.own * 10 < seen * 3) {
            continue;
        }
        let mut normal = normal.as_dvec3().normalize_or_zero();
        if normal == DVec3::ZERO {
            continue;
        }
        if normal.dot(count.towards) < 0.0 {
            normal = -normal;
        }
        discs.push(SurfaceDisc {
            center,
            normal,
            axes: axes.map(|(axis, sigma)| axis.as_dvec3() * f64::from(sigma)),
            opacity: f64::from(model.opacities[i]),
            color: model.mean_color(i, normal.as_vec3()).map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8),
        });
    }
    limit_size(&mut discs);
    discs
}

/// Returns the Gaussians of an entity in the world frame: those with its label near its surface. They render the object
/// alone and move with its body.
pub fn object_gaussians(model: &GaussianModel, entity: &Entity, config: &EntitiesConfig) -> GaussianModel {
    /// Gaussians farther outside the object's box are dropped, metres.
    const MARGIN_M: f64 = 0.005;
    let Some(bounds) = entity.mesh.aabb() else { return GaussianModel::default() };
    let (low, high) = (bounds.min - MARGIN_M, bounds.max + MARGIN_M);
    let indices: Vec<usize> = (0..model.len())
        .filter(|&i| {
            let p = model.positions_w[i].as_dvec3();
            model.labels[i] == entity.label
                && model.is_measured(i)
                && f64::from(model.label_confidence[i]) >= config.min_confidence
                && p.cmpge(low).all()
                && p.cmple(high).all()
        })
        .collect();
    model.subset(&indices)
}

/// Makes discs from the labelled depth pixels, for objects with few Gaussians in the model.
pub(crate) fn pixel_discs(views: &Views, label: u16, spacing: f64) -> Vec<SurfaceDisc> {
    let mut discs: Vec<SurfaceDisc> = Vec::new();
    for (f, frame) in views.sequence.frames.iter().enumerate() {
        let map = &views.labels.maps[f];
        for y in 0..map.height {
            for x in 0..map.width {
                let depth = f64::from(frame.depth[(x, y)]);
                let normal_c = frame.normal_c[(x, y)].map(f64::from);
                if map[(x, y)] != label || depth <= 0.0 || normal_c == [0.0; 3] {
                    continue;
                }
                let normal = frame.camera.x_wc.rotation * DVec3::from_array(normal_c);
                let sigma = frame.camera.intrinsics.pixel_footprint(depth);
                let first = normal.any_orthonormal_vector();
                discs.push(SurfaceDisc {
                    center: frame.camera.unproject_pixel(x, y, depth),
                    normal,
                    axes: [first * sigma, normal.cross(first) * sigma],
                    opacity: 1.0,
                    color: frame.color[(x, y)],
                });
            }
        }
    }
    let centers: Vec<DVec3> = discs.iter().map(|d| d.center).collect();
    let keep = thin(&centers, &discs.iter().map(|d| d.normal).collect::<Vec<_>>(), 0.5 * spacing);
    keep.into_iter().map(|i| discs[i]).collect()
}

/// Shrinks discs that are far larger than the object's median disc: their rims are not on the surface.
fn limit_size(discs: &mut [SurfaceDisc]) {
    let typical = median(discs.iter().map(|d| d.axes[0].length().max(d.axes[1].length())).collect());
    let limit = (3.0 * typical).min(0.025);
    for disc in discs {
        for axis in &mut disc.axes {
            *axis = axis.clamp_length_max(limit);
        }
    }
}

/// Drops islands. Discs within a few times their usual distance form components; components with less than a tenth of
/// the discs of the largest one are dropped.
pub(crate) fn drop_islands(discs: Vec<SurfaceDisc>, spacing: f64) -> Vec<SurfaceDisc> {
    let centers: Vec<DVec3> = discs.iter().map(|d| d.center).collect();
    if centers.len() < 3 {
        return discs;
    }
    let grid = PointGrid::new(&centers, spacing);
    let gaps = centers.iter().map(|&p| grid.nearest_k(p, 4).last().map_or(0.0, |n| n.0.sqrt())).collect();
    let radius = (3.0 * median(gaps)).clamp(1.5 * spacing, 0.03);
    let mut component = vec![usize::MAX; centers.len()];
    let mut sizes = Vec::new();
    for start in 0..centers.len() {
        if component[start] != usize::MAX {
            continue;
        }
        let id = sizes.len();
        let mut stack = vec![start];
        component[start] = id;
        let mut size = 0;
        while let Some(i) = stack.pop() {
            size += 1;
            grid.for_each_within(centers[i], radius, |j, _| {
                if component[j] == usize::MAX {
                    component[j] = id;
                    stack.push(j);
                }
            });
        }
        sizes.push(size);
    }
    let largest = sizes.iter().copied().max().unwrap_or(0);
    let kept = discs.into_iter().zip(component).filter(|(_, c)| sizes[*c] * 10 >= largest);
    kept.map(|(disc, _)| disc).collect()
}

/// Smallest radius for smoothing normals, metres: depth noise is correlated over a few pixels.
const NORMAL_RADIUS_M: f64 = 0.005;

/// Samples each disc uniformly by area, thins the samples to the wanted density, and drops those that contradict the frames.
fn sample(
    discs: &[SurfaceDisc],
    views: &Views,
    label: u16,
    spacing: f64,
    config: &EntitiesConfig,
    seed: Seed,
) -> PointCloud {
    let mut rng = seed.rng();
    let mut order: Vec<usize> = (0..discs.len()).collect();
    order.sort_by(|&a, &b| discs[b].opacity.total_cmp(&discs[a].opacity).then(a.cmp(&b)));
    let mut points: Vec<DVec3> = order.iter().map(|&i| discs[i].center).collect();
    let mut owner = order.clone();
    for &i in &order {
        let disc = &discs[i];
        let area =
            std::f64::consts::PI * config.disc_sigmas.powi(2) * disc.axes[0].length() * disc.axes[1].length();
        // A surplus is thinned out later and makes the result more even.
        let wanted = 2.0 * area / (spacing * spacing) + rng.random::<f64>();
        for _ in 0..(wanted as usize).min(400) {
            // The square root makes the samples uniform by area instead of by radius.
            let radius = config.disc_sigmas * rng.random::<f64>().sqrt();
            let (sin, cos) = (std::f64::consts::TAU * rng.random::<f64>()).sin_cos();
            points.push(disc.center + disc.axes[0] * (radius * cos) + disc.axes[1] * (radius * sin));
            owner.push(i);
        }
    }
    let normals: Vec<DVec3> = owner.iter().map(|&i| discs[i].normal).collect();
    let mut cloud = PointCloud::default();
    let kept = thin(&points, &normals, 0.8 * spacing);
    let counts = views.counts(&kept.iter().map(|&i| points[i]).collect::<Vec<_>>(), label);
    for (i, count) in kept.into_iter().zip(counts) {
        if count.free > count.own || (count.other > count.own && count.own < 3) {
            continue;
        }
        cloud.points_w.push(points[i]);
        cloud.normals_w.push(normals[i]);
        cloud.colors.push(discs[owner[i]].color);
    }
    cloud
}

/// Samples uniform surface points, moves them onto the measured depth and smooths their normals.
pub(crate) fn densify(
    discs: &[SurfaceDisc],
    views: &Views,
    label: u16,
    spacing: f64,
    config: &EntitiesConfig,
    seed: Seed,
) -> PointCloud {
    let mut cloud = sample(discs, views, label, spacing, config, seed);
    if config.refine_to_depth {
        for _ in 0..2 {
            let offsets = views.surface_offsets(&cloud.points_w, &cloud.normals_w, label);
            for ((p, n), offset) in cloud.points_w.iter_mut().zip(&cloud.normals_w).zip(offsets) {
                if let Some(offset) = offset {
                    *p += n * offset;
                }
            }
            smooth_normals(&mut cloud, (2.0 * spacing).max(NORMAL_RADIUS_M));
        }
    }
    drop_strays(&mut cloud, spacing);
    cloud
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::over_plate;

    #[test]
    fn the_point_budget_covers_discs_that_are_farther_apart_than_points() {
        // The labelled half of the plate is 0.5 m × 1 m.
        let (sequence, labels) = over_plate(3, 100);
        let views = Views::new(&sequence, &labels);
        let apart = 0.025;
        let at = |i: usize| DVec3::new(-0.5 + apart * (i % 20) as f64, -0.5 + apart * (i / 20) as f64, 0.0);
        let disc = |i: usize| SurfaceDisc {
            center: at(i) + DVec3::new(0.5, 0.5, 0.0) * apart,
            normal: DVec3::Z,
            axes: [DVec3::X, DVec3::Y].map(|axis| axis * 0.5 * apart),
            opacity: 1.0,
            color: [0; 3],
        };
        let discs: Vec<SurfaceDisc> = (0..800).map(disc).collect();
        let config = EntitiesConfig { point_budget: 40_000, ..EntitiesConfig::default() };
        let spacing_m = spacing(&discs, &views, 1, &config, Seed(1));
        let points = densify(&discs, &views, 1, spacing_m, &config, Seed(2)).points_w.len();
        assert!((36_000..44_000).contains(&points), "{points} points {spacing_m} m apart");
    }
}
