//! What was kept fixed when the scene was made, and can topple all the same.

use crate::resolved::STANDS;
use crate::{LandingDisturbances, LandingError, LandingTask, ResolvedLanding};
use sms_core::{Seed, StageError};
use sms_scene::{BodyKind, Scene};
use sms_sim::{RestingDrift, WorldFactory, fix_restless};

/// A scene in which bodies of the structure can move that were fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct Freed {
    /// The scene.
    pub scene: Scene,
    /// Names of the bodies that can move now, in the scene's order.
    pub bodies: Vec<String>,
    /// Whether the structure would fall with the most likely masses, so that the scene has others within their intervals.
    pub other_masses: bool,
    /// What had to be fixed again, with how far it came by itself, in that order.
    pub held: Vec<RestingDrift>,
    /// What stays fixed because the structure falls otherwise, though it is something else that leaves.
    pub stuck: Option<Stuck>,
}

/// Bodies that could not be freed for another one's sake.
#[derive(Debug, Clone, PartialEq)]
pub struct Stuck {
    /// Their names.
    pub bodies: Vec<String>,
    /// What leaves when they are free, with how far it comes.
    pub leaves: RestingDrift,
}

impl LandingTask {
    /// Lets the parts of the structure move that were kept fixed when the scene was made: what crept by a millimetre then, with the
    /// prior's masses, may stand with those that are known by now, and what is fixed can be neither toppled nor spared. Parts are
    /// those that touch the platform once all that is solid can move; their masses are those of their shapes and materials. Where the
    /// structure then stands, with masses within its materials' intervals if need be, all of them stay free; else what leaves first is
    /// fixed again until the rest stands by the limits of [`ResolvedLanding::check_rest`]. Where that leaves nothing free, the scene is
    /// as it was. What would have failed a landing by itself, with nothing flying over it, is no structure to land on: where the platform
    /// would be fixed because a part leaves by more than [`crate::LandingSuccess`] allows, it is refused. `None` where no part was fixed, and where the task says that it is to stay so ([`LandingTask::free`]).
    ///
    /// # Errors
    /// [`LandingError::AlreadyFalling`], and errors of scenes that cannot be simulated.
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
            // The scene as it is will be refused in the same way.
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

/// Fixes those of `bodies` that leave first until the structure stands; where it never does, all of them.
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
            // What else moves in the room is no concern of the structure.
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
