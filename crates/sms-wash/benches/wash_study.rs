//! Computes the force of a hovering quadrotor on a plate with all models, the width of the free jet, and the cost, for
//! given settings of the particle model: the figures of experiments/studies/wash.md.
//!
//! `cargo bench -p sms-wash --bench wash_study -- key=value …` takes settings of `SphSettings` as in TOML,
//! and `half` (half edge of the plate, metres), `height` (of the propellers above it), `offset` (of the vehicle along
//! x), `propellers`, `seconds`.

use glamx::{DPose3, DQuat, DVec3};
use sms_robots::Rotor;
use sms_wash::{
    BodyState, BodySurface, SphSettings, SphWash, StreamSettings, StreamWash, VehicleState, Wash, Wrench,
};
use std::error::Error;
use std::time::Instant;

const WEIGHT: f64 = 1.182 * 9.81;

fn main() -> Result<(), Box<dyn Error>> {
    let mut table = toml::Table::try_from(SphSettings::default())?;
    let (mut half, mut height, mut offset, mut seconds, mut propellers) = (0.2, 0.35, 0.0, 1.0, 4usize);
    for argument in std::env::args().skip(1).filter(|a| a != "--bench") {
        let (key, value) = argument.split_once('=').ok_or("arguments are key=value")?;
        match key {
            "half" => half = value.parse()?,
            "height" => height = value.parse()?,
            "offset" => offset = value.parse()?,
            "propellers" => propellers = value.parse()?,
            "seconds" => seconds = value.parse()?,
            _ => {
                let one: toml::Table =
                    toml::from_str(&argument).or_else(|_| toml::from_str(&format!("{key} = \"{value}\"")))?;
                table.extend(one);
            }
        }
    }
    let settings: SphSettings = table.try_into()?;
    let plate = vec![BodySurface::cuboid(DVec3::new(half, half, 0.005))?];
    let mut wash = SphWash::new(plate.clone(), settings)?;
    let rotors = [(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)]
        .map(|(x, y)| Rotor { p_v: DVec3::new(x, y, 0.0), radius: 0.0685 });
    // With fewer propellers, the total thrust is smaller; the thrust of each stays the same.
    let thrusts: [f64; 4] = std::array::from_fn(|i| if i < propellers { 0.25 * WEIGHT } else { 0.0 });
    let carried: f64 = thrusts.iter().sum();
    let vehicle = VehicleState {
        x_wv: DPose3::from_parts(DVec3::new(offset, 0.0, height), DQuat::IDENTITY),
        v_w: DVec3::ZERO,
        rotors: &rotors,
        thrusts: &thrusts,
    };
    let body = [BodyState::at_rest(DPose3::IDENTITY)];
    let mut wrench = [Wrench::default()];
    for mut wash in [
        StreamWash::disk(plate.clone(), StreamSettings::default())?,
        StreamWash::jet(plate, StreamSettings::default())?,
    ] {
        wash.step(0.0025, &vehicle, &body, &mut wrench);
        println!(
            "{}: force {:.4} of the thrust, centre of pressure {:.4} m",
            wash.name(),
            -wrench[0].force_w.z / carried,
            -wrench[0].torque_w.y / wrench[0].force_w.z,
        );
    }
    let dt = 0.0025;
    let (warm, steps) = ((0.2 / dt) as usize, (seconds / dt) as usize);
    let (mut forces, mut torque, mut particles, mut fastest, mut rising) = (Vec::new(), 0.0, 0, 0f32, 0.0);
    let began = Instant::now();
    for k in 0..warm + steps {
        wash.step(dt, &vehicle, &body, &mut wrench);
        if k >= warm {
            forces.push(-wrench[0].force_w.z / carried);
            torque += wrench[0].torque_w.y / carried / steps as f64;
            particles += wash.particles().count();
            for (_, v) in wash.particles() {
                fastest = fastest.max(v.iter().map(|c| c * c).sum::<f32>().sqrt());
                rising += f64::from(v[2].max(0.0)) / wash.particles().count() as f64 / steps as f64;
            }
        }
    }
    let wall = began.elapsed().as_secs_f64();
    let mean = forces.iter().sum::<f64>() / forces.len() as f64;
    let deviation = (forces.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / forces.len() as f64).sqrt();
    // Statistics of the particles that still fall freely.
    let (mut count, mut square) = (0.0, 0.0);
    let falls =
        |x: &[f32; 3], v: &[f32; 3]| (0.3 * height..0.4 * height).contains(&f64::from(x[2])) && v[2] < -14.0;
    for (x, _) in wash.particles().filter(|(x, v)| falls(x, v)) {
        count += 1.0;
        let across = |c: f64| (c.abs() - 0.1).powi(2);
        square += across(f64::from(x[0]) - offset) + across(f64::from(x[1]));
    }
    println!(
        "spacing {:.4}: force {mean:.4} ± {deviation:.3} of the thrust, centre of pressure {:.4} m, \
         jet radius {:.4} m, {} particles, fastest {fastest:.1} m/s, rising {rising:.2} m/s, {:.2} ms wall a 2.5 ms step",
        settings.spacing,
        torque / mean,
        (2.0 * square / f64::max(count, 1.0)).sqrt(),
        particles / steps.max(1),
        1e3 * wall / (warm + steps) as f64,
    );
    Ok(())
}
