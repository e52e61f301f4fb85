//! Calls to the control interface, one after the other.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::time::Duration;

use serde_json::Value;
use ureq::http::{Request, Response};
use ureq::{Agent, Body};

use super::Failed;

/// How long a connection may take.
const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// The environment's token.
const TOKEN_VARIABLE: &str = "STANDIN_TOKEN";

/// The most bytes of an answer: ten thousand requests of each of many buses.
const ANSWER_MAX: u64 = 1 << 30;

/// The way to a running program.
pub struct Client {
    agent: Agent,
    url: String,
    token: Option<String>,
}

impl Client {
    /// The way to the program at a URL, with the token of a file or of the environment.
    ///
    /// # Errors
    /// The URL or the file cannot be used.
    pub fn new(url: &str, token_file: Option<&Path>) -> Result<Self, Failed> {
        let url = url.trim_end_matches('/');
        if !url.starts_with("http://") {
            return Err(Failed::new(format!("--at takes a URL such as {}, not {url:?}", super::DEFAULT_URL)));
        }
        let token = match token_file {
            Some(path) => {
                let read = std::fs::read_to_string(path);
                let text = read.map_err(|error| Failed::new(format!("--token-file {}: {error}", path.display())))?;
                Some(text.trim().to_owned())
            }
            None => std::env::var(TOKEN_VARIABLE).ok(),
        };
        // An advance takes as long as it takes, and is answered when it is done.
        let config =
            Agent::config_builder().http_status_as_error(false).timeout_connect(Some(CONNECT_WITHIN)).proxy(None);
        Ok(Self { agent: config.build().into(), url: url.into(), token })
    }

    /// GET.
    ///
    /// # Errors
    /// Nobody answers, or it is refused.
    pub fn get(&self, path: &str) -> Result<Value, Failed> {
        self.call("GET", path, &Value::Null)
    }

    /// PATCH.
    ///
    /// # Errors
    /// Nobody answers, or it is refused.
    pub fn patch(&self, path: &str, body: &Value) -> Result<Value, Failed> {
        self.call("PATCH", path, body)
    }

    /// POST.
    ///
    /// # Errors
    /// Nobody answers, or it is refused.
    pub fn post(&self, path: &str, body: &Value) -> Result<Value, Failed> {
        self.call("POST", path, body)
    }

    /// DELETE.
    ///
    /// # Errors
    /// Nobody answers, or it is refused.
    pub fn delete(&self, path: &str) -> Result<Value, Failed> {
        self.call("DELETE", path, &Value::Null)
    }

    /// GET of something that is no JSON.
    ///
    /// # Errors
    /// Nobody answers, or it is refused.
    pub fn text(&self, path: &str) -> Result<String, Failed> {
        let mut response = self.send("GET", path, &Value::Null)?;
        let text = response.body_mut().with_config().limit(ANSWER_MAX).read_to_string();
        text.map_err(|error| self.unreachable(&error.to_string()))
    }

    /// Hands on server-sent events until there are no more, or `on_event` wants none.
    ///
    /// # Errors
    /// Nobody answers, or it is refused.
    pub fn follow(&self, path: &str, mut on_event: impl FnMut(&str, &Value) -> bool) -> Result<String, Failed> {
        let response = self.send("GET", path, &Value::Null)?;
        let mut name = String::new();
        for line in BufReader::new(response.into_body().into_reader()).lines() {
            let Ok(line) = line else { break };
            if let Some(event) = line.strip_prefix("event: ") {
                name = event.into();
            } else if let Some(data) = line.strip_prefix("data: ")
                && let Ok(data) = serde_json::from_str(data)
                && !on_event(&name, &data)
            {
                break;
            }
        }
        Ok(String::new())
    }

    fn call(&self, method: &str, path: &str, body: &Value) -> Result<Value, Failed> {
        let mut response = self.send(method, path, body)?;
        let text = response.body_mut().with_config().limit(ANSWER_MAX).read_to_string();
        let text = text.map_err(|error| self.unreachable(&error.to_string()))?;
        if text.is_empty() {
            return Ok(Value::Null);
        }
        let foreign = |_| Failed::new(format!("what answers at {} is no standin", self.url));
        serde_json::from_str(&text).map_err(foreign)
    }

    /// Sends a call; an answer that says it was not done is an error.
    fn send(&self, method: &str, path: &str, body: &Value) -> Result<Response<Body>, Failed> {
        let mut request = Request::builder().method(method).uri(format!("{}{path}", self.url));
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        let text = if body.is_null() { String::new() } else { body.to_string() };
        let request = request.header("content-type", "application/json").body(text);
        let request = request.map_err(|error| Failed::new(format!("{}: {error}", self.url)))?;
        let mut response = self.agent.run(request).map_err(|error| self.unreachable(&error.to_string()))?;
        if response.status().is_success() {
            return Ok(response);
        }
        let text = response.body_mut().read_to_string().unwrap_or_default();
        let answer: Value = serde_json::from_str(&text).unwrap_or_default();
        let message = answer["error"]["message"].as_str();
        let words = message.map_or_else(|| format!("{} answers {}", self.url, response.status()), str::to_owned);
        let token_hint = "; set STANDIN_TOKEN or --token-file";
        let words = if response.status() == 401 { words + token_hint } else { words };
        Err(Failed { error: answer["error"].clone(), ..Failed::new(words) })
    }

    fn unreachable(&self, why: &str) -> Failed {
        Failed::new(format!(
            "nobody answers at {}: {why}; does standin run, with --listen or [control] listen, and is --at or STANDIN_URL right?",
            self.url
        ))
    }
}

/// A part of a URL: everything but letters, digits and `-_.~` in hex.
pub fn encoded(text: &str) -> String {
    let byte = |byte: u8| match byte {
        b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' => char::from(byte).to_string(),
        other => format!("%{other:02X}"),
    };
    text.bytes().map(byte).collect()
}
