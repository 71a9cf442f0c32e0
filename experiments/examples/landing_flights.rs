//! Parts of the landing experiment without the command line's baselines, for studies: flights of chosen scenes and starts, with what
//! the planner is told of materials, each with its cost.
//!
//! `landing_flights FOLDER SCENES STARTS [key=value …]` with SCENES such as `1,3` and STARTS such as `0,5`. Keys: `told` (`class`,
//! `noisy`), `draw` (of the noise), `geometry` (`truth`, `scan`), `masks` (of scans: `truth`, `geometry`), `draft` (settings of
//! planner and scan), `random` (1: a random chooser among all places and approaches as well), `seed`.

use rand::RngExt;
use sms_core::{Cancel, NoProgress, Seed};
use sms_experiments::{
    BenchOptions, BilliardsGeometry, LandingBaseline, LandingBench, LandingFlight, LandingPart, MaskChoice,
    MaterialsTold, run_landing,
};
use sms_gaussians::Preset;
use sms_landing::{LandingAction, LandingSettings};
use std::error::Error;
use std::path::Path;

fn random() -> LandingBaseline<'static> {
    LandingBaseline {
        name: "random".to_owned(),
        variant: String::new(),
        choose: Box::new(|sight| {
            let landing = sight.landing;
            let mut rng = sight.seed.derive("random").rng();
            let places: Vec<_> = landing.surface().places().collect();
            let place = places[rng.random_range(0..places.len())];
            let b = landing.task().bounds;
            let mut within = |[low, high]: [f64; 2]| rng.random_range(low..high);
            Ok(Ok(LandingAction {
                landing_w: place.to_array(),
                approach_radius: within(b.approach_radius),
                approach_angle: within(b.approach_angle),
            }))
        }),
    }
}

fn show(f: &LandingFlight) {
    for (name, p) in &f.planned {
        println!(
            "scene {}, start {}, {} {}: {name} {} | predicted {:?} of worlds, {:?} | realised {:?}, jet {:?} | {}{} | {:.0} CPU-s \
             to plan, {:.0} in the target; sph {:.2?} s; {} of {} matched",
            f.scene,
            f.start,
            f.told.as_str(),
            f.draw,
            if p.success { "lands" } else { "FAILS" },
            p.predicted_share,
            p.predicted,
            p.realised,
            p.jet_success,
            p.failure.as_deref().or(p.problem.as_deref()).unwrap_or(""),
            if p.in_the_air { " (in the air)" } else { "" },
            p.plan_cpu_s,
            p.target_cpu_s,
            f.evaluation_s,
            f.matched,
            f.objects,
        );
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [out, scenes, starts, keys @ ..] = &args[..] else { return Err("FOLDER SCENES STARTS".into()) };
    let value = |key: &str| keys.iter().find_map(|k| k.strip_prefix(&format!("{key}="))).map(str::to_owned);
    let numbers = |text: &str| text.split(',').map(str::parse::<usize>).collect::<Result<Vec<_>, _>>();
    let is = |key: &str, word: &str| value(key).is_some_and(|v| v == word);
    let out = Path::new(out);
    let mut bench = LandingBench::new(numbers(scenes)?, out, out);
    if value("draft").is_some() {
        bench.scan.bench =
            BenchOptions { frames: 24, ..BenchOptions::new(Preset::Draft, out.join("recordings")) };
        bench.settings = LandingSettings::draft();
    }
    if is("geometry", "truth") {
        bench.geometry = BilliardsGeometry::Truth;
    }
    if is("masks", "truth") {
        bench.scan.masks = MaskChoice::Truth;
    }
    if value("random").is_some() {
        bench.baselines.push(random());
    }
    bench.seed = Seed(value("seed").map_or(Ok(0), |s| s.parse())?);
    let told = if is("told", "noisy") { MaterialsTold::Noisy } else { MaterialsTold::Class };
    let draw: usize = value("draw").map_or(Ok(0), |d| d.parse())?;
    for scene in bench.scenes.clone() {
        for &start in &numbers(starts)? {
            let part = LandingPart { scene, start, told, draw };
            show(&run_landing(&bench, part, &NoProgress, &Cancel::new())?);
        }
    }
    Ok(())
}
