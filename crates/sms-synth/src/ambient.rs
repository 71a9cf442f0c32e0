//! Ambient light: the visible part of the room and one bounce off floor and neighbours. It varies slowly over a surface and
//! does not depend on the camera, so it is gathered once per scene and interpolated.

use crate::floor_light::FloorLight;
use crate::ray_scene::{RayHit, RayScene};
use crate::shading::{LAMPS, backdrop};
use glamx::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Irradiance / π of the surroundings, on all surfaces.
#[derive(Debug)]
pub(crate) struct Ambient {
    floor: FloorLight<3>,
    /// Value at the corners of every facet.
    corners: Vec<[Vec3; 3]>,
    /// Values of every sphere, by latitude and longitude.
    spheres: Vec<Vec<Vec3>>,
    /// Value on an unobstructed level surface.
    open: Vec3,
}

/// Number of directions per gathering.
const DIRECTIONS: usize = 48;
/// Spacing of the floor's grid, metres.
const CELL_M: f32 = 0.01;
/// Latitudes and longitudes on a sphere.
const RINGS: usize = 12;
const SECTORS: usize = 24;
/// Assumed irradiance / π on a neighbour, for the light that it reflects.
const ON_NEIGHBOURS: f32 = 0.55;

/// Mean linear colours of the floor and of the objects.
pub(crate) struct MeanColors {
    pub(crate) floor: Vec3,
    pub(crate) objects: Vec<Vec3>,
}

impl Ambient {
    /// Gathers the ambient light of a scene; `lit` holds the visible shares of the lamps on the floor.
    pub(crate) fn gather(stage: &RayScene, lit: &FloorLight<LAMPS>, colors: &MeanColors) -> Self {
        let nothing = |d: Vec3| backdrop(d, 0.0);
        let open = around(Vec3::Z).map(nothing).sum::<Vec3>() / DIRECTIONS as f32;
        let thrown_back = |hit: &RayHit| match hit.object {
            Some(object) => colors.objects[object] * ON_NEIGHBOURS,
            None => {
                let shares = lit.at(hit.point).unwrap_or([1.0; LAMPS]);
                let lamps: Vec3 = (stage.lamps.iter().zip(shares))
                    .map(|(lamp, share)| {
                        let (to, _, light) = lamp.seen_from(hit.point);
                        light * (to.z.max(0.0) * share)
                    })
                    .sum();
                colors.floor * (lamps + 0.7 * open)
            }
        };
        let at = |point: Vec3, normal: Vec3| {
            let origin = point + normal * 5e-4;
            let sum: Vec3 = around(normal)
                .map(|d| match stage.nearest(origin, d) {
                    Some(hit) => thrown_back(&hit),
                    None => nothing(d),
                })
                .sum();
            sum / DIRECTIONS as f32
        };
        // Corners with the same position and normal share one value.
        let mut index_of: BTreeMap<[u32; 6], usize> = BTreeMap::new();
        let mut places = Vec::new();
        let corner_index: Vec<[usize; 3]> = (stage.facets.iter())
            .map(|facet| {
                std::array::from_fn(|i| {
                    let (p, n) = (facet.corners[i], facet.normals[i]);
                    let key = [p.x, p.y, p.z, n.x, n.y, n.z].map(f32::to_bits);
                    *index_of.entry(key).or_insert_with(|| {
                        places.push((p, n));
                        places.len() - 1
                    })
                })
            })
            .collect();
        let values: Vec<Vec3> = places.par_iter().map(|&(p, n)| at(p, n)).collect();
        let spheres = (stage.bodies.iter())
            .map(|body| {
                let Some((center, radius)) = body.sphere else { return Vec::new() };
                (0..(RINGS + 1) * SECTORS)
                    .into_par_iter()
                    .map(|i| {
                        let polar = (i / SECTORS) as f32 / RINGS as f32 * std::f32::consts::PI;
                        let turn = (i % SECTORS) as f32 / SECTORS as f32 * std::f32::consts::TAU;
                        let n = Vec3::new(polar.sin() * turn.cos(), polar.sin() * turn.sin(), polar.cos());
                        at(center + n * radius, n)
                    })
                    .collect()
            })
            .collect();
        let (low, high) = lit.rectangle();
        let floor = FloorLight::compute(low, high, CELL_M, |p| at(p, Vec3::Z).to_array());
        let corners = corner_index.iter().map(|of| of.map(|i| values[i])).collect();
        Self { floor, corners, spheres, open }
    }

    /// Returns the ambient light at a hit.
    pub(crate) fn on(&self, hit: &RayHit) -> Vec3 {
        match (hit.object, hit.facet) {
            (None, _) => self.floor.at(hit.point).map_or(self.open, Vec3::from_array),
            (Some(_), Some((facet, w))) => {
                let [a, b, c] = self.corners[facet];
                a * w[0] + b * w[1] + c * w[2]
            }
            (Some(object), None) => on_sphere(&self.spheres[object], hit.normal),
        }
    }
}

fn on_sphere(values: &[Vec3], n: Vec3) -> Vec3 {
    let u = n.z.clamp(-1.0, 1.0).acos() / std::f32::consts::PI * RINGS as f32;
    let v = (n.y.atan2(n.x) / std::f32::consts::TAU).rem_euclid(1.0) * SECTORS as f32;
    let (i, j) = ((u as usize).min(RINGS - 1), v as usize % SECTORS);
    let (fu, fv) = (u - i as f32, v - v.floor());
    let at = |i: usize, j: usize| values[i * SECTORS + j % SECTORS];
    at(i, j).lerp(at(i, j + 1), fv).lerp(at(i + 1, j).lerp(at(i + 1, j + 1), fv), fu)
}

/// Directions around a normal, as dense as the cosine to it.
fn around(normal: Vec3) -> impl Iterator<Item = Vec3> {
    let (side, other) = normal.any_orthonormal_pair();
    (0..DIRECTIONS).map(move |i| {
        let square = (i as f32 + 0.5) / DIRECTIONS as f32;
        let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
        let r = square.sqrt();
        side * (r * cos) + other * (r * sin) + normal * (1.0 - square).sqrt()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AssetKind, BilliardsSettings, generate_billiards};
    use sms_core::Seed;

    #[test]
    fn corners_and_hollows_get_less_light_than_the_open() {
        let settings =
            BilliardsSettings { objects: 1, kinds: vec![AssetKind::Mug], ..BilliardsSettings::default() };
        let scene = generate_billiards(Seed(1), &settings);
        let stage = RayScene::new(&scene);
        let lit = FloorLight::compute([0.2, -0.4], [0.8, 0.4], 0.01, |_| [1.0; LAMPS]);
        let colors = MeanColors { floor: Vec3::splat(0.3), objects: vec![Vec3::splat(0.5); 3] };
        let ambient = Ambient::gather(&stage, &lit, &colors);
        let floor = |p: Vec3| {
            let hit = stage.nearest(p.with_z(0.01), -Vec3::Z).unwrap();
            assert_eq!(hit.object, None);
            ambient.on(&hit).y
        };
        let (ball, radius) = stage.bodies[0].sphere.unwrap();
        let (beside, open) = (floor(ball + Vec3::X * 1.02 * radius), floor(ball + Vec3::X * -5.0 * radius));
        // The ball covers a quarter of the cosine-weighted hemisphere and reflects some light.
        assert!(beside < 0.9 * open && beside > 0.7 * open, "{beside} {open}");
        let mug = stage.bodies[2].center;
        let into = stage.nearest(mug.with_z(0.5), -Vec3::Z).unwrap();
        assert_eq!(into.object, Some(2));
        assert!(into.point.z < 0.02, "the ray sees the bottom of the mug");
        assert!(ambient.on(&into).y < 0.85 * ambient.open.y);
        let top = stage.nearest(ball.with_z(0.5), -Vec3::Z).unwrap();
        assert!((ambient.on(&top).y / ambient.open.y - 1.0).abs() < 0.1);
    }
}
