//! `/api/clock`: simulated time, and how it is moved.

use axum::Json;
use axum::extract::State;
use chrono::{NaiveDateTime, Timelike};
use serde::{Deserialize, Serialize};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{AdditionalProperties, Object, ObjectBuilder, OneOfBuilder, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

use super::app::App;
use super::director::Order;
use super::error::{ApiError, Failure};
use super::input::Body;
use crate::time::{Moment, SimClock, earliest, latest};

/// Simulated time.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct ClockView {
    /// Simulated local date and time.
    #[schema(example = "2014-10-31T15:00:00")]
    pub now: String,
    /// Simulated seconds a real second; 0 stands still.
    pub rate: f64,
    /// Real seconds since the program started.
    pub elapsed_s: f64,
}

impl ClockView {
    /// The clock at a moment.
    pub fn at(moment: Moment, rate: f64) -> Self {
        Self { now: civil_text(moment.civil), rate, elapsed_s: elapsed_s(moment) }
    }

    /// The clock now.
    ///
    /// # Errors
    /// The bus that is asked has ended.
    pub async fn read(app: &App) -> Result<Self, ApiError> {
        let Some(line) = app.buses.first() else { return Err(ApiError::unavailable("there is no bus")) };
        line.call(|bus, now| Self::at(bus.moment(now), bus.rate())).await
    }
}

/// A date and time as all calls print it: with as much of the second as it has.
pub fn civil_text(time: NaiveDateTime) -> String {
    time.format("%Y-%m-%dT%H:%M:%S%.f").to_string()
}

/// Real seconds since the program started.
pub fn elapsed_s(moment: Moment) -> f64 {
    moment.elapsed.0 as f64 / 1e6
}

/// A change of the clock: exactly one of the fields.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockChange {
    now: Option<String>,
    rate: Option<f64>,
    advance_s: Option<f64>,
    until: Option<String>,
}

impl PartialSchema for ClockChange {
    fn schema() -> RefOr<Schema> {
        let number = |about: &str, max: f64| {
            let number = ObjectBuilder::new().schema_type(Type::Number).minimum(Some(0)).maximum(Some(max));
            number.description(Some(about)).build()
        };
        let time = |about: &str| {
            let text = ObjectBuilder::new().schema_type(Type::String).description(Some(about));
            text.examples(["2014-10-31T18:00:00"]).build()
        };
        let only = |name: &str, field: Object| {
            let object = ObjectBuilder::new().property(name, field).required(name);
            object.additional_properties(Some(AdditionalProperties::<Schema>::FreeForm(false))).build()
        };
        let choices = [
            ("now", time("Jump to this local date and time; nothing happens in between.")),
            (
                "rate",
                number("From now on so many simulated seconds a real second; 0 stands still.", SimClock::RATE_MAX),
            ),
            (
                "advance_s",
                number(
                    "Let so many simulated seconds pass; the answer comes when everything in between has happened.",
                    ADVANCE_S_MAX,
                ),
            ),
            ("until", time("Let simulated time pass until this local date and time; everything in between happens.")),
        ];
        let one_of = choices.into_iter().fold(OneOfBuilder::new(), |all, (name, field)| all.item(only(name, field)));
        one_of.description(Some("Exactly one change of the clock.")).into()
    }
}

impl ToSchema for ClockChange {}

/// A change of the clock, judged as far as it can be without looking at the clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Turn {
    /// Jump.
    Now(NaiveDateTime),
    /// Run at this rate.
    Rate(f64),
    /// Live through so many microseconds.
    Advance(i64),
    /// Live on until then.
    Until(NaiveDateTime),
}

/// The most seconds that time may be advanced by: a century.
const ADVANCE_S_MAX: f64 = 36_525.0 * 86_400.0;

impl ClockChange {
    fn judge(&self) -> Result<Turn, ApiError> {
        match (&self.now, self.rate, self.advance_s, &self.until) {
            (Some(text), None, None, None) => parse_time("now", text).map(Turn::Now),
            (None, Some(rate), None, None) => {
                if !(0.0..=SimClock::RATE_MAX).contains(&rate) {
                    let max = SimClock::RATE_MAX;
                    return Err(ApiError::value(format!("rate takes 0 to {max}, not {rate}")).of("rate"));
                }
                // Minus nothing is nothing.
                Ok(Turn::Rate(rate + 0.0))
            }
            (None, None, Some(seconds), None) => {
                if !(0.0..=ADVANCE_S_MAX).contains(&seconds) {
                    let message =
                        format!("advance_s takes 0 to {ADVANCE_S_MAX}, not {seconds}; time goes forward only");
                    return Err(ApiError::value(message).of("advance_s"));
                }
                Ok(Turn::Advance((seconds * 1e6).round() as i64))
            }
            (None, None, None, Some(text)) => parse_time("until", text).map(Turn::Until),
            _ => Err(ApiError::value("the clock takes one of now, rate, advance_s, until at a time")),
        }
    }
}

fn parse_time(field: &str, text: &str) -> Result<NaiveDateTime, ApiError> {
    let time = ["%Y-%m-%dT%H:%M:%S%.f", "%Y-%m-%dT%H:%M"];
    let time = time.into_iter().find_map(|format| NaiveDateTime::parse_from_str(text, format).ok());
    // A leap second is none of the simulation's.
    let time = time.filter(|time| time.nanosecond() < 1_000_000_000 && (earliest()..latest()).contains(time));
    time.ok_or_else(|| {
        let message =
            format!("{field} takes a local date and time such as 2014-10-31T15:00:00, in 2000 to 2099, not {text:?}");
        ApiError::value(message).of(field)
    })
}

/// Simulated time.
#[utoipa::path(get, path = "/api/clock", tag = "clock", operation_id = "clock",
    responses((status = 200, body = ClockView), (status = "default", body = Failure, description = "An error")))]
pub async fn show(State(app): State<App>) -> Result<Json<ClockView>, ApiError> {
    ClockView::read(&app).await.map(Json)
}

/// Moves simulated time, or changes its rate. An advance stops where its caller goes away.
#[utoipa::path(patch, path = "/api/clock", tag = "clock", operation_id = "change_clock", request_body = ClockChange,
    responses((status = 200, body = ClockView), (status = "default", body = Failure, description = "An error")))]
pub async fn change(State(app): State<App>, Body(change): Body<ClockChange>) -> Result<Json<ClockView>, ApiError> {
    let turn = change.judge()?;
    Order::send(&app.director, |answer| Order::Turn(turn, answer)).await.map(Json)
}
