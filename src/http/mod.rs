//! The control interface: JSON over HTTP, by which people and their tools change the world around the devices, move time,
//! break things and ask what happened (CTL-1 … CTL-3).
//!
//! It has a thread of its own and asks the buses' tasks for everything, so that nothing that is asked here keeps a bus
//! from answering. It iterates tables and knows no device.

mod app;
mod clock;
mod devices;
mod director;
mod error;
mod events;
mod faults;
mod guard;
mod input;
mod journal;
mod metrics;
mod server;
mod snapshots;
mod status;

use axum::Router;
use axum::response::{IntoResponse, Response};
use axum::{http::header, middleware};
use utoipa::OpenApi;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use self::app::App;
use self::error::ApiError;
pub use self::server::Server;

/// The description of the interface without its paths, which the handlers give.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "standin",
        description = "The hand that turns the knobs of simulated field devices. Errors are \
            `{\"error\": {\"code\", \"message\", \"field\"}}`: 400 not JSON or an unknown field, 401 no or a wrong token, 403 a \
            foreign Host or Origin, 404 not here, 409 not in this state, 413 more than 1 MiB, 422 a value refused."
    ),
    components(schemas(error::Failure)),
    security((), ("token" = [])),
    tags(
        (name = "status", description = "What runs"),
        (name = "clock", description = "Simulated time"),
        (name = "devices", description = "Devices, their registers and their world"),
        (name = "faults", description = "Things that go wrong on purpose"),
        (name = "journal", description = "What was asked, and what came of it"),
        (name = "snapshots", description = "Keeping and bringing back"),
    )
)]
struct Description;

/// All calls, and their description.
fn calls() -> (Router<App>, utoipa::openapi::OpenApi) {
    let (router, mut description) = OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(status::show))
        .routes(routes!(clock::show, clock::change))
        .routes(routes!(devices::list))
        .routes(routes!(devices::show))
        .routes(routes!(devices::registers, devices::write))
        .routes(routes!(devices::set_inputs))
        .routes(routes!(devices::power))
        .routes(routes!(devices::restart))
        .routes(routes!(devices::factory_reset))
        .routes(routes!(faults::list, faults::add, faults::clear))
        .routes(routes!(faults::show, faults::remove))
        .routes(routes!(journal::list, journal::clear))
        .routes(routes!(journal::count))
        .routes(routes!(snapshots::list))
        .routes(routes!(snapshots::show, snapshots::keep, snapshots::remove))
        .routes(routes!(snapshots::restore))
        .routes(routes!(snapshots::reset))
        .routes(routes!(events::follow))
        .routes(routes!(metrics::show))
        .split_for_parts();
    let token = SecurityScheme::Http(HttpBuilder::new().scheme(HttpAuthScheme::Bearer).build());
    if let Some(components) = &mut description.components {
        components.add_security_scheme("token", token);
    }
    (router, description)
}

/// The whole interface.
fn router(app: App) -> Router {
    let (router, description) = calls();
    let description = description.to_json().unwrap_or_default();
    let describe = move || async move { ([(header::CONTENT_TYPE, "application/json")], description) };
    router
        .route("/api/openapi.json", axum::routing::get(describe))
        .fallback(unknown)
        .method_not_allowed_fallback(wrong_method)
        .layer(middleware::from_fn(input::await_body))
        .layer(middleware::from_fn_with_state(app.clone(), guard::check))
        .with_state(app)
}

async fn unknown(uri: axum::http::Uri) -> Response {
    let message = format!("there is nothing at {}; /api/openapi.json says what there is", uri.path());
    ApiError::not_found(message).into_response()
}

async fn wrong_method(method: axum::http::Method, uri: axum::http::Uri) -> Response {
    ApiError::method(format!("{} does not take {method}; /api/openapi.json says what it takes", uri.path()))
        .into_response()
}
