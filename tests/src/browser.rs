//! Browser. Uses a page as a person does, in headless Chromium, through `chromedriver` and a small part of W3C WebDriver (JSON over HTTP).

#![allow(
    clippy::expect_used,
    clippy::panic,
    reason = "a test cannot go on without its browser"
)]

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use crate::process::{Process, free_endpoint};

/// Longest wait for one answer of the driver.
const ANSWER: Duration = Duration::from_secs(60);
/// Longest wait for the driver to start.
const START: Duration = Duration::from_secs(60);
/// Polling interval.
const PAUSE: Duration = Duration::from_millis(50);

/// A browser with one page.
#[derive(Debug)]
pub struct Browser {
    driver: Process,
    port: String,
    session: String,
}

impl Browser {
    /// Starts `chromedriver` and a headless Chromium with a window of this size, pixels.
    ///
    /// # Panics
    /// When they are not installed, or do not start.
    #[must_use]
    pub fn open(width: u32, height: u32) -> Self {
        let endpoint = free_endpoint();
        let port = endpoint.rsplit(':').next().unwrap_or_default().to_owned();
        let driver = Process::start("chromedriver", &[&format!("--port={port}")], Path::new("."));
        let mut browser = Self {
            driver,
            port,
            session: String::new(),
        };
        let start = Instant::now();
        while browser.answer("GET", "/status", None).is_err() {
            browser.driver.assert_running();
            assert!(start.elapsed() < START, "chromedriver does not answer");
            std::thread::sleep(PAUSE);
        }
        let arguments = [
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--force-color-profile=srgb",
            &format!("--window-size={width},{height}"),
        ];
        let wanted = json!({ "capabilities": { "alwaysMatch": {
            "browserName": "chrome", "goog:chromeOptions": { "args": arguments }, "goog:loggingPrefs": { "browser": "ALL" },
        } } });
        let opened = browser.answer("POST", "/session", Some(&wanted));
        let opened = opened.expect("Chromium starts");
        browser.session = format!("/session/{}", opened["sessionId"].as_str().expect("a session"));
        browser
    }

    /// Opens an address.
    ///
    /// # Panics
    /// When it cannot be loaded.
    pub fn go(&self, address: &str) {
        self.call("POST", "/url", &json!({ "url": address }));
    }

    /// Sets the inner size of the window, pixels.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn resize(&self, width: u32, height: u32) {
        self.call("POST", "/window/rect", &json!({ "width": width, "height": height }));
        let inner = self.script("return [innerWidth, innerHeight]");
        let missing =
            |at: usize, wanted: u32| wanted + wanted.saturating_sub(inner[at].as_u64().map_or(wanted, |n| n as u32));
        self.call(
            "POST",
            "/window/rect",
            &json!({ "width": missing(0, width), "height": missing(1, height) }),
        );
    }

    /// Runs a script (the body of a function) in the page and returns its result.
    ///
    /// # Panics
    /// When it throws.
    #[must_use]
    pub fn script(&self, script: &str) -> Value {
        self.call("POST", "/execute/sync", &json!({ "script": script, "args": [] }))
    }

    /// Like [`Self::script`], for asynchronous scripts: the result is the value that the script passes to its last argument.
    ///
    /// # Panics
    /// When it throws, or does not call it.
    #[must_use]
    pub fn script_async(&self, script: &str) -> Value {
        self.call("POST", "/execute/async", &json!({ "script": script, "args": [] }))
    }

    /// Runs a command of the `DevTools` protocol, such as `Input.dispatchTouchEvent`.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn command(&self, name: &str, parameters: &Value) {
        self.call(
            "POST",
            "/goog/cdp/execute",
            &json!({ "cmd": name, "params": parameters }),
        );
    }

    /// Waits until an expression of the page is true.
    ///
    /// # Panics
    /// With the page's text, when it is not true within `limit`.
    pub fn until(&self, what: &str, limit: Duration, expression: &str) {
        let start = Instant::now();
        while self.script(&format!("return Boolean({expression})")) != true {
            if start.elapsed() > limit {
                let text = self.script("return document.body.innerText");
                panic!("not within {limit:?}: {what} ({expression})\n{text}");
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Clicks on the first element of a CSS selector.
    ///
    /// # Panics
    /// When there is none, or something covers it.
    pub fn click(&self, selector: &str) {
        let found = self.call(
            "POST",
            "/element",
            &json!({ "using": "css selector", "value": selector }),
        );
        let id = found
            .as_object()
            .and_then(|found| found.values().next())
            .and_then(Value::as_str);
        let id = id.expect("an element");
        self.call("POST", &format!("/element/{id}/click"), &json!({}));
    }

    /// Presses the mouse button at one place of the window, drags to another in steps, and releases it; pixels.
    ///
    /// # Panics
    /// When a place is outside the window.
    pub fn drag(&self, from: [f64; 2], to: [f64; 2]) {
        let at = |share: f64| {
            let place = |axis: usize| (from[axis] + (to[axis] - from[axis]) * share).round();
            json!({ "type": "pointerMove", "duration": 30, "x": place(0), "y": place(1) })
        };
        let mut actions = vec![at(0.0), json!({ "type": "pointerDown", "button": 0 })];
        actions.extend([0.25, 0.5, 0.75, 1.0].map(at));
        actions.push(json!({ "type": "pointerUp", "button": 0 }));
        let mouse =
            json!({ "type": "pointer", "id": "mouse", "parameters": { "pointerType": "mouse" }, "actions": actions });
        self.call("POST", "/actions", &json!({ "actions": [mouse] }));
    }

    /// Presses and releases a key; `\u{E007}` is Enter, `\u{E00C}` Escape.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn key(&self, key: &str) {
        self.hold(key, Duration::ZERO);
    }

    /// Holds a key for a while.
    ///
    /// # Panics
    /// When the browser refuses.
    pub fn hold(&self, key: &str, how_long: Duration) {
        let actions = [
            json!({ "type": "keyDown", "value": key }),
            json!({ "type": "pause", "duration": how_long.as_millis() as u64 }),
            json!({ "type": "keyUp", "value": key }),
        ];
        let keyboard = json!({ "type": "key", "id": "keyboard", "actions": actions });
        self.call("POST", "/actions", &json!({ "actions": [keyboard] }));
    }

    /// Writes a picture of the window, PNG.
    ///
    /// # Panics
    /// When there is no picture, or the file cannot be written.
    pub fn screenshot(&self, file: &Path) {
        let text = self.call("GET", "/screenshot", &Value::Null);
        let picture = STANDARD.decode(text.as_str().unwrap_or_default());
        std::fs::write(file, picture.expect("base64")).expect("the picture is written");
    }

    /// Errors in the page's console.
    ///
    /// # Panics
    /// When the browser refuses.
    #[must_use]
    pub fn errors(&self) -> Vec<String> {
        let log = self.call("POST", "/se/log", &json!({ "type": "browser" }));
        let severe = log
            .as_array()
            .into_iter()
            .flatten()
            .filter(|line| line["level"] == "SEVERE");
        severe.map(|line| line["message"].to_string()).collect()
    }

    fn call(&self, method: &str, path: &str, body: &Value) -> Value {
        let body = (method != "GET").then_some(body);
        match self.answer(method, &format!("{}{path}", self.session), body) {
            Ok(value) => value,
            Err(error) => panic!("{method} {path}: {error}"),
        }
    }

    /// One request to the driver, on a connection of its own.
    fn answer(&self, method: &str, path: &str, body: Option<&Value>) -> Result<Value, String> {
        let text = body.map(Value::to_string).unwrap_or_default();
        let ask = || {
            let mut stream = TcpStream::connect(format!("127.0.0.1:{}", self.port))?;
            stream.set_read_timeout(Some(ANSWER))?;
            write!(
                stream,
                "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nContent-Type: application/json\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{text}",
                self.port,
                text.len()
            )?;
            // The driver keeps the connection open, so the length in the head determines where the answer ends.
            let mut reader = BufReader::new(stream);
            let mut length = 0;
            loop {
                let mut line = String::new();
                reader.read_line(&mut line)?;
                if line.trim().is_empty() {
                    break;
                }
                if let Some((name, value)) = line.split_once(':')
                    && name.eq_ignore_ascii_case("content-length")
                {
                    length = value.trim().parse().unwrap_or(0);
                }
            }
            let mut content = vec![0; length];
            reader.read_exact(&mut content)?;
            Ok(String::from_utf8_lossy(&content).into_owned())
        };
        let content: String = ask().map_err(|error: std::io::Error| error.to_string())?;
        let mut answer: Value = serde_json::from_str(&content).map_err(|error| format!("{error}: {content}"))?;
        let value = answer["value"].take();
        match value["error"].as_str() {
            Some(error) => Err(format!("{error}: {}", value["message"])),
            None => Ok(value),
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Chromium ends with its session; the driver is killed after it.
        if !self.session.is_empty() {
            let _ = self.answer("DELETE", &self.session, None);
        }
    }
}
