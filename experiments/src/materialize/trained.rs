//! Scans kept on disk, so that the entities stage can be measured again and again.

use super::{MaskChoice, MaterializeOptions};
use crate::options::BenchOptions;
use crate::prepare::prepare;
use crate::scenes::{BenchScene, generated, model_path};
use crate::{BenchError, TrainerMaker};
use glamx::DVec3;
use serde::{Deserialize, Serialize};
use sms_core::{
    Camera, CoreError, Hasher, InputError, Labels, Seed, StageContext, atomic, hash_serializable,
};
use sms_eval::{
    DiscSampling, Overlaps, SURFACE_SAMPLES, SurfacePoint, TrueSurface, carried, disc_points, match_labels,
    observed_surface_at_most, score_labelled, true_surfaces, true_views,
};
use sms_frames::Sequence;
use sms_gaussians::{GaussianModel, read_ply, write_ply};
use sms_masks::{load_labels, save_labels};
use sms_pipeline::stages::{self, GaussiansRequest};
use sms_synth::TruthObject;
use std::path::{Path, PathBuf};

/// The scan's seed; `sms scan` has the same default.
const SCAN_SEED: Seed = Seed(0);
/// Version of the kept files' layout.
const LAYOUT: u32 = 2;

/// A scanned scene and its truth.
#[derive(Debug)]
pub struct Trained {
    /// The frames trained on.
    pub sequence: Sequence,
    /// Their masks.
    pub labels: Labels,
    /// The result of the scan.
    pub model: GaussianModel,
    /// True surfaces in the truth's world `T`; that of the sequence is carried to it by `x_world_recording.inverse()`.
    pub surfaces: Vec<TrueSurface>,
    /// Their parts that the cameras see.
    pub observed: Vec<Vec<SurfacePoint>>,
    /// The true label that each mask label stands for (as in [`match_labels`]).
    pub truth_of: Vec<u16>,
    /// Cameras in `T`.
    pub cameras_t: Vec<Camera>,
    /// Whether the masks are the true ones.
    pub true_masks: bool,
    /// Quality of the entities' inputs: masks and Gaussians.
    pub inputs: Inputs,
}

/// Quality of the masks and Gaussians that entities are made from, as means over the objects: errors that the entities stage
/// inherits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Inputs {
    /// Seconds of the scan.
    pub scan_seconds: f64,
    /// Intersection over union of the masks with the true ones.
    pub masks_iou: f64,
    /// Median distance of points on the Gaussians' discs to the true surface, metres (`surface_median_m` of `bench.scan`);
    /// `None` where no object has any.
    pub gaussians_median_m: Option<f64>,
    /// Their F1 at 2.5 mm (`f1_2p5mm` of `bench.scan`).
    pub gaussians_f1_2p5mm: f64,
}

#[derive(Serialize, Deserialize)]
struct Record {
    /// Device of the scan.
    #[serde(default)]
    device: String,
    truth_of: Vec<u16>,
    observed: Vec<usize>,
    inputs: Inputs,
}

/// Scans a generated scene, or finds the scan that is there. `None` for a missing model without a kept scan,
/// and for real recordings, which have no truth.
///
/// # Errors
/// [`BenchError`] of the stage that failed.
pub fn train(
    scene: &BenchScene,
    options: &MaterializeOptions,
    context: StageContext<'_>,
) -> Result<Option<Trained>, BenchError> {
    let Some(made) = generated(scene)? else { return Ok(None) };
    let true_masks = match options.masks {
        MaskChoice::Geometry => false,
        MaskChoice::Truth => true,
        MaskChoice::Auto => {
            let longest = |o: &TruthObject| o.aabb_w().extents().max_element();
            let length = made.scene.objects.iter().map(longest).fold(0.0, f64::max);
            length > options.bench.masks.max_object_m
        }
    };
    let bench = BenchOptions { true_masks, ..options.bench.clone() };
    let dir = options.keep.join("scans").join(format!("{scene}-{}", &scan_key(scene, &bench)?[..12]));
    let record_path = dir.join("scan.json");
    if options.rescan || !record_path.is_file() {
        if dir.exists() {
            std::fs::remove_dir_all(&dir).map_err(CoreError::write(&dir))?;
        }
        make(scene, &bench, &options.trainer, &dir, context)?;
    }
    let record: Record = atomic::read_json(&record_path)?;
    let sequence = Sequence::load(&dir.join("frames"))?;
    let x_tw = sequence.x_world_recording.inverse();
    Ok(Some(Trained {
        labels: load_labels(&dir.join("masks"))?,
        model: read_ply(&dir.join("scene.ply"))?,
        surfaces: true_surfaces(&made.scene),
        observed: read_observed(&dir.join("observed.f64"), &record.observed)?,
        truth_of: record.truth_of,
        true_masks,
        inputs: record.inputs,
        cameras_t: sequence.frames.iter().map(|f| carried(&f.camera, &x_tw)).collect(),
        sequence,
    }))
}

/// Names a scan by everything that it was made from but the code: the model's files, the fixed scene's truth or the scene's
/// seed, and all settings up to the scan.
pub(crate) fn scan_key(scene: &BenchScene, bench: &BenchOptions) -> Result<String, CoreError> {
    let mut hasher = Hasher::new();
    if let BenchScene::Model(name) = scene {
        let folder = model_path(name);
        let mut files: Vec<PathBuf> = std::fs::read_dir(folder.parent().unwrap_or(Path::new(".")))
            .map_err(CoreError::read(&folder))?
            .filter_map(|entry| Some(entry.ok()?.path()))
            .collect();
        files.sort();
        for file in files {
            hasher.file(&file)?;
        }
    }
    // A number stays when its scene is made otherwise.
    if let BenchScene::Fixed(_) | BenchScene::Landing(_) | BenchScene::ScannedLanding(_) = scene
        && let Some(made) = generated(scene)?
    {
        hasher.text(&hash_serializable(&made.scene).0);
    }
    let settings =
        (&bench.read, &bench.load, &bench.masks, bench.true_masks, &bench.scan, bench.recorded(), SCAN_SEED);
    hasher.text(&hash_serializable(&settings).0);
    hasher.text(&format!("{scene} {} {LAYOUT}", env!("CARGO_PKG_VERSION")));
    Ok(hasher.finish().0)
}

fn make(
    scene: &BenchScene,
    bench: &BenchOptions,
    maker: &TrainerMaker,
    dir: &Path,
    context: StageContext<'_>,
) -> Result<(), BenchError> {
    let Some(prepared) = prepare(scene, bench, context)? else { return Ok(()) };
    let Some(truth) = &prepared.truth else { return Ok(()) };
    let aside = dir.with_extension(format!("partial-{}", std::process::id()));
    let work = aside.join("work");
    std::fs::create_dir_all(&work).map_err(CoreError::write(&work))?;
    let mut trainer = maker.make(&bench.scan.train, prepared.labels.class_count(), SCAN_SEED)?;
    let timer = std::time::Instant::now();
    let result = stages::gaussians(
        &prepared.sequence,
        &prepared.labels,
        &GaussiansRequest { config: &bench.scan, work_dir: &work },
        trainer.as_mut(),
        &mut (),
        context.with_seed(SCAN_SEED),
    )?;
    let scan_seconds = timer.elapsed().as_secs_f64();
    std::fs::remove_dir_all(&work).map_err(CoreError::write(&work))?;

    let (sequence, labels) = prepared.trained_only(bench.scan.holdout);
    let x_tw = prepared.x_tw();
    let cameras: Vec<Camera> = sequence.frames.iter().map(|f| carried(&f.camera, &x_tw)).collect();
    let surfaces = true_surfaces(truth);
    let observed = observed_surface_at_most(&surfaces, &cameras, SURFACE_SAMPLES);
    // Some frames are enough to tell which mask is which object.
    let every = 6;
    let views = true_views(truth, &cameras.iter().step_by(every).copied().collect::<Vec<_>>());
    let mut overlaps = Overlaps::new(labels.class_count(), surfaces.len() + 1);
    for (map, view) in labels.maps.iter().step_by(every).zip(&views) {
        overlaps.add_maps(map, &view.label);
    }

    write_ply(&result.model, &aside.join("scene.ply"))?;
    sequence.save_with_settings(&aside.join("frames"), &())?;
    save_labels(&aside.join("masks"), &labels)?;
    write_observed(&aside.join("observed.f64"), &observed)?;
    let truth_of = match_labels(&overlaps);
    let points = disc_points(&result.model, &x_tw, &DiscSampling::default());
    let gaussians = score_labelled(&points, &truth_of, &surfaces, &observed).mean;
    let iou = |t: usize| {
        let label = truth_of.iter().position(|of| usize::from(*of) == t);
        label.map_or(0.0, |label| overlaps.iou(label, t))
    };
    let inputs = Inputs {
        scan_seconds,
        masks_iou: (1..=surfaces.len()).map(iou).sum::<f64>() / surfaces.len() as f64,
        gaussians_median_m: Some(gaussians.median_m).filter(|m| m.is_finite()),
        gaussians_f1_2p5mm: gaussians.f1,
    };
    let observed = observed.iter().map(Vec::len).collect();
    let record = Record { device: maker.device().to_owned(), truth_of, observed, inputs };
    atomic::write_json(&aside.join("scan.json"), &record)?;
    match std::fs::rename(&aside, dir) {
        Err(error) if !dir.join("scan.json").is_file() => Err(CoreError::write(dir)(error).into()),
        Err(_) => {
            // Another process was faster.
            let _ = std::fs::remove_dir_all(&aside);
            Ok(())
        }
        Ok(()) => Ok(()),
    }
}

/// Points and normals of all objects, one after another, as little-endian doubles.
fn write_observed(path: &Path, observed: &[Vec<SurfacePoint>]) -> Result<(), CoreError> {
    let numbers = |s: &SurfacePoint| s.point.to_array().into_iter().chain(s.normal.to_array());
    let bytes: Vec<u8> = observed.iter().flatten().flat_map(numbers).flat_map(f64::to_le_bytes).collect();
    atomic::write_bytes(path, &bytes)
}

fn read_observed(path: &Path, counts: &[usize]) -> Result<Vec<Vec<SurfacePoint>>, CoreError> {
    let bytes = std::fs::read(path).map_err(CoreError::read(path))?;
    if bytes.len() != 48 * counts.iter().sum::<usize>() {
        return Err(InputError::new("this file is damaged", path, "measure with --rescan").into());
    }
    let number = |b: &[u8]| f64::from_le_bytes(std::array::from_fn(|i| b[i]));
    let mut points = bytes.chunks_exact(48).map(|b| SurfacePoint {
        point: DVec3::from_array([0, 8, 16].map(|i| number(&b[i..]))),
        normal: DVec3::from_array([24, 32, 40].map(|i| number(&b[i..]))),
    });
    Ok(counts.iter().map(|&count| points.by_ref().take(count).collect()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn observed_points_come_back_bit_by_bit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("observed.f64");
        let point = |x: f64| SurfacePoint { point: DVec3::new(x, 0.1, -x), normal: DVec3::Y * x };
        let observed = vec![vec![point(0.1), point(1e-9)], vec![], vec![point(-3.0)]];
        write_observed(&path, &observed).unwrap();
        assert_eq!(read_observed(&path, &[2, 0, 1]).unwrap(), observed);
        assert!(read_observed(&path, &[2, 0, 2]).is_err());
    }
}
