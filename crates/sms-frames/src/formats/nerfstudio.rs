//! nerfstudio's `transforms.json` with depth.
//!
//! Keys read: intrinsics (`fl_x`, `fl_y`, `cx`, `cy`, `w`, `h`, `k1` … `p2`, or `camera_angle_x`), for all frames or
//! in each; `frames[].{file_path, depth_file_path, mask_path, transform_matrix, time}`; `depth_unit_scale_factor`.
//! `applied_transform` is not undone: the recording's world is that of the written poses, and alignment removes
//! any rigid change of it. `applied_scale` is undone, because the world must be metric.
//! Beyond nerfstudio: `camera_convention` ("opengl", "opencv"), `pose_convention` ("camera_to_world",
//! "world_to_camera"), `pixel_center`, `world_up`, `world_is_aligned`, and for depth images of another size
//! `depth_fl_x`, `depth_fl_y`, `depth_cx`, `depth_cy` or `depth_same_field_of_view`.

use super::to_opencv;
use crate::depth_file::depth_size;
use crate::recording::{Notice, RecordedFrame, Recording, RecordingFormat};
use crate::rigid::pose_from_rows;
use crate::{Axes, Distortion, FramesError, Lens, PoseDirection, ReadOptions};
use glamx::{DPose3, DVec3};
use rayon::prelude::*;
use serde::Deserialize;
use sms_core::{CoreError, InputError, Intrinsics, read_color_size};
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, Default, Deserialize)]
struct CameraKeys {
    camera_model: Option<String>,
    camera_angle_x: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    depth_fl_x: Option<f64>,
    depth_fl_y: Option<f64>,
    depth_cx: Option<f64>,
    depth_cy: Option<f64>,
}

#[derive(Debug, Deserialize)]
struct FrameKeys {
    file_path: String,
    depth_file_path: Option<String>,
    mask_path: Option<String>,
    transform_matrix: Option<Vec<Vec<f64>>>,
    time: Option<f64>,
    #[serde(flatten)]
    camera: CameraKeys,
}

#[derive(Debug, Deserialize)]
struct TransformsJson {
    #[serde(flatten)]
    camera: CameraKeys,
    depth_unit_scale_factor: Option<f64>,
    camera_convention: Option<String>,
    pose_convention: Option<String>,
    pixel_center: Option<f64>,
    world_up: Option<[f64; 3]>,
    #[serde(default)]
    world_is_aligned: bool,
    #[serde(default)]
    depth_same_field_of_view: bool,
    applied_scale: Option<f64>,
    #[serde(default)]
    frames: Vec<FrameKeys>,
}

/// The keys of a frame, completed by those of the file.
struct FrameCamera<'a> {
    own: &'a CameraKeys,
    shared: &'a CameraKeys,
}

impl FrameCamera<'_> {
    fn get(&self, key: fn(&CameraKeys) -> Option<f64>) -> Option<f64> {
        key(self.own).or_else(|| key(self.shared))
    }
}

struct Reader<'a> {
    dir: &'a Path,
    json: PathBuf,
    options: &'a ReadOptions,
    /// Offset added to recorded principal points so that pixel centres lie at +0.5.
    center_shift: f64,
    same_field_of_view: bool,
    has_poses: bool,
}

pub(crate) fn open(dir: &Path, options: &ReadOptions) -> Result<Recording, FramesError> {
    let json = dir.join("transforms.json");
    let text = std::fs::read_to_string(&json).map_err(CoreError::read(&json))?;
    let all: TransformsJson = serde_json::from_str(&text).map_err(|e| parse_error(&json, &text, &e))?;
    if all.frames.is_empty() {
        let cure =
            "\"frames\" must list at least one frame with file_path, depth_file_path and transform_matrix";
        return Err(InputError::new("the recording has no frames", &json, cure).into());
    }
    let mut notices = Vec::new();
    let axes = options.axes.map_or_else(|| declared_axes(all.camera_convention.as_deref(), &json), Ok)?;
    let poses =
        options.poses.map_or_else(|| declared_direction(all.pose_convention.as_deref(), &json), Ok)?;
    let depth_unit_m = match options.depth_unit_m.or(all.depth_unit_scale_factor) {
        Some(unit) => positive(unit, "depth_unit_scale_factor", &json)?,
        None => {
            notices.push(Notice {
                code: "assumed_depth_unit",
                message: "transforms.json does not state the depth unit; millimetres are assumed".to_owned(),
                cure: "add \"depth_unit_scale_factor\": 0.001 (metres of one unit)".to_owned(),
            });
            0.001
        }
    };
    let pixel_center = options.pixel_center.or(all.pixel_center).unwrap_or(0.5);
    let scale = positive(all.applied_scale.unwrap_or(1.0), "applied_scale", &json)?;
    let no_direction =
        || InputError::new("\"world_up\" is not a direction", &json, "give three numbers, e.g. [0, 0, 1]");
    let direction = |up| DVec3::from_array(up).try_normalize().ok_or_else(no_direction);
    let world_up_r = all.world_up.map(direction).transpose()?;
    let reader = Reader {
        dir,
        json: json.clone(),
        options,
        center_shift: 0.5 - pixel_center,
        same_field_of_view: options.depth_same_field_of_view || all.depth_same_field_of_view,
        has_poses: !options.ignore_poses && all.frames.iter().any(|f| f.transform_matrix.is_some()),
    };
    let read: Vec<Result<RecordedFrame, FramesError>> =
        all.frames.par_iter().enumerate().map(|(i, f)| reader.frame(i, f, &all.camera)).collect();
    let mut frames = read.into_iter().collect::<Result<Vec<_>, _>>()?;
    let start = frames.iter().filter_map(|f| f.time_s).fold(f64::INFINITY, f64::min);
    for frame in &mut frames {
        if reader.has_poses {
            frame.x_rc.translation /= scale;
            frame.x_rc = to_opencv(frame.x_rc, axes, poses);
        }
        frame.time_s = frame.time_s.map(|t| t - start);
    }
    Ok(Recording {
        root: dir.to_owned(),
        format: RecordingFormat::Nerfstudio,
        frames,
        depth_unit_m,
        axes,
        poses,
        has_poses: reader.has_poses,
        pixel_center,
        world_up_r,
        world_is_aligned: all.world_is_aligned,
        notices,
        options: options.clone(),
    })
}

fn parse_error(json: &Path, text: &str, error: &serde_json::Error) -> InputError {
    let line = text.lines().nth(error.line().saturating_sub(1)).unwrap_or_default();
    let words = ["nan", "infinity", "inf"];
    let holds_nan = line.to_lowercase().split(|c: char| !c.is_alphabetic()).any(|w| words.contains(&w));
    let error_text = error.to_string();
    if holds_nan || error_text.contains("number out of range") {
        InputError::new(
            format!("line {} of this file holds a number that is not finite", error.line()),
            json,
            "export the recording again, or remove the frame without a pose",
        )
    } else {
        InputError::new(
            "this file does not describe a recording",
            json,
            "it must be JSON with intrinsics and \"frames\", each with file_path, depth_file_path and \
             transform_matrix",
        )
    }
    .because(error_text)
}

fn positive(value: f64, key: &str, json: &Path) -> Result<f64, InputError> {
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    Err(InputError::new(format!("\"{key}\" is {value}"), json, format!("set \"{key}\" to a positive number")))
}

fn declared_axes(text: Option<&str>, json: &Path) -> Result<Axes, InputError> {
    let Some(text) = text else { return Ok(Axes::Opengl) };
    let lower = text.to_lowercase();
    match (lower.contains("opengl"), lower.contains("opencv")) {
        (true, false) => Ok(Axes::Opengl),
        (false, true) => Ok(Axes::Opencv),
        _ => Err(InputError::new(
            format!("\"camera_convention\" is \"{text}\", which names no known axes"),
            json,
            "write \"opengl\" (x right, y up, z backward) or \"opencv\" (x right, y down, z forward)",
        )),
    }
}

fn declared_direction(text: Option<&str>, json: &Path) -> Result<PoseDirection, InputError> {
    let Some(text) = text else { return Ok(PoseDirection::CameraToWorld) };
    match text.to_lowercase().replace([' ', '-'], "_").as_str() {
        "camera_to_world" | "c2w" => Ok(PoseDirection::CameraToWorld),
        "world_to_camera" | "w2c" => Ok(PoseDirection::WorldToCamera),
        _ => Err(InputError::new(
            format!("\"pose_convention\" is \"{text}\", which is not a known convention"),
            json,
            "write \"camera_to_world\" or \"world_to_camera\"",
        )),
    }
}

impl Reader<'_> {
    fn frame(&self, index: usize, frame: &FrameKeys, all: &CameraKeys) -> Result<RecordedFrame, FramesError> {
        let color_path = self.resolve(&frame.file_path);
        let Some(depth_name) = &frame.depth_file_path else {
            let what = format!("frame {index} ({}) has no depth", frame.file_path);
            let cure = "add \"depth_file_path\" to every frame: RGB-D recordings are required";
            return Err(InputError::new(what, &self.json, cure).into());
        };
        let depth_path = self.resolve(depth_name);
        let mask_path = frame.mask_path.as_deref().map(|m| self.resolve(m));
        let color = read_color_size(&color_path)?;
        let depth = depth_size(&depth_path)?;
        let keys = FrameCamera { own: &frame.camera, shared: all };
        let color_lens = self.color_lens(&keys, color, &color_path)?;
        let depth_lens = self.depth_lens(&keys, &color_lens, depth, &depth_path)?;
        let (x_rc, pose_rounding) = self.pose(index, frame)?;
        Ok(RecordedFrame {
            color_path,
            depth_path,
            mask_path,
            color_lens,
            depth_lens,
            x_rc,
            pose_rounding,
            time_s: frame.time,
        })
    }

    /// Returns the pose as written, and its rounding.
    fn pose(&self, index: usize, frame: &FrameKeys) -> Result<(DPose3, f64), InputError> {
        if !self.has_poses {
            return Ok((DPose3::identity(), 0.0));
        }
        let Some(rows) = &frame.transform_matrix else {
            let what = format!("frame {index} ({}) has no pose, but others have", frame.file_path);
            let cure =
                "add transform_matrix to this frame, remove it, or estimate all poses (--poses estimate)";
            return Err(InputError::new(what, &self.json, cure));
        };
        pose_from_rows(rows).map_err(|why| {
            InputError::new(
                format!("the pose of frame {index} ({}) is not a rigid transform", frame.file_path),
                &self.json,
                "export this pose again: transform_matrix must be a rotation and a translation in metres; remove \
                 the frame; or estimate all poses (--poses estimate)",
            )
            .because(why)
        })
    }

    /// Resolves the file that a key names; nerfstudio allows a missing extension.
    fn resolve(&self, name: &str) -> PathBuf {
        let name = name.replace('\\', "/");
        let path = self.dir.join(name.strip_prefix("./").unwrap_or(&name));
        if !path.exists() && path.extension().is_none() {
            for extension in ["png", "jpg", "jpeg"] {
                let with = path.with_extension(extension);
                if with.exists() {
                    return with;
                }
            }
        }
        path
    }

    fn color_lens(
        &self,
        keys: &FrameCamera<'_>,
        size: (usize, usize),
        image: &Path,
    ) -> Result<Lens, FramesError> {
        let json = &self.json;
        if let Some(model) = keys.own.camera_model.as_ref().or(keys.shared.camera_model.as_ref())
            && !["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"].contains(&model.as_str())
        {
            let what = format!("the camera model {model} is not supported");
            let cure = "undistort the recording to the PINHOLE or OPENCV model";
            return Err(InputError::new(what, json, cure).into());
        }
        if let (Some(w), Some(h)) = (keys.get(|k| k.w), keys.get(|k| k.h))
            && (w.round() as usize, h.round() as usize) != size
        {
            let what = format!("the image is {} × {} but its intrinsics are for {w} × {h}", size.0, size.1);
            let cure = "restore the image at its original size, or scale w, h, fl_x, fl_y, cx and cy in \
                        transforms.json to the image";
            return Err(InputError::new(what, image, cure).into());
        }
        let by_angle = |angle: f64| 0.5 * size.0 as f64 / (0.5 * angle).tan();
        let fx = keys.get(|k| k.fl_x).or(keys.get(|k| k.camera_angle_x).map(by_angle));
        let Some(values) = self.options.intrinsics.or(fx.map(|fx| {
            // Without a principal point the image centre is used, regardless of the pixel-centre convention.
            let middle = |n: usize| 0.5 * n as f64 - self.center_shift;
            let cx = keys.get(|k| k.cx).unwrap_or(middle(size.0));
            let cy = keys.get(|k| k.cy).unwrap_or(middle(size.1));
            [fx, keys.get(|k| k.fl_y).unwrap_or(fx), cx, cy]
        })) else {
            let cure = "add fl_x, fl_y, cx and cy in pixels, for all frames or in each";
            return Err(InputError::new("the camera's focal length is missing", json, cure).into());
        };
        let stated: [fn(&CameraKeys) -> Option<f64>; 5] = [|k| k.k1, |k| k.k2, |k| k.p1, |k| k.p2, |k| k.k3];
        let stated = stated.map(|key| keys.get(key).unwrap_or(0.0));
        let distortion = Distortion::from_opencv(self.options.distortion.unwrap_or(stated));
        Ok(Lens { intrinsics: checked_intrinsics(size, values, self.center_shift, json)?, distortion })
    }

    fn depth_lens(
        &self,
        keys: &FrameCamera<'_>,
        color: &Lens,
        size: (usize, usize),
        image: &Path,
    ) -> Result<Lens, FramesError> {
        let k = &color.intrinsics;
        let (fx, fy) = (keys.get(|k| k.depth_fl_x), keys.get(|k| k.depth_fl_y));
        if let (Some(fx), Some(cx), Some(cy)) = (fx, keys.get(|k| k.depth_cx), keys.get(|k| k.depth_cy)) {
            let values = [fx, fy.unwrap_or(fx), cx, cy];
            let intrinsics = checked_intrinsics(size, values, self.center_shift, &self.json)?;
            return Ok(Lens { intrinsics, distortion: Distortion::default() });
        }
        if size == (k.width, k.height) {
            return Ok(*color);
        }
        if self.same_field_of_view {
            return Ok(Lens { intrinsics: k.scaled_to(size.0, size.1), distortion: color.distortion });
        }
        let cure = "add depth_fl_x, depth_fl_y, depth_cx and depth_cy to transforms.json, or \
                    \"depth_same_field_of_view\": true when one is the other scaled";
        Err(not_registered(size, (k.width, k.height), image, cure).into())
    }
}

/// The error for depth and colour images of different size with unknown correspondence.
pub(crate) fn not_registered(
    depth: (usize, usize),
    color: (usize, usize),
    depth_image: &Path,
    cure: &str,
) -> InputError {
    let ((dw, dh), (cw, ch)) = (depth, color);
    let what = format!(
        "the depth image is {dw} × {dh} and the colour image {cw} × {ch}, with unknown correspondence"
    );
    InputError::new(what, depth_image, cure)
}

/// Returns the intrinsics of an image of width × height pixels; `shift` is added to the principal point. Rejects
/// implausible values.
pub(crate) fn checked_intrinsics(
    (width, height): (usize, usize),
    [fx, fy, cx, cy]: [f64; 4],
    shift: f64,
    file: &Path,
) -> Result<Intrinsics, InputError> {
    let k = Intrinsics { width, height, fx, fy, cx: cx + shift, cy: cy + shift };
    let finite = [k.fx, k.fy, k.cx, k.cy].iter().all(|v| v.is_finite());
    let (w, h) = (k.width as f64, k.height as f64);
    let near_image = k.cx > -w && k.cx < 2.0 * w && k.cy > -h && k.cy < 2.0 * h;
    if finite && k.fx > 0.0 && k.fy > 0.0 && near_image && w > 0.0 && h > 0.0 {
        return Ok(k);
    }
    Err(InputError::new(
        format!(
            "the intrinsics fx {} fy {} cx {} cy {} do not fit a {} × {} image",
            k.fx, k.fy, k.cx, k.cy, k.width, k.height
        ),
        file,
        "give focal lengths and the principal point in pixels of the recorded image",
    ))
}
