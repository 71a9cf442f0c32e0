//! Conversation with a server: retries, refusals, fatal failures.

use crate::VlmConfig;
use crate::dialect::{Completion, Dialect, Enforcement, NoReply, ReplyForm, completion, words_of_error};
use crate::pause::{Pause, STEP, Sleep, retry_after, seconds_before};
use crate::transport::{ApiKey, HttpTransport, Reply, Request, Transport, TransportError};
use serde_json::Value;
use sms_core::{Cancel, CoreError, InputError, Seed};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

/// Failure of a request.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CallError {
    /// All other questions fail, too: a wrong key, no such model, no server.
    #[error("{what}")]
    Fatal { what: String, cure: String },
    /// This request failed; others may not.
    #[error("{0}")]
    Failed(String),
    /// The model declined to answer.
    #[error("the model declined: {0}")]
    Declined(String),
    #[error(transparent)]
    Core(#[from] CoreError),
}

/// Requests and tokens used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// Number of requests, including refused and repeated ones.
    pub requests: u64,
    /// Tokens of prompts, images included, as counted by the server.
    pub prompt_tokens: u64,
    /// Tokens of replies.
    pub completion_tokens: u64,
}

/// A client of one OpenAI-compatible chat-completions server. It finds out and remembers which features the server
/// supports.
pub struct Client {
    config: VlmConfig,
    endpoint: String,
    key: Option<ApiKey>,
    transport: Arc<dyn Transport>,
    pause: Arc<dyn Pause>,
    seed: Seed,
    dialect: Mutex<Dialect>,
    usage: Mutex<Usage>,
}

impl std::fmt::Debug for Client {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Client")
            .field("endpoint", &self.endpoint)
            .field("model", &self.config.model)
            .finish_non_exhaustive()
    }
}

impl Client {
    /// A client over HTTP. `seed` randomizes the pauses between attempts.
    ///
    /// # Errors
    /// [`InputError`] if a setting is out of range, or no server or model is given.
    pub fn new(config: &VlmConfig, key: Option<ApiKey>, seed: Seed) -> Result<Self, InputError> {
        Self::with(config, key, seed, Arc::new(HttpTransport::new(config)), Arc::new(Sleep))
    }

    /// A client with its own transport and pauses.
    ///
    /// # Errors
    /// As [`Client::new`].
    pub fn with(
        config: &VlmConfig,
        key: Option<ApiKey>,
        seed: Seed,
        transport: Arc<dyn Transport>,
        pause: Arc<dyn Pause>,
    ) -> Result<Self, InputError> {
        config.validate()?;
        let endpoint = match config.url.trim() {
            "" if config.cache_only => String::new(),
            "" => {
                return Err(InputError::new(
                    "no vision-language model server is set",
                    "`vlm.url` (SMS_VLM_URL)",
                    "give the server's base address, such as https://api.openai.com/v1 or http://localhost:8000/v1",
                ));
            }
            _ => config.endpoint()?,
        };
        if config.model.trim().is_empty() {
            return Err(InputError::new(
                "no vision-language model is set",
                "`vlm.model` (SMS_VLM_MODEL)",
                "give the server's name of a model that accepts images",
            ));
        }
        Ok(Self {
            config: config.clone(),
            endpoint,
            key,
            transport,
            pause,
            seed,
            dialect: Mutex::new(Dialect::default()),
            usage: Mutex::new(Usage::default()),
        })
    }

    /// The settings.
    pub fn config(&self) -> &VlmConfig {
        &self.config
    }

    /// Returns the usage so far.
    pub fn usage(&self) -> Usage {
        *self.usage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns how the form of replies is currently requested.
    pub fn enforcement(&self) -> Enforcement {
        self.current().enforcement
    }

    fn current(&self) -> Dialect {
        *self.dialect.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends a conversation and returns the model's reply. `name` seeds the random pauses.
    pub(crate) fn complete(
        &self,
        name: &str,
        form: &ReplyForm,
        messages: &[Value],
        cancel: &Cancel,
    ) -> Result<Completion, CallError> {
        let seed = self.seed.derive(name);
        let mut attempt = 0;
        loop {
            cancel.check()?;
            let dialect = self.current();
            let config = &self.config;
            let body = dialect.body(&config.model, config.max_tokens, config.temperature, form, messages);
            let reply = self.post(body.to_string().into_bytes(), cancel)?;
            // After a timeout, only one more attempt follows: the time limit is long.
            let is_silent = matches!(reply, Err(TransportError::Timeout(_)));
            let (trouble, wait) = match self.handle(reply, dialect)? {
                Handling::Reply(completion) => return Ok(completion),
                Handling::AskDifferently => continue,
                Handling::Again { trouble, wait } => (trouble, wait),
            };
            attempt += 1;
            if attempt > self.config.max_retries || (is_silent && attempt > 1) {
                return Err(trouble);
            }
            if wait.is_some_and(|w| w.as_secs_f64() > self.config.max_backoff_s) {
                // The server requests a longer pause than allowed; an earlier attempt would only be refused again.
                return Err(trouble);
            }
            let seconds =
                seconds_before(attempt, wait, self.config.backoff_s, self.config.max_backoff_s, seed);
            self.pause.pause(seconds, cancel)?;
        }
    }

    /// Posts on its own thread, so that cancellation works while the server is busy. The thread ends by its time
    /// limits.
    fn post(&self, body: Vec<u8>, cancel: &Cancel) -> Result<Result<Reply, TransportError>, CallError> {
        self.count(|u| u.requests += 1);
        let request = Request { url: self.endpoint.clone(), key: self.key.clone(), body };
        let transport = Arc::clone(&self.transport);
        let (sender, receiver) = channel();
        std::thread::spawn(move || {
            // The receiver is gone after cancellation.
            let _ = sender.send(transport.post(&request));
        });
        loop {
            match receiver.recv_timeout(STEP) {
                Ok(reply) => return Ok(reply),
                Err(RecvTimeoutError::Timeout) => cancel.check()?,
                Err(RecvTimeoutError::Disconnected) => {
                    return Ok(Err(TransportError::Broken("the request ended without a result".to_owned())));
                }
            }
        }
    }

    fn handle(&self, reply: Result<Reply, TransportError>, sent: Dialect) -> Result<Handling, CallError> {
        let again = |trouble| Ok(Handling::Again { trouble, wait: None });
        let reply = match reply {
            Ok(reply) => reply,
            Err(e @ TransportError::Unreachable(_)) => {
                return again(CallError::Fatal {
                    what: format!("the server {} {e}", self.endpoint),
                    cure: "start it, or correct SMS_VLM_URL or `vlm.url`".to_owned(),
                });
            }
            Err(e @ TransportError::TooLarge(_)) => return Err(CallError::Failed(format!("the server {e}"))),
            Err(e) => return again(CallError::Failed(format!("the server {e}"))),
        };
        if !(200..300).contains(&reply.status) {
            return self.handle_status(reply.status, &reply, &words_of_error(&reply.body), sent);
        }
        match completion(&reply.body) {
            Ok(completion) => {
                self.count_tokens(completion.prompt_tokens, completion.completion_tokens);
                Ok(Handling::Reply(completion))
            }
            Err(NoReply::Error { status: Some(status), words }) if (300..600).contains(&status) => {
                self.handle_status(status, &reply, &words, sent)
            }
            Err(NoReply::Error { words, .. }) => {
                again(CallError::Failed(format!("the server says: {words}")))
            }
            Err(NoReply::Malformed(what)) => again(CallError::Failed(what)),
            Err(NoReply::Refused { words, prompt_tokens, completion_tokens }) => {
                self.count_tokens(prompt_tokens, completion_tokens);
                Err(CallError::Declined(words))
            }
        }
    }

    fn handle_status(
        &self,
        status: u16,
        reply: &Reply,
        words: &str,
        sent: Dialect,
    ) -> Result<Handling, CallError> {
        let fatal = |what: String, cure: &str| Err(CallError::Fatal { what, cure: cure.to_owned() });
        let says = if words.is_empty() { String::new() } else { format!(": {words}") };
        match status {
            401 if self.key.is_none() => fatal(
                format!("the server requires a key (401{says})"),
                "give it in the environment variable OPENAI_API_KEY",
            ),
            401 | 403 => fatal(
                format!("the server refuses the key ({status}{says})"),
                "check OPENAI_API_KEY and the permissions of the key",
            ),
            402 => {
                fatal(format!("the account has no credit (402{says})"), "add credit, or use another server")
            }
            404 | 405 => fatal(
                format!("the server has no such address or model `{}` ({status}{says})", self.config.model),
                "check SMS_VLM_URL and SMS_VLM_MODEL (`vlm.url`, `vlm.model`)",
            ),
            429 if words.contains("insufficient_quota") => fatal(
                format!("the account's quota is used up (429{says})"),
                "raise the quota, or use another server",
            ),
            300..=399 => fatal(
                format!("the server redirects to another address ({status})"),
                "give the address that it redirects to as SMS_VLM_URL (`vlm.url`)",
            ),
            413 => Err(CallError::Failed(format!(
                "the image is too large for the server (413{says}); lower `vlm.max_image_side`"
            ))),
            400 | 422 => self
                .step_down(words, sent)
                .map(|()| Handling::AskDifferently)
                .ok_or_else(|| CallError::Failed(format!("the server refuses the request ({status}{says})"))),
            408 | 409 | 425 | 429 | 500..=599 => {
                // Some servers fail instead of refusing.
                let about_form =
                    ["response_format", "json_schema", "grammar"].iter().any(|w| words.contains(w));
                if matches!(status, 500 | 501) && about_form && self.step_down(words, sent).is_some() {
                    return Ok(Handling::AskDifferently);
                }
                let wait = reply.retry_after.as_deref().and_then(|t| retry_after(t, SystemTime::now()));
                let trouble = CallError::Failed(format!("the server is busy or failing ({status}{says})"));
                Ok(Handling::Again { trouble, wait })
            }
            _ => Err(CallError::Failed(format!("the server answers with status {status}{says}"))),
        }
    }

    /// Drops the refused feature, unless another thread already has.
    fn step_down(&self, words: &str, sent: Dialect) -> Option<()> {
        let mut dialect = self.dialect.lock().unwrap_or_else(PoisonError::into_inner);
        if *dialect == sent {
            *dialect = sent.after_refusal(words)?;
        }
        Some(())
    }

    fn count(&self, f: impl FnOnce(&mut Usage)) {
        f(&mut self.usage.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn count_tokens(&self, prompt: u64, completion: u64) {
        self.count(|u| {
            u.prompt_tokens += prompt;
            u.completion_tokens += completion;
        });
    }
}

enum Handling {
    Reply(Completion),
    /// The form of the request was refused; the dialect has changed.
    AskDifferently,
    /// The failure may be temporary.
    Again {
        trouble: CallError,
        wait: Option<std::time::Duration>,
    },
}
