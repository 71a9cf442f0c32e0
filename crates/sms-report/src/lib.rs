//! The report page and its figures.
//!
//! [`write_report`] writes `report/index.html`: a self-contained page with photographs, the objects and their names,
//! the plan, predicted and realised outcomes, and a 3-D view. Its pictures are also written as PNG files.

mod colormap;
mod contour;
mod date;
mod figures;
mod floor;
mod forecast;
mod html;
mod input;
mod labelled;
mod landing;
#[cfg(feature = "rerun")]
mod live;
mod name_text;
mod objects;
mod page;
mod photo;
#[cfg(feature = "rerun")]
mod rerun_parts;
#[cfg(feature = "rerun")]
mod rrd;
mod shot;
mod splats;
mod summary;
mod textures;
mod top_view;
mod view3d;
mod viewer;

pub use colormap::{depth_picture, error_picture, label_picture, turbo};
pub use figures::ViewPair;
pub use input::ReportInput;
pub use landing::{LandingInput, LandingRealised};
#[cfg(feature = "rerun")]
pub use live::{LiveError, LiveScan, Viewer};
pub use page::write_report;
pub use photo::RecordedView;
#[cfg(feature = "rerun")]
pub use rrd::{RrdError, write_rrd};
pub use top_view::{TopOutline, TopPath, TopShape, TopView};
