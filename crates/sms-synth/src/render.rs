//! The renderer: one ray per pixel for depth and labels, more at edges for colour. Colour is that of a microfacet surface under
//! lamps, ambient light and one mirrored bounce; depth and labels do not depend on it.

use crate::ambient::{Ambient, MeanColors};
use crate::brdf::Reflectance;
use crate::floor_light::FloorLight;
use crate::ray_scene::{RayHit, RayScene};
use crate::scene::TruthScene;
use crate::sensor::{ColorCamera, ColorRays, DepthCamera, DepthView, FrameState, Rays, irwin_hall};
use crate::shading::{LAMPS, backdrop, tone_map};
use crate::skin::Skin;
use crate::texture::{hash, linear_from_srgb, srgb_channels};
use glamx::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::{Camera, ColorImage, DepthImage, Image, Intrinsics, LabelMap, Seed};

/// The sensor in one frame: everything about the camera but its intrinsics, pose and motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraModel {
    /// Errors of the depth camera.
    pub depth: DepthCamera,
    /// Errors of the colour camera.
    pub color: ColorCamera,
    /// Whether edges are supersampled (colour only).
    pub antialias: bool,
    /// Seed of all noise of this frame.
    pub seed: Seed,
}

impl CameraModel {
    /// A camera without errors, for measuring against.
    pub fn perfect() -> Self {
        Self { depth: DepthCamera::perfect(), color: ColorCamera::perfect(), ..Self::default() }
    }
}

impl Default for CameraModel {
    fn default() -> Self {
        Self { depth: DepthCamera::default(), color: ColorCamera::default(), antialias: true, seed: Seed(0) }
    }
}

/// One rendered frame.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderedFrame {
    /// Colour with sensor noise.
    pub color: ColorImage,
    /// True depth along the optical axis in metres, at pixel centres; 0 without a surface.
    pub depth: DepthImage,
    /// Depth as the depth camera measures it; smaller than `depth` where the camera records it so, see
    /// [`DepthCamera::fills_image`].
    pub depth_noisy: DepthImage,
    /// Confidence of each pixel of `depth_noisy`: 0 low, 1 medium, 2 high; `None` for a camera that states none.
    pub confidence: Option<Image<u16>>,
    /// Object index + 1, 0 for the floor and beyond.
    pub label: LabelMap,
}

/// A scene prepared for rendering any number of frames.
#[derive(Debug)]
pub struct Renderer<'a> {
    scene: &'a TruthScene,
    /// Image textures of the objects; may be shorter than the objects.
    skins: &'a [Option<Skin>],
    stage: RayScene,
    /// Visible shares of the lamps on the floor.
    floor_light: FloorLight<LAMPS>,
    ambient: Ambient,
}

#[derive(Debug, Clone, Copy, Default)]
struct TracedPixel {
    color: Vec3,
    depth: f32,
    cos_incidence: f32,
    echo: f32,
    normal: Vec3,
    label: u16,
}

/// Spacing of the grid of shadows on the floor, metres: about one pixel of a full-size frame.
const SHADOW_CELL_M: f32 = 0.0025;
/// Surfaces rougher than this reflect the ambient light instead of traced rays.
const ROUGHEST_MIRROR: f32 = 0.45;
/// Number of mirrored rays off rough surfaces: painted ones, and metals, where they contribute most of the light.
const MIRROR_RAYS: usize = 4;
const METAL_RAYS: usize = 14;

impl<'a> Renderer<'a> {
    /// Prepares a scene.
    pub fn new(scene: &'a TruthScene) -> Self {
        Self::with_skins(scene, &[])
    }

    /// Prepares a scene with image textures: `skins[i]` replaces the procedural texture of `scene.objects[i]`.
    pub fn with_skins(scene: &'a TruthScene, skins: &'a [Option<Skin>]) -> Self {
        let stage = RayScene::new(scene);
        let (low, high) = shadowed_rectangle(&stage);
        let floor_light = FloorLight::compute(low, high, SHADOW_CELL_M, |p| lamp_shares(&stage, p));
        let mean = |t: &crate::Texture| linear_from_srgb(t.color).lerp(linear_from_srgb(t.accent), 0.25);
        let objects = scene.objects.iter().enumerate().map(|(index, object)| {
            let skin = skins.get(index).and_then(Option::as_ref);
            skin.map_or_else(|| mean(&object.texture), Skin::mean)
        });
        let colors = MeanColors { floor: mean(&scene.floor.texture), objects: objects.collect() };
        let ambient = Ambient::gather(&stage, &floor_light, &colors);
        Self { scene, skins, stage, floor_light, ambient }
    }

    /// Renders one frame of a camera at rest. Every pixel depends on the scene, the camera and the seed only, not on threads.
    pub fn render(&self, camera: &Camera, model: &CameraModel) -> RenderedFrame {
        self.render_moving(camera, model, &FrameState::default())
    }

    /// Renders one frame of a camera that moves: `camera` has the pose at which depth is taken.
    pub fn render_moving(&self, camera: &Camera, model: &CameraModel, state: &FrameState) -> RenderedFrame {
        let k = &camera.intrinsics;
        let (width, height) = (k.width, k.height);
        let at_rest = Rays::new(camera);
        let pixels = self.traced(k, |_| at_rest);
        let depth = plane(k, &pixels, |p| p.depth);
        let color = if model.color.has_own_rays(state) {
            let rays = ColorRays::new(camera, &model.color, state, near_depth(&depth));
            let seen = self.traced(k, |row| rays.middle(row));
            self.color(k, model, state.gain, &seen, |row, moment| rays.at(row, moment), rays.moments)
        } else {
            self.color(k, model, state.gain, &pixels, |_, _| at_rest, 1)
        };
        let (cos_incidence, echo) = (plane(k, &pixels, |p| p.cos_incidence), plane(k, &pixels, |p| p.echo));
        let label = Image::from_vec(width, height, pixels.iter().map(|p| p.label).collect());
        let view = DepthView {
            depth: &depth,
            cos_incidence: &cos_incidence,
            echo: &echo,
            intrinsics: k,
            guide: Some(&color),
        };
        let measured = model.depth.measure(&view, model.seed.derive("depth"));
        RenderedFrame { color, depth, depth_noisy: measured.depth, confidence: measured.confidence, label }
    }

    /// Traces one ray through the centre of each pixel; `rays` are those of a row.
    fn traced(&self, k: &Intrinsics, rays: impl Fn(usize) -> Rays + Sync) -> Vec<TracedPixel> {
        let pixel_angle = pixel_angle(k);
        let mut pixels = vec![TracedPixel::default(); k.width * k.height];
        pixels.par_chunks_mut(k.width).enumerate().for_each(|(y, row)| {
            let rays = rays(y);
            for (x, pixel) in row.iter_mut().enumerate() {
                let d = rays.direction(x as f64 + 0.5, y as f64 + 0.5);
                *pixel = self.trace(rays.eye, d, pixel_angle, [x, y, 0]);
            }
        });
        pixels
    }

    /// Returns the colour image. `pixels` are its rays through pixel centres; `rays` are those of a row at one of the `moments` of the
    /// exposure.
    fn color(
        &self,
        k: &Intrinsics,
        model: &CameraModel,
        gain: f64,
        pixels: &[TracedPixel],
        rays: impl Fn(usize, f64) -> Rays + Sync,
        moments: usize,
    ) -> ColorImage {
        // A rotated grid of four samples; the centre sample is replaced, not added.
        const GRID: [(f64, f64); 4] = [(0.375, 0.125), (0.875, 0.375), (0.625, 0.875), (0.125, 0.625)];
        let (width, height, pixel_angle) = (k.width, k.height, pixel_angle(k));
        let gain = gain as f32;
        let mut color = Image::filled(width, height, [0u8; 3]);
        let noise_seed = model.seed.derive("color").0 as u32;
        color.data.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let middle = rays(y, 0.5 * moments as f64);
            let exposed: Vec<Rays> = (0..moments).map(|i| rays(y, i as f64 + 0.5)).collect();
            for (x, out) in row.iter_mut().enumerate() {
                let mut rgb = tone_map(pixels[y * width + x].color * gain);
                if moments > 1 {
                    // The sensor sums up light, so that moments are averaged before the tone curve.
                    let mut light = Vec3::ZERO;
                    for (i, rays) in exposed.iter().enumerate() {
                        let (dx, dy) = if model.antialias { GRID[i % GRID.len()] } else { (0.5, 0.5) };
                        let d = rays.direction(x as f64 + dx, y as f64 + dy);
                        light += self.trace(rays.eye, d, pixel_angle, [x, y, i + 1]).color;
                    }
                    rgb = tone_map(light * (gain / moments as f32));
                } else if model.antialias && on_edge(pixels, width, height, x, y) {
                    rgb = Vec3::ZERO;
                    for (i, (dx, dy)) in GRID.into_iter().enumerate() {
                        let d = middle.direction(x as f64 + dx, y as f64 + dy);
                        rgb += 0.25
                            * tone_map(self.trace(middle.eye, d, pixel_angle, [x, y, i + 1]).color * gain);
                    }
                }
                let mut channel = 0;
                *out = srgb_channels(rgb).map(|v| {
                    channel += 2;
                    let noise =
                        irwin_hall(noise_seed, x as i32, y as i32, channel) as f32 * model.color.sigma_levels;
                    (v * 255.0 + noise + 0.5).clamp(0.0, 255.0) as u8
                });
            }
        });
        color
    }

    /// Traces one ray whose `direction` has length 1 along the optical axis, so that distances are depths. `sample` is the
    /// pixel and the number of the ray in it.
    fn trace(&self, eye: Vec3, direction: Vec3, pixel_angle: f32, sample: [usize; 3]) -> TracedPixel {
        let Some(hit) = self.stage.nearest(eye, direction) else {
            return TracedPixel { color: backdrop(direction, 0.0), ..TracedPixel::default() };
        };
        let length = direction.length();
        let to_eye = -direction / length;
        let cos_incidence = hit.flat_normal.dot(to_eye).abs();
        // The footprint of a slanted pixel is long and narrow; its mean width limits the detail.
        let footprint = hit.t * pixel_angle / cos_incidence.max(0.03).sqrt();
        let surface = self.surface(&hit, to_eye, footprint);
        let jitter = hash01(sample.map(|v| v as i32));
        let direct = self.direct(&hit, &surface, to_eye, jitter);
        let ambient = self.ambient.on(&hit);
        let nv = surface.normal.dot(to_eye).clamp(0.0, 1.0);
        let mirrored = self.mirrored(&hit, &surface, to_eye, ambient, jitter);
        TracedPixel {
            color: direct
                + surface.finish.base_share(nv) * ambient
                + surface.finish.lobe_share(nv) * mirrored,
            depth: hit.t,
            cos_incidence,
            echo: surface.finish.echo(cos_incidence),
            normal: hit.normal,
            label: hit.object.map_or(0, |i| i as u16 + 1),
        }
    }

    /// Returns colour, roughness and shading normal (towards the viewer) at a hit.
    fn surface(&self, hit: &RayHit, to_eye: Vec3, footprint: f32) -> ShadedSurface {
        let facing = |n: Vec3| if n.dot(to_eye) < 0.0 { -n } else { n };
        let Some(index) = hit.object else {
            let texture = &self.scene.floor.texture;
            let albedo = texture.albedo(hit.point, Vec3::Z, footprint);
            let finish = Reflectance::new(albedo, texture.gloss, texture.metalness);
            return ShadedSurface { finish, normal: Vec3::Z };
        };
        let body = &self.stage.bodies[index];
        let texture = &self.scene.objects[index].texture;
        let p_a = body.rotation_aw * hit.point + body.translation_aw;
        let normal_a = body.rotation_aw * hit.normal;
        let skin = self.skins.get(index).and_then(Option::as_ref).zip(hit.facet);
        let (albedo, tilt) = match skin {
            Some((skin, (facet, weights))) => {
                (skin.albedo(self.stage.facets[facet].triangle, weights, footprint), Vec3::ZERO)
            }
            None => (texture.albedo(p_a, normal_a, footprint), texture.tilt(p_a, footprint)),
        };
        let tilted = normal_a + (tilt - normal_a * tilt.dot(normal_a));
        let normal = facing(body.rotation_aw.transpose() * tilted.normalize_or(normal_a));
        ShadedSurface { finish: Reflectance::new(albedo, texture.gloss, texture.metalness), normal }
    }

    /// Returns the reflected light of the lamps.
    fn direct(&self, hit: &RayHit, surface: &ShadedSurface, to_eye: Vec3, jitter: f32) -> Vec3 {
        let on_floor = hit.object.is_none().then(|| self.floor_light.at(hit.point).unwrap_or([1.0; LAMPS]));
        let mut sum = Vec3::ZERO;
        for (i, lamp) in self.stage.lamps.iter().enumerate() {
            let (to_lamp, spread, light) = lamp.seen_from(hit.point);
            let reflected = surface.finish.reflect(surface.normal, to_eye, to_lamp, spread);
            if reflected.max_element() <= 1e-4 {
                continue;
            }
            let share = match on_floor {
                Some(shares) => shares[i],
                None => self.stage.lamp_visibility(hit.shadow_origin, lamp, to_lamp, jitter),
            };
            sum += reflected * light * share;
        }
        sum
    }

    /// Returns the mean mirrored radiance without the lamps, which are part of [`Self::direct`].
    fn mirrored(
        &self,
        hit: &RayHit,
        surface: &ShadedSurface,
        to_eye: Vec3,
        ambient: Vec3,
        jitter: f32,
    ) -> Vec3 {
        let (finish, normal) = (&surface.finish, surface.normal);
        let straight = normal * (2.0 * normal.dot(to_eye)) - to_eye;
        if finish.alpha > ROUGHEST_MIRROR {
            return ambient;
        }
        // A floor mostly reflects the room.
        if hit.object.is_none() && !self.stage.may_hit(hit.shadow_origin, straight, 2.0 * finish.alpha, None)
        {
            return backdrop(straight, finish.alpha);
        }
        let rays = match finish.alpha {
            _ if finish.is_metal() => METAL_RAYS,
            smooth if smooth < 0.05 => 1,
            _ => MIRROR_RAYS,
        };
        let mut sum = Vec3::ZERO;
        for i in 0..rays {
            let u = [(i as f32 + jitter) / rays as f32, (jitter * 7.31 + i as f32 * 0.618_034).fract()];
            let sampled = if rays == 1 { straight } else { finish.mirrored(normal, to_eye, u) };
            // Directions below the surface hit the surface itself.
            sum += if sampled.dot(hit.flat_normal) * to_eye.dot(hit.flat_normal) <= 0.0 {
                ambient
            } else if let Some(radiance) = self.radiance(hit.shadow_origin, sampled, finish.alpha) {
                radiance
            } else if hit.object.is_none() {
                // The same as far from bodies, so that there is no seam.
                backdrop(straight, finish.alpha)
            } else {
                backdrop(sampled, finish.alpha)
            };
        }
        sum / rays as f32
    }

    /// Returns the light along a mirrored ray, the diffuse part only; `None` without a hit.
    fn radiance(&self, origin: Vec3, direction: Vec3, blur: f32) -> Option<Vec3> {
        const FOOTPRINT_M: f32 = 0.004;
        let hit = self.stage.nearest(origin, direction)?;
        let surface = self.surface(&hit, -direction, FOOTPRINT_M + 0.5 * blur * hit.t);
        let matte = surface.finish.base_share(0.8);
        let on_floor = hit.object.is_none().then(|| self.floor_light.at(hit.point).unwrap_or([1.0; LAMPS]));
        let mut light = self.ambient.on(&hit);
        for (i, lamp) in self.stage.lamps.iter().enumerate() {
            let (to_lamp, _, strength) = lamp.seen_from(hit.point);
            // Shadows on mirrored objects are not traced; a constant share replaces them.
            let share = on_floor.map_or(0.7, |shares| shares[i]);
            light += strength * (surface.normal.dot(to_lamp).max(0.0) * share);
        }
        Some(matte * light + surface.finish.lobe_share(0.8) * self.ambient.on(&hit))
    }
}

/// Returns a property of the pixels as an image.
fn plane(k: &Intrinsics, pixels: &[TracedPixel], of: fn(&TracedPixel) -> f32) -> Image<f32> {
    Image::from_vec(k.width, k.height, pixels.iter().map(of).collect())
}

/// Returns the angle of a pixel, radians.
fn pixel_angle(k: &Intrinsics) -> f32 {
    1.0 / (k.fx * k.fy).sqrt() as f32
}

/// Returns a depth that a tenth of the surface is nearer than, metres; 1 without any.
fn near_depth(depth: &DepthImage) -> f64 {
    let mut seen: Vec<f32> = depth.data.iter().copied().filter(|z| *z > 0.0).collect();
    let tenth = seen.len() / 10;
    if seen.is_empty() { 1.0 } else { f64::from(*seen.select_nth_unstable_by(tenth, f32::total_cmp).1) }
}

struct ShadedSurface {
    finish: Reflectance,
    /// Unit, towards the viewer.
    normal: Vec3,
}

/// Returns the visible shares of the lamps at a floor point.
fn lamp_shares(stage: &RayScene, point: Vec3) -> [f32; LAMPS] {
    let origin = point + Vec3::Z * 1e-4;
    let turn = hash01([(point.x * 4000.0) as i32, (point.y * 4000.0) as i32, 7]);
    stage.lamps.map(|lamp| stage.lamp_visibility(origin, &lamp, lamp.seen_from(point).0, turn))
}

/// Returns the rectangle of the floor that bodies shade.
fn shadowed_rectangle(stage: &RayScene) -> ([f32; 2], [f32; 2]) {
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for body in &stage.bodies {
        let c = body.center.truncate().to_array();
        let top = body.center.z + body.radius;
        // Reach of shadows from the lowest lamp, 45° and less above the horizon, and from the room.
        let reach = body.radius + (1.2 * top).max(0.15);
        for axis in 0..2 {
            low[axis] = low[axis].min(c[axis] - reach);
            high[axis] = high[axis].max(c[axis] + reach);
        }
    }
    if stage.bodies.is_empty() { ([0.0; 2], [0.0; 2]) } else { (low, high) }
}

/// Returns a number in [0, 1) that is fixed per place, to turn sample patterns.
fn hash01([x, y, z]: [i32; 3]) -> f32 {
    hash(x, y, z, 0x51ED_270B) as f32 / 4_294_967_296.0
}

/// Returns whether colour may change within the pixel: another object, a jump in depth or a crease next to it.
fn on_edge(pixels: &[TracedPixel], width: usize, height: usize, x: usize, y: usize) -> bool {
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
