//! `sms evaluate`: compares the reconstruction with the recorded depth, and with known models or the ground truth of a generated
//! recording.

use crate::cli::EvaluateArguments;
use sms_cli::front::Console;
use sms_core::{judge_depth_agreement, judge_surface_error, length_text};
use sms_pipeline::stages::Comparison;
use sms_pipeline::{RecordedAgreement, Run};

pub(crate) fn run(console: &Console, a: &EvaluateArguments) -> anyhow::Result<()> {
    let run = Run::new(&a.run, &console.context);
    let outcome = run.evaluate(a.objects.as_deref())?;
    say_agreement(console, &outcome.agreement);
    for c in &outcome.comparisons {
        let if_fixed = |mark| if c.is_fixed { mark } else { "" };
        console.say(match (outcome.is_truth, c.sphere) {
            (true, Some((center, radius))) => format!(
                "{:>12}{} is {}: {}; errors of the centre {}, of the radius {}",
                c.entity,
                if_fixed(" (fixed)"),
                c.description,
                judge_surface_error(center + radius),
                length_text(center),
                length_text(radius)
            ),
            (true, None) => {
                format!("{:>12}{} is {}: {}", c.entity, if_fixed(" (fixed)"), c.description, words(c))
            }
            (false, _) => format!("{} ({}{}): {}", c.known, c.entity, if_fixed(", fixed"), words(c)),
        });
    }
    if let Some((moved, turned, seconds)) = outcome.drift {
        console.say(format!(
            "at rest for {seconds} s, bodies move at most {} and turn at most {:.2}°",
            length_text(moved),
            turned.to_degrees()
        ));
    }
    console.conclude(&run)
}

/// Prints the agreement of the scene with the recorded depth, that in held-out frames first.
pub(super) fn say_agreement(console: &Console, agreement: &RecordedAgreement) {
    let held_out = ("held-out frames", agreement.held_out);
    for (frames, found) in [held_out, ("all frames", agreement.all)] {
        let Some([agrees, false_surface, hole]) = found.shares() else { continue };
        console.say(format!(
            "recorded depth, {frames}: {:.1} % of the measured pixels lie on the scene's surfaces (within 5 mm + 1 % of the depth), {:.1} % behind a false surface, {:.1} % in a hole: {}",
            1e2 * agrees,
            1e2 * false_surface,
            1e2 * hole,
            judge_depth_agreement(agrees, false_surface)
        ));
    }
}

/// Formats the scores.
fn words(c: &Comparison) -> String {
    let scores = &c.scores;
    let mut text = format!(
        "{}; median error {}, completion {}, F1 {:.3} at 2.5 mm",
        judge_surface_error(scores.accuracy_p90_m),
        length_text(scores.accuracy_median_m),
        length_text(scores.completion_median_m),
        scores.f1_2p5mm
    );
    if let Some(s) = &c.solid {
        text += &format!(
            "; volume × {:.2}, errors of the mass centre {}, of the inertia {:.1} %",
            s.volume_ratio,
            length_text(s.mass_center_error_m),
            100.0 * s.inertia_error
        );
    }
    text
}
