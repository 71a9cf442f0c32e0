//! Output of landings.

use sms_cli::front::Console;
use sms_core::length_text;
use sms_landing::{LANDING_PLAN_FILE, LandingOutcome, LandingPlan};
use sms_target::{LANDING_EXECUTION_FILE, LandingExecution};
use std::path::Path;

pub(super) fn show_plan(console: &Console, plan: &LandingPlan, dir: &Path) {
    let a = &plan.action;
    let [x, y] = a.landing_w;
    console.say(format!("plan: land on {} at ({x:.3}, {y:.3}) m", plan.surface.body));
    console.say(format!(
        "  approach point {:.2} m from there, {:.0}° about z from x",
        a.approach_radius,
        a.approach_angle.to_degrees()
    ));
    let nominal = verdict(&plan.nominal);
    console.say(match &plan.predicted {
        Some(p) => format!(
            "  predicted: success in {:.0} % of {} worlds; in the scanned one: {nominal}",
            100.0 * p.success_share,
            p.worlds
        ),
        None => format!("  predicted in the scanned world: {nominal}"),
    });
    let e = plan.evaluations;
    console.say(format!(
        "  {} rollouts with jets, {} with particles, {} of them invalid",
        e.jet, e.sph, e.invalid
    ));
    let mission = if dir.join("mission.plan").is_file() { ", mission.plan" } else { "" };
    let file = dir.join(LANDING_PLAN_FILE);
    console.say(format!("  in {}; to fly: flight.json, setpoints.csv{mission}", file.display()));
}

pub(super) fn show_execution(console: &Console, execution: &LandingExecution, dir: &Path) {
    console.say(format!("execute: {}", execution.engine));
    console.say(format!("  realised: {}", verdict(&execution.outcome)));
    if let Some(second) = &execution.second_opinion {
        console.say(format!("  with wash by jets: {}", verdict(second)));
    }
    console.say(format!("  in {}", dir.join(LANDING_EXECUTION_FILE).display()));
}

fn verdict(outcome: &LandingOutcome) -> String {
    match &outcome.failure {
        None => format!("success, {} from the landing point", length_text(outcome.landing_error_m)),
        Some(failure) if outcome.is_toppled_by_wash() => format!("{failure}, by the wash alone"),
        Some(failure) => failure.to_string(),
    }
}
