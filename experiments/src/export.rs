//! Export of a scene as files for other programs, with its truth.
//!
//! # Format
//! `sms-experiments scan --export DIR` writes for each scene the folder `DIR/{scene}/`:
//!
//! | file | holds |
//! |---|---|
//! | `transforms.json` | nerfstudio's layout: `fl_x fl_y cx cy w h` (pixels, `pixel_center` 0.5), `depth_unit_scale_factor` 0.0001, per frame `file_path`, `depth_file_path`, `mask_path` and `transform_matrix` (camera to world, OpenGL axes, metres); `holdout` lists the indices of the frames that must not be used |
//! | `color/NNNNNN.png` | 8-bit colour as the scan trains on it: at the preset's resolution |
//! | `depth/NNNNNN.png` | 16-bit depth in 0.1 mm as the scan trains on it, 0 for none: with noise, and disturbed if requested |
//! | `masks/NNNNNN.png` | 16-bit labels of our masks; 0 is the background, 65535 not to be used |
//! | `truth/truth.json` | names of objects, exact spheres, true poses (camera to world, OpenCV axes), the true label of each mask label |
//! | `truth/object_NN.obj` | true surface of the object with label NN |
//! | `truth/observed.ply` | samples of the observed surface: `x y z nx ny nz`, `object` (its label) |
//! | `truth/depth/NNNNNN.png`, `truth/labels/NNNNNN.png` | noise-free depth (0.1 mm) and labels of the held-out views |
//!
//! Everything is in one world: metres, z up, floor at z = 0. `sms-experiments score --truth DIR/{scene} --surface FILE --views
//! DIR` then measures another program's reconstruction (see [`score_files`](crate::score_files)).

use crate::BenchError;
use crate::options::BenchOptions;
use crate::prepare::Prepared;
use crate::reference::Yardstick;
use crate::scenes::BenchScene;
use glamx::{DMat4, DPose3, DVec3, DVec4};
use serde::{Deserialize, Serialize};
use sms_core::ply::{self, VertexColumn};
use sms_core::{
    CoreError, DepthImage, Image, InputError, LabelMap, Mesh, atomic, read_png_gray16, write_png_color,
    write_png_gray16,
};
use sms_eval::UNMATCHED;
use sms_eval::{SurfacePoint, TrueSurface, TrueView};
use std::path::Path;

/// Metres of one unit of exported depth images.
pub const DEPTH_UNIT_M: f64 = 1e-4;

/// `transforms.json`.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Transforms {
    pub(crate) scene: String,
    pub(crate) preset: String,
    camera_model: String,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    w: usize,
    h: usize,
    pixel_center: f64,
    depth_unit_scale_factor: f64,
    world_up: [f64; 3],
    world_is_aligned: bool,
    pub(crate) holdout: Vec<usize>,
    pub(crate) frames: Vec<TransformsFrame>,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct TransformsFrame {
    pub(crate) file_path: String,
    pub(crate) depth_file_path: String,
    pub(crate) mask_path: String,
    pub(crate) transform_matrix: [[f64; 4]; 4],
}

/// `truth/truth.json`.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct TruthFile {
    objects: Vec<TruthEntry>,
    /// True label of each mask label, from 0; `null` for none.
    truth_of: Vec<Option<u16>>,
    pub(crate) poses_disturbed: bool,
    /// `X_WC` of every frame as it was, rows of 4 × 4 matrices.
    pub(crate) true_x_wc: Vec<[[f64; 4]; 4]>,
}

#[derive(Debug, Serialize, Deserialize)]
struct TruthEntry {
    label: usize,
    name: String,
    mesh: String,
    sphere: Option<(DVec3, f64)>,
}

/// Writes a prepared scene with truth to `dir`.
///
/// # Errors
/// [`CoreError::Write`]; [`InputError`] for a real recording, which has no truth to export.
pub fn export_scene(
    scene: &BenchScene,
    prepared: &Prepared,
    options: &BenchOptions,
    dir: &Path,
) -> Result<(), BenchError> {
    let Some(truth) = Yardstick::new(prepared, options.scan.holdout) else {
        let cure = "export generated scenes; real recordings are nerfstudio folders as they are";
        return Err(InputError::new(format!("{scene} has no truth"), dir, cure).into());
    };
    let mut frames = Vec::new();
    for (i, frame) in prepared.sequence.frames.iter().enumerate() {
        let name = |folder: &str| format!("{folder}/{i:06}.png");
        write_png_color(&dir.join(name("color")), &frame.color)?;
        write_png_gray16(&dir.join(name("depth")), &encode_depth(&frame.depth))?;
        write_png_gray16(&dir.join(name("masks")), &prepared.labels.maps[i])?;
        let flip = DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
        frames.push(TransformsFrame {
            file_path: name("color"),
            depth_file_path: name("depth"),
            mask_path: name("masks"),
            transform_matrix: rows(&(matrix(&frame.camera.x_wc) * flip)),
        });
    }
    let x_wt = prepared.x_tw().inverse();
    let mut objects = Vec::new();
    for (i, surface) in truth.surfaces.iter().enumerate() {
        let mesh = format!("object_{:02}.obj", i + 1);
        surface.mesh.transformed(&x_wt).write_obj(&dir.join("truth").join(&mesh))?;
        let sphere = surface.sphere.map(|(c, r)| (x_wt.transform_point(c), r));
        objects.push(TruthEntry { label: i + 1, name: surface.name.clone(), mesh, sphere });
    }
    write_observed(&dir.join("truth/observed.ply"), &truth.observed, &x_wt)?;
    for (i, view) in &truth.held_out {
        write_png_gray16(&dir.join(format!("truth/depth/{i:06}.png")), &encode_depth(&view.depth))?;
        write_png_gray16(&dir.join(format!("truth/labels/{i:06}.png")), &view.label)?;
    }
    let file = TruthFile {
        objects,
        truth_of: truth.truth_of.iter().map(|&t| (t != UNMATCHED).then_some(t)).collect(),
        poses_disturbed: options.disturbance.disturbs_poses(),
        true_x_wc: prepared.true_cameras.iter().map(|c| rows(&matrix(&c.x_wc))).collect(),
    };
    atomic::write_json(&dir.join("truth/truth.json"), &file)?;
    let k = &prepared.sequence.frames[0].camera.intrinsics;
    let transforms = Transforms {
        scene: scene.to_string(),
        preset: options.preset_name().to_owned(),
        camera_model: "OPENCV".to_owned(),
        fl_x: k.fx,
        fl_y: k.fy,
        cx: k.cx,
        cy: k.cy,
        w: k.width,
        h: k.height,
        pixel_center: 0.5,
        depth_unit_scale_factor: DEPTH_UNIT_M,
        world_up: [0.0, 0.0, 1.0],
        world_is_aligned: true,
        holdout: prepared.held_out(options.scan.holdout),
        frames,
    };
    // Last: a folder with it is whole.
    atomic::write_json(&dir.join("transforms.json"), &transforms)?;
    Ok(())
}

/// An exported scene, read back to score a reconstruction.
pub(crate) struct Exported {
    pub(crate) transforms: Transforms,
    pub(crate) truth: TruthFile,
    pub(crate) yardstick: Yardstick,
}

/// Reads an export of [`export_scene`]; the yardstick is in the exported world.
pub(crate) fn read_export(dir: &Path) -> Result<Exported, BenchError> {
    let path = dir.join("truth/truth.json");
    if !path.is_file() {
        let cure = "give a scene's folder that `sms-experiments scan --export` wrote";
        return Err(InputError::new("this is not an exported scene", dir, cure).into());
    }
    let transforms: Transforms = atomic::read_json(&dir.join("transforms.json"))?;
    let truth: TruthFile = atomic::read_json(&path)?;
    let mut surfaces = Vec::new();
    for object in &truth.objects {
        let path = dir.join("truth").join(&object.mesh);
        let surface = TrueSurface::new(object.name.clone(), Mesh::read_obj(&path)?, object.sphere);
        surfaces.push(surface.ok_or_else(|| InputError::new("this mesh is empty", &path, "export again"))?);
    }
    let observed = read_observed(&dir.join("truth/observed.ply"), surfaces.len())?;
    let mut held_out = Vec::new();
    for &i in &transforms.holdout {
        let depth = decode_depth(&read_png_gray16(&dir.join(format!("truth/depth/{i:06}.png")))?);
        let label: LabelMap = read_png_gray16(&dir.join(format!("truth/labels/{i:06}.png")))?;
        held_out.push((i, TrueView { depth, label }));
    }
    let truth_of = truth.truth_of.iter().map(|t| t.unwrap_or(UNMATCHED)).collect();
    Ok(Exported { transforms, truth, yardstick: Yardstick { surfaces, observed, held_out, truth_of } })
}

fn write_observed(path: &Path, observed: &[Vec<SurfacePoint>], x_wt: &DPose3) -> Result<(), CoreError> {
    let mut columns = vec![Vec::new(); 6];
    let mut object = Vec::new();
    for (i, samples) in observed.iter().enumerate() {
        for s in samples {
            let (p, n) = (x_wt.transform_point(s.point), x_wt.rotation * s.normal);
            for (column, v) in columns.iter_mut().zip([p.x, p.y, p.z, n.x, n.y, n.z]) {
                column.push(v as f32);
            }
            object.push(i as i32 + 1);
        }
    }
    let names = ["x", "y", "z", "nx", "ny", "nz"];
    let mut table: Vec<(&str, VertexColumn)> =
        names.into_iter().zip(columns.into_iter().map(VertexColumn::F32)).collect();
    table.push(("object", VertexColumn::I32(object)));
    ply::write(path, &["surface that at least three training cameras see, world, metres"], &table)
}

fn read_observed(path: &Path, objects: usize) -> Result<Vec<Vec<SurfacePoint>>, BenchError> {
    let table = ply::read(path)?;
    let columns: Option<Vec<&[f64]>> =
        ["x", "y", "z", "nx", "ny", "nz", "object"].iter().map(|n| table.column(n)).collect();
    let Some(c) = columns else {
        return Err(InputError::new("columns are missing in this file", path, "export again").into());
    };
    let mut observed = vec![Vec::new(); objects];
    for i in 0..table.len {
        if let Some(samples) = observed.get_mut((c[6][i] as usize).wrapping_sub(1)) {
            let point = DVec3::new(c[0][i], c[1][i], c[2][i]);
            samples.push(SurfacePoint { point, normal: DVec3::new(c[3][i], c[4][i], c[5][i]) });
        }
    }
    Ok(observed)
}

fn matrix(pose: &DPose3) -> DMat4 {
    DMat4::from_rotation_translation(pose.rotation, pose.translation)
}

fn rows(matrix: &DMat4) -> [[f64; 4]; 4] {
    matrix.transpose().to_cols_array_2d()
}

/// The pose of a 4 × 4 matrix given by rows.
pub(crate) fn pose_of_rows(rows: &[[f64; 4]; 4]) -> DPose3 {
    DPose3::from_mat4(DMat4::from_cols_array_2d(rows).transpose())
}

/// The pose with OpenCV axes of a matrix with OpenGL axes.
pub(crate) fn pose_of_opengl(rows: &[[f64; 4]; 4]) -> DPose3 {
    let flip = DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
    DPose3::from_mat4(DMat4::from_cols_array_2d(rows).transpose() * flip)
}

/// Depth in exported units; 0 if there is none or it does not fit.
pub(crate) fn encode_depth(depth: &DepthImage) -> Image<u16> {
    depth.map(|&z| {
        let units = (f64::from(z) / DEPTH_UNIT_M).round();
        if (1.0..=f64::from(u16::MAX)).contains(&units) { units as u16 } else { 0 }
    })
}

/// Metres of an image in exported units.
pub(crate) fn decode_depth(image: &Image<u16>) -> DepthImage {
    image.map(|&units| (f64::from(units) * DEPTH_UNIT_M) as f32)
}
