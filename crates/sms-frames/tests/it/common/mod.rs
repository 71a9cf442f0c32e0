//! A small recording made by casting rays at a table with a ball and two boxes.

use glamx::{DMat3, DPose3, DQuat, DVec3};
use serde_json::{Value, json};
use sms_core::{Camera, ColorImage, Image, Intrinsics, write_png_color, write_png_gray16};
use std::path::Path;

pub(crate) const WIDTH: usize = 160;
pub(crate) const HEIGHT: usize = 120;

/// Recorded intrinsics with pixel centres at +0.5.
pub(crate) fn intrinsics() -> Intrinsics {
    Intrinsics { width: WIDTH, height: HEIGHT, fx: 150.0, fy: 151.0, cx: 79.3, cy: 61.2 }
}

/// How the recording is written.
#[derive(Clone)]
pub(crate) struct Written {
    pub(crate) frames: usize,
    /// Length of the camera's arc in radians; 0 for a camera that stands still.
    pub(crate) arc: f64,
    pub(crate) opencv_axes: bool,
    pub(crate) inverted: bool,
    /// Metres of a unit in the images, independent of the JSON.
    pub(crate) unit_m: f64,
    /// Pixel centre that the written cx, cy refer to.
    pub(crate) pixel_center: f64,
    /// Carries the z-up world to the recording's.
    pub(crate) x_recording_world: DPose3,
}

impl Default for Written {
    fn default() -> Self {
        Self {
            frames: 9,
            arc: 1.2,
            opencv_axes: false,
            inverted: false,
            unit_m: 0.0002,
            pixel_center: 0.5,
            x_recording_world: DPose3::identity(),
        }
    }
}

/// A camera on an arc round the table, rolling a little.
pub(crate) fn camera(i: usize, frames: usize, arc: f64) -> Camera {
    let s = if frames > 1 { i as f64 / (frames - 1) as f64 - 0.5 } else { 0.0 };
    let angle = arc * s;
    let eye = DVec3::new(0.6 * angle.sin(), -0.6 * angle.cos(), 0.38 + 0.1 * angle);
    let up = DVec3::new(0.5 * angle, 0.0, 1.0);
    Camera::look_at(intrinsics(), eye, DVec3::new(0.0, 0.0, 0.05), up)
}

/// Distance along `ray` (z component 1 in the camera) to the nearest surface, and its colour.
fn hit(origin: DVec3, ray: DVec3) -> (f64, [u8; 3]) {
    let mut best = (f64::INFINITY, [0u8; 3]);
    let mut offer = |t: f64, color: [u8; 3]| {
        if t > 1e-6 && t < best.0 {
            best = (t, color);
        }
    };
    let t = -origin.z / ray.z;
    let p = origin + ray * t;
    if p.x.abs() < 0.6 && p.y.abs() < 0.6 {
        let odd = ((p.x * 20.0).floor() + (p.y * 20.0).floor()).rem_euclid(2.0) > 0.5;
        offer(t, if odd { [180, 170, 150] } else { [90, 80, 70] });
    }
    let (center, radius) = (DVec3::new(0.1, -0.02, 0.06), 0.06);
    let d = origin - center;
    let (a, b, c) = (ray.dot(ray), d.dot(ray), d.dot(d) - radius * radius);
    if b * b > a * c {
        offer((-b - (b * b - a * c).sqrt()) / a, [200, 40, 40]);
    }
    for (low, high, color) in [
        (DVec3::new(-0.18, -0.05, 0.0), DVec3::new(-0.06, 0.05, 0.12), [40, 90, 200]),
        (DVec3::new(-0.02, 0.1, 0.0), DVec3::new(0.16, 0.2, 0.18), [60, 180, 60]),
    ] {
        let (t0, t1) = ((low - origin) / ray, (high - origin) / ray);
        let (near, far) = (t0.min(t1).max_element(), t0.max(t1).min_element());
        if near < far {
            offer(near, color);
        }
    }
    best
}

/// Colour and depth in metres (0 where nothing is hit).
pub(crate) fn render(camera: &Camera) -> (ColorImage, Image<f64>) {
    let k = camera.intrinsics;
    let mut color = Image::filled(k.width, k.height, [0u8; 3]);
    let mut depth = Image::filled(k.width, k.height, 0.0);
    for y in 0..k.height {
        for x in 0..k.width {
            let ray = camera.unproject_pixel(x, y, 1.0) - camera.center_w();
            let (t, c) = hit(camera.center_w(), ray);
            if t < 5.0 {
                depth[(x, y)] = t;
                color[(x, y)] = c;
            }
        }
    }
    (color, depth)
}

pub(crate) fn rows(pose: &DPose3) -> Value {
    let r = DMat3::from_quat(pose.rotation);
    let t = pose.translation;
    let row = |i: usize| json!([r.x_axis[i], r.y_axis[i], r.z_axis[i], t[i]]);
    json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
}

/// Writes the recording; the returned JSON is what `transforms.json` holds, for tests that spoil it.
pub(crate) fn write(dir: &Path, how: &Written) -> Value {
    let mut frames = Vec::new();
    for i in 0..how.frames {
        let camera = camera(i, how.frames, how.arc);
        let (color, depth) = render(&camera);
        let raw = depth.map(|z| (z / how.unit_m).round() as u16);
        write_png_color(&dir.join(format!("color/{i:06}.png")), &color).unwrap();
        write_png_gray16(&dir.join(format!("depth/{i:06}.png")), &raw).unwrap();
        let mut x = how.x_recording_world * camera.x_wc;
        if !how.opencv_axes {
            x.rotation *= DQuat::from_rotation_x(std::f64::consts::PI);
        }
        if how.inverted {
            x = x.inverse();
        }
        frames.push(json!({
            "file_path": format!("color/{i:06}.png"),
            "depth_file_path": format!("depth/{i:06}.png"),
            "transform_matrix": rows(&x),
        }));
    }
    let k = intrinsics();
    let shift = how.pixel_center - 0.5;
    let json = json!({
        "camera_model": "OPENCV", "w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy,
        "cx": k.cx + shift, "cy": k.cy + shift, "depth_unit_scale_factor": how.unit_m, "frames": frames,
    });
    save(dir, &json);
    json
}

pub(crate) fn save(dir: &Path, json: &Value) {
    std::fs::write(dir.join("transforms.json"), serde_json::to_string_pretty(json).unwrap()).unwrap();
}
