//! `sms bench masks`: masks from geometry against the truth.

use super::bench_optimisers::finish;
use crate::context::Context;
use clap::Args;
use sms_bench::{
    BenchOptions, BenchScene, FRAMES, REAL, masks_metrics, masks_table, run_masks, select_mask_scenes,
};
use sms_core::{InputError, Warnings};
use sms_frames::ReadOptions;
use sms_gaussians::Preset;
use sms_masks::GeometryConfig;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct BenchMasks {
    /// `all` (the eighteen fixed billiards scenes, four stacked structures, the real shelf), `fixed`, `stacked`, `real`, or
    /// ids such as fixed_08,stacked_box_on_stool,seq_shelf_tissue.
    #[arg(long, value_name = "IDS", default_value = "all")]
    pub scenes: String,
    /// Frames that are recorded of each generated scene.
    #[arg(long, value_name = "N", default_value_t = FRAMES)]
    pub frames: usize,
    /// Folder for results.json and a picture of each scene: colour, true labels, found labels.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Where rendered recordings are kept.
    #[arg(long, value_name = "DIR", default_value = "runs/bench-recordings")]
    pub cache: PathBuf,
}

pub(crate) fn run(context: &Context, a: &BenchMasks) -> anyhow::Result<()> {
    let base = BenchOptions::new(Preset::Standard, &a.cache);
    let options = BenchOptions {
        load: context.settings.section("frames", base.load.clone())?,
        read: context.settings.section("read", ReadOptions::default())?,
        masks: context.settings.section("masks", GeometryConfig::default())?,
        frames: a.frames,
        ..base
    };
    options.load.validate()?;
    let mut scores = Vec::new();
    for scene in select_mask_scenes(&a.scenes)? {
        let warnings = Warnings::new();
        let progress = context.progress.as_ref();
        match run_masks(&scene, &options, a.out.as_deref(), progress, &context.cancel, &warnings)? {
            Some((score, seconds)) => scores.push((scene, score, seconds)),
            None => context.say(format!("skipped: {scene} is absent (SMS_TEST_DATA names its folder)")),
        }
        context.tell(&warnings);
    }
    let only_real = |s: &BenchScene| matches!(s, BenchScene::Real(name) if REAL.contains(&name.as_str()));
    if scores.is_empty() || (scores.len() > 1 && scores.iter().all(|s| only_real(&s.0)) && a.scenes == "all")
    {
        return Err(InputError::new("no scene could be measured", "--scenes", "name other scenes").into());
    }
    let results = a.out.as_ref().map(|dir| dir.join("results.json"));
    finish(context, &masks_metrics(&scores), results.as_ref(), masks_table(&scores).trim_end())
}
