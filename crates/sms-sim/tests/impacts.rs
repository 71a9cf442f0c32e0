//! Impacts of balls against closed forms, in both precisions. Run with `--nocapture` for the figures.

mod common;

use common::*;
use glamx::{DPose3, DQuat, DVec3};
use sms_scene::{Body, BodyKind};
use sms_sim::{WorldFactory, WorldOptions};

const CUTS_DEG: [f64; 4] = [15.0, 30.0, 45.0, 60.0];
const SPEEDS: [f64; 4] = [0.2, 0.4, 0.8, 1.6];
/// Impacts begin at this many phases of a step.
const PHASES: usize = 12;

/// Direction error (radians, to the left) and relative speed error of a target ball struck at a cut in free space.
fn oblique(
    factory: &dyn WorldFactory,
    options: &WorldOptions,
    (mu, e): (f64, f64),
    cut: f64,
    speed: f64,
    phase: f64,
) -> (f64, f64) {
    let gap = 0.02 + speed * DT * phase;
    let at_impact = DVec3::new(-2.0 * R * cut.cos(), 2.0 * R * cut.sin(), 0.0);
    let cue = ball("cue", at_impact - DVec3::new(gap, 0.0, 0.0), material(mu, e, 0.0));
    let target = ball("target", DVec3::ZERO, material(mu, e, 0.0));
    let mut simulation = simulate(factory, &scene(0.0, vec![cue, target]), options);
    launch(&mut simulation, 0, DVec3::new(speed, 0.0, 0.0), DVec3::ZERO);
    run(&mut simulation, gap / speed + 0.1);
    // Impulses over mass: normal, and tangential either sliding or sticking (two equal solid spheres).
    let normal = 0.5 * (1.0 + e) * speed * cut.cos();
    let tangential = (mu * normal).min(speed * cut.sin() / 7.0);
    let expected = -cut + (tangential / normal).atan();
    let v = simulation.state(1).v_w;
    (v.y.atan2(v.x) - expected, v.length() / normal.hypot(tangential) - 1.0)
}

fn oblique_errors(factory: &dyn WorldFactory, options: &WorldOptions, surface: (f64, f64)) -> (f64, f64) {
    let (mut direction, mut speed) = (Vec::new(), Vec::new());
    for cut in CUTS_DEG {
        for v in SPEEDS {
            for k in 0..PHASES {
                let phase = k as f64 / PHASES as f64;
                let (d, s) = oblique(factory, options, surface, cut.to_radians(), v, phase);
                direction.push(d.to_degrees());
                speed.push(s);
            }
        }
    }
    (worst(&direction), worst(&speed))
}

#[test]
fn a_frictionless_oblique_shot_goes_along_the_line_of_centres() {
    for factory in factories() {
        for e in [0.5, 0.95] {
            let (direction, speed) = oblique_errors(factory, &awake(), (0.0, e));
            println!("{}: frictionless, e {e}: {direction:.4}°, speed {speed:.5}", factory.engine());
            assert!(direction < 0.02, "{}: {direction}°", factory.engine());
            assert!(speed < 2e-3, "{}: {speed}", factory.engine());
        }
    }
}

#[test]
fn friction_throws_the_target_ball_as_the_closed_form_says() {
    for factory in factories() {
        for surface in [(0.05, 0.95), (0.1, 0.95), (0.1, 0.5), (0.4, 0.9)] {
            let (direction, speed) = oblique_errors(factory, &awake(), surface);
            println!("{}: (µ, e) {surface:?}: {direction:.4}°, speed {speed:.5}", factory.engine());
            assert!(direction < 0.1, "{}: {surface:?} {direction}°", factory.engine());
            assert!(speed < 5e-3, "{}: {surface:?} {speed}", factory.engine());
        }
    }
}

/// Without splitting the same shots are off by degrees: what contact timing is for.
#[test]
fn without_contact_timing_oblique_shots_are_bent() {
    let options = WorldOptions { contact_timing: false, ..awake() };
    for factory in factories() {
        let (direction, _) = oblique_errors(factory, &options, (0.0, 0.95));
        println!("{}: frictionless without timing: {direction:.3}°", factory.engine());
        assert!(direction > 1.0, "{}: {direction}°", factory.engine());
    }
}

#[test]
fn equal_masses_exchange_their_speed_head_on() {
    for factory in factories() {
        for e in [0.5, 0.95] {
            for speed in [0.05, 0.2, 0.8] {
                let mut errors = Vec::new();
                let mut momentum = Vec::new();
                for k in 0..PHASES {
                    let gap = 0.01 + speed * DT * k as f64 / PHASES as f64;
                    let balls = vec![
                        ball("a", DVec3::ZERO, material(0.1, e, 0.0)),
                        ball("b", DVec3::new(2.0 * R + gap, 0.0, 0.0), material(0.1, e, 0.0)),
                    ];
                    let mut simulation = simulate(factory, &scene(0.0, balls), &awake());
                    launch(&mut simulation, 0, DVec3::new(speed, 0.0, 0.0), DVec3::ZERO);
                    run(&mut simulation, gap / speed + 0.05);
                    let (a, b) = (simulation.state(0).v_w.x, simulation.state(1).v_w.x);
                    errors.push((b - a) / speed - e);
                    momentum.push((a + b) / speed - 1.0);
                }
                println!("{}: e {e} v {speed}: {:.5}", factory.engine(), worst(&errors));
                assert!(worst(&errors) < 2e-3, "{} e {e} v {speed}: {errors:?}", factory.engine());
                assert!(worst(&momentum) < 1e-5, "{}: momentum {momentum:?}", factory.engine());
            }
        }
    }
}

#[test]
fn a_dropped_ball_bounces_to_e_squared() {
    for factory in factories() {
        for e in [0.5, 0.8, 0.95] {
            let mut errors = Vec::new();
            for k in 0..PHASES {
                let height = 0.03 + 0.1 * k as f64 / PHASES as f64;
                let bodies = vec![
                    floor(material(0.3, e, 0.0)),
                    ball("b", DVec3::new(0.0, 0.0, R + height), material(0.3, e, 0.0)),
                ];
                let mut simulation = simulate(factory, &scene(G, bodies), &awake());
                let (mut top, mut has_bounced) = (0.0f64, false);
                for _ in 0..400 {
                    simulation.advance(DT).unwrap();
                    let state = simulation.state(1);
                    has_bounced |= state.v_w.z > 0.0;
                    if has_bounced {
                        top = top.max(state.x_wb.translation.z - R);
                        if state.v_w.z < 0.0 {
                            break;
                        }
                    }
                }
                errors.push((top / height).sqrt() / e - 1.0);
            }
            println!("{}: drop e {e}: worst {:.4}", factory.engine(), worst(&errors));
            // Rapier's integrator takes half a substep of velocity (0.3 ms) off the height of a bounce.
            assert!(worst(&errors) < 0.015, "{} e {e}: {errors:?}", factory.engine());
        }
    }
}

#[test]
fn a_wall_at_45_degrees_turns_the_normal_velocity_alone() {
    let turn = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_4);
    let half = DVec3::new(0.2, 0.3, 0.1);
    let x_wb = DPose3::from_parts(turn * DVec3::new(0.2 + R, 0.0, 0.0), turn);
    let walls: [Body; 2] = [
        cuboid("hull", x_wb, half, BodyKind::Static, material(0.0, 0.8, 0.0)),
        mesh_box("mesh", x_wb, half, material(0.0, 0.8, 0.0)),
    ];
    for factory in factories() {
        for wall in &walls {
            let mut errors = Vec::new();
            for speed in SPEEDS {
                for k in 0..PHASES {
                    let gap = 0.02 + speed * DT * k as f64 / PHASES as f64;
                    let start = DVec3::new(-gap, 0.0, 0.0);
                    let bodies = vec![wall.clone(), ball("b", start, material(0.0, 0.8, 0.0))];
                    let mut simulation = simulate(factory, &scene(0.0, bodies), &awake());
                    launch(&mut simulation, 1, DVec3::new(speed, 0.0, 0.0), DVec3::ZERO);
                    run(&mut simulation, gap / speed + 0.05);
                    let v = turn.inverse() * simulation.state(1).v_w / speed;
                    let expected = DVec3::new(-0.8, -1.0, 0.0) * std::f64::consts::FRAC_1_SQRT_2;
                    errors.push((v - expected).length());
                }
            }
            println!("{}: {} at 45°: {:.5}", factory.engine(), wall.name, worst(&errors));
            assert!(worst(&errors) < 2e-3, "{} {}: {errors:?}", factory.engine(), wall.name);
        }
    }
}

/// On the table: a rolling cue ball, cut 45°. The target leaves along the line of centres and ends rolling at 5/7 of
/// its first speed; the cue ball's spin carries it forward.
#[test]
fn a_rolling_ball_follows_through_after_an_oblique_impact() {
    let (e, speed, cut) = (0.95, 0.8, 45f64.to_radians());
    for factory in factories() {
        let (mut target_errors, mut cue_errors) = (Vec::new(), Vec::new());
        for k in 0..PHASES {
            let gap = 0.05 + speed * DT * k as f64 / PHASES as f64;
            let at_impact = DVec3::new(-2.0 * R * cut.cos(), 2.0 * R * cut.sin(), R);
            // Frictionless balls on a rough cloth: the mean of both surfaces acts between cloth and ball, which
            // leaves 0 between the balls.
            let bodies = vec![
                floor(material(0.6, 0.0, 0.0)),
                ball("cue", at_impact - DVec3::new(gap, 0.0, 0.0), material(0.0, e, 0.0)),
                ball("target", DVec3::new(0.0, 0.0, R), material(0.0, e, 0.0)),
            ];
            let mut simulation = simulate(factory, &scene(G, bodies), &awake());
            launch(&mut simulation, 1, DVec3::new(speed, 0.0, 0.0), DVec3::new(0.0, speed / R, 0.0));
            run(&mut simulation, gap / speed + 0.5);
            let impulse = 0.5 * (1.0 + e) * speed * cut.cos();
            let line = DVec3::new(cut.cos(), -cut.sin(), 0.0);
            let target = 5.0 / 7.0 * impulse * line;
            let cue = 5.0 / 7.0 * (DVec3::new(speed, 0.0, 0.0) - impulse * line)
                + 2.0 / 7.0 * DVec3::new(speed, 0.0, 0.0);
            let flat = |b| DVec3 { z: 0.0, ..simulation.state(b).v_w };
            target_errors.push(flat(2).angle_between(target).to_degrees());
            cue_errors.push(flat(1).angle_between(cue).to_degrees());
            assert!((flat(2).length() / target.length() - 1.0).abs() < 0.01, "{}", factory.engine());
        }
        let (t, c) = (worst(&target_errors), worst(&cue_errors));
        println!("{}: on the table: target {t:.3}°, cue {c:.3}°", factory.engine());
        assert!(t < 0.1 && c < 1.0, "{}: {t}° {c}°", factory.engine());
    }
}
