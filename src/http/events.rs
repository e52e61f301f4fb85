//! `GET /api/events`: what happens on the buses while it happens, as server-sent events.
//!
//! The buses hand their events to a channel that never waits: a reader that does not keep up loses the oldest and is told
//! how many.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::response::sse::{Event as Sse, KeepAlive};
use axum::response::{IntoResponse, Response};
use futures_util::stream::{self, Stream};
use serde_json::{Value, json};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::broadcast::{self, Receiver};

use super::app::App;
use super::clock::{civil_text, elapsed_s};
use super::devices::value_of;
use super::director::Order;
use super::error::{ApiError, Failure};
use super::journal::{Entry, hex};
use crate::bus::{Event, Exchange, Output};
use crate::io::Watcher;
use crate::time::Moment;

/// Something that happened on the bus of an index.
#[derive(Clone, Debug)]
pub enum Told {
    /// A request and what came of it.
    Exchange(usize, Arc<Exchange>),
    /// Something else.
    Event(usize, Arc<Event>),
}

/// Events that wait for a reader before the oldest are lost.
pub const WAITING_MAX: usize = 1024;

/// How often a stream says that it is still there.
const ALIVE_EVERY: Duration = Duration::from_secs(15);

/// What hands the events of the bus of an index on to those who follow them.
pub fn watcher(index: usize, events: broadcast::Sender<Told>) -> Watcher {
    Box::new(move |_, output| {
        if events.receiver_count() == 0 {
            return;
        }
        let told = match output {
            Output::Exchange(exchange) => Told::Exchange(index, exchange.clone()),
            Output::Event(event) => Told::Event(index, Arc::new(event.clone())),
            _ => return,
        };
        // The last reader may just have gone.
        let _ = events.send(told);
    })
}

/// Follows what happens: `exchange` (as in the journal, without number and hint), `change` of a register, `boot`,
/// `power`, `fault` hit, and `lost` where this reader did not keep up.
#[utoipa::path(get, path = "/api/events", tag = "journal", operation_id = "events",
    responses((status = 200, description = "Server-sent events; the data of each is JSON", content_type = "text/event-stream",
            body = String),
        (status = "default", body = Failure, description = "An error")))]
pub async fn follow(State(app): State<App>) -> Result<Response, ApiError> {
    let receiver = app.events.subscribe();
    Order::send(&app.director, Order::Watch).await?;
    let alive = KeepAlive::new().interval(ALIVE_EVERY);
    Ok(axum::response::Sse::new(events(app, receiver)).keep_alive(alive).into_response())
}

fn events(app: App, receiver: Receiver<Told>) -> impl Stream<Item = Result<Sse, Infallible>> {
    let first = Sse::default().comment("standin");
    stream::unfold((app, receiver, vec![first]), |(app, mut receiver, mut ready)| async move {
        while ready.is_empty() {
            ready = match receiver.recv().await {
                Ok(told) => tell(&app, &told),
                Err(RecvError::Lagged(count)) => vec![event("lost", &json!({ "count": count }))],
                Err(RecvError::Closed) => return None,
            };
        }
        let next = ready.remove(0);
        Some((Ok(next), (app, receiver, ready)))
    })
}

fn event(name: &str, data: &Value) -> Sse {
    Sse::default().event(name).data(data.to_string())
}

fn tell(app: &App, told: &Told) -> Vec<Sse> {
    match told {
        Told::Exchange(index, exchange) => {
            let line = &app.buses[*index];
            let entry = Entry::new(&line.handle.name, &line.devices, 0, exchange);
            let mut data = json!(entry);
            if let Value::Object(fields) = &mut data {
                fields.remove("id");
                fields.remove("hint");
            }
            let hits = exchange.faults.iter().map(|hit| {
                let device = data["device"].clone();
                event("fault", &json!({ "bus": line.handle.name, "id": hit.id, "kind": hit.kind, "device": device }))
            });
            let hits: Vec<Sse> = hits.collect();
            std::iter::once(event("exchange", &data)).chain(hits).collect()
        }
        Told::Event(index, told) => vec![told_event(app, *index, told)],
    }
}

fn told_event(app: &App, index: usize, told: &Event) -> Sse {
    let line = &app.buses[index];
    let head = |at: &Moment, station: Option<usize>| {
        json!({
            "bus": line.handle.name,
            "device": station.map(|station| line.devices[station].name.clone()),
            "elapsed_s": elapsed_s(*at),
            "now": civil_text(at.civil),
        })
    };
    let with = |mut head: Value, more: Value| {
        if let (Value::Object(head), Value::Object(more)) = (&mut head, more) {
            head.extend(more);
        }
        head
    };
    match told {
        Event::Change { at, station, member, scale, before, after } => {
            let more = json!({
                "register": member.name(),
                "raw": after,
                "value": value_of(*member, *scale, *after),
                "unit": member.row.unit,
                "was_raw": before,
                "was": value_of(*member, *scale, *before),
            });
            event("change", &with(head(at, Some(*station)), more))
        }
        Event::Boot { at, station, boots } => event("boot", &with(head(at, Some(*station)), json!({ "boots": boots }))),
        Event::Power { at, station, is_powered } => {
            event("power", &with(head(at, Some(*station)), json!({ "powered": is_powered })))
        }
        Event::Noise { at, hit, bytes } => {
            let more = json!({ "id": hit.id, "kind": hit.kind, "bytes": hex(bytes) });
            event("fault", &with(head(at, None), more))
        }
    }
}
