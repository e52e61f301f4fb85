//! `/api/devices`: devices, their registers, the world that they measure, their power.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ObjectBuilder, Schema, SchemaType, Type};
use utoipa::{IntoParams, PartialSchema, ToSchema};

use super::app::App;
use super::error::{ApiError, Failure};
use super::input::{Body, Named, Query, Segment};
use super::status::LineView;
use crate::device::Kind;
use crate::export;
use crate::image::{Layout, Member, Origin};
use crate::journal::Known;
use crate::map::Access;
use crate::station::Station;
use crate::wire::Exception;
use crate::world::InputRange;

/// A device as it is now.
#[derive(Debug, Serialize, ToSchema)]
pub struct DeviceView {
    /// Its name.
    name: String,
    /// Its model.
    model: &'static str,
    /// What it is.
    title: &'static str,
    /// The bus that it is on.
    bus: String,
    /// The unit that it answers.
    unit: u8,
    /// Whether it has power.
    powered: bool,
    /// Whether it listens: it has power and is not restarting.
    listening: bool,
    /// Whether its plug is in.
    plugged: bool,
    /// How often it has started.
    boots: u32,
    /// The line settings that it uses.
    line: LineView,
    /// The world that it measures, by name.
    inputs: BTreeMap<String, InputView>,
    /// Coils and discrete inputs, by name.
    coils: BTreeMap<String, Reading>,
    /// Holding and input registers, by name.
    registers: BTreeMap<String, Reading>,
}

/// A quantity of the world.
#[derive(Debug, Serialize, ToSchema)]
pub struct InputView {
    /// Its value in engineering units, or true or false.
    #[schema(value_type = Quantity)]
    value: Value,
    /// Unit of measure; empty where it has none.
    unit: &'static str,
    /// What it means.
    about: &'static str,
    /// Least; `null` for true or false.
    min: Option<f64>,
    /// Most; `null` for true or false.
    max: Option<f64>,
    /// The clause that it comes from.
    clause: &'static str,
}

/// What a register shows.
#[derive(Debug, Serialize, ToSchema)]
pub struct Reading {
    /// The number on the wire.
    raw: i64,
    /// What it stands for, in `unit`; true or false for a bit.
    #[schema(value_type = Quantity)]
    value: Value,
    /// Unit of measure; empty where it has none.
    unit: &'static str,
}

/// One line of a device's register table.
#[derive(Debug, Serialize, ToSchema)]
pub struct RegisterView {
    /// `coil`, `discrete`, `input` or `holding`.
    bank: &'static str,
    /// Address on the wire of its first word.
    address: u16,
    /// Its name.
    name: String,
    /// What it means.
    about: &'static str,
    /// Unit of measure; empty where it has none.
    unit: &'static str,
    /// The number on the wire.
    raw: i64,
    /// What it stands for, in `unit`; true or false for a bit.
    #[schema(value_type = Quantity)]
    value: Value,
    /// Its words on the wire, the first address first; a bit is 0 or 1.
    words: Vec<u16>,
    /// `read`, `read-write` or `command`.
    access: &'static str,
    /// What a write may carry; empty where it is only read.
    range: String,
    /// The clause that it comes from.
    clause: &'static str,
}

/// The plug of a device.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PowerChange {
    /// Whether it is in.
    on: bool,
}

/// How registers are written.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct WriteMode {
    /// Set any row within its type, read-only ones too, without asking the device. What a device measures or counts it
    /// shows anew at its next step; the fault `stuck_register` holds a number.
    #[serde(default)]
    #[param(default = false)]
    force: bool,
}

/// What a value may be, for the description: a number, or true or false.
#[derive(Debug)]
pub struct Quantity;

impl PartialSchema for Quantity {
    fn schema() -> RefOr<Schema> {
        let types = SchemaType::from_iter([Type::Number, Type::Boolean]);
        ObjectBuilder::new().schema_type(types).description(Some("A number, or true or false")).into()
    }
}

impl ToSchema for Quantity {}

/// A number without a needless fraction.
pub fn number(value: f64) -> Value {
    if value.fract() == 0.0 && value.abs() < 1e15 { Value::from(value as i64) } else { Value::from(value) }
}

/// What a raw number stands for.
pub fn value_of(member: Member, scale: u8, raw: i64) -> Value {
    match (member.row.bank.is_bits(), scale) {
        (true, _) => Value::from(raw != 0),
        (false, 0) => Value::from(raw),
        (false, digits) => number(raw as f64 / 10f64.powi(i32::from(digits))),
    }
}

fn reading(station: &Station, member: Member) -> Reading {
    let raw = station.raw(member);
    Reading { raw, value: value_of(member, station.scale(member), raw), unit: member.row.unit }
}

fn input_view(station: &Station, index: usize) -> InputView {
    let input = &station.kind().inputs[index];
    let value = station.world().value(index);
    let (min, max) = match input.range {
        InputRange::Flag { .. } => (None, None),
        InputRange::Number { min, max, .. } => (Some(min), Some(max)),
    };
    let value = if input.is_flag() { Value::from(value != 0.0) } else { number(value) };
    InputView { value, unit: input.unit, about: input.about.trim(), min, max, clause: input.cite }
}

impl DeviceView {
    fn new(bus: &str, station: &Station) -> Self {
        let kind = station.kind();
        let address = station.address();
        let (bits, words): (Vec<Member>, Vec<Member>) =
            station.layout().members().partition(|member| member.row.bank.is_bits());
        let readings = |members: Vec<Member>| {
            members.into_iter().map(|member| (member.name(), reading(station, member))).collect::<BTreeMap<_, _>>()
        };
        Self {
            name: station.name().into(),
            model: kind.name,
            title: kind.title,
            bus: bus.into(),
            unit: address.unit,
            powered: station.is_powered(),
            listening: station.is_listening(),
            plugged: station.is_plugged(),
            boots: station.boots(),
            line: address.line.into(),
            inputs: (0..kind.inputs.len())
                .map(|index| (kind.inputs[index].name(), input_view(station, index)))
                .collect(),
            coils: readings(bits),
            registers: readings(words),
        }
    }
}

/// All devices as they are now.
#[utoipa::path(get, path = "/api/devices", tag = "devices", operation_id = "devices",
    responses((status = 200, body = Vec<DeviceView>), (status = "default", body = Failure, description = "An error")))]
pub async fn list(State(app): State<App>) -> Result<Json<Vec<DeviceView>>, ApiError> {
    let mut devices = Vec::new();
    for line in &app.buses {
        let stations = line.stations().await?;
        devices.extend(stations.iter().map(|station| DeviceView::new(&line.handle.name, station)));
    }
    Ok(Json(devices))
}

/// One device as it is now.
#[utoipa::path(get, path = "/api/devices/{name}", tag = "devices", operation_id = "device",
    params(("name" = String, Path, description = "The device")),
    responses((status = 200, body = DeviceView), (status = "default", body = Failure, description = "An error")))]
pub async fn show(State(app): State<App>, Segment(name): Segment<String>) -> Result<Json<DeviceView>, ApiError> {
    view(&app, &name).await
}

async fn view(app: &App, name: &str) -> Result<Json<DeviceView>, ApiError> {
    let (line, index) = app.device(name)?;
    let station = line.station(index).await?;
    Ok(Json(DeviceView::new(&line.handle.name, &station)))
}

/// Every row of a device's table, bank by bank with addresses ascending.
#[utoipa::path(get, path = "/api/devices/{name}/registers", tag = "devices", operation_id = "registers",
    params(("name" = String, Path, description = "The device")),
    responses((status = 200, body = Vec<RegisterView>), (status = "default", body = Failure, description = "An error")))]
pub async fn registers(
    State(app): State<App>,
    Segment(name): Segment<String>,
) -> Result<Json<Vec<RegisterView>>, ApiError> {
    let (line, index) = app.device(&name)?;
    let station = line.station(index).await?;
    let row = |member: Member| {
        let Reading { raw, value, unit } = reading(&station, member);
        RegisterView {
            bank: member.row.bank.name(),
            address: member.addr(),
            name: member.name(),
            about: member.row.about.trim(),
            unit,
            raw,
            value,
            words: station.regs().words(member).to_vec(),
            access: export::access(member.row),
            range: if member.row.access == Access::Read { String::new() } else { member.row.allowed() },
            clause: member.row.cite,
        }
    };
    Ok(Json(station.layout().members().map(row).collect()))
}

/// Writes registers and coils: raw numbers by name, as one write by the device's own rules, as from its front panel. The
/// answer shows what they are now.
#[utoipa::path(patch, path = "/api/devices/{name}/registers", tag = "devices", operation_id = "write_registers",
    params(("name" = String, Path, description = "The device"), WriteMode), request_body = BTreeMap<String, i64>,
    responses((status = 200, body = BTreeMap<String, Reading>),
        (status = "default", body = Failure, description = "An error")))]
pub async fn write(
    State(app): State<App>,
    Segment(name): Segment<String>,
    Query(WriteMode { force }): Query<WriteMode>,
    Body(Named(values)): Body<Named>,
) -> Result<Json<BTreeMap<String, Reading>>, ApiError> {
    let (line, index) = app.device(&name)?;
    let device = &line.devices[index];
    let values = values.iter().map(|(name, value)| written(device, name, value)).collect::<Result<Vec<_>, _>>()?;
    let written = line.call(move |bus, now| {
        bus.with_station(now, index, |station, moment| {
            if force {
                force_all(station, &values)?;
            } else if !station.is_listening() {
                return Err(not_running(station));
            } else {
                station.write_registers(&values, Origin::Panel, moment).map_err(|refusal| {
                    let only = if let [(member, _)] = values[..] { Some(member.name()) } else { None };
                    let error = match refusal.exception {
                        Exception::DeviceFailure => ApiError::state(refusal.to_string()),
                        _ => ApiError::refused(&refusal),
                    };
                    only.into_iter().fold(error, ApiError::of)
                })?;
            }
            Ok(values.iter().map(|(member, _)| (member.name(), reading(station, *member))).collect())
        })
    });
    written.await?.map(Json)
}

fn written(device: &Known, name: &str, value: &Value) -> Result<(Member, i64), ApiError> {
    let member = device.layout.named(name).ok_or_else(|| unknown_register(device.kind, &device.layout, name))?;
    let raw = match value {
        Value::Bool(flag) if member.row.bank.is_bits() => Some(i64::from(*flag)),
        // 5.0 is a whole number, too.
        value => value.as_i64().or_else(|| {
            value.as_f64().filter(|number| number.fract() == 0.0 && number.abs() < 9e15).map(|number| number as i64)
        }),
    };
    let raw = raw.ok_or_else(|| {
        let message = format!("{name} takes the raw number, {}, not {value}", member.row.allowed());
        ApiError::value(message).of(name)
    })?;
    Ok((member, raw))
}

fn unknown_register(kind: &Kind, layout: &Layout, name: &str) -> ApiError {
    let names: Vec<String> = layout.members().map(|member| member.name()).collect();
    let nearest = nearest(name, names.iter().map(String::as_str));
    let hint = nearest.map_or_else(|| format!("`standin registers {}` lists them", kind.name), meant);
    ApiError::unknown_field(name, format!("{} has no register {name}; {hint}", kind.name))
}

fn meant(name: &str) -> String {
    format!("do you mean {name}?")
}

/// The known name that is most like this one, if any is.
pub fn nearest<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let scored = known.map(|other| (strsim::jaro_winkler(name, other), other));
    scored.filter(|(score, _)| *score > 0.8).max_by(|one, other| one.0.total_cmp(&other.0)).map(|(_, name)| name)
}

fn force_all(station: &mut Station, values: &[(Member, i64)]) -> Result<(), ApiError> {
    for (member, raw) in values {
        if member.row.format.encode(*raw, station.scale(*member)).is_none() {
            let (name, format) = (member.name(), member.row.format.name());
            return Err(ApiError::value(format!("{name} is a {format}, which cannot hold {raw}")).of(name));
        }
    }
    for (member, raw) in values {
        station.force(*member, *raw);
    }
    Ok(())
}

fn not_running(station: &Station) -> ApiError {
    let state = if station.is_powered() { "is restarting" } else { "has no power" };
    ApiError::state(format!("{} {state}", station.name()))
}

/// Sets quantities of the world by name, in engineering units: all or nothing.
#[utoipa::path(patch, path = "/api/devices/{name}/inputs", tag = "devices", operation_id = "set_inputs",
    params(("name" = String, Path, description = "The device")), request_body = BTreeMap<String, Quantity>,
    responses((status = 200, body = BTreeMap<String, InputView>),
        (status = "default", body = Failure, description = "An error")))]
pub async fn set_inputs(
    State(app): State<App>,
    Segment(name): Segment<String>,
    Body(Named(values)): Body<Named>,
) -> Result<Json<BTreeMap<String, InputView>>, ApiError> {
    let (line, index) = app.device(&name)?;
    let kind = line.devices[index].kind;
    let values = values.iter().map(|(name, value)| measured(kind, name, value)).collect::<Result<Vec<_>, _>>()?;
    let shown = line.call(move |bus, now| {
        bus.with_station(now, index, |station, moment| {
            station.set_inputs(&values, moment);
            values.iter().map(|(input, _)| (kind.inputs[*input].name(), input_view(station, *input))).collect()
        })
    });
    Ok(Json(shown.await?))
}

fn measured(kind: &'static Kind, name: &str, value: &Value) -> Result<(usize, f64), ApiError> {
    let index = kind.input(name).ok_or_else(|| {
        let names: Vec<String> = kind.inputs.iter().map(|input| input.name()).collect();
        let hint = nearest(name, names.iter().map(String::as_str)).map_or_else(|| names.join(", "), meant);
        ApiError::unknown_field(name, format!("{} has no input {name}; {hint}", kind.name))
    })?;
    let input = &kind.inputs[index];
    let number = match value {
        Value::Bool(flag) if input.is_flag() => Some(f64::from(u8::from(*flag))),
        Value::Number(number) if !input.is_flag() => number.as_f64(),
        _ => None,
    };
    let number = number.filter(|number| input.admits(*number)).ok_or_else(|| {
        let message = format!("{name} takes {}, not {value} ({})", input.allowed(), input.cite);
        ApiError::value(message).of(name)
    })?;
    Ok((index, number))
}

/// Pulls the plug of a device, or puts it back.
#[utoipa::path(post, path = "/api/devices/{name}/power", tag = "devices", operation_id = "power",
    params(("name" = String, Path, description = "The device")), request_body = PowerChange,
    responses((status = 200, body = DeviceView), (status = "default", body = Failure, description = "An error")))]
pub async fn power(
    State(app): State<App>,
    Segment(name): Segment<String>,
    Body(PowerChange { on }): Body<PowerChange>,
) -> Result<Json<DeviceView>, ApiError> {
    let (line, index) = app.device(&name)?;
    line.call(move |bus, now| bus.with_station(now, index, |station, moment| station.set_plug(on, moment))).await?;
    view(&app, &name).await
}

/// Restarts a device; it is silent for its `boot_ms`.
#[utoipa::path(post, path = "/api/devices/{name}/restart", tag = "devices", operation_id = "restart",
    params(("name" = String, Path, description = "The device")),
    responses((status = 200, body = DeviceView), (status = "default", body = Failure, description = "An error")))]
pub async fn restart(State(app): State<App>, Segment(name): Segment<String>) -> Result<Json<DeviceView>, ApiError> {
    while_running(&app, &name, |station, moment| station.restart(moment)).await
}

/// Returns a device to its factory settings, as its own panel would.
#[utoipa::path(post, path = "/api/devices/{name}/factory-reset", tag = "devices", operation_id = "factory_reset",
    params(("name" = String, Path, description = "The device")),
    responses((status = 200, body = DeviceView), (status = "default", body = Failure, description = "An error")))]
pub async fn factory_reset(
    State(app): State<App>,
    Segment(name): Segment<String>,
) -> Result<Json<DeviceView>, ApiError> {
    while_running(&app, &name, |station, moment| station.factory_reset(moment)).await
}

async fn while_running(
    app: &App,
    name: &str,
    act: impl FnOnce(&mut Station, crate::time::Moment) + Send + 'static,
) -> Result<Json<DeviceView>, ApiError> {
    let (line, index) = app.device(name)?;
    let done = line.call(move |bus, now| {
        bus.with_station(now, index, |station, moment| {
            if !station.is_listening() {
                return Err(not_running(station));
            }
            act(station, moment);
            Ok(())
        })
    });
    done.await??;
    view(app, name).await
}
