//! One question an object, all objects.

use crate::answer::{Fault, Reading, read_reply};
use crate::cache::{Cache, Entry};
use crate::client::{CallError, Client, Usage};
use crate::prompt::{SYSTEM, form, question, repair};
use crate::quantity::shortened;
use base64::Engine;
use serde_json::{Value, json};
use sms_core::{Cancel, CoreError, Hash, Progress, Warnings};
use sms_materials::Estimate;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// The stage's name in warnings.
const STAGE: &str = "vlm";
/// After so many failures in a row the server is left alone.
const FAILURES_IN_A_ROW: usize = 3;
/// So much of a reply is quoted back to the model that is to put it right.
const QUOTED_CHARS: usize = 6000;

/// A question about one object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Question {
    /// The object's name in the scene; for messages.
    pub name: String,
    /// What it is called so far; may be empty.
    pub annotation: String,
    /// Whether it is the floor, a wall or another fixed thing.
    pub is_surface: bool,
    /// The picture with its box, JPEG (see [`crate::annotated`]).
    pub jpeg: Vec<u8>,
}

/// How a question ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    /// With values that are in range and in SI units. What the model did not say in a usable way is in `faults` and is
    /// `None` in the estimate.
    Answered {
        /// The values.
        estimate: Box<Estimate>,
        /// What is missing from them, and why.
        faults: Vec<Fault>,
        /// Whether it came from the cache.
        is_cached: bool,
    },
    /// Without any: the table or the prior has to stand in. The reason is a warning too.
    Fallback(String),
}

impl Outcome {
    /// The values, where there are any.
    pub fn estimate(&self) -> Option<&Estimate> {
        match self {
            Self::Answered { estimate, .. } => Some(estimate),
            Self::Fallback(_) => None,
        }
    }
}

/// All that was asked.
#[derive(Debug, Clone, PartialEq)]
pub struct Asked {
    /// One outcome a question, in their order.
    pub outcomes: Vec<Outcome>,
    /// Requests and tokens of this time; what came from the cache cost nothing.
    pub usage: Usage,
    /// Why the server was not asked any more, and what can be done, where it was given up.
    pub given_up: Option<GivenUp>,
}

/// A trouble that every question has: a wrong key, no server, no such model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GivenUp {
    /// What is wrong.
    pub what: String,
    /// What can be done.
    pub cure: String,
}

impl Asked {
    /// Questions with an answer.
    pub fn answered(&self) -> usize {
        self.outcomes.iter().filter(|o| o.estimate().is_some()).count()
    }

    /// Answers that came from the cache.
    pub fn cached(&self) -> usize {
        self.outcomes.iter().filter(|o| matches!(o, Outcome::Answered { is_cached: true, .. })).count()
    }
}

/// Asks about every object, from the cache where that has the reply. Every question ends as values that were checked or
/// as a fallback that is named in `warnings`.
///
/// # Errors
/// [`CoreError::Interrupted`]; [`CoreError::Write`] when the cache cannot be written.
pub fn ask(
    questions: &[Question],
    client: &Client,
    cache: &Cache,
    progress: &dyn Progress,
    cancel: &Cancel,
    warnings: &Warnings,
) -> Result<Asked, CoreError> {
    progress.begin("vlm", questions.len() as u64);
    let keys: Vec<Hash> = questions.iter().map(|q| key(q, client)).collect();
    let stored: Vec<Option<Outcome>> =
        questions.iter().zip(&keys).map(|(q, k)| from_cache(q, k, cache, warnings)).collect();
    let pending: Vec<usize> = (0..questions.len()).filter(|&i| stored[i].is_none()).collect();
    let slots: Vec<Mutex<Option<Outcome>>> = stored.into_iter().map(Mutex::new).collect();
    let session = Session {
        questions,
        keys: &keys,
        slots: &slots,
        client,
        cache,
        progress,
        cancel,
        done: AtomicU64::new((questions.len() - pending.len()) as u64),
        failures: AtomicUsize::new(0),
        given_up: Mutex::new(None),
        error: Mutex::new(None),
    };
    if client.config().cache_only {
        for &i in &pending {
            session.put(
                i,
                Outcome::Fallback("its reply is not in the cache, and no requests are allowed".to_owned()),
            );
        }
    } else if let Some((&first, rest)) = pending.split_first() {
        // The first one finds out what the server takes, and whether it answers at all.
        session.work(first);
        let next = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..client.config().parallel.min(rest.len()) {
                scope.spawn(|| {
                    while let Some(&i) = rest.get(next.fetch_add(1, Ordering::Relaxed)) {
                        session.work(i);
                    }
                });
            }
        });
    }
    let (error, given_up) = (session.error.into_inner(), session.given_up.into_inner());
    if let Some(error) = error.unwrap_or_else(PoisonError::into_inner) {
        progress.end("stopped");
        return Err(error);
    }
    let outcomes: Vec<Outcome> = slots
        .into_iter()
        .map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner))
        .map(|slot| slot.unwrap_or_else(|| Outcome::Fallback("it was not asked".to_owned())))
        .collect();
    let asked =
        Asked { outcomes, usage: client.usage(), given_up: given_up.unwrap_or_else(PoisonError::into_inner) };
    warn(questions, &asked, warnings);
    progress.end(&format!("{} of {} answered", asked.answered(), questions.len()));
    Ok(asked)
}

fn key(q: &Question, client: &Client) -> Hash {
    let prompt = format!("{SYSTEM}\n\n{}", question(&q.annotation, q.is_surface));
    Cache::key(&q.jpeg, &prompt, &client.config().model)
}

fn from_cache(q: &Question, key: &Hash, cache: &Cache, warnings: &Warnings) -> Option<Outcome> {
    let entry = cache.get(key, &q.name, warnings)?;
    let reading = read_reply(&entry.reply).ok().filter(Reading::is_usable)?;
    Some(Outcome::Answered { estimate: Box::new(reading.estimate), faults: reading.faults, is_cached: true })
}

struct Session<'a> {
    questions: &'a [Question],
    keys: &'a [Hash],
    slots: &'a [Mutex<Option<Outcome>>],
    client: &'a Client,
    cache: &'a Cache,
    progress: &'a dyn Progress,
    cancel: &'a Cancel,
    done: AtomicU64,
    failures: AtomicUsize,
    given_up: Mutex<Option<GivenUp>>,
    error: Mutex<Option<CoreError>>,
}

impl Session<'_> {
    fn work(&self, i: usize) {
        if lock(&self.error).is_some() {
            return;
        }
        let stopped = lock(&self.given_up).as_ref().map(|g| g.what.clone());
        let outcome = match stopped {
            Some(what) => Outcome::Fallback(what),
            None => match self.converse(i) {
                Ok(outcome) => {
                    self.failures.store(0, Ordering::Relaxed);
                    outcome
                }
                Err(CallError::Core(e)) => {
                    lock(&self.error).get_or_insert(e);
                    return;
                }
                Err(CallError::Fatal { what, cure }) => self.give_up(what, cure),
                Err(e @ CallError::Declined(_)) => Outcome::Fallback(e.to_string()),
                Err(CallError::Failed(what)) => {
                    if self.failures.fetch_add(1, Ordering::Relaxed) + 1 >= FAILURES_IN_A_ROW {
                        self.give_up(
                            what,
                            "see whether the server is well, and run the command again".to_owned(),
                        )
                    } else {
                        Outcome::Fallback(what)
                    }
                }
            },
        };
        self.put(i, outcome);
    }

    fn give_up(&self, what: String, cure: String) -> Outcome {
        lock(&self.given_up).get_or_insert(GivenUp { what: what.clone(), cure });
        Outcome::Fallback(what)
    }

    fn put(&self, i: usize, outcome: Outcome) {
        *lock(&self.slots[i]) = Some(outcome);
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        self.progress.update(done, &self.questions[i].name);
    }

    /// The question, and at most `max_repairs` times what was wrong with the answer. The best answer counts; a server
    /// that fails in between takes nothing away from it.
    fn converse(&self, i: usize) -> Result<Outcome, CallError> {
        let q = &self.questions[i];
        let mut messages = opening(q);
        let mut best: Option<(Reading, String)> = None;
        let mut tokens = (0, 0);
        let mut complaint = "it replied nothing".to_owned();
        let repairs = self.client.config().max_repairs;
        let form = form();
        for round in 0..=repairs {
            let completion = match self.client.complete(&q.name, &form, &messages, self.cancel) {
                Ok(completion) => completion,
                Err(CallError::Failed(_) | CallError::Declined(_)) if best.is_some() => break,
                Err(e) => return Err(e),
            };
            tokens.0 += completion.prompt_tokens;
            tokens.1 += completion.completion_tokens;
            let faults = match read_reply(&completion.text) {
                Ok(reading) => {
                    let faults = reading.faults.clone();
                    let is_better = best.as_ref().is_none_or(|(b, _)| faults.len() <= b.faults.len());
                    if reading.is_usable() && is_better {
                        best = Some((reading, completion.text.clone()));
                    }
                    faults
                }
                Err(what) if completion.is_cut => {
                    vec![Fault {
                        field: "reply".into(),
                        what: format!("{what} (longer than `vlm.max_tokens`)"),
                    }]
                }
                Err(what) => vec![Fault { field: "reply".into(), what }],
            };
            if faults.is_empty() {
                break;
            }
            complaint = faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
            if round < repairs {
                let said = shortened(&completion.text, QUOTED_CHARS);
                let said = if said.is_empty() { "(nothing)".to_owned() } else { said };
                messages.push(json!({"role": "assistant", "content": said}));
                messages.push(json!({"role": "user", "content": repair(&faults)}));
            }
        }
        let Some((reading, text)) = best else {
            return Ok(Outcome::Fallback(format!("its reply cannot be used ({complaint})")));
        };
        let entry = Entry::new(&self.client.config().model, &q.name, &text, tokens);
        self.cache.put(&self.keys[i], &entry)?;
        Ok(Outcome::Answered {
            estimate: Box::new(reading.estimate),
            faults: reading.faults,
            is_cached: false,
        })
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn opening(q: &Question) -> Vec<Value> {
    let picture = base64::engine::general_purpose::STANDARD.encode(&q.jpeg);
    vec![
        json!({"role": "system", "content": SYSTEM}),
        json!({"role": "user", "content": [
            {"type": "text", "text": question(&q.annotation, q.is_surface)},
            {"type": "image_url", "image_url": {"url": format!("data:image/jpeg;base64,{picture}")}},
        ]}),
    ]
}

/// Names every object whose values are not all the model's, once, with the reason.
fn warn(questions: &[Question], asked: &Asked, warnings: &Warnings) {
    if let Some(given_up) = &asked.given_up {
        let without: Vec<&str> = questions
            .iter()
            .zip(&asked.outcomes)
            .filter(|(_, o)| matches!(o, Outcome::Fallback(what) if *what == given_up.what))
            .map(|(q, _)| q.name.as_str())
            .collect();
        warnings.add(
            STAGE,
            "vlm_given_up",
            format!("{}; the table or a prior stands in for {}", given_up.what, without.join(", ")),
            given_up.cure.clone(),
        );
    }
    for (q, outcome) in questions.iter().zip(&asked.outcomes) {
        match outcome {
            Outcome::Fallback(what) if asked.given_up.as_ref().is_some_and(|g| g.what == *what) => {}
            Outcome::Fallback(what) => warnings.add(
                STAGE,
                "vlm_fallback",
                format!("the model's word on {} is missing: {what}; the table or a prior stands in", q.name),
                "run the command again to ask again, or set its values with `sms materials RUN --set`",
            ),
            Outcome::Answered { faults, .. } if !faults.is_empty() => {
                let list: Vec<String> = faults.iter().map(ToString::to_string).collect();
                warnings.add(
                    STAGE,
                    "vlm_partial",
                    format!("of the model's word on {} a part is left out ({})", q.name, list.join("; ")),
                    "the table or a prior stands in for that; set it with `sms materials RUN --set` where you know better",
                );
            }
            Outcome::Answered { .. } => {}
        }
    }
}
