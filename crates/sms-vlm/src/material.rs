//! Questions about the materials of objects.

use crate::answer::{Fault, read_reply};
use crate::ask::{Answers, Outcome, Question, STAGE, Topic, ask_all};
use crate::cache::Cache;
use crate::client::Client;
use crate::dialect::ReplyForm;
use crate::prompt::{NUMBER_RULES, SYSTEM, form, question};
use sms_core::{CoreError, StageContext, Warnings};
use sms_materials::Estimate;

/// Asks about the material of every object, or takes the reply from the cache. Every question ends with validated values
/// or with a fallback reported in the warnings.
///
/// # Errors
/// [`CoreError::Interrupted`]; [`CoreError::Write`] if the cache cannot be written.
pub fn ask(
    questions: &[Question],
    client: &Client,
    cache: &Cache,
    context: StageContext<'_>,
) -> Result<Answers, CoreError> {
    ask_all::<MaterialTopic>(questions, client, cache, context)
}

struct MaterialTopic;

impl Topic for MaterialTopic {
    type Answer = Estimate;
    const SYSTEM: &'static str = SYSTEM;
    const RULES: &'static str = NUMBER_RULES;
    const SUBSTITUTE: &'static str = "the table or a prior is used";

    fn text(q: &Question) -> String {
        question(&q.annotation, q.is_surface)
    }

    fn form() -> ReplyForm {
        form()
    }

    fn read(reply: &str) -> Result<(Option<Estimate>, Vec<Fault>), String> {
        let reading = read_reply(reply)?;
        let is_usable = reading.is_usable();
        Ok((is_usable.then_some(reading.estimate), reading.faults))
    }

    fn warn(q: &Question, outcome: &Outcome, warnings: &Warnings) {
        match outcome {
            Outcome::Fallback(what) => warnings.add(
                STAGE,
                "vlm_fallback",
                format!("the model gave no estimate for {}: {what}; {}", q.name, Self::SUBSTITUTE),
                "run the command again, or set its values with `sms materials RUN --set`",
            ),
            Outcome::Answered { faults, .. } if !faults.is_empty() => {
                let list: Vec<String> = faults.iter().map(ToString::to_string).collect();
                warnings.add(
                    STAGE,
                    "vlm_partial",
                    format!("a part of the model's estimate for {} was unusable ({})", q.name, list.join("; ")),
                    "the table or a prior is used for that part; set better values with `sms materials RUN --set`",
                );
            }
            Outcome::Answered { .. } => {}
        }
    }
}
