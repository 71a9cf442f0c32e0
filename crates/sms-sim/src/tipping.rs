//! What load tips what stands.

use crate::{SimError, Simulation, WorldFactory, WorldOptions};
use glamx::DVec3;
use sms_scene::{BodyKind, Scene};

/// How a load is put on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadTest {
    /// Time in which the load grows, seconds: a sudden one pushes twice as hard.
    pub grows_s: f64,
    /// Time for which it then stays, seconds.
    pub stays_s: f64,
    /// What sinks farther than this under a load has tipped, metres.
    pub sinks_m: f64,
    /// The largest load, newtons.
    pub most_n: f64,
    /// How exactly the least load that tips is found, as a share of it.
    pub tolerance: f64,
}

impl Default for LoadTest {
    /// A load 1 % above the threshold tips a structure of 10 kg within the time.
    fn default() -> Self {
        Self { grows_s: 1.0, stays_s: 3.0, sinks_m: 0.01, most_n: 40.0, tolerance: 0.005 }
    }
}

/// The least force straight down at a point of a body (world, metres) that makes the point sink by [`LoadTest::sinks_m`], newtons, by
/// halving the interval between loads that stand and loads that tip; 0 where it sinks without one, `None` where the largest load does not
/// tip it or the body cannot move.
///
/// # Errors
/// [`SimError`] when the world cannot be built.
pub fn tipping_load_n(
    factory: &dyn WorldFactory,
    scene: &Scene,
    body: &str,
    p_w: DVec3,
    test: &LoadTest,
) -> Result<Option<f64>, SimError> {
    let Some(id) = scene.body_index(body).filter(|&i| scene.bodies[i].kind == BodyKind::Dynamic) else {
        return Ok(None);
    };
    let tips = |load_n: f64| tips(factory, scene, id, p_w, load_n, test);
    if tips(0.0)? {
        return Ok(Some(0.0));
    }
    // From a small load up, so that the intervals are as narrow as the load asks for.
    let (mut stands, mut falls) = (0.0, test.most_n / 64.0);
    while !tips(falls)? {
        if falls >= test.most_n {
            return Ok(None);
        }
        (stands, falls) = (falls, (2.0 * falls).min(test.most_n));
    }
    while falls - stands > test.tolerance * falls {
        let middle = 0.5 * (stands + falls);
        if tips(middle)? { falls = middle } else { stands = middle }
    }
    Ok(Some(0.5 * (stands + falls)))
}

fn tips(
    factory: &dyn WorldFactory,
    scene: &Scene,
    id: usize,
    p_w: DVec3,
    load_n: f64,
    test: &LoadTest,
) -> Result<bool, SimError> {
    let options = WorldOptions { sleep: false, contact_timing: false, ..WorldOptions::default() };
    let mut simulation = Simulation::new(factory, scene, &options)?;
    let com_b = scene.bodies[id].mass.map_or(DVec3::ZERO, |m| m.com());
    let p_b = simulation.state(id).x_wb.inverse() * p_w;
    let steps = ((test.grows_s + test.stays_s) / options.dt).round() as usize;
    for step in 0..steps {
        let now = simulation.state(id).x_wb;
        let share = ((step + 1) as f64 * options.dt / test.grows_s).min(1.0);
        let force = DVec3::NEG_Z * load_n * share;
        simulation.apply_wrench(id, force, (now * p_b - now * com_b).cross(force));
        match simulation.advance(options.dt) {
            Ok(_) => {}
            // What flies apart under a load does not bear it.
            Err(SimError::Diverged { .. }) => return Ok(true),
            Err(e) => return Err(e),
        }
        if p_w.z - (simulation.state(id).x_wb * p_b).z > test.sinks_m {
            return Ok(true);
        }
    }
    Ok(false)
}
