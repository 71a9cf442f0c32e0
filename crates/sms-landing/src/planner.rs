//! Planning: many approaches with `jet`, the promising ones with `sph`, the final choice in disturbed worlds.

use crate::disturb_worlds::{Family, Flown};
use crate::plan::{LandingAlternative, LandingEvaluations};
use crate::{
    LandingAction, LandingError, LandingPlan, LandingPlanOutcome, LandingPrediction, LandingRecording,
    LandingSettings, ResolvedLanding, RolloutOptions,
};
use sms_core::{Cancel, Progress, Seed, Warnings};
use sms_plan::{Halton, LocalSearch, NelderMead, Phase, Trial};
use sms_scene::{BodyKind, Scene};
use sms_sim::WorldFactory;
use sms_wash::{WashModel, WashSettings};
use std::path::Path;

/// Points drawn at most for each of the screening's.
const MOST_DRAWS: u64 = 16;
/// First steps of a local search in the unit box.
const STEP: f64 = 0.06;
/// Time between the states of the plan's recorded motion, seconds.
const RECORD_EVERY_S: f64 = 1.0 / 60.0;

/// An action that goes on.
#[derive(Debug, Clone)]
struct Candidate {
    u: Vec<f64>,
    action: LandingAction,
    /// What it is ranked by: rollouts that cannot be believed, then the mean objective.
    rank: (usize, f64),
    /// In the scanned world, by the better model.
    nominal: f64,
    prediction: Option<LandingPrediction>,
}

/// Everything that planning needs.
struct Planning<'a> {
    landing: &'a ResolvedLanding,
    settings: &'a LandingSettings,
    seed: Seed,
    trials: Vec<Trial>,
    evaluations: LandingEvaluations,
}

/// Plans a landing in a scene: the action with the smallest mean objective over disturbed worlds (the same ones for every action), of
/// those that screening with `jet` and refinement with `sph` found. What it is predicted to do is measured in other worlds. The plan is the same for
/// any number of threads; rayon's current pool is used. Only `scene`, which the scan made, is looked at.
///
/// # Errors
/// [`LandingError`]: bad settings, a structure that is falling already, a scene that cannot be simulated, or interruption.
pub fn plan_landing(
    landing: &ResolvedLanding,
    scene: &Scene,
    factory: &dyn WorldFactory,
    settings: &LandingSettings,
    seed: Seed,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<LandingPlanOutcome, LandingError> {
    settings.validate(Path::new("(settings of the planner)"))?;
    landing.check_rest(factory, scene)?;
    let scene = &scene.without_pictures();
    let robust = settings.worlds > 0;
    let family = |model: WashModel, seed: Option<Seed>, count: usize| {
        Family::new(landing, scene, factory, settings, wash(settings, model), seed, count, progress, cancel)
    };
    let mut planning =
        Planning { landing, settings, seed, trials: Vec::new(), evaluations: LandingEvaluations::default() };

    progress.begin("landing: screening", settings.screening as u64);
    let jet = family(WashModel::Jet, None, 1);
    let mut found = planning.screen(&jet)?;
    progress.end(&format!("best of {}: {:.3}", found.len(), found.first().map_or(f64::NAN, |c| c.nominal)));

    let (choice, fresh) = (seed.derive("choice"), seed.derive("forecast"));
    if robust && settings.jet_worlds > 0 {
        found = distinct(found, settings.candidates);
        progress.begin("landing: disturbed worlds, jet", (found.len() * settings.jet_worlds) as u64);
        let worlds = family(WashModel::Jet, Some(choice), settings.jet_worlds);
        planning.in_worlds(&mut found, &worlds, Phase::Disturbed, 0..settings.jet_worlds)?;
        progress.end("");
    }

    found.truncate(settings.refine);
    let polish = settings.polish_starts * settings.polish;
    progress.begin("landing: refinement, sph", (found.len() + polish) as u64);
    let sph = family(WashModel::Sph, None, 1);
    planning.in_nominal(&mut found, &sph)?;
    planning.polish(&mut found, &sph)?;
    progress.end("");

    found.truncate(settings.finalists);
    if robust {
        progress.begin("landing: disturbed worlds, sph", (found.len() * settings.worlds) as u64);
        let worlds = family(WashModel::Sph, Some(choice), settings.worlds);
        planning.in_worlds(&mut found, &worlds, Phase::Disturbed, 0..settings.worlds)?;
        progress.end("");
    }
    let Some(winner) = found.first().filter(|w| w.rank.1.is_finite()).cloned() else {
        let all = planning.evaluations;
        return Err(LandingError::Nothing {
            engine: factory.engine().to_owned(),
            evaluations: all.jet + all.sph,
        });
    };

    let mut predicted = None;
    if robust && settings.forecast_worlds > 0 {
        progress.begin("landing: forecast", settings.forecast_worlds as u64);
        let worlds = family(WashModel::Sph, Some(fresh), settings.forecast_worlds);
        let mut only = vec![winner.clone()];
        planning.in_worlds(&mut only, &worlds, Phase::Forecast, 0..settings.forecast_worlds)?;
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
        nominal,
        predicted,
        alternatives: found[1..].iter().map(Candidate::alternative).collect(),
        evaluations: planning.evaluations,
    };
    warn(&plan, scene, warnings);
    Ok(LandingPlanOutcome { plan, trials: planning.trials })
}

/// The settings of one model.
fn wash(settings: &LandingSettings, model: WashModel) -> WashSettings {
    // Rollouts run side by side.
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

impl Planning<'_> {
    /// Flies the points of a low-discrepancy sequence in the scanned world; best first.
    fn screen(&mut self, jet: &Family<'_>) -> Result<Vec<Candidate>, LandingError> {
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
                rank: (0, f64::INFINITY),
                nominal: f64::INFINITY,
                prediction: None,
            })
            .collect();
        let jobs: Vec<_> = found.iter().map(|c| (c.action, 0)).collect();
        let flown = self.count(jet.fly_all(&jobs)?, WashModel::Jet);
        for (i, (candidate, flown)) in found.iter_mut().zip(&flown).enumerate() {
            candidate.set_nominal(flown.score);
            self.trials.push(trial(Phase::Screen, -1, i, candidate.action, flown.score));
        }
        sort(&mut found);
        Ok(found)
    }

    /// Flies all candidates in the scanned world; best first.
    fn in_nominal(&mut self, found: &mut [Candidate], sph: &Family<'_>) -> Result<(), LandingError> {
        let jobs: Vec<_> = found.iter().map(|c| (c.action, 0)).collect();
        let flown = self.count(sph.fly_all(&jobs)?, WashModel::Sph);
        for (i, (candidate, flown)) in found.iter_mut().zip(&flown).enumerate() {
            candidate.set_nominal(flown.score);
            self.trials.push(trial(Phase::Search, i as i32, 0, candidate.action, flown.score));
        }
        sort(found);
        Ok(())
    }

    /// Local searches from the best candidates, side by side; what they find takes their places.
    fn polish(&mut self, found: &mut [Candidate], sph: &Family<'_>) -> Result<(), LandingError> {
        let count = self.settings.polish_starts.min(found.len());
        let steps = [STEP; 4];
        let simplex = NelderMead::default();
        let mut searches: Vec<LocalSearch> = found[..count]
            .iter()
            .map(|c| LocalSearch::new(&simplex, std::slice::from_ref(&c.u), &steps, Some(c.nominal)))
            .collect();
        for round in 0..self.settings.polish {
            let mut asked: Vec<(usize, LandingAction)> = Vec::new();
            for (i, search) in searches.iter_mut().enumerate() {
                while let Some(action) = search.next_point().map(|u| self.landing.action_at(u)) {
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
                self.trials.push(trial(Phase::Search, i as i32, round + 1, action, flown.score));
            }
        }
        for (candidate, search) in found.iter_mut().zip(&searches) {
            let minimum = search.minimum();
            if minimum.objective < candidate.nominal {
                candidate.action = self.landing.action_at(&minimum.x);
                candidate.u = minimum.x;
                candidate.set_nominal(minimum.objective);
            }
        }
        sort(found);
        Ok(())
    }

    /// Flies all candidates in the same disturbed worlds; the best mean first.
    fn in_worlds(
        &mut self,
        found: &mut [Candidate],
        worlds: &Family<'_>,
        phase: Phase,
        range: std::ops::Range<usize>,
    ) -> Result<(), LandingError> {
        let n = range.len();
        let jobs: Vec<_> = found.iter().flat_map(|c| range.clone().map(move |w| (c.action, w))).collect();
        let flown = self.count(worlds.fly_all(&jobs)?, worlds.model());
        for (i, (candidate, row)) in found.iter_mut().zip(flown.chunks(n)).enumerate() {
            for (w, flown) in row.iter().enumerate() {
                self.trials.push(trial(phase, i as i32, w, candidate.action, flown.score));
            }
            let scores: Vec<f64> = row.iter().map(|f| f.score).collect();
            let invalid = scores.iter().filter(|s| !s.is_finite()).count();
            let prediction = LandingPrediction::of(worlds.model(), row);
            candidate.rank = (invalid, prediction.mean);
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
    fn set_nominal(&mut self, score: f64) {
        self.nominal = score;
        self.rank = (usize::from(!score.is_finite()), score);
    }
}

/// Best first; what was found first comes first among equals.
fn sort(found: &mut [Candidate]) {
    found.sort_by(|a, b| a.rank.0.cmp(&b.rank.0).then(a.rank.1.total_cmp(&b.rank.1)));
}

/// The best candidates that differ from each other by more than half of a search's first step.
fn distinct(found: Vec<Candidate>, count: usize) -> Vec<Candidate> {
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in found {
        if kept.len() == count {
            break;
        }
        let near = |k: &Candidate| k.u.iter().zip(&candidate.u).all(|(a, b)| (a - b).abs() < 0.5 * STEP);
        if !kept.iter().any(near) {
            kept.push(candidate);
        }
    }
    kept
}

fn trial(phase: Phase, start: i32, iteration: usize, action: LandingAction, score: f64) -> Trial {
    Trial::new(phase, start, iteration as i32, action.values(), score)
}

fn warn(plan: &LandingPlan, scene: &Scene, warnings: &Warnings) {
    let platform = &plan.surface.body;
    if scene.body(platform).is_some_and(|b| b.kind == BodyKind::Static) {
        warnings.add(
            "plan",
            "platform_fixed",
            format!("`{platform}` is fixed in the scene: nothing can topple it, whatever the vehicle does"),
            "look at its reconstruction: what does not rest by itself, or is taken for background, is fixed",
        );
    }
    if let Some(failure) = &plan.nominal.failure {
        warnings.add(
            "plan",
            "no_good_landing",
            format!("no landing was found that does what the task asks: in the best one {failure}"),
            "start from another side, widen the task's bounds, or plan with more rollouts (`[landing]`)",
        );
    } else if let Some(p) = plan.predicted.as_ref().filter(|p| p.success_share < 0.9) {
        let why: Vec<String> = p.failures.iter().map(|(kind, n)| format!("{kind} {n}")).collect();
        warnings.add(
            "plan",
            "fragile_landing",
            format!(
                "the chosen landing succeeds in {:.0} % of {} worlds that differ within what is known ({})",
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
            format!(
                "{} simulated landings cannot be believed and were not counted",
                plan.evaluations.invalid
            ),
            "look for interpenetrating or very light bodies in the scene",
        );
    }
}
