//! `sms-experiments score`: another program's reconstruction of an exported scene.

use clap::Args;
use sms_cli::front::Console;
use sms_experiments::score_files;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct ScoreArguments {
    /// Folder of the exported scene.
    #[arg(long, value_name = "DIR")]
    pub truth: PathBuf,
    /// The reconstructed surface: points with labels (PLY with a column `label`), points alone, or a mesh (OBJ).
    #[arg(long, value_name = "FILE", required_unless_present = "views")]
    pub surface: Option<PathBuf>,
    /// Rendered held-out views: color/NNNNNN.png, depth/NNNNNN.png (0.1 mm), label/NNNNNN.png.
    #[arg(long, value_name = "DIR")]
    pub views: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &ScoreArguments) -> anyhow::Result<()> {
    let metrics = score_files(&a.truth, a.surface.as_deref(), a.views.as_deref())?;
    if console.json {
        return console.print_json(&metrics);
    }
    for (key, value) in metrics.iter() {
        console.say(format!("{:<32} {value}", key.trim_start_matches("bench.score.")));
    }
    Ok(())
}
