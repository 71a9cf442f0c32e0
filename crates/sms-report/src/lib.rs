//! Metrics against truth, figures and the report page.
//!
//! [`evaluate_object`] measures a reconstructed surface against a known one. [`write_report`] makes
//! `report/index.html`: one page without outside files, with the scan, the objects, the planned shot, predicted
//! against realised, and a 3-D view; its pictures are also written as PNG beside it.
//!
//! ```
//! use sms_core::Mesh;
//! use sms_report::{EvaluateSettings, KnownSurface, evaluate_object};
//! let (found, truth) = (Mesh::icosphere(0.0301, 4), Mesh::icosphere(0.03, 4));
//! let scores = evaluate_object(&found, KnownSurface::Mesh(&truth), &EvaluateSettings::default()).unwrap();
//! assert!((scores.chamfer_m - 1e-4).abs() < 1e-5 && scores.f1_2p5mm == 1.0);
//! ```

mod assignment;
mod colormap;
mod evaluate;
mod figures;
mod forecast;
mod landing;
#[cfg(feature = "rerun")]
mod live;
mod page;
#[cfg(feature = "rerun")]
mod rerun_parts;
#[cfg(feature = "rerun")]
mod rrd;
mod shot;
mod solids;
mod surface;
mod top_view;
mod view3d;

pub use assignment::{MatchSurface, least_cost_assignment, match_objects};
pub use colormap::{depth_picture, error_picture, label_picture, turbo};
pub use evaluate::{
    EvaluateError, EvaluateSettings, KnownObject, KnownSurface, ObjectScores, compare_sphere,
    evaluate_object, read_known_objects,
};
pub use figures::ViewPair;
pub use landing::{LandingInput, LandingRealised};
#[cfg(feature = "rerun")]
pub use live::{LiveError, LiveScan, Viewer};
pub use page::{LossPoint, ReportError, ReportInput, write_report};
#[cfg(feature = "rerun")]
pub use rrd::{RrdError, write_rrd};
pub use solids::{SolidScores, entity_solid, known_solid};
pub use surface::{ClosestPoint, SurfaceIndex, sample_surface, sample_triangles};
pub use top_view::{TopOutline, TopPath, TopShape, TopView, footprint};
