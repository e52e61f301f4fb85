//! `/api/journal`: what was asked, what came of it and why.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::app::{App, Line};
use super::clock::{civil_text, elapsed_s};
use super::error::{ApiError, Failure};
use super::input::Query;
use crate::bus::{Exchange, Record, outcome_name};
use crate::journal::{Asked, Filter, Known, hint, values_read};
use crate::station::Outcome;
use crate::wire::function_name;

/// Which requests; what is not said does not matter.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct JournalQuery {
    /// Of this bus.
    bus: Option<String>,
    /// To this device.
    device: Option<String>,
    /// Of this function code.
    #[param(maximum = 255)]
    function: Option<u8>,
    /// That came to this.
    #[param(inline)]
    outcome: Option<OutcomeName>,
    /// That touch this address.
    #[param(maximum = 65535)]
    address: Option<u16>,
    /// From this real second since the start on.
    #[param(minimum = 0, maximum = 1000000000)]
    since: Option<f64>,
}

/// Which requests, and how many.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct ListQuery {
    /// Of this bus.
    bus: Option<String>,
    /// To this device.
    device: Option<String>,
    /// Of this function code.
    #[param(maximum = 255)]
    function: Option<u8>,
    /// That came to this.
    #[param(inline)]
    outcome: Option<OutcomeName>,
    /// That touch this address.
    #[param(maximum = 65535)]
    address: Option<u16>,
    /// From this real second since the start on.
    #[param(minimum = 0, maximum = 1000000000)]
    since: Option<f64>,
    /// The last so many of each bus; absent: all that are kept.
    limit: Option<usize>,
}

/// What came of a request.
#[derive(Clone, Copy, Debug, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutcomeName {
    /// A reply.
    Reply,
    /// An exception.
    Exception,
    /// No answer.
    Silence,
}

/// A request that is kept.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Entry {
    /// Its number on its bus, ascending.
    id: u64,
    #[serde(flatten)]
    exchange: ExchangeView,
    /// What it may have been meant to be, where it looks like a common mistake; else `null`.
    hint: Option<String>,
}

/// A request and what came of it.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ExchangeView {
    /// The bus.
    pub bus: String,
    /// Real seconds since the start when its last byte was there.
    elapsed_s: f64,
    /// Simulated date and time then.
    now: String,
    /// The unit that it asked; 0 is a broadcast.
    unit: u8,
    /// The device that it reached; `null` for none.
    pub device: Option<String>,
    /// Function code.
    function: u8,
    /// What that is called.
    function_name: &'static str,
    /// First address, where it has one.
    address: Option<u16>,
    /// How many bits or registers, where it says.
    quantity: Option<u16>,
    /// The words that were written, or read; bits are 0 and 1.
    values: Vec<u16>,
    /// `reply`, `exception` or `silence`.
    outcome: &'static str,
    /// Exception code; `null` for none.
    code: Option<u8>,
    /// Why it was refused or not answered; `null` for a reply.
    reason: Option<String>,
    /// The clause that a refusal rests on.
    clause: Option<&'static str>,
    /// Milliseconds from its last byte until the reply left; `null` without one.
    reply_ms: Option<f64>,
    /// Unit, function and data of the request in hex; all bytes of what is no frame.
    request: String,
    /// Unit, function and data of the device's reply in hex; empty without one.
    reply: String,
    /// All bytes that left in hex, where faults made others of the reply; else `null`.
    sent: Option<String>,
    /// The faults that hit it.
    faults: Vec<FaultHit>,
}

/// A fault that hit a request.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub struct FaultHit {
    /// Its number.
    id: u64,
    /// What it does.
    kind: &'static str,
}

/// The latest second that may be asked for: thirty years.
const SINCE_MAX: f64 = 1e9;

/// How many requests.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub struct Count {
    /// How many of those kept.
    count: usize,
}

/// Bytes in hex, a space between two.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02X}")).collect::<Vec<_>>().join(" ")
}

impl Entry {
    /// An entry of a bus; `devices` are those of the bus, with the units that they have now.
    fn new(bus: &str, devices: &[Known], id: u64, exchange: &Exchange) -> Self {
        Self { id, exchange: ExchangeView::new(bus, devices, exchange), hint: hint(exchange, devices) }
    }
}

impl ExchangeView {
    /// What happened on a bus that has these devices.
    pub fn new(bus: &str, devices: &[Known], exchange: &Exchange) -> Self {
        let asked = Asked::of(exchange);
        let (reason, clause) = match &exchange.outcome {
            Outcome::Reply => (None, None),
            Outcome::Exception(refusal) => (Some(refusal.reason.to_string()), Some(refusal.cite)),
            Outcome::Silence(reason) => (Some((*reason).to_owned()), None),
        };
        let is_silent = matches!(exchange.outcome, Outcome::Silence(_));
        Self {
            bus: bus.into(),
            elapsed_s: elapsed_s(exchange.at),
            now: civil_text(exchange.at.civil),
            unit: exchange.unit,
            device: exchange.station.and_then(|index| devices.get(index)).map(|device| device.name.clone()),
            function: exchange.function(),
            function_name: function_name(exchange.function()),
            address: asked.as_ref().map(|asked| asked.start),
            quantity: asked.as_ref().map(|asked| asked.quantity),
            values: asked
                .map(|asked| asked.values)
                .filter(|values| !values.is_empty())
                .unwrap_or_else(|| values_read(exchange)),
            outcome: outcome_name(&exchange.outcome),
            code: exchange.exception_code(),
            reason,
            clause,
            reply_ms: (!is_silent).then_some(exchange.reply_us as f64 / 1e3),
            request: hex(&exchange.request),
            reply: hex(&exchange.reply),
            sent: exchange.sent.as_deref().map(hex),
            faults: exchange.faults.iter().map(|hit| FaultHit { id: hit.id, kind: hit.kind }).collect(),
        }
    }
}

impl JournalQuery {
    /// The buses that are meant, and the filter on each.
    fn lines<'a>(&self, app: &'a App) -> Result<Vec<(&'a Line, Filter)>, ApiError> {
        if let Some(since) = self.since.filter(|since| !(0.0..=SINCE_MAX).contains(since)) {
            let message = format!("since takes real seconds from 0 to {SINCE_MAX}, not {since}");
            return Err(ApiError::value(message).of("since"));
        }
        let filter = Filter {
            station: None,
            function: self.function,
            outcome: self.outcome.map(|outcome| match outcome {
                OutcomeName::Reply => "reply",
                OutcomeName::Exception => "exception",
                OutcomeName::Silence => "silence",
            }),
            address: self.address,
            since_us: self.since.map(|seconds| (seconds * 1e6) as u64),
        };
        let on_bus = self.bus.as_deref().map(|name| app.bus(name).map_err(|error| error.of("bus"))).transpose()?;
        let on_bus = on_bus.map(|(_, line)| line.handle.name.as_str());
        let is_meant = |line: &&Line| on_bus.is_none_or(|name| line.handle.name == name);
        match &self.device {
            None => Ok(app.buses.iter().filter(is_meant).map(|line| (line, filter.clone())).collect()),
            Some(name) => {
                let (line, index) = app.device(name).map_err(|error| error.of("device"))?;
                let filter = Filter { station: Some(index), ..filter };
                Ok(Some(line).filter(is_meant).map(|line| (line, filter)).into_iter().collect())
            }
        }
    }
}

/// The devices of a bus, with the units that they have now.
async fn known(line: &Line) -> Result<Vec<Known>, ApiError> {
    let units = line.call(|bus, _| bus.stations().iter().map(|station| station.address().unit).collect::<Vec<u8>>());
    let units = units.await?;
    Ok(line.devices.iter().zip(units).map(|(device, unit)| Known { unit, ..device.clone() }).collect())
}

/// The last requests, at most 10,000 of each bus, the oldest first.
#[utoipa::path(get, path = "/api/journal", tag = "journal", operation_id = "journal", params(ListQuery),
    responses((status = 200, body = Vec<Entry>), (status = "default", body = Failure, description = "An error")))]
pub async fn list(State(app): State<App>, Query(query): Query<ListQuery>) -> Result<Json<Vec<Entry>>, ApiError> {
    let ListQuery { bus, device, function, outcome, address, since, limit } = query;
    let query = JournalQuery { bus, device, function, outcome, address, since };
    let mut entries = Vec::new();
    for (line, filter) in query.lines(&app)? {
        let records = line.call(move |bus, _| {
            let records = bus.journal().into_iter().flat_map(|journal| journal.records().rev());
            let wanted = records.filter(|record| filter.admits(&record.exchange)).take(limit.unwrap_or(usize::MAX));
            wanted.cloned().collect::<Vec<Record>>()
        });
        let records = records.await?;
        let devices = known(line).await?;
        let entry = |record: &Record| Entry::new(&line.handle.name, &devices, record.id, &record.exchange);
        entries.extend(records.iter().rev().map(|record| (record.exchange.at.elapsed, entry(record))));
    }
    entries.sort_by_key(|(at, _)| *at);
    Ok(Json(entries.into_iter().map(|(_, entry)| entry).collect()))
}

/// How many of the last requests are so.
#[utoipa::path(get, path = "/api/journal/count", tag = "journal", operation_id = "journal_count", params(JournalQuery),
    responses((status = 200, body = Count), (status = "default", body = Failure, description = "An error")))]
pub async fn count(State(app): State<App>, Query(query): Query<JournalQuery>) -> Result<Json<Count>, ApiError> {
    let mut count = 0;
    for (line, filter) in query.lines(&app)? {
        let found = line.call(move |bus, _| {
            let records = bus.journal().into_iter().flat_map(|journal| journal.records());
            records.filter(|record| filter.admits(&record.exchange)).count()
        });
        count += found.await?;
    }
    Ok(Json(Count { count }))
}

/// Empties the journals.
#[utoipa::path(delete, path = "/api/journal", tag = "journal", operation_id = "clear_journal",
    responses((status = 204), (status = "default", body = Failure, description = "An error")))]
pub async fn clear(State(app): State<App>) -> Result<StatusCode, ApiError> {
    for line in &app.buses {
        line.call(|bus, _| bus.clear_journal()).await?;
    }
    Ok(StatusCode::NO_CONTENT)
}
