//! `/api/snapshots` and `/api/reset`: keeping everything, and bringing it back.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::Serialize;
use utoipa::ToSchema;

use super::app::App;
use super::clock::ClockView;
use super::director::Order;
use super::error::{ApiError, Failure};
use super::input::Segment;

/// Something that is kept.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct SnapshotView {
    /// Its name.
    pub name: String,
    /// The simulated time that it was.
    pub now: String,
    /// The real seconds since the program started that it was.
    pub elapsed_s: f64,
}

/// Most characters of a snapshot's name.
const NAME_MAX: usize = 64;

fn judged(name: String) -> Result<String, ApiError> {
    let is_fine = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    // A dot and two dots mean other paths to most clients.
    if (1..=NAME_MAX).contains(&name.len()) && name.chars().all(is_fine) && !name.starts_with('.') {
        return Ok(name);
    }
    let message =
        format!("a snapshot's name has 1 to {NAME_MAX} letters, digits, _, - or ., no . first; it is not {name:?}");
    Err(ApiError::value(message).of("name"))
}

/// What is kept.
#[utoipa::path(get, path = "/api/snapshots", tag = "snapshots", operation_id = "snapshots",
    responses((status = 200, body = Vec<SnapshotView>), (status = "default", body = Failure, description = "An error")))]
pub async fn list(State(app): State<App>) -> Result<Json<Vec<SnapshotView>>, ApiError> {
    Order::send(&app.director, Order::Snapshots).await.map(Json)
}

/// One that is kept.
#[utoipa::path(get, path = "/api/snapshots/{name}", tag = "snapshots", operation_id = "snapshot",
    params(("name" = String, Path, description = "The snapshot")),
    responses((status = 200, body = SnapshotView), (status = "default", body = Failure, description = "An error")))]
pub async fn show(State(app): State<App>, Segment(name): Segment<String>) -> Result<Json<SnapshotView>, ApiError> {
    let all = Order::send(&app.director, Order::Snapshots).await?;
    let names: Vec<String> = all.iter().map(|view| view.name.clone()).collect();
    let found = all.into_iter().find(|view| view.name == name);
    found.map(Json).ok_or_else(|| ApiError::none_of("snapshot", &name, names.iter().map(String::as_str)))
}

/// Keeps devices, EEPROM, inputs, faults and clock as they are now; what was kept under the name is replaced.
#[utoipa::path(post, path = "/api/snapshots/{name}", tag = "snapshots", operation_id = "keep_snapshot",
    params(("name" = String, Path, description = "The snapshot", pattern = "^[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}$")),
    responses((status = 201, body = SnapshotView), (status = "default", body = Failure, description = "An error")))]
pub async fn keep(
    State(app): State<App>,
    Segment(name): Segment<String>,
) -> Result<(StatusCode, Json<SnapshotView>), ApiError> {
    let name = judged(name)?;
    let view = Order::send(&app.director, |answer| Order::Keep(name, answer)).await?;
    Ok((StatusCode::CREATED, Json(view)))
}

/// Forgets a snapshot.
#[utoipa::path(delete, path = "/api/snapshots/{name}", tag = "snapshots", operation_id = "forget_snapshot",
    params(("name" = String, Path, description = "The snapshot")),
    responses((status = 204), (status = "default", body = Failure, description = "An error")))]
pub async fn remove(State(app): State<App>, Segment(name): Segment<String>) -> Result<StatusCode, ApiError> {
    Order::send(&app.director, |answer| Order::Forget(name, answer)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Brings a snapshot back: devices, EEPROM, inputs, faults and clock. Journals and counters go on.
#[utoipa::path(post, path = "/api/snapshots/{name}/restore", tag = "snapshots", operation_id = "restore_snapshot",
    params(("name" = String, Path, description = "The snapshot")),
    responses((status = 200, body = ClockView), (status = "default", body = Failure, description = "An error")))]
pub async fn restore(State(app): State<App>, Segment(name): Segment<String>) -> Result<Json<ClockView>, ApiError> {
    Order::send(&app.director, |answer| Order::Restore(name, answer)).await.map(Json)
}

/// Back to how the program started: devices, EEPROM, inputs and clock, no faults, empty journals, counters at 0. Snapshots
/// stay.
#[utoipa::path(post, path = "/api/reset", tag = "snapshots", operation_id = "reset",
    responses((status = 200, body = ClockView), (status = "default", body = Failure, description = "An error")))]
pub async fn reset(State(app): State<App>) -> Result<Json<ClockView>, ApiError> {
    Order::send(&app.director, Order::Reset).await.map(Json)
}
