//! Sliding, rolling, tipping and resting.

use super::scenes::{DT, G, R, ball, cuboid, fixed, floor, launch, material, run, simulate};
use glamx::{DPose3, DVec3};
use sms_sim::{SimError, WorldFactory};

/// A ball that slides at first rolls at 5/7 of its initial speed after 2v/(7µg); this speed is independent of friction.
pub(super) fn slide_to_roll(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let mut errors = Vec::new();
    for mu in [0.1, 0.3, 0.6] {
        for speed in [0.3, 1.0] {
            let bodies = vec![
                floor(material(mu, 0.0, 0.0)),
                ball("b", DVec3::new(0.0, 0.0, R), material(mu, 0.0, 0.0))?,
            ];
            let mut simulation = simulate(factory, G, bodies)?;
            launch(&mut simulation, 1, DVec3::X * speed, DVec3::ZERO);
            run(&mut simulation, 2.0 * speed / (7.0 * mu * G) + 0.1)?;
            errors.push(simulation.state(1).v_w.x / (5.0 / 7.0 * speed) - 1.0);
        }
    }
    Ok(errors)
}

/// A ball with draw and side spin. The direction of friction is constant until the ball rolls, after 2u/(7µg), where u
/// is the initial speed of the ball's lowest point (Coriolis 1835). So the path is a parabola. Errors are distances
/// from the parabola, relative to its length.
pub(super) fn curved_path(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let mut errors = Vec::new();
    for mu in [0.1, 0.3] {
        for turn in [0.0, 0.5, 2.1, 4.0] {
            let v = 0.8 * DVec3::new(f64::cos(turn), f64::sin(turn), 0.0);
            for w in [DVec3::ZERO, DVec3::new(15.0, -10.0, 30.0), DVec3::new(-25.0, 5.0, 0.0)] {
                let surface = || material(mu, 0.0, 0.0);
                let bodies = vec![floor(surface()), ball("b", DVec3::new(0.0, 0.0, R), surface())?];
                let mut simulation = simulate(factory, G, bodies)?;
                launch(&mut simulation, 1, v, w);
                let slip = v + w.cross(-R * DVec3::Z);
                let slides_s = 2.0 * slip.length() / (7.0 * mu * G);
                // A whole number of steps within the sliding phase.
                let t = (0.95 * slides_s / DT).floor() * DT;
                run(&mut simulation, t)?;
                let expected = v * t - 0.5 * mu * G * t * t * slip.normalize_or_zero();
                let state = simulation.state(1);
                let at = state.x_wb.translation.with_z(0.0);
                errors.push(at.distance(expected) / expected.length());
            }
        }
    }
    Ok(errors)
}

/// A rolling ball decelerates by 5/7·g·lever/radius.
pub(super) fn rolling_stop(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let mut errors = Vec::new();
    for (speed, lever) in [(0.3, 2e-4), (0.6, 1e-3), (0.2, 5e-4)] {
        let surface = || material(0.3, 0.0, lever);
        let bodies = vec![floor(surface()), ball("b", DVec3::new(0.0, 0.0, R), surface())?];
        let mut simulation = simulate(factory, G, bodies)?;
        let heading = DVec3::new(0.3f64.cos(), 0.3f64.sin(), 0.0);
        launch(&mut simulation, 1, speed * heading, DVec3::Z.cross(heading) * (speed / R));
        let deceleration = 5.0 / 7.0 * G * lever / R;
        run(&mut simulation, speed / deceleration + 1.0)?;
        let state = simulation.state(1);
        let way = state.x_wb.translation.dot(heading);
        errors.push(way / (speed * speed / (2.0 * deceleration)) - 1.0);
        errors.push(state.v_w.length() / speed);
    }
    Ok(errors)
}

/// A block slides by v²/(2µg).
pub(super) fn sliding_block(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let mut errors = Vec::new();
    for (mu, speed) in [(0.2, 0.8), (0.5, 0.8), (0.5, 1.6)] {
        let half = DVec3::new(0.05, 0.04, 0.01);
        let block =
            cuboid("block", DPose3::from_translation(DVec3::Z * half.z), half, material(mu, 0.0, 0.0))?;
        let mut simulation = simulate(factory, G, vec![floor(material(mu, 0.0, 0.0)), block])?;
        // The block first settles by some µm.
        run(&mut simulation, 0.2)?;
        let start = simulation.state(1).x_wb.translation.x;
        launch(&mut simulation, 1, DVec3::X * speed, DVec3::ZERO);
        run(&mut simulation, speed / (mu * G) + 0.3)?;
        let way = simulation.state(1).x_wb.translation.x - start;
        errors.push(way / (speed * speed / (2.0 * mu * G)) - 1.0);
    }
    Ok(errors)
}

/// A platform of 0.24 m on a post 0.12 m wide. A force on its edge, 0.06 m beyond the post's edge, tips it if the force
/// exceeds its weight. The threshold is found by bisection.
pub(super) fn tipping_force(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let surface = || material(0.5, 0.0, 0.0);
    let (post, plate) = (DVec3::new(0.06, 0.06, 0.05), DVec3::new(0.12, 0.06, 0.005));
    let top = 2.0 * post.z + plate.z;
    let bodies = vec![
        fixed(cuboid("post", DPose3::from_translation(DVec3::Z * post.z), post, surface())?),
        cuboid("platform", DPose3::from_translation(DVec3::Z * top), plate, surface())?,
    ];
    let weight = bodies[1].mass.as_ref().map_or(0.0, |m| m.mass()) * G;
    let arm = plate.x - post.x;
    let expected = weight * post.x / arm;
    let tips = |force: f64| -> Result<bool, SimError> {
        let mut simulation = simulate(factory, G, bodies.clone())?;
        run(&mut simulation, 0.2)?;
        let state = simulation.state(1);
        let begin = state.x_wb.rotation;
        for _ in 0..(0.6 / DT) as usize {
            let state = simulation.state(1);
            let lever = state.x_wb.rotation * DVec3::new(plate.x, 0.0, 0.0);
            let force_w = DVec3::Z * -force;
            simulation.apply_wrench(1, force_w, lever.cross(force_w));
            simulation.advance(DT)?;
        }
        Ok(simulation.state(1).x_wb.rotation.angle_between(begin) > 0.02)
    };
    let (mut low, mut high) = (0.5 * expected, 1.5 * expected);
    if tips(low)? || !tips(high)? {
        return Ok(vec![f64::INFINITY]);
    }
    for _ in 0..9 {
        let middle = 0.5 * (low + high);
        if tips(middle)? { high = middle } else { low = middle }
    }
    Ok(vec![0.5 * (low + high) / expected - 1.0])
}

/// A stack of four boxes stays in place.
pub(super) fn stack(factory: &dyn WorldFactory) -> Result<Vec<f64>, SimError> {
    let half = DVec3::new(0.04, 0.04, 0.03);
    let mut bodies = vec![floor(material(0.5, 0.2, 0.0))];
    for k in 0..4 {
        let center = DPose3::from_translation(DVec3::Z * (half.z * f64::from(2 * k + 1)));
        bodies.push(cuboid(&format!("box{k}"), center, half, material(0.5, 0.2, 0.0))?);
    }
    let starts: Vec<DVec3> = bodies.iter().map(|b| b.x_wb.translation).collect();
    let mut simulation = simulate(factory, G, bodies)?;
    run(&mut simulation, 4.0)?;
    Ok((1..5).map(|b| 1e3 * simulation.state(b).x_wb.translation.distance(starts[b])).collect())
}
