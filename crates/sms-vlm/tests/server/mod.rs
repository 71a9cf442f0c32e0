//! A chat-completions server within the test: it plays the replies that it was given, one a request, and keeps what it
//! was asked.

use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// One request as it came.
#[derive(Debug, Clone)]
pub(crate) struct Asked {
    pub(crate) path: String,
    pub(crate) authorization: Option<String>,
    pub(crate) body: Value,
}

impl Asked {
    /// The type of the response format, and whether the schema has objects in objects.
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

    /// The text of the last message.
    pub(crate) fn last_text(&self) -> String {
        let messages = self.body["messages"].as_array().cloned().unwrap_or_default();
        let content = messages.last().map(|m| m["content"].clone()).unwrap_or_default();
        content.as_str().map(str::to_owned).unwrap_or_else(|| content.to_string())
    }
}

/// What the server does with one request.
pub(crate) enum Act {
    /// A status, more headers, a body.
    Http(u16, Vec<(&'static str, String)>, Vec<u8>),
    /// The same in pieces of so many bytes.
    Chunked(usize, Vec<u8>),
    /// Headers that promise more than comes.
    CutBody(Vec<u8>),
    /// The connection closes without a word.
    Drop,
    /// Nothing comes until the server ends.
    Hang,
    /// Bytes that are no HTTP.
    Garbage(Vec<u8>),
}

/// A reply of a model with this text, as the server would send it.
pub(crate) fn reply(text: &str) -> Act {
    Act::Http(200, vec![], envelope(json!(text)))
}

/// The body of a reply with this content.
pub(crate) fn envelope(content: Value) -> Vec<u8> {
    let body = json!({
        "choices": [{"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": content}}],
        "usage": {"prompt_tokens": 1000, "completion_tokens": 100, "total_tokens": 1100},
    });
    body.to_string().into_bytes()
}

/// A server error as OpenAI words it.
pub(crate) fn refusal(status: u16, message: &str) -> Act {
    Act::Http(
        status,
        vec![],
        json!({"error": {"message": message, "type": "invalid_request_error"}}).to_string().into_bytes(),
    )
}

type Script = dyn Fn(usize, &Asked) -> Act + Send + Sync;

/// A listening server.
pub(crate) struct Server {
    pub(crate) url: String,
    asked: Arc<Mutex<Vec<Asked>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Plays `script`: from the number of the request and the request to what is done.
    pub(crate) fn new(script: impl Fn(usize, &Asked) -> Act + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/v1", listener.local_addr().unwrap());
        let (asked, stop) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let script: Arc<Script> = Arc::new(script);
        let (all, ended) = (Arc::clone(&asked), Arc::clone(&stop));
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
        Self { url, asked, stop, thread: Some(thread) }
    }

    /// What was asked so far.
    pub(crate) fn asked(&self) -> Vec<Asked> {
        self.asked.lock().unwrap().clone()
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
fn serve(mut stream: TcpStream, all: &Mutex<Vec<Asked>>, stop: &AtomicBool, script: &Script) {
    let Some(asked) = read_request(&stream) else { return };
    let number = {
        let mut all = all.lock().unwrap();
        all.push(asked.clone());
        all.len() - 1
    };
    // Whoever asked may be gone: that is what some tests are about.
    let _ = act(&mut stream, script(number, &asked), stop);
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

fn read_request(stream: &TcpStream) -> Option<Asked> {
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
    Some(Asked { path, authorization, body: serde_json::from_slice(&body).ok()? })
}
