//! Settings of the stage.

use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};

/// Settings of the vision-language model. The key is not a setting: it comes from `OPENAI_API_KEY` and is never
/// written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VlmConfig {
    /// Base address of an OpenAI-compatible server, such as `https://api.openai.com/v1`; empty for none.
    pub url: String,
    /// The model's name on that server.
    pub model: String,
    /// Whether to use only cached replies and make no requests.
    pub cache_only: bool,
    /// Longest time to connect, seconds.
    pub connect_timeout_s: f64,
    /// Longest time from the request to the end of the reply, seconds.
    pub timeout_s: f64,
    /// Greatest number of repetitions of a request that found the server busy, failing or silent.
    pub max_retries: usize,
    /// Greatest number of repair requests per question (at most 2).
    pub max_repairs: usize,
    /// First pause before a repetition, seconds; it doubles each time. A server's `Retry-After` takes precedence.
    pub backoff_s: f64,
    /// Longest such pause, seconds, regardless of the server's `Retry-After`.
    pub max_backoff_s: f64,
    /// Number of parallel requests.
    pub parallel: usize,
    /// Greatest number of tokens of a reply. Reasoning models need thousands.
    pub max_tokens: usize,
    /// Sampling temperature; not sent to servers that refuse it.
    pub temperature: f64,
    /// Greatest size of a reply, bytes.
    pub max_reply_bytes: usize,
    /// Longer side of the sent image, pixels.
    pub max_image_side: usize,
    /// Width of the surroundings shown on each side of the object, in sizes of its box.
    pub context: f64,
    /// Price of a million prompt tokens, in any currency, for the printed cost; 0 if unknown.
    pub price_prompt_per_million: f64,
    /// Price of a million completion tokens in the same currency.
    pub price_completion_per_million: f64,
}

impl Default for VlmConfig {
    fn default() -> Self {
        Self {
            url: String::new(),
            model: String::new(),
            cache_only: false,
            connect_timeout_s: 10.0,
            timeout_s: 120.0,
            max_retries: 4,
            max_repairs: 2,
            backoff_s: 1.0,
            max_backoff_s: 60.0,
            parallel: 4,
            max_tokens: 4000,
            temperature: 0.0,
            max_reply_bytes: 4 << 20,
            max_image_side: 1024,
            context: 1.0,
            price_prompt_per_million: 0.0,
            price_completion_per_million: 0.0,
        }
    }
}

impl VlmConfig {
    /// Validates all values.
    ///
    /// # Errors
    /// [`InputError`] with the key of the first invalid value and its range.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("vlm");
        for (key, value, low, high) in [
            ("connect_timeout_s", self.connect_timeout_s, 0.01, 600.0),
            ("timeout_s", self.timeout_s, 0.01, 3600.0),
            ("backoff_s", self.backoff_s, 0.0, 600.0),
            ("max_backoff_s", self.max_backoff_s, 0.0, 3600.0),
            ("temperature", self.temperature, 0.0, 2.0),
            ("context", self.context, 0.0, 100.0),
            ("price_prompt_per_million", self.price_prompt_per_million, 0.0, 1e6),
            ("price_completion_per_million", self.price_completion_per_million, 0.0, 1e6),
        ] {
            r.within(key, value, low, high)?;
        }
        for (key, value, low, high) in [
            ("max_retries", self.max_retries, 0, 20),
            ("max_repairs", self.max_repairs, 0, 2),
            ("parallel", self.parallel, 1, 64),
            ("max_tokens", self.max_tokens, 64, 1_000_000),
            ("max_reply_bytes", self.max_reply_bytes, 1024, 1 << 30),
            ("max_image_side", self.max_image_side, 64, 8192),
        ] {
            r.count(key, value, low, high)?;
        }
        if self.url.is_empty() { Ok(()) } else { self.endpoint().map(drop) }
    }

    /// Returns the address of chat completions: `url` with any missing part of the path.
    ///
    /// # Errors
    /// [`InputError`] if the address is not http or https.
    pub fn endpoint(&self) -> Result<String, InputError> {
        let fault = |what: String| {
            InputError::new(
                what,
                "`vlm.url` (SMS_VLM_URL)",
                "give the server's base address, such as https://api.openai.com/v1 or http://localhost:8000/v1",
            )
            .at_key("vlm.url")
        };
        let url = self.url.trim().trim_end_matches('/');
        let rest = ["http://", "https://"]
            .iter()
            .find_map(|scheme| url.strip_prefix(scheme))
            .ok_or_else(|| fault(format!("`vlm.url` is `{url}`, which is not an http or https address")))?;
        let (host, path) = rest.split_once('/').unwrap_or((rest, ""));
        if host.is_empty() || host.contains(char::is_whitespace) || host.contains('@') {
            return Err(fault("`vlm.url` has no usable host (the key must not be part of it)".to_owned()));
        }
        Ok(match path {
            "" => format!("{url}/v1/chat/completions"),
            p if p.ends_with("chat/completions") => url.to_owned(),
            _ => format!("{url}/chat/completions"),
        })
    }

    /// Returns the cost of a number of tokens, if prices are given.
    pub fn cost(&self, prompt_tokens: u64, completion_tokens: u64) -> Option<f64> {
        let (prompt, completion) = (self.price_prompt_per_million, self.price_completion_per_million);
        (prompt > 0.0 || completion > 0.0)
            .then(|| (prompt_tokens as f64 * prompt + completion_tokens as f64 * completion) / 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn endpoint(url: &str) -> Result<String, String> {
        VlmConfig { url: url.into(), ..Default::default() }.endpoint().map_err(|e| e.to_string())
    }

    #[test]
    fn addresses_are_completed() {
        for (url, whole) in [
            ("https://api.openai.com/v1", "https://api.openai.com/v1/chat/completions"),
            ("https://api.openai.com/v1/", "https://api.openai.com/v1/chat/completions"),
            ("http://localhost:11434", "http://localhost:11434/v1/chat/completions"),
            ("http://h/v1/chat/completions", "http://h/v1/chat/completions"),
            (" https://h/api/v3 ", "https://h/api/v3/chat/completions"),
        ] {
            assert_eq!(endpoint(url).unwrap(), whole);
        }
        for wrong in ["localhost:8000", "ftp://h/v1", "http://", "https:///v1", "http://key@h/v1"] {
            assert!(endpoint(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_cost_is_of_both_kinds_of_tokens_and_unknown_without_prices() {
        assert_eq!(VlmConfig::default().cost(1000, 1000), None);
        let config = VlmConfig {
            price_prompt_per_million: 2.0,
            price_completion_per_million: 8.0,
            ..Default::default()
        };
        assert_eq!(config.cost(500_000, 250_000), Some(3.0));
    }
}
