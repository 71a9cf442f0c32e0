//! The planner: screens many approaches with `jet`, refines the promising ones with `sph`, and chooses in perturbed
//! worlds.

use crate::disturb_worlds::{Flown, PerturbedLandings};
use crate::hard::{Hardness, PerturbedWorld, spread};
use crate::plan::{LandingAlternative, LandingEvaluations};
use crate::{
    LandingAction, LandingError, LandingPlan, LandingPlanOutcome, LandingPrediction, LandingRecording,
    LandingSettings, PlannedBody, ResolvedLanding, RolloutOptions,
};
use sms_core::{Seed, StageContext, Warnings};
use sms_plan::{Halton, LocalSearch, NelderMead, Trial, TrialPhase};
use sms_scene::{BodyKind, Scene};
use sms_sim::WorldFactory;
use sms_wash::{WashModel, WashSettings};
use std::path::Path;

/// Largest number of draws per point of the screening.
const MOST_DRAWS: u64 = 16;
/// Initial step of a local search in the unit box.
const STEP: f64 = 0.06;
/// Number of landings in the margins' worlds that are flown in parallel.
const MARGINS_AT_ONCE: usize = 16;
/// Time between the states of the plan's recorded motion, seconds.
const RECORD_EVERY_S: f64 = 1.0 / 60.0;

/// An action that is still in the search, and its point `u` in the unit box.
#[derive(Debug, Clone)]
struct Candidate {
    u: Vec<f64>,
    action: LandingAction,
    rank: Rank,
    /// Objective in the scanned world, with the last wash model that flew it.
    nominal: f64,
    prediction: Option<LandingPrediction>,
}

/// Ranking criteria in order of priority. The objectives of successful landings differ by millimetres and do not show
/// their margin to failure.
#[derive(Debug, Clone, Copy)]
struct Rank {
    /// Number of failed rollouts in the last phase.
    failures: usize,
    /// Number of failed rollouts with `jet` in the hardest worlds.
    hard_failures: usize,
    /// One-based index of the hardest of the margins' worlds in which it succeeds, the easiest being 1; 0 if none is
    /// known.
    margin: usize,
    mean: f64,
}

impl Rank {
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        let failures = self.failures.cmp(&other.failures).then(self.hard_failures.cmp(&other.hard_failures));
        failures.then(other.margin.cmp(&self.margin)).then(self.mean.total_cmp(&other.mean))
    }
}

/// State of the search.
struct LandingSearch<'a> {
    landing: &'a ResolvedLanding,
    settings: &'a LandingSettings,
    seed: Seed,
    trials: Vec<Trial>,
    evaluations: LandingEvaluations,
}

/// Plans a landing in a scene. Screening with `jet` and refinement with `sph` produce candidates. The planner chooses
/// the candidate that succeeds in most of the hard worlds, which are the same for every action; among equals the one
/// that succeeds in a harder world of the margins, then the one with the smallest mean objective. The prediction is
/// made in other worlds. The plan does not depend on the number of threads; rollouts run in rayon's current pool. The
/// planner uses only `scene`, the result of the scan.
///
/// # Errors
/// [`LandingError`] for invalid settings, a structure that falls by itself, a scene that cannot be simulated, or
/// interruption.
pub fn plan_landing(
    landing: &ResolvedLanding,
    scene: &Scene,
    factory: &dyn WorldFactory,
    settings: &LandingSettings,
    context: StageContext<'_>,
) -> Result<LandingPlanOutcome, LandingError> {
    let StageContext { progress, cancel, warnings, seed } = context;
    settings.validate(Path::new("(settings of the planner)"))?;
    let robust = settings.worlds > 0;
    let mut scene = scene.without_pictures();
    if !robust {
        landing.check_rest(factory, &scene)?;
    } else if let Some(stands) =
        settings.disturbances.that_stands(landing, factory, &scene, seed.derive("standing"))?
    {
        scene = stands;
        warnings.add(
            "plan",
            "masses_do_not_stand",
            "with the most likely masses the structure would fall by itself, but it stood during the scan: the plan uses other \
             masses from their intervals",
            "narrow the material intervals (`sms materials`), ideally with a weighed `mass_kg`",
        );
    }
    let scene = &scene;
    let family = |model: WashModel, worlds: Vec<PerturbedWorld>| {
        PerturbedLandings::new(landing, factory, settings, wash(settings, model), worlds, progress, cancel)
    };
    let scanned = || vec![PerturbedWorld::exactly(scene.clone())];
    let mut planning = LandingSearch {
        landing,
        settings,
        seed,
        trials: Vec::new(),
        evaluations: LandingEvaluations::default(),
    };

    progress.begin("landing: screening", settings.screening as u64);
    let jet = family(WashModel::Jet, scanned());
    let mut found = planning.screen(&jet)?;
    progress.end(&format!("best of {}: {:.3}", found.len(), found.first().map_or(f64::NAN, |c| c.nominal)));

    let hardness = Hardness { landing, factory, disturbances: &settings.disturbances, progress, cancel };
    let hard =
        if robust { hardness.order(scene, seed.derive("choice"), settings.draws)? } else { Vec::new() };
    if robust && settings.margins > 0 {
        progress.begin("landing: margins", 0);
        let worlds = family(WashModel::Jet, hardness.margins(&hard, settings));
        planning.margins(&mut found, &worlds)?;
        let most = found.first().map_or(0, |c| c.rank.margin);
        progress.end(&format!("best margin {most} of {}", worlds.len()));
    }

    if robust && settings.jet_worlds > 0 {
        found = distinct(found, settings.candidates);
        let hardest = hard.iter().take(settings.jet_worlds).cloned().collect();
        let worlds = family(WashModel::Jet, hardest);
        progress.begin("landing: hardest worlds, jet", (found.len() * worlds.len()) as u64);
        planning.in_worlds(&mut found, &worlds, TrialPhase::Perturbed)?;
        for candidate in &mut found {
            candidate.rank.hard_failures = candidate.rank.failures;
        }
        progress.end("");
    }

    found.truncate(settings.refine);
    let polish = settings.polish_starts * settings.polish;
    progress.begin("landing: refinement, sph", (found.len() + polish) as u64);
    let sph = family(WashModel::Sph, scanned());
    planning.in_nominal(&mut found, &sph)?;
    planning.polish(&mut found, &sph)?;
    progress.end("");

    found.truncate(settings.finalists);
    if robust {
        let worlds = family(WashModel::Sph, spread(&hard, settings.worlds));
        progress.begin("landing: hard worlds, sph", (found.len() * worlds.len()) as u64);
        planning.in_worlds(&mut found, &worlds, TrialPhase::Perturbed)?;
        progress.end("");
    }
    let Some(winner) = found.first().filter(|w| w.rank.mean.is_finite()).cloned() else {
        let all = planning.evaluations;
        return Err(LandingError::Nothing {
            engine: factory.engine().to_owned(),
            evaluations: all.jet + all.sph,
        });
    };

    let mut predicted = None;
    if robust && settings.forecast_worlds > 0 {
        progress.begin("landing: forecast", settings.forecast_worlds as u64);
        let drawn = hardness.draw(scene, seed.derive("forecast"), settings.forecast_worlds)?;
        let worlds = family(WashModel::Sph, drawn);
        let mut only = vec![winner.clone()];
        planning.in_worlds(&mut only, &worlds, TrialPhase::Forecast)?;
        predicted = only.swap_remove(0).prediction;
        progress.end("");
    }
    let recording = Some(LandingRecording { every_s: RECORD_EVERY_S, particles: false });
    let nominal =
        sph.fly_in(0, &winner.action, &RolloutOptions { recording, ..RolloutOptions::default() })?;
    planning.evaluations.sph += 1;
    let plan = LandingPlan {
        task: landing.task().clone(),
        engine: factory.engine().to_owned(),
        vehicle: landing.vehicle().clone(),
        surface: landing.surface().clone(),
        structure: landing.structure().to_vec(),
        parameters: landing.parameters(),
        action: winner.action,
        bodies: PlannedBody::all_of(scene),
        nominal,
        wash: wash(settings, WashModel::Sph),
        predicted,
        alternatives: found[1..].iter().map(Candidate::alternative).collect(),
        evaluations: planning.evaluations,
    };
    warn(&plan, scene, warnings);
    Ok(LandingPlanOutcome { plan, trials: planning.trials })
}

/// Settings of a wash model.
fn wash(settings: &LandingSettings, model: WashModel) -> WashSettings {
    // Rollouts run in parallel already.
    let sph = sms_wash::SphSettings { parallel: false, ..settings.sph };
    WashSettings { model, stream: settings.jet, sph }
}

impl Candidate {
    fn alternative(&self) -> LandingAlternative {
        LandingAlternative {
            action: self.action,
            objective: Some(self.nominal).filter(|v| v.is_finite()),
            prediction: self.prediction.clone(),
        }
    }
}

impl LandingSearch<'_> {
    /// Flies the points of a low-discrepancy sequence in the scanned world. Returns them best first.
    fn screen(&mut self, jet: &PerturbedLandings<'_>) -> Result<Vec<Candidate>, LandingError> {
        let halton = Halton::new(4, self.seed.derive("screening"));
        let wanted = self.settings.screening;
        let points: Vec<Vec<f64>> = (0..wanted as u64 * MOST_DRAWS)
            .map(|i| halton.point(i))
            .filter(|u| self.landing.is_possible(&self.landing.action_at(u)))
            .take(wanted)
            .collect();
        let mut found: Vec<Candidate> = points
            .into_iter()
            .map(|u| Candidate {
                action: self.landing.action_at(&u),
                u,
                rank: Rank { failures: 0, hard_failures: 0, margin: 0, mean: f64::INFINITY },
                nominal: f64::INFINITY,
                prediction: None,
            })
            .collect();
        let jobs: Vec<_> = found.iter().map(|c| (c.action, 0)).collect();
        let flown = self.count(jet.fly_all(&jobs)?, WashModel::Jet);
        for (i, (candidate, flown)) in found.iter_mut().zip(&flown).enumerate() {
            candidate.set_nominal(flown);
            self.trials.push(trial(TrialPhase::Screen, -1, i, candidate.action, flown.score));
        }
        sort(&mut found);
        Ok(found)
    }

    /// Flies the successful candidates in the hardest world of the margins (the last), and those that fail there in the
    /// next easier one, and so on. Stops as soon as the candidates of the next phase are known: equals keep the order
    /// in which they are flown. Sorts best first.
    fn margins(
        &mut self,
        found: &mut [Candidate],
        worlds: &PerturbedLandings<'_>,
    ) -> Result<(), LandingError> {
        let wanted = self.settings.candidates.max(self.settings.refine);
        let mut left: Vec<usize> = (0..found.len()).filter(|i| found[*i].rank.failures == 0).collect();
        for level in (0..worlds.len()).rev() {
            let mut failed = Vec::new();
            for some in left.chunks(MARGINS_AT_ONCE) {
                let mut known: Vec<Candidate> = found.iter().filter(|c| c.rank.margin > 0).cloned().collect();
                sort(&mut known);
                if distinct(known, wanted).len() == wanted {
                    sort(found);
                    return Ok(());
                }
                let jobs: Vec<_> = some.iter().map(|i| (found[*i].action, level)).collect();
                let flown = self.count(worlds.fly_all(&jobs)?, WashModel::Jet);
                for (&i, flown) in some.iter().zip(&flown) {
                    self.trials.push(trial(TrialPhase::Perturbed, -1, level, found[i].action, flown.score));
                    match flown.failure {
                        None => found[i].rank.margin = level + 1,
                        Some(_) => failed.push(i),
                    }
                }
            }
            left = failed;
        }
        sort(found);
        Ok(())
    }

    /// Flies all candidates in the scanned world and sorts them best first.
    fn in_nominal(
        &mut self,
        found: &mut [Candidate],
        sph: &PerturbedLandings<'_>,
    ) -> Result<(), LandingError> {
        let jobs: Vec<_> = found.iter().map(|c| (c.action, 0)).collect();
        let flown = self.count(sph.fly_all(&jobs)?, WashModel::Sph);
        for (i, (candidate, flown)) in found.iter_mut().zip(&flown).enumerate() {
            candidate.set_nominal(flown);
            self.trials.push(trial(TrialPhase::Search, i as i32, 0, candidate.action, flown.score));
        }
        sort(found);
        Ok(())
    }

    /// Runs local searches from the best candidates in parallel. A better point replaces its candidate.
    fn polish(&mut self, found: &mut [Candidate], sph: &PerturbedLandings<'_>) -> Result<(), LandingError> {
        let count = self.settings.polish_starts.min(found.len());
        let steps = [STEP; 4];
        let simplex = NelderMead::default();
        // A search stays in the unit box. If angles are periodic, the angle is shifted so that the box is centred on
        // the start.
        let turns: Vec<f64> =
            found[..count].iter().map(|c| if self.is_periodic() { c.u[3] - 0.5 } else { 0.0 }).collect();
        let mut searches: Vec<LocalSearch> = found[..count]
            .iter()
            .zip(&turns)
            .map(|(c, turn)| {
                let start = vec![c.u[0], c.u[1], c.u[2], c.u[3] - turn];
                LocalSearch::new(&simplex, std::slice::from_ref(&start), &steps, Some(c.nominal))
            })
            .collect();
        let turned = |i: usize, u: &[f64]| vec![u[0], u[1], u[2], (u[3] + turns[i]).rem_euclid(1.0)];
        let whole = |i: usize, u: &[f64]| if turns[i] == 0.0 { u.to_vec() } else { turned(i, u) };
        for round in 0..self.settings.polish {
            let mut asked: Vec<(usize, LandingAction)> = Vec::new();
            for (i, search) in searches.iter_mut().enumerate() {
                while let Some(action) = search.next_point().map(|u| self.landing.action_at(&whole(i, u))) {
                    if self.landing.is_possible(&action) {
                        asked.push((i, action));
                        break;
                    }
                    search.refuse();
                }
            }
            let jobs: Vec<_> = asked.iter().map(|(_, action)| (*action, 0)).collect();
            let flown = self.count(sph.fly_all(&jobs)?, WashModel::Sph);
            for ((i, action), flown) in asked.into_iter().zip(&flown) {
                searches[i].tell(flown.score);
                self.trials.push(trial(TrialPhase::Search, i as i32, round + 1, action, flown.score));
            }
        }
        for (i, (candidate, search)) in found.iter_mut().zip(&searches).enumerate() {
            let minimum = search.minimum();
            if minimum.objective < candidate.nominal {
                candidate.u = whole(i, &minimum.x);
                candidate.action = self.landing.action_at(&candidate.u);
                (candidate.nominal, candidate.rank.mean) = (minimum.objective, minimum.objective);
            }
        }
        sort(found);
        Ok(())
    }

    /// Whether the approach angle is periodic.
    fn is_periodic(&self) -> bool {
        let [low, high] = self.landing.task().bounds.approach_angle;
        (high - low - std::f64::consts::TAU).abs() < 1e-9
    }

    /// Flies all candidates in the same perturbed worlds and sorts them best first.
    fn in_worlds(
        &mut self,
        found: &mut [Candidate],
        worlds: &PerturbedLandings<'_>,
        phase: TrialPhase,
    ) -> Result<(), LandingError> {
        let n = worlds.len();
        let jobs: Vec<_> = found.iter().flat_map(|c| (0..n).map(move |w| (c.action, w))).collect();
        let flown = self.count(worlds.fly_all(&jobs)?, worlds.model());
        for (i, (candidate, row)) in found.iter_mut().zip(flown.chunks(n)).enumerate() {
            for (w, flown) in row.iter().enumerate() {
                self.trials.push(trial(phase, i as i32, w, candidate.action, flown.score));
            }
            let prediction = LandingPrediction::of(worlds.model(), row);
            candidate.rank.failures = row.iter().filter(|f| f.failure.is_some()).count();
            candidate.rank.mean = prediction.mean;
            candidate.prediction = Some(prediction);
        }
        sort(found);
        Ok(())
    }

    fn count(&mut self, flown: Vec<Flown>, model: WashModel) -> Vec<Flown> {
        match model {
            WashModel::Sph => self.evaluations.sph += flown.len(),
            _ => self.evaluations.jet += flown.len(),
        }
        self.evaluations.invalid += flown.iter().filter(|f| !f.score.is_finite()).count();
        flown
    }
}

impl Candidate {
    fn set_nominal(&mut self, flown: &Flown) {
        self.nominal = flown.score;
        self.rank.failures = usize::from(flown.failure.is_some());
        self.rank.mean = flown.score;
    }
}

/// Sorts best first; the sort is stable.
fn sort(found: &mut [Candidate]) {
    found.sort_by(|a, b| a.rank.order(&b.rank));
}

/// Picks the best candidates that differ from each other by more than half of a local search's initial step.
fn distinct(found: Vec<Candidate>, count: usize) -> Vec<Candidate> {
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in found {
        if kept.len() == count {
            break;
        }
        let angle = |c: &Candidate| c.action.approach_angle;
        let near = |k: &Candidate| {
            let turn = (angle(k) - angle(&candidate)).rem_euclid(std::f64::consts::TAU);
            let turn = turn.min(std::f64::consts::TAU - turn) / std::f64::consts::TAU;
            let rest = k.u[..3].iter().zip(&candidate.u).all(|(a, b)| (a - b).abs() < 0.5 * STEP);
            rest && turn < 0.5 * STEP
        };
        if !kept.iter().any(near) {
            kept.push(candidate);
        }
    }
    kept
}

fn trial(phase: TrialPhase, start: i32, iteration: usize, action: LandingAction, score: f64) -> Trial {
    Trial::new(phase, start, iteration as i32, action.values(), score)
}

fn warn(plan: &LandingPlan, scene: &Scene, warnings: &Warnings) {
    let platform = &plan.surface.body;
    if scene.body(platform).is_some_and(|b| b.kind == BodyKind::Static) {
        warnings.add(
            "plan",
            "platform_fixed",
            format!("`{platform}` is fixed in the scene, so no landing can topple it"),
            "check its reconstruction: bodies that do not rest by themselves, or belong to the background, are fixed",
        );
    }
    if let Some(failure) = &plan.nominal.failure {
        warnings.add(
            "plan",
            "no_good_landing",
            format!("no landing meets the conditions of the task: in the best one, {failure}"),
            "start from another side, widen the task's bounds, or plan with more rollouts (`[landing]`)",
        );
    } else if let Some(p) = plan.predicted.as_ref().filter(|p| p.success_share < 0.9) {
        let why: Vec<String> = p.failures.iter().map(|(kind, n)| format!("{kind} {n}")).collect();
        warnings.add(
            "plan",
            "fragile_landing",
            format!(
                "the chosen landing succeeds in {:.0} % of {} perturbed worlds ({})",
                100.0 * p.success_share,
                p.worlds,
                why.join(", ")
            ),
            "narrow the material intervals (`sms materials`), or land elsewhere",
        );
    }
    if plan.evaluations.invalid > 0 {
        warnings.add(
            "plan",
            "failed_rollouts",
            format!("{} simulated landings are invalid and were not counted", plan.evaluations.invalid),
            "check the scene for interpenetrating or very light bodies",
        );
    }
}
