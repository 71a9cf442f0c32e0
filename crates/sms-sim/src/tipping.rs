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
    let Some(id) = movable(scene, body) else { return Ok(None) };
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

/// How fast a load grows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadRamp {
    /// Newtons per second.
    pub rate_n_per_s: f64,
    /// The largest load, newtons.
    pub most_n: f64,
    /// What sinks farther than this has tipped, metres.
    pub sinks_m: f64,
}

impl Default for LoadRamp {
    /// Up to the weight of two small quadrotors in six seconds.
    fn default() -> Self {
        Self { rate_n_per_s: 4.0, most_n: 24.0, sinks_m: 0.01 }
    }
}

/// The force straight down at a point of a body (world, metres) under which the point has sunk by [`LoadRamp::sinks_m`] while the force
/// grows from zero, newtons; `None` where the largest does not do it or the body cannot move. It is more than
/// [`tipping_load_n`] by what it grows while the body sinks, a newton or two, but takes one simulation: good for what is to be ordered.
///
/// # Errors
/// [`SimError`] when the world cannot be built.
pub fn ramp_load_n(
    factory: &dyn WorldFactory,
    scene: &Scene,
    body: &str,
    p_w: DVec3,
    ramp: &LoadRamp,
) -> Result<Option<f64>, SimError> {
    let Some(id) = movable(scene, body) else { return Ok(None) };
    let load_at = |t: f64| ramp.rate_n_per_s * t;
    loaded(factory, scene, id, p_w, ramp.most_n / ramp.rate_n_per_s, &load_at, ramp.sinks_m)
}

/// The index of a body that can move.
fn movable(scene: &Scene, body: &str) -> Option<usize> {
    scene.body_index(body).filter(|&i| scene.bodies[i].kind == BodyKind::Dynamic)
}

fn tips(
    factory: &dyn WorldFactory,
    scene: &Scene,
    id: usize,
    p_w: DVec3,
    load_n: f64,
    test: &LoadTest,
) -> Result<bool, SimError> {
    let load_at = |t: f64| load_n * (t / test.grows_s).min(1.0);
    let seconds = test.grows_s + test.stays_s;
    Ok(loaded(factory, scene, id, p_w, seconds, &load_at, test.sinks_m)?.is_some())
}

/// The load under which the point had sunk, of one that is a function of time; `None` where it does not sink in that time.
fn loaded(
    factory: &dyn WorldFactory,
    scene: &Scene,
    id: usize,
    p_w: DVec3,
    seconds: f64,
    load_at: &dyn Fn(f64) -> f64,
    sinks_m: f64,
) -> Result<Option<f64>, SimError> {
    let options = WorldOptions { sleep: false, contact_timing: false, ..WorldOptions::default() };
    let mut simulation = Simulation::new(factory, scene, &options)?;
    let com_b = scene.bodies[id].mass.map_or(DVec3::ZERO, |m| m.com());
    let p_b = simulation.state(id).x_wb.inverse() * p_w;
    let steps = (seconds / options.dt).round() as usize;
    for step in 0..steps {
        let now = simulation.state(id).x_wb;
        let load_n = load_at((step + 1) as f64 * options.dt);
        let force = DVec3::NEG_Z * load_n;
        simulation.apply_wrench(id, force, (now * p_b - now * com_b).cross(force));
        match simulation.advance(options.dt) {
            Ok(_) => {}
            // What flies apart under a load does not bear it.
            Err(SimError::Diverged { .. }) => return Ok(Some(load_n)),
            Err(e) => return Err(e),
        }
        if p_w.z - (simulation.state(id).x_wb * p_b).z > sinks_m {
            return Ok(Some(load_n));
        }
    }
    Ok(None)
}
