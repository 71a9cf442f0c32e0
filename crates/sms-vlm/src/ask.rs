//! Asking about all objects, one question per object.

use crate::answer::Fault;
use crate::cache::{Cache, CachedReply};
use crate::client::{CallError, Client, Usage};
use crate::dialect::ReplyForm;
use crate::prompt::{picture_part, quoted, repair};
use serde_json::{Value, json};
use sms_core::{CoreError, Hash, StageContext, Warnings};
use sms_materials::Estimate;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// The stage's name in warnings.
pub(crate) const STAGE: &str = "vlm";
/// Reason of a missing answer if only stored replies are used.
const NOT_STORED: &str = "no reply is stored, and no requests are allowed";
/// Number of consecutive failures after which the server is given up.
const FAILURES_IN_A_ROW: usize = 3;

/// A question about one object.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Question {
    /// Name of the object in the scene, for messages.
    pub name: String,
    /// Current label of the object; may be empty.
    pub annotation: String,
    /// Whether it is the floor, a wall or another fixed part.
    pub is_surface: bool,
    /// The picture with its box, JPEG (see [`crate::annotated`]).
    pub jpeg: Vec<u8>,
}

/// The outcome of a question.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome<A = Estimate> {
    /// A validated answer: an estimate has values in range and in SI units. Unusable fields are listed in `faults` and
    /// are absent from the answer.
    Answered {
        /// The answer.
        answer: Box<A>,
        /// The missing values, with reasons.
        faults: Vec<Fault>,
        /// Whether it came from the cache.
        is_cached: bool,
    },
    /// No answer. Contains the reason, which is also a warning.
    Fallback(String),
}

impl<A> Outcome<A> {
    /// Returns the answer, if any.
    pub fn answer(&self) -> Option<&A> {
        match self {
            Self::Answered { answer, .. } => Some(answer),
            Self::Fallback(_) => None,
        }
    }
}

/// Outcomes of all questions.
#[derive(Debug, Clone, PartialEq)]
pub struct Answers<A = Estimate> {
    /// One outcome per question, in order.
    pub outcomes: Vec<Outcome<A>>,
    /// Requests and tokens of this call; cached replies cost nothing.
    pub usage: Usage,
    /// The reason, if the server was given up.
    pub given_up: Option<GivenUp>,
}

/// A failure that affects every question: a wrong key, no server, no such model.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GivenUp {
    /// The failure.
    pub what: String,
    /// Its remedy.
    pub cure: String,
}

impl<A> Answers<A> {
    /// Returns the number of questions with an answer.
    pub fn answered(&self) -> usize {
        self.outcomes.iter().filter(|o| o.answer().is_some()).count()
    }

    /// Returns the number of answers from the cache.
    pub fn cached(&self) -> usize {
        self.outcomes.iter().filter(|o| matches!(o, Outcome::Answered { is_cached: true, .. })).count()
    }
}

/// A topic of questions about objects: the wording of a question, the form of the answer, and its parser.
pub(crate) trait Topic {
    /// The validated answer.
    type Answer: Send;
    /// The system message.
    const SYSTEM: &'static str;
    /// Rules for values that a request for a repair repeats.
    const RULES: &'static str;
    /// The substitute for an answer, for messages.
    const SUBSTITUTE: &'static str;

    /// Returns the text of a question.
    fn text(question: &Question) -> String;

    /// Returns the form of the answer.
    fn form() -> ReplyForm;

    /// Parses a reply: the answer, if it is usable, and the faults of the rest.
    ///
    /// # Errors
    /// The complaint to send to the model if the reply has no JSON object with an answer.
    fn read(reply: &str) -> Result<(Option<Self::Answer>, Vec<Fault>), String>;

    /// Warns about an outcome with missing values, with the reason.
    fn warn(question: &Question, outcome: &Outcome<Self::Answer>, warnings: &Warnings);
}

/// Asks about every object, or takes the reply from the cache. Every question ends with a validated answer or with a
/// fallback reported in the warnings.
///
/// # Errors
/// [`CoreError::Interrupted`]; [`CoreError::Write`] if the cache cannot be written.
pub(crate) fn ask_all<T: Topic>(
    questions: &[Question],
    client: &Client,
    cache: &Cache,
    context: StageContext<'_>,
) -> Result<Answers<T::Answer>, CoreError> {
    let StageContext { progress, warnings, .. } = context;
    progress.begin("vlm", questions.len() as u64);
    let stored: Vec<Option<Outcome<T::Answer>>> =
        questions.iter().map(|q| from_cache::<T>(q, client, cache, warnings)).collect();
    let pending: Vec<usize> = (0..questions.len()).filter(|&i| stored[i].is_none()).collect();
    let slots: Vec<Mutex<Option<Outcome<T::Answer>>>> = stored.into_iter().map(Mutex::new).collect();
    let session: AskSession<'_, T> = AskSession {
        questions,
        slots: &slots,
        client,
        cache,
        context,
        done: AtomicU64::new((questions.len() - pending.len()) as u64),
        failures: AtomicUsize::new(0),
        given_up: Mutex::new(None),
        error: Mutex::new(None),
    };
    if client.config().cache_only {
        pending.iter().for_each(|&i| session.put(i, Outcome::Fallback(NOT_STORED.to_owned())));
    } else if let Some((&first, rest)) = pending.split_first() {
        // The first question finds out which features the server supports, and whether it answers at all.
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
    let outcomes = slots
        .into_iter()
        .map(|slot| slot.into_inner().unwrap_or_else(PoisonError::into_inner))
        .map(|slot| slot.unwrap_or_else(|| Outcome::Fallback("it was not asked".to_owned())))
        .collect();
    let answers = Answers {
        outcomes,
        usage: client.usage(),
        given_up: given_up.unwrap_or_else(PoisonError::into_inner),
    };
    warn::<T>(questions, &answers, warnings);
    progress.end(&format!("{} of {} answered", answers.answered(), questions.len()));
    Ok(answers)
}

fn key<T: Topic>(q: &Question, client: &Client) -> Hash {
    let prompt = format!("{}\n\n{}", T::SYSTEM, T::text(q));
    Cache::key(&q.jpeg, &prompt, &client.config().model)
}

fn from_cache<T: Topic>(
    q: &Question,
    client: &Client,
    cache: &Cache,
    warnings: &Warnings,
) -> Option<Outcome<T::Answer>> {
    let entry = cache.get(&key::<T>(q, client), &q.name, warnings)?;
    let (answer, faults) = T::read(&entry.reply).ok()?;
    Some(Outcome::Answered { answer: Box::new(answer?), faults, is_cached: true })
}

struct AskSession<'a, T: Topic> {
    questions: &'a [Question],
    slots: &'a [Mutex<Option<Outcome<T::Answer>>>],
    client: &'a Client,
    cache: &'a Cache,
    context: StageContext<'a>,
    done: AtomicU64,
    failures: AtomicUsize,
    given_up: Mutex<Option<GivenUp>>,
    error: Mutex<Option<CoreError>>,
}

impl<T: Topic> AskSession<'_, T> {
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
                        self.give_up(what, "check the server, and run the command again".to_owned())
                    } else {
                        Outcome::Fallback(what)
                    }
                }
            },
        };
        self.put(i, outcome);
    }

    fn give_up(&self, what: String, cure: String) -> Outcome<T::Answer> {
        lock(&self.given_up).get_or_insert(GivenUp { what: what.clone(), cure });
        Outcome::Fallback(what)
    }

    fn put(&self, i: usize, outcome: Outcome<T::Answer>) {
        *lock(&self.slots[i]) = Some(outcome);
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        self.context.progress.update(done, &self.questions[i].name);
    }

    /// Asks one question, and requests at most `max_repairs` repairs. The best answer counts, even if the server
    /// fails later.
    fn converse(&self, i: usize) -> Result<Outcome<T::Answer>, CallError> {
        let q = &self.questions[i];
        let mut messages = opening::<T>(q);
        let mut best: Option<(T::Answer, Vec<Fault>, String)> = None;
        let mut tokens = (0, 0);
        let mut complaint = "it replied nothing".to_owned();
        let repairs = self.client.config().max_repairs;
        let form = T::form();
        for round in 0..=repairs {
            let completion = match self.client.complete(&q.name, &form, &messages, self.context.cancel) {
                Ok(completion) => completion,
                Err(CallError::Failed(_) | CallError::Declined(_)) if best.is_some() => break,
                Err(e) => return Err(e),
            };
            tokens.0 += completion.prompt_tokens;
            tokens.1 += completion.completion_tokens;
            let faults = match T::read(&completion.text) {
                Ok((answer, faults)) => {
                    let is_better = best.as_ref().is_none_or(|(_, b, _)| faults.len() <= b.len());
                    if let Some(answer) = answer.filter(|_| is_better) {
                        best = Some((answer, faults.clone(), completion.text.clone()));
                    }
                    faults
                }
                Err(what) => {
                    let cause = if completion.is_cut { " (longer than `vlm.max_tokens`)" } else { "" };
                    vec![Fault { field: "reply".into(), what: format!("{what}{cause}") }]
                }
            };
            if faults.is_empty() {
                break;
            }
            complaint = faults.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
            if round < repairs {
                messages.push(quoted(&completion.text));
                messages.push(json!({"role": "user", "content": repair(&faults, T::RULES)}));
            }
        }
        let Some((answer, faults, text)) = best else {
            return Ok(Outcome::Fallback(format!("its reply cannot be used ({complaint})")));
        };
        let entry = CachedReply::new(&self.client.config().model, &q.name, &text, tokens);
        self.cache.put(&key::<T>(q, self.client), &entry)?;
        Ok(Outcome::Answered { answer: Box::new(answer), faults, is_cached: false })
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn opening<T: Topic>(q: &Question) -> Vec<Value> {
    vec![
        json!({"role": "system", "content": T::SYSTEM}),
        json!({"role": "user", "content": [
            {"type": "text", "text": T::text(q)},
            picture_part(&q.jpeg),
        ]}),
    ]
}

/// A reason of missing answers that does not depend on the object.
struct SharedReason<'a> {
    code: &'static str,
    what: &'a str,
    cure: &'a str,
}

impl SharedReason<'_> {
    fn is_of<A>(&self, outcome: &Outcome<A>) -> bool {
        match outcome {
            Outcome::Fallback(what) => what == self.what,
            Outcome::Answered { .. } => false,
        }
    }
}

/// Warns about every object with missing values, once, with the reason. A reason of all objects is one warning.
fn warn<T: Topic>(questions: &[Question], answers: &Answers<T::Answer>, warnings: &Warnings) {
    let all = || questions.iter().zip(&answers.outcomes);
    let given_up = answers.given_up.as_ref();
    let shared = [
        given_up.map(|g| SharedReason { code: "vlm_given_up", what: &g.what, cure: &g.cure }),
        Some(SharedReason {
            code: "vlm_not_stored",
            what: NOT_STORED,
            cure: "allow requests: leave `cache-only` and `vlm.cache_only` out",
        }),
    ];
    for reason in shared.iter().flatten() {
        let without: Vec<&str> =
            all().filter(|(_, o)| reason.is_of(o)).map(|(q, _)| q.name.as_str()).collect();
        if !without.is_empty() {
            let what = format!("{}; {} for {}", reason.what, T::SUBSTITUTE, without.join(", "));
            warnings.add(STAGE, reason.code, what, reason.cure);
        }
    }
    let is_shared = |o: &Outcome<T::Answer>| shared.iter().flatten().any(|reason| reason.is_of(o));
    all().filter(|(_, o)| !is_shared(o)).for_each(|(q, o)| T::warn(q, o, warnings));
}
