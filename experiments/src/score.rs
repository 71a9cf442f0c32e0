//! Somebody else's reconstruction of an exported scene, measured by the same functions as ours.

use crate::align::refine_on_surfaces;
use crate::export::{Exported, decode_depth, pose_of_opengl, pose_of_rows, read_export};
use crate::{BenchError, ShownView};
use glamx::{DPose3, DVec3};
use sms_core::metrics::Metrics;
use sms_core::ply::{self, VertexColumn};
use sms_core::{InputError, Mesh, Seed, read_png_color, read_png_gray16};
use sms_eval::sample_surface;
use sms_eval::{DepthErrors, mean_iou, psnr_db};
use sms_eval::{LabelledPoint, SceneScores, UNMATCHED, score_cropped, score_labelled, stray_share};
use sms_poses::align_cameras;
use std::path::Path;

/// Points per square metre of sampled meshes, the same as for ours.
const DENSITY_PER_M2: f64 = 1e6;

/// Scores a reconstruction of the scene that was exported to `dir`; keys are `bench.score.…`, named as those of
/// `bench.scan.{scene}.…`.
///
/// - `surface`: a PLY of points in the exported world (sample meshes evenly; faces are ignored), with a column `label`
///   (label of the masks), if there are labels; or an OBJ, which is sampled at 1 point per mm². Labelled points are measured
///   against the object of their label. All points are also measured cropped, without their
///   labels (`cropped_…`, see [`score_cropped`]).
/// - `views`: a folder with `color/NNNNNN.png` (8 bits), `depth/NNNNNN.png` (16 bits, 0.1 mm, 0 for no depth),
///   `label/NNNNNN.png` (labels of the masks) of the held-out frames; a missing kind is not measured.
///
/// If the exported poses were disturbed, points are aligned to the truth first, and views cannot be scored.
///
/// # Errors
/// [`InputError`] naming the file that is missing or does not fit.
pub fn score_files(dir: &Path, surface: Option<&Path>, views: Option<&Path>) -> Result<Metrics, BenchError> {
    // `DIR/truth` is understood as well.
    let dir = if dir.ends_with("truth") { dir.parent().unwrap_or(dir) } else { dir };
    let exported = read_export(dir)?;
    let mut metrics = Metrics::new();
    metrics.set("bench.score.scene", exported.transforms.scene.clone());
    metrics.set("bench.score.preset", exported.transforms.preset.clone());
    if let Some(path) = surface {
        score_surface_file(&exported, path, &mut metrics)?;
    }
    if let Some(views) = views {
        if exported.truth.poses_disturbed {
            let cure = "export without --pose-noise to score views";
            return Err(InputError::new("the held-out poses were disturbed", views, cure).into());
        }
        score_views(dir, &exported, views, &mut metrics)?;
    }
    Ok(metrics)
}

fn score_surface_file(exported: &Exported, path: &Path, metrics: &mut Metrics) -> Result<(), BenchError> {
    let is_obj = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
    let (mut points, labelled) = if is_obj {
        let mesh = Mesh::read_obj(path)?;
        let count = (mesh.area() * DENSITY_PER_M2).ceil().min(2e7) as usize;
        let points = sample_surface(&mesh, count, Seed(0));
        (points.into_iter().map(|point| LabelledPoint { point, label: 0 }).collect(), false)
    } else {
        read_points(path)?
    };
    points.retain(|p| p.point.is_finite());
    let y = &exported.yardstick;
    if exported.truth.poses_disturbed {
        let x_tw = alignment(exported, &points, labelled);
        points.iter_mut().for_each(|p| p.point = x_tw.transform_point(p.point));
    }
    let mut set = |key: &str, value: f64| {
        metrics.set(format!("bench.score.{key}"), value);
    };
    set("points", points.len() as f64);
    let mut all = |name: &str, s: &SceneScores| {
        let dot = if name == "surface" { "surface_" } else { "cropped_" };
        set(&format!("{dot}median_m"), s.mean.median_m);
        set(&format!("{dot}p90_m"), s.mean.p90_m);
        set(&format!("{dot}precision_2p5mm"), s.mean.precision);
        set(&format!("{dot}recall_2p5mm"), s.mean.recall);
        set(if name == "surface" { "f1_2p5mm" } else { "cropped_f1_2p5mm" }, s.mean.f1);
    };
    if labelled {
        all("surface", &score_labelled(&points, &y.truth_of, &y.surfaces, &y.observed));
    }
    let bare: Vec<DVec3> = points.iter().map(|p| p.point).collect();
    all("cropped", &score_cropped(&bare, &y.surfaces, &y.observed));
    if labelled {
        set("surface_stray_share", stray_share(&points, &y.truth_of));
    }
    Ok(())
}

fn alignment(exported: &Exported, points: &[LabelledPoint], labelled: bool) -> DPose3 {
    let held = &exported.transforms.holdout;
    let frames = exported.transforms.frames.iter().zip(&exported.truth.true_x_wc).enumerate();
    let (x_tc, x_wc): (Vec<DPose3>, Vec<DPose3>) = frames
        .filter(|(i, _)| !held.contains(i))
        .map(|(_, (used, truth))| (pose_of_rows(truth), pose_of_opengl(&used.transform_matrix)))
        .unzip();
    let first = align_cameras(&x_wc, &x_tc);
    if !labelled {
        return first;
    }
    let y = &exported.yardstick;
    let on_objects: Vec<(DVec3, usize)> = points
        .iter()
        .filter_map(|p| {
            let truth = *y.truth_of.get(usize::from(p.label))?;
            (truth != 0 && truth != UNMATCHED).then(|| (p.point, usize::from(truth) - 1))
        })
        .collect();
    refine_on_surfaces(&on_objects, &y.surfaces, first)
}

/// Points of a PLY, and whether they have labels.
fn read_points(path: &Path) -> Result<(Vec<LabelledPoint>, bool), BenchError> {
    let table = ply::read(path)?;
    let (Some(x), Some(y), Some(z)) = (table.column("x"), table.column("y"), table.column("z")) else {
        return Err(InputError::new("this PLY has no x, y, z", path, "write points with positions").into());
    };
    let label = table.column("label");
    let points = (0..table.len)
        .map(|i| LabelledPoint {
            point: DVec3::new(x[i], y[i], z[i]),
            label: label.map_or(0, |l| l[i].clamp(0.0, f64::from(u16::MAX)) as u16),
        })
        .collect();
    Ok((points, label.is_some()))
}

fn score_views(
    dir: &Path,
    exported: &Exported,
    views: &Path,
    metrics: &mut Metrics,
) -> Result<(), BenchError> {
    let y = &exported.yardstick;
    let [has_color, has_depth, has_label] = ["color", "depth", "label"].map(|k| views.join(k).is_dir());
    if !(has_color || has_depth || has_label) {
        let cure = "put the held-out views into color/, depth/ and label/ there";
        return Err(InputError::new("there are no views", views, cure).into());
    }
    let (mut psnr, mut errors, mut labels) = (Vec::new(), DepthErrors::default(), Vec::new());
    for (i, truth) in &y.held_out {
        let frame = &exported.transforms.frames[*i];
        let path = |kind: &str| views.join(kind).join(format!("{i:06}.png"));
        let fits = |size: (usize, usize), path: &Path| {
            let (w, h) = truth.depth.size();
            let cure = format!("render it at {w} × {h} from the exported camera");
            if size == (w, h) {
                Ok(())
            } else {
                Err(InputError::new("this view has another size", path, cure))
            }
        };
        if has_color {
            let shown = read_png_color(&path("color"))?;
            fits(shown.size(), &path("color"))?;
            let observed = read_png_color(&dir.join(&frame.file_path))?;
            psnr.push(psnr_db(&shown.map(|c| c.map(|v| f32::from(v) / 255.0)), &observed));
        }
        if has_depth {
            let shown = read_png_gray16(&path("depth"))?;
            fits(shown.size(), &path("depth"))?;
            let measured = decode_depth(&read_png_gray16(&dir.join(&frame.depth_file_path))?);
            errors.add(&decode_depth(&shown), truth, &measured);
        }
        if has_label {
            let shown = read_png_gray16(&path("label"))?;
            fits(shown.size(), &path("label"))?;
            labels.push((shown, truth));
        }
    }
    let mut set = |key: &str, value: f64| {
        metrics.set(format!("bench.score.{key}"), value);
    };
    if has_color {
        set("holdout_psnr_db", psnr.iter().sum::<f64>() / psnr.len() as f64);
    }
    if has_depth {
        let s = errors.scores();
        set("holdout_depth_mae_m", s.mae_m);
        set("holdout_depth_median_m", s.median_m);
        set("holdout_depth_inner_mae_m", s.inner_mae_m);
        set("holdout_depth_measured_mae_m", s.measured_mae_m);
        set("holdout_coverage", s.coverage);
    }
    if has_label {
        let pairs: Vec<_> = labels.iter().map(|(l, t)| (l, *t)).collect();
        set("holdout_miou", mean_iou(&pairs, &y.truth_of, y.surfaces.len() + 1));
    }
    Ok(())
}

/// Writes a shown view as [`score_files`] reads it, into `color/`, `depth/` and `label/` of `views`.
///
/// # Errors
/// [`CoreError::Write`](sms_core::CoreError).
pub fn write_view(views: &Path, index: usize, shown: &ShownView) -> Result<(), BenchError> {
    let path = |kind: &str| views.join(kind).join(format!("{index:06}.png"));
    let color = shown.color.map(|c| c.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8));
    sms_core::write_png_color(&path("color"), &color)?;
    sms_core::write_png_gray16(&path("depth"), &crate::export::encode_depth(&shown.depth))?;
    if let Some(label) = &shown.label {
        sms_core::write_png_gray16(&path("label"), label)?;
    }
    Ok(())
}

/// Writes points with labels as [`score_files`] reads them.
///
/// # Errors
/// [`CoreError::Write`](sms_core::CoreError).
pub fn write_points(path: &Path, points: &[LabelledPoint]) -> Result<(), BenchError> {
    let column = |axis: usize| VertexColumn::F32(points.iter().map(|p| p.point[axis] as f32).collect());
    let label = VertexColumn::I32(points.iter().map(|p| i32::from(p.label)).collect());
    let columns = [("x", column(0)), ("y", column(1)), ("z", column(2)), ("label", label)];
    Ok(ply::write(path, &["reconstructed surface, world, metres"], &columns)?)
}
