//! `sms-experiments landing`: the paper's landing experiment.

use super::gpu;
use super::shared::{Geometry, Masks, finish, nothing_there, parse_shard, with_settings};
use anyhow::Context as _;
use clap::Args;
use sms_cli::front::{Console, EngineName, PresetName};
use sms_core::{InputError, Seed, StageContext, Warnings, length_text};
use sms_experiments::{
    BenchError, BenchOptions, FRAMES, LANDING_SCENES, LandingBaseline, LandingBench, LandingFlight,
    LandingScan, LandingSight, Shard, Standing, landing_metrics, landing_scan_metrics, landing_table,
    part_of, read_landings, run_landings, scan_landings,
};
use sms_frames::Frame;
use sms_landing::{LandingAction, Stuck};
use sms_pipeline::Device;
use sms_prompting::{
    ApproachSettings, Choice, Observation, PromptingInputs, SiteSettings, Sites, best_view, geometric,
    landing_sites, random, surfaces_of, visual_prompting,
};
use sms_scene::Scene;
use sms_sim::RestingDrift;
use sms_vlm::{ApiKey, Cache, ChooseError, Client, picture};
use std::path::{Path, PathBuf};

/// Folder of a model's stored replies, as in a run of `sms`.
const REPLIES: &str = "vlm";

/// Starts for each draw of the noise.
const NOISY_STARTS: usize = 4;

#[derive(Debug, Args, Clone)]
pub(crate) struct LandingArguments {
    /// Numbers of structures: 1 to 4, or seeds of drawn ones from 5 on (default: the four, with --quick 1).
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',')]
    pub scenes: Vec<usize>,
    /// With scanned models (folder meshes in SMS_TEST_DATA, default ../shared/data) in the place of box, tote, bin and one stool.
    #[arg(long)]
    pub scanned: bool,
    /// Starts on the circle (default: 10, with --quick 4).
    #[arg(long, value_name = "N")]
    pub starts: Option<usize>,
    /// Also plan with noisy materials: draws of the noise for each structure (default: 5), four starts each.
    #[arg(long, value_name = "DRAWS", num_args = 0..=1, default_missing_value = "5")]
    pub noisy: Option<usize>,
    /// Also let a vision-language model choose (the paper's visual prompting); server and model by SMS_VLM_URL and SMS_VLM_MODEL.
    #[arg(long)]
    pub visual_prompting: bool,
    /// Only every n-th flight, from the i-th (i/n, from 1). Shards may share the folder of the results; otherwise merge
    /// them with `sms-experiments merge`.
    #[arg(long, value_name = "I/N")]
    pub shard: Option<String>,
    /// Source of the planner's geometry.
    #[arg(long, value_enum, default_value = "scan")]
    pub geometry: Geometry,
    /// Masks of the scans.
    #[arg(long, value_enum, default_value = "geometry")]
    pub masks: Masks,
    /// Preset of the scans (default: standard).
    #[arg(long, value_enum)]
    pub preset: Option<PresetName>,
    /// Recorded frames per structure (default: 60, with --quick 24).
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Target engine (default: physx where it is built in, else rapier).
    #[arg(long, value_enum)]
    pub engine: Option<EngineName>,
    /// Random seed of all plans.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// One structure, four starts, 24 frames, a smaller search, coarser air: four minutes on two cores.
    #[arg(long)]
    pub quick: bool,
    /// Folder of the results: a file for each flight, and results.json.
    #[arg(long, value_name = "DIR", default_value = "runs/bench-landing")]
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

pub(crate) fn run(console: &Console, a: &LandingArguments) -> anyhow::Result<()> {
    let bench = bench(console, a)?;
    if a.scans_only {
        let line = |scan: &LandingScan| {
            let freed = match scan.freed.as_slice() {
                [] => String::new(),
                names => format!("; was fixed, free to topple: {}", names.join(", ")),
            };
            let held: String =
                scan.held.iter().map(|d| format!("; stays fixed: {}", drift_text(d))).collect();
            let stuck = scan.stuck.as_ref().map(|s| format!("; {}", stuck_text(s))).unwrap_or_default();
            let falling = scan.falling.as_ref().map(|why| format!("; {why}")).unwrap_or_default();
            let (scene, matched, objects) = (scan.scene, scan.matched, scan.objects);
            let stands = scan.standing.as_ref().map(standing_text).unwrap_or_default();
            console.say(format!(
                "scene {scene}: {matched} of {objects} objects matched{freed}{held}{stuck}{falling}{stands}"
            ));
        };
        let scans = scan_landings(&bench, &line, console.context.progress.as_ref(), &console.context.cancel)?;
        return if console.json { console.print_json(&landing_scan_metrics(&scans)) } else { Ok(()) };
    }
    if !a.table {
        let line = |f: &LandingFlight| console.say(flight_line(f));
        run_landings(&bench, &line, console.context.progress.as_ref(), &console.context.cancel)?;
    }
    let found = read_landings(&bench)?;
    if found.is_empty() {
        return Err(nothing_there(&a.out).into());
    }
    if a.shard.is_some() {
        part_with(bench.part, &bench, &found)?.save_in(&bench.out)?;
    }
    show(console, &found, Some(&a.out.join("results.json")))
}

/// Figures and table of all flights of a run or of merged parts.
fn show(console: &Console, found: &[LandingFlight], out: Option<&PathBuf>) -> anyhow::Result<()> {
    finish(console, &landing_metrics(found), out, landing_table(found).trim_end())
}

/// Shows merged parts in the same way.
pub(crate) fn show_merged(console: &Console, whole: &Shard, out: Option<&PathBuf>) -> anyhow::Result<()> {
    show(console, &flights_of(whole)?, out)
}

/// The shard of a part.
fn part_with(
    part: (usize, usize),
    bench: &LandingBench<'_>,
    found: &[LandingFlight],
) -> anyhow::Result<Shard> {
    let own = part_of(bench.flights(), part);
    let mut shard = Shard::new("landing", part, bench.settings());
    for f in found.iter().filter(|f| own.contains(&f.part())) {
        shard.put(&f.item(), f).context("a flight cannot be written")?;
    }
    Ok(shard)
}

/// Returns the flights of the parts in the order of a run without shards.
fn flights_of(whole: &Shard) -> anyhow::Result<Vec<LandingFlight>> {
    let mut found: Vec<LandingFlight> = whole.values()?.into_iter().map(|(_, flight)| flight).collect();
    found.sort_by_key(|f| (f.material_prior, f.scene, f.draw, f.start));
    Ok(found)
}

fn bench(console: &Console, a: &LandingArguments) -> anyhow::Result<LandingBench<'static>> {
    let keep = a.keep.clone().unwrap_or_else(|| a.out.clone());
    let mut scenes = a.scenes.clone();
    if scenes.is_empty() {
        scenes = if a.quick { vec![1] } else { LANDING_SCENES.collect() };
    }
    if scenes.contains(&0) {
        let cure = "give numbers from 1 to 4, or seeds from 5 on";
        return Err(InputError::new("there is no structure 0", "--scenes", cure).into());
    }
    let mut bench = if a.quick {
        LandingBench { scenes, ..LandingBench::quick(&keep, &a.out) }
    } else {
        LandingBench::new(scenes, &keep, &a.out)
    };
    let preset = a.preset.unwrap_or(PresetName::Standard);
    let base = BenchOptions::new(preset.preset(), keep.join("recordings"));
    bench.scan.bench = BenchOptions {
        frames: a.frames.unwrap_or(if a.quick { 24 } else { FRAMES }),
        ..with_settings(console, base)?
    };
    bench.scan.rescan = a.rescan;
    bench.scan.trainer = gpu::trainer_maker(a.device)?;
    bench.scan.masks = a.masks.choice();
    bench.geometry = a.geometry.choice();
    bench.scanned = a.scanned;
    bench.starts = a.starts.unwrap_or(bench.starts).clamp(1, 10);
    (bench.noisy_draws, bench.noisy_starts) = (a.noisy.unwrap_or(0), NOISY_STARTS);
    bench.seed = Seed(a.seed);
    bench.part = a.shard.as_deref().map(parse_shard).transpose()?.unwrap_or((1, 1));
    if let Some(engine) = a.engine {
        bench.engine = engine.engine();
    }
    bench.settings = console.context.settings.section("landing", bench.settings)?;
    bench.baselines = vec![
        baseline("geometric", "", |sight, sites, ways| {
            Ok(Ok(geometric(sites, sight.landing.start_w(), ways)))
        }),
        baseline("random", "", |sight, sites, ways| {
            Ok(Ok(random(sites, sight.landing.start_w(), ways, sight.seed)))
        }),
    ];
    if a.visual_prompting {
        bench.baselines.push(prompting(console, &keep, bench.seed)?);
    }
    Ok(bench)
}

/// The landing of a choice.
fn action_of(choice: &Choice) -> LandingAction {
    LandingAction {
        landing_w: choice.site.p_w.truncate().to_array(),
        approach_radius: choice.approach.radius,
        approach_angle: choice.approach.angle.rem_euclid(std::f64::consts::TAU),
    }
}

/// The frame with the best view of the sites; `None` if no frame shows them.
fn observation(frames: &[Frame], scene: &Scene, sites: &Sites) -> Option<Observation> {
    let frame = &frames[best_view(frames.iter().map(|f| &f.camera), &sites.sites)?];
    let image = picture(&frame.color_path, frame.color.size()).unwrap_or_else(|| frame.color.clone());
    let called = scene.body(&sites.platform).map(|b| b.description.clone()).filter(|d| !d.trim().is_empty());
    let target = called.unwrap_or_else(|| sites.platform.replace('_', " "));
    Some(Observation { image, camera: frame.camera, target })
}

fn drift_text(drift: &RestingDrift) -> String {
    let (moved, degrees) = (length_text(drift.moved_m), drift.turned_rad.to_degrees());
    format!("`{}` moved {moved} and turned {degrees:.1}° when left alone", drift.body)
}

fn stuck_text(stuck: &Stuck) -> String {
    let names = stuck.bodies.iter().map(|b| format!("`{b}`")).collect::<Vec<_>>().join(", ");
    let leaves = drift_text(&stuck.leaves);
    format!(
        "{names} cannot topple in this plan: fixed, because the structure does not stand otherwise ({leaves})"
    )
}

/// A chooser among the geometric candidates; without candidates it chooses nothing.
fn baseline(
    name: &str,
    variant: &str,
    choose: impl Fn(
        &LandingSight<'_>,
        &Sites,
        &ApproachSettings,
    ) -> Result<std::result::Result<Choice, String>, BenchError>
    + 'static,
) -> LandingBaseline<'static> {
    let choose = move |sight: &LandingSight<'_>| {
        let limits = sight.landing.task().surface;
        let settings = SiteSettings {
            min_height: limits.height_m,
            max_tilt: limits.slope_rad,
            ..SiteSettings::default()
        };
        let sites = match landing_sites(&surfaces_of(sight.scene), sight.landing.vehicle(), &settings) {
            Ok(sites) => sites,
            Err(nowhere) => return Ok(Err(nowhere.to_string())),
        };
        Ok(choose(sight, &sites, &ApproachSettings::default())?.map(|choice| action_of(&choice)))
    };
    LandingBaseline { name: name.to_owned(), variant: variant.to_owned(), choose: Box::new(choose) }
}

/// A vision-language model that sees the candidates. Its replies are stored beside the scans.
fn prompting(console: &Console, keep: &Path, seed: Seed) -> anyhow::Result<LandingBaseline<'static>> {
    let config = console.context.settings.section("vlm", sms_pipeline::settings::vlm_defaults())?;
    let key = ApiKey::new(&std::env::var("OPENAI_API_KEY").unwrap_or_default())?;
    let client = Client::new(&config, key, seed.derive("visual prompting"))?;
    let (cache, cancel) = (Cache::new(&keep.join(REPLIES)), console.context.cancel.clone());
    let model = config.model.clone();
    let choose = move |sight: &LandingSight<'_>, sites: &Sites, ways: &ApproachSettings| {
        let Some(seen) = observation(sight.frames()?, sight.scene, sites) else {
            return Ok(Err("no frame of the recording shows the landing sites from above".to_owned()));
        };
        let (start_w, warnings) = (sight.landing.start_w(), Warnings::new());
        let inputs = PromptingInputs { observation: &seen, sites, start_w, approaches: ways };
        match visual_prompting(&inputs, &client, &cache, StageContext::quiet(&cancel, &warnings)) {
            Ok(prompted) => Ok(Ok(prompted.choice)),
            // The model failed at it; a server that does not answer says nothing of the model.
            Err(e @ ChooseError::Undecided { .. }) => Ok(Err(e.to_string())),
            Err(e) => Err(e.input(&config.url).map_or_else(BenchError::from, BenchError::from)),
        }
    };
    Ok(baseline("visual_prompting", &model, choose))
}

/// Drift and tipping loads of a structure, beside the truth's.
fn standing_text(standing: &Standing) -> String {
    let drift =
        format!("; drifts {:.2} mm, {:.2}° in 2 s", 1e3 * standing.drift_m, standing.drift_rad.to_degrees());
    let (Some(load), Some([end, own]), Some([_, worst])) =
        (&standing.end, standing.end_errors(), standing.worst_errors())
    else {
        return drift;
    };
    let unmatched = match &standing.unmatched[..] {
        [] => String::new(),
        bodies => format!("; {} match no true object and keep the prior's mass", bodies.join(", ")),
    };
    format!(
        "{drift}; tips under {:.2} N at the overhang's end ({:+.0} % of the truth's {:.2} N; with true masses {:+.0} %, at most {:+.0} % \
         on its edge{unmatched})",
        load.planner_n,
        1e2 * end,
        load.truth_n,
        1e2 * own,
        1e2 * worst
    )
}

fn flight_line(f: &LandingFlight) -> String {
    let each: Vec<String> = f
        .planned
        .iter()
        .map(|(name, p)| {
            let why = p.failure.as_deref().map(|why| format!(" ({why})")).unwrap_or_default();
            format!("{name}: {}{why}", if p.success { "landed" } else { "failed" })
        })
        .collect();
    format!("scene {}, start {}, {}: {}", f.scene, f.start, f.material_prior.as_str(), each.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Hash;
    use sms_experiments::{LandingPart, merge_shards};

    fn flight(part: LandingPart) -> LandingFlight {
        LandingFlight {
            key: Hash(String::new()),
            scene: part.scene,
            scanned: false,
            engine: String::new(),
            start: part.start,
            material_prior: part.material_prior,
            draw: part.draw,
            objects: 2,
            matched: 2,
            evaluation_s: Some(0.1 * part.start as f64),
            planned: Default::default(),
        }
    }

    #[test]
    fn parts_of_a_run_make_the_run() {
        let dir = tempfile::tempdir().unwrap();
        let mut bench = LandingBench::new(vec![1, 2], dir.path(), dir.path());
        (bench.starts, bench.noisy_draws, bench.noisy_starts) = (3, 2, 2);
        let all: Vec<LandingFlight> = bench.flights().into_iter().map(flight).collect();
        assert_eq!(all.len(), 2 * 3 + 2 * 2 * 2);
        for i in 1..=3 {
            // All parts read the folder that they share, and write their own results.
            let shard = part_with((i, 3), &bench, &all).unwrap();
            assert!(shard.items.len() < all.len());
            shard.save_in(dir.path()).unwrap();
        }
        let merged = merge_shards(&[dir.path().to_owned()]).unwrap();
        assert!(merged.missing.is_empty() && merged.builds == 1);
        let flights = flights_of(&merged.whole).unwrap();
        assert_eq!(flights, all);
        assert_eq!(landing_metrics(&flights), landing_metrics(&all));
        // With other settings they are no parts of one run.
        bench.seed = Seed(1);
        part_with((1, 3), &bench, &all).unwrap().save_in(dir.path()).unwrap();
        assert!(merge_shards(&[dir.path().to_owned()]).unwrap_err().to_string().contains("`seed`"));
    }
}
