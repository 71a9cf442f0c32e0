//! Downloads from a hub inside the test, which drops connections, changes files and refuses requests.

use sha2::{Digest, Sha256};
use sms_core::{Cancel, NoProgress};
use sms_nets::NetsError;
use sms_nets::hub::{HubConfig, HubModel, MODELS, model};
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const COMMIT: &str = "0123456789abcdef0123456789abcdef01234567";
const MODEL: HubModel = HubModel {
    name: "toy",
    repository: "org/toy",
    revision: "main",
    about: "",
    files: &["config.json", "model.safetensors"],
};

/// A recorded request.
#[derive(Debug, Clone)]
struct RecordedRequest {
    method: String,
    path: String,
    token: Option<String>,
    from: Option<usize>,
}

/// A fault of the server.
#[derive(Debug, Clone, PartialEq)]
enum Fault {
    None,
    /// Closes the connection after this many bytes of a body.
    Cut(usize),
    /// Answers with this status and `Retry-After`.
    Status(u16, &'static str),
    /// Sends other bytes of the same length.
    Wrong,
    /// Ignores ranges.
    Whole,
    /// Redirects to another server for the content.
    Elsewhere(String),
    /// Redirects to another path on the same server, with only the commit.
    Moved,
    /// Answers like an ordinary web server.
    Plain,
}

type Script = dyn Fn(usize, &RecordedRequest) -> Fault + Send + Sync;

struct Server {
    url: String,
    requests: Arc<Mutex<Vec<RecordedRequest>>>,
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

fn content(file: &str) -> Vec<u8> {
    match file {
        "config.json" => b"{\"model_type\": \"toy\"}\n".to_vec(),
        _ => (0..300_000u32).map(|i| (i * 31 % 251) as u8).collect(),
    }
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// The `git hash-object` of `config.json`'s content.
fn checksum(file: &str) -> String {
    if file == "config.json" { GIT_NAME.into() } else { sha256(&content(file)) }
}

const GIT_NAME: &str = "beafd0b1303476cd8c3cd7c92e31bb3dbb077681";

impl Server {
    fn new(script: impl Fn(usize, &RecordedRequest) -> Fault + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let (requests, stop) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let script: Arc<Script> = Arc::new(script);
        let (all, ended) = (Arc::clone(&requests), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            for stream in listener.incoming() {
                if ended.load(Ordering::SeqCst) {
                    return;
                }
                if let Ok(stream) = stream {
                    let _ = serve(stream, &all, script.as_ref());
                }
            }
        });
        Self { url, requests, stop, thread: Some(thread) }
    }

    fn requests(&self) -> Vec<RecordedRequest> {
        self.requests.lock().unwrap().clone()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        let _ = TcpStream::connect(self.url.trim_start_matches("http://"));
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Serves one request and closes the connection.
fn serve(mut stream: TcpStream, all: &Mutex<Vec<RecordedRequest>>, script: &Script) -> std::io::Result<()> {
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut line = String::new();
    reader.read_line(&mut line)?;
    let words: Vec<&str> = line.split_whitespace().collect();
    let &[method, path, _] = &words[..] else { return Ok(()) };
    let mut request = RecordedRequest { method: method.into(), path: path.into(), token: None, from: None };
    loop {
        let mut header = String::new();
        reader.read_line(&mut header)?;
        let Some((name, value)) = header.trim_end().split_once(':') else { break };
        match name.to_ascii_lowercase().as_str() {
            "authorization" => request.token = Some(value.trim().into()),
            "range" => {
                request.from = value.trim().trim_start_matches("bytes=").trim_end_matches('-').parse().ok();
            }
            _ => {}
        }
    }
    let number = {
        let mut all = all.lock().unwrap();
        all.push(request.clone());
        all.len() - 1
    };
    let fault = script(number, &request);
    if let Fault::Status(status, retry) = fault {
        return write!(
            stream,
            "HTTP/1.1 {status} No\r\nConnection: close\r\nRetry-After: {retry}\r\nContent-Length: 0\r\n\r\n"
        );
    }
    if fault == Fault::Moved {
        return write!(
            stream,
            "HTTP/1.1 307 Moved\r\nConnection: close\r\nLocation: /moved{path}\r\nX-Repo-Commit: {COMMIT}\r\nContent-Length: 0\r\n\r\n"
        );
    }
    if fault == Fault::Plain {
        return write!(stream, "HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: 5\r\n\r\nhello");
    }
    let file = path.rsplit('/').next().unwrap_or_default();
    let bytes = content(file);
    if method == "HEAD" {
        // Like the hub for large files: a description, and a redirection to the content.
        let place = if let Fault::Elsewhere(url) = &fault { url.as_str() } else { "" };
        let sends_on = if file.ends_with("safetensors") {
            format!(
                "Location: {place}/cdn/{file}\r\nX-Linked-Etag: \"{}\"\r\nX-Linked-Size: {}\r\n",
                checksum(file),
                bytes.len()
            )
        } else {
            format!("ETag: \"{}\"\r\n", checksum(file))
        };
        let status = if file.ends_with("safetensors") { "302 DetectedObject" } else { "200 OK" };
        return write!(
            stream,
            "HTTP/1.1 {status}\r\nConnection: close\r\nX-Repo-Commit: {COMMIT}\r\n{sends_on}Content-Length: {}\r\n\r\n",
            if sends_on.starts_with("Location") { 0 } else { bytes.len() }
        );
    }
    let from = request.from.filter(|_| fault != Fault::Whole).unwrap_or(0).min(bytes.len());
    let status = if from > 0 { "206 Partial Content" } else { "200 OK" };
    let mut body = bytes[from..].to_vec();
    if fault == Fault::Wrong {
        body[0] ^= 1;
    }
    write!(stream, "HTTP/1.1 {status}\r\nConnection: close\r\nContent-Length: {}\r\n\r\n", body.len())?;
    if let Fault::Cut(after) = fault {
        body.truncate(after);
    }
    stream.write_all(&body)
}

fn hub(server: &Server, cache: &Path) -> HubConfig {
    HubConfig {
        endpoint: server.url.clone(),
        cache: cache.into(),
        token: None,
        is_offline: false,
        revision: Some("main".into()),
        attempts: 3,
        pause: Duration::from_millis(1),
    }
}

fn fetch(hub: &HubConfig) -> Result<std::path::PathBuf, NetsError> {
    hub.fetch(&MODEL, &NoProgress, &Cancel::new())
}

fn assert_whole(folder: &Path) {
    for file in MODEL.files {
        assert_eq!(std::fs::read(folder.join(file)).unwrap(), content(file), "{file}");
    }
}

#[test]
fn a_model_is_fetched_once_into_the_standard_cache() {
    let server = Server::new(|_, _| Fault::None);
    let cache = tempfile::tempdir().unwrap();
    let hub = hub(&server, cache.path());
    assert_eq!(hub.cached(&MODEL), None);
    let folder = fetch(&hub).unwrap();
    assert_whole(&folder);
    let repository = cache.path().join("models--org--toy");
    assert_eq!(folder, repository.join("snapshots").join(COMMIT));
    assert_eq!(std::fs::read_to_string(repository.join("refs/main")).unwrap(), COMMIT);
    assert!(repository.join("blobs").join(checksum("model.safetensors")).is_file());
    // The second file is requested at the commit of the first.
    assert!(
        server.requests().iter().any(|a| a.path.contains(&format!("/resolve/{COMMIT}/model.safetensors")))
    );
    let before = server.requests().len();
    assert_eq!(fetch(&hub).unwrap(), folder);
    assert_eq!(server.requests().len(), before, "no further requests");
    let offline = HubConfig { is_offline: true, ..hub };
    assert_eq!(fetch(&offline).unwrap(), folder);
}

#[test]
fn a_pinned_commit_is_requested_without_a_branch() {
    let server = Server::new(|_, _| Fault::None);
    let cache = tempfile::tempdir().unwrap();
    let hub = HubConfig { revision: None, ..hub(&server, cache.path()) };
    let pinned = HubModel { revision: COMMIT, ..MODEL };
    let folder = hub.fetch(&pinned, &NoProgress, &Cancel::new()).unwrap();
    assert_whole(&folder);
    assert!(
        server.requests().iter().filter(|a| a.path.contains("/resolve/")).all(|a| a.path.contains(COMMIT))
    );
    assert_eq!(hub.cached(&pinned).map(|c| c.commit).as_deref(), Some(COMMIT));
    assert!(!cache.path().join("models--org--toy/refs").exists());
    for model in &MODELS {
        assert!(model.revision.len() == 40 && model.revision.bytes().all(|b| b.is_ascii_hexdigit()));
    }
}

#[test]
fn a_dropped_connection_is_resumed() {
    let gets = Arc::new(Mutex::new(0));
    let server = Server::new(move |_, request| {
        let mut gets = gets.lock().unwrap();
        if request.method == "GET" && request.path.ends_with("safetensors") {
            *gets += 1;
            if *gets < 3 {
                return Fault::Cut(100_000);
            }
        }
        Fault::None
    });
    let cache = tempfile::tempdir().unwrap();
    assert_whole(&fetch(&hub(&server, cache.path())).unwrap());
    let from: Vec<_> = server
        .requests()
        .iter()
        .filter(|a| a.method == "GET" && a.path.contains("cdn"))
        .map(|a| a.from)
        .collect();
    assert_eq!(from, [None, Some(100_000), Some(200_000)]);
}

#[test]
fn a_broken_download_is_resumed_by_the_next_run_even_without_ranges() {
    let cache = tempfile::tempdir().unwrap();
    let gets = Mutex::new(0);
    let cutting = Server::new(move |_, a| {
        if a.method == "GET" && a.path.contains("cdn") {
            let mut gets = gets.lock().unwrap();
            *gets += 1;
            // No more bytes afterwards.
            return Fault::Cut(if *gets <= 3 { 10_000 } else { 0 });
        }
        Fault::None
    });
    assert!(matches!(fetch(&hub(&cutting, cache.path())), Err(NetsError::Input(_))));
    let whole = Server::new(|_, _| Fault::Whole);
    assert_whole(&fetch(&hub(&whole, cache.path())).unwrap());
    assert_eq!(whole.requests().iter().filter_map(|a| a.from).collect::<Vec<_>>(), [30_000]);
}

#[test]
fn repeated_disconnects_do_not_prevent_a_download() {
    let cutting = Server::new(|_, a| {
        if a.method == "GET" && a.path.contains("cdn") { Fault::Cut(30_000) } else { Fault::None }
    });
    let cache = tempfile::tempdir().unwrap();
    assert_whole(&fetch(&hub(&cutting, cache.path())).unwrap());
    let gets = cutting.requests().iter().filter(|a| a.path.contains("cdn")).count();
    assert!(gets > hub(&cutting, cache.path()).attempts, "{gets}");
}

#[test]
fn an_expired_address_is_requested_again() {
    let elsewhere = Server::new(|number, _| if number == 0 { Fault::Status(403, "0") } else { Fault::None });
    let other = elsewhere.url.clone();
    let server = Server::new(move |_, _| Fault::Elsewhere(other.clone()));
    let cache = tempfile::tempdir().unwrap();
    assert_whole(&fetch(&hub(&server, cache.path())).unwrap());
    let described = |a: &&RecordedRequest| a.method == "HEAD" && a.path.ends_with("safetensors");
    assert_eq!(server.requests().iter().filter(described).count(), 2);
    // Permanent refusals are not retried forever.
    let status = 403;
    let never = Server::new(move |_, _| Fault::Status(status, "0"));
    let other = never.url.clone();
    let server = Server::new(move |_, _| Fault::Elsewhere(other.clone()));
    let cache = tempfile::tempdir().unwrap();
    let message = fetch(&hub(&server, cache.path())).unwrap_err().to_string();
    assert!(message.contains(&status.to_string()), "{message}");
    assert_eq!(never.requests().len(), 2);
}

#[test]
fn redirected_descriptions_are_followed_and_other_servers_refused() {
    let moving = Server::new(|_, a| {
        if a.method == "HEAD" && !a.path.starts_with("/moved") { Fault::Moved } else { Fault::None }
    });
    let cache = tempfile::tempdir().unwrap();
    assert_whole(&fetch(&hub(&moving, cache.path())).unwrap());
    let plain = Server::new(|_, _| Fault::Plain);
    let cache = tempfile::tempdir().unwrap();
    assert!(matches!(fetch(&hub(&plain, cache.path())), Err(NetsError::Input(_))));
    let circling = Server::new(|_, _| Fault::Moved);
    assert!(matches!(fetch(&hub(&circling, cache.path())), Err(NetsError::Input(_))));
}

#[test]
fn a_wrong_checksum_is_refused_and_not_cached() {
    let cache = tempfile::tempdir().unwrap();
    for file in ["config.json", "safetensors"] {
        let server =
            Server::new(
                move |_, a| {
                    if a.method == "GET" && a.path.ends_with(file) { Fault::Wrong } else { Fault::None }
                },
            );
        let hub = hub(&server, cache.path());
        let Err(NetsError::Input(error)) = fetch(&hub) else { panic!("{file}") };
        assert!(error.detail().is_some(), "{error}");
        assert_eq!(hub.cached(&MODEL), None);
    }
    let good = Server::new(|_, _| Fault::None);
    assert_whole(&fetch(&hub(&good, cache.path())).unwrap());
}

#[test]
fn a_hub_that_answers_with_another_commit_is_refused() {
    let server = Server::new(|_, _| Fault::None);
    let cache = tempfile::tempdir().unwrap();
    let hub = HubConfig { revision: None, ..hub(&server, cache.path()) };
    let pinned = HubModel { revision: "fedcba9876543210fedcba9876543210fedcba98", ..MODEL };
    let message = hub.fetch(&pinned, &NoProgress, &Cancel::new()).unwrap_err().to_string();
    assert!(message.contains(pinned.revision) && message.contains(COMMIT), "{message}");
    assert!(server.requests().iter().all(|a| a.method == "HEAD"), "nothing is fetched");
    assert_eq!(hub.cached(&pinned), None);
}

#[test]
fn cached_files_with_a_wrong_checksum_are_fetched_again() {
    let server = Server::new(|_, _| Fault::None);
    let cache = tempfile::tempdir().unwrap();
    let blobs = cache.path().join("models--org--toy/blobs");
    std::fs::create_dir_all(&blobs).unwrap();
    let mut bytes = content("model.safetensors");
    bytes[7] ^= 1;
    std::fs::write(blobs.join(checksum("model.safetensors")), bytes).unwrap();
    std::fs::write(blobs.join(checksum("config.json")), content("config.json")).unwrap();
    assert_whole(&fetch(&hub(&server, cache.path())).unwrap());
    let fetched: Vec<String> =
        server.requests().into_iter().filter(|a| a.method == "GET").map(|a| a.path).collect();
    assert_eq!(fetched, ["/cdn/model.safetensors"], "and valid files are not");
}

#[test]
fn refusals_are_explained_and_busy_servers_asked_again() {
    for status in [401, 403, 404, 418] {
        let server = Server::new(move |_, _| Fault::Status(status, "0"));
        let cache = tempfile::tempdir().unwrap();
        let message = fetch(&hub(&server, cache.path())).unwrap_err().to_string();
        assert!(message.contains(&status.to_string()) && message.contains(MODEL.repository), "{message}");
        assert_eq!(server.requests().len(), 1, "{status} is final");
    }
    for status in [429, 503] {
        let server =
            Server::new(
                move |number, _| {
                    if number.is_multiple_of(3) { Fault::None } else { Fault::Status(status, "0") }
                },
            );
        let cache = tempfile::tempdir().unwrap();
        assert_whole(&fetch(&hub(&server, cache.path())).unwrap());
        let never = Server::new(move |_, _| Fault::Status(status, "0"));
        let cache = tempfile::tempdir().unwrap();
        let message = fetch(&hub(&never, cache.path())).unwrap_err().to_string();
        assert!(message.contains(&status.to_string()), "{message}");
        assert_eq!(never.requests().len(), 3);
    }
}

#[test]
fn the_token_goes_to_the_hub_alone() {
    let elsewhere = Server::new(|_, _| Fault::None);
    let other = elsewhere.url.clone();
    let server = Server::new(move |_, _| Fault::Elsewhere(other.clone()));
    let cache = tempfile::tempdir().unwrap();
    let hub = HubConfig { token: Some("hf_secret".into()), ..hub(&server, cache.path()) };
    assert_whole(&fetch(&hub).unwrap());
    assert!(server.requests().iter().all(|a| a.token.as_deref() == Some("Bearer hf_secret")));
    let requests = elsewhere.requests();
    assert!(!requests.is_empty() && requests.iter().all(|a| a.token.is_none()), "{requests:?}");
}

#[test]
fn an_unreachable_hub_names_the_files_and_their_place() {
    let cache = tempfile::tempdir().unwrap();
    let server = Server::new(|_, _| Fault::None);
    let nowhere = HubConfig { endpoint: "http://127.0.0.1:9".into(), ..hub(&server, cache.path()) };
    let offline = HubConfig { is_offline: true, ..hub(&server, cache.path()) };
    for hub in [nowhere, offline] {
        let message = fetch(&hub).unwrap_err().to_string();
        assert!(
            MODEL.files.iter().all(|f| message.contains(f)) && message.contains(MODEL.repository),
            "{message}"
        );
    }
    assert!(server.requests().is_empty());
    let message = model("sam3").unwrap_err().to_string();
    assert!(MODELS.iter().all(|m| message.contains(m.name)), "{message}");
}

#[test]
fn a_local_copy_is_taken_in_any_of_the_usual_folders() {
    let local = tempfile::tempdir().unwrap();
    let server = Server::new(|_, _| Fault::None);
    let hub = hub(&server, local.path());
    let folder = || MODEL.folder(Some(local.path()), &hub, &NoProgress, &Cancel::new());
    let message = folder().unwrap_err().to_string();
    assert!(
        MODEL.files.iter().all(|f| message.contains(f)) && message.contains(MODEL.repository),
        "{message}"
    );
    for place in ["", "org/toy", "toy"] {
        for file in MODEL.files {
            let path = local.path().join(place).join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, content(file)).unwrap();
        }
        assert_eq!(
            folder().unwrap(),
            if place.is_empty() { local.path().to_owned() } else { local.path().join(place) }
        );
    }
    assert!(server.requests().is_empty());
}
