//! `GET /metrics`: counts for Prometheus, in the journal's words.

use std::fmt::Write;

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use super::app::{App, Line};
use super::clock::ClockView;
use super::error::{ApiError, Failure};
use crate::bus::{Counters, REPLY_BOUNDS_US, ReplyTimes, Tally};

/// A metric: its name, its type, what it says, and its samples.
struct Metric {
    name: &'static str,
    kind: &'static str,
    help: &'static str,
    samples: String,
}

impl Metric {
    fn new(name: &'static str, kind: &'static str, help: &'static str) -> Self {
        Self { name, kind, help, samples: String::new() }
    }

    fn add(&mut self, labels: &[(&str, &str)], value: impl std::fmt::Display) {
        self.add_as("", labels, value);
    }

    fn add_as(&mut self, suffix: &str, labels: &[(&str, &str)], value: impl std::fmt::Display) {
        let labels: Vec<String> = labels.iter().map(|(name, text)| format!("{name}=\"{}\"", escaped(text))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        // Writing to a String does not fail.
        let _ = writeln!(self.samples, "{}{suffix}{labels} {value}", self.name);
    }

    fn text(&self) -> String {
        let Self { name, kind, help, samples } = self;
        format!("# HELP {name} {help}\n# TYPE {name} {kind}\n{samples}")
    }
}

fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

/// Counts for Prometheus, since the start or the last reset.
#[utoipa::path(get, path = "/metrics", tag = "status", operation_id = "metrics",
    responses((status = 200, description = "Prometheus text", content_type = "text/plain", body = String),
        (status = "default", body = Failure, description = "An error")))]
pub async fn show(State(app): State<App>) -> Result<Response, ApiError> {
    let mut lines = Vec::new();
    for line in &app.buses {
        let found = line.call(|bus, _| {
            let tally = bus.journal().map(|journal| journal.tally().clone()).unwrap_or_default();
            let stations = bus.stations().iter().map(|station| (station.boots(), station.is_powered()));
            Sample { counters: bus.counters(), tally, stations: stations.collect() }
        });
        lines.push((line, found.await?));
    }
    let clock = ClockView::read(&app).await?;
    let text = text(&lines, &clock);
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response())
}

/// What a bus has counted.
struct Sample {
    counters: Counters,
    tally: Tally,
    /// Starts, and whether it has power, of each device.
    stations: Vec<(u32, bool)>,
}

fn text(lines: &[(&Line, Sample)], clock: &ClockView) -> String {
    let mut frames = Metric::new("standin_frames_total", "counter", "Frames with a good CRC, other units' included.");
    let mut bad = Metric::new("standin_bad_frames_total", "counter", "Runs of bytes that were no frame.");
    let mut dropped = Metric::new("standin_dropped_bytes_total", "counter", "Bytes of runs that were no frame.");
    let help = "Requests by device, function and outcome; code is the exception code, 0 for none.";
    let mut requests = Metric::new("standin_requests_total", "counter", help);
    let help = "Time from a request's last byte until the reply left.";
    let mut times = Metric::new("standin_reply_seconds", "histogram", help);
    let mut faults = Metric::new("standin_fault_hits_total", "counter", "Hits of faults by what they do.");
    let mut boots = Metric::new("standin_boots_total", "counter", "Starts of a device.");
    let mut powered = Metric::new("standin_powered", "gauge", "Whether a device has power.");
    let mut rate = Metric::new("standin_clock_rate", "gauge", "Simulated seconds a real second.");
    let mut elapsed = Metric::new("standin_elapsed_seconds", "gauge", "Real seconds since the start.");
    rate.add(&[], clock.rate);
    elapsed.add(&[], clock.elapsed_s);
    for (line, Sample { counters, tally, stations }) in lines {
        let bus = ("bus", line.handle.name.as_str());
        frames.add(&[bus], counters.frames);
        bad.add(&[bus], counters.bad_frames);
        dropped.add(&[bus], counters.dropped_bytes);
        let name = |index: usize| line.devices.get(index).map_or("", |device| device.name.as_str());
        for (subject, count) in &tally.requests {
            let device = ("device", subject.station.map_or("", name));
            let (function, code) = (subject.function.to_string(), subject.code.to_string());
            let labels = [bus, device, ("function", &*function), ("outcome", subject.outcome), ("code", &*code)];
            requests.add(&labels, count);
        }
        for (index, reply_times) in &tally.reply_times {
            add_times(&mut times, &[bus, ("device", name(*index))], reply_times);
        }
        for (kind, count) in &tally.hits {
            faults.add(&[bus, ("kind", kind)], count);
        }
        for (index, (starts, is_powered)) in stations.iter().enumerate() {
            boots.add(&[bus, ("device", name(index))], starts);
            powered.add(&[bus, ("device", name(index))], u8::from(*is_powered));
        }
    }
    let all = [elapsed, rate, frames, bad, dropped, requests, times, faults, boots, powered];
    all.iter().map(Metric::text).collect()
}

fn add_times(metric: &mut Metric, labels: &[(&str, &str); 2], times: &ReplyTimes) {
    let [bus, device] = *labels;
    let mut count = 0;
    for (index, own) in times.counts.iter().enumerate() {
        count += own;
        let bound = REPLY_BOUNDS_US.get(index).map_or("+Inf".into(), |us| (*us as f64 / 1e6).to_string());
        metric.add_as("_bucket", &[bus, device, ("le", &bound)], count);
    }
    metric.add_as("_sum", labels, times.sum_us as f64 / 1e6);
    metric.add_as("_count", labels, count);
}
