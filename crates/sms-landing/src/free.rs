//! What was kept fixed when the scene was made, and can topple all the same.

use crate::resolved::STANDS;
use crate::{LandingDisturbances, LandingError, LandingTask};
use sms_core::Seed;
use sms_scene::{BodyKind, Scene, loose_mass};
use sms_sim::{WorldFactory, fix_restless};

/// A scene in which bodies of the structure can move that were fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct Freed {
    /// The scene.
    pub scene: Scene,
    /// Names of the bodies that can move now, in the scene's order.
    pub bodies: Vec<String>,
}

impl LandingTask {
    /// Lets the parts of the structure move that were kept fixed when the scene was made: what crept by a millimetre then, with the
    /// prior's masses, may stand with those that are known by now, and what is fixed can be neither toppled nor spared. Parts are
    /// those that touch the platform once all that is solid can move; their masses are those of their shapes and materials. Where the
    /// structure then stands with masses within its materials' intervals, all of them stay free; else what leaves first is fixed
    /// until the rest stands by the limits of [`crate::ResolvedLanding::check_rest`]. `None` where nothing could be freed.
    ///
    /// # Errors
    /// [`LandingError`] of scenes that cannot be simulated.
    pub fn freed(
        &self,
        factory: &dyn WorldFactory,
        scene: &Scene,
        disturbances: &LandingDisturbances,
        seed: Seed,
    ) -> Result<Option<Freed>, LandingError> {
        let mut loose = scene.clone();
        let mut bodies = Vec::new();
        for body in loose.bodies.iter_mut().filter(|b| b.kind == BodyKind::Static) {
            if let Some(mass) = body.mass.or_else(|| loose_mass(body)) {
                (body.kind, body.mass) = (BodyKind::Dynamic, Some(mass));
                bodies.push(body.name.clone());
            }
        }
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
        let mut freed = scene.clone();
        for (body, free) in freed.bodies.iter_mut().zip(loose.bodies) {
            if bodies.contains(&free.name) {
                *body = free;
            }
        }
        match disturbances.that_stands(&landing, factory, &freed, seed.derive("freed")) {
            Ok(_) => {}
            Err(LandingError::AlreadyFalling(_)) => {
                fix_restless(factory, &mut freed, &STANDS)?;
                bodies.retain(|name| freed.body(name).is_some_and(|b| b.kind == BodyKind::Dynamic));
            }
            Err(e) => return Err(e),
        }
        Ok((!bodies.is_empty()).then_some(Freed { scene: freed, bodies }))
    }
}
