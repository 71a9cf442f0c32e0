//! `sms execute`: executes the plan in the target world.

use super::{landing, objective_reference};
use crate::cli::{ArmName, ExecuteArguments};
use sms_cli::front::{Console, EngineName};
use sms_core::lengths_text;
use sms_pipeline::{ExecuteOutcome, ExecuteRequest, Run};
use sms_sim::ArmKind;

pub(crate) fn run(console: &Console, a: &ExecuteArguments) -> anyhow::Result<()> {
    let arm = match a.arm {
        ArmName::Shared => ArmKind::Shared,
        ArmName::Articulation => ArmKind::Articulation,
    };
    let run = Run::new(&a.run, &console.context);
    let outcome = run.execute(&ExecuteRequest { engine: a.engine.map(EngineName::engine), arm })?;
    show(console, &outcome);
    console.conclude(&run)
}

/// Prints an execution.
pub(crate) fn show(console: &Console, outcome: &ExecuteOutcome) {
    let (plan, e, dir) = match outcome {
        ExecuteOutcome::Landing { execution, dir } => {
            return landing::show_execution(console, execution, dir);
        }
        ExecuteOutcome::Strike { plan, execution, dir } => (plan, execution, dir),
    };
    console.say(format!("execute: {}", e.engine));
    let (mean, q90, nominal) =
        e.predicted.as_ref().map_or((0.0, 0.0, plan.objective), |p| (p.mean, p.q90, p.nominal));
    let [realised, mean, q90, nominal] = lengths_text([e.objective, mean, q90, nominal]);
    console.say(format!(
        "  realised {realised} {}; {}",
        objective_reference(&plan.task),
        if e.success { "success" } else { "missed" }
    ));
    console.say(match &e.predicted {
        Some(p) => format!(
            "  predicted {mean} on average, within {q90} in 90 % of worlds, {nominal} in the scanned one; {}",
            p.rank_text()
        ),
        None => format!("  predicted {nominal} in the scanned world"),
    });
    console.say(format!("  in {}", dir.join("execution.json").display()));
}
