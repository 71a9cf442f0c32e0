//! `sms-experiments masks`: masks from geometry against the truth.

use super::shared::{finish, parse_shard, settings};
use anyhow::Context as _;
use clap::Args;
use sms_cli::front::Console;
use sms_core::{InputError, StageContext, Warnings};
use sms_eval::MaskScores;
use sms_experiments::{
    BenchOptions, BenchScene, FRAMES, REAL, Shard, masks_metrics, masks_table, part_of, run_masks,
    select_mask_scenes,
};
use sms_frames::ReadOptions;
use sms_gaussians::Preset;
use sms_masks::GeometryConfig;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct MaskStudyArguments {
    /// `all` (the eighteen fixed billiards scenes, four stacked structures, the real shelf), `fixed`, `stacked`, `real`, or
    /// ids such as fixed_08,stacked_box_on_stool,seq_shelf_tissue.
    #[arg(long, value_name = "IDS", default_value = "all")]
    pub scenes: String,
    /// Recorded frames per generated scene.
    #[arg(long, value_name = "N", default_value_t = FRAMES)]
    pub frames: usize,
    /// Only every n-th scene, from the i-th (i/n, from 1); for `sms-experiments merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// Folder for results.json and a picture of each scene: colour, true labels, found labels.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Folder of rendered recordings.
    #[arg(long, value_name = "DIR", default_value = "runs/bench-recordings")]
    pub cache: PathBuf,
}

pub(crate) fn run(console: &Console, a: &MaskStudyArguments) -> anyhow::Result<()> {
    let base = BenchOptions::new(Preset::Standard, &a.cache);
    let options = BenchOptions {
        load: console.context.settings.section("frames", base.load.clone())?,
        read: console.context.settings.section("read", ReadOptions::default())?,
        masks: console.context.settings.section("masks", GeometryConfig::default())?,
        frames: a.frames,
        ..base
    };
    options.load.validate()?;
    let part = a.shard.as_deref().map(parse_shard).transpose()?;
    let mut scores = Vec::new();
    for scene in part_of(select_mask_scenes(&a.scenes)?, part.unwrap_or((1, 1))) {
        let warnings = Warnings::new();
        let progress = console.context.progress.as_ref();
        match run_masks(
            &scene,
            &options,
            a.out.as_deref(),
            StageContext::new(progress, &console.context.cancel, &warnings),
        )? {
            Some((score, seconds)) => scores.push((scene, score, seconds)),
            None => console.say(format!("skipped: {scene} is absent (SMS_TEST_DATA names its folder)")),
        }
        console.context.warn(&warnings);
    }
    let only_real = |s: &BenchScene| matches!(s, BenchScene::Real(name) if REAL.contains(&name.as_str()));
    let none_generated = scores.len() > 1 && scores.iter().all(|s| only_real(&s.0)) && a.scenes == "all";
    if let (Some(part), Some(dir)) = (part, &a.out) {
        // None of its scenes may be here.
        part_with(part, &options, &scores)?.save_in(dir)?;
    } else if scores.is_empty() || none_generated {
        return Err(InputError::new("no scene could be measured", "--scenes", "name other scenes").into());
    }
    let results = a.out.as_ref().map(|dir| dir.join("results.json"));
    finish(console, &masks_metrics(&scores), results.as_ref(), masks_table(&scores).trim_end())
}

type Scored = (BenchScene, MaskScores, f64);

fn part_with(part: (usize, usize), options: &BenchOptions, scores: &[Scored]) -> anyhow::Result<Shard> {
    let mut shard = Shard::new("masks", part, settings(options.settings()));
    for (scene, score, seconds) in scores {
        shard.put(&scene.to_string(), &(score, seconds)).context("a score cannot be written")?;
    }
    Ok(shard)
}

/// Figures and table of parts.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    let scores = scores_of(whole)?;
    finish(console, &masks_metrics(&scores), out, masks_table(&scores).trim_end())
}

/// Returns the scores of the parts in the order of a run without shards.
fn scores_of(whole: &Shard) -> anyhow::Result<Vec<Scored>> {
    let usual: Vec<String> = select_mask_scenes("all")?.iter().map(BenchScene::to_string).collect();
    let mut all: Vec<(&str, (MaskScores, f64))> = whole.values()?;
    all.sort_by_key(|(name, _)| usual.iter().position(|u| u == name).unwrap_or(usual.len()));
    all.into_iter().map(|(name, (score, s))| Ok((select_mask_scenes(name)?.remove(0), score, s))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_eval::MaskedObject;
    use sms_experiments::merge_shards;

    #[test]
    fn parts_of_a_run_make_the_run() {
        let dir = tempfile::tempdir().unwrap();
        let options = BenchOptions::new(Preset::Standard, dir.path());
        let score = |(i, scene): (usize, BenchScene)| {
            let object = MaskedObject { name: "mug".into(), iou: 1.0 / (i + 1) as f64, held_share: 0.1 };
            let score =
                MaskScores { objects: vec![object], labels: i, false_labels: 1, whole_truth: i % 5 > 0 };
            (scene, score, 0.3)
        };
        let all: Vec<Scored> =
            select_mask_scenes("all").unwrap().into_iter().enumerate().map(score).collect();
        for i in 1..=4 {
            let own = part_of(all.clone(), (i, 4));
            part_with((i, 4), &options, &own).unwrap().save_in(dir.path()).unwrap();
        }
        let merged = merge_shards(&[dir.path().to_owned()]).unwrap();
        let scores = scores_of(&merged.whole).unwrap();
        assert_eq!(masks_metrics(&scores), masks_metrics(&all));
        assert_eq!(masks_table(&scores), masks_table(&all));
    }
}
