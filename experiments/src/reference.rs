//! A scanned scene and the truth that it is measured against.

use crate::options::BenchOptions;
use crate::prepare::Prepared;
use sms_core::Camera;
use sms_eval::{
    Overlaps, SurfacePoint, TrueSurface, carried, match_labels, observed_surface_at_most, true_surfaces,
    true_views,
};
use sms_gaussians::GaussianModel;
use std::path::Path;

/// A scanned scene that is to be measured.
pub(crate) struct ScannedScene<'a> {
    /// Start of the keys of its metrics.
    pub(crate) prefix: &'a str,
    /// Input of the scan.
    pub(crate) prepared: &'a Prepared,
    /// Settings of the scan and the measurements.
    pub(crate) options: &'a BenchOptions,
    /// Result of the scan.
    pub(crate) model: &'a GaussianModel,
    /// Folder of the results.
    pub(crate) dir: &'a Path,
}

/// Truth of a generated scene that any reconstruction is measured against.
pub struct Yardstick {
    /// True surfaces in the truth's world.
    pub surfaces: Vec<TrueSurface>,
    /// Their parts that the training cameras see.
    pub observed: Vec<Vec<SurfacePoint>>,
    /// Indices of the held-out frames, and their true views.
    pub held_out: Vec<(usize, sms_eval::TrueView)>,
    /// Which true label each mask label stands for, by best overlap of the masks with the true labels in the held-out
    /// views.
    pub truth_of: Vec<u16>,
}

impl Yardstick {
    /// Returns the reference of a prepared scene; `None` without a truth.
    pub fn new(prepared: &Prepared, holdout: usize) -> Option<Self> {
        let scene = prepared.truth.as_ref()?;
        let camera = |i: usize| carried(&prepared.true_cameras[i], &prepared.x_tw());
        let surfaces = true_surfaces(scene);
        let trained: Vec<Camera> = prepared.trained(holdout).into_iter().map(camera).collect();
        let observed = observed_surface_at_most(&surfaces, &trained, usize::MAX);
        let held_out = prepared.held_out(holdout);
        let views = true_views(scene, &held_out.iter().map(|&i| camera(i)).collect::<Vec<_>>());
        let held_out: Vec<_> = held_out.into_iter().zip(views).collect();
        let mut overlaps = Overlaps::new(prepared.labels.class_count(), surfaces.len() + 1);
        for (i, view) in &held_out {
            overlaps.add_maps(&prepared.labels.maps[*i], &view.label);
        }
        Some(Self { surfaces, observed, held_out, truth_of: match_labels(&overlaps) })
    }
}
