//! Impacts of balls.

use super::scenes::{
    DT, G, PHASES, R, ball, cuboid, fixed, floor, launch, material, phases, run, simulate, simulate_with,
};
use glamx::{DPose3, DQuat, DVec3};
use sms_scene::{Body, BodyShape};
use sms_sim::{SimError, WorldFactory};

const CUTS_DEG: [f64; 4] = [15.0, 30.0, 45.0, 60.0];
const SPEEDS: [f64; 4] = [0.2, 0.4, 0.8, 1.6];
/// Friction and restitution of the balls.
type Surface = (f64, f64);
const SMOOTH: [Surface; 2] = [(0.0, 0.5), (0.0, 0.95)];
const ROUGH: [Surface; 4] = [(0.05, 0.95), (0.1, 0.95), (0.1, 0.5), (0.4, 0.9)];

/// Direction error (degrees, to the left) and relative speed error of a ball struck at a cut in free space.
///
/// Two equal solid spheres exchange (1+e)/2 of the closing speed along the line of centres; across this line friction
/// either slides (µ times the normal impulse) or sticks (a seventh of the tangential speed at the contact).
fn oblique(
    factory: &dyn WorldFactory,
    timing: bool,
    (mu, e): Surface,
    cut: f64,
    speed: f64,
    phase: f64,
) -> Result<(f64, f64), SimError> {
    let gap = 0.02 + speed * DT * phase;
    let at_impact = DVec3::new(-2.0 * R * cut.cos(), 2.0 * R * cut.sin(), 0.0);
    let cue = ball("cue", at_impact - DVec3::new(gap, 0.0, 0.0), material(mu, e, 0.0))?;
    let target = ball("target", DVec3::ZERO, material(mu, e, 0.0))?;
    let mut simulation = simulate_with(factory, 0.0, vec![cue, target], timing)?;
    launch(&mut simulation, 0, DVec3::new(speed, 0.0, 0.0), DVec3::ZERO);
    run(&mut simulation, gap / speed + 0.1)?;
    let normal = 0.5 * (1.0 + e) * speed * cut.cos();
    let tangential = (mu * normal).min(speed * cut.sin() / 7.0);
    let expected = -cut + (tangential / normal).atan();
    let v = simulation.state(1).v_w;
    Ok(((v.y.atan2(v.x) - expected).to_degrees(), v.length() / normal.hypot(tangential) - 1.0))
}

/// Runs [`oblique`] for every cut, speed and phase.
fn oblique_all(
    factory: &dyn WorldFactory,
    timing: bool,
    surfaces: &[Surface],
) -> Result<Vec<(f64, f64)>, SimError> {
    let mut errors = Vec::new();
    for &surface in surfaces {
        for cut in CUTS_DEG {
            for speed in SPEEDS {
                for phase in phases() {
                    errors.push(oblique(factory, timing, surface, cut.to_radians(), speed, phase)?);
                }
            }
        }
    }
    Ok(errors)
}

pub(super) fn oblique_without_friction(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(oblique_all(factory, true, &SMOOTH)?.into_iter().map(|e| e.0).collect())
}

pub(super) fn oblique_with_friction(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(oblique_all(factory, true, &ROUGH)?.into_iter().map(|e| e.0).collect())
}

pub(super) fn oblique_speed(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(oblique_all(factory, true, &[SMOOTH, [ROUGH[1], ROUGH[3]]].concat())?
        .into_iter()
        .map(|e| e.1)
        .collect())
}

/// Head on, with side spin: the sideways motion of the surface drags the object ball along.
pub(super) fn spin_throw(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let mut errors = Vec::new();
    for (mu, e) in ROUGH {
        for spin in [2.0, 10.0, 40.0] {
            for phase in phases() {
                let speed = 0.8;
                let gap = 0.02 + speed * DT * phase;
                let cue = ball("cue", DVec3::new(-2.0 * R - gap, 0.0, 0.0), material(mu, e, 0.0))?;
                let target = ball("target", DVec3::ZERO, material(mu, e, 0.0))?;
                let mut simulation = simulate(factory, 0.0, vec![cue, target])?;
                launch(&mut simulation, 0, DVec3::new(speed, 0.0, 0.0), DVec3::new(0.0, 0.0, spin));
                run(&mut simulation, gap / speed + 0.1)?;
                let normal = 0.5 * (1.0 + e) * speed;
                let tangential = (mu * normal).min(spin * R / 7.0);
                let v = simulation.state(1).v_w;
                errors.push((v.y.atan2(v.x) - tangential.atan2(normal)).to_degrees());
            }
        }
    }
    Ok(errors)
}

/// At a cut, with topspin or draw: the slip has a component along the table and one across. Friction opposes the slip,
/// so the sideways throw of the object ball decreases with the spin.
pub(super) fn topspin_throw(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let mut errors = Vec::new();
    for (mu, e) in ROUGH {
        for cut in CUTS_DEG.map(f64::to_radians) {
            for spin in [-0.5, 0.5, 1.0] {
                let speed = 0.8;
                let gap = 0.02;
                let line = DVec3::new(cut.cos(), -cut.sin(), 0.0);
                let start = -2.0 * R * line - DVec3::new(gap, 0.0, 0.0);
                let cue = ball("cue", start, material(mu, e, 0.0))?;
                let target = ball("target", DVec3::ZERO, material(mu, e, 0.0))?;
                let mut simulation = simulate(factory, 0.0, vec![cue, target])?;
                let (v_w, w_w) = (DVec3::X * speed, DVec3::Y * (spin * speed / R));
                launch(&mut simulation, 0, v_w, w_w);
                run(&mut simulation, gap / speed + 0.1)?;
                let normal = 0.5 * (1.0 + e) * speed * cut.cos();
                let slip = v_w + w_w.cross(R * line) - line * v_w.dot(line);
                let tangential = (mu * normal).min(slip.length() / 7.0);
                let expected = normal * line + tangential * slip.normalize_or_zero();
                errors.push(simulation.state(1).v_w.angle_between(expected).to_degrees());
            }
        }
    }
    Ok(errors)
}

pub(super) fn head_on(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(head_on_all(factory)?.into_iter().map(|e| e.0).collect())
}

pub(super) fn head_on_momentum(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(head_on_all(factory)?.into_iter().map(|e| e.1).collect())
}

/// Errors of restitution and of momentum, relative to the speed.
fn head_on_all(factory: &dyn WorldFactory) -> Result<Vec<(f64, f64)>, SimError> {
    let mut errors = Vec::new();
    for e in [0.5, 0.95] {
        for speed in [0.05, 0.2, 0.8] {
            for phase in phases() {
                let gap = 0.01 + speed * DT * phase;
                let balls = vec![
                    ball("a", DVec3::ZERO, material(0.1, e, 0.0))?,
                    ball("b", DVec3::new(2.0 * R + gap, 0.0, 0.0), material(0.1, e, 0.0))?,
                ];
                let mut simulation = simulate(factory, 0.0, balls)?;
                launch(&mut simulation, 0, DVec3::new(speed, 0.0, 0.0), DVec3::ZERO);
                run(&mut simulation, gap / speed + 0.05)?;
                let (a, b) = (simulation.state(0).v_w.x, simulation.state(1).v_w.x);
                errors.push(((b - a) / speed - e, (a + b) / speed - 1.0));
            }
        }
    }
    Ok(errors)
}

/// Restitution of a dropped ball: the square root of the share of its height that it reaches again.
pub(super) fn drop(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let mut errors = Vec::new();
    for e in [0.5, 0.8, 0.95] {
        for k in 0..PHASES {
            let height = 0.03 + 0.1 * k as f64 / PHASES as f64;
            let bodies = vec![
                floor(material(0.3, e, 0.0)),
                ball("b", DVec3::new(0.0, 0.0, R + height), material(0.3, e, 0.0))?,
            ];
            let mut simulation = simulate(factory, G, bodies)?;
            let (mut top, mut has_bounced) = (0.0f64, false);
            for _ in 0..400 {
                simulation.advance(DT)?;
                let state = simulation.state(1);
                has_bounced |= state.v_w.z > 0.0;
                if has_bounced {
                    // The highest point lies between two steps.
                    top = top.max(state.x_wb.translation.z - R + state.v_w.z.max(0.0).powi(2) / (2.0 * G));
                    if state.v_w.z < 0.0 {
                        break;
                    }
                }
            }
            errors.push((top / height).sqrt() - e);
        }
    }
    Ok(errors)
}

/// A frictionless wall at 45°, as a hull and as a mesh, reverses only the normal velocity.
pub(super) fn wall(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let turn = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_4);
    let half = DVec3::new(0.2, 0.3, 0.1);
    let x_wb = DPose3::from_parts(turn * DVec3::new(0.2 + R, 0.0, 0.0), turn);
    let hull = fixed(cuboid("hull", x_wb, half, material(0.0, 0.8, 0.0))?);
    let mesh = Body {
        name: "mesh".into(),
        shape: BodyShape::TriMesh { mesh: sms_core::Mesh::cuboid(half) },
        ..hull.clone()
    };
    let mut errors = Vec::new();
    for wall in [hull, mesh] {
        for speed in SPEEDS {
            for phase in phases() {
                let gap = 0.02 + speed * DT * phase;
                let start = DVec3::new(-gap, 0.0, 0.0);
                let bodies = vec![wall.clone(), ball("b", start, material(0.0, 0.8, 0.0))?];
                let mut simulation = simulate(factory, 0.0, bodies)?;
                launch(&mut simulation, 1, DVec3::new(speed, 0.0, 0.0), DVec3::ZERO);
                run(&mut simulation, gap / speed + 0.05)?;
                let v = turn.inverse() * simulation.state(1).v_w / speed;
                let expected = DVec3::new(-0.8, -1.0, 0.0) * std::f64::consts::FRAC_1_SQRT_2;
                errors.push((v - expected).length());
            }
        }
    }
    Ok(errors)
}

/// A rolling cue ball on the table, cut 45°. The object ball leaves along the line of centres and finally rolls at 5/7
/// of its initial speed; the spin of the cue ball moves it forward.
pub(super) fn follow_through(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(follow_through_all(factory)?.into_iter().map(|e| e[0]).collect())
}

pub(super) fn follow_through_speed(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(follow_through_all(factory)?.into_iter().map(|e| e[1]).collect())
}

pub(super) fn follow_through_cue(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(follow_through_all(factory)?.into_iter().map(|e| e[2]).collect())
}

/// Returns direction (degrees) and relative speed of the object ball, and direction of the cue ball (degrees).
fn follow_through_all(factory: &dyn WorldFactory) -> Result<Vec<[f64; 3]>, SimError> {
    let (e, speed, cut) = (0.95, 0.8, 45f64.to_radians());
    let mut errors = Vec::new();
    for phase in phases() {
        let gap = 0.05 + speed * DT * phase;
        let at_impact = DVec3::new(-2.0 * R * cut.cos(), 2.0 * R * cut.sin(), R);
        // Frictionless balls on a rough cloth: between cloth and ball the friction is the mean of both surfaces, so it
        // is 0 between the balls.
        let bodies = vec![
            floor(material(0.6, 0.0, 0.0)),
            ball("cue", at_impact - DVec3::new(gap, 0.0, 0.0), material(0.0, e, 0.0))?,
            ball("target", DVec3::new(0.0, 0.0, R), material(0.0, e, 0.0))?,
        ];
        let mut simulation = simulate(factory, G, bodies)?;
        launch(&mut simulation, 1, DVec3::new(speed, 0.0, 0.0), DVec3::new(0.0, speed / R, 0.0));
        run(&mut simulation, gap / speed + 0.5)?;
        let impulse = 0.5 * (1.0 + e) * speed * cut.cos();
        let line = DVec3::new(cut.cos(), -cut.sin(), 0.0);
        let cue = 5.0 / 7.0 * (DVec3::new(speed, 0.0, 0.0) - impulse * line)
            + 2.0 / 7.0 * DVec3::new(speed, 0.0, 0.0);
        let flat = |b| simulation.state(b).v_w.with_z(0.0);
        errors.push([
            flat(2).angle_between(line).to_degrees(),
            flat(2).length() / (5.0 / 7.0 * impulse) - 1.0,
            flat(1).angle_between(cue).to_degrees(),
        ]);
    }
    Ok(errors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_sim::{RapierF64Factory, RapierFactory};

    /// The reason for contact timing: without it, the directions of the same shots are wrong by degrees.
    #[test]
    fn without_contact_timing_oblique_shots_are_bent() {
        let factories: [&dyn WorldFactory; 2] = [&RapierFactory, &RapierF64Factory];
        for factory in factories {
            let errors = oblique_all(factory, false, &SMOOTH[1..]).unwrap();
            let worst = errors.iter().map(|e| e.0.abs()).fold(0.0, f64::max);
            println!("{}: frictionless without timing: {worst:.3}°", factory.engine());
            assert!(worst > 1.0, "{}: {worst}°", factory.engine());
        }
    }
}
