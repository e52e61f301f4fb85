//! `/api/faults`: things that go wrong on purpose.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ArrayBuilder, Object, ObjectBuilder, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

use super::app::{App, Line};
use super::devices::nearest;
use super::director::Order;
use super::error::{ApiError, Failure};
use super::input::{Body, Segment};
use crate::bus::Bus;
use crate::faults::{Active, Fault, FaultKind, Place, Target};
use crate::time::Instant;

/// A fault. What a kind needs stands with the field; a field that a kind does not have is refused.
#[derive(Clone, Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FaultPlan {
    /// `drop`: the request is lost. `delay`: the reply comes later. `exception`: the device answers an exception and does
    /// nothing. `bad_crc`, `truncate`, `garbage`, `wrong_unit`, `wrong_function`, `split`: so comes the reply. `stale`: the
    /// previous reply once more. `echo`: the request comes back first. `offline`: the cable is pulled. `noise`: bytes that
    /// nobody asked for. `stuck_register`: reads show one number.
    #[schema(value_type = KindName)]
    kind: String,
    /// The bus.
    bus: String,
    /// The device; absent: all of the bus.
    device: Option<String>,
    /// Function codes; absent: all.
    #[schema(value_type = Option<Vec<FunctionCode>>)]
    functions: Option<Vec<u8>>,
    /// First and last address of ranges, both included, one of which the request touches; absent: all.
    #[schema(value_type = Option<Vec<AddressRange>>)]
    addresses: Option<Vec<(u16, u16)>>,
    /// How likely it hits, 0 to 1; absent: 1.
    #[schema(minimum = 0, maximum = 1)]
    probability: Option<f64>,
    /// How often it hits before it is spent; absent: without end.
    #[schema(minimum = 1)]
    count: Option<u64>,
    /// Real seconds until it is spent; absent: never.
    #[schema(minimum = 0, maximum = 31536000)]
    for_s: Option<f64>,
    /// What chance is drawn from; absent: the fault's number.
    seed: Option<u64>,
    /// Of `delay`: milliseconds, 0 to 600000.
    #[schema(minimum = 0, maximum = 600000)]
    ms: Option<u64>,
    /// Of `delay`: the most milliseconds that chance adds; absent: 0.
    #[schema(minimum = 0, maximum = 600000)]
    jitter_ms: Option<u64>,
    /// Of `exception`: the code, 1 to 255.
    #[schema(minimum = 1, maximum = 255)]
    code: Option<u8>,
    /// Of `truncate`: bytes that are missing at the end, 1 to 256. Of `garbage`: bytes that come with the reply.
    #[schema(minimum = 1, maximum = 256)]
    bytes: Option<usize>,
    /// Of `garbage`: before or after the reply; absent: before.
    #[schema(value_type = Option<PlaceName>)]
    place: Option<String>,
    /// Of `split`: bytes of the first piece, 1 to 255.
    #[schema(minimum = 1, maximum = 255)]
    at: Option<usize>,
    /// Of `split`: milliseconds between the pieces, 0 to 600000.
    #[schema(minimum = 0, maximum = 600000)]
    gap_ms: Option<u64>,
    /// Of `noise`: bursts a minute on the average, 1 to 6000.
    #[schema(minimum = 1, maximum = 6000)]
    per_minute: Option<u32>,
    /// Of `stuck_register`: the register or coil, of the device that is named.
    name: Option<String>,
    /// Of `stuck_register`: the raw number that it shows.
    value: Option<i64>,
}

/// The kinds of faults.
#[derive(Debug, ToSchema)]
#[schema(rename_all = "snake_case")]
#[expect(dead_code, reason = "it only describes a field")]
pub enum KindName {
    Drop,
    Delay,
    Exception,
    BadCrc,
    Truncate,
    Garbage,
    WrongUnit,
    WrongFunction,
    Split,
    Stale,
    Echo,
    Offline,
    Noise,
    StuckRegister,
}

/// Sides of a reply.
#[derive(Debug, ToSchema)]
#[schema(rename_all = "snake_case")]
#[expect(dead_code, reason = "it only describes a field")]
pub enum PlaceName {
    Before,
    After,
}

/// A function code, for the description.
#[derive(Debug)]
pub struct FunctionCode;

impl PartialSchema for FunctionCode {
    fn schema() -> RefOr<Schema> {
        whole(1, 127).into()
    }
}

impl ToSchema for FunctionCode {}

/// First and last address of a range, for the description.
#[derive(Debug)]
pub struct AddressRange;

impl PartialSchema for AddressRange {
    fn schema() -> RefOr<Schema> {
        ArrayBuilder::new().items(whole(0, 65_535)).min_items(Some(2)).max_items(Some(2)).into()
    }
}

impl ToSchema for AddressRange {}

fn whole(min: u32, max: u32) -> Object {
    ObjectBuilder::new().schema_type(Type::Integer).minimum(Some(min)).maximum(Some(max)).build()
}

/// A fault and what it has done.
#[derive(Clone, Debug, Default, Serialize, ToSchema)]
pub struct FaultView {
    /// Its number.
    id: u64,
    /// What it does.
    kind: &'static str,
    /// The bus.
    bus: String,
    /// Whether it may still hit: its count and time are not used up.
    active: bool,
    /// How often it has hit.
    hits: u64,
    /// How likely it hits.
    probability: f64,
    /// What its chance is drawn from.
    seed: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    functions: Option<Vec<u8>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Vec<AddressRange>>)]
    addresses: Option<Vec<(u16, u16)>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    count: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    for_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ms: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    jitter_ms: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    code: Option<u8>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    place: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gap_ms: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    per_minute: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    value: Option<i64>,
}

/// Milliseconds of a delay or gap, at most.
const MS_MAX: u64 = 600_000;

/// What a range of numbers says of a field.
fn within<T: PartialOrd + std::fmt::Display + Copy>(field: &str, value: T, min: T, max: T) -> Result<T, ApiError> {
    if min <= value && value <= max {
        return Ok(value);
    }
    Err(ApiError::value(format!("{field} takes {min} to {max}, not {value}")).of(field))
}

/// The kinds, and the fields that each has beside those of all; a `?` marks what may be left out.
const KINDS: &[(&str, &[&str])] = &[
    ("drop", &[]),
    ("delay", &["ms", "jitter_ms?"]),
    ("exception", &["code"]),
    ("bad_crc", &[]),
    ("truncate", &["bytes"]),
    ("garbage", &["bytes", "place?"]),
    ("wrong_unit", &[]),
    ("wrong_function", &[]),
    ("split", &["at", "gap_ms"]),
    ("stale", &[]),
    ("echo", &[]),
    ("offline", &[]),
    ("noise", &["per_minute"]),
    ("stuck_register", &["name", "value"]),
];

impl FaultPlan {
    /// The fault that is meant, but for its number and the words of a stuck register; and the index of its device.
    fn judge(&self, line: &Line) -> Result<(Target, PlannedKind), ApiError> {
        self.judge_fields()?;
        let station = self.device.as_deref().map(|name| self.station(line, name)).transpose()?;
        let functions = self.functions.clone().unwrap_or_default();
        for function in &functions {
            within("functions", *function, 1, 127)?;
        }
        let addresses = self.addresses.clone().unwrap_or_default();
        if let Some((first, last)) = addresses.iter().find(|(first, last)| first > last) {
            let message = format!("addresses takes first and last, in that order, not [{first}, {last}]");
            return Err(ApiError::value(message).of("addresses"));
        }
        let kind = self.judge_kind(line, station)?;
        let is_of_the_line = matches!(kind, PlannedKind::Kind(FaultKind::Offline | FaultKind::Noise { .. }));
        if is_of_the_line && (station.is_some() || self.functions.is_some() || self.addresses.is_some()) {
            let message = format!("{} is of the whole bus and takes no device, functions or addresses", self.kind);
            return Err(ApiError::value(message).of("device"));
        }
        Ok((Target { station, functions, addresses }, kind))
    }

    fn station(&self, line: &Line, name: &str) -> Result<usize, ApiError> {
        let found = line.devices.iter().position(|device| device.name == name);
        found.ok_or_else(|| {
            let names = line.devices.iter().map(|device| device.name.as_str());
            ApiError::none_of(&format!("device {name} on"), &self.bus, names).of("device")
        })
    }

    /// Refuses fields that the kind does not have, and the lack of those that it needs.
    fn judge_fields(&self) -> Result<(), ApiError> {
        let fields = KINDS.iter().find(|(kind, _)| *kind == self.kind).map(|(_, fields)| *fields);
        let fields = fields.ok_or_else(|| {
            let names: Vec<&str> = KINDS.iter().map(|(kind, _)| *kind).collect();
            ApiError::value(format!("kind takes {}, not {:?}", names.join(", "), self.kind)).of("kind")
        })?;
        let given = [
            ("ms", self.ms.is_some()),
            ("jitter_ms", self.jitter_ms.is_some()),
            ("code", self.code.is_some()),
            ("bytes", self.bytes.is_some()),
            ("place", self.place.is_some()),
            ("at", self.at.is_some()),
            ("gap_ms", self.gap_ms.is_some()),
            ("per_minute", self.per_minute.is_some()),
            ("name", self.name.is_some()),
            ("value", self.value.is_some()),
        ];
        for (field, is_given) in given {
            let needed = fields.contains(&field);
            let allowed = needed || fields.iter().any(|other| other.strip_suffix('?') == Some(field));
            if is_given && !allowed {
                return Err(ApiError::value(format!("{} has no {field}", self.kind)).of(field));
            }
            if needed && !is_given {
                return Err(ApiError::value(format!("{} needs {field}", self.kind)).of(field));
            }
        }
        Ok(())
    }

    fn judge_kind(&self, line: &Line, station: Option<usize>) -> Result<PlannedKind, ApiError> {
        let ms = |field, value: Option<u64>| within(field, value.unwrap_or(0), 0, MS_MAX);
        let kind = match self.kind.as_str() {
            "drop" => FaultKind::Drop,
            "delay" => FaultKind::Delay { ms: ms("ms", self.ms)?, jitter_ms: ms("jitter_ms", self.jitter_ms)? },
            "exception" => FaultKind::Exception { code: within("code", self.code.unwrap_or(0), 1, 255)? },
            "bad_crc" => FaultKind::BadCrc,
            "truncate" => FaultKind::Truncate { bytes: within("bytes", self.bytes.unwrap_or(0), 1, 256)? },
            "garbage" => {
                let place = match self.place.as_deref() {
                    None | Some("before") => Place::Before,
                    Some("after") => Place::After,
                    Some(other) => {
                        return Err(ApiError::value(format!("place takes before or after, not {other:?}")).of("place"));
                    }
                };
                FaultKind::Garbage { bytes: within("bytes", self.bytes.unwrap_or(0), 1, 256)?, place }
            }
            "wrong_unit" => FaultKind::WrongUnit,
            "wrong_function" => FaultKind::WrongFunction,
            "split" => {
                FaultKind::Split { at: within("at", self.at.unwrap_or(0), 1, 255)?, gap_ms: ms("gap_ms", self.gap_ms)? }
            }
            "stale" => FaultKind::Stale,
            "echo" => FaultKind::Echo,
            "offline" => FaultKind::Offline,
            "noise" => FaultKind::Noise { per_minute: within("per_minute", self.per_minute.unwrap_or(0), 1, 6000)? },
            _ => return self.stuck(line, station),
        };
        Ok(PlannedKind::Kind(kind))
    }

    fn stuck(&self, line: &Line, station: Option<usize>) -> Result<PlannedKind, ApiError> {
        let station = station.ok_or_else(|| ApiError::value("stuck_register needs device").of("device"))?;
        let name = self.name.as_deref().unwrap_or_default();
        let device = &line.devices[station];
        let member = device.layout.named(name).ok_or_else(|| {
            let names: Vec<String> = device.layout.members().map(|member| member.name()).collect();
            let hint = nearest(name, names.iter().map(String::as_str)).map(|name| format!("; do you mean {name}?"));
            let message = format!("{} has no register {name}{}", device.name, hint.unwrap_or_default());
            ApiError::value(message).of("name")
        })?;
        Ok(PlannedKind::Stuck { station, member, value: self.value.unwrap_or(0) })
    }
}

/// The kind of a fault, as far as it is known without asking the device.
#[derive(Clone, Copy, Debug)]
enum PlannedKind {
    Kind(FaultKind),
    Stuck { station: usize, member: crate::image::Member, value: i64 },
}

impl PlannedKind {
    /// The words of a stuck register depend on how many decimals the device's options give it.
    async fn settle(self, line: &Line) -> Result<FaultKind, ApiError> {
        let PlannedKind::Stuck { station, member, value } = self else {
            let PlannedKind::Kind(kind) = self else { return Err(ApiError::value("no kind")) };
            return Ok(kind);
        };
        let scale = line.call(move |bus, _| bus.stations()[station].scale(member)).await?;
        let words = member.row.format.encode(value, scale).ok_or_else(|| {
            let (name, format) = (member.name(), member.row.format.name());
            ApiError::value(format!("{name} is a {format}, which cannot hold {value}")).of("value")
        })?;
        Ok(FaultKind::StuckRegister { member, words, value })
    }
}

impl FaultView {
    fn new(line: &Line, active: &Active, is_active: bool) -> Self {
        let Fault { id, kind, target, probability, count, lasts_us, seed } = active.fault().clone();
        let mut view = Self {
            id,
            kind: kind.name(),
            bus: line.handle.name.clone(),
            active: is_active,
            hits: active.hits(),
            probability,
            seed,
            device: target.station.map(|index| line.devices[index].name.clone()),
            functions: (!target.functions.is_empty()).then_some(target.functions),
            addresses: (!target.addresses.is_empty()).then_some(target.addresses),
            count,
            for_s: lasts_us.map(|us| us as f64 / 1e6),
            ..Self::default()
        };
        match kind {
            FaultKind::Delay { ms, jitter_ms } => (view.ms, view.jitter_ms) = (Some(ms), Some(jitter_ms)),
            FaultKind::Exception { code } => view.code = Some(code),
            FaultKind::Truncate { bytes } => view.bytes = Some(bytes),
            FaultKind::Garbage { bytes, place } => {
                view.bytes = Some(bytes);
                view.place = Some(if place == Place::Before { "before" } else { "after" });
            }
            FaultKind::Split { at, gap_ms } => (view.at, view.gap_ms) = (Some(at), Some(gap_ms)),
            FaultKind::Noise { per_minute } => view.per_minute = Some(per_minute),
            FaultKind::StuckRegister { member, value, .. } => {
                (view.name, view.value) = (Some(member.name()), Some(value));
            }
            FaultKind::Drop
            | FaultKind::BadCrc
            | FaultKind::WrongUnit
            | FaultKind::WrongFunction
            | FaultKind::Stale
            | FaultKind::Echo
            | FaultKind::Offline => {}
        }
        view
    }
}

fn with_state(bus: &Bus, now: Instant) -> Vec<(Active, bool)> {
    let list = bus.faults().list();
    list.iter().map(|active| (active.clone(), bus.is_fault_active(now, active.fault().id))).collect()
}

async fn all(app: &App) -> Result<Vec<FaultView>, ApiError> {
    let mut views = Vec::new();
    for line in &app.buses {
        let faults = line.call(|bus, now| with_state(bus, now)).await?;
        views.extend(faults.iter().map(|(active, is_active)| FaultView::new(line, active, *is_active)));
    }
    views.sort_by_key(|view| view.id);
    Ok(views)
}

async fn one(app: &App, id: &str) -> Result<FaultView, ApiError> {
    let views = all(app).await?;
    let ids: Vec<String> = views.iter().map(|view| view.id.to_string()).collect();
    let found = views.into_iter().zip(&ids).find(|(_, known)| *known == id).map(|(view, _)| view);
    found.ok_or_else(|| ApiError::none_of("fault", id, ids.iter().map(String::as_str)))
}

/// All faults, spent ones too, in the order in which they were added.
#[utoipa::path(get, path = "/api/faults", tag = "faults", operation_id = "faults",
    responses((status = 200, body = Vec<FaultView>), (status = "default", body = Failure, description = "An error")))]
pub async fn list(State(app): State<App>) -> Result<Json<Vec<FaultView>>, ApiError> {
    all(&app).await.map(Json)
}

/// One fault.
#[utoipa::path(get, path = "/api/faults/{id}", tag = "faults", operation_id = "fault",
    params(("id" = u64, Path, description = "The fault's number")),
    responses((status = 200, body = FaultView), (status = "default", body = Failure, description = "An error")))]
pub async fn show(State(app): State<App>, Segment(id): Segment<String>) -> Result<Json<FaultView>, ApiError> {
    one(&app, &id).await.map(Json)
}

/// Adds a fault behind those of its bus.
#[utoipa::path(post, path = "/api/faults", tag = "faults", operation_id = "add_fault", request_body = FaultPlan,
    responses((status = 201, body = FaultView), (status = "default", body = Failure, description = "An error")))]
pub async fn add(
    State(app): State<App>,
    Body(plan): Body<FaultPlan>,
) -> Result<(StatusCode, Json<FaultView>), ApiError> {
    let (index, line) = app.bus(&plan.bus).map_err(|error| error.of("bus"))?;
    let (target, kind) = plan.judge(line)?;
    let probability = within("probability", plan.probability.unwrap_or(1.0), 0.0, 1.0)?;
    let count = plan.count.map(|count| within("count", count, 1, u64::MAX)).transpose()?;
    let for_s = plan.for_s.map(|seconds| within("for_s", seconds, 0.0, 31_536_000.0)).transpose()?;
    let lasts_us = for_s.map(|seconds| (seconds * 1e6) as u64);
    let kind = kind.settle(line).await?;
    let seed = plan.seed.unwrap_or(0);
    let fault = Box::new(Fault { id: 0, kind, target, probability, count, lasts_us, seed });
    let has_seed = plan.seed.is_some();
    let id = Order::send(&app.director, |answer| Order::AddFault(index, fault, has_seed, answer)).await?;
    Ok((StatusCode::CREATED, Json(one(&app, &id.to_string()).await?)))
}

/// Takes all faults away.
#[utoipa::path(delete, path = "/api/faults", tag = "faults", operation_id = "clear_faults",
    responses((status = 204), (status = "default", body = Failure, description = "An error")))]
pub async fn clear(State(app): State<App>) -> Result<StatusCode, ApiError> {
    for line in &app.buses {
        line.call(|bus, _| bus.clear_faults()).await?;
    }
    Ok(StatusCode::NO_CONTENT)
}

/// Takes a fault away; the answer shows what it has done.
#[utoipa::path(delete, path = "/api/faults/{id}", tag = "faults", operation_id = "remove_fault",
    params(("id" = u64, Path, description = "The fault's number")),
    responses((status = 200, body = FaultView), (status = "default", body = Failure, description = "An error")))]
pub async fn remove(State(app): State<App>, Segment(id): Segment<String>) -> Result<Json<FaultView>, ApiError> {
    let view = one(&app, &id).await?;
    let id = view.id;
    for line in &app.buses {
        line.call(move |bus, _| bus.remove_fault(id)).await?;
    }
    Ok(Json(view))
}
