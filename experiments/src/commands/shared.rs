//! Arguments and output that several experiments share.

use clap::ValueEnum;
use serde_json::{Map, Value};
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{CoreError, InputError};
use sms_experiments::{BenchOptions, BilliardsGeometry, MaskChoice, MaterialPrior, SceneFamily, Shard};
use std::path::{Path, PathBuf};

/// Family of the scenes in a planner's benchmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Family {
    /// The paper's: free corridors from cue to target ball to goal, cut of at most 35°.
    Open,
    /// Nine obstacles that may stand in the way, cut of up to 75°.
    Crowded,
    /// The eighteen scenes of `sms-experiments billiards`; the seeds are their numbers.
    Fixed,
}

impl Family {
    pub(crate) fn family(self) -> SceneFamily {
        match self {
            Self::Open => SceneFamily::Open,
            Self::Crowded => SceneFamily::Crowded,
            Self::Fixed => SceneFamily::Fixed,
        }
    }
}

/// The planner's knowledge of materials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum PriorName {
    /// The handbook's values for the true class.
    Class,
    /// The true values with errors like those of vision-language models.
    Noisy,
    /// No knowledge: the prior.
    Prior,
    /// The truth.
    Truth,
    /// Estimates of a vision-language model from the scan's views (SMS_VLM_URL, SMS_VLM_MODEL).
    Vlm,
}

impl PriorName {
    pub(crate) fn prior(self) -> MaterialPrior {
        match self {
            Self::Class => MaterialPrior::Class,
            Self::Noisy => MaterialPrior::Noisy,
            Self::Prior => MaterialPrior::Prior,
            Self::Truth => MaterialPrior::Truth,
            Self::Vlm => MaterialPrior::Vlm,
        }
    }
}

/// Source of geometry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Geometry {
    /// A scan of a generated recording.
    Scan,
    /// The truth, for ablations and quick tests.
    Truth,
}

/// Masks of scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Masks {
    /// From geometry, as in `sms scan`.
    Geometry,
    /// The true ones.
    Truth,
}

impl Geometry {
    pub(crate) fn choice(self) -> BilliardsGeometry {
        match self {
            Self::Scan => BilliardsGeometry::Scan,
            Self::Truth => BilliardsGeometry::Truth,
        }
    }
}

impl Masks {
    pub(crate) fn choice(self) -> MaskChoice {
        match self {
            Self::Geometry => MaskChoice::Geometry,
            Self::Truth => MaskChoice::Truth,
        }
    }
}

/// The error for a folder without results of these settings.
pub(crate) fn nothing_there(out: &Path) -> InputError {
    InputError::new(
        "the folder holds no results of these settings",
        out,
        "run it without --table, or with the settings that it was made with",
    )
}

/// Keeps the figures of a benchmark and prints them, or `text` for people.
pub(crate) fn finish(
    console: &Console,
    metrics: &Metrics,
    out: Option<&PathBuf>,
    text: &str,
) -> anyhow::Result<()> {
    if let Some(out) = out {
        metrics.save(out)?;
    }
    if console.json {
        return console.print_json(metrics);
    }
    console.say(text);
    Ok(())
}

/// `1001..1012` (both included), `1,2,7`, or a mixture.
pub(crate) fn parse_seeds(text: &str) -> anyhow::Result<Vec<u64>> {
    let mut seeds = Vec::new();
    for part in text.split(',').map(str::trim) {
        let number = |s: &str| s.trim().parse::<u64>();
        match part.split_once("..") {
            None => seeds.push(number(part)),
            Some((first, last)) => match (number(first), number(last.trim_start_matches('='))) {
                (Ok(first), Ok(last)) if first <= last && last - first < 10_000 => {
                    seeds.extend((first..=last).map(Ok));
                }
                (Err(e), _) | (_, Err(e)) => seeds.push(Err(e)),
                _ => return Err(no_seeds(text).into()),
            },
        }
    }
    let seeds: Vec<u64> = seeds.into_iter().collect::<Result<_, _>>().map_err(|_| no_seeds(text))?;
    Ok(seeds)
}

fn no_seeds(text: &str) -> InputError {
    InputError::new(
        format!("`{text}` is not a list of seeds"),
        "--seeds",
        "give a range such as 1001..1012, or a list such as 1,2,7",
    )
}

/// Seeds that are the names of items, in order.
pub(crate) fn seeds_of(whole: &Shard) -> Vec<u64> {
    let mut seeds: Vec<u64> = whole.items.keys().filter_map(|k| k.parse().ok()).collect();
    seeds.sort_unstable();
    seeds
}

/// Settings of a part by their names.
pub(crate) fn settings<const N: usize>(all: [(&str, Value); N]) -> Map<String, Value> {
    all.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}

/// The user's settings of frames, masks, scan and entities over those of `base`.
pub(crate) fn with_settings(console: &Console, base: BenchOptions) -> anyhow::Result<BenchOptions> {
    Ok(BenchOptions {
        load: console.context.settings.section("frames", base.load)?,
        read: console.context.settings.section("read", base.read)?,
        masks: console.context.settings.section("masks", base.masks)?,
        scan: console.context.settings.section("scan", base.scan)?,
        entities: console.context.settings.section("entities", base.entities)?,
        ..base
    })
}

/// Reads the results of an earlier run, to compare with.
pub(crate) fn read_baseline(path: &Path) -> anyhow::Result<Metrics> {
    if !path.is_file() {
        let cure = "give the results of an earlier run, as --out writes them";
        return Err(CoreError::from(InputError::new(
            "the file does not exist",
            path.display().to_string(),
            cure,
        ))
        .into());
    }
    Ok(Metrics::load(path)?)
}

/// `2/4`: the second of four parts.
pub(crate) fn parse_shard(text: &str) -> anyhow::Result<(usize, usize)> {
    let parts =
        text.split_once('/').and_then(|(i, n)| Some((i.trim().parse().ok()?, n.trim().parse().ok()?)));
    match parts {
        Some((i, n)) if 1 <= i && i <= n => Ok((i, n)),
        _ => {
            Err(InputError::new(format!("`{text}` is not a shard"), "--shard", "write for example 2/4")
                .into())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_ranges_and_lists() {
        assert_eq!(parse_seeds("1001..1003").unwrap(), [1001, 1002, 1003]);
        assert_eq!(parse_seeds("7, 1..=2").unwrap(), [7, 1, 2]);
        for bad in ["", "x", "3..1", "1..x"] {
            assert!(parse_seeds(bad).unwrap_err().downcast_ref::<InputError>().is_some(), "{bad}");
        }
    }

    #[test]
    fn shards_are_counted_from_one() {
        assert_eq!(parse_shard("2/4").unwrap(), (2, 4));
        for bad in ["0/2", "3/2", "2", "a/b"] {
            assert!(parse_shard(bad).is_err(), "{bad}");
        }
    }
}
