//! `GET /api/status`: what runs.

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::app::App;
use super::clock::ClockView;
use super::error::{ApiError, Failure};
use crate::bus::{LineCheck, Timing};
use crate::line::Line;

/// What runs.
#[derive(Debug, Serialize, ToSchema)]
pub struct Status {
    /// Version of the program.
    version: &'static str,
    /// Real seconds since the program started.
    elapsed_s: f64,
    /// Simulated time.
    clock: ClockView,
    /// The buses, in the order of devices.toml.
    buses: Vec<BusView>,
}

/// A bus.
#[derive(Debug, Serialize, ToSchema)]
pub struct BusView {
    /// Its name.
    name: String,
    /// What a client opens first.
    path: String,
    /// All its ports.
    ports: Vec<PortView>,
    /// Its line.
    line: LineView,
    /// `fast` or `wire` (BUS-17).
    timing: &'static str,
    /// `warn`, `enforce` or `off` (BUS-16).
    line_check: &'static str,
    /// What it has counted since the start or the last reset.
    counters: CountersView,
    /// Its devices.
    devices: Vec<String>,
}

/// A port of a bus.
#[derive(Debug, Serialize, ToSchema)]
pub struct PortView {
    /// As devices.toml names it.
    port: String,
    /// What a client opens.
    path: String,
}

/// Speed and character format of a line.
#[derive(Debug, Serialize, ToSchema)]
pub struct LineView {
    /// Bits a second.
    baud: u32,
    /// `none`, `even` or `odd`.
    parity: String,
    /// 1 or 2.
    stop_bits: u8,
}

impl From<Line> for LineView {
    fn from(line: Line) -> Self {
        Self { baud: line.baud, parity: line.parity.to_string(), stop_bits: line.stop_bits }
    }
}

/// What a bus has counted.
#[derive(Debug, Serialize, ToSchema)]
pub struct CountersView {
    /// Frames with a good CRC, other units' included.
    frames: u64,
    /// Replies without exceptions.
    replies: u64,
    /// Exceptions.
    exceptions: u64,
    /// Runs of bytes that were no frame.
    bad_crc: u64,
    /// Bytes of those.
    dropped_bytes: u64,
}

/// What runs.
#[utoipa::path(get, path = "/api/status", tag = "status", operation_id = "status",
    responses((status = 200, body = Status), (status = "default", body = Failure, description = "An error")))]
pub async fn show(State(app): State<App>) -> Result<Json<Status>, ApiError> {
    let mut buses = Vec::new();
    for line in &app.buses {
        let (settings, counters) = line.call(|bus, _| (*bus.settings(), bus.counters())).await?;
        let ports = line.handle.ports.iter();
        let ports: Vec<PortView> =
            ports.map(|(port, path)| PortView { port: port.to_string(), path: path.clone() }).collect();
        buses.push(BusView {
            name: line.handle.name.clone(),
            path: ports.first().map(|port| port.path.clone()).unwrap_or_default(),
            ports,
            line: settings.line.into(),
            timing: match settings.timing {
                Timing::Fast => "fast",
                Timing::Wire => "wire",
            },
            line_check: match settings.line_check {
                LineCheck::Warn => "warn",
                LineCheck::Enforce => "enforce",
                LineCheck::Off => "off",
            },
            counters: CountersView {
                frames: counters.frames,
                replies: counters.replies,
                exceptions: counters.exceptions,
                bad_crc: counters.bad_frames,
                dropped_bytes: counters.dropped_bytes,
            },
            devices: line.devices.iter().map(|device| device.name.clone()).collect(),
        });
    }
    let clock = ClockView::read(&app).await?;
    Ok(Json(Status { version: env!("CARGO_PKG_VERSION"), elapsed_s: clock.elapsed_s, clock, buses }))
}
