//! The sweep under torque control in free space.

use glamx::DVec3;
use sms_robot::{FIST_HALF, RobotModel, StrikeConfig, Sweep, Workspace, floor, plan_sweep, simulate_sweep};

#[test]
fn scan() {
    let model = RobotModel::fr3();
    let mut ws = Workspace::default();
    let mut config = StrikeConfig::default();
    if let Ok(s) = std::env::var("STARTS") {
        config.ik.starts = s.parse().unwrap();
        config.candidates = s.parse::<usize>().unwrap() / 4;
    }
    for speed in [0.2, 0.4, 0.6, 0.85, 1.0, 1.25, 1.5] {
        let (mut ok, mut worst_v, mut worst_d, mut worst_o, mut worst_e) =
            (0, 0.0f64, 0.0f64, 0.0f64, 0.0f64);
        let mut why: std::collections::BTreeMap<String, usize> = Default::default();
        let mut lim = (0, 0, 0);
        let t0 = std::time::Instant::now();
        let mut total = 0;
        for x in [0.35, 0.45, 0.55, 0.65] {
            for y in [-0.2, 0.0, 0.2] {
                for angle in [-90f64, -45.0, -20.0, 0.0, 20.0, 45.0, 90.0] {
                    total += 1;
                    let sweep =
                        Sweep::of_ball(DVec3::new(x, y, 0.03), 0.03, angle.to_radians(), speed, FIST_HALF.x);
                    match plan_sweep(&model, &sweep, &[floor(0.0)], &config, &mut ws) {
                        Ok(plan) => {
                            ok += 1;
                            let t = simulate_sweep(&model, &plan, &config.osc, &model, 1.0, 0.00125);
                            worst_v = worst_v.max((t.contact_speed / speed - 1.0).abs());
                            worst_d = worst_d.max(t.direction_error_rad.to_degrees());
                            worst_o = worst_o.max(t.offset_m);
                            worst_e = worst_e.max(t.largest_error_m);
                            lim.0 += t.saturated_periods;
                            lim.1 += t.rate_limited_periods;
                            lim.2 += t.over_speed_periods;
                        }
                        Err(e) => {
                            let m = e.to_string();
                            let key: String = m.chars().filter(|c| !c.is_ascii_digit()).take(60).collect();
                            *why.entry(format!("{key}")).or_default() += 1;
                            if why.values().sum::<usize>() < 4 {
                                println!("  {x} {y} {angle}: {m}");
                            }
                        }
                    }
                }
            }
        }
        println!(
            "v {speed}: {ok}/{total}, speed {:.3} %, direction {:.3} deg, offset {:.2} mm, error {:.2} mm, limited {lim:?}, {:?}",
            100.0 * worst_v,
            worst_d,
            1e3 * worst_o,
            1e3 * worst_e,
            t0.elapsed()
        );
        for (k, n) in why {
            println!("   {n} {k}");
        }
    }
}
