//! A chat-completions server within the test: it sends scripted replies, one per request, and records the requests.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// A recorded request.
#[derive(Debug, Clone)]
pub(crate) struct RecordedRequest {
    pub(crate) path: String,
    pub(crate) authorization: Option<String>,
    pub(crate) body: Value,
}

impl RecordedRequest {
    /// Returns the type of the response format, and whether the schema has nested objects.
    pub(crate) fn form(&self) -> &'static str {
        let format = &self.body["response_format"];
        match format["type"].as_str() {
            Some("json_schema")
                if format["json_schema"]["schema"]["properties"]["properties"].is_object() =>
            {
                "nested"
            }
            Some("json_schema") => "flat",
            Some("json_object") => "object",
            Some(_) => "other",
            None => "none",
        }
    }

    /// Returns the text of the last message.
    pub(crate) fn last_text(&self) -> String {
        let messages = self.body["messages"].as_array().cloned().unwrap_or_default();
        let content = messages.last().map(|m| m["content"].clone()).unwrap_or_default();
        content.as_str().map(str::to_owned).unwrap_or_else(|| content.to_string())
    }
}

/// The server's reaction to one request.
pub(crate) enum Act {
    /// A status, additional headers, a body.
    Http(u16, Vec<(&'static str, String)>, Vec<u8>),
    /// The same in chunks of this size.
    Chunked(usize, Vec<u8>),
    /// Headers that promise more bytes than follow.
    CutBody(Vec<u8>),
    /// The connection closes without a reply.
    Drop,
    /// No reply until the server ends.
    Hang,
    /// Bytes that are not HTTP.
    Garbage(Vec<u8>),
}

/// Returns a model's reply with this text.
pub(crate) fn reply(text: &str) -> Act {
    Act::Http(200, vec![], envelope(json!(text)))
}

/// Returns the body of a reply with this content.
pub(crate) fn envelope(content: Value) -> Vec<u8> {
    let body = json!({
        "choices": [{"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": content}}],
        "usage": {"prompt_tokens": 1000, "completion_tokens": 100, "total_tokens": 1100},
    });
    body.to_string().into_bytes()
}

/// Returns a server error in OpenAI's form.
pub(crate) fn refusal(status: u16, message: &str) -> Act {
    Act::Http(
        status,
        vec![],
        json!({"error": {"message": message, "type": "invalid_request_error"}}).to_string().into_bytes(),
    )
}

type Script = dyn Fn(usize, &RecordedRequest) -> Act + Send + Sync;

/// A listening server.
pub(crate) struct Server {
    pub(crate) url: String,
    requests: Arc<Mutex<Vec<RecordedRequest>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Runs `script`, a function of the request's index and the request.
    pub(crate) fn new(script: impl Fn(usize, &RecordedRequest) -> Act + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/v1", listener.local_addr().unwrap());
        let (requests, stop) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let script: Arc<Script> = Arc::new(script);
        let (all, ended) = (Arc::clone(&requests), Arc::clone(&stop));
        let thread = std::thread::spawn(move || {
            for stream in listener.incoming() {
                if ended.load(Ordering::SeqCst) {
                    return;
                }
                let Ok(stream) = stream else { continue };
                let (all, ended, script) = (Arc::clone(&all), Arc::clone(&ended), Arc::clone(&script));
                std::thread::spawn(move || serve(stream, &all, &ended, script.as_ref()));
            }
        });
        Self { url, requests, stop, thread: Some(thread) }
    }

    /// Returns the requests so far.
    pub(crate) fn requests(&self) -> Vec<RecordedRequest> {
        self.requests.lock().unwrap().clone()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::SeqCst);
        let address = self.url.trim_start_matches("http://").trim_end_matches("/v1").to_owned();
        let _ = TcpStream::connect(address);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Serves one connection; it closes after each reply.
fn serve(mut stream: TcpStream, all: &Mutex<Vec<RecordedRequest>>, stop: &AtomicBool, script: &Script) {
    let Some(request) = read_request(&stream) else { return };
    let number = {
        let mut all = all.lock().unwrap();
        all.push(request.clone());
        all.len() - 1
    };
    // The client may be gone: some tests are about that.
    let _ = act(&mut stream, script(number, &request), stop);
}

fn act(stream: &mut TcpStream, act: Act, stop: &AtomicBool) -> std::io::Result<()> {
    match act {
        Act::Http(status, headers, body) => {
            write!(
                stream,
                "HTTP/1.1 {status} Whatever\r\nConnection: close\r\nContent-Length: {}\r\n",
                body.len()
            )?;
            for (name, value) in headers {
                write!(stream, "{name}: {value}\r\n")?;
            }
            stream.write_all(b"\r\n")?;
            stream.write_all(&body)
        }
        Act::Chunked(size, body) => {
            write!(stream, "HTTP/1.1 200 OK\r\nConnection: close\r\nTransfer-Encoding: chunked\r\n\r\n")?;
            for chunk in body.chunks(size) {
                write!(stream, "{:x}\r\n", chunk.len())?;
                stream.write_all(chunk)?;
                stream.write_all(b"\r\n")?;
                stream.flush()?;
            }
            stream.write_all(b"0\r\n\r\n")
        }
        Act::CutBody(body) => {
            write!(stream, "HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n", body.len() + 1000)?;
            stream.write_all(&body)
        }
        Act::Drop => Ok(()),
        Act::Hang => {
            while !stop.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(10));
            }
            Ok(())
        }
        Act::Garbage(bytes) => stream.write_all(&bytes),
    }
}

fn read_request(stream: &TcpStream) -> Option<RecordedRequest> {
    stream.set_read_timeout(Some(Duration::from_secs(5))).ok()?;
    let mut reader = BufReader::new(stream);
    let mut line = String::new();
    reader.read_line(&mut line).ok()?;
    let path = line.split_whitespace().nth(1)?.to_owned();
    let (mut length, mut authorization) = (0, None);
    loop {
        let mut header = String::new();
        reader.read_line(&mut header).ok()?;
        let Some((name, value)) = header.trim_end().split_once(':') else { break };
        match name.to_ascii_lowercase().as_str() {
            "content-length" => length = value.trim().parse().ok()?,
            "authorization" => authorization = Some(value.trim().to_owned()),
            _ => {}
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).ok()?;
    Some(RecordedRequest { path, authorization, body: serde_json::from_slice(&body).ok()? })
}
