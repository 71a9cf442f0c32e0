//! Candidate landing sites, by geometry alone.

use crate::top_map::{ObjectSurface, Top, TopMap};
use glamx::{DVec2, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::length_text;
use sms_robots::Quadrotor;
use std::collections::BTreeMap;

/// Half of the square in which the slope of a surface is measured, metres.
const WINDOW_HALF_M: f64 = 0.03;

/// Settings of [`landing_sites`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SiteSettings {
    /// Greatest number of sites (paper: 15).
    pub most: usize,
    /// Least height above the ground, metres (paper: 0.5).
    pub min_height: f64,
    /// Greatest angle between a surface's normal and the vertical, radians.
    pub max_tilt: f64,
    /// Least distance between sites, metres; also the diameter of marks in the picture, so that they do not overlap.
    pub spacing: f64,
    /// Greatest height difference between the surface below a foot and the site, metres.
    pub foot_tolerance: f64,
    /// Side of the grid's cells, metres.
    pub cell: f64,
}

impl Default for SiteSettings {
    fn default() -> Self {
        let max_tilt = 10f64.to_radians();
        Self { most: 15, min_height: 0.5, max_tilt, spacing: 0.08, foot_tolerance: 0.01, cell: 0.01 }
    }
}

/// A place to land on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandingSite {
    /// Number in pictures, from 1.
    pub id: u32,
    /// The point on the surface, metres.
    pub p_w: DVec3,
    /// The object that contains it.
    pub surface: String,
}

/// All sites of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sites {
    /// The sites; at least one.
    pub sites: Vec<LandingSite>,
    /// The object with the largest top face among those with a site.
    pub platform: String,
    /// Centre of that face, metres.
    pub center_w: DVec3,
    /// Diameter of the marks in pictures, metres.
    pub spacing: f64,
}

/// Reason why there is no site.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoSite {
    /// No surface is both high and level enough.
    #[error("there is nothing to land on: no level surface is {} or more above the ground (the highest level one is at {})", length_text(*.min_height), length_text(*.highest))]
    NoSurface {
        /// The least height, metres.
        min_height: f64,
        /// Height of the highest level surface, metres; 0 if there is none.
        highest: f64,
    },
    /// There are surfaces, but no room for the vehicle's feet on them.
    #[error("the quadrotor is too wide: on {surface}, the largest level surface, there is no place for its feet, which stand {} apart", length_text(*.feet))]
    TooNarrow {
        /// The object with the most level surface.
        surface: String,
        /// Diameter of the circle through the feet, metres.
        feet: f64,
    },
}

/// Finds up to [`SiteSettings::most`] places on level surfaces where all of the vehicle's feet are supported and
/// nothing within its reach rises above them. The first is the nearest to the centre of the platform's top face,
/// each further one the farthest from all before (Gonzalez 1985), so that they cover it up to its edges.
///
/// # Errors
/// [`NoSite`] with the reason.
pub fn landing_sites(
    surfaces: &[ObjectSurface],
    vehicle: &Quadrotor,
    settings: &SiteSettings,
) -> Result<Sites, NoSite> {
    let map = TopMap::new(surfaces, settings.cell);
    let level = level_cells(&map, settings);
    let highest = level.iter().map(|(_, p_w)| p_w.z).fold(0.0, f64::max);
    let high: Vec<(usize, DVec3)> =
        level.into_iter().filter(|(_, p_w)| p_w.z >= settings.min_height).collect();
    let largest = |cells: &[(usize, DVec3)]| {
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for (surface, _) in cells {
            *counts.entry(&surfaces[*surface].name).or_default() += 1;
        }
        counts.into_iter().max_by_key(|(_, n)| *n).map(|(name, _)| name.to_owned())
    };
    let Some(widest) = largest(&high) else {
        return Err(NoSite::NoSurface { min_height: settings.min_height, highest });
    };
    let fitting: Vec<(usize, DVec3)> =
        high.iter().copied().filter(|(_, p_w)| fits(&map, *p_w, vehicle, settings)).collect();
    let Some(platform) = largest(&fitting) else {
        let feet = 2.0 * vehicle.feet.iter().map(|f| f.truncate().length()).fold(0.0, f64::max);
        return Err(NoSite::TooNarrow { surface: widest, feet });
    };
    let face: Vec<DVec3> =
        high.iter().filter(|(s, _)| surfaces[*s].name == platform).map(|(_, p_w)| *p_w).collect();
    let center_w = face.iter().sum::<DVec3>() / face.len() as f64;
    let sites = spread(&fitting, &platform, center_w, surfaces, settings);
    Ok(Sites { sites, platform, center_w, spacing: settings.spacing })
}

/// Returns cells with level surroundings, as the surface's index and the point.
fn level_cells(map: &TopMap, settings: &SiteSettings) -> Vec<(usize, DVec3)> {
    let least_cos = settings.max_tilt.cos();
    let level = |(p_w, top): (DVec2, Top)| {
        let (z, normal_w) = map.plane(p_w, WINDOW_HALF_M, top.surface)?;
        let is_level = normal_w.z >= least_cos && (top.z - z).abs() <= settings.foot_tolerance;
        is_level.then(|| (top.surface, p_w.extend(z)))
    };
    map.cells().filter_map(level).collect()
}

/// Whether the vehicle fits at a point: a surface below each foot, and nothing higher within its reach.
fn fits(map: &TopMap, p_w: DVec3, vehicle: &Quadrotor, settings: &SiteSettings) -> bool {
    let center = p_w.truncate();
    let stands = vehicle.feet.iter().all(|foot| {
        map.square(center + foot.truncate(), vehicle.foot_half.max(0.5 * settings.cell))
            .all(|(_, top)| top.is_some_and(|t| (t.z - p_w.z).abs() <= settings.foot_tolerance))
    });
    let reach = vehicle.reach();
    stands
        && map.square(center, reach).all(|(q, top)| {
            q.distance(center) > reach || top.is_none_or(|t| t.z <= p_w.z + settings.foot_tolerance)
        })
}

/// Samples farthest points, from the point of the platform nearest to its centre.
fn spread(
    fitting: &[(usize, DVec3)],
    platform: &str,
    center_w: DVec3,
    surfaces: &[ObjectSurface],
    settings: &SiteSettings,
) -> Vec<LandingSite> {
    let from_center = |p: &DVec3| p.truncate().distance(center_w.truncate());
    let on_platform = |i: &usize| surfaces[fitting[*i].0].name == platform;
    let mut next = (0..fitting.len())
        .filter(on_platform)
        .min_by(|&a, &b| from_center(&fitting[a].1).total_cmp(&from_center(&fitting[b].1)));
    let mut sites = Vec::new();
    let mut distances = vec![f64::INFINITY; fitting.len()];
    while let Some(i) = next.filter(|_| sites.len() < settings.most) {
        let (surface, p_w) = fitting[i];
        let id = sites.len() as u32 + 1;
        sites.push(LandingSite { id, p_w, surface: surfaces[surface].name.clone() });
        for (d, (_, q)) in distances.iter_mut().zip(fitting) {
            *d = d.min(DVec2::distance(q.truncate(), p_w.truncate()));
        }
        let farthest = (0..fitting.len()).max_by(|&a, &b| distances[a].total_cmp(&distances[b]));
        next = farthest.filter(|&f| distances[f] >= settings.spacing);
    }
    sites
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DQuat};
    use sms_core::Mesh;

    fn cuboid(name: &str, half: DVec3, center: DVec3, yaw: f64) -> ObjectSurface {
        let x_wb = DPose3::from_parts(center, DQuat::from_rotation_z(yaw));
        ObjectSurface { name: name.into(), mesh_w: Mesh::cuboid(half).transformed(&x_wb) }
    }

    fn found(surfaces: &[ObjectSurface]) -> Result<Sites, NoSite> {
        landing_sites(surfaces, &Quadrotor::default(), &SiteSettings::default())
    }

    #[test]
    fn sites_lie_apart_and_the_feet_stand_on_the_platform() {
        let (half, center) = (DVec3::new(0.40, 0.30, 0.05), DVec3::new(0.4, -0.2, 0.65));
        let sites =
            found(&[cuboid("box", half, center, 0.5), cuboid("stool", half, DVec3::Z * 0.2, 0.0)]).unwrap();
        assert_eq!((sites.sites.len(), sites.platform.as_str()), (15, "box"));
        assert!(sites.center_w.distance(DVec3::new(0.4, -0.2, 0.7)) < 0.005, "{}", sites.center_w);
        assert!(sites.sites[0].p_w.distance(sites.center_w) < 0.01);
        let vehicle = Quadrotor::default();
        let to_box = DPose3::from_parts(center, DQuat::from_rotation_z(0.5)).inverse();
        for (i, site) in sites.sites.iter().enumerate() {
            assert!((site.p_w.z - 0.7).abs() < 1e-9 && site.id as usize == i + 1);
            for foot in &vehicle.feet {
                let p_b = to_box.transform_point(site.p_w + foot.with_z(0.0));
                assert!(p_b.x.abs() < 0.40 && p_b.y.abs() < 0.30, "{p_b}");
            }
            assert!(sites.sites[..i].iter().all(|s| s.p_w.distance(site.p_w) >= 0.08 - 1e-9));
        }
        let farthest = sites.sites.iter().map(|s| s.p_w.distance(sites.center_w)).fold(0.0, f64::max);
        assert!(farthest > 0.15, "up to the edges: {farthest}");
    }

    #[test]
    fn objects_on_the_platform_are_kept_clear() {
        let board = cuboid("board", DVec3::new(0.6, 0.2, 0.01), DVec3::Z * 0.69, 0.0);
        let bar = cuboid("bar", DVec3::new(0.05, 0.15, 0.03), DVec3::new(-0.5, 0.0, 0.73), 0.0);
        let sites = found(&[board, bar]).unwrap();
        let reach = Quadrotor::default().reach();
        assert!(sites.sites.len() >= 5 && sites.sites.iter().all(|s| s.surface == "board"));
        assert!(sites.sites.iter().all(|s| s.p_w.x > -0.45 + 0.9 * reach), "{:?}", sites.sites);
    }

    #[test]
    fn scenes_without_a_site_are_explained() {
        let low = cuboid("crate", DVec3::new(0.5, 0.5, 0.1), DVec3::Z * 0.2, 0.0);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-4;
        assert!(matches!(found(std::slice::from_ref(&low)),
            Err(NoSite::NoSurface { min_height, highest }) if close(min_height, 0.5) && close(highest, 0.3)));
        let mut slope = low.clone();
        let tilted = DPose3::from_parts(DVec3::Z, DQuat::from_rotation_x(0.4));
        slope.mesh_w = Mesh::cuboid(DVec3::new(0.5, 0.5, 0.001)).transformed(&tilted);
        assert!(matches!(found(&[slope]), Err(NoSite::NoSurface { .. })));
        let post = cuboid("post", DVec3::new(0.08, 0.5, 0.4), DVec3::Z * 0.4, 0.0);
        assert!(matches!(found(&[post]),
            Err(NoSite::TooNarrow { surface, feet }) if surface == "post" && close(feet, 0.2828)));
        assert!(matches!(found(&[]), Err(NoSite::NoSurface { .. })));
    }

    #[test]
    fn a_rough_surface_is_level_where_its_slope_is_on_average() {
        // A lattice of 1 cm with heights that differ by up to 2 mm: single triangles lean by 15°.
        let mut mesh = Mesh::default();
        let n = 60u32;
        for y in 0..=n {
            for x in 0..=n {
                let rough = f64::from((x * 7919 + y * 104_729) % 1000) / 1000.0 * 0.002;
                mesh.vertices.push(DVec3::new(f64::from(x) * 0.01, f64::from(y) * 0.01, 0.6 + rough));
            }
        }
        let at = |x: u32, y: u32| y * (n + 1) + x;
        for y in 0..n {
            for x in 0..n {
                mesh.triangles.push([at(x, y), at(x + 1, y), at(x + 1, y + 1)]);
                mesh.triangles.push([at(x, y), at(x + 1, y + 1), at(x, y + 1)]);
            }
        }
        let sites = found(&[ObjectSurface { name: "sheet".into(), mesh_w: mesh }]).unwrap();
        assert_eq!(sites.sites.len(), 15);
    }
}
