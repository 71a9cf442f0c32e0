//! `sms-experiments tracking`: camera poses from images alone.

use super::orbits::chosen;
use super::shared::{finish, parse_seeds};
use clap::Args;
use sms_cli::front::Console;
use sms_core::{NoProgress, Seed, StageContext, Warnings};
use sms_experiments::{TrackedKind, track_generated, track_recording, tracking_metrics, tracking_table};
use sms_poses::PosesConfig;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct TrackingArguments {
    /// Recordings with poses, for comparison.
    #[arg(value_name = "RECORDING")]
    pub recordings: Vec<PathBuf>,
    /// Use only every N-th frame of these recordings.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub stride: usize,
    /// Seeds of generated recordings: 1..5, or 1,2,5.
    #[arg(long, value_name = "SEEDS", default_value = "1..5")]
    pub seeds: String,
    /// Only these generated recordings: desk, room.
    #[arg(long, value_name = "SCENES", value_delimiter = ',')]
    pub scenes: Vec<String>,
    /// Track the given recordings only.
    #[arg(long)]
    pub no_generated: bool,
    /// File for the figures (JSON).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &TrackingArguments) -> anyhow::Result<()> {
    let config = console.context.settings.section("poses", PosesConfig::default())?;
    config.validate()?;
    let scenes = chosen(&a.scenes, "--scenes", &TrackedKind::ALL, TrackedKind::as_str)?;
    let seeds = if a.no_generated { Vec::new() } else { parse_seeds(&a.seeds)? };
    let progress = console.context.progress.as_ref();
    progress.begin("tracking", (a.recordings.len() + scenes.len() * seeds.len()) as u64);
    let mut rows = Vec::new();
    let warnings = Warnings::new();
    let context = StageContext::new(&NoProgress, &console.context.cancel, &warnings);
    for recording in &a.recordings {
        rows.push(track_recording(recording, a.stride, &config, context)?);
        progress.update(rows.len() as u64, &recording.display().to_string());
    }
    for &scene in &scenes {
        for &seed in &seeds {
            rows.push(track_generated(scene, Seed(seed), &config, context)?);
            progress.update(rows.len() as u64, &format!("{} {seed}", scene.as_str()));
        }
    }
    progress.end("");
    finish(console, &tracking_metrics(&rows), a.out.as_ref(), &tracking_table(&rows))
}
