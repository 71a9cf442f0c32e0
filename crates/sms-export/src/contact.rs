//! Conversion of our contact rule to that of other simulators.
//!
//! A pair of bodies has the mean of both coefficients here. Other simulators multiply them or take the smaller or larger one.
//! The exported values give a body on the ground exactly the mean; pairs of moving bodies get the best approximation of each
//! rule.

use sms_core::Property;
use sms_scene::{Body, BodyKind, BodyShape, Scene};

/// Returns the ground: the first half space, else the first static body.
pub(crate) fn ground(scene: &Scene) -> Option<&Body> {
    let is_plane = |b: &&Body| matches!(b.shape, BodyShape::HalfSpace);
    scene.bodies.iter().find(is_plane).or_else(|| scene.bodies.iter().find(|b| b.kind == BodyKind::Static))
}

/// Returns the mean of a coefficient of `body` and of the ground, or that of a static body itself.
pub(crate) fn with_ground(scene: &Scene, body: &Body, of: impl Fn(&Body) -> Property) -> f64 {
    let own = of(body).value.best;
    match ground(scene) {
        Some(ground) if body.kind == BodyKind::Dynamic => 0.5 * (own + of(ground).value.best),
        _ => own,
    }
}

/// Friction, restitution and rolling lever of a body for simulators that **multiply** those of a pair (Bullet; DART for
/// restitution): exact against the ground, approximate for other pairs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ContactFactors {
    pub(crate) friction: f64,
    pub(crate) restitution: f64,
    /// Lever in metres such that Bullet's rule, own lever × other's friction + other's × own, gives our mean; 0 for static
    /// bodies.
    pub(crate) rolling: f64,
}

/// Returns the square root of the ground's coefficient, the divisor for the factors of moving bodies.
fn root(value: f64) -> f64 {
    value.max(0.01).sqrt()
}

/// See [`ContactFactors`].
pub(crate) fn factors(scene: &Scene, body: &Body) -> ContactFactors {
    let own = &body.material;
    let base = ground(scene).map_or(own, |b| &b.material);
    if body.kind == BodyKind::Static {
        return ContactFactors {
            friction: root(own.friction.value.best),
            restitution: root(own.restitution.value.best),
            rolling: 0.0,
        };
    }
    let friction = with_ground(scene, body, |b| b.material.friction) / root(base.friction.value.best);
    let restitution =
        with_ground(scene, body, |b| b.material.restitution) / root(base.restitution.value.best);
    let rolls = matches!(body.shape, BodyShape::Sphere { .. } | BodyShape::Cylinder { .. });
    let lever = if rolls { with_ground(scene, body, |b| b.material.rolling_m) } else { 0.0 };
    ContactFactors { friction, restitution, rolling: lever / root(base.friction.value.best) }
}

/// Returns the damping ratio of a spring-damper contact without adhesion for a coefficient of restitution (Schwager and Pöschel
/// 2007, eq. 19), by bisection.
pub(crate) fn damping_ratio(restitution: f64) -> f64 {
    let rebound = |ratio: f64| {
        let (beta, omega) = (ratio, (1.0 - ratio * ratio).sqrt());
        let angle = std::f64::consts::PI - (2.0 * beta * omega).atan2(omega * omega - beta * beta);
        (-beta / omega * angle).exp()
    };
    let (mut low, mut high) = (0.005, 0.999);
    if restitution <= rebound(high) {
        return 1.0;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if rebound(middle) > restitution { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example::scene;

    #[test]
    fn products_with_the_ground_are_the_means() {
        let scene = scene();
        let floor = factors(&scene, scene.body("floor").unwrap());
        for body in scene.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic) {
            let f = factors(&scene, body);
            let mean = |of: &dyn Fn(&Body) -> Property| {
                0.5 * (of(body).value.best + of(ground(&scene).unwrap()).value.best)
            };
            assert!((f.friction * floor.friction - mean(&|b| b.material.friction)).abs() < 1e-12);
            assert!((f.restitution * floor.restitution - mean(&|b| b.material.restitution)).abs() < 1e-12);
            let rolling = f.rolling * floor.friction + floor.rolling * f.friction;
            let rolls = ["ball", "can"].contains(&body.name.as_str());
            let expected = if rolls { mean(&|b| b.material.rolling_m) } else { 0.0 };
            assert!((rolling - expected).abs() < 1e-12, "{}", body.name);
        }
    }

    #[test]
    fn a_damped_spring_gives_back_what_its_ratio_says() {
        for restitution in [0.3, 0.5, 0.9] {
            let ratio = damping_ratio(restitution);
            // x'' = −2ζ x' − x from rest at the surface until the force x'' no longer pushes.
            let (mut x, mut v, dt) = (0.0, -1.0, 1e-5);
            while -2.0 * ratio * v - x > 0.0 || x >= 0.0 {
                v += dt * (-2.0 * ratio * v - x);
                x += dt * v;
            }
            assert!((v - restitution).abs() < 1e-3, "{restitution}: {v}");
        }
        assert_eq!((damping_ratio(0.0), damping_ratio(1.0) < 0.006), (1.0, true));
    }
}
