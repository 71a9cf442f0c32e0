//! Places where the goals of the fixed billiards scenes may lie: `goals SHOTS PLACES [SCENES [FASTEST_M_S]]`.

use sms_core::{Cancel, NoProgress};
use sms_experiments::{GoalsBench, run_goals};
use sms_synth::FIXED_SCENES;
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, other: usize| args.get(i).map_or(Ok(other), |a| a.parse());
    let (shots, places) = (number(0, 600)?, number(1, 40)?);
    let wanted: Vec<usize> = match args.get(2) {
        None => (1..=FIXED_SCENES.len()).collect(),
        Some(list) => list.split(',').map(str::parse).collect::<Result<_, _>>()?,
    };
    let fastest_m_s = args.get(3).map_or(Ok(f64::INFINITY), |a| a.parse())?;
    let bench = GoalsBench {
        scenes: FIXED_SCENES.into_iter().filter(|s| wanted.contains(&s.number)).collect(),
        shots: shots as u64,
        fastest_m_s,
        distance_m: [0.24, 0.55],
        least_share: 0.006,
        best_m: 0.012,
        direct_m: 0.075,
        places,
    };
    println!("scene      x      y  away_m  share_%  best_cm (0, 1, more rebounds)  grid_cm");
    for p in run_goals(&bench, &NoProgress, &Cancel::new())? {
        let [none, one, more] = p.best_m.map(|m| 1e2 * m);
        println!(
            "{:5} {:6.3} {:6.3}  {:6.3}  {:7.2}  {none:6.1} {one:6.1} {more:6.1}  {:7.1}",
            p.scene,
            p.goal_w.x,
            p.goal_w.y,
            p.distance_m,
            1e2 * p.share,
            1e2 * p.grid_m,
        );
    }
    Ok(())
}
