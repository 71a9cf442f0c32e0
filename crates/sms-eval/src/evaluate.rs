//! Reconstructed objects against known ones.
//!
//! The known model is a point cloud (from a scanner, or sampled from a true mesh) or a mesh. *Accuracy* is the distance
//! of reconstructed surface points to the model, *completion* is the distance of model points to the reconstructed
//! surface. F1 at a threshold is the harmonic mean of the shares within the threshold (Knapitsch et al. 2017, "Tanks
//! and Temples").
//!
//! As in MobileBrick, thresholds are 2.5 and 5 mm, 100 000 points are spread over each surface, and shares are strictly
//! within the threshold (Li, Bian, Castle, Torr, Prisacariu: "MobileBrick: Building LEGO for 3D Reconstruction on
//! Mobile Devices", CVPR 2023, and its evaluation script). Three things differ. Distances are to the surface instead of
//! the nearest sample, which is exact. Reconstructions are not fitted to the model first, since their poses are
//! evaluated, too. Chamfer is the mean of the two mean distances; in MobileBrick it is their sum. MobileBrick leaves
//! out points outside a mask of visible space. Here every point counts; `sms-experiments materialize` restricts points
//! to the view of the cameras.

use crate::statistics::{f1, mean, rank};
use crate::surface_index::{SurfaceIndex, sample_surface};
use glamx::{DMat4, DPose3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sms_core::metrics::Metrics;
use sms_core::{CoreError, ErrorKind, InputError, Mesh, PointCloud, Ranges, Seed, StageError, atomic};
use std::path::Path;

/// Errors of evaluation.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// Files.
    #[error(transparent)]
    Core(#[from] CoreError),
    /// Nothing to compare.
    #[error("{0} has no surface to compare")]
    Empty(&'static str),
}

impl StageError for EvaluateError {
    fn kind(&self) -> ErrorKind<'_> {
        match self {
            Self::Core(e) => e.kind(),
            Self::Empty(_) => ErrorKind::Other,
        }
    }
}

/// Settings for the comparison of surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EvaluateSettings {
    /// Points sampled on each surface (MobileBrick: 100 000).
    pub samples: usize,
    /// Seed of the samples.
    pub seed: u64,
}

impl Default for EvaluateSettings {
    fn default() -> Self {
        Self { samples: 100_000, seed: 0 }
    }
}

impl EvaluateSettings {
    /// Checks that all values are valid.
    ///
    /// # Errors
    /// [`InputError`] that names the first invalid key and its range.
    pub fn validate(&self) -> Result<(), InputError> {
        Ranges::of("evaluate").count("samples", self.samples, 100, 100_000_000)
    }
}

/// Scores of one object; distances in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ObjectScores {
    /// Median distance reconstruction → model.
    pub accuracy_median_m: f64,
    /// 90 % quantile of the distance reconstruction → model.
    pub accuracy_p90_m: f64,
    /// Median distance model → reconstruction.
    pub completion_median_m: f64,
    /// Mean of the two mean distances.
    pub chamfer_m: f64,
    /// Share of the reconstruction within 2.5 mm of the model.
    pub precision_2p5mm: f64,
    /// Share of the model within 2.5 mm of the reconstruction.
    pub recall_2p5mm: f64,
    /// F1 at 2.5 mm.
    pub f1_2p5mm: f64,
    /// F1 at 5 mm.
    pub f1_5mm: f64,
}

impl ObjectScores {
    /// Returns the scores as `evaluate.<name>.*` metrics.
    pub fn metrics(&self, name: &str) -> Metrics {
        Metrics::of_fields(&format!("evaluate.{name}"), self)
    }
}

/// A surface to be compared or matched, in the world.
#[derive(Debug, Clone, Copy)]
pub enum KnownSurface<'a> {
    /// Points of a scanner, dense enough that the distance to the nearest point is the distance to the surface.
    Cloud(&'a PointCloud),
    /// A mesh.
    Mesh(&'a Mesh),
}

impl KnownSurface<'_> {
    pub(crate) fn index(&self) -> Option<SurfaceIndex> {
        match self {
            Self::Cloud(cloud) => SurfaceIndex::of_points(&cloud.points_w),
            Self::Mesh(mesh) => SurfaceIndex::new(mesh),
        }
    }

    fn points(&self, settings: &EvaluateSettings) -> Vec<DVec3> {
        match self {
            Self::Cloud(cloud) => cloud.points_w.clone(),
            Self::Mesh(mesh) => {
                sample_surface(mesh, settings.samples, Seed(settings.seed).derive("known surface"))
            }
        }
    }
}

/// Compares a reconstructed mesh with a known surface, both in the world.
///
/// # Errors
/// [`EvaluateError::Empty`] when either has no surface.
pub fn evaluate_object(
    mesh_w: &Mesh,
    known_w: KnownSurface<'_>,
    settings: &EvaluateSettings,
) -> Result<ObjectScores, EvaluateError> {
    let surface = SurfaceIndex::new(mesh_w).ok_or(EvaluateError::Empty("the reconstruction"))?;
    let samples = sample_surface(mesh_w, settings.samples, Seed(settings.seed));
    let known = known_w.index().ok_or(EvaluateError::Empty("the known model"))?;
    let mut accuracy: Vec<f64> = samples.par_iter().map(|&p| known.closest(p).distance).collect();
    let mut completion: Vec<f64> =
        known_w.points(settings).par_iter().map(|&p| surface.closest(p).distance).collect();
    if accuracy.is_empty() {
        return Err(EvaluateError::Empty("the reconstruction"));
    }
    let within = |v: &[f64], t: f64| v.iter().filter(|&&d| d < t).count() as f64 / v.len() as f64;
    let f1 = |t: f64| f1(within(&accuracy, t), within(&completion, t));
    let (f1_2p5mm, f1_5mm) = (f1(0.0025), f1(0.005));
    let chamfer_m = 0.5 * (mean(&accuracy) + mean(&completion));
    Ok(ObjectScores {
        accuracy_median_m: rank(&mut accuracy, 0.5),
        accuracy_p90_m: rank(&mut accuracy, 0.9),
        completion_median_m: rank(&mut completion, 0.5),
        chamfer_m,
        precision_2p5mm: within(&accuracy, 0.0025),
        recall_2p5mm: within(&completion, 0.0025),
        f1_2p5mm,
        f1_5mm,
    })
}

/// Returns the centre and radius errors of a fitted sphere as `evaluate.<name>.*` metrics.
pub fn compare_sphere(name: &str, found: (DVec3, f64), truth: (DVec3, f64)) -> Metrics {
    let mut m = Metrics::new();
    m.set(format!("evaluate.{name}.center_error_m"), (found.0 - truth.0).length());
    m.set(format!("evaluate.{name}.radius_error_m"), (found.1 - truth.1).abs());
    m
}

/// A known object of a recording.
#[derive(Debug, Clone)]
pub struct KnownObject {
    /// Name.
    pub name: String,
    /// The object's value in the recording's label images.
    pub mask_value: u16,
    /// The model's points in the recording's world; for a mesh, samples of its surface.
    pub model_r: PointCloud,
    /// The model's surface in the recording's world if it is a mesh.
    pub mesh_r: Option<Mesh>,
}

#[derive(Deserialize)]
struct KnownObjectsFile {
    objects: Vec<ObjectEntry>,
}

#[derive(Deserialize)]
struct ObjectEntry {
    name: String,
    mask_value: u16,
    model: Option<String>,
    model_to_world: Option<[[f64; 4]; 4]>,
}

/// Reads `objects.json`: objects with a scanned model (`model`, a PLY or OBJ relative to the file) and its pose in
/// the recording's world (`model_to_world`, 4×4). Objects without a model are left out.
///
/// # Errors
/// [`InputError`] naming the file when something is missing or not rigid.
pub fn read_known_objects(path: &Path) -> Result<Vec<KnownObject>, EvaluateError> {
    let file: KnownObjectsFile = atomic::read_json(path)?;
    let folder = path.parent().unwrap_or(Path::new("."));
    let mut known = Vec::new();
    for object in file.objects {
        let (Some(model), Some(rows)) = (object.model, object.model_to_world) else { continue };
        let model_path = folder.join(&model);
        let is_obj = model_path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
        let mesh = if is_obj { Some(Mesh::read_obj(&model_path)?) } else { None };
        let points = match &mesh {
            Some(mesh) => sample_surface(mesh, 50_000, Seed(0)),
            None => PointCloud::read_ply(&model_path)?.points_w,
        };
        let matrix = DMat4::from_cols_array_2d(&rows).transpose();
        let rotation = glamx::DMat3::from_mat4(matrix);
        let rigid = (rotation * rotation.transpose()).abs_diff_eq(glamx::DMat3::IDENTITY, 1e-3);
        if !rigid {
            return Err(CoreError::from(InputError::new(
                format!("`model_to_world` of `{}` is not a rigid pose", object.name),
                path,
                "give a rotation and a translation in metres, without scale",
            ))
            .into());
        }
        let pose = DPose3::from_mat4(matrix);
        known.push(KnownObject {
            name: object.name,
            mask_value: object.mask_value,
            model_r: PointCloud {
                points_w: points.into_iter().map(|p| pose.transform_point(p)).collect(),
                ..PointCloud::default()
            },
            mesh_r: mesh.map(|m| m.transformed(&pose)),
        });
    }
    Ok(known)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sphere_grown_by_two_millimetres_is_two_millimetres_off() {
        let model = PointCloud {
            points_w: sample_surface(&Mesh::icosphere(0.05, 4), 20_000, Seed(3)),
            ..PointCloud::default()
        };
        let grown = Mesh::icosphere(0.052, 4);
        let exact = Mesh::icosphere(0.05, 4);
        let s = evaluate_object(&grown, KnownSurface::Mesh(&exact), &EvaluateSettings::default()).unwrap();
        assert!((s.accuracy_median_m - 0.002).abs() < 2e-5 && (s.chamfer_m - 0.002).abs() < 2e-5, "{s:?}");
        let s = evaluate_object(&grown, KnownSurface::Cloud(&model), &EvaluateSettings::default()).unwrap();
        assert!((s.accuracy_median_m - 0.002).abs() < 2e-4, "{s:?}");
        assert!((s.completion_median_m - 0.002).abs() < 2e-4, "{s:?}");
        assert!(s.f1_2p5mm > 0.95 && s.f1_5mm == 1.0, "{s:?}");
        let far = grown.transformed(&DPose3::from_translation(DVec3::X));
        let s = evaluate_object(&far, KnownSurface::Cloud(&model), &EvaluateSettings::default()).unwrap();
        assert_eq!(s.f1_5mm, 0.0);
    }

    #[test]
    fn half_a_sphere_is_accurate_but_not_complete() {
        let full = Mesh::icosphere(0.05, 4);
        let model = PointCloud { points_w: sample_surface(&full, 20_000, Seed(3)), ..PointCloud::default() };
        let mut half = full.clone();
        half.triangles.retain(|t| t.iter().all(|&i| full.vertices[i as usize].z > 0.0));
        let s = evaluate_object(&half, KnownSurface::Cloud(&model), &EvaluateSettings::default()).unwrap();
        assert!(s.accuracy_p90_m < 1.5e-3 && s.f1_2p5mm < 0.75 && s.f1_2p5mm > 0.55, "{s:?}");
    }

    #[test]
    fn known_objects_are_posed_and_scaled_poses_refused() {
        let dir = tempfile::tempdir().unwrap();
        let cloud = PointCloud { points_w: vec![DVec3::X], ..PointCloud::default() };
        cloud.write_ply(&dir.path().join("m.ply")).unwrap();
        let path = dir.path().join("objects.json");
        let write = |scale: f64| {
            let text = format!(
                r#"{{"objects":[{{"name":"a","mask_value":3,"model":"m.ply","model_to_world":
                [[0,{s},0,1],[-{s},0,0,2],[0,0,{s},3],[0,0,0,1]]}},{{"name":"b","mask_value":4}}]}}"#,
                s = scale
            );
            std::fs::write(&path, text).unwrap();
        };
        write(1.0);
        let known = read_known_objects(&path).unwrap();
        assert_eq!((known.len(), known[0].mask_value), (1, 3));
        assert!((known[0].model_r.points_w[0] - DVec3::new(1.0, 1.0, 3.0)).length() < 1e-6);
        write(2.0);
        assert!(matches!(read_known_objects(&path), Err(EvaluateError::Core(CoreError::Input(_)))));
    }
}
