//! `sms plan`: searches for the best action for a task.

use super::{landing, objective_reference};
use crate::cli;
use sms_cli::front::Console;
use sms_core::{Seed, counted, judge_success, length_text};
use sms_pipeline::{PlanRequest, PlannedTask, Run};
use sms_plan::Plan;

pub(crate) fn run(console: &Console, a: &cli::PlanArguments) -> anyhow::Result<()> {
    let request = PlanRequest {
        task: a.task.clone(),
        seed: a.seed.map(Seed),
        robust: a.robust,
        chooser: a.chooser.chooser(),
        draft: false,
    };
    let run = Run::new(&a.run, &console.context);
    show(console, &run.plan(&request)?);
    console.conclude(&run)
}

/// Prints a plan.
pub(crate) fn show(console: &Console, planned: &PlannedTask) {
    match planned {
        PlannedTask::Strike { plan, bodies, dir } => {
            let values = plan.parameters.iter().zip(&plan.action.0);
            let values: Vec<String> = values.map(|(p, v)| format!("{} {v:.4} {}", p.name, p.unit)).collect();
            console.say(format!("plan: {} → {}", bodies[0], bodies[1]));
            console.say(format!("  {}, by {}", values.join(", "), plan.striker));
            summary(plan).iter().for_each(|line| console.say(line));
            console.say(format!("  in {}", dir.join("plan.json").display()));
        }
        PlannedTask::Landing { plan, dir } => landing::show_plan(console, plan, dir),
    }
}

/// Returns lines with the prediction, the strategies, the reasons and the sensitivities.
fn summary(plan: &Plan) -> Vec<String> {
    let mut lines = Vec::new();
    let reference = objective_reference(&plan.task);
    match &plan.predicted {
        Some(p) => lines.push(format!(
            "  predicted {} {reference} on average (within {} in 90 % of worlds), {} in the scanned world; success in {:.0} % of \
             {} worlds: {}",
            length_text(p.mean),
            length_text(p.q90),
            length_text(plan.objective),
            100.0 * p.success_share,
            p.worlds,
            judge_success(p.success_share).grade
        )),
        None => {
            let failure = plan.strategies.first().and_then(|s| s.failure_text());
            let elsewhere = failure.map_or_else(
                || "not tested in perturbed ones".to_owned(),
                |text| format!("the plan {text}"),
            );
            lines.push(format!(
                "  predicted {} {reference} in the scanned world; {elsewhere}",
                length_text(plan.objective)
            ));
        }
    }
    let width = plan.strategies.iter().map(|s| s.name.chars().count()).max().unwrap_or(0).max(10);
    let columns = ["scanned", "mean", "10 %", "50 %", "90 %", "success"].map(|c| format!("{c:>9}")).concat();
    lines.push(format!("  {:<width$}  {columns}", "strategies"));
    for s in &plan.strategies {
        let mut line = format!("    {:<width$}{:>9}", s.name, length_text(s.objective));
        if let Some(p) = &s.prediction {
            for v in [p.mean, p.q10, p.q50, p.q90] {
                line.push_str(&format!("{:>9}", length_text(v)));
            }
            line.push_str(&format!("{:>7.0} %", 100.0 * p.success_share));
            if let Some(missing) = p.missing_text() {
                line.push_str(&format!("  ({missing})"));
            }
        } else if let Some(text) = s.failure_text() {
            line.push_str(&format!("  {text}"));
        }
        lines.push(line);
    }
    for (i, reason) in plan.reasons.iter().enumerate() {
        lines.push(format!("  {} {}", if i == 0 { "why:" } else { "    " }, reason.text));
    }
    let sensitive: Vec<String> = plan
        .sensitivities
        .iter()
        .filter(|s| s.share >= 0.05)
        .take(4)
        .map(|s| format!("{s} ({:.0} %, {})", 100.0 * s.share, length_text(s.change)))
        .collect();
    if !sensitive.is_empty() {
        lines.push(format!("  largest sensitivities: {}", sensitive.join(", ")));
    }
    let invalid =
        if plan.invalid > 0 { format!(", {} of them invalid", plan.invalid) } else { String::new() };
    // More than half are a warning, which was printed.
    let refused = plan.refused_text().filter(|_| !plan.is_mostly_refused());
    lines.extend(refused.map(|text| format!("  {text}")));
    lines.push(format!("  {}{invalid}", counted(plan.evaluations, "rollout", "rollouts")));
    lines.extend(plan.failure_text().map(|text| format!("    invalid: {text}")));
    lines
}
