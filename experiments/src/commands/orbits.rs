//! `sms-experiments orbits`: pose refinement on generated orbits.

use super::shared::{finish, parse_seeds};
use clap::Args;
use sms_cli::front::Console;
use sms_core::{InputError, NoProgress, Seed, StageContext, Warnings};
use sms_experiments::{Orbit, OrbitKind, PoseFault, orbit_metrics, orbit_table, refine_orbit};
use sms_poses::PosesConfig;
use std::path::PathBuf;

#[derive(Debug, Args, Clone)]
pub(crate) struct OrbitsArguments {
    /// Seeds of scene, noise and faults: 1..20, or 1,2,5.
    #[arg(long, value_name = "SEEDS", default_value = "1..20")]
    pub seeds: String,
    /// Only these scenes: desk, box.
    #[arg(long, value_name = "SCENES", value_delimiter = ',')]
    pub scenes: Vec<String>,
    /// Only these faults: exact, independent, hand_eye, drift, color_shift, focal, all.
    #[arg(long, value_name = "FAULTS", value_delimiter = ',')]
    pub faults: Vec<String>,
    /// File for the figures (JSON).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

pub(crate) fn run(console: &Console, a: &OrbitsArguments) -> anyhow::Result<()> {
    let config = console.context.settings.section("poses", PosesConfig::default())?;
    config.validate()?;
    let seeds = parse_seeds(&a.seeds)?;
    let scenes = chosen(&a.scenes, "--scenes", &OrbitKind::ALL, OrbitKind::as_str)?;
    let faults = chosen(&a.faults, "--faults", &PoseFault::ALL, PoseFault::as_str)?;
    let progress = console.context.progress.as_ref();
    let mut rows = Vec::new();
    progress.begin("orbits", (seeds.len() * scenes.len() * faults.len()) as u64);
    for &scene in &scenes {
        for &seed in &seeds {
            let orbit = Orbit::record(scene, Seed(seed));
            for &fault in &faults {
                let warnings = Warnings::new();
                let context = StageContext::new(&NoProgress, &console.context.cancel, &warnings);
                let row = refine_orbit(&orbit, fault, &config, Seed(seed), context)?;
                rows.push(row);
                let what = format!("{} {} {seed}", scene.as_str(), fault.as_str());
                progress.update(rows.len() as u64, &what);
            }
        }
    }
    progress.end("");
    finish(console, &orbit_metrics(&rows), a.out.as_ref(), &orbit_table(&rows))
}

/// Returns the values with these names, or all without names.
pub(super) fn chosen<T: Copy>(
    names: &[String],
    option: &str,
    all: &[T],
    name_of: impl Fn(T) -> &'static str,
) -> Result<Vec<T>, InputError> {
    if names.is_empty() {
        return Ok(all.to_vec());
    }
    let known: Vec<&str> = all.iter().map(|&value| name_of(value)).collect();
    let find = |name: &String| {
        all.iter().copied().find(|&value| name_of(value) == name).ok_or_else(|| {
            InputError::new(format!("`{name}` is not known"), option, format!("use: {}", known.join(", ")))
        })
    };
    names.iter().map(find).collect()
}
