//! `sms-experiments materialize`: meshes of scanned models against the models.

use super::gpu;
use super::shared::{finish, parse_shard, read_baseline, with_settings};
use clap::{Args, ValueEnum};
use sms_cli::front::{Console, PresetName};
use sms_core::metrics::Metrics;
use sms_core::{InputError, StageContext, Warnings};
use sms_experiments::{
    BenchOptions, BenchScene, FRAMES, HOLDOUT, MODELS, MaskChoice, MaterializeOptions, Shard,
    add_materialize_means, materialize_markdown, materialize_table, model_path, part_of, run_materialize,
};
use sms_pipeline::Device;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct MaterializeStudyArguments {
    /// Models with one of these words in their names (default: all eighteen, unless --seeds are given).
    #[arg(long, value_name = "WORDS", value_delimiter = ',')]
    pub objects: Vec<String>,
    /// Generated scenes of ten objects with these seeds.
    #[arg(long, value_name = "SEEDS", value_delimiter = ',')]
    pub seeds: Vec<u64>,
    /// Preset of the scans.
    #[arg(long, value_enum, default_value = "standard")]
    pub preset: PresetName,
    /// Masks of the scans.
    #[arg(long, value_enum, default_value = "auto")]
    pub masks: MaskChoiceName,
    /// Recorded frames per object.
    #[arg(long, value_name = "N", default_value_t = FRAMES)]
    pub frames: usize,
    /// Folder of kept scans, of their recordings (recordings/) and of the meshes.
    #[arg(long, value_name = "DIR", default_value = "runs/bench-meshes")]
    pub keep: PathBuf,
    /// Scan again even if a kept scan exists (kept scans are not invalidated by code changes).
    #[arg(long)]
    pub rescan: bool,
    /// Device of the scans; `auto` here means the CPU, so that figures stay comparable.
    #[arg(long, value_name = "cpu|gpu[:N]", default_value = "auto")]
    pub device: Device,
    /// Only every n-th object, from the i-th (i/n, from 1); for `sms-experiments merge`.
    #[arg(long, value_name = "I/N", requires = "out")]
    pub shard: Option<String>,
    /// File for the results.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Earlier results (--out, or the output of --json), to print differences to.
    #[arg(long, value_name = "FILE")]
    pub compare: Option<PathBuf>,
    /// Print a Markdown table.
    #[arg(long)]
    pub markdown: bool,
    /// Print the table of earlier results without measuring (--out, or the output of --json).
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
}

/// Masks of generated scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum MaskChoiceName {
    /// From geometry; the true ones for objects longer than its settings allow (`masks.max_object_m`).
    Auto,
    /// From geometry, as in `sms scan`.
    Geometry,
    /// The true ones.
    Truth,
}

pub(crate) fn run(console: &Console, a: &MaterializeStudyArguments) -> anyhow::Result<()> {
    let mut scenes = match (&a.objects[..], &a.seeds[..]) {
        ([], [_, ..]) => Vec::new(),
        ([], []) => MODELS.iter().map(|m| BenchScene::Model((*m).to_owned())).collect(),
        (words, _) => sms_experiments::select_models(words)?,
    };
    scenes.extend(a.seeds.iter().map(|&seed| BenchScene::Ten(seed)));
    let baseline = a.compare.as_deref().map(read_baseline).transpose()?;
    if let Some(path) = &a.table {
        let metrics = read_baseline(path)?;
        scenes.retain(|s| metrics.number(&format!("bench.materialize.{s}.seconds")).is_some());
        return show(console, a, &metrics, &scenes, baseline.as_ref());
    }
    let options = options(console, a)?;
    let part = a.shard.as_deref().map(parse_shard).transpose()?;
    scenes = part_of(scenes, part.unwrap_or((1, 1)));
    let mut shard = Shard::new("materialize", part.unwrap_or((1, 1)), options.settings());
    let mut metrics = Metrics::new();
    let mut measured = Vec::new();
    for scene in scenes {
        if let BenchScene::Model(name) = &scene
            && !model_path(name).is_file()
        {
            eprintln!("skipped {scene}: there is no {} (SMS_TEST_DATA)", model_path(name).display());
            continue;
        }
        let warnings = Warnings::new();
        let progress = console.context.progress.as_ref();
        if let Some(figures) = run_materialize(
            &scene,
            &options,
            StageContext::new(progress, &console.context.cancel, &warnings),
        )? {
            shard.add(&scene.to_string(), &figures);
            metrics.merge(figures);
            measured.push(scene.clone());
        }
        for w in warnings.snapshot() {
            eprintln!("warning: {scene}: {}", w.message);
        }
    }
    if measured.is_empty() {
        return Err(InputError::new(
            "none of these objects is here",
            "--objects",
            "set SMS_TEST_DATA to the folder that holds meshes/, or give --seeds",
        )
        .into());
    }
    add_materialize_means(&mut metrics, &measured);
    metrics.set("bench.materialize.preset", options.bench.preset_name());
    if let Some(path) = &a.out {
        metrics.save(path)?;
        if part.is_some() {
            shard.save(&Shard::path_beside(path))?;
        }
    }
    show(console, a, &metrics, &measured, baseline.as_ref())
}

/// Figures and table of merged parts.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    // The order of a run without shards.
    let models = MODELS.iter().map(|m| BenchScene::Model((*m).to_owned()));
    let seeds = whole.items.keys().filter_map(|k| Some(BenchScene::Ten(k.rsplit('_').next()?.parse().ok()?)));
    let mut scenes: Vec<BenchScene> = models.chain(seeds).collect();
    scenes.retain(|s| whole.items.contains_key(&s.to_string()));
    let mut metrics = Metrics::new();
    whole.items.keys().for_each(|k| metrics.merge(whole.figures(k)));
    add_materialize_means(&mut metrics, &scenes);
    metrics.set("bench.materialize.preset", whole.setting::<String>("preset")?);
    finish(console, &metrics, out, materialize_table(&metrics, &scenes, None).trim_end())
}

fn show(
    console: &Console,
    a: &MaterializeStudyArguments,
    metrics: &Metrics,
    scenes: &[BenchScene],
    baseline: Option<&Metrics>,
) -> anyhow::Result<()> {
    if console.json {
        return console.print_json(metrics);
    }
    let text = if a.markdown {
        materialize_markdown(metrics, scenes)
    } else {
        materialize_table(metrics, scenes, baseline)
    };
    console.print(text.trim_end());
    Ok(())
}

fn options(console: &Console, a: &MaterializeStudyArguments) -> anyhow::Result<MaterializeOptions> {
    if a.frames < HOLDOUT {
        let cure = format!("record at least {HOLDOUT} frames");
        return Err(InputError::new("no frame would be held out", "--frames", cure).into());
    }
    let base = BenchOptions::new(a.preset.preset(), a.keep.join("recordings"));
    Ok(MaterializeOptions {
        bench: BenchOptions { frames: a.frames, ..with_settings(console, base)? },
        masks: match a.masks {
            MaskChoiceName::Auto => MaskChoice::Auto,
            MaskChoiceName::Geometry => MaskChoice::Geometry,
            MaskChoiceName::Truth => MaskChoice::Truth,
        },
        keep: a.keep.clone(),
        rescan: a.rescan,
        trainer: gpu::trainer_maker(a.device)?,
    })
}
