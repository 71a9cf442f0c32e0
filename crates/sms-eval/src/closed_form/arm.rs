//! The arm strikes a ball with its effective mass.

use super::scenes::{R, ball, material, simulate};
use glamx::DVec3;
use sms_core::sphere_mass_properties;
use sms_robots::{ArmStrike, FIST_HALF, OscConfig, RobotModel, StrikeConfig, Sweep, Workspace, plan_sweep};
use sms_scene::Body;
use sms_sim::{SimError, Striker, WorldFactory};
use std::sync::Arc;

/// Places (x, y), directions and speeds of the strikes.
const STRIKES: [(f64, f64, f64, f64); 4] =
    [(0.5, 0.1, 0.4, 0.3), (0.45, 0.0, 0.0, 0.6), (0.5, -0.1, -0.3, 0.8), (0.4, 0.15, 1.2, 0.5)];
/// Masses of the balls, kg; restitutions; places on the front face, metres from its middle.
const MASSES: [f64; 4] = [0.03, 0.19, 0.5, 2.0];
const RESTITUTIONS: [f64; 3] = [0.0, 0.6, 1.0];
const OFFSETS: [f64; 3] = [0.0, 0.008, -0.012];

/// Errors of one blow.
struct Blow {
    /// Ball's speed along the sweep over (1 + e)·v/(1 + m/M) − 1, with speed v and effective mass M of the touched
    /// point.
    speed: f64,
    /// Sum of the momenta of ball and arm, relative.
    momentum: f64,
    /// Energy of ball and arm after over before − 1.
    energy: f64,
    restitution: f64,
}

pub(super) fn speed(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(blows(factory)?.iter().map(|b| b.speed).collect())
}

pub(super) fn momentum(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(blows(factory)?.iter().map(|b| b.momentum).collect())
}

/// Energy errors of elastic blows.
pub(super) fn energy(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    Ok(blows(factory)?.iter().filter(|b| b.restitution == 1.0).map(|b| b.energy).collect())
}

fn blows(factory: &dyn WorldFactory) -> Result<Vec<Blow>, SimError> {
    let model = Arc::new(RobotModel::fr3());
    let mut all = Vec::new();
    for (x, y, angle, speed) in STRIKES {
        let sweep = Sweep::of_ball(DVec3::new(x, y, R), R, angle, speed, FIST_HALF.x);
        let plan = plan_sweep(&model, &sweep, &[], &StrikeConfig::default(), &mut Workspace::default())?;
        let strike = Arc::new(ArmStrike::of_plan(model.clone(), &plan, OscConfig::default(), FIST_HALF));
        for mass in MASSES {
            for e in RESTITUTIONS {
                for offset in OFFSETS {
                    all.push(blow(factory, &strike, mass, e, offset)?);
                }
            }
        }
    }
    Ok(all)
}

fn blow(
    factory: &dyn WorldFactory,
    strike: &Arc<ArmStrike>,
    mass: f64,
    e: f64,
    offset: f64,
) -> Result<Blow, SimError> {
    let sweep = &strike.sweep;
    let d = sweep.direction_w;
    let point_w = sweep.contact_w + FIST_HALF.x * d + offset * DVec3::Z.cross(d);
    let (mut simulation, cue) = (simulate(factory, 0.0, vec![heavy(point_w + R * d, mass, e)?])?, 0);
    let striker = simulation.strike(Striker::Arm(strike.clone()), 0.0, e);
    simulation.advance(sweep.contact_s() - 1e-3)?;
    let missing = || SimError::Body { body: "striker".into(), why: "it is not an arm".into() };
    let mut before = simulation.arm(striker).ok_or_else(missing)?.clone();
    before.advance_to(sweep.contact_s());
    let (x_wt, v_w, w_w) = before.tool();
    let tip = (v_w + w_w.cross(point_w - x_wt.translation)).dot(d);
    let arm_mass = before.effective_mass(point_w, d);
    let energy = before.kinetic_energy();
    // The blow lasts for some 0.1 ms.
    simulation.advance(1.5e-3)?;
    let v = simulation.state(cue).v_w;
    let received = simulation.received_impulse_w(striker).ok_or_else(missing)?;
    let mut after = simulation.arm(striker).ok_or_else(missing)?.clone();
    let energy_after = after.kinetic_energy() + 0.5 * mass * v.length_squared();
    // Change of the arm's momentum by the motors without the ball.
    before.advance_to(simulation.time_s());
    let by_motors = before.kinetic_energy() - energy;
    Ok(Blow {
        speed: v.dot(d) / ((1.0 + e) * tip / (1.0 + mass / arm_mass)) - 1.0,
        momentum: (mass * v + received).length() / (mass * v.length()),
        energy: (energy_after - by_motors) / energy - 1.0,
        restitution: e,
    })
}

fn heavy(center_w: DVec3, mass: f64, e: f64) -> Result<Body, SimError> {
    let density = mass / (4.0 / 3.0 * std::f64::consts::PI * R.powi(3));
    let properties = sphere_mass_properties(DVec3::ZERO, R, density)
        .map_err(|why| SimError::Body { body: "cue".into(), why: why.to_string() })?;
    Ok(Body { mass: Some(properties), ..ball("cue", center_w, material(0.0, e, 0.0))? })
}
