//! Landings on the fixed structures with true geometry: what rollouts cost, what toppled, what plans are worth.
//!
//! `landing_study WHAT SCENES STARTS [key=value …]` with WHAT one of `cost`, `over`, `straight`, `random`, `plan`; SCENES such as
//! `1,3`, STARTS such as `0,5`. Keys: `engine`, `seed`, `target` (0: the planner's world alone), `speed` (m/s), `slide` (metres by which
//! the overhang is longer), `draft`, `spacing` (metres: of the planner's particles, of which the target's is half).

use glamx::DVec2;
use rand::RngExt;
use sms_core::{Cancel, NoProgress, Seed, Warnings};
use sms_landing::{
    LandingAction, LandingOutcome, LandingSettings, LandingTask, LandingWorld, ResolvedLanding,
    RolloutOptions, plan_landing,
};
use sms_scene::Scene;
use sms_sim::RapierFactory;
use sms_synth::{LandingStructure, TruthScene};
use sms_target::{LandingTargetOptions, Target, TargetEngine, execute_landing, scene_from_truth};
use sms_wash::{WashModel, WashSettings};
use std::error::Error;
use std::time::Instant;

type Failed = Box<dyn Error>;

/// CPU time of the process, seconds, where the system tells.
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|f| f.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

struct Case {
    /// Spacing of the planner's particles, of which the target's is half.
    spacing: Option<f64>,
    truth: TruthScene,
    scene: Scene,
    landing: ResolvedLanding,
}

impl Case {
    fn new(truth: TruthScene, start_w: DVec2, speed: Option<f64>) -> Result<Self, Failed> {
        let scene = scene_from_truth(&truth)?;
        let mut task = LandingTask::new(start_w.to_array());
        task.flight.speed = speed.unwrap_or(task.flight.speed);
        let landing = task.resolve(&scene)?;
        Ok(Self { spacing: None, truth, scene, landing })
    }

    fn at_start(number: usize, start: usize, speed: Option<f64>, slide: f64) -> Result<Self, Failed> {
        let mut truth = LandingStructure::ALL[number - 1].fixed();
        let landing = truth.landing.as_ref().ok_or("no landing scene")?;
        let (start_w, along) = (landing.starts_w[start], DVec2::from(landing.overhang_w));
        truth.objects[1..].iter_mut().for_each(|o| o.x_wb.translation += (along * slide).extend(0.0));
        Self::new(truth, start_w.truncate(), speed)
    }

    /// Where the vehicle fits and is nearest to the middle of the base.
    fn safest(&self) -> DVec2 {
        let base = self.truth.objects[0].aabb_w().center().truncate();
        let off = |p: &DVec2| p.distance(base);
        self.landing.surface().places().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(base)
    }

    fn fly(&self, model: WashModel, action: &LandingAction) -> Result<LandingOutcome, Failed> {
        let wash = WashSettings { model, ..WashSettings::default() };
        let (l, s) = (&self.landing, &self.scene);
        let mut world = LandingWorld::new(&RapierFactory, &l.world_options(), s, l, l.structure(), &wash)?;
        Ok(world.fly(action, &RolloutOptions { enough: Some(1.0), ..RolloutOptions::default() })?)
    }

    fn everywhere(
        &self,
        target: Option<&dyn Target>,
        action: &LandingAction,
    ) -> Result<(String, bool), Failed> {
        let (jet, sph) = (self.fly(WashModel::Jet, action)?, self.fly(WashModel::Sph, action)?);
        let mut text = format!("jet {} | sph {}", verdict(&jet), verdict(&sph));
        let Some(target) = target else { return Ok((text, sph.is_success())) };
        let options =
            LandingTargetOptions { recording: None, enough: Some(1.0), ..LandingTargetOptions::default() };
        let mut options = options;
        options.planner_sph.spacing = self.spacing.unwrap_or(options.planner_sph.spacing);
        let (cpu, wall) = (cpu_s(), Instant::now());
        let done = execute_landing(target, &self.landing, action, &self.scene, &self.truth, &options)?;
        text += &format!(
            " | target {} ({:.1} CPU-s, {:.1} s), with jet {}",
            verdict(&done.outcome),
            cpu_s() - cpu,
            wall.elapsed().as_secs_f64(),
            done.second_opinion.as_ref().map_or(String::new(), verdict)
        );
        Ok((text, done.outcome.is_success()))
    }
}

fn verdict(o: &LandingOutcome) -> String {
    let by = if o.is_toppled_by_wash() { " in the air" } else { "" };
    match &o.failure {
        None => format!("ok {:.3}", o.objective.unwrap_or(f64::NAN)),
        Some(f) => format!("FAILS{by}: {f}"),
    }
}

fn cost(case: &Case) -> Result<(), Failed> {
    let action = case.landing.straight(case.safest());
    for (name, model) in [("none", WashModel::None), ("jet", WashModel::Jet), ("sph", WashModel::Sph)] {
        let sph = sms_wash::SphSettings { parallel: false, ..Default::default() };
        let wash = WashSettings { model, sph, ..WashSettings::default() };
        let l = &case.landing;
        let cpu = cpu_s();
        let options = l.world_options();
        let mut world = LandingWorld::new(&RapierFactory, &options, &case.scene, l, l.structure(), &wash)?;
        let built = cpu_s() - cpu;
        let runs = if model == WashModel::Sph { 2 } else { 8 };
        let cpu = cpu_s();
        let mut last = None;
        for _ in 0..runs {
            last = Some(world.fly(&action, &RolloutOptions::default())?);
        }
        let o = last.ok_or("nothing flown")?;
        println!(
            "  {name}: {:.3} CPU-s a rollout, {built:.3} to build; cut at {:.1} s, end at {:.1} s, {}",
            (cpu_s() - cpu) / f64::from(runs),
            o.cut_s.unwrap_or(f64::NAN),
            o.end_s,
            verdict(&o)
        );
    }
    Ok(())
}

fn plan(case: &Case, target: Option<&dyn Target>, seed: u64, draft: bool) -> Result<bool, Failed> {
    let (cpu, wall) = (cpu_s(), Instant::now());
    let settings = if draft { LandingSettings::draft() } else { LandingSettings::default() };
    let planned = plan_landing(
        &case.landing,
        &case.scene,
        &RapierFactory,
        &settings,
        Seed(seed),
        &NoProgress,
        &Cancel::new(),
        &Warnings::new(),
    )?;
    let p = &planned.plan;
    let screened = planned.trials.iter().filter(|t| t.phase == sms_plan::Phase::Screen);
    let good = screened.clone().filter(|t| t.objective < 0.1).count();
    println!(
        "  planned in {:.1} CPU-s, {:.1} s: {:?}; nominal {}; {} jet, {} sph; {good} of {} screened below 0.1; {:?}",
        cpu_s() - cpu,
        wall.elapsed().as_secs_f64(),
        p.action,
        verdict(&p.nominal),
        p.evaluations.jet,
        p.evaluations.sph,
        screened.count(),
        p.predicted.as_ref().map(|p| (p.success_share, p.mean, p.q90))
    );
    let (text, ok) = case.everywhere(target, &p.action)?;
    println!("  {text}");
    Ok(ok)
}

fn main() -> Result<(), Failed> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [what, scenes, starts, keys @ ..] = &args[..] else { return Err("WHAT SCENES STARTS".into()) };
    let value = |key: &str| keys.iter().find_map(|k| k.strip_prefix(&format!("{key}="))).map(str::to_owned);
    let numbers = |text: &str| text.split(',').map(str::parse::<usize>).collect::<Result<Vec<_>, _>>();
    let engine = match value("engine").as_deref() {
        Some("rapier") => TargetEngine::Rapier,
        _ => TargetEngine::preferred(),
    };
    let target = if value("target").as_deref() == Some("0") { None } else { Some(engine.target()?) };
    let target = target.as_deref();
    let seed: u64 = value("seed").map_or(Ok(0), |s| s.parse())?;
    let speed: Option<f64> = value("speed").map(|s| s.parse()).transpose()?;
    let spacing: Option<f64> = value("spacing").map(|s| s.parse()).transpose()?;
    let slide: f64 = value("slide").map_or(Ok(0.0), |s| s.parse())?;
    for number in numbers(scenes)? {
        let mut good = 0;
        let starts = numbers(starts)?;
        for &start in &starts {
            let case = Case { spacing, ..Case::at_start(number, start, speed, slide)? };
            let s = case.landing.surface();
            println!(
                "scene {number}, start {start}: `{}` {:.2} m high, places {:.2} × {:.2} m, {} cells, safest bears {:.0} N",
                s.body,
                s.top_w,
                2.0 * s.half[0],
                2.0 * s.half[1],
                s.places().count(),
                case.truth.tipping_load_n(case.safest()).unwrap_or(0.0)
            );
            good += usize::from(match what.as_str() {
                "cost" => {
                    cost(&case)?;
                    true
                }
                "over" => {
                    // From beyond the end of the overhang, straight over it to the safest place.
                    let along = case.truth.landing.as_ref().ok_or("no landing scene")?.overhang_w;
                    let start_w = case.safest() + 2.0 * DVec2::from(along);
                    let case = Case { spacing, ..Case::new(case.truth, start_w, speed)? };
                    let (text, ok) = case.everywhere(target, &case.landing.straight(case.safest()))?;
                    println!("  straight over the overhang: {text}");
                    ok
                }
                "straight" => {
                    let center = DVec2::from(s.center_w);
                    let (text, ok) = case.everywhere(target, &case.landing.straight(center))?;
                    println!("  straight to the middle: {text}");
                    ok
                }
                "random" => {
                    let mut rng = Seed(seed).derive_index("random", (10 * number + start) as u64).rng();
                    let places: Vec<DVec2> = s.places().collect();
                    let place = places[rng.random_range(0..places.len())];
                    let b = case.landing.task().bounds;
                    let mut within = |[low, high]: [f64; 2]| rng.random_range(low..high);
                    let action = LandingAction {
                        landing_w: place.to_array(),
                        approach_radius: within(b.approach_radius),
                        approach_angle: within(b.approach_angle),
                    };
                    let (text, ok) = case.everywhere(target, &action)?;
                    println!("  random: {text}");
                    ok
                }
                "plan" => plan(&case, target, seed, value("draft").is_some())?,
                _ => return Err(format!("what is `{what}`?").into()),
            });
        }
        println!("scene {number}: {good} of {} succeed\n", starts.len());
    }
    Ok(())
}
