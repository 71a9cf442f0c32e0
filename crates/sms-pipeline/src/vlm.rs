//! Material estimates of a vision-language model, and its client.

use crate::cache::record;
use crate::settings::vlm_defaults;
use crate::{Context, Error};
use sms_core::metrics::Metrics;
use sms_core::{InputError, Labels, RunFolder, Seed, StageContext, Warnings};
use sms_entities::EntitySet;
use sms_frames::Sequence;
use sms_materials::{Estimate, ObjectQuery};
use sms_vlm::{Answers, ApiKey, Cache, Client, GivenUp, VlmConfig, ask, question_about};
use std::time::Instant;

/// Folder of the stored replies in a run. It is not a stage: replies stay when the scene is rebuilt.
pub(crate) const REPLIES: &str = "vlm";

/// Use of a vision-language model for materials.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum VlmMode {
    /// Use no model.
    Off,
    /// Use a model if a server is configured; continue without estimates if it does not answer.
    #[default]
    Auto,
    /// Use a model; fail if the server cannot be used.
    On,
    /// Use stored replies of earlier runs and make no requests.
    CacheOnly,
}

/// Estimates for queries, and the replies behind them.
#[derive(Debug)]
pub struct Estimates {
    /// One estimate per query; `None` if the model was not asked or did not answer.
    pub estimates: Vec<Option<Estimate>>,
    /// The replies in detail.
    pub answers: Answers,
}

/// Asks a model about each of `queries` (the entities of `set`, then the floor). `labels` has the entities' labels.
///
/// # Errors
/// [`Error::Core`] if interrupted, or if a reply cannot be stored.
pub fn estimates(
    set: &EntitySet,
    queries: &[ObjectQuery],
    (sequence, labels): (&Sequence, &Labels),
    client: &Client,
    cache: &Cache,
    context: StageContext<'_>,
) -> Result<Estimates, Error> {
    let mut indices = Vec::new();
    let mut questions = Vec::new();
    for (i, query) in queries.iter().enumerate() {
        let entity = set.entities.get(i);
        match question_about(query, entity, set.support_height, sequence, labels, client.config()) {
            Some(question) => {
                indices.push(i);
                questions.push(question);
            }
            None => context.warnings.add(
                "vlm",
                "vlm_not_seen",
                format!(
                    "no view shows enough of {} to ask about it; the table or a prior is used",
                    query.name
                ),
                "set its values with `sms materials RUN --set`",
            ),
        }
    }
    let answers = ask(&questions, client, cache, context)?;
    let mut estimates = vec![None; queries.len()];
    for (i, outcome) in indices.into_iter().zip(&answers.outcomes) {
        estimates[i] = outcome.answer().cloned();
    }
    Ok(Estimates { estimates, answers })
}

/// Calls [`estimates`] with the stored replies of the run.
pub(crate) fn cached_estimates(
    context: &Context,
    run: &RunFolder,
    mode: VlmMode,
    (set, queries): (&EntitySet, &[ObjectQuery]),
    views: (&Sequence, &Labels),
    seed: Seed,
) -> Result<Vec<Option<Estimate>>, Error> {
    let mut config = context.settings.section("vlm", vlm_defaults())?;
    let is_wanted = match mode {
        VlmMode::Off => false,
        VlmMode::Auto => !config.url.trim().is_empty(),
        VlmMode::On | VlmMode::CacheOnly => true,
    };
    let warnings = Warnings::new();
    if !is_wanted {
        // Removes the metrics of an earlier run of the command.
        record(context, run, "vlm", &["vlm."], Metrics::new(), &warnings)?;
        return Ok(vec![None; queries.len()]);
    }
    config.cache_only |= mode == VlmMode::CacheOnly;
    run.record_settings("vlm", &config)?;
    let began = Instant::now();
    let client = client(&config, seed.derive("vlm"))?;
    let cache = Cache::new(&run.root().join(REPLIES));
    let found = estimates(set, queries, views, &client, &cache, context.stage(&warnings, seed))?;
    let answers = &found.answers;
    if mode == VlmMode::On {
        // Before the warnings, which say that other values are used instead.
        refuse_given_up(answers, &config)?;
    }
    let mut metrics = metrics(answers, queries.len(), &config);
    metrics.set("vlm.seconds", began.elapsed().as_secs_f64());
    record(context, run, "vlm", &["vlm."], metrics, &warnings)?;
    context.message(summary(answers, queries.len(), &config));
    let is_unanswered = !answers.outcomes.is_empty() && answers.outcomes.iter().all(|o| o.answer().is_none());
    if mode == VlmMode::On && is_unanswered {
        let what = "the vision-language model answered about none of the objects";
        let cure = "see the warnings above; or use --vlm auto, which falls back to the table or a prior";
        return Err(InputError::new(what, config.url, cure).into());
    }
    Ok(found.estimates)
}

/// Refuses answers of a server that cannot be used.
pub(crate) fn refuse_given_up<A>(answers: &Answers<A>, config: &VlmConfig) -> Result<(), InputError> {
    match &answers.given_up {
        Some(GivenUp { what, cure }) => Err(InputError::new(what.clone(), &config.url, cure.clone())),
        None => Ok(()),
    }
}

/// Returns a client with the API key of the environment.
pub(crate) fn client(config: &VlmConfig, seed: Seed) -> Result<Client, InputError> {
    let key = ApiKey::new(&std::env::var("OPENAI_API_KEY").unwrap_or_default())?;
    Client::new(config, key, seed)
}

fn metrics(answers: &Answers, objects: usize, config: &VlmConfig) -> Metrics {
    let usage = answers.usage;
    let mut metrics = Metrics::new();
    metrics
        .set("vlm.objects", objects)
        .set("vlm.answered", answers.answered())
        .set("vlm.cached", answers.cached())
        .set("vlm.fallbacks", objects - answers.answered())
        .set("vlm.requests", usage.requests)
        .set("vlm.prompt_tokens", usage.prompt_tokens)
        .set("vlm.completion_tokens", usage.completion_tokens);
    if let Some(cost) = config.cost(usage.prompt_tokens, usage.completion_tokens) {
        metrics.set("vlm.cost", cost);
    }
    metrics
}

/// Returns a line with the number of answers and their cost.
pub(crate) fn summary<A>(answers: &Answers<A>, objects: usize, config: &VlmConfig) -> String {
    let usage = answers.usage;
    if usage.requests == 0 {
        let all = answers.cached();
        return format!(
            "{:>16}: {all} of {objects} answered by {}, all from stored replies; no requests",
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
        "{:>16}: {} of {objects} answered by {}, {} from stored replies; {} requests, {} + {} tokens, {cost}",
        "vlm",
        answers.answered(),
        config.model,
        answers.cached(),
        usage.requests,
        usage.prompt_tokens,
        usage.completion_tokens,
    )
}
