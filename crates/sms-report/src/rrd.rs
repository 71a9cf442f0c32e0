//! Writes a run as a Rerun recording, `run.rrd` (feature `rerun`).
//!
//! Timelines: `step` (training steps; the viewer opens on it, because curves, pictures and scene are all on it), `time`
//! (seconds of the shot) and `frame` (of the recording). Entities: `world/camera` (observed and rendered images, depth,
//! labels), `world/gaussians`, `world/bodies/*` (moving as predicted), `world/realised/*`, `world/paths/*`, `world/air`
//! (particles of a landing's wash), `losses/*`.

use crate::input::ReportInput;
use crate::landing::{planner_name, with_vehicle};
use crate::rerun_parts::{APPLICATION, GaussianPoints, Logged, color_image, depth_image, pinhole, transform};
use rerun::blueprint::{
    Blueprint, BlueprintActivation, Horizontal, Spatial2DView, Spatial3DView, TimePanel, TimeSeriesView,
    Vertical,
};
use rerun::{RecordingStream, RecordingStreamBuilder};
use sms_core::Mesh;
use sms_core::glamx::DVec3;
use sms_landing::ParticleFrame;
use sms_scene::{BodyKind, BodyShape, Scene};
use sms_task::Trajectory;
use std::path::{Path, PathBuf};

/// An error of writing a Rerun recording.
#[derive(Debug, thiserror::Error)]
pub enum RrdError {
    /// The SDK could not log or write.
    #[error("cannot write the Rerun recording {path}: {source}")]
    Sdk {
        /// The file.
        path: PathBuf,
        /// The reason.
        source: rerun::RecordingStreamError,
    },
    /// Some data did not reach the file.
    #[error("the Rerun recording {path} is incomplete: {why}")]
    Flush {
        /// The file.
        path: PathBuf,
        /// The reason.
        why: String,
    },
    /// The finished recording could not be moved into place.
    #[error(transparent)]
    Core(#[from] sms_core::CoreError),
}

/// Writes the recording; an earlier one stays intact until this one is complete.
///
/// # Errors
/// [`RrdError`] that names the file.
pub fn write_rrd(path: &Path, input: &ReportInput<'_>) -> Result<(), RrdError> {
    let temporary = path.with_extension("rrd.tmp");
    let sdk = |source| RrdError::Sdk { path: path.to_owned(), source };
    let rec = RecordingStreamBuilder::new(APPLICATION)
        .recording_name(input.title.clone())
        .save(&temporary)
        .map_err(sdk)?;
    log_all(&rec, input).map_err(sdk)?;
    rec.flush_blocking().map_err(|e| RrdError::Flush { path: path.to_owned(), why: e.to_string() })?;
    drop(rec);
    std::fs::rename(&temporary, path).map_err(sms_core::CoreError::write(path))?;
    Ok(())
}

fn log_all(rec: &RecordingStream, input: &ReportInput<'_>) -> Logged {
    blueprint().send(rec, BlueprintActivation { make_active: true, make_default: true })?;
    rec.log_static("world", &rerun::ViewCoordinates::RIGHT_HAND_Z_UP())?;
    log_views(rec, input)?;
    log_gaussians(rec, input)?;
    if let Some(scene) = input.scene {
        let scene = &*with_vehicle(scene, input.landing.as_ref());
        log_bodies(rec, scene, "world/bodies", None)?;
        if let Some(planned) = input.predicted() {
            log_motion(rec, scene, planned, "world/bodies", |n| Some(n.to_owned()))?;
            log_paths(rec, planned, "predicted", [31, 95, 208])?;
        }
        if let Some((there, matches)) = input.realised() {
            log_bodies(rec, scene, "world/realised", Some([73, 209, 124, 120]))?;
            log_motion(rec, scene, there, "world/realised", |n| planner_name(matches, n))?;
            log_paths(rec, there, "realised", [73, 209, 124])?;
        }
    }
    if let Some(landing) = &input.landing {
        log_particles(rec, &landing.plan.nominal.particles)?;
    }
    if let Some([x, y]) = input.goal_w {
        let goal = rerun::Points3D::new([[x as f32, y as f32, 0.002]])
            .with_radii([0.03])
            .with_colors([rerun::Color::from_rgb(217, 51, 51)])
            .with_labels(["goal"]);
        rec.log_static("world/goal", &goal)?;
    }
    for point in &input.losses {
        rec.set_time_sequence("step", point.step as i64);
        let loss = point.loss;
        for (name, value) in [("color_l1", loss.color_l1), ("depth_m", loss.depth), ("total", loss.total)] {
            rec.log(format!("losses/{name}"), &rerun::Scalars::new([f64::from(value)]))?;
        }
    }
    Ok(())
}

fn blueprint() -> Blueprint {
    Blueprint::new(Horizontal::new([
        Spatial3DView::new("scene")
            .with_origin("world")
            .with_contents(["world/**", "- world/camera/**"])
            .into(),
        Vertical::new([
            Spatial2DView::new("observed").with_origin("world/camera/observed").into(),
            Spatial2DView::new("rendered").with_origin("world/camera/rendered").into(),
            TimeSeriesView::new("losses").with_origin("losses").into(),
        ])
        .into(),
    ]))
    // The shot is on the timeline `time`, which has no curves.
    .with_time_panel(TimePanel::new().with_timeline("step"))
}

fn log_views(rec: &RecordingStream, input: &ReportInput<'_>) -> Logged {
    let last_step = input.losses.last().map_or(0, |l| l.step);
    for (shown, view) in input.views.iter().enumerate() {
        rec.set_time_sequence("frame", view.frame_index as i64);
        // The pictures are also spread over the other timelines, where they would be blank otherwise.
        rec.set_duration_secs("time", shown as f64);
        rec.set_time_sequence("step", (last_step * shown as u64 / input.views.len() as u64) as i64);
        rec.log("world/camera", &transform(&view.camera.x_wc))?;
        let k = view.camera.intrinsics;
        let size = [k.width as u32, k.height as u32];
        for (name, color, depth, label) in [
            ("observed", &view.observed_color, &view.observed_depth, &view.observed_label),
            ("rendered", &view.rendered_color, &view.rendered_depth, &view.rendered_label),
        ] {
            let at = format!("world/camera/{name}");
            rec.log(at.clone(), &pinhole(&view.camera))?;
            let pixels = color.data.as_flattened().to_vec();
            rec.log(format!("{at}/color"), &color_image(pixels, size))?;
            rec.log(format!("{at}/depth"), &depth_image(&depth.data, size))?;
            let ids: Vec<u8> = label.data.iter().flat_map(|l| l.to_le_bytes()).collect();
            let format = rerun::components::ImageFormat::segmentation(size, rerun::ChannelDatatype::U16);
            rec.log(format!("{at}/labels"), &rerun::SegmentationImage::new(ids, format))?;
        }
    }
    rec.reset_time();
    Ok(())
}

fn log_gaussians(rec: &RecordingStream, input: &ReportInput<'_>) -> Logged {
    let Some(g) = input.gaussians else { return Ok(()) };
    rec.log_static("world/gaussians", &GaussianPoints::of(g, usize::MAX).archetype())
}

fn mesh_of(mesh: &Mesh, color: [u8; 4]) -> rerun::Mesh3D {
    let logged = rerun::Mesh3D::new(mesh.vertices.iter().map(|p| p.as_vec3().to_array()))
        .with_triangle_indices(mesh.triangles.iter().copied());
    if mesh.colors.len() == mesh.vertices.len() && color[3] == 255 {
        logged.with_vertex_colors(mesh.colors.iter().map(|c| rerun::Color::from_rgb(c[0], c[1], c[2])))
    } else {
        let [r, g, b, a] = color;
        logged.with_albedo_factor(rerun::Rgba32::from_unmultiplied_rgba(r, g, b, a))
    }
}

fn log_bodies(rec: &RecordingStream, scene: &Scene, root: &str, tint: Option<[u8; 4]>) -> Logged {
    for body in &scene.bodies {
        if tint.is_some() && body.kind == BodyKind::Static {
            continue;
        }
        let at = format!("{root}/{}", body.name);
        // Static poses would hide the motion, so bodies are logged at the start of every timeline.
        rec.set_time_sequence("step", 0);
        rec.set_time_sequence("frame", 0);
        rec.set_duration_secs("time", 0.0);
        rec.log(at.clone(), &transform(&body.x_wb))?;
        rec.reset_time();
        let [r, g, b] = body.color;
        if !body.visual.triangles.is_empty() {
            rec.log_static(format!("{at}/mesh"), &mesh_of(&body.visual, tint.unwrap_or([r, g, b, 255])))?;
        }
        let is_solid = !matches!(body.shape, BodyShape::TriMesh { .. } | BodyShape::Sphere { .. });
        if is_solid && tint.is_none() {
            for (i, hull) in body.shape.meshes().iter().enumerate() {
                rec.log_static(format!("{at}/parts/{i:02}"), &mesh_of(hull, [r, g, b, 90]))?;
            }
        }
    }
    Ok(())
}

/// Logs the motion of a trajectory, applied to the scene's bodies relative to their first states.
fn log_motion(
    rec: &RecordingStream,
    scene: &Scene,
    trajectory: &Trajectory,
    root: &str,
    planner_name: impl Fn(&str) -> Option<String>,
) -> Logged {
    for track in &trajectory.bodies {
        let Some(body) = planner_name(&track.name).and_then(|n| scene.body(&n).cloned()) else { continue };
        let Some(first) = track.states.first() else { continue };
        let x_offset = first.x_wb.inverse() * body.x_wb;
        for (time, state) in trajectory.times_s.iter().zip(&track.states) {
            rec.set_duration_secs("time", *time);
            rec.log(format!("{root}/{}", body.name), &transform(&(state.x_wb * x_offset)))?;
        }
    }
    rec.reset_time();
    Ok(())
}

/// Logs the wash particles over the time of the flight.
fn log_particles(rec: &RecordingStream, frames: &[ParticleFrame]) -> Logged {
    for frame in frames {
        rec.set_duration_secs("time", frame.time_s);
        let points = rerun::Points3D::new(frame.particles_w.iter().copied())
            .with_radii([0.006])
            .with_colors([rerun::Color::from_unmultiplied_rgba(90, 160, 230, 110)]);
        rec.log("world/air", &points)?;
    }
    rec.reset_time();
    Ok(())
}

fn log_paths(rec: &RecordingStream, trajectory: &Trajectory, name: &str, color: [u8; 3]) -> Logged {
    for track in &trajectory.bodies {
        let points: Vec<DVec3> = track.states.iter().map(|s| s.x_wb.translation).collect();
        let moved = points.iter().any(|p| (*p - points[0]).length() > 0.003);
        if track.name == "striker" || !moved {
            continue;
        }
        let strip: Vec<[f32; 3]> = points.iter().map(|p| p.as_vec3().to_array()).collect();
        let line = rerun::LineStrips3D::new([strip])
            .with_radii([0.0015])
            .with_colors([rerun::Color::from_rgb(color[0], color[1], color[2])]);
        rec.log_static(format!("world/paths/{name}/{}", track.name), &line)?;
    }
    Ok(())
}
