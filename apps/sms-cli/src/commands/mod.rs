//! One file per command: each calls the pipeline and prints its outcome.

pub(crate) mod check;
pub(crate) mod demo;
pub(crate) mod devices;
pub(crate) mod evaluate;
pub(crate) mod execute;
pub(crate) mod export;
mod landing;
pub(crate) mod manual;
pub(crate) mod masks;
pub(crate) mod materialize;
pub(crate) mod materials;
pub(crate) mod models;
pub(crate) mod name;
pub(crate) mod plan;
pub(crate) mod report;
pub(crate) mod robot;
pub(crate) mod run;
pub(crate) mod sample;
pub(crate) mod scan;
pub(crate) mod settings;
pub(crate) mod simulate;
pub(crate) mod status;
pub(crate) mod synth;
pub(crate) mod view;

/// Returns the reference of an objective in metres, by the kind of task.
fn objective_reference(task: &str) -> &'static str {
    if task == "billiards" { "from the goal" } else { "in all terms" }
}
