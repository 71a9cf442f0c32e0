//! Frees bodies of the structure that the scan fixed, so that the wash can topple them.

use crate::resolved::STANDS;
use crate::{LandingDisturbances, LandingError, LandingTask, ResolvedLanding};
use sms_core::{Seed, StageError};
use sms_scene::{BodyKind, Scene};
use sms_sim::{RestingDrift, WorldFactory, fix_restless};

/// A scene in which fixed bodies of the structure can move again.
#[derive(Debug, Clone, PartialEq)]
pub struct Freed {
    /// The scene with the freed bodies.
    pub scene: Scene,
    /// Names of the freed bodies, in the scene's order.
    pub bodies: Vec<String>,
    /// Whether the structure would fall with the most likely masses, so that the scene has other masses from their
    /// intervals.
    pub other_masses: bool,
    /// Drift of the bodies that had to be fixed again, in the order of fixing.
    pub held: Vec<RestingDrift>,
    /// Bodies that stay fixed because another body moves away once they are free.
    pub stuck: Option<Stuck>,
}

/// Bodies that stay fixed to keep another body in place.
#[derive(Debug, Clone, PartialEq)]
pub struct Stuck {
    /// Names of the fixed bodies.
    pub bodies: Vec<String>,
    /// Drift of the body that moves away when they are free.
    pub leaves: RestingDrift,
}

impl LandingTask {
    /// Frees the parts of the structure that the scan fixed: a fixed part can be neither toppled nor spared, and a part
    /// that crept by a millimetre with the prior's masses may stand with the masses known by now. Parts are the solid
    /// bodies that touch the platform, directly or through each other, once all solid bodies can move. Their masses
    /// follow from their shapes and materials.
    ///
    /// If the structure then stands, if need be with other masses from its materials' intervals, all parts stay free.
    /// Otherwise the part that moves away first is fixed again until the rest stands by the limits of
    /// [`ResolvedLanding::check_rest`]. If no part stays free, the scene is unchanged.
    ///
    /// A structure whose platform would be fixed because a part drifts by more than [`crate::LandingSuccess`] allows is
    /// refused: it would fail any landing by itself. Returns `None` if no part was fixed, or if the task keeps the
    /// parts fixed ([`LandingTask::free`]).
    ///
    /// # Errors
    /// [`LandingError::AlreadyFalling`] for a refused structure; other variants if a scene cannot be simulated.
    pub fn freed(
        &self,
        factory: &dyn WorldFactory,
        scene: &Scene,
        disturbances: &LandingDisturbances,
        seed: Seed,
    ) -> Result<Option<Freed>, LandingError> {
        if !self.free {
            return Ok(None);
        }
        let loose = scene.loosened();
        let was_fixed = scene.bodies.iter().zip(&loose.bodies).filter(|(was, is)| was.kind != is.kind);
        let mut bodies: Vec<String> = was_fixed.map(|(_, is)| is.name.clone()).collect();
        if bodies.is_empty() {
            return Ok(None);
        }
        let landing = match self.resolve(&loose) {
            Ok(landing) => landing,
            // Resolving the unchanged scene gives the same error.
            Err(e) if e.input().is_some() => return Ok(None),
            Err(e) => return Err(e),
        };
        bodies.retain(|name| landing.structure().contains(name));
        if bodies.is_empty() {
            return Ok(None);
        }
        let mut freed = scene.clone();
        for (body, free) in freed.bodies.iter_mut().zip(loose.bodies) {
            if bodies.contains(&free.name) {
                *body = free;
            }
        }
        let (mut other_masses, mut held, mut stuck) = (false, Vec::new(), None);
        match disturbances.that_stands(&landing, factory, &freed, seed.derive("freed")) {
            Ok(None) => {}
            Ok(Some(stands)) => (freed, other_masses) = (stands, true),
            Err(LandingError::AlreadyFalling(_)) => {
                (held, stuck) = hold(&landing, factory, &mut freed, &bodies)?;
                let platform = &landing.surface().body;
                let is_fixed = freed.body(platform).is_some_and(|b| b.kind != BodyKind::Dynamic);
                let drifts = held.iter().chain(stuck.iter().map(|s| &s.leaves));
                let limits = &self.success;
                let falls =
                    |d: &&RestingDrift| d.moved_m > limits.moved_m || d.turned_rad > limits.turned_rad;
                if is_fixed && let Some(drift) = drifts.into_iter().find(falls) {
                    let or = "; to plan as if it were fixed, write `free = false` in the task";
                    return Err(landing.falling(drift, scene, or));
                }
            }
            Err(e) => return Err(e),
        }
        bodies.retain(|name| freed.body(name).is_some_and(|b| b.kind == BodyKind::Dynamic));
        let scene = if bodies.is_empty() { scene.clone() } else { freed };
        Ok(Some(Freed { scene, bodies, other_masses, held, stuck }))
    }
}

/// Fixes the members of `bodies` that move away first until the structure stands; if it never does, fixes all of them.
fn hold(
    landing: &ResolvedLanding,
    factory: &dyn WorldFactory,
    freed: &mut Scene,
    bodies: &[String],
) -> Result<(Vec<RestingDrift>, Option<Stuck>), LandingError> {
    let fix = |scene: &mut Scene, name: &str| {
        if let Some(i) = scene.body_index(name) {
            (scene.bodies[i].kind, scene.bodies[i].mass) = (BodyKind::Static, None);
        }
    };
    let (mut held, mut leaves) = (Vec::new(), None);
    for drift in fix_restless(factory, &mut freed.without_pictures(), &STANDS)? {
        if !bodies.contains(&drift.body) {
            // Bodies outside the structure do not matter.
            leaves = leaves.or(Some(drift).filter(|d| landing.structure().contains(&d.body)));
            continue;
        }
        fix(freed, &drift.body);
        held.push(drift);
        match landing.check_rest(factory, freed) {
            Ok(_) => return Ok((held, None)),
            Err(LandingError::AlreadyFalling(_)) => {}
            Err(e) => return Err(e),
        }
    }
    bodies.iter().for_each(|name| fix(freed, name));
    let is_held = |name: &&String| held.iter().any(|d: &RestingDrift| d.body == **name);
    let rest: Vec<String> = bodies.iter().filter(|name| !is_held(name)).cloned().collect();
    let stuck = leaves.filter(|_| !rest.is_empty()).map(|leaves| Stuck { bodies: rest, leaves });
    Ok((held, stuck))
}
