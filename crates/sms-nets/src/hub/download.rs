//! Requests to the hub: the description of a file, and its resumable download.

use super::HubModel;
use super::cache::HubConfig;
use crate::NetsError;
use sha1::Sha1;
use sha2::{Digest, Sha256};
use sms_core::{Cancel, CoreError, InputError, Progress};
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use ureq::http::Response;
use ureq::{Agent, Body};

const PIECE: usize = 1 << 16;
/// Longest pause that is accepted on a server's request.
const LONGEST_PAUSE: Duration = Duration::from_secs(120);
/// Longest time of one request. Afterwards a silent or slow connection is closed and the download resumed; no data are
/// lost.
const LONGEST_BODY: Duration = Duration::from_secs(120);
/// Largest number of successive redirects.
const REDIRECTS: usize = 8;

/// The hub's description of a file.
#[derive(Debug, Clone)]
pub(crate) struct Remote {
    /// Commit of the requested revision.
    pub(crate) commit: String,
    /// SHA-256 of a large file, or the Git object name of a small one; also the file's name in the cache.
    pub(crate) checksum: String,
    /// Size in bytes.
    size: Option<u64>,
    /// Address of its content.
    url: String,
}

/// A failed attempt.
enum Failure {
    /// Temporary: a retry may help, after this time if the server gives one.
    Passing(String, Option<Duration>),
    /// A retry will not help.
    Lasting(Box<NetsError>),
}

/// Client of the hub for one model.
pub(crate) struct HubClient<'a> {
    hub: &'a HubConfig,
    model: &'a HubModel,
    agent: Agent,
}

impl<'a> HubClient<'a> {
    pub(crate) fn new(hub: &'a HubConfig, model: &'a HubModel) -> Self {
        let builder = Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .timeout_connect(Some(Duration::from_secs(20)))
            .timeout_recv_response(Some(Duration::from_secs(60)))
            .timeout_recv_body(Some(LONGEST_BODY))
            .user_agent(concat!("sms/", env!("CARGO_PKG_VERSION")));
        let is_local = ["://localhost", "://127.", "://[::1]"].iter().any(|h| hub.endpoint.contains(h));
        let builder = if is_local { builder.proxy(None) } else { builder };
        Self { hub, model, agent: builder.build().into() }
    }

    /// Fetches the description of a file.
    pub(crate) fn look(&self, revision: &str, file: &str, cancel: &Cancel) -> Result<Remote, NetsError> {
        self.repeated(file, cancel, || 0, || self.look_once(&self.address(revision, file), file))
    }

    /// Returns the address of a file's description.
    fn address(&self, revision: &str, file: &str) -> String {
        format!("{}/{}/resolve/{revision}/{file}", self.hub.endpoint, self.model.repository)
    }

    fn look_once(&self, url: &str, file: &str) -> Result<Remote, Failure> {
        let mut at = url.to_owned();
        let mut commit = None;
        for _ in 0..REDIRECTS {
            let response = self.ask(&at, true, None)?;
            let header = |name: &str| {
                response.headers().get(name).and_then(|v| v.to_str().ok()).map(|v| v.trim().to_owned())
            };
            let is_hex = |s: &String| s.bytes().all(|b| b.is_ascii_hexdigit());
            let status = response.status().as_u16();
            let target = header("location").map(|l| absolute(&at, &l));
            commit = header("x-repo-commit").filter(|c| c.len() == 40 && is_hex(c)).or(commit);
            let checksum = header("x-linked-etag")
                .or_else(|| header("etag"))
                .map(|e| e.trim_start_matches("W/").trim_matches('"').to_ascii_lowercase())
                .filter(|c| is_hex(c) && (c.len() == 40 || c.len() == 64));
            if !(200..400).contains(&status) {
                return Err(self.refused(status, file, header("retry-after")));
            }
            let own_size = || header("content-length").filter(|_| status < 300);
            let size = header("x-linked-size").or_else(own_size).and_then(|s| s.parse().ok());
            match (&commit, checksum, target) {
                // The hub describes the file, and may redirect to its content.
                (Some(commit), Some(checksum), target) => {
                    return Ok(Remote { commit: commit.clone(), checksum, size, url: target.unwrap_or(at) });
                }
                // The hub may also redirect to the description.
                (_, _, Some(target)) => at = target,
                _ => {
                    let what = format!("the server at {at} is not a Hugging Face hub");
                    let cure = self.hub.by_hand(self.model);
                    return Err(Failure::Lasting(Box::new(
                        InputError::new(what, "HF_ENDPOINT", cure).into(),
                    )));
                }
            }
        }
        Err(Failure::Passing("too many redirections".into(), None))
    }

    /// Downloads a file into the cache, resuming after interruptions.
    pub(crate) fn download(
        &self,
        remote: &Remote,
        file: &str,
        blob: &Path,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<(), NetsError> {
        let folder = blob.parent().unwrap_or(blob);
        std::fs::create_dir_all(folder).map_err(CoreError::write(folder))?;
        let partial = PathBuf::from(format!("{}.incomplete", blob.display()));
        progress.begin(&format!("fetching {}/{file}", self.model.repository), remote.size.unwrap_or(0));
        self.repeated(
            file,
            cancel,
            || length(&partial),
            || self.fetch_rest(remote, file, &partial, progress, cancel),
        )?;
        let found = checksum_of(&partial, remote.checksum.len(), cancel)?;
        if found != remote.checksum {
            std::fs::remove_file(&partial).map_err(CoreError::write(&partial))?;
            let what = format!("{file} of {} has the wrong checksum", self.model.repository);
            let cure = "run the same command again; if it fails again, a proxy or mirror changes the file";
            return Err(InputError::new(what, &remote.url, cure)
                .because(format!("{found} instead of {}", remote.checksum))
                .into());
        }
        std::fs::rename(&partial, blob).map_err(CoreError::write(blob))?;
        progress.end(file);
        Ok(())
    }

    fn fetch_rest(
        &self,
        remote: &Remote,
        file: &str,
        partial: &Path,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<(), Failure> {
        let own = |e: CoreError| Failure::Lasting(Box::new(e.into()));
        let mut have = length(partial);
        if remote.size.is_some_and(|size| have > size) {
            have = 0;
        }
        if remote.size == Some(have) && have > 0 {
            return Ok(());
        }
        let mut at = remote.url.clone();
        let mut response = self.ask(&at, false, (have > 0).then_some(have))?;
        for _ in 0..REDIRECTS {
            let location = response.headers().get("location").and_then(|v| v.to_str().ok());
            let Some(location) = location.filter(|_| response.status().is_redirection()) else { break };
            at = absolute(&at, location);
            response = self.ask(&at, false, (have > 0).then_some(have))?;
        }
        if matches!(response.status().as_u16(), 401 | 403) && !same_host(&at, &self.hub.endpoint) {
            // Addresses of content are signed and expire.
            at = self.look_once(&self.address(&remote.commit, file), file)?.url;
            response = self.ask(&at, false, (have > 0).then_some(have))?;
        }
        let status = response.status().as_u16();
        let retry = response.headers().get("retry-after").and_then(|v| v.to_str().ok()).map(str::to_owned);
        match status {
            // The server does not support ranges: start again.
            200 => have = 0,
            206 => {}
            // The range does not exist: the partial file belongs to another version.
            416 => {
                let _ = std::fs::remove_file(partial);
                return Err(Failure::Passing("the file has changed".into(), None));
            }
            _ => return Err(self.refused(status, file, retry)),
        }
        let mut options = File::options();
        let opened =
            if have > 0 { options.append(true) } else { options.write(true).create(true).truncate(true) };
        let mut out = opened.open(partial).map_err(CoreError::write(partial)).map_err(own)?;
        let mut body = response.body_mut().as_reader();
        let mut piece = vec![0; PIECE];
        loop {
            cancel.check().map_err(own)?;
            match body.read(&mut piece) {
                Ok(0) => break,
                Ok(count) => {
                    out.write_all(&piece[..count]).map_err(CoreError::write(partial)).map_err(own)?;
                    have += count as u64;
                    progress.update(have, file);
                }
                Err(e) => return Err(Failure::Passing(format!("the connection broke: {e}"), None)),
            }
        }
        match remote.size {
            Some(size) if have < size => {
                Err(Failure::Passing(format!("the connection broke after {have} of {size} bytes"), None))
            }
            _ => Ok(()),
        }
    }

    /// Sends one request; redirects are not followed.
    fn ask(&self, url: &str, head: bool, from: Option<u64>) -> Result<Response<Body>, Failure> {
        let mut request = if head { self.agent.head(url) } else { self.agent.get(url) };
        request = request.header("Accept-Encoding", "identity");
        // The token is only for the hub: it is not sent to redirection targets.
        if let Some(token) = self.hub.token.as_ref().filter(|_| same_host(url, &self.hub.endpoint)) {
            request = request.header("Authorization", format!("Bearer {token}"));
        }
        if let Some(from) = from {
            request = request.header("Range", format!("bytes={from}-"));
        }
        request.call().map_err(|e| Failure::Passing(format!("{url} cannot be reached: {e}"), None))
    }

    fn refused(&self, status: u16, file: &str, retry_after: Option<String>) -> Failure {
        let repository = self.model.repository;
        let input = |what: String, cure: String| {
            Failure::Lasting(Box::new(InputError::new(what, &self.hub.endpoint, cure).into()))
        };
        match status {
            401 | 403 => input(
                format!("the hub requires a valid token for {file} of {repository} (status {status})"),
                format!(
                    "accept the model's terms at https://huggingface.co/{repository} and set HF_TOKEN; or {}",
                    self.hub.by_hand(self.model)
                ),
            ),
            404 => input(
                format!(
                    "the hub has no {file} of {repository} at revision `{}` (status 404)",
                    self.hub.revision(self.model)
                ),
                format!("check the revision; or {}", self.hub.by_hand(self.model)),
            ),
            408 | 429 | 500..600 => {
                let seconds = retry_after.and_then(|r| r.trim().parse::<f64>().ok());
                let wait = seconds.filter(|s| (0.0..1e6).contains(s)).map(Duration::from_secs_f64);
                let why = if status == 429 { "too many requests" } else { "the hub is out of order" };
                Failure::Passing(format!("{why} (status {status})"), wait)
            }
            _ => input(format!("the hub answers with status {status}"), self.hub.by_hand(self.model)),
        }
    }

    /// Repeats an attempt until it succeeds, a permanent failure occurs, or no attempts are left. Attempts with
    /// progress do not count; `have` returns the number of bytes so far.
    fn repeated<T>(
        &self,
        file: &str,
        cancel: &Cancel,
        have: impl Fn() -> u64,
        attempt: impl Fn() -> Result<T, Failure>,
    ) -> Result<T, NetsError> {
        let mut pause = self.hub.pause;
        let mut number = 0;
        loop {
            number += 1;
            cancel.check()?;
            let before = have();
            let (why, wait) = match attempt() {
                Ok(value) => return Ok(value),
                Err(Failure::Lasting(error)) => return Err(*error),
                Err(Failure::Passing(why, wait)) => (why, wait),
            };
            if have() > before {
                (number, pause) = (0, self.hub.pause);
            }
            if number >= self.hub.attempts.max(1) {
                let what = format!("{file} of {} could not be downloaded", self.model.repository);
                let cure = format!("try again later; or {}", self.hub.by_hand(self.model));
                return Err(InputError::new(what, &self.hub.endpoint, cure).because(why).into());
            }
            let end = Instant::now() + wait.unwrap_or(pause).min(LONGEST_PAUSE);
            while Instant::now() < end {
                cancel.check()?;
                std::thread::sleep(
                    Duration::from_millis(25).min(end.saturating_duration_since(Instant::now())),
                );
            }
            pause *= 2;
        }
    }
}

/// Returns the size of a file; 0 if it does not exist.
fn length(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |m| m.len())
}

/// Returns the SHA-256 if the checksum has 64 digits, else the Git object name of the file's content.
pub(crate) fn checksum_of(path: &Path, digits: usize, cancel: &Cancel) -> Result<String, NetsError> {
    let mut file = File::open(path).map_err(CoreError::read(path))?;
    let length = file.metadata().map_err(CoreError::read(path))?.len();
    let mut sha256 = Sha256::new();
    let mut sha1 = Sha1::new();
    sha1.update(format!("blob {length}\0"));
    let mut piece = vec![0; PIECE];
    loop {
        cancel.check()?;
        let count = file.read(&mut piece).map_err(CoreError::read(path))?;
        if count == 0 {
            break;
        }
        if digits == 64 { sha256.update(&piece[..count]) } else { sha1.update(&piece[..count]) }
    }
    let hex = |bytes: &[u8]| bytes.iter().map(|b| format!("{b:02x}")).collect::<String>();
    Ok(if digits == 64 { hex(&sha256.finalize()) } else { hex(&sha1.finalize()) })
}

/// Returns scheme and host of an address.
fn host(url: &str) -> &str {
    let after = url.find("://").map_or(0, |i| i + 3);
    &url[..url[after..].find('/').map_or(url.len(), |i| after + i)]
}

fn same_host(a: &str, b: &str) -> bool {
    host(a).eq_ignore_ascii_case(host(b))
}

/// Resolves `location` relative to `base`.
fn absolute(base: &str, location: &str) -> String {
    if location.contains("://") {
        location.to_owned()
    } else if location.starts_with('/') {
        format!("{}{location}", host(base))
    } else {
        format!("{}/{location}", base.rsplit_once('/').map_or(base, |(folder, _)| folder))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_the_tools() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f");
        std::fs::write(&path, "hello\n").unwrap();
        // `sha256sum` and `git hash-object`.
        let sha256 = "5891b5b522d5df086d0ff0b110fbd9d21bb4fc7163af34d08286a2e846f6be03";
        assert_eq!(checksum_of(&path, 64, &Cancel::new()).unwrap(), sha256);
        assert_eq!(
            checksum_of(&path, 40, &Cancel::new()).unwrap(),
            "ce013625030ba8dba906f756967f9e9ca394464a"
        );
    }

    #[test]
    fn addresses_are_resolved_and_hosts_told_apart() {
        assert_eq!(absolute("https://a.b/c/d", "/x"), "https://a.b/x");
        assert_eq!(absolute("https://a.b/c/d", "x"), "https://a.b/c/x");
        assert_eq!(absolute("https://a.b/c", "https://e/f"), "https://e/f");
        assert!(same_host("http://A.b:1/x", "http://a.b:1") && !same_host("http://a.b:1/x", "http://a.b:2"));
        // A host with the hub's address as a prefix also gets no token.
        assert!(!same_host("https://huggingface.co.evil/x", "https://huggingface.co"));
    }
}
