//! Oriented point clouds: thinning, normals, selection.

use crate::pca::{principal_axes, scatter};
use crate::point_grid::PointGrid;
use glamx::DVec3;
use sms_core::{Aabb, PointCloud};

/// Returns the indices of points that are at least `distance` apart, in order. Points on opposite sides of a thin wall
/// are independent.
pub fn thin(points: &[DVec3], normals: &[DVec3], distance: f64) -> Vec<usize> {
    const EMPTY: u32 = u32::MAX;
    let Some(bounds) = Aabb::of_points(points.iter().copied()) else { return Vec::new() };
    let mut cell = distance;
    while (bounds.extents() / cell + DVec3::splat(3.0)).to_array().iter().product::<f64>() > 4e6 {
        cell *= 1.5;
    }
    // A border of empty cells avoids bounds checks; kept points are chained within their cell.
    let size = (bounds.extents() / cell).to_array().map(|v| v as usize + 3);
    let mut head = vec![EMPTY; size.iter().product()];
    let mut next = vec![EMPTY; points.len()];
    let mut kept = Vec::new();
    let limit = distance * distance;
    for (i, &p) in points.iter().enumerate() {
        let at = ((p - bounds.min) / cell).to_array().map(|v| v as usize + 1);
        let mut blocked = false;
        'search: for z in at[2] - 1..=at[2] + 1 {
            for y in at[1] - 1..=at[1] + 1 {
                for x in at[0] - 1..=at[0] + 1 {
                    let mut j = head[(z * size[1] + y) * size[0] + x];
                    while j != EMPTY {
                        let k = j as usize;
                        if points[k].distance_squared(p) < limit && normals[k].dot(normals[i]) > 0.3 {
                            blocked = true;
                            break 'search;
                        }
                        j = next[k];
                    }
                }
            }
        }
        if !blocked {
            let slot = &mut head[(at[2] * size[1] + at[1]) * size[0] + at[0]];
            next[i] = *slot;
            *slot = i as u32;
            kept.push(i);
        }
    }
    kept
}

/// Replaces normals by local plane fits in flat surroundings, else by the mean of similar neighbours.
pub fn smooth_normals(cloud: &mut PointCloud, radius: f64) {
    let grid = PointGrid::new(&cloud.points_w, radius);
    let smoothed: Vec<DVec3> = (0..cloud.points_w.len())
        .map(|i| {
            let (p, n) = (cloud.points_w[i], cloud.normals_w[i]);
            let (mut sum, mut near) = (DVec3::ZERO, Vec::new());
            grid.for_each_within(p, radius, |j, d| {
                let like = cloud.normals_w[j].dot(n);
                if like > 0.5 {
                    let w = (1.0 - d / (radius * radius)) * like;
                    sum += cloud.normals_w[j] * w;
                    near.push((cloud.points_w[j], w));
                }
            });
            let average = sum.normalize_or(n);
            if near.len() < 6 {
                return average;
            }
            let axes = scatter(near.iter().copied()).and_then(|(moments, _)| principal_axes(moments));
            let Some((values, axes)) = axes else { return average };
            let flat = values[0] < 0.1 * values[1];
            let fit = if axes[0].dot(average) < 0.0 { -axes[0] } else { axes[0] };
            if flat && fit.dot(average) > 0.7 { (average + fit).normalize() } else { average }
        })
        .collect();
    cloud.normals_w = smoothed;
}

/// Drops points that have hardly any neighbours.
pub fn drop_strays(cloud: &mut PointCloud, spacing: f64) {
    let grid = PointGrid::new(&cloud.points_w, 3.0 * spacing);
    let has_neighbors = |&p: &DVec3| {
        let mut near = 0;
        grid.for_each_within(p, 3.0 * spacing, |_, _| near += 1);
        near >= 5
    };
    let keep: Vec<bool> = cloud.points_w.iter().map(has_neighbors).collect();
    retain(cloud, &keep);
}

/// Returns the points whose entry is true.
pub fn chosen(cloud: &PointCloud, which: &[bool]) -> PointCloud {
    let mut part = cloud.clone();
    retain(&mut part, which);
    part
}

/// Adds the points of one cloud to another.
pub fn extend(cloud: &mut PointCloud, by: PointCloud) {
    cloud.points_w.extend(by.points_w);
    cloud.normals_w.extend(by.normals_w);
    cloud.colors.extend(by.colors);
}

/// Keeps the points whose entry is true.
pub fn retain(cloud: &mut PointCloud, keep: &[bool]) {
    fn filter<T: Copy>(values: &mut Vec<T>, keep: &[bool]) {
        let mut keep = keep.iter();
        values.retain(|_| keep.next() == Some(&true));
    }
    filter(&mut cloud.points_w, keep);
    filter(&mut cloud.normals_w, keep);
    filter(&mut cloud.colors, keep);
}

/// Returns the mean colour; grey for an empty cloud.
pub fn mean_color(colors: &[[u8; 3]]) -> [u8; 3] {
    if colors.is_empty() {
        return [128; 3];
    }
    std::array::from_fn(|k| {
        let sum: usize = colors.iter().map(|c| c[k] as usize).sum();
        (sum / colors.len()) as u8
    })
}
