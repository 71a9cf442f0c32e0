//! Comparison of a scanned structure's stability and tipping loads with the truth's.

use crate::BenchError;
use glamx::DVec2;
use sms_core::{MassProperties, metrics::Metrics};
use sms_landing::LandingError;
use sms_scene::Scene;
use sms_sim::{LoadTest, RapierFactory, resting_drift, tipping_load_n};
use sms_synth::{LandingTruth, TruthScene};
use sms_target::{TargetError, match_bodies, scene_from_truth};

/// Time without a load, seconds.
const STANDS_S: f64 = 2.0;
/// Largest load of interest for a landing: three quadrotors, newtons.
const MOST_N: f64 = 35.0;

/// Smallest load straight down at a point of the platform that topples the structure, newtons; infinite if none does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeLoad {
    /// Position of the load in the true world, metres.
    pub p_w: DVec2,
    /// Load from the statics of the true contacts.
    pub truth_n: f64,
    /// Load in the planner's world with the masses of its prior.
    pub planner_n: f64,
    /// Load in the planner's world with the true masses; its error is due to geometry.
    pub true_masses_n: f64,
}

/// Stability of a scanned structure.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Standing {
    /// Largest drift of a body in 2 s without a load, metres.
    pub drift_m: f64,
    /// Largest turn of a body in 2 s without a load, radians.
    pub drift_rad: f64,
    /// Load at the overhang's end, if less than three quadrotors tip the true platform there.
    pub end: Option<EdgeLoad>,
    /// Loads at the platform's corners and edge midpoints where less than that tips the true platform.
    pub edges: Vec<EdgeLoad>,
    /// Bodies of the structure that match no true object: they keep the prior's masses in [`EdgeLoad::true_masses_n`], too.
    pub unmatched: Vec<String>,
}

impl Standing {
    /// Returns the relative errors of the load at the overhang's end, with the prior's masses and with the true ones; infinite
    /// if no load tips it.
    pub fn end_errors(&self) -> Option<[f64; 2]> {
        self.end.as_ref().map(EdgeLoad::errors)
    }

    /// Returns the largest of these errors over all points.
    pub fn worst_errors(&self) -> Option<[f64; 2]> {
        let worst = |a: [f64; 2], b: [f64; 2]| {
            let larger = |i: usize| if b[i].abs() > a[i].abs() { b[i] } else { a[i] };
            [larger(0), larger(1)]
        };
        self.loads().map(EdgeLoad::errors).reduce(worst)
    }

    fn loads(&self) -> impl Iterator<Item = &EdgeLoad> {
        self.end.iter().chain(&self.edges)
    }

    pub(super) fn tell(&self, word: &str, metrics: &mut Metrics) {
        let mut set = |key: &str, value: f64| {
            metrics.set(format!("bench.landing.{word}.{key}"), value);
        };
        set("drift_m", self.drift_m);
        set("drift_rad", self.drift_rad);
        // JSON has no infinity: if nothing tips the scanned structure, the error is null and is counted here.
        set("tipping_points", self.loads().count() as f64);
        let held = |of: fn(&EdgeLoad) -> f64| self.loads().filter(|l| of(l).is_infinite()).count() as f64;
        set("tipping_points_held", held(|l| l.planner_n));
        set("tipping_points_held_true_masses", held(|l| l.true_masses_n));
        set("unmatched_bodies", self.unmatched.len() as f64);
        let material_prior = [("end", self.end_errors()), ("worst", self.worst_errors())];
        for (which, [error, geometry]) in
            material_prior.into_iter().filter_map(|(which, e)| Some((which, e?)))
        {
            set(&format!("tipping_load_{which}_error"), error);
            set(&format!("tipping_load_{which}_error_true_masses"), geometry);
        }
    }
}

impl EdgeLoad {
    fn errors(&self) -> [f64; 2] {
        [self.planner_n, self.true_masses_n].map(|n| n / self.truth_n - 1.0)
    }
}

/// Simulates the planner's structure without a load, then loads its platform.
pub(super) fn standing(
    scene: &Scene,
    truth: &TruthScene,
    structure: &[String],
    platform: &str,
) -> Result<Standing, BenchError> {
    let scene = scene.without_pictures();
    let drifts = resting_drift(&RapierFactory, &scene, STANDS_S).map_err(LandingError::from)?;
    let most = |of: &dyn Fn(&sms_sim::RestingDrift) -> f64| {
        drifts.iter().filter(|d| structure.contains(&d.body)).map(of).fold(0.0, f64::max)
    };
    let mut found =
        Standing { drift_m: most(&|d| d.moved_m), drift_rad: most(&|d| d.turned_rad), ..Standing::default() };
    let Some(landing) = &truth.landing else { return Ok(found) };
    let (weighed, matched) = with_true_masses(&scene, truth)?;
    found.unmatched = structure.iter().filter(|body| !matched.contains(body)).cloned().collect();
    let test = LoadTest { most_n: 4.0 * MOST_N, ..LoadTest::default() };
    let load_at = |p_w: DVec2| -> Result<Option<EdgeLoad>, BenchError> {
        // A structure that topples without a load has no relative error.
        let tips = |n: &f64| *n > 0.0 && *n < MOST_N;
        let Some(truth_n) = truth.tipping_load_n(p_w).filter(tips) else { return Ok(None) };
        let at_w = scene.x_world_recording.transform_point(p_w.extend(landing.top_m));
        let load = |scene: &Scene| {
            let load = tipping_load_n(&RapierFactory, scene, platform, at_w, &test);
            load.map(|n| n.unwrap_or(f64::INFINITY)).map_err(LandingError::from)
        };
        Ok(Some(EdgeLoad { p_w, truth_n, planner_n: load(&scene)?, true_masses_n: load(&weighed)? }))
    };
    found.end = load_at(landing.end_w.into())?;
    for p_w in edge_points(landing) {
        found.edges.extend(load_at(p_w)?);
    }
    Ok(found)
}

/// Corners and edge midpoints of the platform except for the overhang's end.
fn edge_points(landing: &LandingTruth) -> Vec<DVec2> {
    let corners: Vec<DVec2> = landing.outline_w.iter().map(|&q| q.into()).collect();
    let with_middle = |i: usize| [corners[i], corners[i].midpoint(corners[(i + 1) % corners.len()])];
    let points = (0..corners.len()).flat_map(with_middle);
    points.filter(|p| p.distance(landing.end_w.into()) > 1e-6).collect()
}

/// Returns the scene with true masses for bodies that match a true one, and the names of these bodies.
fn with_true_masses(scene: &Scene, truth: &TruthScene) -> Result<(Scene, Vec<String>), BenchError> {
    let mut there = scene_from_truth(truth).map_err(TargetError::from)?;
    for body in &mut there.bodies {
        body.x_wb = scene.x_world_recording * body.x_wb;
    }
    let (mut weighed, mut matched) = (scene.clone(), Vec::new());
    for (own, other) in match_bodies(scene, &there) {
        let (Some(i), Some(object)) = (weighed.body_index(&own), truth.object(&other)) else { continue };
        let Some(was) = weighed.bodies[i].mass else { continue };
        let mass = object.mass.mass();
        if let Ok(scaled) = MassProperties::new(mass, was.com(), was.inertia() * (mass / was.mass())) {
            weighed.bodies[i].mass = Some(scaled);
            matched.push(own);
        }
    }
    Ok((weighed, matched))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_synth::LandingStructure;

    /// With true geometry and masses the planner's engine agrees with statics; a structure heavier by a fifth bears a fifth more.
    #[test]
    fn true_structures_tip_under_the_loads_of_statics() {
        for structure in LandingStructure::ALL {
            let truth = structure.fixed();
            let mut scene = scene_from_truth(&truth).unwrap();
            let names: Vec<String> = truth.objects.iter().map(|o| o.name.clone()).collect();
            for body in &mut scene.bodies {
                if let Some(m) = body.mass {
                    let heavier = MassProperties::new(1.2 * m.mass(), m.com(), m.inertia() * 1.2);
                    body.mass = Some(heavier.unwrap());
                }
            }
            let platform = truth.landing.as_ref().unwrap().platform.clone();
            let found = standing(&scene, &truth, &names, &platform).unwrap();
            assert!(found.drift_m < 1e-3, "{}: {} m", truth.name, found.drift_m);
            assert!(found.end.is_some() && !found.edges.is_empty() && found.unmatched.is_empty());
            for l in found.loads() {
                println!(
                    "{} {:.2}: {:.2} {:.2} {:.2}",
                    truth.name, l.p_w, l.truth_n, l.planner_n, l.true_masses_n
                );
            }
            let ([material_prior, own], [_, worst]) =
                (found.end_errors().unwrap(), found.worst_errors().unwrap());
            assert!(
                (material_prior - 0.2).abs() < 0.06 && own.abs() < 0.05,
                "{}: {material_prior}, {own}",
                truth.name
            );
            assert!(worst.abs() < 0.08, "{}: {worst}", truth.name);
        }
    }
}
