//! The paper's billiards experiment (section "Experiments", Table 1) on the eighteen fixed scenes: scan, materialize, plan
//! from many starts, and carry every plan out in the target worlds.
//!
//! `planner_view.rs` builds the planner's view from the recording and the material prior; plans in `rows.rs` are made
//! of that alone. `realise.rs` and `ablation.rs` are the only places where the truth decides anything. Every scene is a file that is written
//! when its plans are made and after every engine, so that an interrupted run resumes, and shards of a run meet
//! in one folder.

mod ablated;
mod ablation;
mod drawing;
mod figures;
mod options;
mod pictures;
pub(crate) mod planner_view;
mod realise;
mod result;
mod row;
mod rows;
mod run;
mod table;
mod vlm_materials;

pub use ablated::{Ablated, Ablation, Replaced};
pub use drawing::{Drawing, Way};
pub use figures::billiards_metrics;
pub use options::{BilliardsBench, BilliardsGeometry, paper_entities};
pub use pictures::write_pictures;
pub use result::{BilliardsScene, Shot, read_billiards, write_shots};
pub use row::{Row, Unfinished};
pub use run::{run_billiards, scan_billiards};
pub use table::billiards_table;
