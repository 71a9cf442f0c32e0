//! `sms-experiments billiards`: the paper's billiards experiment.

use super::gpu;
use super::shared::{Geometry, Masks, PriorName, finish, nothing_there, parse_shard, with_settings};
use anyhow::Context as _;
use clap::{Args, ValueEnum};
use serde_json::{Map, Value};
use sms_cli::front::{Console, EngineName, PathName, PresetName};
use sms_core::{InputError, Seed, length_text};
use sms_experiments::{
    BenchOptions, BilliardsBench, BilliardsScene, FRAMES, Row, Shard, billiards_metrics, billiards_table,
    part_of, read_billiards, run_billiards, scan_billiards, write_pictures, write_shots,
};
use sms_pipeline::Device;
use sms_plan::PlanConfig;
use sms_synth::{FIXED_SCENES, FixedScene, billiards_scene};
use sms_vlm::{ApiKey, Client};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Scenes of `--quick`: the one without obstacles, one with a far goal, and the one with two rebounds.
const QUICK: [usize; 3] = [1, 8, 18];

#[derive(Debug, Args, Clone)]
pub(crate) struct BilliardsArguments {
    /// Numbers of scenes, 1 to 18 (default: all, with --quick 1,8,18); from 1001 on, drawn ones that were not selected.
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    pub scenes: Vec<usize>,
    /// Only every n-th of them, from the i-th (i/n, from 1).
    #[arg(long, value_name = "I/N")]
    pub shard: Option<String>,
    /// The planner's knowledge of the true materials, one value after another.
    #[arg(long, value_enum, value_name = "WHAT", value_delimiter = ',', default_value = "class")]
    pub materials: Vec<PriorName>,
    /// Source of the planner's geometry.
    #[arg(long, value_enum, default_value = "scan")]
    pub geometry: Geometry,
    /// Masks of the scans.
    #[arg(long, value_enum, default_value = "geometry")]
    pub masks: Masks,
    /// Preset of the scans (default: standard, with --quick draft).
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Recorded frames per scene (default: 60, with --quick 24).
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Heights of the camera path in the recordings.
    #[arg(long, value_enum, default_value = "high")]
    pub path: PathName,
    /// Target engines (default: all that are built in).
    #[arg(long, value_enum, value_name = "ENGINES", value_delimiter = ',')]
    pub engines: Vec<EngineName>,
    /// Rows to plan (default: all).
    #[arg(long, value_enum, value_name = "ROWS", value_delimiter = ',')]
    pub rows: Vec<RowName>,
    /// Number of plans for each of the rows `paper` and `ours` (default: 30, with --quick 6).
    #[arg(long, value_name = "N")]
    pub starts: Option<usize>,
    /// Attribute the loss between predicted and realised: shapes, poses, materials and engine are replaced by the truth one at a
    /// time, and STARTS starts (default: 8) are planned again with each.
    #[arg(long, value_name = "STARTS", num_args = 0..=1, default_missing_value = "8")]
    pub ablation: Option<usize>,
    /// Random seed of all plans.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// Three scenes, draft scans and plans: at most ten minutes.
    #[arg(long)]
    pub quick: bool,
    /// Folder of the results: a file for each scene, shots.parquet and results.json.
    #[arg(long, value_name = "DIR", default_value = "runs/bench-billiards")]
    pub out: PathBuf,
    /// Folder of recordings and scans (default: the folder of the results).
    #[arg(long, value_name = "DIR")]
    pub keep: Option<PathBuf>,
    /// Scan again even if a kept scan exists (kept scans are not invalidated by code changes).
    #[arg(long)]
    pub rescan: bool,
    /// Device of the scans; `auto` here means the CPU, so that figures stay comparable.
    #[arg(long, value_name = "cpu|gpu[:N]", default_value = "auto")]
    pub device: Device,
    /// Only scan and make the bodies. Another run, also on another machine, resumes from the folder of --keep.
    #[arg(long, conflicts_with = "table")]
    pub scans_only: bool,
    /// Only print the results in the folder.
    #[arg(long)]
    pub table: bool,
}

/// Planners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum RowName {
    /// The paper's planner, with bodies built as in the paper.
    Paper,
    /// The planner of `sms` with a small budget from each start.
    Ours,
    /// The single robust plan per scene that a user would execute.
    Robust,
    /// The paper's grid baseline.
    Grid,
}

impl RowName {
    fn row(self) -> Row {
        match self {
            Self::Paper => Row::Paper,
            Self::Ours => Row::Ours,
            Self::Robust => Row::Robust,
            Self::Grid => Row::Grid,
        }
    }
}

pub(crate) fn run(console: &Console, a: &BilliardsArguments) -> anyhow::Result<()> {
    let bench = bench(console, a)?;
    if a.scans_only {
        let line = |s: &FixedScene, matched: usize, objects: usize| {
            console.say(format!(
                "scene {:>2} ({}): {matched} of {objects} objects matched",
                s.number,
                s.layout.as_str()
            ));
        };
        return Ok(scan_billiards(
            &bench,
            &line,
            console.context.progress.as_ref(),
            &console.context.cancel,
        )?);
    }
    let mut unanswered = None;
    if !a.table {
        let line = |s: &BilliardsScene| console.say(scene_line(s));
        unanswered =
            run_billiards(&bench, &line, console.context.progress.as_ref(), &console.context.cancel)?;
    }
    let found = read_billiards(&bench)?;
    if found.is_empty() {
        return Err(unanswered.unwrap_or_else(|| nothing_there(&a.out)).into());
    }
    if let Some(part) = a.shard.as_deref().map(parse_shard).transpose()? {
        let mut shard = Shard::new("billiards", part, bench.settings());
        let own = |s: &&BilliardsScene| bench.scenes.iter().any(|fixed| fixed.number == s.number);
        for s in found.iter().filter(own) {
            let item = format!("{} {:02}", s.material_prior.as_str(), s.number);
            shard.put(&item, s).context("a scene's result cannot be written")?;
        }
        shard.save_in(&bench.out)?;
    }
    show(console, &found, &bench.settings(), &bench.out)?;
    // Reported at the end and by the exit code, so that a driver of parts runs this one again.
    unanswered.map_or(Ok(()), |why| Err(why.into()))
}

/// Writes the figures, shots and pictures of all scenes of a run or of merged parts, and prints the table.
fn show(
    console: &Console,
    found: &[BilliardsScene],
    settings: &Map<String, Value>,
    out: &Path,
) -> anyhow::Result<()> {
    let mut metrics = billiards_metrics(found);
    for name in ["geometry", "preset", "starts"] {
        metrics.set(format!("bench.billiards.{name}"), settings.get(name).cloned().unwrap_or_default());
    }
    write_shots(&out.join("shots.parquet"), found)?;
    let text = billiards_table(found);
    write_pictures(out, found, &text)?;
    finish(console, &metrics, Some(&out.join("results.json")), text.trim_end())
}

/// Shows merged parts in the same way.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: &Path) -> anyhow::Result<()> {
    let mut found: Vec<BilliardsScene> = whole.values()?.into_iter().map(|(_, scene)| scene).collect();
    found.sort_by_key(|s| (s.material_prior, s.number));
    show(console, &found, &whole.settings, out)
}

fn bench(console: &Console, a: &BilliardsArguments) -> anyhow::Result<BilliardsBench> {
    let preset = a.preset.unwrap_or(if a.quick { PresetName::Draft } else { PresetName::Standard });
    let keep = a.keep.clone().unwrap_or_else(|| a.out.clone());
    let mut bench = BilliardsBench::new(scenes(a)?, &keep, &a.out);
    let base = BenchOptions::new(preset.preset(), keep.join("recordings"));
    bench.scan.bench = BenchOptions {
        frames: a.frames.unwrap_or(if a.quick { 24 } else { FRAMES }),
        path: a.path.path(),
        ..with_settings(console, base)?
    };
    bench.scan.rescan = a.rescan;
    bench.scan.trainer = gpu::trainer_maker(a.device)?;
    bench.scan.masks = a.masks.choice();
    bench.geometry = a.geometry.choice();
    bench.material_prior = a.materials.iter().map(|t| t.prior()).collect();
    if a.materials.contains(&PriorName::Vlm) {
        let config = console.context.settings.section("vlm", sms_pipeline::settings::vlm_defaults())?;
        let key = ApiKey::new(&std::env::var("OPENAI_API_KEY").unwrap_or_default())?;
        bench.vlm = Some(Arc::new(Client::new(&config, key, bench.seed.derive("vlm"))?));
    }
    if !a.engines.is_empty() {
        bench.engines = a.engines.iter().map(|e| e.engine()).collect();
        for engine in &bench.engines {
            // Said at once, not after an hour.
            engine.target()?;
        }
    }
    bench.starts = a.starts.unwrap_or(if a.quick { 6 } else { bench.starts }).max(1);
    bench.seed = Seed(a.seed);
    bench.ablation_starts = a.ablation.map_or(0, |starts| starts.max(1));
    if !a.rows.is_empty() {
        bench.rows = Row::ALL.into_iter().filter(|row| a.rows.iter().any(|r| r.row() == *row)).collect();
        let is_there = |row: &Row| bench.rows.contains(row);
        if bench.ablation_starts > 0 && ![Row::Ours, Row::Robust].iter().all(is_there) {
            let what = "the ablation needs the rows `ours` and `robust`";
            return Err(InputError::new(what, "--rows", "add them, or leave --ablation out").into());
        }
    }
    let robust = if a.quick { PlanConfig::draft() } else { PlanConfig::default() };
    bench.robust =
        console.context.settings.section("plan", PlanConfig { sensitivity_rollouts: 0, ..robust })?;
    Ok(bench)
}

fn scenes(a: &BilliardsArguments) -> anyhow::Result<Vec<FixedScene>> {
    let numbers = match (&a.scenes[..], a.quick) {
        ([], true) => QUICK.to_vec(),
        ([], false) => FIXED_SCENES.iter().map(|s| s.number).collect(),
        (numbers, _) => numbers.to_vec(),
    };
    let scene = |number: usize| {
        billiards_scene(number).ok_or_else(|| {
            InputError::new(
                format!("there is no scene {number}"),
                "--scenes",
                "give numbers from 1 to 18, such as 1,8,18, or of drawn scenes, from 1001 on",
            )
        })
    };
    let mut scenes = numbers.into_iter().map(scene).collect::<Result<Vec<_>, _>>()?;
    if let Some(shard) = &a.shard {
        let (i, n) = parse_shard(shard)?;
        scenes = part_of(scenes, (i, n));
    }
    Ok(scenes)
}

/// Summary of one scene.
fn scene_line(s: &BilliardsScene) -> String {
    let mean = |values: Vec<f64>| length_text(values.iter().sum::<f64>() / values.len().max(1) as f64);
    let mut line = format!(
        "scene {:>2} ({}, {}): {} of {} objects matched",
        s.number,
        s.layout.as_str(),
        s.material_prior.as_str(),
        s.matched,
        s.objects,
    );
    if s.plans.contains_key(&Row::Ours) {
        line.push_str(&format!("; predicted {}", mean(s.predicted_m(Row::Ours))));
    }
    for engine in s.realised.keys() {
        let of = |row| s.realised_m(engine, row).map(mean);
        let material_prior: Vec<String> = [("ours", Row::Ours), ("one plan", Row::Robust)]
            .into_iter()
            .filter_map(|(name, row)| Some(format!("{name} {}", of(row)?)))
            .collect();
        if !material_prior.is_empty() {
            line.push_str(&format!("; {engine} {}", material_prior.join(", ")));
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        billiards: BilliardsArguments,
    }

    fn numbers(arguments: &[&str]) -> anyhow::Result<Vec<usize>> {
        let command = Command::parse_from(std::iter::once(&"bench").chain(arguments));
        Ok(scenes(&command.billiards)?.iter().map(|s| s.number).collect())
    }

    #[test]
    fn shards_part_the_scenes() {
        assert_eq!(numbers(&[]).unwrap().len(), 18);
        assert_eq!(numbers(&["--quick"]).unwrap(), QUICK);
        assert_eq!(numbers(&["--scenes", "3,1,2", "--shard", "2/2"]).unwrap(), [1]);
        let mut all: Vec<usize> =
            ["1/3", "2/3", "3/3"].iter().flat_map(|s| numbers(&["--shard", s]).unwrap()).collect();
        all.sort_unstable();
        assert_eq!(all, (1..=18).collect::<Vec<_>>());
        assert!(numbers(&["--scenes", "19"]).unwrap_err().to_string().contains("19"));
        assert!(numbers(&["--shard", "3/2"]).is_err());
    }
}
