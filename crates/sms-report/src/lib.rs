//! Metrics against truth, figures and the report page.
//!
//! [`evaluate_object`] measures a reconstructed surface against a known one. [`write_report`] makes
//! `report/index.html`: one page without outside files, with the scan, the objects, the planned shot, predicted
//! against realised, and a 3-D view; its pictures are also written as PNG beside it.
//!
//! ```
//! use sms_core::{Mesh, PointCloud, glamx::DVec3};
//! let ball = Mesh::icosphere(0.03, 4);
//! let model = PointCloud { points_w: Mesh::icosphere(0.03, 3).vertices, ..PointCloud::default() };
//! let scores = sms_report::evaluate_object(&ball, &model, &sms_report::EvaluateSettings::default()).unwrap();
//! assert!(scores.chamfer_m < 1e-3 && scores.f1_2p5mm > 0.99);
//! ```

mod colormap;
mod evaluate;
mod figures;
mod page;
#[cfg(feature = "rerun")]
mod rrd;
mod shot;
mod surface;
mod view3d;

pub use colormap::{depth_picture, error_picture, label_picture, turbo};
pub use evaluate::{
    EvaluateError, EvaluateSettings, KnownObject, ObjectScores, compare_sphere, evaluate_object,
    read_known_objects,
};
pub use figures::ViewPair;
pub use page::{LossPoint, ReportError, ReportInput, write_report};
#[cfg(feature = "rerun")]
pub use rrd::{RrdError, write_rrd};
pub use surface::{ClosestPoint, SurfaceIndex, sample_surface};
