//! A small analytic recording: a textured floor (z = 0) with a ball and a box on it, ray-cast with pixel centres at
//! +0.5 and noise along the depth axis.

use glamx::{DVec3, Vec3};
use rand::RngExt;
use sms_core::{Camera, Image, Intrinsics, LabelInfo, Labels, MaskSource, Seed};
use sms_frames::{DepthNoise, Frame, Sequence, normals_from_depth};

/// Label of the ball.
pub(crate) const BALL: u16 = 1;
/// Label of the box.
pub(crate) const BOX: u16 = 2;
/// Centre of the ball, metres.
pub(crate) const BALL_CENTER: DVec3 = DVec3::new(-0.05, 0.02, 0.03);
/// Radius of the ball, metres.
pub(crate) const BALL_RADIUS: f64 = 0.03;
/// Centre and half extents of the box, metres.
pub(crate) const BOX_CENTER: DVec3 = DVec3::new(0.06, -0.01, 0.025);
pub(crate) const BOX_HALF: DVec3 = DVec3::new(0.03, 0.04, 0.025);

/// Parameters of the recording.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Recorded {
    pub(crate) frames: usize,
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Depth noise, standard deviation in metres.
    pub(crate) noise_m: f64,
}

/// 160 × 100 pixels, eight frames, 1 mm of noise.
pub(crate) const SMALL: Recorded = Recorded { frames: 8, width: 160, height: 100, noise_m: 0.001 };

/// Returns the signed distance of a point to the true surface of the object `label`, positive outside.
pub(crate) fn signed_distance_m(label: u16, p_w: Vec3) -> f64 {
    let p = p_w.as_dvec3();
    match label {
        BALL => (p - BALL_CENTER).length() - BALL_RADIUS,
        BOX => {
            let q = (p - BOX_CENTER).abs() - BOX_HALF;
            q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
        }
        _ => p.z,
    }
}

/// The nearest hit of a ray: (distance in units of `d`, label, normal).
fn cast(o: DVec3, d: DVec3) -> Option<(f64, u16, DVec3)> {
    let mut hits = Vec::new();
    if d.z < 0.0 {
        hits.push((-o.z / d.z, 0, DVec3::Z));
    }
    let (oc, a) = (o - BALL_CENTER, d.length_squared());
    let (b, c) = (oc.dot(d), oc.length_squared() - BALL_RADIUS * BALL_RADIUS);
    if b * b > a * c {
        let t = (-b - (b * b - a * c).sqrt()) / a;
        hits.push((t, BALL, (o + d * t - BALL_CENTER) / BALL_RADIUS));
    }
    let (low, high) = ((BOX_CENTER - BOX_HALF - o) / d, (BOX_CENTER + BOX_HALF - o) / d);
    let (near, far) = (low.min(high), low.max(high));
    let t = near.max_element();
    if t < far.min_element() {
        let axis = near.to_array().iter().position(|v| *v == t).unwrap_or(0);
        hits.push((t, BOX, -DVec3::AXES[axis] * d[axis].signum()));
    }
    hits.into_iter().filter(|h| h.0 > 0.0).min_by(|x, y| x.0.total_cmp(&y.0))
}

fn color(label: u16, p: DVec3, n: DVec3) -> [u8; 3] {
    let waves =
        |s: f64| 0.5 + 0.25 * (s * p.x).sin() * (s * p.y + 1.0).cos() + 0.25 * (0.7 * s * (p.z + p.x)).sin();
    let albedo = match label {
        BALL => DVec3::new(0.9, 0.3 + 0.3 * waves(150.0), 0.2),
        BOX => DVec3::new(0.2, 0.4, 0.5 + 0.4 * waves(200.0)),
        _ => DVec3::splat(0.35 + 0.4 * waves(90.0)),
    };
    let light = 0.35 + 0.65 * n.dot(DVec3::new(0.3, -0.4, 0.87).normalize()).max(0.0);
    (albedo * light * 255.0).to_array().map(|v| v.round().clamp(0.0, 255.0) as u8)
}

/// Returns the recording and its true labels. The cameras move on an arc of 100° around the objects.
pub(crate) fn record(r: Recorded) -> (Sequence, Labels) {
    let k = Intrinsics::from_fov(r.width, r.height, 0.65);
    let (mut frames, mut maps) = (Vec::new(), Vec::new());
    for index in 0..r.frames {
        let angle = (-140.0 + 100.0 * index as f64 / (r.frames - 1).max(1) as f64).to_radians();
        let eye = DVec3::new(0.45 * angle.cos(), 0.45 * angle.sin(), 0.35);
        let camera = Camera::look_at(k, eye, DVec3::new(0.0, 0.0, 0.02), DVec3::Z);
        let mut rng = Seed(17).derive_index("noise", index as u64).rng();
        let mut color_image = Image::filled(r.width, r.height, [0u8; 3]);
        let mut depth = Image::filled(r.width, r.height, 0.0f32);
        let mut label_map = Image::filled(r.width, r.height, 0u16);
        for y in 0..r.height {
            for x in 0..r.width {
                // The ray has depth 1, so that the parameter of a hit is its depth.
                let direction = camera.unproject_pixel(x, y, 1.0) - eye;
                let noise: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
                let Some((t, label, normal)) = cast(eye, direction) else { continue };
                color_image[(x, y)] = color(label, eye + direction * t, normal);
                depth[(x, y)] = (t + r.noise_m * noise) as f32;
                label_map[(x, y)] = label;
            }
        }
        let normal_c = normals_from_depth(&depth, &k, &DepthNoise::default(), 2);
        maps.push(label_map);
        frames.push(Frame {
            index,
            color_path: format!("{index:06}.png").into(),
            ..Frame::new(camera, color_image, depth, normal_c)
        });
    }
    let object = |id: u16, name: &str| LabelInfo { id, name: name.to_owned(), description: String::new() };
    let labels =
        Labels { maps, objects: vec![object(BALL, "ball"), object(BOX, "box")], source: MaskSource::Truth };
    let sequence =
        Sequence { frames, x_world_recording: glamx::DPose3::identity(), source: "fixture".into() };
    (sequence, labels)
}
