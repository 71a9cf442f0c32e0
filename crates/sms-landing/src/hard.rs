//! Hard worlds: perturbed worlds in which the structure stands, but a small load tips it.
//!
//! Estimated masses may be wrong by a factor. If the ballast is estimated too heavy and its load too light, nothing
//! seems to topple the structure: every landing succeeds, and good landings do not differ from bad ones. It is certain
//! only that the structure stood during the scan, so landings are compared in worlds in which it stands and a small
//! load tips it.

use crate::{CarriedOut, LandingDisturbances, LandingError, LandingSettings, ResolvedLanding};
use glamx::{DVec2, DVec3};
use rayon::prelude::*;
use sms_core::{Cancel, MassProperties, Progress, Seed};
use sms_scene::Scene;
use sms_sim::{LoadRamp, WorldFactory, ramp_load_n};

/// Number of points on the platform's edge at which the tipping load is measured: those with the smallest tipping load
/// in the scanned world.
const WEAK_POINTS: usize = 3;
/// Inset of these points from the platform's outline, as a share of its size: corners of reconstructions are rounded.
const INSET: f64 = 0.03;
/// One in this number of worlds is harder than the world that is made lighter: in the hardest world no landing may
/// succeed.
const LIGHTENED: usize = 16;

/// A scene and the execution errors of the flight in it.
#[derive(Debug, Clone)]
pub(crate) struct PerturbedWorld {
    pub(crate) scene: Scene,
    pub(crate) carried_out: CarriedOut,
}

impl PerturbedWorld {
    /// A scene without execution errors.
    pub(crate) fn exactly(scene: Scene) -> Self {
        Self { scene, carried_out: CarriedOut::default() }
    }
}

/// Draws perturbed worlds and orders them by hardness.
pub(crate) struct Hardness<'a> {
    pub(crate) landing: &'a ResolvedLanding,
    pub(crate) factory: &'a dyn WorldFactory,
    pub(crate) disturbances: &'a LandingDisturbances,
    pub(crate) progress: &'a dyn Progress,
    pub(crate) cancel: &'a Cancel,
}

impl Hardness<'_> {
    /// Draws perturbed worlds in which the structure stands.
    pub(crate) fn draw(
        &self,
        scene: &Scene,
        seed: Seed,
        count: usize,
    ) -> Result<Vec<PerturbedWorld>, LandingError> {
        let draw = |index: usize| {
            self.cancel.check()?;
            let d = self.disturbances;
            let drawn = d.standing_scene(self.landing, self.factory, scene, seed, index)?;
            Ok(PerturbedWorld { scene: drawn, carried_out: d.carried_out(seed, index) })
        };
        (0..count).into_par_iter().map(draw).collect()
    }

    /// Draws perturbed worlds in which the structure stands and sorts them by the smallest tipping load, relative to
    /// the world's wash strength; hardest first.
    pub(crate) fn order(
        &self,
        scene: &Scene,
        seed: Seed,
        count: usize,
    ) -> Result<Vec<PerturbedWorld>, LandingError> {
        self.progress.begin("landing: draw worlds in which the structure stands", 0);
        let worlds = self.draw(scene, seed, count)?;
        let points = self.weak_points(scene)?;
        let hardness = |world: &PerturbedWorld| {
            self.cancel.check()?;
            let mut least = f64::INFINITY;
            for p_w in &points {
                least = least.min(self.load_n(&world.scene, *p_w)?);
            }
            Ok::<f64, LandingError>(least / world.carried_out.wash)
        };
        let loads = worlds.par_iter().map(hardness).collect::<Result<Vec<f64>, _>>()?;
        let mut ordered: Vec<(f64, PerturbedWorld)> = loads.into_iter().zip(worlds).collect();
        ordered.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.progress.end(&match (ordered.first(), ordered.get(count / 2)) {
            (Some(least), Some(middle)) => format!(
                "{count} drawn, tipping load at least {} (median {})",
                load_text(least.0),
                load_text(middle.0)
            ),
            _ => String::new(),
        });
        Ok(ordered.into_iter().map(|(_, world)| world).collect())
    }

    /// Picks the worlds of the margins, hardest last, from worlds that are ordered hardest first.
    pub(crate) fn margins(
        &self,
        ordered: &[PerturbedWorld],
        settings: &LandingSettings,
    ) -> Vec<PerturbedWorld> {
        let mut worlds = spread(ordered, settings.margins);
        worlds.reverse();
        let Some(base) = ordered.get(ordered.len() / LIGHTENED) else { return worlds };
        for step in 1..=settings.lighter {
            let share = settings.lightest.powf(step as f64 / settings.lighter as f64);
            let scene = lighter(self.landing, &base.scene, share);
            worlds.push(PerturbedWorld { scene, carried_out: base.carried_out });
        }
        worlds
    }

    /// Finds the points on the platform's edge with the smallest tipping loads.
    fn weak_points(&self, scene: &Scene) -> Result<Vec<DVec3>, LandingError> {
        let surface = self.landing.surface();
        let corners = surface.outline_w.map(DVec2::from);
        let middle = corners.iter().sum::<DVec2>() / corners.len() as f64;
        let points: Vec<DVec3> = (0..corners.len())
            .flat_map(|i| [corners[i], corners[i].midpoint(corners[(i + 1) % corners.len()])])
            .map(|p| p.lerp(middle, INSET).extend(surface.top_w))
            .collect();
        let loads = points.par_iter().map(|p| self.load_n(scene, *p)).collect::<Result<Vec<f64>, _>>()?;
        let mut ordered: Vec<(f64, DVec3)> = loads.into_iter().zip(points).collect();
        ordered.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(ordered.into_iter().take(WEAK_POINTS).map(|(_, p)| p).collect())
    }

    /// Measures the load on a point of the platform that tips the structure, newtons; infinite if even the largest load
    /// of the ramp does not.
    fn load_n(&self, scene: &Scene, p_w: DVec3) -> Result<f64, LandingError> {
        let body = &self.landing.surface().body;
        let load = ramp_load_n(self.factory, scene, body, p_w, &LoadRamp::default())?;
        Ok(load.unwrap_or(f64::INFINITY))
    }
}

/// Formats a tipping load; an infinite one is beyond the ramp of [`Hardness::load_n`].
fn load_text(newtons: f64) -> String {
    if newtons.is_finite() {
        format!("{newtons:.1} N")
    } else {
        format!("over {:.0} N", LoadRamp::default().most_n)
    }
}

/// Picks `count` worlds at logarithmically spaced ranks (the first and those at 1/2, 1/4, 1/8, … of the order) and
/// keeps their order. Missing ranks are filled from the front. Returns all worlds if `count` is at least their number.
pub(crate) fn spread(ordered: &[PerturbedWorld], count: usize) -> Vec<PerturbedWorld> {
    if ordered.len() <= count {
        return ordered.to_vec();
    }
    let mut ranks: Vec<usize> = (1..count).map(|i| ordered.len() >> i).chain([0]).take(count).collect();
    ranks.sort_unstable();
    ranks.dedup();
    for rank in 0..count {
        if ranks.len() < count && !ranks.contains(&rank) {
            ranks.push(rank);
        }
    }
    ranks.sort_unstable();
    ranks.into_iter().map(|i| ordered[i].clone()).collect()
}

/// Scales the structure's masses to this share.
fn lighter(landing: &ResolvedLanding, scene: &Scene, share: f64) -> Scene {
    let mut scene = scene.clone();
    for body in scene.bodies.iter_mut().filter(|b| landing.structure().contains(&b.name)) {
        let scaled = |m: MassProperties| {
            MassProperties::new(m.mass() * share, m.com(), m.inertia() * share).unwrap_or(m)
        };
        body.mass = body.mass.map(scaled);
    }
    scene
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_scene::SCENE_VERSION;

    #[test]
    fn worlds_are_taken_at_halves_of_their_order() {
        let scene = Scene {
            version: SCENE_VERSION,
            name: "empty".into(),
            gravity_w: DVec3::NEG_Z,
            size_sigma: 0.0,
            x_world_recording: glamx::DPose3::IDENTITY,
            bodies: Vec::new(),
        };
        let worlds: Vec<PerturbedWorld> = (0..40)
            .map(|i| PerturbedWorld {
                carried_out: CarriedOut { speed: f64::from(i), ..CarriedOut::default() },
                ..PerturbedWorld::exactly(scene.clone())
            })
            .collect();
        let speeds = |ws: Vec<PerturbedWorld>| ws.iter().map(|w| w.carried_out.speed).collect::<Vec<_>>();
        assert_eq!(speeds(spread(&worlds, 5)), [0.0, 2.0, 5.0, 10.0, 20.0]);
        assert_eq!(speeds(spread(&worlds, 1)), [0.0]);
        assert_eq!(speeds(spread(&worlds, 8)), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 10.0, 20.0]);
        assert_eq!(speeds(spread(&worlds[..3], 5)), [0.0, 1.0, 2.0]);
        assert_eq!(speeds(spread(&worlds[..3], 2)), [0.0, 1.0]);
        assert!(spread(&worlds, 0).is_empty() && spread(&[], 5).is_empty());
    }
}
