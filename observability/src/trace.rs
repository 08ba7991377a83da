//! Traces. The spans of one scan through all parts until it moves the wheels, and how long each takes.
//!
//! A context is W3C's `traceparent` (<https://www.w3.org/TR/trace-context/>); it crosses the bus in a message's attachment. Each process
//! writes its spans into its own file, one OTLP export request in JSON per line, as OpenTelemetry's file exporter does: Jaeger opens the
//! file, a collector reads it, and `cat` joins the files of several hosts. Off unless a file is named. Spans never wait for the disk: if
//! the queue is full they are dropped and counted.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::{self, Write as _};
use std::path::Path;
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde_json::json;
use uuid::Uuid;

use crate::metrics::SPANS_DROPPED;
use crate::process;

/// Most spans queued for the disk.
const MOST_WAITING: usize = 1024;
/// Largest file, bytes; later spans are left out.
const LARGEST_FILE: u64 = 256 * 1024 * 1024;
/// Length of a `traceparent`.
const LENGTH: usize = 55;

static WRITER: OnceLock<SyncSender<Span>> = OnceLock::new();

/// Starts writing spans into a new file; an existing one is replaced.
///
/// # Errors
/// When the file cannot be created, or spans are already written to another one.
pub fn start(path: &Path) -> io::Result<()> {
    let file = File::create(path)?;
    let (sender, spans) = sync_channel(MOST_WAITING);
    WRITER
        .set(sender)
        .map_err(|_| io::Error::other("spans are written already"))?;
    std::thread::Builder::new()
        .name("zenav-trace".to_owned())
        .spawn(move || write(file, &spans))?;
    Ok(())
}

fn write(mut file: File, spans: &Receiver<Span>) {
    let host = process::facts().host.unwrap_or_default();
    let mut left = LARGEST_FILE;
    while let Ok(span) = spans.recv() {
        let line = span.line(&host);
        let written = match left.checked_sub(line.len() as u64) {
            Some(rest) => {
                left = rest;
                file.write_all(line.as_bytes())
            }
            None => Err(io::Error::other("it is as large as it may be")),
        };
        if let Err(error) = written {
            tracing::warn!(%error, "the trace file takes no more spans");
            return;
        }
    }
}

/// Whether spans are written.
#[must_use]
pub fn is_on() -> bool {
    WRITER.get().is_some()
}

/// Trace context of a message: the trace, and the span that it comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Context {
    trace: [u8; 16],
    span: [u8; 8],
}

impl Context {
    /// Parses a sampled `traceparent` of version 00; `None` for anything else.
    #[must_use]
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let text = std::str::from_utf8(bytes).ok().filter(|text| text.len() == LENGTH)?;
        let mut parts = text.split('-');
        let (version, trace, span, flags) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
        if version != "00" || parts.next().is_some() || u8::from_str_radix(flags, 16).ok()? & 1 == 0 {
            return None;
        }
        let context = Self {
            trace: from_hex(trace)?,
            span: from_hex(span)?,
        };
        (context.trace != [0; 16] && context.span != [0; 8]).then_some(context)
    }
}

impl fmt::Display for Context {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "00-{}-{}-01", hex(&self.trace), hex(&self.span))
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let digits = text.as_bytes();
    if digits.len() != 2 * N || !digits.iter().all(|digit| matches!(digit, b'0'..=b'9' | b'a'..=b'f')) {
        return None;
    }
    let mut bytes = [0; N];
    for (byte, pair) in bytes.iter_mut().zip(text.as_bytes().chunks(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
    }
    Some(bytes)
}

/// A random span id.
fn new_span() -> [u8; 8] {
    let mut span = [0; 8];
    span.copy_from_slice(&Uuid::new_v4().as_bytes()[..8]);
    span
}

/// A span. It is written when it [ends](Span::end); a dropped span is not.
#[derive(Clone, Debug)]
pub struct Span {
    context: Context,
    parent: Option<[u8; 8]>,
    part: String,
    name: &'static str,
    began: Duration,
    ended: Duration,
    attributes: BTreeMap<&'static str, String>,
}

/// The first span of a new trace; `None` while no spans are written.
#[must_use]
pub fn root(part: &str, name: &'static str) -> Option<Span> {
    is_on().then(|| Span::new(*Uuid::new_v4().as_bytes(), None, part, name))
}

/// A child span of a context; `None` while no spans are written.
#[must_use]
pub fn child(parent: &Context, part: &str, name: &'static str) -> Option<Span> {
    is_on().then(|| Span::new(parent.trace, Some(parent.span), part, name))
}

impl Span {
    fn new(trace: [u8; 16], parent: Option<[u8; 8]>, part: &str, name: &'static str) -> Self {
        Self {
            context: Context {
                trace,
                span: new_span(),
            },
            parent,
            part: part.to_owned(),
            name,
            began: now(),
            ended: Duration::ZERO,
            attributes: BTreeMap::new(),
        }
    }

    /// Adds an attribute.
    #[must_use]
    pub fn with(mut self, name: &'static str, value: impl ToString) -> Self {
        self.attributes.insert(name, value.to_string());
        self
    }

    /// The context for child spans.
    #[must_use]
    pub fn context(&self) -> Context {
        self.context
    }

    /// Ends the span now and queues it for the file.
    pub fn end(mut self) {
        self.ended = now();
        if let Some(writer) = WRITER.get()
            && writer.try_send(self).is_err()
        {
            SPANS_DROPPED.with_label_values::<&str>(&[]).inc();
        }
    }

    /// An OTLP export request with only this span, and a newline.
    fn line(&self, host: &str) -> String {
        let attribute = |name: &str, value: &str| json!({ "key": name, "value": { "stringValue": value } });
        let attributes = self.attributes.iter().map(|(name, value)| attribute(name, value));
        let span = json!({
            "traceId": hex(&self.context.trace),
            "spanId": hex(&self.context.span),
            "parentSpanId": self.parent.map(|parent| hex(&parent)).unwrap_or_default(),
            "name": self.name,
            "kind": 1,
            "startTimeUnixNano": self.began.as_nanos().to_string(),
            "endTimeUnixNano": self.ended.as_nanos().to_string(),
            "attributes": attributes.collect::<Vec<_>>(),
            "status": {},
        });
        let request = json!({ "resourceSpans": [{
            "resource": { "attributes": [attribute("service.name", &self.part), attribute("host.name", host)] },
            "scopeSpans": [{
                "scope": { "name": "zenav", "version": env!("CARGO_PKG_VERSION") },
                "spans": [span],
            }],
        }] });
        format!("{request}\n")
    }
}

fn now() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_context_is_written_as_w3c_wants_it_and_strange_ones_are_none() {
        let text = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";
        let context = Context::parse(text.as_bytes()).unwrap();
        assert_eq!(context.to_string(), text);
        for strange in [
            "",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-00",
            "ff-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
            "00-00000000000000000000000000000000-00f067aa0ba902b7-01",
            "00-4BF92F3577B34DA6A3CE929D0E0E4736-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e47-36-0f067aa0ba902b7-01x",
        ] {
            assert_eq!(Context::parse(strange.as_bytes()), None, "{strange}");
        }
        assert_eq!(Context::parse(&[0xff; LENGTH]), None);
    }

    #[test]
    fn spans_of_one_trace_are_written_as_otlp_and_point_to_their_parents() {
        assert!(root("edge-a", "scan").is_none(), "off until a file is named");
        let file = std::env::temp_dir().join(format!("zenav-trace-{}.jsonl", std::process::id()));
        start(&file).unwrap();
        let scan = root("edge-a", "scan").unwrap();
        let insertion = child(&scan.context(), "mapping-a", "insertion")
            .unwrap()
            .with("scan", "a \"b\"");
        let (first, second) = (scan.context(), insertion.context());
        scan.end();
        insertion.end();
        let lines = loop {
            let text = std::fs::read_to_string(&file).unwrap();
            if text.lines().count() == 2 && text.ends_with('\n') {
                break text;
            }
            std::thread::yield_now();
        };
        std::fs::remove_file(&file).unwrap();
        let spans: Vec<serde_json::Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        let of = |index: usize| &spans[index]["resourceSpans"][0]["scopeSpans"][0]["spans"][0];
        assert_eq!(of(0)["traceId"], of(1)["traceId"]);
        assert_eq!(
            (of(0)["parentSpanId"].as_str(), of(1)["parentSpanId"].as_str()),
            (Some(""), of(0)["spanId"].as_str())
        );
        assert_eq!(of(1)["attributes"][0]["value"]["stringValue"], "a \"b\"");
        assert_eq!(
            spans[1]["resourceSpans"][0]["resource"]["attributes"][0]["value"]["stringValue"],
            "mapping-a"
        );
        assert!(first.to_string() != second.to_string() && first.trace == second.trace);
    }
}
