//! One HTTP request.

use crate::VlmConfig;
use sms_core::InputError;
use std::io::Read;
use std::time::Duration;

/// A request to a chat-completions server.
#[derive(Clone)]
pub struct Request {
    /// The complete address.
    pub url: String,
    /// The key, if the server requires one.
    pub key: Option<ApiKey>,
    /// The body, JSON.
    pub body: Vec<u8>,
}

/// The key of a server. It is never shown, neither by [`Debug`] nor in messages.
#[derive(Clone, PartialEq, Eq)]
pub struct ApiKey(String);

impl ApiKey {
    /// Trims the key from the environment; an empty one counts as missing.
    ///
    /// # Errors
    /// [`InputError`] if it contains characters that are impossible in keys.
    pub fn new(text: &str) -> Result<Option<Self>, InputError> {
        let key = text.trim();
        if !key.chars().all(|c| c.is_ascii_graphic()) {
            return Err(InputError::new(
                "the key contains invalid characters (blanks or letters beyond ASCII)",
                "OPENAI_API_KEY",
                "copy the key again",
            ));
        }
        Ok((!key.is_empty()).then(|| Self(key.to_owned())))
    }
}

impl std::fmt::Debug for ApiKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("ApiKey(…)")
    }
}

impl std::fmt::Debug for Request {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Request")
            .field("url", &self.url)
            .field("bytes", &self.body.len())
            .finish_non_exhaustive()
    }
}

/// A reply with any status.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// HTTP status.
    pub status: u16,
    /// The header `Retry-After`.
    pub retry_after: Option<String>,
    /// The body.
    pub body: Vec<u8>,
}

/// Reason why a request got no reply.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TransportError {
    /// No connection: wrong address, no listener, or an untrusted certificate.
    #[error("cannot be reached ({0})")]
    Unreachable(String),
    /// The reply was missing or incomplete at the time limit.
    #[error("did not answer in time ({0})")]
    Timeout(String),
    /// The connection broke, or the reply is not HTTP.
    #[error("broke off ({0})")]
    Broken(String),
    /// The reply is larger than `max_reply_bytes`.
    #[error("sent more than {0} bytes")]
    TooLarge(usize),
}

/// Sends requests. Tests have their own.
pub trait Transport: Send + Sync {
    /// Posts one request and waits for the whole reply.
    ///
    /// # Errors
    /// [`TransportError`] if there is none.
    fn post(&self, request: &Request) -> Result<Reply, TransportError>;
}

/// HTTP and HTTPS, with time limits on every step.
#[derive(Debug)]
pub struct HttpTransport {
    agent: ureq::Agent,
    max_bytes: usize,
}

impl HttpTransport {
    /// A transport with the limits of `config`. Proxies are taken from the environment, except for this machine
    /// itself.
    pub fn new(config: &VlmConfig) -> Self {
        let seconds = Duration::from_secs_f64;
        let builder = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .timeout_connect(Some(seconds(config.connect_timeout_s.min(config.timeout_s))))
            .timeout_global(Some(seconds(config.timeout_s)))
            .user_agent(concat!("sms/", env!("CARGO_PKG_VERSION")));
        let is_local = ["://localhost", "://127.", "://[::1]"].iter().any(|host| config.url.contains(host));
        let builder = if is_local { builder.proxy(None) } else { builder };
        Self { agent: builder.build().into(), max_bytes: config.max_reply_bytes }
    }
}

impl Transport for HttpTransport {
    fn post(&self, request: &Request) -> Result<Reply, TransportError> {
        let mut builder = self.agent.post(&request.url).header("Content-Type", "application/json");
        if let Some(ApiKey(key)) = &request.key {
            builder = builder.header("Authorization", format!("Bearer {key}"));
        }
        let mut response = builder.send(&request.body[..]).map_err(|e| explained(&e))?;
        let retry_after =
            response.headers().get("retry-after").and_then(|v| v.to_str().ok()).map(str::to_owned);
        let mut body = Vec::new();
        // One extra byte distinguishes a body that is too large from one that just fits.
        let mut reader = response.body_mut().as_reader().take(self.max_bytes as u64 + 1);
        reader.read_to_end(&mut body).map_err(|e| explained_io(&e))?;
        if body.len() > self.max_bytes {
            return Err(TransportError::TooLarge(self.max_bytes));
        }
        Ok(Reply { status: response.status().as_u16(), retry_after, body })
    }
}

fn explained(error: &ureq::Error) -> TransportError {
    use ureq::Error;
    match error {
        Error::Timeout(ureq::Timeout::Connect | ureq::Timeout::Resolve)
        | Error::HostNotFound
        | Error::ConnectionFailed
        | Error::BadUri(_)
        | Error::Tls(_)
        | Error::Rustls(_) => TransportError::Unreachable(error.to_string()),
        Error::Timeout(_) => TransportError::Timeout(error.to_string()),
        Error::Io(e) => explained_io(e),
        _ => TransportError::Broken(error.to_string()),
    }
}

fn explained_io(error: &std::io::Error) -> TransportError {
    // Errors of the body are I/O errors that wrap the transport's own.
    if let Some(inner) = error.get_ref().and_then(|e| e.downcast_ref::<ureq::Error>()) {
        return match inner {
            ureq::Error::Io(e) if e.get_ref().is_none() => of_kind(e),
            ureq::Error::Io(_) => TransportError::Broken(inner.to_string()),
            other => explained(other),
        };
    }
    of_kind(error)
}

fn of_kind(error: &std::io::Error) -> TransportError {
    use std::io::ErrorKind;
    match error.kind() {
        ErrorKind::ConnectionRefused
        | ErrorKind::AddrNotAvailable
        | ErrorKind::HostUnreachable
        | ErrorKind::NetworkUnreachable
        | ErrorKind::NotFound => TransportError::Unreachable(error.to_string()),
        ErrorKind::TimedOut | ErrorKind::WouldBlock => TransportError::Timeout(error.to_string()),
        _ => TransportError::Broken(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_checked_and_never_shown() {
        let secret = "secret";
        let key = ApiKey::new(" sk-secret \n").unwrap().unwrap();
        assert_eq!(format!("{key:?}"), "ApiKey(…)");
        let request = Request { url: "http://h".into(), key: Some(key), body: vec![1] };
        assert!(!format!("{request:?}").contains(secret));
        assert_eq!(ApiKey::new("  ").unwrap(), None);
        let message = ApiKey::new("sk secret").unwrap_err().to_string();
        assert!(!message.contains(secret), "{message}");
    }
}
