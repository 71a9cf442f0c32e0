//! Ray-cast scenes with known masks, for tests: a table (z = 0) recorded by a noisy depth camera on an arc.

use glamx::{DPose3, DVec3};
use rand::RngExt;
use sms_core::{Camera, Image, Intrinsics, LabelMap, Labels, Seed};
use sms_frames::{Frame, Sequence};

/// A solid on the table.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Solid {
    /// Centre and radius.
    Sphere(DVec3, f64),
    /// Centre, half extents, turn about z in radians.
    Box(DVec3, DVec3, f64),
    /// A cylinder: its centre, half of its axis, its radius.
    Rod(DVec3, DVec3, f64),
    /// An upright cup, open at the top, with walls and floor 4 mm thick: centre of its base, radius, height.
    Cup(DVec3, f64, f64),
}

/// Errors of the depth camera.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sensor {
    /// Standard deviation at 1 m; grows with the square of depth.
    pub(crate) sigma_1m: f64,
    /// Share of pixels without depth.
    pub(crate) missing: f64,
    /// Frames on the arc.
    pub(crate) frames: usize,
    /// Image width and height.
    pub(crate) size: (usize, usize),
}

impl Default for Sensor {
    fn default() -> Self {
        Self { sigma_1m: 0.002, missing: 0.05, frames: 24, size: (320, 200) }
    }
}

/// Frames of a given size without depth, for the tests of readers.
pub(crate) fn blank_sequence(frames: usize, width: usize, height: usize) -> Sequence {
    let camera = Camera::new(Intrinsics::from_fov(width, height, 1.0), DPose3::identity());
    let frame = |index| Frame {
        index,
        color_path: format!("color/{index:06}.png").into(),
        ..Frame::new(
            camera,
            Image::filled(width, height, [0; 3]),
            Image::filled(width, height, 0.0),
            Image::filled(width, height, [0.0; 3]),
        )
    };
    Sequence {
        frames: (0..frames).map(frame).collect(),
        x_world_recording: DPose3::identity(),
        source: "fixture".into(),
    }
}

/// Returns the distance along a unit-speed ray to a solid's surface.
fn hit(solid: &Solid, o: DVec3, d: DVec3) -> Option<f64> {
    match *solid {
        Solid::Sphere(c, r) => {
            let (oc, dd) = (o - c, d.dot(d));
            let b = oc.dot(d) / dd;
            let disc = b * b - (oc.dot(oc) - r * r) / dd;
            (disc > 0.0).then(|| -b - disc.sqrt()).filter(|&t| t > 0.0)
        }
        Solid::Box(c, half, turn) => {
            let q = glamx::DQuat::from_rotation_z(-turn);
            let (o, d) = (q * (o - c), q * d);
            let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
            for k in 0..3 {
                let (a, b) = ((-half[k] - o[k]) / d[k], (half[k] - o[k]) / d[k]);
                near = near.max(a.min(b));
                far = far.min(a.max(b));
            }
            (near < far && near > 0.0).then_some(near)
        }
        Solid::Rod(c, half, r) => {
            let (oc, axis) = (o - c, half.normalize());
            let (o_along, d_along) = (oc.dot(axis), d.dot(axis));
            // In the plane across the axis, a disc.
            let (o, d) = (oc - axis * o_along, d - axis * d_along);
            let (a, b) = (d.dot(d), o.dot(d));
            let disc = b * b - a * (o.dot(o) - r * r);
            let round = (disc > 0.0).then(|| [(-b - disc.sqrt()) / a, (-b + disc.sqrt()) / a])?;
            let ends = [-1.0, 1.0].map(|side| (side * half.length() - o_along) / d_along);
            let near = round[0].max(ends[0].min(ends[1]));
            (near < round[1].min(ends[0].max(ends[1])) && near > 0.0).then_some(near)
        }
        Solid::Cup(base, r, height) => {
            const WALL: f64 = 0.004;
            let o = o - base;
            let at = |t: f64| o + d * t;
            // Both walls of the cup, where the ray leaves the inner cylinder and enters the outer one.
            let wall = |r: f64, side: f64, low: f64| {
                let (a, b) = (d.truncate().length_squared(), o.truncate().dot(d.truncate()));
                let disc = b * b - a * (o.truncate().length_squared() - r * r);
                (disc > 0.0)
                    .then(|| (-b + side * disc.sqrt()) / a)
                    .filter(|&t| (low..height).contains(&at(t).z))
            };
            let level = |z: f64, radii: std::ops::Range<f64>| {
                Some((z - o.z) / d.z).filter(|&t| radii.contains(&at(t).truncate().length()))
            };
            [
                wall(r, -1.0, 0.0),
                wall(r - WALL, 1.0, WALL),
                level(height, r - WALL..r),
                level(WALL, 0.0..r - WALL),
            ]
            .into_iter()
            .flatten()
            .filter(|&t| t > 0.0)
            .min_by(f64::total_cmp)
        }
    }
}

/// Returns the noisy sequence and its true masks (value = index of the solid + 1).
pub(crate) fn scene(solids: &[Solid], sensor: Sensor, seed: u64) -> (Sequence, Vec<LabelMap>) {
    let (width, height) = sensor.size;
    let k = Intrinsics::from_fov(width, height, 1.05);
    let mut sequence = blank_sequence(sensor.frames, width, height);
    let mut truth = Vec::new();
    for frame in &mut sequence.frames {
        let angle = std::f64::consts::TAU * frame.index as f64 / sensor.frames as f64;
        let lift = 0.75 + 0.15 * (3.0 * angle).sin();
        let eye_w = DVec3::new(0.8 * angle.cos(), 0.8 * angle.sin(), lift);
        frame.camera = Camera::look_at(k, eye_w, DVec3::new(0.0, 0.0, 0.03), DVec3::Z);
        let mut rng = Seed(seed).derive_index("fixture", frame.index as u64).rng();
        let mut labels = Image::filled(width, height, 0);
        for y in 0..height {
            for x in 0..width {
                // At depth 1 along the camera's axis, so that the ray's parameter is the depth.
                let d = frame.camera.unproject_pixel(x, y, 1.0) - eye_w;
                let floor = -eye_w.z / d.z;
                let (mut z, mut label) = if floor > 0.0 { (floor, 0) } else { (0.0, 0) };
                for (i, solid) in solids.iter().enumerate() {
                    if let Some(t) = hit(solid, eye_w, d).filter(|&t| z == 0.0 || t < z) {
                        (z, label) = (t, i as u16 + 1);
                    }
                }
                let (u1, u2): (f64, f64) = (rng.random::<f64>().max(1e-12), rng.random());
                let normal = (-2.0 * u1.ln()).sqrt() * (std::f64::consts::TAU * u2).cos();
                let lost = rng.random::<f64>() < sensor.missing;
                labels[(x, y)] = label;
                let measured = z + normal * sensor.sigma_1m * z * z;
                frame.depth[(x, y)] = if lost || z <= 0.0 { 0.0 } else { measured as f32 };
                let shade = 60 + 40 * (label % 5) as u8;
                frame.color[(x, y)] = [shade, 255 - shade, 90];
            }
        }
        truth.push(labels);
    }
    (sequence, truth)
}

/// Returns the intersection over union of a true label (over all frames) with the found label of most overlap, and
/// that label.
pub(crate) fn best_iou(truth: &[LabelMap], value: u16, found: &Labels) -> (f64, u16) {
    let classes = found.class_count();
    let (mut both, mut area, mut own) = (vec![0usize; classes], vec![0usize; classes], 0usize);
    for (t, f) in truth.iter().zip(&found.maps) {
        for (&t, &f) in t.data.iter().zip(&f.data) {
            own += usize::from(t == value);
            area[usize::from(f)] += 1;
            both[usize::from(f)] += usize::from(t == value);
        }
    }
    (1..classes)
        .map(|id| (both[id] as f64 / (own + area[id] - both[id]) as f64, id as u16))
        .fold((0.0, 0), |best, next| if next.0 > best.0 { next } else { best })
}

/// Five separate solids of the sizes in billiards scenes.
pub(crate) fn table_scene() -> Vec<Solid> {
    let on = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    vec![
        Solid::Sphere(on(0.0, 0.0, 0.0286), 0.0286),
        Solid::Sphere(on(0.15, 0.05, 0.0286), 0.0286),
        Solid::Box(on(-0.15, 0.1, 0.05), on(0.03, 0.04, 0.05), 0.4),
        Solid::Box(on(0.05, -0.18, 0.02), on(0.06, 0.035, 0.02), -0.7),
        Solid::Box(on(-0.12, -0.12, 0.035), on(0.02, 0.02, 0.035), 0.0),
    ]
}
