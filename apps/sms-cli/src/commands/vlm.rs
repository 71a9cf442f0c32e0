//! Asks a vision-language model about the objects of a scene, as `sms materialize` does.

use crate::cli::VlmMode;
use sms_cli::front::Console;
use sms_core::metrics::Metrics;
use sms_core::{InputError, Labels, RunFolder, Seed, Warnings};
use sms_entities::EntitySet;
use sms_frames::Sequence;
use sms_materials::{Estimate, ObjectQuery};
use sms_vlm::{ApiKey, Asked, Cache, Client, VlmConfig, ask, question_about};
use std::time::Instant;

/// Folder of the stored replies in a run. It is no stage: replies stay when the scene is made again.
pub(crate) const REPLIES: &str = "vlm";

/// What the model says of each of `queries` (the entities of `set`, then the floor); `None` for those that it was not asked
/// about or did not answer.
pub(crate) fn estimates(
    console: &Console,
    run: &RunFolder,
    mode: VlmMode,
    set: &EntitySet,
    queries: &[ObjectQuery],
    sequence: &Sequence,
    labels: &Labels,
    seed: Seed,
) -> anyhow::Result<Vec<Option<Estimate>>> {
    let mut estimates = vec![None; queries.len()];
    let mut config = console.context.settings.section("vlm", sms_cli::settings::vlm_defaults())?;
    let is_wanted = match mode {
        VlmMode::Off => false,
        VlmMode::Auto => !config.url.trim().is_empty(),
        VlmMode::On | VlmMode::CacheOnly => true,
    };
    let warnings = Warnings::new();
    if !is_wanted {
        // What an earlier run of the command said of the model is no longer so.
        console.finish(run, "vlm", &["vlm."], Metrics::new(), &warnings)?;
        return Ok(estimates);
    }
    config.cache_only |= mode == VlmMode::CacheOnly;
    run.record_settings("vlm", &config)?;
    let began = Instant::now();
    let key = ApiKey::new(&std::env::var("OPENAI_API_KEY").unwrap_or_default())?;
    let client = Client::new(&config, key, seed.derive("vlm"))?;

    let mut asked_about = Vec::new();
    let mut questions = Vec::new();
    for (i, query) in queries.iter().enumerate() {
        let entity = set.entities.get(i);
        match question_about(query, entity, set.support_height, sequence, labels, &config) {
            Some(question) => {
                asked_about.push(i);
                questions.push(question);
            }
            // Nobody asked for the environment's own material where no camera shows it.
            None => warnings.add(
                "vlm",
                "vlm_not_seen",
                format!(
                    "no view shows enough of {} to ask about it; the table or a prior stands in",
                    query.name
                ),
                "set its values with `sms materials RUN --set`",
            ),
        }
    }
    let cache = Cache::new(&run.root().join(REPLIES));
    let asked = ask(
        &questions,
        &client,
        &cache,
        console.context.progress.as_ref(),
        &console.context.cancel,
        &warnings,
    )?;
    let mut metrics = Metrics::new();
    count(&asked, queries.len(), &config, &mut metrics);
    metrics.set("vlm.seconds", began.elapsed().as_secs_f64());
    console.finish(run, "vlm", &["vlm."], metrics, &warnings)?;
    console.say(summary(&asked, queries.len(), &config));
    if let (VlmMode::On, Some(given_up)) = (mode, &asked.given_up) {
        return Err(InputError::new(given_up.what.clone(), config.url, given_up.cure.clone()).into());
    }
    let is_silent = !questions.is_empty() && asked.outcomes.iter().all(|o| o.estimate().is_none());
    if mode == VlmMode::On && is_silent {
        return Err(InputError::new(
            "not one object could be answered by the vision-language model",
            config.url,
            "see the warnings above; or use --vlm auto, and the table or a prior stands in",
        )
        .into());
    }
    for (i, outcome) in asked_about.into_iter().zip(&asked.outcomes) {
        estimates[i] = outcome.estimate().cloned();
    }
    Ok(estimates)
}

fn count(asked: &Asked, objects: usize, config: &VlmConfig, metrics: &mut Metrics) {
    let usage = asked.usage;
    metrics
        .set("vlm.objects", objects)
        .set("vlm.answered", asked.answered())
        .set("vlm.cached", asked.cached());
    metrics.set("vlm.fallbacks", objects - asked.answered());
    metrics.set("vlm.requests", usage.requests);
    metrics
        .set("vlm.prompt_tokens", usage.prompt_tokens)
        .set("vlm.completion_tokens", usage.completion_tokens);
    if let Some(cost) = config.cost(usage.prompt_tokens, usage.completion_tokens) {
        metrics.set("vlm.cost", cost);
    }
}

fn summary(asked: &Asked, objects: usize, config: &VlmConfig) -> String {
    let usage = asked.usage;
    if usage.requests == 0 {
        let all = asked.cached();
        return format!(
            "{:>16}: {all} of {objects} answered by {}, all stored before; no requests",
            "vlm", config.model
        );
    }
    let cost = match config.cost(usage.prompt_tokens, usage.completion_tokens) {
        Some(cost) => format!("cost {cost:.4}"),
        None => {
            "cost unknown (set vlm.price_prompt_per_million and vlm.price_completion_per_million)".to_owned()
        }
    };
    format!(
        "{:>16}: {} of {objects} answered by {}, {} of these stored before; {} requests, {} + {} tokens, {cost}",
        "vlm",
        asked.answered(),
        config.model,
        asked.cached(),
        usage.requests,
        usage.prompt_tokens,
        usage.completion_tokens,
    )
}
