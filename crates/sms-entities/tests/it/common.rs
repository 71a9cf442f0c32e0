//! Scenes of analytic shapes: signed distances, frames with ray-cast depth, and Gaussians on the seen surface.
#![allow(dead_code, unreachable_pub, reason = "a module of fixtures; each test file uses its own part")]

use rand::RngExt;
use sms_core::glamx::{DQuat, DVec3, Quat, Vec3};
use sms_core::{Camera, Image, Intrinsics, LabelInfo, Labels, MaskSource, Mesh, PointCloud, Seed};
use sms_frames::{Frame, Sequence};
use sms_gaussians::{AFFINITY_DIM, GaussianModel};

/// Signed distance to an object in the world, negative inside, with the object's exact volume.
pub struct Shape {
    pub name: &'static str,
    pub sdf: Box<dyn Fn(DVec3) -> f64 + Sync>,
    pub volume: f64,
}

fn box_sdf(p: DVec3, half: DVec3) -> f64 {
    let q = p.abs() - half;
    q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
}

const PI: f64 = std::f64::consts::PI;

pub fn ball(center: DVec3, r: f64) -> Shape {
    Shape { name: "ball", sdf: Box::new(move |p| p.distance(center) - r), volume: 4.0 / 3.0 * PI * r * r * r }
}

/// A box standing on `foot`, turned about z by `yaw`.
pub fn cuboid(foot: DVec3, half: DVec3, yaw: f64) -> Shape {
    let turn = DQuat::from_rotation_z(-yaw);
    let center = foot + DVec3::Z * half.z;
    Shape {
        name: "box",
        sdf: Box::new(move |p| box_sdf(turn * (p - center), half)),
        volume: 8.0 * half.x * half.y * half.z,
    }
}

pub fn cylinder(foot: DVec3, r: f64, h: f64) -> Shape {
    let sdf = move |p: DVec3| {
        let q = p - foot - DVec3::Z * (0.5 * h);
        let (a, b) = (q.x.hypot(q.y) - r, q.z.abs() - 0.5 * h);
        a.max(0.0).hypot(b.max(0.0)) + a.max(b).min(0.0)
    };
    Shape { name: "cylinder", sdf: Box::new(sdf), volume: PI * r * r * h }
}

/// A bowl on a flat base of 4 mm. Its wall is the part of a spherical shell of outer radius `r` and thickness `t` below
/// height `h`.
pub fn round_bowl(foot: DVec3, r: f64, h: f64, t: f64) -> Shape {
    let center = r - 0.004;
    let sdf = move |p: DVec3| {
        let q = p - foot;
        let from_center = (q - DVec3::Z * center).length();
        (from_center - r).max((r - t) - from_center).max(q.z - h).max(-q.z)
    };
    // Volume of a ball of radius `r` with its centre at height `center`, between two heights.
    let segment = move |r: f64, low: f64, high: f64| {
        let integral = |z: f64| PI * (r * r * z - (z - center).powi(3) / 3.0);
        integral(high) - integral(low)
    };
    let volume = segment(r, 0.0, h) - segment(r - t, (center - (r - t)).max(0.0), h);
    Shape { name: "bowl", sdf: Box::new(sdf), volume }
}

/// A mug without a handle: a cup of wall and floor thickness `t`.
pub fn cup(foot: DVec3, r: f64, h: f64, t: f64) -> Shape {
    let sdf = move |p: DVec3| {
        let q = p - foot;
        let radial = q.x.hypot(q.y);
        let outer = (radial - r).max((q.z - 0.5 * h).abs() - 0.5 * h);
        let hollow = (radial - (r - t)).max(t - q.z);
        outer.max(-hollow)
    };
    let inner = r - t;
    Shape { name: "cup", sdf: Box::new(sdf), volume: PI * (r * r * h - inner * inner * (h - t)) }
}

/// An L that stands on its foot: a long arm along x and a tower at its −x end.
pub fn bracket(foot: DVec3, length: f64, width: f64, thick: f64, height: f64) -> Shape {
    let sdf = move |p: DVec3| {
        let q = p - foot;
        let arm = box_sdf(q - DVec3::Z * (0.5 * thick), DVec3::new(0.5 * length, 0.5 * width, 0.5 * thick));
        let at = DVec3::new(-0.5 * (length - thick), 0.0, 0.5 * height);
        let tower = box_sdf(q - at, DVec3::new(0.5 * thick, 0.5 * width, 0.5 * height));
        arm.min(tower)
    };
    let volume = width * (length * thick + thick * (height - thick));
    Shape { name: "bracket", sdf: Box::new(sdf), volume }
}

/// A torus lying flat.
pub fn torus(foot: DVec3, ring: f64, tube: f64) -> Shape {
    let center = foot + DVec3::Z * tube;
    let sdf = move |p: DVec3| {
        let q = p - center;
        (q.x.hypot(q.y) - ring).hypot(q.z) - tube
    };
    Shape { name: "torus", sdf: Box::new(sdf), volume: 2.0 * PI * PI * ring * tube * tube }
}

/// An ellipsoid.
pub fn ellipsoid(center: DVec3, half: DVec3) -> Shape {
    let sdf = move |p: DVec3| {
        let q = p - center;
        let (k0, k1) = ((q / half).length(), (q / (half * half)).length());
        k0 * (k0 - 1.0) / k1.max(1e-9)
    };
    Shape { name: "egg", sdf: Box::new(sdf), volume: 4.0 / 3.0 * PI * half.x * half.y * half.z }
}

/// Parameters of the cameras and the noise.
pub struct Observation {
    pub frames: usize,
    pub width: usize,
    pub height: usize,
    /// Depth noise, one standard deviation at 1 m, growing with the square of depth.
    pub noise: f64,
    /// Metres between Gaussians.
    pub pitch: f64,
    /// Noise of the Gaussians' centres along the normal, metres.
    pub position_noise: f64,
    /// Noise of the Gaussians' normals, radians.
    pub normal_noise: f64,
    /// Camera distance.
    pub distance: f64,
    /// Elevation of all cameras over the horizon, radians; `None` for three rings.
    pub elevation: Option<f64>,
    /// Azimuth range, radians.
    pub arc: f64,
}

impl Default for Observation {
    fn default() -> Self {
        Self {
            frames: 16,
            width: 200,
            height: 150,
            noise: 0.0015,
            pitch: 0.004,
            position_noise: 0.0008,
            normal_noise: 0.15,
            distance: 0.55,
            elevation: None,
            arc: 2.0 * PI,
        }
    }
}

pub struct Fixture {
    pub sequence: Sequence,
    pub labels: Labels,
    pub model: GaussianModel,
}

fn gauss(rng: &mut sms_core::StageRng) -> f64 {
    (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
}

fn gradient(sdf: &dyn Fn(DVec3) -> f64, p: DVec3) -> DVec3 {
    let e = 1e-6;
    DVec3::from_array([DVec3::X, DVec3::Y, DVec3::Z].map(|a| sdf(p + a * e) - sdf(p - a * e)))
        .normalize_or_zero()
}

/// Objects (labels 1, 2, …) and unlabelled `clutter` on the floor z = 0.
pub fn observe(objects: &[Shape], clutter: &[Shape], how: &Observation, seed: u64) -> Fixture {
    let mut rng = Seed(seed).rng();
    let all = |p: DVec3| -> (f64, u16) {
        let mut best = (p.z, 0u16);
        for (i, s) in objects.iter().enumerate() {
            let d = (s.sdf)(p);
            if d < best.0 {
                best = (d, i as u16 + 1);
            }
        }
        clutter.iter().fold(best, |b, s| {
            let d = (s.sdf)(p);
            if d < b.0 { (d, 0) } else { b }
        })
    };
    let k = Intrinsics::from_fov(how.width, how.height, 1.0);
    let (mut frames, mut maps) = (Vec::new(), Vec::new());
    let mut model = GaussianModel::default();
    let mut taken = std::collections::BTreeSet::new();
    for f in 0..how.frames {
        let azimuth = how.arc * (f as f64 / how.frames as f64 - 0.5);
        let elevation = how.elevation.unwrap_or([0.75, 0.45, 1.0][f % 3]);
        let eye =
            DVec3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        let camera = Camera::look_at(k, eye * how.distance, DVec3::Z * 0.03, DVec3::Z);
        let mut depth = Image::filled(how.width, how.height, 0.0f32);
        let mut normal_c = Image::filled(how.width, how.height, [0.0f32; 3]);
        let mut map = Image::filled(how.width, how.height, 0u16);
        for y in 0..how.height {
            for x in 0..how.width {
                let origin = camera.center_w();
                let direction = (camera.unproject_pixel(x, y, 1.0) - origin).normalize();
                let (mut t, mut hit) = (0.05, None);
                for _ in 0..300 {
                    let (d, label) = all(origin + direction * t);
                    if d < 1e-5 {
                        hit = Some(label);
                        break;
                    }
                    t += 0.9 * d;
                    if t > 3.0 {
                        break;
                    }
                }
                let Some(label) = hit else { continue };
                let p = origin + direction * t;
                let z = camera.x_wc.inverse_transform_point(p).z;
                let n = gradient(&|q| all(q).0, p);
                map[(x, y)] = label;
                depth[(x, y)] = (z + how.noise * z * z * gauss(&mut rng)) as f32;
                let n_c = camera.x_wc.rotation.inverse() * n;
                normal_c[(x, y)] = n_c.as_vec3().to_array();
                let cell = (p / how.pitch).floor().to_array().map(|v| v as i64);
                if taken.insert((cell, label)) {
                    let jitter = DVec3::new(gauss(&mut rng), gauss(&mut rng), gauss(&mut rng));
                    let tilted = (n + jitter * how.normal_noise).normalize();
                    let turn = Quat::from_rotation_arc(Vec3::Z, tilted.as_vec3());
                    let sigma = (0.6 * how.pitch) as f32;
                    model.positions_w.push((p + n * how.position_noise * gauss(&mut rng)).as_vec3());
                    model.rotations_wg.push(turn);
                    model.scales.push(Vec3::new(sigma, sigma, 0.1 * sigma));
                    model.opacities.push(0.8);
                    model.colors.push([0.2 + 0.2 * f32::from(label), 0.5, 0.4]);
                    model.affinities.push([0.0; AFFINITY_DIM]);
                    model.labels.push(label);
                    model.label_confidence.push(0.95);
                }
            }
        }
        frames.push(Frame {
            index: f,
            ..Frame::new(camera, Image::filled(how.width, how.height, [120u8; 3]), depth, normal_c)
        });
        maps.push(map);
    }
    let infos = objects
        .iter()
        .enumerate()
        .map(|(i, s)| LabelInfo {
            id: i as u16 + 1,
            name: format!("{}_{}", s.name, i + 1),
            description: String::new(),
        })
        .collect();
    Fixture {
        sequence: Sequence {
            frames,
            x_world_recording: sms_core::glamx::DPose3::identity(),
            source: Default::default(),
        },
        labels: Labels { maps, objects: infos, source: MaskSource::Truth },
        model,
    }
}

/// Returns the mean and largest distance of evenly spread surface samples of `mesh` to the shape's surface, metres.
pub fn surface_error(mesh: &Mesh, shape: &Shape) -> (f64, f64) {
    let (mut sum, mut weight, mut worst) = (0.0, 0.0, 0.0f64);
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.corners(t);
        let area = (b - a).cross(c - a).length();
        for (u, v) in [(1.0 / 3.0, 1.0 / 3.0), (0.6, 0.2), (0.2, 0.6), (0.2, 0.2)] {
            let d = (shape.sdf)(a * (1.0 - u - v) + b * u + c * v).abs();
            sum += d * area;
            weight += area;
            worst = worst.max(d);
        }
    }
    (sum / weight, worst)
}

/// Returns `n` points spread evenly over the surface of a shape that lies within ±`half` of the origin. The points are
/// moved by `noise_m` along their normals, and the normals are turned by about `normal_noise_rad` about each tangent
/// axis.
pub fn sample_surface_of(
    shape: &Shape,
    half: f64,
    n: usize,
    noise_m: f64,
    normal_noise_rad: f64,
    seed: u64,
) -> PointCloud {
    const SHELL_M: f64 = 0.0008;
    let mut rng = Seed(seed).rng();
    let mut cloud = PointCloud::default();
    while cloud.points_w.len() < n {
        let mut p = DVec3::from_array(std::array::from_fn(|_| half * (2.0 * rng.random::<f64>() - 1.0)));
        // Points that are uniform in a thin shell are uniform on the surface.
        if (shape.sdf)(p).abs() > SHELL_M {
            continue;
        }
        for _ in 0..3 {
            p -= gradient(&shape.sdf, p) * (shape.sdf)(p);
        }
        let normal = gradient(&shape.sdf, p);
        if normal == DVec3::ZERO || (shape.sdf)(p).abs() > 1e-5 {
            continue;
        }
        let (u, v) = (normal.any_orthonormal_vector(), normal.cross(normal.any_orthonormal_vector()));
        let turned = normal + (u * gauss(&mut rng) + v * gauss(&mut rng)) * normal_noise_rad;
        cloud.points_w.push(p + normal * (noise_m * gauss(&mut rng)));
        cloud.normals_w.push(turned.normalize());
        cloud.colors.push([128; 3]);
    }
    cloud
}
