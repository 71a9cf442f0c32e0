//! The renderer: one ray a pixel for depth and labels, more at edges for colour.

use crate::bvh::{Bvh, Ray};
use crate::depth_camera::{DepthCamera, irwin_hall};
use crate::floor_light::FloorLight;
use crate::scene::TruthScene;
use crate::shading::{Lamp, SurfacePoint, backdrop, lamps, shade, tone_map};
use crate::skin::Skin;
use crate::texture::{hash, linear_from_srgb, srgb_channels};
use glamx::{DPose3, Mat3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{Camera, ColorImage, DepthImage, Image, LabelMap, Seed};
use std::collections::BTreeMap;

/// The sensor: everything about the camera but its intrinsics and pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraModel {
    /// Errors of the depth camera.
    pub depth: DepthCamera,
    /// Standard deviation of the colour noise, in 8-bit levels.
    pub color_sigma: f32,
    /// Whether edges are supersampled (colour only).
    pub antialias: bool,
    /// Seed of all noise of this frame.
    pub seed: Seed,
}

impl Default for CameraModel {
    fn default() -> Self {
        Self { depth: DepthCamera::default(), color_sigma: 1.2, antialias: true, seed: Seed(0) }
    }
}

/// One rendered frame.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderedFrame {
    /// Colour with sensor noise.
    pub color: ColorImage,
    /// True depth along the optical axis in metres, at pixel centres; 0 where nothing is hit.
    pub depth: DepthImage,
    /// Depth as the depth camera measures it.
    pub depth_noisy: DepthImage,
    /// Object index + 1, 0 for the floor and beyond.
    pub label: LabelMap,
}

/// Renders one frame. [`Renderer`] prepares the scene once for many frames.
pub fn render(scene: &TruthScene, camera: &Camera, model: &CameraModel) -> RenderedFrame {
    Renderer::new(scene).render(camera, model)
}

/// A scene prepared for rendering.
#[derive(Debug)]
pub struct Renderer<'a> {
    scene: &'a TruthScene,
    /// Pictures of the objects that have one; may be shorter than the objects.
    skins: &'a [Option<Skin>],
    bvh: Bvh,
    facets: Vec<Facet>,
    bodies: Vec<Body>,
    lamps: [Lamp; 2],
    /// Mean linear colour of the floor, for light that it throws back.
    floor_color: Vec3,
    floor_light: FloorLight,
}

/// What shading needs to know of a triangle.
#[derive(Debug, Clone, Copy)]
struct Facet {
    object: usize,
    /// Index in the object's mesh.
    triangle: usize,
    corners: [Vec3; 3],
    normals: [Vec3; 3],
}

#[derive(Debug)]
struct Body {
    /// Exact sphere, if it is one: centre in the world and radius.
    sphere: Option<(Vec3, f32)>,
    /// Sphere around it.
    center: Vec3,
    radius: f32,
    /// A stack of spheres that stands for it where it takes light from the sky: centre, squared radius.
    stack: Vec<(Vec3, f32)>,
    /// World to asset frame.
    rotation_aw: Mat3,
    translation_aw: Vec3,
}

/// The nearest surface along a ray.
struct Hit {
    t: f32,
    /// Triangle of the object's mesh and weights of its corners; `None` for the floor and spheres.
    facet: Option<(usize, [f32; 3])>,
    /// `None` for the floor.
    object: Option<usize>,
    point: Vec3,
    normal: Vec3,
    /// Normal of the facet itself.
    flat_normal: Vec3,
    /// From where shadow rays start, so that facets do not show in the shadow's edge (Hanika 2021).
    shadow_origin: Vec3,
}

#[derive(Debug, Clone, Copy, Default)]
struct Pixel {
    color: Vec3,
    depth: f32,
    cos_incidence: f32,
    normal: Vec3,
    label: u16,
}

/// Facets that meet at less than this angle are shaded as one smooth surface: cos 38°.
const CREASE_COS: f64 = 0.79;

impl<'a> Renderer<'a> {
    /// Prepares a scene.
    pub fn new(scene: &'a TruthScene) -> Self {
        Self::with_skins(scene, &[])
    }

    /// Prepares a scene some of whose objects have pictures: `skins[i]` is that of `scene.objects[i]`, in place of the
    /// object's texture.
    pub fn with_skins(scene: &'a TruthScene, skins: &'a [Option<Skin>]) -> Self {
        let mut facets = Vec::new();
        for (index, object) in scene.objects.iter().enumerate() {
            if object.sphere_radius.is_none() {
                let mesh = object.mesh_w();
                let normals = smooth_normals(&mesh);
                facets.extend((0..mesh.triangles.len()).map(|t| Facet {
                    object: index,
                    triangle: t,
                    corners: mesh.corners(t).map(|p| p.as_vec3()),
                    normals: normals[t],
                }));
            }
        }
        let corners: Vec<[Vec3; 3]> = facets.iter().map(|f| f.corners).collect();
        let bodies = scene
            .objects
            .iter()
            .map(|object| {
                let bounds = object.aabb_w();
                let half = 0.5 * bounds.extents();
                let x_aw: DPose3 = object.x_ab * object.x_wb.inverse();
                let r = 0.45 * (half.x + half.y);
                let count = (half.z / r).ceil().max(1.0) as usize;
                let stack = (0..count)
                    .map(|i| {
                        let z = bounds.min.z + (i as f64 + 0.5) / count as f64 * 2.0 * half.z;
                        let c = bounds.center();
                        (glamx::DVec3::new(c.x, c.y, z).as_vec3(), (r * r.min(half.z)) as f32)
                    })
                    .collect();
                Body {
                    sphere: object.sphere_radius.map(|r| (object.x_wb.translation.as_vec3(), r as f32)),
                    center: bounds.center().as_vec3(),
                    radius: object.sphere_radius.unwrap_or(half.length()) as f32,
                    stack,
                    rotation_aw: Mat3::from_quat(x_aw.rotation.as_quat()),
                    translation_aw: x_aw.translation.as_vec3(),
                }
            })
            .collect();
        let floor = &scene.floor.texture;
        let floor_color = linear_from_srgb(floor.color).lerp(linear_from_srgb(floor.accent), 0.25);
        let empty = FloorLight::compute([0.0; 2], [0.0; 2], |_| [1.0; 3]);
        let bvh = Bvh::build(&corners);
        let mut renderer =
            Self { scene, skins, bvh, facets, bodies, lamps: lamps(), floor_color, floor_light: empty };
        renderer.floor_light = renderer.light_floor();
        renderer
    }

    /// Light on the floor around the bodies, as far as their shadows reach.
    fn light_floor(&self) -> FloorLight {
        const SHADOW_REACH_M: f32 = 0.3;
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for body in &self.bodies {
            let c = body.center.truncate().to_array();
            for axis in 0..2 {
                low[axis] = low[axis].min(c[axis] - body.radius - SHADOW_REACH_M);
                high[axis] = high[axis].max(c[axis] + body.radius + SHADOW_REACH_M);
            }
        }
        if self.bodies.is_empty() {
            (low, high) = ([0.0; 2], [0.0; 2]);
        }
        FloorLight::compute(low, high, |p| self.floor_light_at(p))
    }

    fn floor_light_at(&self, point: Vec3) -> [f32; 3] {
        let origin = point + Vec3::Z * 1e-4;
        let turn = hash01([(point.x * 4000.0) as i32, (point.y * 4000.0) as i32, 7]);
        let [key, fill] = self
            .lamps
            .map(|lamp| self.lamp_visibility(origin, &lamp, (lamp.center - point).normalize(), turn));
        [key, fill, self.openness(point, Vec3::Z, None)]
    }

    /// Renders one frame. Every pixel depends on the scene, the camera and the seed only, not on threads.
    pub fn render(&self, camera: &Camera, model: &CameraModel) -> RenderedFrame {
        let k = &camera.intrinsics;
        let (width, height) = (k.width, k.height);
        let rotation = Mat3::from_quat(camera.x_wc.rotation.as_quat());
        let eye = camera.x_wc.translation.as_vec3();
        let direction = |u: f64, v: f64| {
            rotation * Vec3::new(((u - k.cx) / k.fx) as f32, ((v - k.cy) / k.fy) as f32, 1.0)
        };
        let pixel_angle = 1.0 / (k.fx * k.fy).sqrt() as f32;
        let mut pixels = vec![Pixel::default(); width * height];
        pixels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                let d = direction(x as f64 + 0.5, y as f64 + 0.5);
                *pixel = self.trace(eye, d, pixel_angle, jitter(x, y, 0));
            }
        });
        let mut color = Image::filled(width, height, [0u8; 3]);
        let noise_seed = model.seed.derive("color").0 as u32;
        color.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, out) in row.iter_mut().enumerate() {
                let mut rgb = tone_map(pixels[y * width + x].color);
                if model.antialias && on_edge(&pixels, width, height, x, y) {
                    // A rotated grid of four samples; the centre sample is replaced, not added.
                    rgb = Vec3::ZERO;
                    for (i, (dx, dy)) in [(0.375, 0.125), (0.875, 0.375), (0.625, 0.875), (0.125, 0.625)]
                        .into_iter()
                        .enumerate()
                    {
                        let d = direction(x as f64 + dx, y as f64 + dy);
                        rgb += 0.25
                            * tone_map(self.trace(eye, d, pixel_angle, jitter(x, y, i as u32 + 1)).color);
                    }
                }
                let mut channel = 0;
                *out = srgb_channels(rgb).map(|v| {
                    channel += 2;
                    let noise =
                        irwin_hall(noise_seed, x as i32, y as i32, channel) as f32 * model.color_sigma;
                    (v * 255.0 + noise + 0.5).clamp(0.0, 255.0) as u8
                });
            }
        });
        let depth = Image::from_vec(width, height, pixels.iter().map(|p| p.depth).collect());
        let cos = Image::from_vec(width, height, pixels.iter().map(|p| p.cos_incidence).collect());
        let label = Image::from_vec(width, height, pixels.iter().map(|p| p.label).collect());
        let depth_noisy = model.depth.measure(&depth, &cos, model.seed.derive("depth"));
        RenderedFrame { color, depth, depth_noisy, label }
    }

    /// Traces one ray whose `direction` has length 1 along the optical axis, so that distances are depths.
    fn trace(&self, eye: Vec3, direction: Vec3, pixel_angle: f32, jitter: f32) -> Pixel {
        let Some(hit) = self.nearest(eye, direction) else {
            return Pixel { color: backdrop(direction), ..Pixel::default() };
        };
        let length = direction.length();
        let to_eye = -direction / length;
        let cos_incidence = hit.flat_normal.dot(to_eye).abs();
        let normal = if hit.normal.dot(to_eye) < 0.0 { -hit.normal } else { hit.normal };
        // A slanted pixel is long and narrow; its mean width decides what detail it can show.
        let footprint = hit.t * pixel_angle / cos_incidence.max(0.03).sqrt();
        let (texture, albedo) = match hit.object {
            None => {
                let texture = &self.scene.floor.texture;
                (texture, texture.albedo(hit.point, Vec3::Z, footprint))
            }
            Some(index) => {
                let body = &self.bodies[index];
                let texture = &self.scene.objects[index].texture;
                let skin = self.skins.get(index).and_then(Option::as_ref).zip(hit.facet);
                let albedo = match skin {
                    Some((skin, (triangle, weights))) => skin.albedo(triangle, weights, footprint),
                    None => {
                        let p_a = body.rotation_aw * hit.point + body.translation_aw;
                        texture.albedo(p_a, body.rotation_aw * hit.normal, footprint)
                    }
                };
                (texture, albedo)
            }
        };
        let to_lamp = self.lamps.map(|lamp| (lamp.center - hit.point).normalize());
        let [key, fill, openness] = match hit.object {
            None => self.floor_light.at(hit.point).unwrap_or_else(|| self.floor_light_at(hit.point)),
            Some(_) => {
                let [key, fill] = [0, 1].map(|i| {
                    if normal.dot(to_lamp[i]) <= 0.0 {
                        return 0.0;
                    }
                    self.lamp_visibility(hit.shadow_origin, &self.lamps[i], to_lamp[i], jitter)
                });
                [key, fill, self.openness(hit.point, normal, hit.object)]
            }
        };
        let lamps = [(to_lamp[0], key), (to_lamp[1], fill)];
        let point = SurfacePoint { normal, to_eye, height: hit.point.z, albedo, texture, openness, lamps };
        Pixel {
            color: shade(&point, self.floor_color),
            depth: hit.t,
            cos_incidence,
            normal,
            label: hit.object.map_or(0, |i| i as u16 + 1),
        }
    }

    fn nearest(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        const START: f32 = 1e-3;
        let mut limit = f32::INFINITY;
        let mut hit = None;
        let half = self.scene.floor.half_size_m as f32;
        if direction.z < 0.0 && origin.z > 0.0 {
            let t = -origin.z / direction.z;
            let point = origin + direction * t;
            if point.x.abs() <= half && point.y.abs() <= half {
                limit = t;
                let point = point.with_z(0.0);
                let shadow_origin = point + Vec3::Z * 1e-4;
                hit = Some(Hit {
                    t,
                    facet: None,
                    object: None,
                    point,
                    normal: Vec3::Z,
                    flat_normal: Vec3::Z,
                    shadow_origin,
                });
            }
        }
        for (index, body) in self.bodies.iter().enumerate() {
            let Some((center, radius)) = body.sphere else { continue };
            if let Some(t) = sphere_distance(origin, direction, center, radius, START).filter(|&t| t < limit)
            {
                limit = t;
                let normal = (origin + direction * t - center).normalize();
                let point = center + normal * radius;
                let shadow_origin = point + normal * 1e-4;
                let object = Some(index);
                hit = Some(Hit { t, facet: None, object, point, normal, flat_normal: normal, shadow_origin });
            }
        }
        let ray = Ray::new(origin, direction, START);
        if let Some(found) = self.bvh.nearest(&ray, limit) {
            let facet = &self.facets[found.triangle as usize];
            let weights = [1.0 - found.u - found.v, found.u, found.v];
            let blend = |v: [Vec3; 3]| v[0] * weights[0] + v[1] * weights[1] + v[2] * weights[2];
            let point = blend(facet.corners);
            let normal = blend(facet.normals).normalize_or_zero();
            let [a, b, c] = facet.corners;
            let flat_normal = (b - a).cross(c - a).normalize_or_zero();
            // The point lifted towards the smooth surface that the corner normals describe.
            let lifted: [Vec3; 3] = std::array::from_fn(|i| {
                let above = (point - facet.corners[i]).dot(facet.normals[i]).min(0.0);
                point - facet.normals[i] * above
            });
            let shadow_origin = blend(lifted) + flat_normal * 1e-4;
            let object = Some(facet.object);
            let weighted = Some((facet.triangle, weights));
            hit =
                Some(Hit { t: found.t, facet: weighted, object, point, normal, flat_normal, shadow_origin });
        }
        hit
    }

    /// The share of a lamp that a point sees. Rays are only traced past bodies that stand near the line of sight, and
    /// many only where the first four disagree.
    fn lamp_visibility(&self, origin: Vec3, lamp: &Lamp, to_lamp: Vec3, jitter: f32) -> f32 {
        const RING: usize = 4;
        const SAMPLES: usize = 16;
        let reach = (lamp.center - origin).length();
        let in_the_way = |body: &Body| {
            let along = (body.center - origin).dot(to_lamp);
            let beside = (body.center - origin - to_lamp * along).length();
            along > -body.radius && beside < body.radius + lamp.radius * (along.max(0.0) / reach)
        };
        let (mut spheres, mut meshes) = (false, false);
        for body in self.bodies.iter().filter(|b| in_the_way(b)) {
            if body.sphere.is_some() { spheres = true } else { meshes = true }
        }
        if !spheres && !meshes {
            return 1.0;
        }
        let (side, other) = to_lamp.any_orthonormal_pair();
        let blocked = |radius: f32, angle: f32| {
            let aim = lamp.center + (side * angle.cos() + other * angle.sin()) * (radius * lamp.radius);
            let direction = aim - origin;
            let hits_sphere = || {
                self.bodies
                    .iter()
                    .filter_map(|b| b.sphere)
                    .any(|(c, r)| sphere_distance(origin, direction, c, r, 1e-4).is_some_and(|t| t < 1.0))
            };
            (spheres && hits_sphere()) || (meshes && self.bvh.any(&Ray::new(origin, direction, 1e-4), 1.0))
        };
        let turn = jitter * std::f32::consts::TAU;
        let quarter = std::f32::consts::FRAC_PI_2;
        let dark = (0..RING).filter(|&i| blocked(0.95, turn + i as f32 * quarter)).count();
        if dark == 0 || dark == RING {
            return 1.0 - (dark / RING) as f32;
        }
        // Vogel's spiral covers the disc evenly.
        let lit = (0..SAMPLES)
            .filter(|&i| !blocked(((i as f32 + 0.5) / SAMPLES as f32).sqrt(), turn + i as f32 * 2.399_963))
            .count();
        lit as f32 / SAMPLES as f32
    }

    /// The share of the sky left open by other bodies, each seen as a stack of spheres.
    fn openness(&self, point: Vec3, normal: Vec3, own: Option<usize>) -> f32 {
        let mut open = 1.0;
        for (index, body) in self.bodies.iter().enumerate() {
            if own == Some(index) {
                continue;
            }
            for &(center, square) in &body.stack {
                let to = center - point;
                let distance2 = to.length_squared().max(square);
                let facing = (normal.dot(to) / distance2.sqrt() + 0.15).max(0.0);
                open *= 1.0 - (0.9 * facing * square / distance2).min(0.9);
            }
        }
        open
    }
}

/// Distance to a sphere in units of `direction`, computed without cancellation (Haines et al. 2019, "Precision
/// Improvements for Ray/Sphere Intersection").
fn sphere_distance(origin: Vec3, direction: Vec3, center: Vec3, radius: f32, t_min: f32) -> Option<f32> {
    let f = origin - center;
    let a = direction.length_squared();
    let b = -f.dot(direction);
    let off_axis = f + direction * (b / a);
    let discriminant = radius * radius - off_axis.length_squared();
    if discriminant < 0.0 {
        return None;
    }
    let q = b + b.signum() * (a * discriminant).sqrt();
    let c = f.length_squared() - radius * radius;
    let (near, far) = if b > 0.0 { (c / q, q / a) } else { (q / a, c / q) };
    [near, far].into_iter().find(|&t| t > t_min)
}

/// Corner normals of each triangle: the area-weighted mean of the facets around the corner that bend by less than the
/// crease angle.
fn smooth_normals(mesh: &sms_core::Mesh) -> Vec<[Vec3; 3]> {
    let area_normals: Vec<glamx::DVec3> = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(c - a)
        })
        .collect();
    let mut around: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (t, corners) in mesh.triangles.iter().enumerate() {
        corners.iter().for_each(|&i| around.entry(i).or_default().push(t));
    }
    mesh.triangles
        .iter()
        .zip(&area_normals)
        .map(|(corners, own)| {
            let own_unit = own.normalize_or_zero();
            corners.map(|i| {
                let sum: glamx::DVec3 = around[&i]
                    .iter()
                    .map(|&t| area_normals[t])
                    .filter(|n| n.normalize_or_zero().dot(own_unit) > CREASE_COS)
                    .sum();
                sum.try_normalize().unwrap_or(own_unit).as_vec3()
            })
        })
        .collect()
}

/// A number in [0, 1) for turning sample patterns, fixed per pixel.
fn jitter(x: usize, y: usize, sample: u32) -> f32 {
    hash01([x as i32, y as i32, sample as i32])
}

fn hash01([x, y, z]: [i32; 3]) -> f32 {
    hash(x, y, z, 0x51ED_270B) as f32 / 4_294_967_296.0
}

/// Whether colour may change within the pixel: another object, a jump in depth or a crease next to it.
fn on_edge(pixels: &[Pixel], width: usize, height: usize, x: usize, y: usize) -> bool {
    let own = &pixels[y * width + x];
    let differs = |x: usize, y: usize| {
        let other = &pixels[y * width + x];
        own.label != other.label
            || (own.depth == 0.0) != (other.depth == 0.0)
            || (own.depth > 0.0 && own.normal.dot(other.normal) < 0.85)
            || (own.label > 0 && (own.depth - other.depth).abs() > 0.02 * own.depth)
    };
    (x > 0 && differs(x - 1, y))
        || (x + 1 < width && differs(x + 1, y))
        || (y > 0 && differs(x, y - 1))
        || (y + 1 < height && differs(x, y + 1))
}
