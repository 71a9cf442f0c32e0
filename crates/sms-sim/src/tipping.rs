//! The load that tips a structure.

use crate::{BodyId, SimError, Simulation, WorldFactory, WorldOptions};
use glamx::DVec3;
use sms_scene::{BodyKind, Scene};

/// Settings of a load test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadTest {
    /// Duration of the load's increase, seconds: a sudden load pushes twice as hard.
    pub grows_s: f64,
    /// Duration of the constant load that follows, seconds.
    pub stays_s: f64,
    /// Sinking of the loaded point that counts as tipping, metres.
    pub sinks_m: f64,
    /// The largest load, newtons.
    pub most_n: f64,
    /// Tolerance of the tipping load, as a share of it.
    pub tolerance: f64,
}

impl Default for LoadTest {
    /// Detects a load 1 % above the threshold on a structure of 10 kg.
    fn default() -> Self {
        Self { grows_s: 1.0, stays_s: 3.0, sinks_m: 0.01, most_n: 40.0, tolerance: 0.005 }
    }
}

/// Finds the smallest downward force (newtons) at a point of a body (world, metres) that makes the point sink by
/// [`LoadTest::sinks_m`], by bisection. Returns 0 if the point sinks without a load, and `None` if the largest load
/// does not tip the structure or the body cannot move.
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
    let Some(load) = PointLoad::new(factory, scene, body, p_w) else { return Ok(None) };
    let tips = |load_n: f64| -> Result<bool, SimError> {
        let newtons_at = |t: f64| load_n * (t / test.grows_s).min(1.0);
        Ok(load.sinking_n(test.grows_s + test.stays_s, test.sinks_m, newtons_at)?.is_some())
    };
    if tips(0.0)? {
        return Ok(Some(0.0));
    }
    // Starts from a small load, so that the accuracy is relative to the result.
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

/// A linearly increasing load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoadRamp {
    /// Newtons per second.
    pub rate_n_per_s: f64,
    /// The largest load, newtons.
    pub most_n: f64,
    /// Sinking of the loaded point that counts as tipping, metres.
    pub sinks_m: f64,
}

impl Default for LoadRamp {
    /// Reaches the weight of two small quadrotors in six seconds.
    fn default() -> Self {
        Self { rate_n_per_s: 4.0, most_n: 24.0, sinks_m: 0.01 }
    }
}

/// Increases a downward force at a point of a body (world, metres) from zero until the point has sunk by
/// [`LoadRamp::sinks_m`]. Returns this force in newtons, or `None` if the largest force does not suffice or the body
/// cannot move. The force exceeds [`tipping_load_n`] by a newton or two, because it increases while the body sinks. It
/// takes a single simulation and is accurate enough for a ranking.
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
    let Some(load) = PointLoad::new(factory, scene, body, p_w) else { return Ok(None) };
    load.sinking_n(ramp.most_n / ramp.rate_n_per_s, ramp.sinks_m, |t| ramp.rate_n_per_s * t)
}

/// A vertical load on a point of a body.
struct PointLoad<'a> {
    factory: &'a dyn WorldFactory,
    scene: &'a Scene,
    body: BodyId,
    /// The loaded point, metres in the world.
    p_w: DVec3,
}

impl<'a> PointLoad<'a> {
    /// `None` for a body that cannot move.
    fn new(factory: &'a dyn WorldFactory, scene: &'a Scene, body: &str, p_w: DVec3) -> Option<Self> {
        let body = scene.body_index(body).filter(|&i| scene.bodies[i].kind == BodyKind::Dynamic)?;
        Some(Self { factory, scene, body, p_w })
    }

    /// Returns the force (newtons) at which the point has sunk by `sinks_m`; `None` if it does not sink by as much
    /// within `seconds`. `newtons_at` is the downward force as a function of time in seconds.
    fn sinking_n(
        &self,
        seconds: f64,
        sinks_m: f64,
        newtons_at: impl Fn(f64) -> f64,
    ) -> Result<Option<f64>, SimError> {
        let options = WorldOptions { sleep: false, contact_timing: false, ..WorldOptions::default() };
        let mut simulation = Simulation::new(self.factory, self.scene, &options)?;
        let com_b = self.scene.bodies[self.body].mass.map_or(DVec3::ZERO, |m| m.com());
        let p_b = simulation.state(self.body).x_wb.inverse() * self.p_w;
        let steps = (seconds / options.dt).round() as usize;
        for step in 0..steps {
            let now = simulation.state(self.body).x_wb;
            let load_n = newtons_at((step + 1) as f64 * options.dt);
            let force = DVec3::NEG_Z * load_n;
            simulation.apply_wrench(self.body, force, (now * p_b - now * com_b).cross(force));
            match simulation.advance(options.dt) {
                Ok(_) => {}
                // A structure that diverges under a load does not bear it.
                Err(SimError::Diverged { .. }) => return Ok(Some(load_n)),
                Err(e) => return Err(e),
            }
            if self.p_w.z - (simulation.state(self.body).x_wb * p_b).z > sinks_m {
                return Ok(Some(load_n));
            }
        }
        Ok(None)
    }
}
